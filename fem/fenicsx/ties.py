"""Rigid bodies whose boundaries' nodes several ranks own, and the unknowns of a stage with such bodies.

The boundaries' degrees of freedom are few. Every rank knows their values and does the same with them as the own host;
then each takes what it owns.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from granfabric.fem.loads.amplitude import Amplitude
from granfabric.fem.loads.rigid import Contact
from granfabric.fem.loads.ties import Tie, Ties

from .distribution import Distribution
from .shared import SharedDofs

Array = NDArray[np.float64]


class DistributedContact:
    """What `Contact` is for the own host, on vectors of which each rank has the part that it owns.

    Parameters
    ----------
    shared : SharedDofs
        Those on the boundaries of all bodies of the stage.
    whole : Contact
        In their numbers.
    """

    def __init__(self, shared: SharedDofs, whole: Contact) -> None:
        self._shared = shared
        self._whole = whole
        self.body = whole.body
        self.arm = whole.arm

    def at_point(self, displacement: Array) -> Array:
        """See `Contact.at_point`."""
        return self._whole.at_point(self._shared.of(displacement))

    def take_out(self, forces: Array) -> None:
        """See `Contact.take_out`."""
        whole = self._shared.of(forces)
        self._whole.take_out(whole)
        forces[self._shared.local] = whole[self._shared.places]


class DistributedTies:
    """What `Ties` is for the own host.

    Parameters
    ----------
    shared : SharedDofs
    whole : Ties
        Of these degrees of freedom alone.
    constrained : ndarray of int
        Degrees of freedom of this rank that supports prescribe.

    Attributes
    ----------
    ties : list of Tie
    dofs : ndarray of int
        Degrees of freedom of this rank that follow bodies, ascending.
    """

    def __init__(self, shared: SharedDofs, whole: Ties, constrained: NDArray[np.int64]) -> None:
        self.shared = shared
        self.whole = whole
        self._constrained = constrained
        contacts: list[Any] = [DistributedContact(shared, tie.contact) for tie in whole.ties]
        self.ties: list[Tie] = [replace(tie, contact=contact) for tie, contact in zip(whole.ties, contacts)]
        self.dofs = np.sort(shared.local[np.isin(shared.places, whole.dofs)])

    def same(self, other: DistributedTies) -> bool:
        """Whether the same nodes follow in the same way."""
        ours, theirs = self.whole.matrix, other.whole.matrix
        alike = ours.shape == theirs.shape and abs(ours - theirs).nnz == 0
        return alike and np.array_equal(self.shared.local, other.shared.local)

    def carried(self, start: Array, moved: Array, factor: Callable[[Amplitude], float]) -> Array:
        """See `Ties.carried`."""
        told = np.zeros_like(start)
        told[self._constrained] = moved
        moved = self.shared.of(told)[self.whole.constrained]
        return self.shared.own(self.whole.carried(self.shared.of(start), moved, factor))

    def lead(self, number: int) -> Array:
        """See `Ties.lead`."""
        return self.shared.own(self.whole.lead(number))

    def faded(self, imbalance: Array) -> Array:
        """See `Ties.faded`."""
        return self.shared.own(self.whole.faded(self.shared.of(imbalance)))


def spread_ties(
    distribution: Distribution, whole: Ties | None, constrained: NDArray[np.int64]
) -> DistributedTies | None:
    """The rigid bodies of a stage, from what rank 0 knows of them; None if there are none."""
    told = distribution.comm.bcast(None if whole is None else _of_boundaries(whole), root=0)
    if told is None:
        return None
    dofs, ties = told
    return DistributedTies(SharedDofs(distribution, dofs), ties, constrained)


def _of_boundaries(ties: Ties) -> tuple[NDArray[np.int64], Ties]:
    """Degrees of freedom on the boundaries of the bodies, and the same ties in terms of these."""
    nodes = np.unique(np.concatenate([tie.contact.nodes for tie in ties.ties]))
    dofs = np.stack([2 * nodes, 2 * nodes + 1], axis=1).ravel()
    made = []
    for tie in ties.ties:
        contact = copy(tie.contact)
        contact.nodes = np.searchsorted(nodes, contact.nodes)
        contact.space_ndofs = len(dofs)
        made.append(replace(tie, contact=contact))
    return dofs, Ties(len(dofs), np.flatnonzero(np.isin(dofs, ties.constrained)), made)


class DistributedUnknowns:
    """What `granfabric.fem.equilibrium.unknowns.TiedUnknowns` is for the own host.

    A coordinate of a body belongs to the rank that owns the first of its nodes.

    Parameters
    ----------
    free : ndarray of int
        Degrees of freedom of this rank that are there and nothing prescribes; those that follow bodies are taken out.
    ties : DistributedTies
    """

    def __init__(self, free: NDArray[np.int64], ties: DistributedTies) -> None:
        shared = self._shared = ties.shared
        self._free = np.setdiff1d(free, shared.local)
        self._matrix = csr_matrix(ties.whole.matrix)
        self._transposed = csr_matrix(ties.whole.matrix.T)
        self._inverse = csr_matrix(ties.whole.left_inverse)
        first = self._transposed.indices[self._transposed.indptr[:-1]]
        self._mine = np.flatnonzero(np.isin(first, shared.places))
        self.count = len(self._free) + len(self._mine)

    def _told(self, change: Array) -> Array:
        """All unknowns of the boundaries."""
        return self._shared.told(self._mine, change[len(self._free) :], self._matrix.shape[1])

    def reduce(self, forces: Array) -> Array:
        """See `Unknowns`."""
        of_boundaries = self._transposed @ self._shared.of(forces)
        return np.concatenate([forces[self._free], of_boundaries[self._mine]])

    def add(self, displacement: Array, change: Array) -> None:
        """See `Unknowns`."""
        displacement[self._free] += change[: len(self._free)]
        displacement += self._shared.own(self._matrix @ self._told(change))

    def expand(self, change: Array, out: Array) -> Array:
        """See `Unknowns`."""
        out[:] = 0.0
        self.add(out, change)
        return out

    def of(self, displacement: Array) -> Array:
        """See `Unknowns`."""
        of_boundaries = self._inverse @ self._shared.of(displacement)
        return np.concatenate([displacement[self._free], of_boundaries[self._mine]])

    def tangent(self, space: Any, springs: Any) -> Any:
        """The matrix is made by PETSc, see `transformation`."""
        raise NotImplementedError

    def transformation(self, comm: Any, petsc: Any, ndofs: int) -> Any:
        """How unknowns move the degrees of freedom, a matrix of PETSc of which each rank has its rows."""
        first = int(comm.exscan(self.count) or 0)
        count, places = len(self._free), self._shared.places
        own = (first + count + np.arange(len(self._mine))).astype(np.float64)
        number = self._shared.told(self._mine, own, self._matrix.shape[1]).astype(np.int64)
        part = csr_matrix(self._matrix[places]).tocoo()
        rows = np.concatenate([self._free, self._shared.local[part.row]])
        columns = np.concatenate([first + np.arange(count), number[part.col]])
        values = np.concatenate([np.ones(count), part.data])
        total = int(comm.allreduce(self.count))
        made = csr_matrix((values, (rows, columns)), shape=(ndofs, total))
        kind = petsc.IntType
        sizes = ((ndofs, None), (self.count, None))
        arrays = (made.indptr.astype(kind), made.indices.astype(kind), made.data)
        matrix = petsc.Mat().createAIJ(sizes, csr=arrays, comm=comm)
        matrix.assemble()
        return matrix
