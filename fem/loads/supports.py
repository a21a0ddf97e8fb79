"""Whether every body of a mesh of several is held: one that is not has no unique displacement."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from granfabric.fem.discretisation.space import Space

from .kinds import LoadError
from .load_program import StageTerms

_FREE = 1e-9
"""Stiffness of a rigid motion, relative to the stiffest, below which nothing holds it."""
_MOTIONS = ("move along x", "move along y", "turn")


def bodies_of(space: Space) -> NDArray[np.int64]:
    """Number of the body that each node is in; nodes of one element are in one body."""
    first = np.repeat(space.element_nodes[:, :1], space.element_nodes.shape[1] - 1, axis=1).ravel()
    other = space.element_nodes[:, 1:].ravel()
    graph = coo_matrix((np.ones(len(first)), (first, other)), shape=(space.nnodes, space.nnodes))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def refuse_loose_bodies(space: Space, terms: Sequence[StageTerms]) -> None:
    """See that in each stage each body of a mesh of several is held against moving and turning.

    Raises
    ------
    LoadError
        Naming the stage, the body and the motion that is free.
    """
    body = bodies_of(space)
    count = int(body.max()) + 1
    if count == 1:
        return
    sizes = np.bincount(body)
    middle = np.stack([np.bincount(body, weights=space.nodes[:, axis]) / sizes for axis in (0, 1)], axis=1)
    away = space.nodes - middle[body]
    reach = np.sqrt(np.bincount(body, weights=(away**2).sum(axis=1)) / sizes)
    away = away / reach[body][:, None]
    # how a rigid motion of the body (along x, along y, turn) moves each degree of freedom
    modes = np.zeros((space.ndofs, 3))
    modes[0::2, 0], modes[0::2, 2] = 1.0, -away[:, 1]
    modes[1::2, 1], modes[1::2, 2] = 1.0, away[:, 0]
    for stage in terms:
        held = modes[stage.constrained]
        of_body = body[stage.constrained // 2]
        stiffness = np.zeros((count, 3, 3))
        np.add.at(stiffness, of_body, held[:, :, None] * held[:, None, :])
        values = np.linalg.eigvalsh(stiffness)
        loose = np.flatnonzero(values[:, 0] <= _FREE * np.maximum(values[:, 2], 1.0))
        if loose.size:
            number = int(loose[0])
            free = [motion for k, motion in enumerate(_MOTIONS) if stiffness[number, k, k] <= _FREE]
            motion = " and to ".join(free or [_MOTIONS[2]])  # about another point than its middle
            x, y = space.nodes[np.flatnonzero(body == number)[0]]
            raise LoadError(
                f"stage {stage.stage.name!r}: of the {count} bodies of the mesh the one "
                f"{_regions(space, body, number)} with the node at ({x:.6g}, {y:.6g}) is free to {motion}; hold it by "
                f"fixed, displacement or fixed_point (loose bodies: {loose.size})"
            )


def _regions(space: Space, body: NDArray[np.int64], number: int) -> str:
    cells = body[space.element_nodes[:, 0]] == number
    names = [name for name, index in space.host_mesh.regions.items() if cells[index].any()]
    return f"of region {', '.join(map(repr, names[:3]))}" if names else "in no region"
