"""Unknowns of a stage in which rigid bodies tie degrees of freedom: a transformation, exact and symmetric.

Displacements are ``u = u_0 + w + T z``: w is what is prescribed, z holds the free degrees of freedom of the nodes and
the free coordinates of the bodies. Equilibrium is ``T^T (external - internal) = 0``, its tangent ``T^T K T``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from granfabric.fem.vectors import Array

from .amplitude import RAMP, Amplitude
from .checks import COMPONENTS, LoadError
from .rigid import MOTIONS, SAME, UNFELT, Contact

# Components of a unit motion below this are rounding.
ROUNDING = 1e-13


@dataclass(frozen=True)
class Tie:
    """A rigid body in one stage; its coordinates are those of its point, and the rotation times the arm.

    Parameters
    ----------
    contact : Contact
    prescribed : tuple of bool
        Which of its three coordinates are.
    target : ndarray, shape (3,)
        Of these at the end of the stage [m]; nan where they stay.
    amplitude : Amplitude
    led : int
        Coordinate that a control leads; -1 if none.
    """

    contact: Contact
    prescribed: tuple[bool, bool, bool]
    target: Array
    amplitude: Amplitude = RAMP
    led: int = -1


@dataclass(frozen=True)
class _Motion:
    """What is prescribed of a body's coordinates q: ``rows q = values``; the rest is ``free z``."""

    tie: Tie
    rows: Array  # (m, 3)
    own: list[int]  # coordinate that a row is of; -1 where a support is the reason
    supports: NDArray[np.int64]  # place among the constrained degrees of freedom; -1 where it is the body's own
    inverse: Array  # (3, m)
    free: Array  # (3, k)


@dataclass(frozen=True)
class Ties:
    """All rigid bodies of a stage with its supports.

    Parameters
    ----------
    constrained : ndarray of int
        Degrees of freedom that supports prescribe, ascending.
    ties : sequence of Tie
    there : ndarray of bool, shape (ndofs,), optional
        Degrees of freedom that are there at all, where stages change the body; the boundaries' are.

    Raises
    ------
    LoadError
        If bodies share a node, or a support holds a node of a smooth body along neither of its directions.
    """

    ndofs: int
    constrained: NDArray[np.int64]
    ties: Sequence[Tie]
    there: NDArray[np.bool_] | None = None
    matrix: csr_matrix = field(init=False)
    """T, shape (ndofs, n)."""
    left_inverse: csr_matrix = field(init=False)
    """Unknowns of displacements that fit, shape (n, ndofs)."""
    motions: list[_Motion] = field(init=False)

    def __post_init__(self) -> None:
        place = np.full(self.ndofs, -1, dtype=np.int64)
        place[self.constrained] = np.arange(len(self.constrained))
        single = np.ones(self.ndofs, dtype=bool) if self.there is None else self.there.copy()
        single[self.constrained] = False
        columns: list[tuple[NDArray[np.int64], Array, Array]] = []  # dofs, what the unknown moves, what finds it
        motions = []
        taken: dict[int, str] = {}
        for tie in self.ties:
            contact = tie.contact
            for node in contact.nodes.tolist():
                if node in taken:
                    raise LoadError(
                        f"the rigid bodies on boundaries {taken[node]!r} and {contact.body.boundary!r} share a node"
                    )
                taken[node] = contact.body.boundary
            motion = _motion(tie, place)
            motions.append(motion)
            if contact.normal is None:
                single[contact.dofs] = False
            else:
                for node, (nx, ny) in zip(contact.nodes.tolist(), contact.normal.tolist()):
                    pair = np.array([2 * node, 2 * node + 1])
                    if min(abs(nx), abs(ny)) <= SAME:  # along one of the axes: the other component stays as it is
                        single[pair[0 if abs(nx) > abs(ny) else 1]] = False
                        continue
                    single[pair] = False
                    along = np.array([-ny, nx])
                    columns.append((pair, along, along))
            finder = np.linalg.pinv(contact.felt, rcond=UNFELT)  # (3, m)
            if contact.normal is not None:
                finder = np.einsum("kn,ni->kni", finder, contact.normal).reshape(3, -1)
            for direction in motion.free.T:
                columns.append((contact.dofs, contact.displaced(direction).ravel(), direction @ finder))
        lone = np.flatnonzero(single)
        count = len(lone)
        rows = np.concatenate([lone, *(dofs for dofs, _, _ in columns)])
        numbers = np.concatenate([np.arange(count), *(np.full(len(c[0]), count + k) for k, c in enumerate(columns))])
        shape = (self.ndofs, count + len(columns))
        ones = np.ones(count)
        matrix = csr_matrix((np.concatenate([ones, *(c[1] for c in columns)]), (rows, numbers)), shape=shape)
        matrix.data[np.abs(matrix.data) <= ROUNDING] = 0.0
        matrix.eliminate_zeros()
        inverse = csr_matrix((np.concatenate([ones, *(c[2] for c in columns)]), (numbers, rows)), shape=shape[::-1])
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "left_inverse", inverse)
        object.__setattr__(self, "motions", motions)

    @property
    def dofs(self) -> NDArray[np.int64]:
        """Degrees of freedom that follow bodies, ascending."""
        return np.unique(np.concatenate([tie.contact.tied_dofs for tie in self.ties]))

    def carried(self, start: Array, moved: Array, factor: Callable[[Amplitude], float]) -> Array:
        """What the prescribed coordinates of the bodies move since the start of the stage, shape (ndofs,) [m].

        Parameters
        ----------
        start : ndarray, shape (ndofs,)
            Displacements there.
        moved : ndarray, shape (nconstrained,)
            Change of the supports' displacements since then.
        factor : callable
            Of an amplitude, where the stage is.
        """
        carried = np.zeros(self.ndofs)
        for motion in self.motions:
            tie = motion.tie
            if not len(motion.rows):
                continue
            here = tie.contact.at_point(start)
            change = factor(tie.amplitude) * np.where(np.isnan(tie.target), 0.0, tie.target - here)
            values = np.array(
                [change[own] if own >= 0 else moved[support] for own, support in zip(motion.own, motion.supports)]
            )
            carried[tie.contact.dofs] += tie.contact.displaced(motion.inverse @ values).ravel()
        carried[self.constrained] = 0.0
        return carried

    def lead(self, number: int) -> Array:
        """Displacements, shape (ndofs,), when the led coordinate of a tie grows by one."""
        motion = self.motions[number]
        unit = np.array([float(own == motion.tie.led) for own in motion.own])
        direction = np.zeros(self.ndofs)
        direction[motion.tie.contact.dofs] = motion.tie.contact.displaced(motion.inverse @ unit).ravel()
        direction[self.constrained] = 0.0
        return direction

    def faded(self, imbalance: Array) -> Array:
        """Of forces at the bodies' nodes, shape (ndofs,), what their free coordinates feel."""
        felt = np.zeros(self.ndofs)
        for motion in self.motions:
            contact = motion.tie.contact
            felt += contact.spread(motion.free @ (motion.free.T @ contact.generalised(imbalance)))
        felt[self.constrained] = 0.0
        return felt


