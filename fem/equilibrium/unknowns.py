"""Unknowns of a stage: free degrees of freedom, or those and coordinates of rigid bodies; matrices in terms of them."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from granfabric.fem.discretisation.active_part import Elements
from granfabric.fem.discretisation.assembly import TangentAssembler
from granfabric.fem.loads.load_program import StageTerms
from granfabric.fem.loads.ties import Ties
from granfabric.fem.vectors import Array


class Unknowns(Protocol):
    """How unknowns z move the body, and what forces do in their direction."""

    count: int

    def reduce(self, forces: Array) -> Array:
        """Forces, shape (ndofs,), in the direction of the unknowns, shape (count,)."""
        ...

    def add(self, displacement: Array, change: Array) -> None:
        """Move displacements, shape (ndofs,), by a change of the unknowns, in place."""
        ...

    def expand(self, change: Array, out: Array) -> Array:
        """Displacements, shape (ndofs,), of a change of the unknowns; `out` is zero wherever nothing is free."""
        ...

    def of(self, displacement: Array) -> Array:
        """Unknowns, shape (count,), of displacements, shape (ndofs,)."""
        ...

    def tangent(self, space: Elements, springs: csr_matrix | None) -> UnknownsTangent:
        """Assembler of the tangent matrix."""
        ...


def unknowns_of(terms: StageTerms, ndofs: int) -> Unknowns:
    """Unknowns of a stage; what a control leads is none of them."""
    led = -1 if terms.led is None else terms.led.dof
    if terms.ties is not None:
        return TiedUnknowns(terms.ties, led)
    return FreeUnknowns(free_dofs(terms, ndofs))


def free_dofs(terms: StageTerms, ndofs: int) -> NDArray[np.int64]:
    """Degrees of freedom, ascending, that are there and that neither supports prescribe nor a control leads."""
    mask = np.ones(ndofs, dtype=bool) if terms.body is None else terms.body.dofs.copy()
    mask[terms.constrained] = False
    if terms.led is not None and terms.led.dof >= 0:
        mask[terms.led.dof] = False
    return np.flatnonzero(mask)


class FreeUnknowns:
    """Degrees of freedom that nothing prescribes, one by one.

    Parameters
    ----------
    free : ndarray of int, ascending
    """

    def __init__(self, free: NDArray[np.int64]) -> None:
        self.free = free
        self.count = len(free)

    def reduce(self, forces: Array) -> Array:
        """See `Unknowns`."""
        return np.asarray(forces[self.free])

    def add(self, displacement: Array, change: Array) -> None:
        """See `Unknowns`."""
        displacement[self.free] += change

    def expand(self, change: Array, out: Array) -> Array:
        """See `Unknowns`."""
        out[self.free] = change
        return out

    def of(self, displacement: Array) -> Array:
        """See `Unknowns`."""
        return np.asarray(displacement[self.free])

    def tangent(self, space: Elements, springs: csr_matrix | None) -> UnknownsTangent:
        """See `Unknowns`."""
        return UnknownsTangent(space, self.free, springs, None)


class TiedUnknowns:
    """Free degrees of freedom and coordinates of rigid bodies, see `granfabric.fem.loads.ties.Ties`.

    Parameters
    ----------
    ties : Ties
    without : int
        A degree of freedom that is none, because a control leads it; -1 if there is no such one.
    """

    def __init__(self, ties: Ties, without: int = -1) -> None:
        matrix, inverse = ties.matrix, ties.left_inverse
        if without >= 0:
            other = np.flatnonzero(matrix[without].toarray().ravel() == 0.0)
            matrix, inverse = matrix[:, other], inverse[other]
        self._matrix = csr_matrix(matrix)
        self._transposed = csr_matrix(matrix.T)
        self._inverse = csr_matrix(inverse)
        self.count = int(matrix.shape[1])

    def reduce(self, forces: Array) -> Array:
        """See `Unknowns`."""
        return np.asarray(self._transposed @ forces)

    def add(self, displacement: Array, change: Array) -> None:
        """See `Unknowns`."""
        displacement += self._matrix @ change

    def expand(self, change: Array, out: Array) -> Array:
        """See `Unknowns`."""
        out[:] = self._matrix @ change
        return out

    def of(self, displacement: Array) -> Array:
        """See `Unknowns`."""
        return np.asarray(self._inverse @ displacement)

    def tangent(self, space: Elements, springs: csr_matrix | None) -> UnknownsTangent:
        """See `Unknowns`."""
        used = np.flatnonzero(np.diff(self._matrix.indptr))
        return UnknownsTangent(space, used, springs, csr_matrix(self._matrix[used]))


class UnknownsTangent:
    """Tangent matrix in a fixed pattern: of degrees of freedom, with springs added, and transformed if they are tied.

    Parameters
    ----------
    space : Space or ActivePart
    dofs : ndarray of int, ascending
        Degrees of freedom that the unknowns move.
    springs : csr_matrix, shape (ndofs, ndofs), optional
    transformation : csr_matrix, shape (len(dofs), count), optional
        How unknowns move them; one by one if None.

    Attributes
    ----------
    matrix : csr_matrix, shape (count, count)
        Columns ascend, its pattern is symmetric; `assemble` overwrites its values.
    """

    def __init__(
        self,
        space: Elements,
        dofs: NDArray[np.int64],
        springs: csr_matrix | None,
        transformation: csr_matrix | None,
    ) -> None:
        self._assembler = TangentAssembler(space, dofs)
        self._places: NDArray[np.int64] | None = None
        if springs is not None:
            part = csr_matrix(springs[dofs][:, dofs]).tocoo()
            self._places = _places(self._assembler.matrix, part.row, part.col)
            self._stiffness = part.data
        self._values: csr_matrix | None = None
        self.matrix = self._assembler.matrix
        if transformation is not None:
            self.matrix, self._values = _transformed(self._assembler.matrix, transformation)

    def assemble(self, tangent: Array) -> csr_matrix:
        """The matrix of tangents at the points, shape (npt, 3, 3) [Pa]; the same object at each call."""
        matrix = self._assembler.assemble(tangent)
        if self._places is not None:
            matrix.data[self._places] += self._stiffness
        if self._values is not None:
            self.matrix.data[:] = self._values @ matrix.data
        return self.matrix


def _keys(matrix: csr_matrix) -> NDArray[np.int64]:
    """Row and column of each entry in one number, ascending."""
    count = matrix.shape[1]
    rows = np.repeat(np.arange(matrix.shape[0], dtype=np.int64), np.diff(matrix.indptr))
    return rows * count + matrix.indices


def _places(matrix: csr_matrix, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Where entries stand among the values of a matrix that has them all."""
    keys = rows.astype(np.int64) * matrix.shape[1] + columns
    return np.searchsorted(_keys(matrix), keys)


