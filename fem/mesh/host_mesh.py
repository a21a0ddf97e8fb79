"""The host's mesh: scikit-fem topology with boundaries and regions by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray

from granfabric.fem.mesh.msh.file import read_raw

from .checks import MeshError, coordinates, nearest_name, numbers_of, oriented_cells, refuse_doubled_cells
from .curved import curved_mesh
from .topology import TopologyError, check_topology

__all__ = ["HostMesh", "MeshError", "TopologyError", "build_mesh", "read_mesh", "rectangle"]

SAME_PLACE = 1e-9
"""Distance, relative to the size of the mesh, below which two places are the same."""

CurvedSides = tuple[NDArray[np.int64], NDArray[np.float64]]
"""Node pairs, shape (n, 2), and where the middle of the side between them lies [m], shape (n, 2)."""


LARGEST_COORDINATE = 1e60
"""[m]; beyond, areas and their products leave the range of numbers."""


@dataclass(frozen=True)
class HostMesh:
    """A plane mesh of triangles or quadrilaterals.

    Parameters
    ----------
    mesh : skfem.MeshTri1 or skfem.MeshQuad1
        Geometry and topology; coordinates in m.
    boundaries : dict of str to ndarray of int
        Facet indices of each named curve (also curves inside the domain).
    regions : dict of str to ndarray of int
        Element indices of each named surface.
    curved : skfem.MeshTri2 or skfem.MeshQuad2, optional
        The same mesh with curved sides; elements of second order use it as their geometry (isoparametric), those of
        first order the straight one.
    remarks : tuple of str
        What is worth saying about the groups of the file that it was read from.
    """

    mesh: Any
    boundaries: dict[str, NDArray[np.int64]]
    regions: dict[str, NDArray[np.int64]]
    curved: Any = None
    remarks: tuple[str, ...] = ()

    @property
    def cell(self) -> str:
        """ "triangle" or "quad"."""
        return "triangle" if self.mesh.t.shape[0] == 3 else "quad"

    def facets(self, name: str) -> NDArray[np.int64]:
        """Facets of the named curve.

        Raises
        ------
        MeshError
            If the mesh has no such curve; names the nearest.
        """
        if not isinstance(name, str) or name not in self.boundaries:
            raise MeshError(f"the mesh has no boundary {name!r}; {nearest_name(name, list(self.boundaries))}")
        return self.boundaries[name]

    def facets_between(
        self, name: str, x: Sequence[float] | None = None, y: Sequence[float] | None = None
    ) -> NDArray[np.int64]:
        """Facets of the named curve between two places.

        Parameters
        ----------
        name : str
        x, y : (float, float), optional
            From, to [m]; sides of elements have to end there.

        Raises
        ------
        MeshError
            If the mesh has no such curve, or no side of an element lies between, or one lies across an end.
        """
        facets = self.facets(name)
        ends = self.mesh.p[:, self.mesh.facets[:, facets]]
        allowed = SAME_PLACE * float(np.ptp(self.mesh.p, axis=1).max())
        inside, at_end = np.ones(ends.shape[1:], dtype=bool), np.zeros(ends.shape[1:], dtype=bool)
        for axis, between in enumerate((x, y)):
            if between is not None:
                inside &= (ends[axis] >= min(between) - allowed) & (ends[axis] <= max(between) + allowed)
                at_end |= np.abs(ends[axis][..., None] - np.asarray(between)).min(axis=-1) <= allowed
        whole = inside.all(axis=0)
        if not whole.any():
            raise MeshError(f"no side of boundary {name!r} lies between x = {x}, y = {y}")
        if (inside & ~whole & ~at_end).any():
            raise MeshError(
                f"a side of boundary {name!r} lies across an end of x = {x}, y = {y}; snap = true moves the ends to "
                "the nearest nodes"
            )
        return facets[whole]

    def facets_near(
        self, name: str, x: Sequence[float] | None = None, y: Sequence[float] | None = None
    ) -> tuple[NDArray[np.int64], float]:
        """Facets of the named curve between two places whose ends move to the nearest nodes.

        Parameters
        ----------
        name : str
        x, y : (float, float), optional
            From, to [m].

        Returns
        -------
        facets : ndarray of int
            Those with more than half of their length between the places.
        moved : float
            By how much an end has moved, the larger one [m].

        Raises
        ------
        MeshError
            If the mesh has no such curve, or no side of an element lies for the larger part between.
        """
        facets = self.facets(name)
        ends = self.mesh.p[:, self.mesh.facets[:, facets]]
        inside = np.ones(ends.shape[2], dtype=bool)
        middle = ends.mean(axis=1)
        for axis, between in enumerate((x, y)):
            if between is not None:
                inside &= (middle[axis] >= min(between)) & (middle[axis] <= max(between))
        if not inside.any():
            raise MeshError(f"no side of boundary {name!r} lies for the larger part between x = {x}, y = {y}")
        moved = 0.0
        for axis, between in enumerate((x, y)):
            if between is None:
                continue
            for place, low in ((min(between), True), (max(between), False)):
                reached = ends[axis][:, inside].min() if low else ends[axis][:, inside].max()
                whole = ends[axis].min() if low else ends[axis].max()
                # a place beyond the end of the curve is no end of the part
                if not (reached == whole and (place < whole if low else place > whole)):
                    moved = max(moved, abs(float(reached) - place))
        return facets[inside], moved

    def cells(self, name: str) -> NDArray[np.int64]:
        """Elements of the named surface.

        Raises
        ------
        MeshError
            If the mesh has no such surface; names the nearest.
        """
        if not isinstance(name, str) or name not in self.regions:
            raise MeshError(f"the mesh has no region {name!r}; {nearest_name(name, list(self.regions))}")
        return self.regions[name]


def build_mesh(
    points: NDArray[np.float64],
    cells: NDArray[np.int64],
    lines: dict[str, NDArray[np.int64]] | None = None,
    regions: dict[str, NDArray[np.int64]] | None = None,
    sides: CurvedSides | None = None,
    parts: str = "joined",
    remarks: tuple[str, ...] = (),
) -> HostMesh:
    """Checked mesh from raw arrays.

    Parameters
    ----------
    points : ndarray, shape (npoints, 2)
        Coordinates [m]. Points that no element uses are dropped.
    cells : ndarray of int, shape (nelem, 3 or 4)
        Corners, clockwise or counter-clockwise.
    lines : dict of str to ndarray of int, shape (nlines, 2), optional
        Node pairs of each named curve; each pair must be an element edge.
    regions : dict of str to ndarray of int, optional
        Element indices of each named surface.
    sides : CurvedSides, optional
        Sides that are not straight; each must be an element edge.
    parts : {"joined", "separate"}
        "joined": the mesh has to be one body. "separate" admits several bodies, bodies that touch without being
        joined, and cracks whose faces have nodes of their own; see `granfabric.fem.mesh.topology`.
    remarks : tuple of str
        Kept with the mesh.

    Raises
    ------
    MeshError
        If the mesh is not usable; a `TopologyError` if it is not one body or lies over itself.
    """
    points = coordinates("points", points)
    cells = numbers_of("cells", cells, (3, 4), len(points), "nodes")
    if not len(cells):
        raise MeshError("the mesh has no triangles or quadrilaterals")
    if np.abs(points).max() > LARGEST_COORDINATE:
        raise MeshError(f"the mesh holds the coordinate {np.abs(points).max():g}, beyond {LARGEST_COORDINATE:g} m")
    refuse_doubled_cells(points, cells)
    cells = oriented_cells(points, cells)
    used, inverse = np.unique(cells, return_inverse=True)
    renumber = np.full(len(points), -1, dtype=np.int64)
    renumber[used] = np.arange(len(used))
    kind = skfem.MeshTri1 if cells.shape[1] == 3 else skfem.MeshQuad1
    corners = np.ascontiguousarray(inverse.reshape(cells.shape).T)
    mesh = kind(np.ascontiguousarray(points[used].T), corners)
    find = _FacetFinder(mesh, renumber)
    boundaries = {}
    for name, pairs in (lines or {}).items():
        pairs = numbers_of(f"curve {name!r}", pairs, (2,), len(points), "nodes")
        found, bad = find(pairs)
        if bad.any():
            a, b = points[pairs[int(np.argmax(bad))]]
            raise MeshError(
                f"curve {name!r} has a segment from ({a[0]:.6g}, {a[1]:.6g}) to ({b[0]:.6g}, {b[1]:.6g}) that is not "
                "the edge of any element (is the surface beside it a part of the mesh?)"
            )
        boundaries[name] = np.unique(found)
    named = {
        name: np.unique(numbers_of(f"region {name!r}", index, (), len(cells), "elements"))
        for name, index in (regions or {}).items()
    }
    curved = None
    if sides is not None and len(sides[0]):
        ends = numbers_of("curved sides", sides[0], (2,), len(points), "nodes")
        middles = coordinates("middles", sides[1])
        if len(ends) != len(middles):
            raise MeshError(f"there are {len(ends)} curved sides and {len(middles)} middles")
        facets, bad = find(ends)
        if bad.any():
            raise MeshError("a curved side is not the edge of any element")
        curved = curved_mesh(mesh, facets, middles)
    host = HostMesh(mesh, boundaries, named, curved, remarks)
    try:
        check_topology(mesh, named, parts)
    except TopologyError as error:
        error.mesh = host
        raise
    return host


class _FacetFinder:
    """Facets of a mesh by the raw numbers of their ends."""

    def __init__(self, mesh: Any, renumber: NDArray[np.int64]) -> None:
        self._nodes, self._renumber = mesh.p.shape[1], renumber
        facet_keys = np.sort(mesh.facets.astype(np.int64), axis=0)
        keys = facet_keys[0] * self._nodes + facet_keys[1]
        self._order = np.argsort(keys)
        self._keys = keys[self._order]

    def __call__(self, pairs: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Facet of each pair, and which pairs are no facet."""
        ends = np.sort(self._renumber[pairs], axis=1)
        wanted = ends[:, 0] * self._nodes + ends[:, 1]
        position = np.minimum(np.searchsorted(self._keys, wanted), len(self._keys) - 1)
        return self._order[position], (ends < 0).any(axis=1) | (self._keys[position] != wanted)


