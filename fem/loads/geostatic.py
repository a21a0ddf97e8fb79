"""Geostatic stress: at every point the weight of what lies vertically above it, and K0 times that sideways.

Weights are constant body forces, so that the integral along a vertical is a sum over the sides of elements at which the
weight jumps (the surface, bounds of layers, roofs and floors of openings): with gamma the weight below and above a side
at the height y_f, the load on a point at the height y is ``sum (gamma_below - gamma_above) (y_f - y)`` over the sides
above it. Exact for straight sides, whatever the mesh.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.discretisation.space import Space
from granfabric.fem.mesh.checks import MeshError

from .bodies import inactive_at_outset
from .checks import values_at
from .kinds import INITIAL, BodyForce, LoadError, Pressure, Stage, Traction, check_stages

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEVEL = 1e-6
"""Rise of a surface, relative to the height of the body, up to which it counts as level."""
UPRIGHT = 1e-9
"""Width of a side, relative to that of the body, up to which it stands upright and bounds nothing from above."""
_CHUNK = 2_000_000


@dataclass(frozen=True)
class _Sides:
    """Sides at which the weight jumps or on which a load stands: ends from left to right, jump of the weight [N/m3]."""

    left: Array
    right: Array
    jump: Array
    facet: NDArray[np.int64]

    def heights(self, number: NDArray[np.int64], x: Array) -> Array:
        """Height of sides at places x between their ends."""
        a, b = self.left[number], self.right[number]
        return a[:, 1] + (x - a[:, 0]) / (b[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])

    def above(self, points: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Pairs of a point and a side above it; a side holds its left end but not its right one."""
        rows, columns = [], []
        step = max(1, _CHUNK // max(len(self.left), 1))
        for first in range(0, len(points), step):
            x, y = points[first : first + step].T
            row, column = np.nonzero((x[:, None] >= self.left[:, 0]) & (x[:, None] < self.right[:, 0]))
            higher = self.heights(column, x[row]) > y[row]
            rows.append(row[higher] + first)
            columns.append(column[higher])
        return np.concatenate(rows), np.concatenate(columns)


def geostatic_stress(
    space: Space, stages: Sequence[Stage], k0: float | Mapping[str, float], level: bool = True
) -> Array:
    """Initial stress from weight and surcharge of the first stage.

    Parameters
    ----------
    space : Space
    stages : sequence of Stage
        The first one, named "initial", holds the weights (`BodyForce`) and the surcharge (`Pressure`, `Traction` on the
        surface); what a later stage activates is not there.
    k0 : float or mapping of str to float
        Horizontal over vertical stress [-], of everything or by region.
    level : bool
        Refuse a surface that is not level, below which this stress is not in equilibrium. If False it is an estimate.

    Returns
    -------
    ndarray, shape (npt, 3)
        xx, yy, xy, tension positive [Pa]; zero where nothing is.

    Raises
    ------
    LoadError
        If weights are missing, not constant or not vertical, or the surface is not level.
    MeshError
        If a region is unknown.

    Examples
    --------
    >>> import granfabric as gf
    >>> space = gf.Space(gf.rectangle(1.0, 2.0, 2, 4), "P2")
    >>> held = [gf.Fixed("bottom"), gf.Fixed("left", ("x",)), gf.Fixed("right", ("x",))]
    >>> initial = gf.Stage("initial", [*held, gf.BodyForce((0.0, -20e3)), gf.Pressure("top", 10e3)])
    >>> stress = gf.geostatic_stress(space, [initial], k0=0.5)
    >>> bool(abs(stress[:, 1] + 10e3 + 20e3 * (2.0 - space.points[:, 1])).max() < 1e-6)
    True
    """
    check_stages(stages)
    if stages[0].name != INITIAL:
        raise LoadError(
            "weight and surcharge of the initial stress are those of the first stage, which has to be named "
            f"{INITIAL!r} so that they act from the outset, not {stages[0].name!r}"
        )
    active = ~inactive_at_outset(space.host_mesh, stages)
    weight = _weights(space, stages[0], active)
    ratio = _ratios(space, k0, active)
    sides = _sides(space, active, weight)
    if level:
        _refuse_slope(space, active, sides)
    there = active[space.point_cell]
    points = space.points[there]
    point, side = sides.above(points)
    lift = sides.heights(side, points[point, 0]) - points[point, 1]
    above = np.bincount(point, weights=sides.jump[side] * lift, minlength=len(points))
    load = above + _surcharge(space, stages[0], sides, points, point, side)
    stress = np.zeros((space.npoints, 3))
    stress[there, 1] = -load
    stress[there, 0] = -ratio[space.point_cell[there]] * load
    return stress


def _weights(space: Space, stage: Stage, active: Mask) -> Array:
    """Unit weight of each element, shape (nelem,) [N/m3]; zero where nothing is."""
    weight = np.zeros(space.nelements)
    for load in stage.loads:
        if not isinstance(load, BodyForce):
            continue
        what = "the body force" + ("" if load.region is None else f" on region {load.region!r}")
        if callable(load.value) or any(map(callable, load.value)):
            raise LoadError(f"{what} is not constant, so that the initial stress does not follow from it")
        if load.value[0] != 0.0 or load.value[1] > 0.0:
            raise LoadError(f"{what} = {tuple(load.value)} does not point straight down, as weight does")
        cells = slice(None) if load.region is None else space.host_mesh.cells(load.region)
        weight[cells] -= load.value[1]
    weight[~active] = 0.0
    bare = active & (weight == 0.0)
    if bare.any():
        names = [name for name, cells in space.host_mesh.regions.items() if bare[cells].any()]
        where = f"region {', '.join(map(repr, names[:3]))}" if names else "a part of the mesh"
        raise LoadError(
            f"the first stage gives no weight (body_force) to {where}, from which the initial stress follows"
            f"{_why_there(space, names)}"
        )
    return weight


def _why_there(space: Space, names: Sequence[str]) -> str:
    """Why a region of several is there at the outset, which who forgot to activate it does not expect."""
    if not names or len(space.host_mesh.regions) < 2:
        return ""
    which = "it is" if len(names) == 1 else "they are"
    return f" (no stage activates {'it' if len(names) == 1 else 'them'}, so that {which} there from the outset)"


def _ratios(space: Space, k0: float | Mapping[str, float], active: Mask) -> Array:
    """K0 of each element, shape (nelem,)."""
    if not isinstance(k0, Mapping):
        return np.full(space.nelements, float(k0))
    ratio = np.zeros(space.nelements)
    for name, value in k0.items():
        try:
            cells = space.host_mesh.cells(name)
        except MeshError as error:
            raise MeshError(f"k0: {error}") from None
        other = ratio[cells]
        if ((other != 0.0) & (other != value)).any():
            raise LoadError(f"k0 of region {name!r}: elements of it are in another region of k0 too")
        ratio[cells] = value
    bare = active & (ratio == 0.0)
    if bare.any():
        names = [name for name, cells in space.host_mesh.regions.items() if bare[cells].any() and name not in k0]
        left_out = ", ".join(map(repr, names[:3])) or "(cells in no region)"
        raise LoadError(f"k0 leaves out region {left_out}{_why_there(space, names)}")
    return ratio


def _sides(space: Space, active: Mask, weight: Array) -> _Sides:
    """Sides at which the weight jumps, without upright ones."""
    mesh = space.host_mesh.mesh
    beside = mesh.f2t
    own = np.where((beside >= 0) & active[beside], weight[beside], 0.0)
    facet = np.flatnonzero(own[0] != own[1])
    ends = mesh.p[:, mesh.facets[:, facet]].transpose(2, 1, 0)  # (n, end, axis)
    order = np.argsort(ends[:, :, 0], axis=1)
    ends = np.take_along_axis(ends, order[:, :, None], axis=1)
    lying = ends[:, 1, 0] - ends[:, 0, 0] > UPRIGHT * np.ptp(mesh.p[0])
    facet, ends = facet[lying], ends[lying]
    # the first element of a side is below it if its middle is
    centre = mesh.p[:, mesh.t[:, beside[0, facet]]].mean(axis=1).T
    slope = (ends[:, 1, 1] - ends[:, 0, 1]) / (ends[:, 1, 0] - ends[:, 0, 0])
    below = centre[:, 1] < ends[:, 0, 1] + slope * (centre[:, 0] - ends[:, 0, 0])
    jump = np.where(below, 1.0, -1.0) * (own[0] - own[1])[facet]
    return _Sides(ends[:, 0], ends[:, 1], jump, facet)


def _refuse_slope(space: Space, active: Mask, sides: _Sides) -> None:
    """See that the ground's surface, below which no air lies and above which nothing does, is level."""
    beside = space.host_mesh.mesh.f2t[:, sides.facet]
    exposed = ((beside >= 0) & active[beside]).sum(axis=0) == 1
    middle = (sides.left + sides.right) / 2
    height = float(np.ptp(space.nodes[:, 1]))
    row, _ = sides.above(middle + np.array([0.0, LEVEL * height]))
    top = exposed & (np.bincount(row, minlength=len(middle)) == 0)
    ends = np.concatenate([sides.left[top], sides.right[top]])
    low, high = ends[np.argmin(ends[:, 1])], ends[np.argmax(ends[:, 1])]
    if high[1] - low[1] > LEVEL * height:
        raise LoadError(
            f"the surface is not level: it rises by {high[1] - low[1]:.4g} m from ({low[0]:.4g}, {low[1]:.4g}) to "
            f"({high[0]:.4g}, {high[1]:.4g}), and below it weight alone does not tell the stress; for sloping ground "
            'use from = "gravity" (an estimate that the first stage brings into equilibrium)'
        )


def _surcharge(
    space: Space,
    stage: Stage,
    sides: _Sides,
    points: Array,
    point: NDArray[np.int64],
    side: NDArray[np.int64],
) -> Array:
    """Vertical load per width of pressures and tractions on sides above each point, shape (n,) [Pa]."""
    load = np.zeros(len(points))
    along = sides.right - sides.left
    length = np.hypot(along[:, 0], along[:, 1])
    for given in stage.loads:
        if not isinstance(given, (Pressure, Traction)):
            continue
        facets = space.host_mesh.facets(given.boundary)
        chosen = np.isin(sides.facet[side], facets)
        row, number = point[chosen], side[chosen]
        if not len(row):
            continue
        x = points[row, 0]
        y = sides.heights(number, x)
        up = np.sign(sides.jump[number])  # of a roof the outward side is below
        normal = up[:, None] * np.stack([-along[number, 1], along[number, 0]], axis=1) / length[number, None]
        if isinstance(given, Pressure):
            down = up * values_at(f"the pressure on boundary {given.boundary!r}", given.value, (), x, y)
        else:
            traction = values_at(f"the traction on boundary {given.boundary!r}", given.value, (2,), x, y, *normal.T)
            down = -traction[:, 1] * (length / along[:, 0])[number]
        load += np.bincount(row, weights=down, minlength=len(points))
    return load