def _transformed(matrix: csr_matrix, transformation: csr_matrix) -> tuple[csr_matrix, csr_matrix]:
    """``T^T K T`` as a pattern, and the matrix that turns the values of K into its values."""
    count = transformation.shape[1]
    width = np.diff(transformation.indptr).astype(np.int64)
    rows = np.repeat(np.arange(matrix.shape[0], dtype=np.int64), np.diff(matrix.indptr))
    columns = matrix.indices.astype(np.int64)
    # each entry K_ij goes to all pairs (a, b) with T_ia and T_jb
    pairs = width[rows] * width[columns]
    entry = np.repeat(np.arange(len(rows)), pairs)
    within = np.arange(len(entry)) - np.repeat(np.cumsum(pairs) - pairs, pairs)
    first, second = np.divmod(within, width[columns][entry])
    left = transformation.indptr[rows[entry]] + first
    right = transformation.indptr[columns[entry]] + second
    key = transformation.indices[left].astype(np.int64) * count + transformation.indices[right]
    weight = transformation.data[left] * transformation.data[right]
    unique, place = np.unique(key, return_inverse=True)
    values = csr_matrix((weight, (place, entry)), shape=(len(unique), len(rows)))
    new_rows, new_columns = np.divmod(unique, max(count, 1))
    pointers = np.concatenate([[0], np.cumsum(np.bincount(new_rows, minlength=count))]).astype(np.int32)
    made = csr_matrix((np.zeros(len(unique)), new_columns.astype(np.int32), pointers), shape=(count, count))
    made.has_sorted_indices = True
    return made, values
