"""Stress-strain curve of the law with sliding beside loadings of disks beyond the peak, and its figure.

For each folder of ``granfabric dem dem_peak --set packing.particles=5000 --set packing.seed=N -o FOLDER`` the law
follows the loading with the parameters of every folder: its own and those of the other packings.

    python tests/benchmarks/sliding_curve.py FOLDER FOLDER ... docs/figures/sliding.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from granfabric.cases.records.files import read_csv
from granfabric.cases.scene.material_file import read_material
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Material
from granfabric.constitutive.path import Leg, drive
from granfabric.dem_ref.inputs.sliding import fit_hardening, peak_stress_ratio, plastic_part

PRESSURE = 1e5
LEVELS = np.linspace(0.05, 0.9, 35)
CLOSURE = {"force_change": "shifted_distribution", "shear_stiffness": "isostatic"}


def predicted(tables, sliding: bool = True, **changes) -> dict[str, np.ndarray]:
    """q/p, shear strain, dilation and z of the law at constant p, by stress to 99 % of the peak."""
    material = Material(**{**tables["material"], **changes})
    closure = Closure(**{**CLOSURE, **tables.get("closure", {})})
    law = ContactLaw([material], closure, Effects(sliding=sliding))
    top = 0.99 * material.peak_stress_ratio
    history = drive(law, (-PRESSURE, -PRESSURE, 0.0), [Leg(target=(-PRESSURE * (1 - top), -PRESSURE * (1 + top), 0.0),
                                                           increments=200)])  # fmt: skip
    columns = history.columns
    return {
        "ratio": columns["q"] / columns["p"],
        "shear": columns["strain_xx"] - columns["strain_yy"],
        "dilation": columns["strain_xx"] + columns["strain_yy"],
        "z": columns["coordination"],
    }


def measured(folder: Path) -> tuple[dict[str, np.ndarray], dict]:
    """The same of a loading, and what was measured on its packing."""
    history = {name: np.array(values) for name, values in read_csv(folder / "history.csv").items()}
    tables = read_material(folder / "material.toml")
    part = plastic_part(history, {**tables["material"], **tables["closure"]})
    return {
        "ratio": part.stress_ratio, "shear": part.shear, "dilation": part.dilation, "z": history["coordination"],
        "part": part,
    }, tables  # fmt: skip


def misfit(law: dict[str, np.ndarray], dem: dict[str, np.ndarray], peak: float) -> float:
    """Largest relative error of q/p at given shear strain, from q/p = 0.05 to nine tenths of the peak."""
    rising = np.maximum.accumulate(dem["ratio"])
    keep = np.concatenate([[True], np.diff(rising) > 0.0])
    levels = np.linspace(0.05, 0.9 * peak, 60)
    shear = np.interp(levels, rising[keep], dem["shear"][keep])
    return float(np.abs(np.interp(shear, law["shear"], law["ratio"]) / levels - 1.0).max())


def main(folders: list[Path], figure: Path) -> None:
    """Print the table and draw the figure."""
    runs = [measured(folder) for folder in folders]
    laws = [predicted(tables) for _, tables in runs]
    peaks = [peak_stress_ratio(dem["part"]) for dem, _ in runs]
    print("parameters:")
    for folder, (_, tables) in zip(folders, runs, strict=True):
        names = ("peak_stress_ratio", "reference_plastic_strain", "dilatancy", "constant_volume_stress_ratio")
        print(f"  {folder.name}: " + ", ".join(f"{name} {tables['material'][name]:.4g}" for name in names))
    print("fit alone, largest error of q/p at given strain: m = 2, hyperbola, hyperbola from 0.06 on")
    for folder, (dem, _), peak in zip(folders, runs, peaks, strict=True):
        fits = [fit_hardening(dem["part"], peak, *choice).misfit for choice in ((2.0, 0.0), (1.0, 0.0), (1.0, 0.06))]
        print(f"  {folder.name}: " + ", ".join(f"{100 * fit:.1f} %" for fit in fits))
    print("law, largest error of q/p at given strain up to 90 % of the peak (row: loading, column: parameters of)")
    for folder, (dem, _), peak in zip(folders, runs, peaks, strict=True):
        print(f"  {folder.name}: " + ", ".join(f"{100 * misfit(law, dem, peak):.1f} %" for law in laws))

    drawing = draw([dem for dem, _ in runs], laws, predicted(runs[0][1], sliding=False))
    figure.parent.mkdir(parents=True, exist_ok=True)
    drawing.savefig(figure, dpi=130)


def draw(grains: list[dict[str, np.ndarray]], laws: list[dict[str, np.ndarray]], elastic: dict[str, np.ndarray]):
    """The figure: q/p, dilation and z over the shear strain; strains in per cent, in the inset in 1e-4."""
    plt.rcParams.update({"font.size": 9, "axes.grid": True, "grid.alpha": 0.3})
    drawing, axes = plt.subplots(1, 3, figsize=(11.5, 3.8), layout="constrained")
    for number, (dem, law) in enumerate(zip(grains, laws, strict=True)):
        label = number == 0
        for axis, name in zip(axes, ("ratio", "dilation", "z"), strict=True):
            scale = 100.0 if name == "dilation" else 1.0
            reach = dem["shear"] <= 0.0101
            axis.plot(100 * dem["shear"][reach], scale * dem[name][reach], color="0.6", lw=1.0,
                      label="disks, each packing" if label else None)  # fmt: skip
            axis.plot(100 * law["shear"], scale * law[name], color="tab:blue", lw=1.3,
                      label="law, parameters of each" if label else None)  # fmt: skip
    axes[0].plot(100 * elastic["shear"], elastic["ratio"], color="tab:red", ls="--", lw=1.2, label="without sliding")
    axes[2].plot(100 * elastic["shear"], elastic["z"], color="tab:red", ls="--", lw=1.2)
    for axis, name in zip(axes, ("q/p", "dilation [%]", "coordination number"), strict=True):
        axis.set_xlabel("shear strain [%]")
        axis.set_ylabel(name)
        axis.set_xlim(0, 1.0)
        axis.legend(loc="best", fontsize=8)
    inset = axes[0].inset_axes((0.42, 0.12, 0.54, 0.5))
    for dem, law in zip(grains, laws, strict=True):
        inset.plot(1e4 * dem["shear"], dem["ratio"], color="0.6", lw=1.0)
        inset.plot(1e4 * law["shear"], law["ratio"], color="tab:blue", lw=1.2)
    inset.plot(1e4 * elastic["shear"], elastic["ratio"], color="tab:red", ls="--", lw=1.0)
    inset.set_xlim(0, 4)
    inset.set_ylim(0, 0.37)
    inset.set_xlabel(r"$10^{-4}$", fontsize=7, labelpad=0)
    inset.tick_params(labelsize=7)
    axes[0].legend(loc="upper right", fontsize=8, bbox_to_anchor=(1.0, 0.95))
    return drawing


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:-1]], Path(sys.argv[-1]))
