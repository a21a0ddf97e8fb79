"""The elements of a space that are there at a stage: arrays of their own, nodes numbered as in the whole mesh."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .space import Space

Array = NDArray[np.float64]


class Elements(Protocol):
    """What assembly needs of a space, or of a part of it; see `Space` for the arrays."""

    gradients: Array
    weights: Array
    element_nodes: NDArray[np.int32]
    points_per_cell: int

    @property
    def nelements(self) -> int:
        """Number of elements."""
        ...

    @property
    def nnodes(self) -> int:
        """Number of nodes, those of the whole mesh."""
        ...

    @property
    def ndofs(self) -> int:
        """Number of degrees of freedom, two a node."""
        ...

    @property
    def npoints(self) -> int:
        """Number of integration points."""
        ...


class ActivePart:
    """Some elements of a space. Nothing is computed, stored or assembled for the others.

    Parameters
    ----------
    space : Space
    active : ndarray of bool, shape (nelem,)
        Elements that are there.

    Attributes
    ----------
    cells : ndarray of int, shape (nelem of the part,)
        Numbers of the elements in the whole mesh, ascending.
    points : ndarray of int, shape (npt of the part,)
        Numbers of their integration points in the whole mesh, ascending.
    nodes : ndarray of int
        Nodes of these elements, ascending.
    """

    def __init__(self, space: Space, active: NDArray[np.bool_]) -> None:
        self.cells = np.flatnonzero(active)
        self.points = np.flatnonzero(active[space.point_cell])
        self.gradients = np.ascontiguousarray(space.gradients[self.points])
        self.weights = np.ascontiguousarray(space.weights[self.points])
        self.element_nodes = np.ascontiguousarray(space.element_nodes[self.cells])
        self.points_per_cell = space.points_per_cell
        self.nodes = np.unique(self.element_nodes).astype(np.int64)
        self._nnodes = space.nnodes

    @property
    def nelements(self) -> int:
        """Number of elements of the part."""
        return len(self.cells)

    @property
    def nnodes(self) -> int:
        """Number of nodes of the whole mesh."""
        return self._nnodes

    @property
    def ndofs(self) -> int:
        """Number of degrees of freedom of the whole mesh."""
        return 2 * self._nnodes

    @property
    def npoints(self) -> int:
        """Number of integration points of the part."""
        return len(self.points)


def nodes_of(space: Space, active: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether each node belongs to an active element, shape (nnodes,)."""
    found = np.zeros(space.nnodes, dtype=bool)
    found[space.element_nodes[active]] = True
    return found


def degrees_of_freedom(nodes: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The same for the two degrees of freedom of each node."""
    return np.repeat(nodes, 2)