def read_mesh(path: str | Path, parts: str = "joined") -> HostMesh:
    """Read a Gmsh file (MSH 1, 2, 4.0 or 4.1, text or binary) with boundaries and regions by physical group.

    Parameters
    ----------
    path : str or Path
        A `.msh` file of triangles or quadrilaterals of first or second order in the x-y plane. Curved sides of
        second-order elements become the geometry of P2 and Q2; P1 and Q1 join their corners by straight lines.
        Groups without a name are called by their numbers, ``curve 5`` or ``surface 2``.
    parts : {"joined", "separate"}
        As for `build_mesh`.

    Raises
    ------
    MeshError
        If the file cannot be read, is not plane, or holds degenerate, inverted or mixed elements; a `TopologyError` if
        the mesh is not one body or lies over itself.
    """
    if not isinstance(path, (str, Path)):
        raise MeshError(f"the name of a mesh file is wanted, got a {type(path).__name__}")
    try:
        raw = read_raw(Path(path))
        return build_mesh(raw.points, raw.cells, raw.lines, raw.regions, raw.sides, parts, raw.remarks)
    except TopologyError as error:
        raise error.about(f"mesh {path}") from None
    except MeshError as error:
        raise MeshError(f"mesh {path}: {error}") from None


def rectangle(width: float, height: float, nx: int, ny: int, cell: str = "triangle") -> HostMesh:
    """Structured mesh of ``[0, width] x [0, height]``.

    Parameters
    ----------
    width, height : float
        Sizes [m].
    nx, ny : int
        Number of squares along x and y.
    cell : {"triangle", "quad"}
        Triangles halve each square from its lower left to its upper right corner.

    Returns
    -------
    HostMesh
        With boundaries ``bottom, right, top, left`` and region ``all``.
    """
    if cell not in ("triangle", "quad"):
        raise MeshError(f"cell = {cell!r} is not one of 'triangle', 'quad'")
    for name, number in (("nx", nx), ("ny", ny)):
        if isinstance(number, bool) or not isinstance(number, (int, np.integer)):
            raise MeshError(f"{name} = {number!r} is not a whole number")
    for name, size in (("width", width), ("height", height)):
        if isinstance(size, bool) or not isinstance(size, (int, float, np.integer, np.floating)):
            raise MeshError(f"{name} = {size!r} is not a number")
    if not (width > 0 and height > 0 and nx >= 1 and ny >= 1):
        raise MeshError(f"a rectangle of {width} m x {height} m in {nx} x {ny} cells is empty")
    x, y = np.meshgrid(np.linspace(0.0, width, nx + 1), np.linspace(0.0, height, ny + 1))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    node = np.arange(len(points)).reshape(ny + 1, nx + 1)
    a, b, c, d = (part.ravel() for part in (node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]))
    if cell == "quad":
        cells = np.stack([a, b, c, d], axis=1)
    else:
        cells = np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)
    sides = {"bottom": node[0], "right": node[:, -1], "top": node[-1], "left": node[:, 0]}
    lines = {name: np.stack([line[:-1], line[1:]], axis=1) for name, line in sides.items()}
    return build_mesh(points, cells, lines, {"all": np.arange(len(cells))})
