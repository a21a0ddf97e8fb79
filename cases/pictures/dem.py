"""Pictures of a DEM run, from its history, its packing and its last checkpoint."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import EllipseCollection, LineCollection
from numpy.typing import NDArray

from granfabric.cases.records import files
from granfabric.dem_ref.loading.run import DemRun, RunOptions
from granfabric.dem_ref.measures.contacts import contacts_of
from granfabric.dem_ref.measures.distribution import force_distribution
from granfabric.dem_ref.measures.fields import contact_fields, particle_fields
from granfabric.dem_ref.measures.tessellation import gap_distribution
from granfabric.dem_ref.sample.disks import Sample, SampleError, load_sample

from .distribution import draw_force_density, draw_gap_density
from .style import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, SKY, picture

Columns = dict[str, NDArray[np.float64]]

CHAIN_WIDTH = 2.4
"""Width of a line [point] at four times the mean force, for a sample of a thousand disks."""


def draw_dem(folder: Path, columns: Columns, scene: dict[str, Any]) -> list[Path]:
    """Draw `overview.png`, `packing.png` and `distributions.png`.

    Parameters
    ----------
    folder : Path
        Holds the packing and, if the loading began, a checkpoint.
    columns : dict of str to ndarray
        Columns of `history.csv`.
    scene : dict
        The scene as resolved.

    Returns
    -------
    list of Path
    """
    from granfabric.cases.scene.dem_path import run_options
    from granfabric.cases.scene.schema_dem import DemScene

    packing = load_sample(folder / files.PACKING)
    run = finished_run(folder, run_options(DemScene.model_validate(scene)))
    made = [_overview(folder, columns, scene), _distributions(folder, packing, scene)]
    made.append(_networks(folder, packing, None if run is None else run.sample, columns, scene))
    return made


def draw_packing(folder: Path, scene: dict[str, Any]) -> list[Path]:
    """Draw `packing.png` and `distributions.png` of a packing that is not loaded."""
    packing = load_sample(folder / files.PACKING)
    return [_distributions(folder, packing, scene), _networks(folder, packing, None, {}, scene)]


def finished_run(folder: Path, options: RunOptions) -> DemRun | None:
    """The run whose checkpoint lies in a folder, as far as it went; None without one that can be read."""
    try:
        return DemRun.resume(folder / files.CHECKPOINT, options)
    except SampleError:
        return None


def stress_ratio(columns: Columns) -> NDArray[np.float64]:
    """q/p of every record, NaN where no pressure is left."""
    p = columns["p"]
    return np.where(p > 0.0, columns["q"] / np.where(p > 0.0, p, 1.0), np.nan)


def _horizontal(columns: Columns) -> tuple[NDArray[np.float64], str]:
    """The strain that moved most, in 1e-6 and positive where it grew first."""
    xx, yy = columns["strain_xx"], columns["strain_yy"]
    choices = {
        (r"\varepsilon_{xx} - \varepsilon_{yy}", r"\varepsilon_{yy} - \varepsilon_{xx}"): xx - yy,
        (r"\varepsilon_{xx} + \varepsilon_{yy}", r"-\varepsilon_{xx} - \varepsilon_{yy}"): xx + yy,
        (r"\gamma_{xy}", r"-\gamma_{xy}"): columns["strain_xy"],
    }
    labels = max(choices, key=lambda names: float(np.ptp(choices[names])))
    values = choices[labels]
    grown = np.abs(values) > 0.05 * np.abs(values).max()
    negative = bool(values[int(np.argmax(grown))] < 0.0)
    return (-values if negative else values) * 1e6, f"strain ${labels[negative]}$ [$10^{{-6}}$]"


def _overview(folder: Path, columns: Columns, scene: dict[str, Any]) -> Path:
    x, label = _horizontal(columns)
    path = folder / "overview.png"
    with picture(path, 12.0, 6.6) as figure:
        axes = figure.subplots(2, 3).ravel()
        stress, count, anisotropy, force, change, quality = axes
        stress.plot(x, stress_ratio(columns), color=BLACK, label="$q/p$")
        if np.ptp(columns["p"]) > 0.02 * columns["p"][0]:
            stress.plot(x, columns["p"] / columns["p"][0], color=BLUE, label="$p/p_0$")
        stress.set(title="(a) stress", ylabel="stress ratio [-]")
        count.plot(x, columns["coordination"], color=BLUE, label="all particles")
        count.plot(x, columns["coordination_without_rattlers"], color=SKY, label="without rattlers")
        count.set(title="(b) coordination number", ylabel="$z$ [-]")
        for name, symbol, colour in (
            ("fabric", "$a_c$", RED), ("normal_force", "$a_n$", GREEN), ("tangential_force", "$a_t$", PURPLE)
        ):  # fmt: skip
            anisotropy.plot(x, columns[f"{name}_anisotropy"], color=colour, label=symbol)
        anisotropy.set(title="(c) anisotropies", ylabel="anisotropy [-]")
        force.plot(x, columns["mean_normal_force"], color=ORANGE, label="mean force $f/f_0$")
        force.plot(x, 1.0 + columns["sliding_fraction"], color=BLACK, linestyle=":", label="1 + sliding fraction")
        force.set(title="(d) mean force, sliding contacts", ylabel="[-]")
        net = columns["fabric_anisotropy"] - columns["fabric_anisotropy"][0]
        change.axhline(0.0, color=BLACK, linewidth=0.8)
        change.plot(x, columns["fabric_lost"], color=ORANGE, linewidth=4.5, alpha=0.75, label="lost")
        change.plot(x, columns["fabric_gained"], color=SKY, label="gained")
        change.plot(x, columns["fabric_persisting"], color=GREEN, label="persisting (rotated)")
        change.plot(x, net, color=BLACK, linestyle=(0, (5, 3)), label="net")
        change.set(title="(e) fabric change by contacts", ylabel="change of $a_c$ [-]")
        late = slice(1, None)
        limits = scene["rates"]
        for name, text, colour in (
            ("unbalanced_force", "unbalanced force", RED), ("inertial_number", "inertial number", BLUE)
        ):  # fmt: skip
            if (columns[name][late] > 0.0).any():  # without contacts there is no unbalanced force
                quality.semilogy(x[late], columns[name][late], color=colour, label=text)
            quality.axhline(limits[name], color=colour, linestyle=":", linewidth=1.2)
        quality.set(title="(f) quasi-static limits (dotted)", ylabel="[-]")
        for one in axes:
            one.set_xlabel(label)
            one.legend(fontsize=8)
        figure.suptitle(scene["title"], x=0.01, ha="left", fontsize=13, parse_math=False)
    return path


def _distributions(folder: Path, packing: Sample, scene: dict[str, Any]) -> Path:
    path = folder / "distributions.png"
    with picture(path, 11.0, 4.4) as figure:
        left, right = figure.subplots(1, 2)
        draw_force_density(left, force_distribution(contacts_of(packing)))
        draw_gap_density(right, gap_distribution(packing), closing=_closing_gap_density(folder))
        figure.suptitle(f"{scene['title']}: the packing", x=0.01, ha="left", fontsize=13, parse_math=False)
    return path


def _closing_gap_density(folder: Path) -> float | None:
    """`gap_density_at_zero` of the material file in the folder; None if there is none."""
    try:
        table = tomllib.loads((folder / files.MATERIAL).read_text(encoding="utf-8"))
        return float(table["material"]["gap_density_at_zero"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _networks(folder: Path, packing: Sample, loaded: Sample | None, columns: Columns, scene: dict[str, Any]) -> Path:
    """Disks and force chains of the packing and of the last state, force over the mean of each as width."""
    path = folder / "packing.png"
    shown = [("packing", packing)]
    if loaded is not None and len(columns["q"]) > 1:
        ratio = stress_ratio(columns)[-1]
        shown.append((f"at $q/p$ = {ratio:.3f}" if np.isfinite(ratio) else "at the end, without pressure", loaded))
    with picture(path, 6.3 * len(shown) + 0.9, 6.6) as figure:
        axes = np.atleast_1d(figure.subplots(1, len(shown)))
        for one, (text, sample) in zip(axes, shown):
            chains = draw_network(one, sample)
            one.set_title(text)
        bar = figure.colorbar(chains, ax=list(axes), shrink=0.6, pad=0.01, boundaries=np.linspace(0.0, 4.0, 81))
        bar.set_ticks([0, 1, 2, 3, 4], labels=["0", "1", "2", "3", r"$\geq$ 4"])
        bar.set_label("normal force over its mean; disks without force blue")
        figure.suptitle(f"{scene['title']}: contact forces", x=0.01, ha="left", fontsize=13, parse_math=False)
    return path


def draw_network(axes: Any, sample: Sample, wrapped: bool = True) -> LineCollection:
    """Disks and contact forces over their mean; in the periodic cell, with its outline, if they are `wrapped`."""
    particles, contacts = particle_fields(sample), contact_fields(sample, wrapped)
    if not wrapped:
        particles["position"] = sample.position
    position, diameter = particles["position"], 2.0 * particles["radius"]
    bearing = particles["bears_force"] > 0
    outline = 0.3 * min(1.0, 2000.0 / sample.count)  # of many disks the outlines alone would fill the picture
    for mask, face in ((bearing, "#e9edf2"), (~bearing, "#a9d4f0")):
        axes.add_collection(
            EllipseCollection(
                diameter[mask], diameter[mask], np.zeros(int(mask.sum())), units="x", offsets=position[mask],
                transOffset=axes.transData, facecolors=face, edgecolors="#b8c0c8", linewidths=outline,
            )
        )  # fmt: skip
    force = contacts["normal_force"]
    force = force / force.mean() if len(force) else force
    order = np.argsort(force)
    lines = np.stack([contacts["start"], contacts["end"]], axis=1)[order]
    scale = CHAIN_WIDTH / 4.0 * np.sqrt(1000.0 / sample.count)
    chains = LineCollection(list(lines), linewidths=scale * force[order], cmap="inferno_r", capstyle="round")
    chains.set_array(np.clip(force[order], 0.0, 4.0))
    chains.set_clim(-0.6, 4.0)
    axes.add_collection(chains)
    if not wrapped:
        return chains
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) @ sample.cell
    axes.plot(*corners.T, color=BLACK, linewidth=0.8)
    edge = 0.5 * float(diameter.max())
    low, high = corners.min(axis=0) - edge, corners.max(axis=0) + edge
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xticks=[], yticks=[])
    axes.grid(False)
    axes.spines[:].set_visible(False)
    return chains
