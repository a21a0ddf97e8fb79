"""A space divided among ranks by dolfinx, and which of its numbers are which of the own host's.

dolfinx numbers cells, nodes and points of an element in its own way. The correspondence is found from reference
coordinates and from the original numbers that dolfinx keeps, and checked against places.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.discretisation.space import Space

from . import dialect
from .engine import dolfinx
from .exchange import Exchange

Array = NDArray[np.float64]

_CELLS = {"P": "triangle", "Q": "quadrilateral"}
SAME_PLACE = 1e-10
"""Two places are the same if they differ by less than this fraction of the mesh's extent."""


class DistributionError(ValueError):
    """The space cannot be divided, or not in a way that both hosts agree on."""


@dataclass(frozen=True)
class Outline:
    """What every rank needs of the space that rank 0 has.

    Parameters
    ----------
    element : {"P1", "P2", "Q1", "Q2"}
    quadrature_degree : int
    curved : bool
        Whether sides are as curved as the element can represent.
    places : ndarray, shape (nq, 2)
        Reference coordinates of the integration points of a cell, in the own host's order.
    weights : ndarray, shape (nq,)
    nodes : ndarray, shape (nb, 2)
        Reference coordinates of the nodes of a cell, in the own host's order.
    extent : float
        Largest extent of the mesh [m].
    """

    element: str
    quadrature_degree: int
    curved: bool
    places: Array
    weights: Array
    nodes: Array
    extent: float

    @property
    def order(self) -> int:
        """Degree of the displacements."""
        return int(self.element[1])

    @property
    def cell(self) -> str:
        """dolfinx's name of the cells."""
        return _CELLS[self.element[0]]


def outline(space: Space) -> Outline:
    """What every rank needs of a space."""
    return Outline(
        space.element,
        space.quadrature_degree,
        space.is_curved,
        space.reference_points,
        space.reference_weights,
        space.reference_nodes,
        float(np.ptp(space.nodes, axis=0).max()),
    )


def matching(ours: Array, theirs: Array) -> NDArray[np.int64] | None:
    """Number in `theirs` of each row of `ours`, both of shape (n, 2); None if they are not the same places."""
    if ours.shape != theirs.shape:
        return None
    distance = np.abs(ours[:, None, :] - theirs[None, :, :]).max(axis=2)
    found = distance.argmin(axis=1)
    same = distance[np.arange(len(ours)), found].max() < SAME_PLACE
    return found if same and len(np.unique(found)) == len(ours) else None


