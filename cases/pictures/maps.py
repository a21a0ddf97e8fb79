"""Maps of a field run: what can be drawn of the last step, its colours and units."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from granfabric.cases.records import series

from .style import BLACK

Array = NDArray[np.float64]

GLYPHS_ALONG = 16
"""Direction lines along the longer side of the specimen."""
WIDE = 0.8
"""Width over height from which maps lie above each other."""
CONTOURS = 9
FRACTION_DRAWN = 0.995
"""Colours end where this fraction of the nodes ends, on either side: a singular corner does not grey out the rest."""


def _magnitude(mesh: Any, name: str) -> Array:
    values = np.asarray(mesh.point_data[name], dtype=np.float64)
    if values.ndim == 1 or values.shape[1] == 1:
        return np.abs(values.ravel())
    return np.asarray(np.linalg.norm(values, axis=1))


def _stress(mesh: Any, place: int, name: str = "stress") -> Array:
    return np.asarray(mesh.point_data[name], dtype=np.float64)[:, place]


def _carried(mesh: Any) -> str:
    """Stress of the skeleton: the effective one where there is pore fluid."""
    return "effective_stress" if "effective_stress" in mesh.point_data else "stress"


def _pressure(mesh: Any, name: str = "stress") -> Array:
    return -(_stress(mesh, 0, name) + _stress(mesh, 4, name)) / 2


def _stress_ratio(mesh: Any) -> Array:
    deviator = np.hypot((_stress(mesh, 0) - _stress(mesh, 4)) / 2, _stress(mesh, 1))
    return np.asarray(deviator / _pressure(mesh, _carried(mesh)))


def _pore_pressure(mesh: Any) -> Array:
    if "pore_pressure" not in mesh.point_data:
        return np.zeros(len(mesh.points))
    return np.asarray(mesh.point_data["pore_pressure"], dtype=np.float64).ravel()


def _displacement(mesh: Any, axis: int) -> Array:
    return np.asarray(mesh.point_data["displacement"], dtype=np.float64)[:, axis]


DIVERGING = "RdBu_r"
"""Colours of a field that takes both signs, white at zero."""
BOTH_SIGNS = 0.02
"""Smaller over larger of the two extremes from which a field takes both signs."""


@dataclass(frozen=True)
class Map:
    """How a field is drawn: title, label of the colour bar, colours, values of the last and the first step.

    A field with diverging colours has them centred on zero whatever its values are; any other one that takes both signs
    gets them.
    """

    title: str
    label: str
    colours: str
    values: Callable[[Any, Any], Array]

    def shades(self, low: float, high: float) -> tuple[str, float, float]:
        """Colours and the values at their two ends, for a field between two values."""
        reach = max(abs(low), abs(high))
        if self.colours == DIVERGING or min(-low, high) > BOTH_SIGNS * reach:
            return DIVERGING, -reach, reach
        return self.colours, low, high


MAPS: dict[str, Map] = {
    "coordination": Map(
        "Coordination number",
        "coordination number $z$ [-]",
        "viridis",
        lambda last, _: _magnitude(last, "coordination"),
    ),
    "coordination_change": Map(
        "Change of coordination",
        "$z - z(0)$ [-]",
        "viridis",
        lambda last, first: _magnitude(last, "coordination") - _magnitude(first, "coordination"),
    ),
    "fabric_anisotropy": Map(
        "Fabric and its direction",
        "fabric anisotropy $a_c$ [-]",
        "cividis",
        lambda last, _: _magnitude(last, "fabric_anisotropy"),
    ),
    "mean_pressure": Map("Mean pressure", "mean pressure $p$ [kPa]", "magma_r", lambda last, _: _pressure(last) / 1e3),
    "stress_ratio": Map("Stress ratio", "stress ratio $q/p$ [-]", "inferno_r", lambda last, _: _stress_ratio(last)),
    "stress_xx": Map("Stress xx", r"$\sigma_{xx}$ [kPa]", "magma", lambda last, _: _stress(last, 0) / 1e3),
    "stress_yy": Map("Stress yy", r"$\sigma_{yy}$ [kPa]", "magma", lambda last, _: _stress(last, 4) / 1e3),
    "stress_xy": Map("Shear stress xy", r"$\sigma_{xy}$ [kPa]", DIVERGING, lambda last, _: _stress(last, 1) / 1e3),
    "pore_pressure": Map(
        "Pore pressure", "pore pressure $u$ [kPa]", "Blues", lambda last, _: _pore_pressure(last) / 1e3
    ),
    "displacement_x": Map(
        "Displacement x", r"$u_x$ [$10^{-6}$ m]", DIVERGING, lambda last, _: _displacement(last, 0) * 1e6
    ),
    "displacement_y": Map(
        "Displacement y", r"$u_y$ [$10^{-6}$ m]", DIVERGING, lambda last, _: _displacement(last, 1) * 1e6
    ),
}


def is_wide(mesh: Any) -> bool:
    """Whether the body is so wide that maps lie above each other."""
    size = np.ptp(mesh.points[:, :2], axis=0)
    return bool(size[0] > WIDE * size[1])


def chosen_maps(wanted: list[str], last: Any) -> list[str]:
    """Fields to draw: those that the scene names, else the network where it varies, else the stress."""
    if wanted:
        return wanted
    z = _magnitude(last, "coordination")
    varies = float(np.ptp(z)) > 1e-9 or float(_magnitude(last, "fabric_anisotropy").max()) > 1e-9
    return ["coordination", "fabric_anisotropy"] if varies else ["mean_pressure", "stress_ratio"]


def draw_map(figure: Any, axes: Any, name: str, last: Any, first: Any, cloud: Any) -> None:
    """Draw one field with its colour bar into axes; of the fabric also the direction of most contacts."""
    what = MAPS[name]
    values = what.values(last, first)
    grid = Triangulation(last.points[:, 0], last.points[:, 1], series.triangles(last))
    low, high = (float(bound) for bound in np.quantile(values, [1 - FRACTION_DRAWN, FRACTION_DRAWN]))
    flat = high - low < 1e-9 * max(abs(high), 1e-12)
    if flat:  # a homogeneous field gets one colour, not magnified rounding
        middle = (low + high) / 2
        low, high = middle - 0.005 * max(abs(middle), 1e-6), middle + 0.005 * max(abs(middle), 1e-6)
    colours, least, most = what.shades(low, high)
    beyond = bool(values.min() < least), bool(values.max() > most)
    extend = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[beyond]
    shading = axes.tripcolor(grid, values, shading="gouraud", cmap=colours, vmin=least, vmax=most, rasterized=True)
    if not flat:
        levels = np.linspace(low, high, CONTOURS + 2)[1:-1]
        axes.tricontour(grid, values, levels=levels, colors=BLACK, linewidths=0.5, linestyles="solid", alpha=0.45)
    # As high as the map where maps lie above each other; the layout keeps room for bars only between maps side by side.
    where = {"cax": axes.inset_axes((1.03, 0.0, 0.05, 1.0))} if is_wide(last) else {"ax": axes, "shrink": 0.85}
    bar = figure.colorbar(shading, label=what.label, extend=extend, **where)
    bar.formatter.set_useOffset(False)
    bar.ax.set_ylim(low, high)
    edges = _region_edges(last)
    if len(edges):
        axes.add_collection(LineCollection(list(edges), colors=BLACK, linewidths=1.1))
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title=what.title)
    axes.grid(False)
    axes.locator_params(nbins=4)
    if name == "fabric_anisotropy":
        _directions(axes, cloud)


def _region_edges(mesh: Any) -> Array:
    """Lines between regions, shape (n, 2, 2) [m]."""
    region, triangles = series.of_triangles(mesh, "region"), series.triangles(mesh)
    if region is None or not len(triangles) or (region == region[0]).all():
        return np.zeros((0, 2, 2))
    # nodes at one place, where materials meet, are one here
    places, place = np.unique(mesh.points[:, :2], axis=0, return_inverse=True)
    sides = np.sort(place.ravel()[triangles[:, [[0, 1], [1, 2], [2, 0]]]].reshape(-1, 2), axis=1)
    of_side = np.repeat(region, 3)
    key = sides[:, 0] * len(places) + sides[:, 1]
    order = np.argsort(key, kind="stable")
    pair = np.flatnonzero(key[order[:-1]] == key[order[1:]])
    between = pair[of_side[order[pair]] != of_side[order[pair + 1]]]
    return np.asarray(places[sides[order[between]]])


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
