"""Gmsh files to raw arrays: plane coordinates, one kind of element, physical groups by name."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
from numpy.typing import NDArray

from .checks import MeshError
from .foreign_files import ForeignFileError, guarded
from .gmsh_file_checks import check_sections

IntArray = NDArray[np.int64]
Sides = tuple[IntArray, NDArray[np.float64]]
RawMesh = tuple[NDArray[np.float64], IntArray, dict[str, IntArray], dict[str, IntArray], Sides]

_CORNERS = {"triangle": 3, "triangle6": 3, "quad": 4, "quad8": 4, "quad9": 4}
_LINES = ("line", "line3")
_IGNORED = ("vertex",)
# Relative distance of a midside node from the middle of its edge beyond which the edge counts as curved.
_STRAIGHT = 1e-6


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
        data = path.read_bytes()
    except OSError as error:
        raise MeshError(f"it cannot be read: {error.strerror}") from None
    check_sections(data)
    try:
        with guarded(len(data)):
            raw = meshio.gmsh.read(str(path))
    except ForeignFileError as error:
        raise MeshError(f"it cannot be read as Gmsh MSH 2.2 or 4.1 ({error})") from None
    kinds = [block.type for block in raw.cells]
    for kind in kinds:
        if kind not in _CORNERS and kind not in _LINES and kind not in _IGNORED:
            raise MeshError(
                f"it is not a plane mesh of triangles or quadrilaterals: it holds elements of type {kind!r}"
            )
    surface = sorted({kind for kind in kinds if kind in _CORNERS})
    if not surface:
        raise MeshError("it has no triangles or quadrilaterals; was a physical surface named and meshed in 2D?")
    if len(surface) > 1:
        raise MeshError(f"it mixes element types {', '.join(surface)}; use one")
    points = _plane_points(np.asarray(raw.points, dtype=np.float64))
    cells = np.concatenate([block.data for block in raw.cells if block.type == surface[0]]).astype(np.int64)
    _refuse_unknown_nodes(raw, len(points))
    sides = _curved_sides(points, cells, _CORNERS[surface[0]])
    names = {(int(tag), int(dim)): name for name, (tag, dim) in raw.field_data.items()}
    lines = _named(raw, names, _LINES, 1)
    regions = _named(raw, names, (surface[0],), 2)
    pairs = {
        name: np.concatenate([block.data[:, :2] for block in raw.cells if block.type in _LINES])[index].astype(np.int64)
        for name, index in lines.items()
    }
    return points, cells[:, : _CORNERS[surface[0]]], pairs, regions, sides


def _refuse_unknown_nodes(raw: meshio.Mesh, count: int) -> None:
    """The reader gives nodes that the file does not define the number -1, which NumPy takes for the last one."""
    for block in raw.cells:
        if block.type not in _IGNORED and len(block.data) and not (0 <= block.data.min() <= block.data.max() < count):
            raise MeshError(f"an element of type {block.type!r} names a node that the file does not define")


def _plane_points(points: NDArray[np.float64]) -> NDArray[np.float64]:
    if points.shape[1] == 2:
        return points
    spread = np.ptp(points, axis=0)
    if spread[2] > 1e-9 * max(spread[0], spread[1], 1e-300):
        raise MeshError(f"it is not plane: z runs from {points[:, 2].min():.6g} to {points[:, 2].max():.6g}")
    return points[:, :2]


def _curved_sides(points: NDArray[np.float64], cells: IntArray, corners: int) -> tuple[IntArray, NDArray[np.float64]]:
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


def _named(
    raw: meshio.Mesh, names: dict[tuple[int, int], str], types: tuple[str, ...], dimension: int
) -> dict[str, IntArray]:
    """Element numbers, counted over all blocks of the given types, of each physical group of that dimension."""
    blocks = [i for i, block in enumerate(raw.cells) if block.type in types]
    offsets = np.concatenate([[0], np.cumsum([len(raw.cells[i].data) for i in blocks])]).astype(np.int64)
    tags = raw.cell_data.get("gmsh:physical")
    groups: dict[str, IntArray] = {}
    for (tag, dim), name in names.items():
        if dim != dimension:
            continue
        members = []
        for offset, i in zip(offsets, blocks):
            if name in raw.cell_sets and raw.cell_sets[name][i] is not None:
                members.append(offset + np.asarray(raw.cell_sets[name][i], dtype=np.int64))
            elif tags is not None and name not in raw.cell_sets:
                members.append(offset + np.flatnonzero(tags[i] == tag))
        index = np.unique(np.concatenate(members)) if members else np.empty(0, dtype=np.int64)
        if index.size:
            groups[name] = index
    return groups