class Distribution:
    """Mesh and spaces of dolfinx, and the own host's numbers of what this rank owns.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    space : Space or None
        On rank 0; None elsewhere.

    Attributes
    ----------
    mesh : dolfinx.mesh.Mesh
    displacements : dolfinx.fem.FunctionSpace
        Vector Lagrange space.
    outline : Outline
    cells : ndarray of int32
        The cells that this rank owns.
    nodes : Exchange
        Rows are nodes.
    elements : Exchange
        Rows are cells.
    points : Exchange
        Rows are integration points.
    node_numbers, cell_numbers, point_numbers : ndarray of int
        On rank 0, of what this rank owns.
    first_dof : int
        dolfinx's number, over all ranks, of the first degree of freedom that this rank owns.
    node_order, point_order : ndarray of int
        For dolfinx's nodes and points of a cell the numbers of the own host's.
    ndofs, nelements, npoints, points_per_cell : int
        Owned by this rank.
    point_cell : ndarray of int, shape (npoints,)
        Cell of each point.
    places : ndarray, shape (npoints, 2)
        [m].
    weights : ndarray, shape (npoints,)
        Areas of the points [m^2].

    Raises
    ------
    DistributionError
        On all ranks.
    """

    def __init__(self, comm: Any, space: Space | None) -> None:
        self.comm = comm
        self.outline: Outline = comm.bcast(None if space is None else outline(space), root=0)
        shape = self.outline
        node, point, self.reference_points = _correspondence(shape)
        order = shape.order if shape.curved else 1
        self.mesh = self._divide(space, node, order)
        self.displacements = dialect.vector_space(self.mesh, shape.order)
        self.node_order, self.point_order = np.argsort(node), np.argsort(point)
        self._number(space, self.node_order, self.point_order)

    def _divide(self, space: Space | None, node: NDArray[np.int64], order: int) -> Any:
        # dolfinx's nodes of the geometry come first among those of the element
        corners = len(dialect.lagrange_points(self.outline.cell, order))
        if space is not None:
            rows = space.element_nodes[:, np.argsort(node)[:corners]]
            used, compact = np.unique(rows, return_inverse=True)
            rows, coordinates = compact.reshape(rows.shape).astype(np.int64), space.nodes[used]
        else:
            rows, coordinates = np.empty((0, corners), dtype=np.int64), np.empty((0, 2))
        return dialect.create_mesh(self.comm, rows, coordinates, self.outline.cell, order)

    def _number(self, space: Space | None, node: NDArray[np.int64], point: NDArray[np.int64]) -> None:
        number = self.mesh.topology.index_map(2).size_local
        self.cells = np.arange(number, dtype=np.int32)
        local = np.asarray(self.mesh.topology.original_cell_index, dtype=np.int64)  # ghosts come last
        # rank 0 tells each rank the nodes of its cells: a node that it owns may lie on a ghost only
        asked = self.comm.gather(local, root=0)
        answers = [space.element_nodes[cells] for cells in asked] if space is not None and asked is not None else None
        element_nodes = self.comm.scatter(answers, root=0)
        index_map = self.displacements.dofmap.index_map
        numbers = np.full(index_map.size_local + index_map.num_ghosts, -1, dtype=np.int64)
        numbers[dialect.dof_table(self.displacements)[: len(local)]] = element_nodes[:, node]
        owned, original = numbers[: index_map.size_local], local[:number]
        self.node_numbers = owned
        self.nodes = Exchange(self.comm, owned)
        self.first_dof = 2 * int(index_map.local_range[0])
        self.cell_numbers, self.nelements = original, number
        self.elements = Exchange(self.comm, original)
        self.points_per_cell = nq = len(point)
        self.point_cell = np.repeat(np.arange(number), nq)
        self.point_numbers = (original[:, None] * nq + point[None, :]).ravel()
        self.points = Exchange(self.comm, self.point_numbers)
        self.ndofs = 2 * index_map.size_local
        self.npoints = number * nq
        self.places = self.points.scatter(None if space is None else space.points, (2,))
        self.weights = self.points.scatter(None if space is None else space.weights)
        self._check_places(space)

    def _check_places(self, space: Space | None) -> None:
        wanted = self.nodes.scatter(None if space is None else space.nodes, (2,))
        have = self.displacements.tabulate_dof_coordinates()[: len(wanted), :2]
        off = float(np.abs(have - wanted).max()) if len(wanted) else 0.0
        if self.comm.allreduce(int(not off <= SAME_PLACE * self.outline.extent)):
            raise DistributionError("the two hosts disagree on where the nodes are")


def check_space(space: Space) -> None:
    """Make sure that both hosts mean the same by an element and its integration points.

    Raises
    ------
    DistributionError
    """
    dolfinx()
    _correspondence(outline(space))


def _correspondence(shape: Outline) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """dolfinx's numbers of the own host's nodes and points of a cell, and dolfinx's reference points."""
    node = _agreed(shape.nodes, dialect.lagrange_points(shape.cell, shape.order), f"the nodes of {shape.element}")
    theirs, weights = dialect.quadrature_rule(shape.cell, shape.quadrature_degree)
    rule = f"quadrature_degree = {shape.quadrature_degree} of {shape.element}"
    point = _agreed(shape.places, theirs, f"the {len(shape.places)} integration points of {rule}")
    if not np.allclose(weights[point], shape.weights, rtol=1e-12):
        raise DistributionError(f"the host 'fenicsx' weighs the integration points of {rule} differently")
    return node, point, theirs


def _agreed(ours: Array, theirs: Array, what: str) -> NDArray[np.int64]:
    found = matching(ours, np.asarray(theirs)[:, :2])
    if found is None:
        raise DistributionError(f"the host 'fenicsx' places {what} elsewhere")
    return found
