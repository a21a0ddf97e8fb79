"""Gmsh files to raw arrays: plane coordinates, one shape of cells, physical groups by name.

The file is read here and not by meshio, which compares groups with their sign, mixes up a curve and a surface of one
name, and cannot read partitioned and parametric files, MSH 4.0 as Gmsh writes it, and MSH 1.
"""

from __future__ import annotations

import codecs
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.mesh.checks import MeshError

from .elements import Block, IntArray, RawFile
from .groups import groups_of, physical_names
from .sections import split_sections
from .version_4 import read_new
from .versions_1_and_2 import read_old

Sides = tuple[IntArray, NDArray[np.float64]]

# Relative distance of a midside node from the middle of its edge beyond which the edge counts as curved.
_STRAIGHT = 1e-6


class RawMesh(NamedTuple):
    """Points, corners of cells, named node pairs, named cells, curved sides, and what is worth saying of the file."""

    points: NDArray[np.float64]
    cells: IntArray
    lines: dict[str, IntArray]
    regions: dict[str, IntArray]
    sides: Sides
    remarks: tuple[str, ...]


def read_raw(path: Path) -> RawMesh:
    """Points, cells, named node pairs, named elements and curved sides of a `.msh` file.

    Raises
    ------
    MeshError
        If the file is missing, damaged, not plane, or holds unsupported elements.
    """
    if not path.is_file():
        raise MeshError("there is no such file")
    if path.suffix.lower() != ".msh":
        raise MeshError(f"a Gmsh file ending in .msh is wanted, not {path.suffix!r}")
    try:
        data = path.read_bytes().removeprefix(codecs.BOM_UTF8)  # which an editor may have put there
    except OSError as error:
        raise MeshError(f"it cannot be read: {error.strerror}") from None
    file = split_sections(data)
    raw = read_old(file) if file.version in ("1", "2") else read_new(file)
    if raw.missing_parts:
        raise MeshError(
            f"it holds {raw.missing_parts} parts of a partitioned mesh; save it whole "
            "(Mesh.PartitionSplitMeshFiles = 0) or without partitions (gmsh.model.mesh.unpartition())"
        )
    groups = groups_of(raw.blocks, physical_names(file), file.version)
    surfaces = [block for block in raw.blocks if block.kind.dimension == 2 and len(block.nodes)]
    _refuse_mixture(surfaces)
    find = _NodeFinder(raw)
    kind = surfaces[0].kind
    width = min(block.nodes.shape[1] for block in surfaces)
    cells = find(np.concatenate([block.nodes[:, :width] for block in surfaces]), kind.name)
    points = _plane_points(raw.points, cells)
    regions = groups.surfaces
    if file.version in ("1", "2"):
        entity = np.concatenate([block.entity for block in surfaces])
        cells, regions = _merged(cells, kind.corners, regions, entity)
    curves = [block for block in raw.blocks if block.kind.dimension == 1]
    ends = np.concatenate([np.empty((0, 2), dtype=np.int64), *(block.nodes[:, :2] for block in curves)])
    lines = {name: find(ends[index], "lines") for name, index in groups.curves.items()}
    sides = _curved_sides(points, cells, kind.corners)
    return RawMesh(points, cells[:, : kind.corners], lines, regions, sides, groups.remarks)


def _refuse_mixture(surfaces: list[Block]) -> None:
    """See that there are cells, and of one shape and order."""
    if not surfaces:
        raise MeshError("it has no triangles or quadrilaterals; was a physical surface named and meshed in 2D?")
    shapes: Counter[str] = Counter()
    orders: Counter[int] = Counter()
    for block in surfaces:
        shapes[block.kind.name] += len(block.nodes)
        orders[block.kind.order] += len(block.nodes)
    if len(shapes) > 1:
        raise MeshError(
            f"it mixes {shapes['triangles']} triangles and {shapes['quadrilaterals']} quadrilaterals, and a mesh has "
            "to be of one shape: for triangles take `Recombine` out, for quadrilaterals set Mesh.RecombineAll = 1 and "
            "Mesh.SubdivisionAlgorithm = 1"
        )
    if len(orders) > 1:
        raise MeshError(
            f"it mixes {orders[1]} {surfaces[0].kind.name} of first and {orders[2]} of second order; set "
            "Mesh.ElementOrder once, for all surfaces"
        )


