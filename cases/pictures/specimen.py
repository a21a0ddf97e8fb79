"""Picture of a specimen of disks, from its history and its last checkpoint."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from numpy.typing import NDArray

from granfabric.cases.records import files
from granfabric.cases.records.dem_series import FieldGrid
from granfabric.cases.records.specimen_series import fields_on_grid
from granfabric.dem_ref.sample.disks import SampleError
from granfabric.dem_ref.specimen.membrane import outline
from granfabric.dem_ref.specimen.run import SpecimenRun

from .dem import draw_network
from .style import BLACK, BLUE, GREEN, ORANGE, RED, picture

Columns = dict[str, NDArray[np.float64]]

CELLS = 8
"""Across the specimen, where the scene has no grid."""


def draw_specimen(folder: Path, columns: Columns, scene: dict[str, Any]) -> list[Path]:
    """Draw `overview.png`: curves, the disks with their forces, and the stress ratio in the specimen.

    Parameters
    ----------
    folder : Path
        Holds a checkpoint, if the specimen was consolidated.
    columns : dict of str to ndarray
        Columns of `history.csv`.
    scene : dict
        The scene as resolved.

    Returns
    -------
    list of Path
    """
    path = folder / "overview.png"
    run = _run(folder, scene)
    x = columns["axial_strain"] * 1e6
    with picture(path, 15.0 if run is not None else 8.4, 7.2) as figure:
        widths = [1.0, 1.0] if run is None else [1.0, 1.0, 1.1, 1.1]
        grid = figure.add_gridspec(2, len(widths), width_ratios=widths)
        places = [(row, column) for row in (0, 1) for column in (0, 1)]
        stress, contacts, volume, forces = (figure.add_subplot(grid[place]) for place in places)
        stress.plot(x, columns["stress_ratio"], color=BLACK, label="$q/p$")
        stress.set(title="(a) stress ratio", ylabel="(axial - lateral)/(axial + lateral)")
        contacts.plot(x, columns["coordination"], color=BLUE)
        contacts.set(title="(b) contacts")
        contacts.set_ylabel("$z$ [-]", color=BLUE)
        other = contacts.twinx()
        other.plot(x, columns["fabric_anisotropy"], color=RED)
        other.set_ylabel("$a_c$ along the axis [-]", color=RED)
        other.grid(False)
        volume.plot(x, columns["volumetric_strain"] * 1e6, color=GREEN)
        volume.set(title="(c) change of volume", ylabel="compression [$10^{-6}$]")
        forces.plot(x, columns["upper_force"] / 1e3, color=ORANGE, label="upper platen")
        forces.plot(x, columns["lower_force"] / 1e3, color=BLUE, linestyle="--", label="lower platen")
        forces.set(title="(d) forces on the platens", ylabel="[kN/m]")
        for one in (stress, volume, forces):
            one.set_xlabel("axial strain [$10^{-6}$]")
        contacts.set_xlabel("axial strain [$10^{-6}$]")
        for one in (stress, forces):
            one.legend(fontsize=8)
        if run is not None:
            _bodies(figure, figure.add_subplot(grid[:, 2]), figure.add_subplot(grid[:, 3]), run, scene)
        figure.suptitle(scene["title"], x=0.01, ha="left", fontsize=13, parse_math=False)
    return [path]


def _run(folder: Path, scene: dict[str, Any]) -> SpecimenRun | None:
    """The run whose checkpoint lies in a folder, as far as it went; None without one that can be read."""
    from granfabric.cases.scene.schema_specimen import SpecimenScene
    from granfabric.cases.scene.specimen_path import specimen_legs, specimen_options, strain_step

    checked = SpecimenScene.model_validate(scene)
    try:
        return SpecimenRun.resume(
            folder / files.CHECKPOINT, specimen_options(checked), specimen_legs(checked), strain_step(checked)
        )
    except SampleError:
        return None


def _bodies(figure: Any, left: Any, right: Any, run: SpecimenRun, scene: dict[str, Any]) -> None:
    """The disks with their forces between platens and membranes, and the stress ratio on the grid."""
    specimen = run.specimen
    chains = draw_network(left, specimen.sample, wrapped=False)
    figure.colorbar(chains, ax=left, shrink=0.5, location="bottom", pad=0.02).set_label("normal force over its mean")
    output = scene["output"]
    grid = FieldGrid(output["field_cells"] or CELLS, output["field_kernel"], output.get("field_scale"))
    found, corner = fields_on_grid(specimen, run.start_position, grid)
    p = -0.5 * (found.stress[:, 0] + found.stress[:, 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.hypot(0.5 * (found.stress[:, 0] - found.stress[:, 1]), found.stress[:, 2]) / p
    cells = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]], axis=2).reshape(-1, 4, 2)
    shown = PolyCollection(list(cells), array=ratio, cmap="viridis")
    right.add_collection(shown)
    figure.colorbar(shown, ax=right, shrink=0.5, location="bottom", pad=0.02).set_label("$q/p$, averaged")
    ring = outline(specimen.sample.position, specimen.sample.radius, specimen.left, specimen.right, *specimen.platens)
    low, high = ring.min(axis=0), ring.max(axis=0)
    edge = 0.06 * (high[0] - low[0])
    middle = len(specimen.right) + 2
    for axes, text in ((left, "(e) disks and contact forces"), (right, "(f) stress ratio")):
        for part in (ring[:middle], ring[middle:]):
            axes.plot(*part.T, color=BLUE, linewidth=1.0)
        for height in specimen.platens:
            axes.plot([low[0] - edge, high[0] + edge], [height, height], color=BLACK, linewidth=2.5)
        axes.set(
            title=text, aspect="equal", xticks=[], yticks=[], xlim=(low[0] - edge, high[0] + edge),
            ylim=(low[1] - edge, high[1] + edge),
        )  # fmt: skip
        axes.grid(False)
        axes.spines[:].set_visible(False)
