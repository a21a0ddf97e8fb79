"""Elements as VTK's cells: in its order of nodes, and those with curved sides cut into straight ones.

VTK finds no place in a curved QUADRATIC_TRIANGLE reliably: it takes the cell for four plane triangles when it looks,
and for the curved one when it interpolates. A cell whose sides are curved is therefore handed over as these four (a
quadrilateral likewise) with the same nodes, so that a probe or a line across the body misses nothing of it. `joined`
puts them together again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.discretisation.parts import Parts
from granfabric.fem.discretisation.space import Space

_TYPES = {"P1": "triangle", "P2": "triangle6", "Q1": "quad", "Q2": "quad9"}
_CUT: dict[str, tuple[str, tuple[tuple[int, ...], ...]]] = {
    "triangle6": ("triangle", ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5))),
    "quad9": ("quad", ((0, 4, 8, 7), (4, 1, 5, 8), (8, 5, 2, 6), (7, 8, 6, 3))),
}
"""Kind and nodes of the pieces of a cell of second order."""
_SIDES = {"triangle6": ((0, 1, 3), (1, 2, 4), (2, 0, 5)), "quad9": ((0, 1, 4), (1, 2, 5), (2, 3, 6), (3, 0, 7))}
"""Ends and middle of the sides."""

STRAIGHT = 1e-9
"""Distance of a side's middle from the middle of its ends, relative to its length, up to which it is straight."""


@dataclass(frozen=True)
class VtkCells:
    """Cells of a file.

    Parameters
    ----------
    blocks : list of (str, ndarray of int)
        As `granfabric.fem.output.vtu.GridWriter` takes them.
    element : ndarray of int32, shape (ncells,)
        Element of each cell; four cells may be of one.
    """

    blocks: list[tuple[str, NDArray[np.int64]]]
    element: NDArray[np.int32]


def whole_cells(space: Space, nodes: Parts) -> tuple[str, NDArray[np.int64]]:
    """Kind and nodes of all elements in VTK's order, nothing cut."""
    return _TYPES[space.element], _counter_clockwise(space, nodes.element_nodes)


def vtk_cells(space: Space, nodes: Parts) -> VtkCells:
    """All elements as cells, those with curved sides cut."""
    kind, cells = whole_cells(space, nodes)
    element = np.arange(len(cells), dtype=np.int32)
    if kind not in _CUT:
        return VtkCells([(kind, cells)], element)
    curved = _curved(space.nodes[nodes.node], kind, cells)
    straight_kind, pieces = _CUT[kind]
    cut = cells[curved][:, np.array(pieces)].reshape(-1, len(pieces[0]))
    both = ((kind, cells[~curved]), (straight_kind, cut))
    return VtkCells(
        [(name, block) for name, block in both if len(block)],
        np.concatenate([element[~curved], np.repeat(element[curved], len(pieces))]),
    )


def _curved(nodes: NDArray[np.float64], kind: str, cells: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which cells of second order have a side that is not straight with its node in the middle."""
    found = np.zeros(len(cells), dtype=bool)
    for start, end, middle in _SIDES[kind]:
        a, b, m = nodes[cells[:, start]], nodes[cells[:, end]], nodes[cells[:, middle]]
        found |= np.linalg.norm(m - (a + b) / 2, axis=1) > STRAIGHT * np.linalg.norm(b - a, axis=1)
    return found


def joined(blocks: Sequence[Any], element: Sequence[NDArray] | None) -> tuple[str, NDArray[np.int64]]:
    """Kind and nodes of the elements of a file, with those that were cut as they were.

    Parameters
    ----------
    blocks : sequence
        Blocks of cells with attributes `type` and `data`, as meshio reads them.
    element : sequence of ndarray of int, optional
        Element of each cell, by block; not in files in which nothing is cut.

    Raises
    ------
    ValueError
        If the cells are not those of elements of one kind.
    """
    whole = {name: cut for name, (cut, _) in _CUT.items()}
    found: list[NDArray[np.int64]] = []
    places: list[NDArray] = []
    kinds: set[str] = set()
    for number, block in enumerate(blocks):
        data, kind = np.asarray(block.data, dtype=np.int64), str(block.type)
        place = np.arange(len(data)) if element is None else np.asarray(element[number])
        if len(data) > 1 and len(data) % 4 == 0 and (place[0::4] == place[3::4]).all():
            kind = next((name for name, cut in whole.items() if cut == kind), kind)
            data, place = _whole(kind, data), place[::4]
        kinds.add(kind)
        found.append(data)
        places.append(place)
    if len(kinds) != 1:
        raise ValueError("its cells are not of one kind")
    return kinds.pop(), np.concatenate(found)[np.argsort(np.concatenate(places), kind="stable")]


def _whole(kind: str, pieces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Nodes of the elements that were cut into these."""
    order = _CUT[kind][1]
    parts = pieces.reshape(-1, len(order), len(order[0]))
    cells = np.empty((len(parts), 1 + max(map(max, order))), dtype=np.int64)
    for piece, nodes in enumerate(order):
        for place, node in enumerate(nodes):
            cells[:, node] = parts[:, piece, place]
    return cells


def _counter_clockwise(space: Space, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Element nodes in VTK's order; scikit-fem sorts the corners of triangles, which turns some of them."""
    if space.host_mesh.cell == "quad":
        return nodes
    corner = space.nodes[space.element_nodes[:, :3]]
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    turned = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] < 0
    order = [0, 2, 1] if space.order == 1 else [0, 2, 1, 5, 4, 3]
    result = nodes.copy()
    result[turned] = nodes[turned][:, order]
    return result
