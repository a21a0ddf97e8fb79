"""Internal forces and tangent matrix of a space, into buffers and a sparsity pattern that are made once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from .kernels import (
    element_action_kernel,
    element_force_kernel,
    element_tangent_kernel,
    gather_force_kernel,
    gather_tangent_kernel,
    strain_kernel,
)
from .space import Space

Array = NDArray[np.float64]


class ForceAssembler:
    """Strains and internal forces; no allocation per call.

    Parameters
    ----------
    space : Space
    """

    def __init__(self, space: Space) -> None:
        self.space = space
        nelem, nb = space.element_nodes.shape
        self._local = np.empty((nelem, nb, 2))
        self._flat = self._local.reshape(-1, 2)
        flat_nodes = space.element_nodes.ravel()
        self._source = np.argsort(flat_nodes, kind="stable").astype(np.int32)
        counts = np.bincount(flat_nodes, minlength=space.nnodes)
        self._start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        self.magnitude = np.empty(space.ndofs)

    def strain(self, displacement: Array, out: Array) -> Array:
        """Strain at the points of nodal displacements.

        Parameters
        ----------
        displacement : ndarray, shape (ndofs,)
            [m].
        out : ndarray, shape (npt, 3)
            Receives xx, yy, engineering xy; tension positive.
        """
        space = self.space
        strain_kernel(space.gradients, space.element_nodes, space.points_per_cell, displacement, out)
        return out

    def internal_force(self, stress: Array, out: Array) -> Array:
        """``int B^T sigma dV``; also sets `magnitude`, the nodal sums of the element forces' absolute values.

        Parameters
        ----------
        stress : ndarray, shape (npt, 3)
            Tension positive [Pa].
        out : ndarray, shape (ndofs,)
            Receives the forces that the stress exerts against the nodes [N/m].
        """
        space = self.space
        element_force_kernel(space.gradients, space.weights, space.points_per_cell, stress, self._local)
        gather_force_kernel(self._start, self._source, self._flat, out, self.magnitude)
        return out

    def tangent_times(self, tangent: Array, displacement: Array, out: Array) -> Array:
        """``int B^T D B u dV`` without the matrix, for all degrees of freedom; leaves `magnitude` of that product.

        Parameters
        ----------
        tangent : ndarray, shape (npt, 3, 3)
            [Pa].
        displacement : ndarray, shape (ndofs,)
        out : ndarray, shape (ndofs,)
        """
        space = self.space
        element_action_kernel(
            space.gradients,
            space.weights,
            space.element_nodes,
            space.points_per_cell,
            tangent,
            displacement,
            self._local,
        )
        gather_force_kernel(self._start, self._source, self._flat, out, self.magnitude)
        return out


class TangentAssembler:
    """Tangent matrix of the free degrees of freedom in a fixed compressed-row pattern.

    Parameters
    ----------
    space : Space
    free : ndarray of int
        Degrees of freedom that are rows and columns of the matrix, ascending.

    Attributes
    ----------
    matrix : scipy.sparse.csr_matrix, shape (nfree, nfree)
        Column indices ascend; its pattern is symmetric. `assemble` overwrites its values.
    """

    def __init__(self, space: Space, free: NDArray[np.int64]) -> None:
        self.space = space
        self.free = np.asarray(free, dtype=np.int64)
        nfree = len(self.free)
        nelem, nb = space.element_nodes.shape
        number = np.full(space.ndofs, -1, dtype=np.int64)
        number[self.free] = np.arange(nfree)
        dofs = np.stack([2 * space.element_nodes, 2 * space.element_nodes + 1], axis=2).reshape(nelem, 2 * nb)
        local = number[dofs]
        key = local[:, :, None] * nfree + local[:, None, :]
        kept = (local[:, :, None] >= 0) & (local[:, None, :] >= 0)
        position = np.flatnonzero(kept)
        key = key.ravel()[position]
        order = np.argsort(key, kind="stable")
        key = key[order]
        first = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]])) if key.size else np.empty(0, np.int64)
        self._source = position[order].astype(np.int32)
        self._start = np.concatenate([first, [len(key)]]).astype(np.int32)
        rows, columns = np.divmod(key[first], max(nfree, 1))
        indptr = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=nfree))]).astype(np.int32)
        self.matrix = csr_matrix((np.zeros(len(first)), columns.astype(np.int32), indptr), shape=(nfree, nfree))
        self.matrix.has_sorted_indices = True
        self._local = np.empty((nelem, 2 * nb, 2 * nb))
        self._flat = self._local.reshape(-1)

    def assemble(self, tangent: Array) -> csr_matrix:
        """``int B^T D B dV`` for the free degrees of freedom.

        Parameters
        ----------
        tangent : ndarray, shape (npt, 3, 3)
            Not necessarily symmetric [Pa].

        Returns
        -------
        scipy.sparse.csr_matrix
            The same object at each call, with new values.
        """
        space = self.space
        element_tangent_kernel(space.gradients, space.weights, space.points_per_cell, tangent, self._local)
        gather_tangent_kernel(self._start, self._source, self._flat, self.matrix.data)
        return self.matrix
