"""Picture of a field run, from `history.csv` and the last files of the two series."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from . import series
from .plot_style import BLACK, BLUE, RED, picture

Array = NDArray[np.float64]

SYMBOLS = {"strain_xx": r"\varepsilon_{xx}", "strain_yy": r"\varepsilon_{yy}", "strain_xy": r"\gamma_{xy}"}
GLYPHS_ALONG = 16
"""Direction lines along the longer side of the specimen."""


def draw_field(folder: Path, columns: dict[str, NDArray[Any]], scene: dict[str, Any]) -> list[Path]:
    """Draw `overview.png`: curves of the means, and maps of the last step's coordination number and fabric.

    Parameters
    ----------
    folder : Path
    columns : dict of str to ndarray, shape (nsteps + 1,)
        Columns of `history.csv`.
    scene : dict
        The scene as resolved.

    Returns
    -------
    list of Path
    """
    path = folder / "overview.png"
    fields, points = series.last_file(folder, "result"), series.last_file(folder, "points")
    maps = fields is not None and points is not None
    with picture(path, 13.0 if maps else 5.5, 6.0) as figure:
        grid = figure.add_gridspec(2, 3 if maps else 1, width_ratios=[1.25, 1, 1] if maps else [1])
        _curves(figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, 0]), columns)
        if fields is not None and points is not None:
            mesh, cloud = series.read(fields), series.read(points)
            left, right = figure.add_subplot(grid[:, 1]), figure.add_subplot(grid[:, 2])
            _map(figure, left, mesh, _magnitude(mesh, "coordination"), "viridis", "coordination number $z$ [-]")
            _map(figure, right, mesh, _magnitude(mesh, "fabric_anisotropy"), "cividis", "fabric anisotropy $a_c$ [-]")
            _directions(right, cloud)
            left.set_title("Coordination number")
            right.set_title("Fabric anisotropy and direction")
        step, stage = int(columns["step"][-1]), str(columns["stage"][-1])
        title = f"{scene['title']} (step {step}, stage {stage})"
        figure.suptitle(title, x=0.01, ha="left", fontsize=13, parse_math=False)
    return [path]


def _curves(above: Any, below: Any, columns: dict[str, NDArray[Any]]) -> None:
    name = max(SYMBOLS, key=lambda key: float(np.ptp(columns[key])))
    sign = -1.0 if columns[name][-1] < 0 else 1.0
    strain = sign * columns[name] * 1e6
    label = f"mean strain ${'-' if sign < 0 else ''}{SYMBOLS[name]}$ [$10^{{-6}}$]"
    marker: dict[str, Any] = {"marker": "o", "markersize": 3.5}
    above.plot(strain, columns["q"] / columns["p"], color=BLACK, label="of the mean stress", **marker)
    above.plot(strain, columns["stress_ratio_largest"], color=RED, linestyle="--", label="largest of all points")
    above.set(xlabel=label, ylabel="stress ratio $q/p$ [-]", title="Stress and strain")
    above.legend()
    low, high = columns["coordination_smallest"], columns["coordination_largest"]
    below.fill_between(strain, low, high, color=BLUE, alpha=0.2, linewidth=0, label="all points")
    below.plot(strain, columns["coordination"], color=BLUE, label="mean", **marker)
    below.set(xlabel=label, ylabel="coordination number $z$ [-]", title="Contact network")
    below.ticklabel_format(axis="y", useOffset=False)
    below.legend()


def _magnitude(mesh: Any, name: str) -> Array:
    values = np.asarray(mesh.point_data[name], dtype=np.float64)
    if values.ndim == 1 or values.shape[1] == 1:
        return np.abs(values.ravel())
    return np.linalg.norm(values, axis=1)


def _map(figure: Any, axes: Any, mesh: Any, values: Array, colours: str, label: str) -> None:
    grid = Triangulation(mesh.points[:, 0], mesh.points[:, 1], series.triangles(mesh))
    low, high = float(values.min()), float(values.max())
    if high - low < 1e-9 * max(abs(high), 1e-12):  # a homogeneous field gets one colour, not magnified rounding
        middle = (low + high) / 2
        low, high = middle - 0.005 * max(abs(middle), 1e-6), middle + 0.005 * max(abs(middle), 1e-6)
    shading = axes.tripcolor(grid, values, shading="gouraud", cmap=colours, vmin=low, vmax=high, rasterized=True)
    bar = figure.colorbar(shading, ax=axes, label=label, shrink=0.85)
    bar.formatter.set_useOffset(False)
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.grid(False)
    axes.locator_params(nbins=4)


def _directions(axes: Any, cloud: Any) -> None:
    """Short lines along the direction of most contacts, as long as the anisotropy is strong."""
    place = cloud.points[:, :2]
    fabric = np.asarray(cloud.point_data["fabric_anisotropy"], dtype=np.float64)
    vector = np.column_stack([fabric.ravel(), np.zeros(len(fabric))]) if fabric.ndim == 1 else fabric[:, :2]
    strength = np.linalg.norm(vector, axis=1)
    if not strength.max() > 1e-12:
        return
    corner, size = place.min(axis=0), np.ptp(place, axis=0)
    number = np.maximum(1, np.round(GLYPHS_ALONG * size / size.max())).astype(np.int64)
    spacing = size / number
    cell = np.minimum(((place - corner) / spacing).astype(np.int64), number - 1)
    # One line for each square of a raster: the mean of its points, at their centre.
    raster = cell[:, 0] * number[1] + cell[:, 1]
    count = np.bincount(raster, minlength=int(number.prod()))
    filled = count > 0

    def mean(values: Array) -> Array:
        sums = [np.bincount(raster, weights=values[:, axis], minlength=len(count))[filled] for axis in range(2)]
        return np.column_stack(sums) / count[filled, None]

    place, vector = mean(place), mean(vector)
    strength = np.linalg.norm(vector, axis=1)
    angle = 0.5 * np.arctan2(vector[:, 1], vector[:, 0])
    half = 0.42 * float(spacing.min()) * (strength / strength.max())[:, None]
    along = half * np.column_stack([np.cos(angle), np.sin(angle)])
    lines = np.stack([place - along, place + along], axis=1)
    for colour, width in ((BLACK, 2.4), ("white", 1.1)):
        axes.add_collection(LineCollection(list(lines), colors=colour, linewidths=width, capstyle="round"))
