"""From integration points to the nodes of files and probes, each material by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from granfabric.fem.discretisation.parts import parts
from granfabric.fem.discretisation.projection import Projection
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.results import StepResult

Array = NDArray[np.float64]


def region_of_cells(space: Space) -> NDArray[np.int32]:
    """Number of each cell's region, from 1 in the mesh's order; 0 in none, and the first where several overlap."""
    number = np.zeros(space.nelements, dtype=np.int32)
    for place, cells in reversed(list(enumerate(space.host_mesh.regions.values(), start=1))):
        number[cells] = place
    return number


class Recovery:
    """Values at nodes and means of cells.

    Parameters
    ----------
    space : Space
    material_index : ndarray of int, shape (npt,), optional
        Number of the material at each integration point, from 0; one material if not given.

    Attributes
    ----------
    nodes : Parts
        Nodes of the values; where materials meet, each has its own.
    material : ndarray of int32, shape (nelem,)
        Number of each cell's material, from 1.
    """

    def __init__(self, space: Space, material_index: NDArray[np.integer] | None = None) -> None:
        nq = space.points_per_cell
        index = np.zeros(space.nelements, np.int32) if material_index is None else material_index[::nq]
        self.material = (index + 1).astype(np.int32)
        self.nodes = parts(space, self.material)
        self._projection = Projection(space, self.nodes)
        weights = space.weights.reshape(-1, nq)
        self._share = weights / weights.sum(axis=1, keepdims=True)

    def field(self, values: Array) -> Array:
        """Values at the nodes, shape (n, ...), of those at the integration points."""
        return self._projection(values)

    def result(self, result: StepResult) -> StepResult:
        """Stress, strain and state at the nodes."""
        recover = self._projection
        return replace(
            result, stress=recover(result.stress), strain=recover(result.strain), state=recover(result.state)
        )

    def at(self, nodes: NDArray[np.int64], weights: Array) -> csr_matrix:
        """Matrix that takes values at the integration points to places given by nodes and their weights, (n, nb)."""
        rows = np.repeat(np.arange(len(nodes)), nodes.shape[1])
        shape = (len(nodes), len(self.nodes.node))
        return csr_matrix((weights.ravel(), (rows, nodes.ravel())), shape=shape) @ self._projection.operator

    def cell_means(self, values: Array) -> Array:
        """Means over the cells, shape (nelem, k), of values at the integration points, shape (npt, k)."""
        return np.einsum("eq,eqk->ek", self._share, values.reshape(*self._share.shape, -1))
