"""Internal forces and tangent matrix of a space, into buffers and a sparsity pattern that are made once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from granfabric.constitutive.arrays import index, keep_apart, read, written
from granfabric.constitutive.threads import run_in_threads

from .active_part import Elements
from .kernels import (
    element_action_kernel,
    element_force_kernel,
    element_tangent_kernel,
    gather_force_kernel,
    gather_tangent_kernel,
    strain_kernel,
)

Array = NDArray[np.float64]

FEWEST_ELEMENTS = 1024
"""Elements for which a second thread pays."""


class _Known:
    """Arrays of a space or a part of it as the kernels may use them: checked once, node numbers out of reach."""

    def __init__(self, space: Elements) -> None:
        nelem, nb = space.element_nodes.shape
        self.points_per_cell = int(space.points_per_cell)
        npt = nelem * self.points_per_cell
        self.gradients = read("gradients", space.gradients, (npt, nb, 2))
        self.weights = read("weights", space.weights, (npt,))
        nodes = index("element_nodes", space.element_nodes.ravel(), nelem * nb, space.nnodes)
        self.element_nodes = nodes.reshape(nelem, nb).copy()


class ForceAssembler:
    """Strains and internal forces; no allocation per call.

    Parameters
    ----------
    space : Space or ActivePart

    Raises
    ------
    ValueError
        From the calls, if an array is of the wrong shape or kind, or one to be written shares memory with another.
    """

    def __init__(self, space: Elements) -> None:
        self.space = space
        self._known = _Known(space)
        nelem, nb = self._known.element_nodes.shape
        self._local = np.empty((nelem, nb, 2))
        self._flat = self._local.reshape(-1, 2)
        flat_nodes = self._known.element_nodes.ravel()
        self._source = np.argsort(flat_nodes, kind="stable").astype(np.int32)
        counts = np.bincount(flat_nodes, minlength=space.nnodes)
        self._start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        self.magnitude = np.empty(space.ndofs)

    def _outputs(self, out: Array, inputs: Sequence[tuple[str, Array, object]]) -> tuple[Array, Array]:
        """Forces and magnitudes, checked."""
        force = written("out", out, (self.space.ndofs,))
        magnitude = written("magnitude", self.magnitude, (self.space.ndofs,))
        keep_apart({"out": force, "magnitude": magnitude}, inputs)
        return force, magnitude

    def strain(self, displacement: Array, out: Array) -> Array:
        """Strain at the points of nodal displacements.

        Parameters
        ----------
        displacement : ndarray, shape (ndofs,)
            [m].
        out : ndarray, shape (npt, 3)
            Receives xx, yy, engineering xy; tension positive.
        """
        space, known = self.space, self._known
        moved = read("displacement", displacement, (space.ndofs,))
        strain = written("out", out, (space.npoints, 3))
        keep_apart({"out": strain}, [("displacement", moved, displacement)])
        arguments = (known.gradients, known.element_nodes, known.points_per_cell, moved, strain)
        run_in_threads(strain_kernel, space.nelements, arguments, FEWEST_ELEMENTS)
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
        space, known = self.space, self._known
        given = read("stress", stress, (space.npoints, 3))
        force, magnitude = self._outputs(out, [("stress", given, stress)])
        arguments = (known.gradients, known.weights, known.points_per_cell, given, self._local)
        run_in_threads(element_force_kernel, space.nelements, arguments, FEWEST_ELEMENTS)
        gather_force_kernel(self._start, self._source, self._flat, force, magnitude)
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
        space, known = self.space, self._known
        stiffness = read("tangent", tangent, (space.npoints, 3, 3))
        moved = read("displacement", displacement, (space.ndofs,))
        force, magnitude = self._outputs(
            out, [("tangent", stiffness, tangent), ("displacement", moved, displacement)]
        )
        arguments = (
            known.gradients,
            known.weights,
            known.element_nodes,
            known.points_per_cell,
            stiffness,
            moved,
            self._local,
        )
        run_in_threads(element_action_kernel, space.nelements, arguments, FEWEST_ELEMENTS)
        gather_force_kernel(self._start, self._source, self._flat, force, magnitude)
        return out


class TangentAssembler:
    """Tangent matrix of the free degrees of freedom in a fixed compressed-row pattern.

    Parameters
    ----------
    space : Space or ActivePart
    free : ndarray of int
        Degrees of freedom that are rows and columns of the matrix, ascending.

    Raises
    ------
    ValueError
        If they do not ascend or are out of range; from the calls, if an array is of the wrong shape or kind.

    Attributes
    ----------
    matrix : scipy.sparse.csr_matrix, shape (nfree, nfree)
        Column indices ascend; its pattern is symmetric. `assemble` overwrites its values.
    """

    def __init__(self, space: Elements, free: NDArray[np.int64]) -> None:
        self.space = space
        self._known = _Known(space)
        nfree = np.size(free)
        self.free = index("free", free, nfree, space.ndofs).astype(np.int64)
        if (np.diff(self.free) <= 0).any():
            raise ValueError("free must be an array of integers that ascend, each degree of freedom once")
        nelem, nb = self._known.element_nodes.shape
        if nelem * (2 * nb) ** 2 >= 2**31:
            raise ValueError(f"a mesh of {nelem} elements of {nb} nodes is too large for a matrix")
        number = np.full(space.ndofs, -1, dtype=np.int64)
        number[self.free] = np.arange(nfree)
        nodes = self._known.element_nodes
        dofs = np.stack([2 * nodes, 2 * nodes + 1], axis=2).reshape(nelem, 2 * nb)
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
        space, known = self.space, self._known
        stiffness = read("tangent", tangent, (space.npoints, 3, 3))
        values = written("the values of the matrix", self.matrix.data, (len(self._start) - 1,))
        keep_apart({"the values of the matrix": values}, [("tangent", stiffness, tangent)])
        arguments = (known.gradients, known.weights, known.points_per_cell, stiffness, self._local)
        run_in_threads(element_tangent_kernel, space.nelements, arguments, FEWEST_ELEMENTS)
        gather_tangent_kernel(self._start, self._source, self._flat, values)
        return self.matrix