def _motion(tie: Tie, place: NDArray[np.int64]) -> _Motion:
    contact = tie.contact
    rows, own, supports = [], [], []
    for coordinate in range(3):
        if tie.prescribed[coordinate] or coordinate == tie.led:
            rows.append(contact.point_coordinates[coordinate])
            own.append(coordinate)
            supports.append(-1)
    boundary = contact.body.boundary
    for number, node in enumerate(contact.nodes.tolist()):
        for axis in (0, 1):
            held = int(place[2 * node + axis])
            if held < 0:
                continue
            if contact.normal is not None:
                across = abs(contact.normal[number, axis])
                if across <= SAME:
                    continue  # along the boundary, where a smooth body does not hold
                if across < 1.0 - SAME:
                    raise LoadError(
                        f"component {COMPONENTS[axis]} of a node of boundary {boundary!r} is held by a support, but "
                        "the smooth rigid body on it moves the node along a slant; let the support end before the "
                        "body, or take a rough body"
                    )
            rows.append(contact.modes[number, axis])
            own.append(-1)
            supports.append(held)
    matrix = np.array(rows).reshape(-1, 3)
    inverse = np.linalg.pinv(matrix, rcond=SAME) if len(rows) else np.zeros((3, 0))
    if tie.led >= 0:
        others = np.delete(matrix, own.index(tie.led), axis=0)
        if np.linalg.matrix_rank(matrix, SAME) == np.linalg.matrix_rank(others, SAME):
            raise LoadError(
                f"the control leads the {MOTIONS[tie.led]} of the rigid body on boundary {boundary!r}, which is "
                "prescribed or held by supports"
            )
    _, sizes, directions = np.linalg.svd(matrix) if len(rows) else (None, np.zeros(0), np.eye(3))
    rank = int((sizes > SAME).sum())
    free = directions[rank:].T
    if free.shape[1]:  # what the boundary does not feel is no unknown
        _, sizes, mixed = np.linalg.svd(contact.felt @ free, full_matrices=False)
        free = free @ mixed[sizes > UNFELT * np.sqrt(len(contact.felt))].T
    return _Motion(tie, matrix, own, np.array(supports, dtype=np.int64), inverse, free)


def check_motions(ties: Ties, moved: Array, start: Array, label: str) -> None:
    """Refuse supports that tell a body two motions.

    Parameters
    ----------
    ties : Ties
    moved : ndarray, shape (nconstrained,)
        Change of the supports' displacements over the stage; nan where it is not known.
    start : ndarray, shape (ndofs,)
        Displacements at the start of the stage; nan where they are not known.

    Raises
    ------
    LoadError
    """
    for motion in ties.motions:
        tie = motion.tie
        if len(motion.rows) <= 1:
            continue
        known = np.isfinite(start[tie.contact.dofs]).all()
        here = tie.contact.at_point(start) if known else np.full(3, np.nan)
        change = np.where(np.isnan(tie.target), 0.0, tie.target - here)
        values = np.array(
            [
                0.0 if own == tie.led >= 0 else change[own] if own >= 0 else moved[support]
                for own, support in zip(motion.own, motion.supports)
            ]
        )
        sure = np.isfinite(values)
        if sure.sum() <= 1:
            continue
        rows, values = motion.rows[sure], values[sure]
        fit = np.linalg.pinv(rows, rcond=SAME) @ values
        if np.abs(rows @ fit - values).max() > 1e-9 * np.abs(values).max(initial=0.0):
            raise LoadError(
                f"{label}: supports and the prescribed motion of the rigid body on boundary "
                f"{tie.contact.body.boundary!r} contradict each other: no rigid motion meets both"
            )
