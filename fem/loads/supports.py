"""Whether every body of a mesh is held: one that is not has no unique displacement."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

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


def bodies_of(space: Space, active: NDArray[np.bool_] | None = None) -> NDArray[np.int64]:
    """Number of the body that each node is in; nodes of one element are in one body.

    Parameters
    ----------
    space : Space
    active : ndarray of bool, shape (nelem,), optional
        Elements that are there; nodes of no such element are in no body, -1.
    """
    elements = space.element_nodes if active is None else space.element_nodes[active]
    first = np.repeat(elements[:, :1], elements.shape[1] - 1, axis=1).ravel()
    other = elements[:, 1:].ravel()
    graph = coo_matrix((np.ones(len(first)), (first, other)), shape=(space.nnodes, space.nnodes))
    body = connected_components(graph, directed=False)[1].astype(np.int64)
    if active is None:
        return body
    there = np.zeros(space.nnodes, dtype=bool)
    there[elements] = True
    numbered = np.full(space.nnodes, -1, dtype=np.int64)
    numbered[there] = np.unique(body[there], return_inverse=True)[1]
    return numbered


def refuse_loose_bodies(space: Space, terms: Sequence[StageTerms]) -> None:
    """See that in each stage each of several bodies is held against moving and turning.

    A single body may be free, in balance under its loads (see `free_motions`); where it was held at the outset, what
    stages take away may not leave it free.

    Raises
    ------
    LoadError
        Naming the stage, the body and the motion that is free.
    """
    whole = next((not free for _, _, free in _loose(space, terms[:1])), False)  # and held at the outset
    for stage, body, loose in _loose(space, terms):
        count = int(body.max()) + 1
        if loose and count == 1 and whole and (body < 0).any():
            raise LoadError(
                f"stage {stage!r}: what is left of the body is free to {loose[0][1]}; hold it by fixed, displacement "
                "or fixed_point, or leave the ground that held it"
            )
        if count > 1 and loose:
            number, free = loose[0]
            x, y = space.nodes[np.flatnonzero(body == number)[0]]
            raise LoadError(
                f"stage {stage!r}: of the {count} bodies of the mesh the one "
                f"{_regions(space, body, number)} with the node at ({x:.6g}, {y:.6g}) is free to {free}; hold it by "
                f"fixed, displacement or fixed_point (loose bodies: {len(loose)})"
            )


def free_motions(space: Space, terms: Sequence[StageTerms]) -> list[str]:
    """Rigid motions of a single body that no support prevents, stage by stage; "" where it is held.

    Such a body is in equilibrium at most under loads that balance each other, and has no unique displacement.
    """
    return [loose[0][1] if loose else "" for _, _, loose in _loose(space, terms)]


_Loose = list[tuple[int, str]]


def _loose(space: Space, terms: Sequence[StageTerms]) -> Iterator[tuple[str, NDArray[np.int64], _Loose]]:
    """Name of each stage, the body of each node, and the bodies that are not held with the motions that are free."""
    body, modes = np.empty(0, dtype=np.int64), np.empty((0, 3))
    for number, stage in enumerate(terms):
        if number == 0 or (stage.body is not None and stage.body.changes):
            body = bodies_of(space, None if stage.body is None else stage.body.active)
            modes = _rigid_motions(space, body)
        yield stage.stage.name, body, _free(stage, body, modes)


def _rigid_motions(space: Space, body: NDArray[np.int64]) -> NDArray[np.float64]:
    """How a rigid motion of its body (along x, along y, turn) moves each degree of freedom, shape (ndofs, 3)."""
    there = body >= 0
    own, nodes = body[there], space.nodes[there]
    sizes = np.bincount(own)
    middle = np.stack([np.bincount(own, weights=nodes[:, axis]) / sizes for axis in (0, 1)], axis=1)
    away = np.zeros_like(space.nodes)
    away[there] = nodes - middle[own]
    reach = np.sqrt(np.bincount(own, weights=(away[there] ** 2).sum(axis=1)) / sizes)
    away[there] /= reach[own][:, None]
    modes = np.zeros((space.ndofs, 3))
    modes[0::2, 0], modes[0::2, 2] = 1.0, -away[:, 1]
    modes[1::2, 1], modes[1::2, 2] = 1.0, away[:, 0]
    return modes


def _free(stage: StageTerms, body: NDArray[np.int64], modes: NDArray[np.float64]) -> _Loose:
    count = int(body.max()) + 1
    held = modes[stage.constrained]
    of_body = body[stage.constrained // 2]
    stiffness = np.zeros((count, 3, 3))
    np.add.at(stiffness, of_body, held[:, :, None] * held[:, None, :])
    _add_ties(stiffness, stage, modes, body)
    _add_springs(stiffness, stage, modes, body)
    values = np.linalg.eigvalsh(stiffness)
    found = []
    for number in np.flatnonzero(values[:, 0] <= _FREE * np.maximum(values[:, 2], 1.0)).tolist():
        free = [motion for k, motion in enumerate(_MOTIONS) if stiffness[number, k, k] <= _FREE]
        found.append((number, " and to ".join(free or [_MOTIONS[2]])))  # about another point than its middle
    return found


def _add_ties(stiffness: NDArray[np.float64], stage: StageTerms, modes: NDArray[np.float64], body: NDArray) -> None:
    """What rigid bodies do not let move: all but their own free motions."""
    if stage.ties is None:
        return
    for motion in stage.ties.motions:
        contact = motion.tie.contact
        for number in np.unique(body[contact.nodes]).tolist():
            mine = body[contact.nodes] == number
            moves = modes[contact.dofs].reshape(-1, 2, 3)
            if contact.normal is not None:
                moves = contact.normal[:, :, None] * np.einsum("ni,nik->nk", contact.normal, moves)[:, None]
            rest = moves[mine].reshape(-1, 3)
            if motion.free.shape[1]:
                free = np.stack([contact.displaced(direction) for direction in motion.free.T], axis=-1)
                follows = free[mine].reshape(-1, free.shape[2])
                rest = rest - follows @ (np.linalg.pinv(follows) @ rest)
            stiffness[number] += rest.T @ rest


def _add_springs(stiffness: NDArray[np.float64], stage: StageTerms, modes: NDArray[np.float64], body: NDArray) -> None:
    for _, matrix in stage.springs:
        scaled = matrix / abs(matrix).max()
        for number in np.unique(body[np.unique(matrix.indices) // 2]).tolist():
            mine = np.where((np.repeat(body, 2) == number)[:, None], modes, 0.0)
            stiffness[number] += mine.T @ (scaled @ mine)


def _regions(space: Space, body: NDArray[np.int64], number: int) -> str:
    cells = body[space.element_nodes[:, 0]] == number
    names = [name for name, index in space.host_mesh.regions.items() if cells[index].any()]
    return f"of region {', '.join(map(repr, names[:3]))}" if names else "in no region"
