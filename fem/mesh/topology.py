"""Whether a mesh is one body: no doubled or hanging nodes, no parts that only look joined, no cells over others.

Everything that can be wrong shows on the outline, the sides with a cell on one side only: the sides of a mesh that is
joined well bound the body, and no node but their own ends lies on them. So the outline is compared with itself, and a
point just inside each of its sides has to lie in one cell.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from .checks import MeshError
from .near_boxes import overlapping_boxes

IntArray = NDArray[np.int64]
Array = NDArray[np.float64]

TOUCH = 1e-3
"""Fraction of the size of the cells around below which a node counts as lying on a side, or on another node."""
OVERLAP = 0.05
"""Fraction of its size by which a cell may reach into another body: curved interfaces with different nodes do."""

PARTS = ("joined", "separate")

_REMEDY = (
    "in Gmsh let surfaces share their curves (Coherence, or BooleanFragments with OpenCASCADE) or merge the nodes "
    "(Coherence Mesh, or gmsh.model.mesh.removeDuplicateNodes())"
)
_DELIBERATE = 'if that is meant (a crack, bodies held one by one), set mesh.parts = "separate"'
_OVERLAY = "in Gmsh cut the surfaces along each other (BooleanFragments) or take one away (BooleanDifference)"


class TopologyError(MeshError):
    """A mesh is not one body; `mesh` is what was built of it, `places` are where it is wrong, shape (n, 2) [m]."""

    mesh: Any = None

    def __init__(self, text: str, places: Array) -> None:
        super().__init__(text)
        self.places = places

    def about(self, subject: str) -> TopologyError:
        """The same error, beginning with what it is about."""
        error = TopologyError(f"{subject}: {self}", self.places)
        error.mesh = self.mesh
        return error


@dataclass(frozen=True)
class Outline:
    """Sides with one cell.

    Parameters
    ----------
    ends : ndarray of int, shape (n, 2)
    cell : ndarray of int, shape (n,)
    body : ndarray of int, shape (n,)
        Body that the cell is in: cells in one body are joined by sides or corners.
    """

    ends: IntArray
    cell: IntArray
    body: IntArray


def _components(ends: IntArray, size: int) -> IntArray:
    graph = coo_matrix((np.ones(ends.shape[1]), (ends[0], ends[1])), shape=(size, size))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def parts_of(mesh: Any) -> IntArray:
    """Number of the part that each cell is in; the cells of a part are joined by sides, not by corners alone."""
    return _components(mesh.f2t[:, mesh.f2t[1] >= 0], mesh.t.shape[1])


def _cell_sizes(mesh: Any) -> Array:
    """Size of each cell across [m]: the least area between two of its sides over its longest side."""
    corners = mesh.p.T[mesh.t.T]
    ahead, back = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    areas = np.abs(ahead[:, :, 0] * back[:, :, 1] - ahead[:, :, 1] * back[:, :, 0])
    return areas.min(axis=1) / np.linalg.norm(ahead, axis=2).max(axis=1)


def outline_of(mesh: Any) -> Outline:
    """Sides of a mesh with one cell."""
    facets = np.flatnonzero(mesh.f2t[1] < 0)
    ends = mesh.facets[:, facets].T.astype(np.int64)
    body = _components(mesh.facets, mesh.p.shape[1])
    return Outline(ends, mesh.f2t[0, facets].astype(np.int64), body[ends[:, 0]])


def twin_sides(mesh: Any) -> IntArray:
    """Pairs of sides of the outline that lie on each other with nodes of their own, as the faces of a crack do.

    Returns
    -------
    ndarray of int, shape (n, 2)
        Numbers of facets.
    """
    facets = np.flatnonzero(mesh.f2t[1] < 0)
    ends = mesh.p.T[mesh.facets[:, facets].T]
    reach = TOUCH * _cell_sizes(mesh)[mesh.f2t[0, facets]]
    low, high = ends.min(axis=1) - reach[:, None], ends.max(axis=1) + reach[:, None]
    found = [np.empty((0, 2), dtype=np.int64)]
    for i, j in overlapping_boxes(low, high, low, high):
        i, j = i[i < j], j[i < j]
        apart = [np.linalg.norm(ends[i] - ends[j][:, order], axis=2).max(axis=1) for order in ([0, 1], [1, 0])]
        same = np.minimum(*apart) <= np.minimum(reach[i], reach[j])
        found.append(np.stack([facets[i[same]], facets[j[same]]], axis=1))
    return np.concatenate(found)


def check_topology(mesh: Any, regions: dict[str, IntArray], parts: str = "joined") -> None:
    """Refuse a mesh that is not what it looks like.

    Parameters
    ----------
    mesh : skfem.MeshTri1 or skfem.MeshQuad1
    regions : dict of str to ndarray of int
        For the names in messages.
    parts : {"joined", "separate"}
        "separate" admits several parts, parts that touch, and doubled nodes, so that cracks and bodies side by side are
        possible. Hanging nodes within a body (between cells that common nodes join, if in a roundabout way) and cells
        that overlap are refused either way.

    Raises
    ------
    TopologyError
        With coordinates, the regions and a remedy.
    MeshError
        If `parts` is neither.
    """
    if parts not in PARTS:
        raise MeshError(f"parts = {parts!r} is not one of {', '.join(repr(name) for name in PARTS)}")
    part = parts_of(mesh)
    outline = outline_of(mesh)
    say = _Words(mesh, regions, part)
    near = _Neighbours(mesh, outline)
    _refuse_overlaps(mesh, outline, near, say)
    _refuse_hanging_nodes(outline, near, say, separate=parts == "separate")
    if parts == "joined":
        _refuse_doubled_nodes(outline, near, say)
        _refuse_parts(mesh, part, say)


class _Words:
    """Places and regions for messages."""

    def __init__(self, mesh: Any, regions: dict[str, IntArray], part: IntArray) -> None:
        self.points, self.part = mesh.p.T, part
        self.nparts = int(part.max()) + 1
        self._mesh, self._names = mesh, list(regions)
        self._region = np.full(len(part), -1, dtype=np.int64)
        for number, cells in reversed(list(enumerate(regions.values()))):  # of several the first is named
            self._region[cells] = number

    def at(self, place: Array) -> str:
        return f"({place[0]:.6g}, {place[1]:.6g})"

    def between(self, one: int, other: int) -> str:
        """The regions of two cells."""
        numbers = sorted((int(self._region[cell]) for cell in (one, other)), key=lambda n: (n < 0, n))
        shown = [f"region {self._names[number]!r}" if number >= 0 else "a cell of no region" for number in numbers]
        return f"in {shown[0]}" if shown[0] == shown[1] else f"between {shown[0]} and {shown[1]}"

    def subject(self) -> str:
        return "the mesh" if self.nparts == 1 else f"the mesh falls into {self.nparts} parts"

    def part_at(self, number: int) -> str:
        """A part by its regions, size and place."""
        cells = np.flatnonzero(self.part == number)
        names = [self._names[number] for number in np.unique(self._region[cells]) if number >= 0][:3]
        middle = self.points[self._mesh.t[:, cells[0]]].mean(axis=0)
        shown = f"region{'s' if len(names) > 1 else ''} {', '.join(map(repr, names))}, " if names else ""
        return f"{shown}{len(cells)} {'cell' if len(cells) == 1 else 'cells'} at {self.at(middle)}"


class _Neighbours:
    """Pairs of sides of the outline that are near each other, and what they do to each other.

    Attributes
    ----------
    hanging : ndarray of int, shape (n, 3)
        Node, side on which it lies without being its end, side of which it is an end.
    doubled : ndarray of int, shape (n, 4)
        Two nodes at one place, two sides of which they are ends.
    crossing : ndarray of int, shape (n, 2)
        Sides that cross.
    """

    def __init__(self, mesh: Any, outline: Outline) -> None:
        points = mesh.p.T
        start, end = points[outline.ends[:, 0]], points[outline.ends[:, 1]]
        length = np.linalg.norm(end - start, axis=1)
        of_cell = _cell_sizes(mesh)
        of_side, of_node = of_cell[outline.cell], np.full(len(points), np.inf)
        for corner in mesh.t:
            np.minimum.at(of_node, corner, of_cell)
        reach = TOUCH * of_side[:, None]
        low, high = np.minimum(start, end) - reach, np.maximum(start, end) + reach
        hanging = [np.empty((0, 3), dtype=np.int64)]
        doubled = [np.empty((0, 4), dtype=np.int64)]
        crossing = [np.empty((0, 2), dtype=np.int64)]
        for i, j in overlapping_boxes(low, high, low, high):
            i, j = i[i != j], j[i != j]
            shared = (outline.ends[i][:, :, None] == outline.ends[j][:, None, :]).any(axis=(1, 2))
            along = (end[i] - start[i]) / length[i][:, None]
            for k in (0, 1):  # ends of the side j seen from the side i
                node = outline.ends[j, k]
                away = points[node] - start[i]
                place = np.einsum("ni,ni->n", away, along)
                height = np.abs(along[:, 0] * away[:, 1] - along[:, 1] * away[:, 0])
                allowed = TOUCH * np.minimum(of_side[i], of_node[node])
                on = (height <= allowed) & (place > allowed) & (place < length[i] - allowed)
                hanging.append(np.stack([node[on], i[on], j[on]], axis=1))
                for m in (0, 1):
                    mine = outline.ends[i, m]
                    apart = np.linalg.norm(points[node] - points[mine], axis=1)
                    # also for two sides with a common end: a crack ends in one node and opens in two
                    same = (apart <= TOUCH * np.minimum(of_node[mine], of_node[node])) & (mine < node)
                    doubled.append(np.stack([mine[same], node[same], i[same], j[same]], axis=1))
            half = (i < j) & ~shared
            crossing.append(_crossing(points, outline, i[half], j[half], length, of_side))
        self.hanging = _first_of_each(np.concatenate(hanging), (0, 1))
        self.doubled = _first_of_each(np.concatenate(doubled), (0, 1))
        self.crossing = np.concatenate(crossing)


def _first_of_each(rows: IntArray, columns: tuple[int, ...]) -> IntArray:
    return rows[np.unique(rows[:, columns], axis=0, return_index=True)[1]]


def _crossing(points: Array, outline: Outline, i: IntArray, j: IntArray, length: Array, size: Array) -> IntArray:
    """Pairs of sides that cross, each with both ends clearly on either side of the other."""

    def heights(line: IntArray, other: IntArray) -> Array:
        a, b = points[outline.ends[line, 0]], points[outline.ends[line, 1]]
        away = points[outline.ends[other]] - a[:, None, :]
        direction = (b - a) / length[line][:, None]
        return direction[:, None, 0] * away[:, :, 1] - direction[:, None, 1] * away[:, :, 0]

    first, second = heights(i, j), heights(j, i)
    least = np.minimum(np.abs(first).min(axis=1), np.abs(second).min(axis=1))
    allowed = np.where(outline.body[i] == outline.body[j], TOUCH, OVERLAP) * np.minimum(size[i], size[j])
    cross = (first.prod(axis=1) < 0) & (second.prod(axis=1) < 0) & (least > allowed)
    return np.stack([i[cross], j[cross]], axis=1)


def _covered(mesh: Any, outline: Outline) -> tuple[IntArray, IntArray]:
    """Sides whose inside lies in a second cell, and that cell."""
    corners = mesh.p.T[mesh.t.T]
    start, end = mesh.p.T[outline.ends[:, 0]], mesh.p.T[outline.ends[:, 1]]
    middle = (start + end) / 2
    across = np.stack([start[:, 1] - end[:, 1], end[:, 0] - start[:, 0]], axis=1)
    across /= np.linalg.norm(across, axis=1)[:, None]
    height = np.einsum("nci,ni->nc", corners[outline.cell] - middle[:, None, :], across)
    deepest = height[np.arange(len(height)), np.abs(height).argmax(axis=1)]
    inside = middle + OVERLAP * deepest[:, None] * across
    found: tuple[list[IntArray], list[IntArray]] = ([], [])
    for side, cell in overlapping_boxes(inside, inside, corners.min(axis=1), corners.max(axis=1)):
        other = cell != outline.cell[side]
        side, cell = side[other], cell[other]
        edges = np.roll(corners[cell], -1, axis=1) - corners[cell]
        away = inside[side][:, None, :] - corners[cell]
        turn = edges[:, :, 0] * away[:, :, 1] - edges[:, :, 1] * away[:, :, 0]
        # skfem sorts the corners of triangles: their sense of rotation is not known
        over = (turn > 0).all(axis=1) | (turn < 0).all(axis=1)
        found[0].append(side[over])
        found[1].append(cell[over])
    none = np.empty(0, dtype=np.int64)
    return np.concatenate([none, *found[0]]), np.concatenate([none, *found[1]])


def _refuse_overlaps(mesh: Any, outline: Outline, near: _Neighbours, say: _Words) -> None:
    side, cell = _covered(mesh, outline)
    if side.size:
        first = np.unique(side, return_index=True)[1]
        places = say.points[outline.ends[side[first]]].mean(axis=1)
        one, other = int(outline.cell[side[first[0]]]), int(cell[first[0]])
    elif near.crossing.size:
        i, j = near.crossing[0]
        places = say.points[outline.ends[near.crossing[:, 0]]].mean(axis=1)
        one, other = int(outline.cell[i]), int(outline.cell[j])
    else:
        return
    overlap = "overlaps itself" if say.nparts == 1 else "that overlap"
    raise TopologyError(
        f"{say.subject()} {overlap}: cells lie over cells at {say.at(places[0])} {say.between(one, other)} and at "
        f"{len(places)} sides of its outline in all; {_OVERLAY}",
        places,
    )


def _refuse_hanging_nodes(outline: Outline, near: _Neighbours, say: _Words, separate: bool) -> None:
    rows = near.hanging[np.lexsort(near.hanging.T[::-1])]
    within = outline.body[rows[:, 1]] == outline.body[rows[:, 2]]
    if separate:
        rows = rows[within]
    if not rows.size:
        return
    node, side, other = rows[np.argmax(outline.body[rows[:, 1]] == outline.body[rows[:, 2]])]
    places = say.points[np.unique(rows[:, 0])]
    a, b = say.points[outline.ends[side]]
    start = "the mesh has hanging nodes" if within.any() else f"{say.subject()} that touch"
    count = f"{len(places)} such {'node' if len(places) == 1 else 'nodes'}"
    raise TopologyError(
        f"{start}: the node at {say.at(say.points[node])} lies on the side from {say.at(a)} to "
        f"{say.at(b)}, which does not have it ({say.between(int(outline.cell[side]), int(outline.cell[other]))}; "
        f"{count} in all); {_REMEDY}" + (f"; {_DELIBERATE}" if not separate and not within.any() else ""),
        places,
    )


def _refuse_doubled_nodes(outline: Outline, near: _Neighbours, say: _Words) -> None:
    if not near.doubled.size:
        return
    node, _, side, other = near.doubled[0]
    places = say.points[np.unique(near.doubled[:, 0])]
    what = "has doubled nodes" if say.nparts == 1 else "that touch"
    count = f"{len(places)} such {'place' if len(places) == 1 else 'places'}"
    where = say.between(int(outline.cell[side]), int(outline.cell[other]))
    raise TopologyError(
        f"{say.subject()} {what}: two nodes at {say.at(say.points[node])} are not one ({where}; {count} in all); "
        f"{_REMEDY}; {_DELIBERATE}",
        places,
    )


def _refuse_parts(mesh: Any, part: IntArray, say: _Words) -> None:
    if say.nparts == 1:
        return
    sizes = np.bincount(part)
    shown = np.argsort(-sizes, kind="stable")[:3]
    listed = "; ".join(say.part_at(int(number)) for number in shown)
    nodes = np.concatenate([np.stack([row, part], axis=1) for row in mesh.t.astype(np.int64)])
    nodes = np.unique(nodes, axis=0)
    hinges = np.unique(nodes[1:][nodes[1:, 0] == nodes[:-1, 0], 0])
    more = f" and {say.nparts - 3} more" if say.nparts > 3 else ""
    if hinges.size:
        places = say.points[hinges]
        text = f"that hang together at single nodes only, as at a hinge, such as the one at {say.at(places[0])}"
    else:
        places = say.points[mesh.t[0, [int(np.argmax(part == number)) for number in shown]]]
        text = "that do not touch"
    raise TopologyError(f"{say.subject()} {text} ({listed}{more}); {_DELIBERATE}", places)
