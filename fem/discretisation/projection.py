"""From integration points to nodes, so that linear fields come out exactly on any mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from .parts import Parts, parts
from .space import Space

Array = NDArray[np.float64]

# A patch whose points lie so nearly on one line does not determine a linear field and is enlarged.
_SMALLEST_SPREAD = 1e-3
_LARGEST_PATCH_RINGS = 3


class Projection:
    """Least-squares patch recovery (Zienkiewicz & Zhu 1992, IJNME 33, 1331) as one sparse matrix.

    The value at a vertex is that of the linear polynomial which fits the integration points of the elements around it,
    weighted by area; where these do not determine one (a corner of a P1 mesh), elements further away join in. Nodes on
    sides and inside elements take the mean of the vertices around them. Made once, applied by one product to any number
    of columns.

    Parameters
    ----------
    space : Space
    nodes : Parts, optional
        Where several groups meet, the fit of each takes its own elements alone, so that nothing is smoothed across.

    Attributes
    ----------
    operator : scipy.sparse.csr_matrix, shape (n, npt)
    """

    def __init__(self, space: Space, nodes: Parts | None = None) -> None:
        nodes = nodes or parts(space)
        corners = space.host_mesh.mesh.t.shape[0]
        of_vertex, place = np.unique(nodes.element_nodes[:, :corners], return_inverse=True)
        vertices = place.reshape(-1, corners)
        nvertices = len(of_vertex)
        coordinates = space.nodes[nodes.node[of_vertex]]
        nq = space.points_per_cell
        incidence = csr_matrix(
            (np.ones(vertices.size), (vertices.ravel(), np.repeat(np.arange(len(vertices)), corners))),
            shape=(nvertices, len(vertices)),
        )
        rows, cells = incidence.nonzero()
        matrix = _fit(space, rows.astype(np.int64), cells.astype(np.int64), coordinates)
        weak = np.flatnonzero(~matrix[1])
        operator = matrix[0]
        if weak.size:
            operator = operator.tolil()
            for vertex in weak:
                points, weights = _enlarged_patch(space, incidence, int(vertex), nq, coordinates[vertex])
                operator.rows[vertex] = points.tolist()
                operator.data[vertex] = weights.tolist()
            operator = operator.tocsr()
        self.operator = csr_matrix(_vertices_to_nodes(space, nodes, of_vertex) @ operator)

    def __call__(self, values: Array) -> Array:
        """Nodal values, shape (n, k), of point values, shape (npt, k) (or (n,) of (npt,)); n nodes as in `Parts`."""
        return np.asarray(self.operator @ values)


def _fit(
    space: Space, rows: NDArray[np.int64], cells: NDArray[np.int64], vertices: Array
) -> tuple[csr_matrix, NDArray[np.bool_]]:
    """Weights of the linear fits of all vertices at once, and which fits are determined."""
    nq, nvertices = space.points_per_cell, len(vertices)
    vertex = np.repeat(rows, nq)
    point = (cells[:, None] * nq + np.arange(nq)).ravel()
    offset = space.points[point] - vertices[vertex]
    weight = space.weights[point]
    total = np.bincount(vertex, weights=weight, minlength=nvertices)
    radius2 = np.bincount(vertex, weights=weight * np.sum(offset**2, axis=1), minlength=nvertices) / total
    offset /= np.sqrt(radius2)[vertex, None]
    terms = np.stack([np.ones(len(point)), offset[:, 0], offset[:, 1]], axis=1)
    normal = np.empty((nvertices, 3, 3))
    for i in range(3):
        for j in range(3):
            moment = weight * terms[:, i] * terms[:, j]
            normal[:, i, j] = np.bincount(vertex, weights=moment, minlength=nvertices) / total
    determined = np.linalg.eigvalsh(normal)[:, 0] > _SMALLEST_SPREAD
    normal[~determined] = np.eye(3)
    first_row = np.linalg.inv(normal)[:, 0, :]
    values = np.einsum("ij,ij->i", first_row[vertex], terms) * weight / total[vertex]
    return csr_matrix((values, (vertex, point)), shape=(nvertices, space.npoints)), determined


def _enlarged_patch(
    space: Space, incidence: csr_matrix, vertex: int, nq: int, place: Array
) -> tuple[NDArray[np.int64], Array]:
    """Fit at one vertex with rings of neighbours added until it is determined, or as well as the mesh allows."""
    cells = incidence[vertex].indices
    for _ in range(_LARGEST_PATCH_RINGS):
        around = np.unique(incidence[:, cells].tocoo().row)
        cells = np.unique(incidence[around].indices)
        points = np.sort((cells[:, None].astype(np.int64) * nq + np.arange(nq)).ravel())
        fraction = space.weights[points] / space.weights[points].sum()
        centre = fraction @ space.points[points]
        root = np.sqrt(fraction)
        scaled = (space.points[points] - centre) * root[:, None]
        spread = np.linalg.eigvalsh(scaled.T @ scaled)
        if spread[0] > _SMALLEST_SPREAD * spread[1]:
            break
    # Mean plus slope; the pseudo-inverse leaves out a slope that the points do not determine.
    gradient = np.linalg.pinv(scaled, rcond=1e-8) * root
    gradient -= np.outer(gradient.sum(axis=1), fraction)
    return points, fraction + (place - centre) @ gradient


_SIDES = {3: ((0, 1), (1, 2), (0, 2)), 4: ((0, 1), (1, 2), (2, 3), (0, 3))}
"""Ends of the sides of a cell, in scikit-fem's order, by its number of corners."""


def _vertices_to_nodes(space: Space, nodes: Parts, of_vertex: NDArray[np.int64]) -> csr_matrix:
    """Vertices as they are; a midside node the mean of its side's ends, a centre node that of all corners."""
    corners = space.host_mesh.mesh.t.shape[0]
    local = nodes.element_nodes
    rows, columns, values = [of_vertex], [np.arange(len(of_vertex))], [np.ones(len(of_vertex))]

    def add(node: NDArray[np.int64], around: NDArray[np.int64]) -> None:
        _, first = np.unique(node, return_index=True)
        rows.append(np.repeat(node[first], around.shape[1]))
        columns.append(np.searchsorted(of_vertex, np.sort(around[first], axis=1)).ravel())
        values.append(np.full(len(columns[-1]), 1.0 / around.shape[1]))

    if space.order == 2:
        ends = np.array(_SIDES[corners])
        add(local[:, corners : 2 * corners].ravel(), local[:, ends].reshape(-1, 2))
        if space.element == "Q2":
            add(local[:, -1], local[:, :4])
    return csr_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
        shape=(len(nodes.node), len(of_vertex)),
    )