class _NodeFinder:
    """Places of nodes by their numbers in the file."""

    def __init__(self, raw: RawFile) -> None:
        self._order = np.argsort(raw.tags, kind="stable")
        self._tags = raw.tags[self._order]
        twice = np.flatnonzero(self._tags[1:] == self._tags[:-1])
        if twice.size:
            raise MeshError(f"it defines the node {self._tags[twice[0]]} twice")

    def __call__(self, tags: IntArray, name: str) -> IntArray:
        place = np.minimum(np.searchsorted(self._tags, tags), max(len(self._tags) - 1, 0))
        if not len(self._tags) or (self._tags[place] != tags).any():
            unknown = tags.flat[0] if not len(self._tags) else tags[self._tags[place] != tags][0]
            raise MeshError(f"one of its {name} names the node {unknown}, which the file does not define")
        return self._order[place]


def _plane_points(points: NDArray[np.float64], cells: IntArray) -> NDArray[np.float64]:
    """Coordinates in the plane; only nodes of cells have to lie in it."""
    used = points[np.unique(cells)]
    with np.errstate(over="ignore", invalid="ignore"):
        spread = np.ptp(used, axis=0)
    if not np.isfinite(spread).all():  # told later, with the coordinate
        return points[:, :2]
    if spread[2] > 1e-9 * max(spread[0], spread[1], 1e-300):
        other = [name for name, size in zip("xy", spread) if size <= 1e-9 * spread[2]]
        remedy = f"; all {other[0]} are equal: turn it into the x-y plane" if other else ""
        raise MeshError(f"it is not plane: z runs from {used[:, 2].min():.6g} to {used[:, 2].max():.6g}{remedy}")
    return points[:, :2]


def _merged(
    cells: IntArray, corners: int, regions: dict[str, IntArray], entity: IntArray
) -> tuple[IntArray, dict[str, IntArray]]:
    """Each cell once, where the file writes it once for every group that it is in.

    Cells with the same corners that are parts of different surfaces in one group lie on top of each other: they stay
    two, and are refused later.
    """
    _, first, inverse = np.unique(np.sort(cells[:, :corners], axis=1), axis=0, return_index=True, return_inverse=True)
    inverse = inverse.ravel()
    if len(first) == len(cells):
        return cells, regions
    for index in regions.values():
        places = np.unique(np.stack([inverse[index], entity[index]], axis=1), axis=0)
        if (places[1:, 0] == places[:-1, 0]).any():
            return cells, regions
    order = np.argsort(first)
    rank = np.empty(len(first), dtype=np.int64)
    rank[order] = np.arange(len(first))
    return cells[first[order]], {name: np.unique(rank[inverse[index]]) for name, index in regions.items()}


def _curved_sides(points: NDArray[np.float64], cells: IntArray, corners: int) -> Sides:
    """Sides of second-order elements whose midside node is not in the middle between their ends."""
    pairs, middles = [np.empty((0, 2), dtype=np.int64)], [np.empty((0, 2))]
    for side in range(corners if cells.shape[1] >= 2 * corners else 0):
        ends = cells[:, [side, (side + 1) % corners]]
        start, end, middle = points[ends[:, 0]], points[ends[:, 1]], points[cells[:, corners + side]]
        off = np.linalg.norm(middle - (start + end) / 2, axis=1)
        curved = off > _STRAIGHT * np.linalg.norm(end - start, axis=1)
        pairs.append(ends[curved])
        middles.append(middle[curved])
    return np.concatenate(pairs), np.concatenate(middles)
