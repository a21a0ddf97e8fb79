"""The pieces of a step as one mesh again, in the order of a file that was written in one piece."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import meshio
import numpy as np
from numpy.typing import NDArray

NODE = "node"
"""Field of the points of a piece: which node of the whole each is."""


def merged(pieces: Sequence[Any]) -> meshio.Mesh:
    """One mesh of several, as meshio reads them.

    Nodes that several pieces have become one, unless materials meet there; elements are in their own order.

    Parameters
    ----------
    pieces : sequence of meshio.Mesh
        At least one.

    Raises
    ------
    ValueError
        If they do not belong together.
    """
    try:
        return _merged(pieces)
    except (KeyError, IndexError, TypeError) as error:
        raise ValueError(f"its pieces do not belong together ({error!r})") from error


def _merged(pieces: Sequence[Any]) -> meshio.Mesh:
    fields = _common([piece.point_data for piece in pieces])
    if NODE not in fields:
        order = np.argsort(np.concatenate([piece.point_data["element"] for piece in pieces]), kind="stable")
        points = np.concatenate([piece.points for piece in pieces])[order]
        data = {name: np.concatenate([piece.point_data[name] for piece in pieces])[order] for name in fields}
        return meshio.Mesh(points, [("vertex", np.arange(len(points)).reshape(-1, 1))], data)
    place = _places(pieces)
    starts = np.cumsum([0, *(len(piece.points) for piece in pieces)])
    count = int(place.max()) + 1

    def at_nodes(values: Sequence[NDArray]) -> NDArray:
        found = np.empty((count, *values[0].shape[1:]), dtype=values[0].dtype)
        found[place] = np.concatenate(values)
        return found

    points = at_nodes([piece.points for piece in pieces])
    data = {name: at_nodes([piece.point_data[name] for piece in pieces]) for name in fields if name != NODE}
    kinds = list(dict.fromkeys(block.type for piece in pieces for block in piece.cells))
    kinds.sort(key=lambda kind: kind in ("triangle", "quad"))  # of second order first, as in one piece
    of_cells = _common([piece.cell_data for piece in pieces])
    cells, cell_data = [], {name: [] for name in of_cells}  # type: ignore[var-annotated]
    for kind in kinds:
        found = [
            (place[starts[number] + block.data], {name: piece.cell_data[name][row] for name in of_cells})
            for number, piece in enumerate(pieces)
            for row, block in enumerate(piece.cells)
            if block.type == kind
        ]
        order = np.argsort(np.concatenate([values["element"] for _, values in found]), kind="stable")
        cells.append((kind, np.concatenate([block for block, _ in found])[order]))
        for name in of_cells:
            cell_data[name].append(np.concatenate([values[name] for _, values in found])[order])
    return meshio.Mesh(points, cells, data, cell_data)


def _common(given: Sequence[dict[str, Any]]) -> list[str]:
    names = list(given[0])
    if any(set(each) != set(names) for each in given):
        raise ValueError("its pieces do not hold the same fields")
    return names


def _places(pieces: Sequence[Any]) -> NDArray[np.int64]:
    """Number in the whole of each point of all pieces: nodes ascending, then those that further materials have."""
    materials = []
    for piece in pieces:
        material = np.zeros(len(piece.points), dtype=np.int64)
        for block, of_block in zip(piece.cells, piece.cell_data["material"]):
            material[block.data] = np.asarray(of_block)[:, None]
        materials.append(material)
    node = np.concatenate([np.asarray(piece.point_data[NODE], dtype=np.int64) for piece in pieces])
    material = np.concatenate(materials)
    pairs, place = np.unique(node * (material.max() + 1) + material, return_inverse=True)
    of_pair = pairs // (material.max() + 1)
    further = np.concatenate([[False], of_pair[1:] == of_pair[:-1]])
    number = np.empty(len(pairs), dtype=np.int64)
    number[~further] = np.arange(np.count_nonzero(~further))
    number[further] = np.count_nonzero(~further) + np.arange(np.count_nonzero(further))
    return number[place.ravel()]
