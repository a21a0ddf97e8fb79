"""Degrees of freedom whose values every rank knows: the few on boundaries that rigid bodies or springs tie together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .distribution import Distribution

Array = NDArray[np.float64]


class SharedDofs:
    """Some degrees of freedom of all ranks; every call is made by all ranks together.

    Parameters
    ----------
    distribution : Distribution
    dofs : ndarray of int, shape (m,)
        Numbers on rank 0, the same on all ranks.

    Attributes
    ----------
    places : ndarray of int
        Which of them this rank owns.
    local : ndarray of int
        Numbers of these among the degrees of freedom that it owns.
    """

    def __init__(self, distribution: Distribution, dofs: NDArray[np.int64]) -> None:
        self._comm = distribution.comm
        self.count = len(dofs)
        self._ndofs = distribution.ndofs
        own, order = distribution.node_numbers, np.argsort(distribution.node_numbers)
        nodes, component = np.divmod(np.asarray(dofs, dtype=np.int64), 2)
        found = np.searchsorted(own[order], nodes)
        here = found < len(own)
        here[here] = own[order[found[here]]] == nodes[here]
        self.places = np.flatnonzero(here)
        self.local = 2 * order[found[here]] + component[here]

    def of(self, vector: Array) -> Array:
        """Their values, shape (m,), in a vector of which each rank has the part that it owns, shape (ndofs,)."""
        return self.told(self.places, vector[self.local], self.count)

    def own(self, values: Array) -> Array:
        """A vector, shape (ndofs,), with this rank's part of such values; zero elsewhere."""
        vector = np.zeros(self._ndofs)
        vector[self.local] = values[self.places]
        return vector

    def told(self, places: NDArray[np.int64], values: Array, count: int) -> Array:
        """An array of a length on all ranks, of which each gives some places; no place is given by two."""
        given, told = np.zeros(count), np.empty(count)
        given[places] = values
        self._comm.Allreduce(given, told)
        return told
