"""From integration points to nodes, so that linear fields come out exactly on any mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

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
    """

    def __init__(self, space: Space) -> None:
        vertices = space.host_mesh.mesh.t.T.astype(np.int64)
        nvertices = space.host_mesh.mesh.p.shape[1]
        corners = vertices.shape[1]
        nq = space.points_per_cell
        incidence = csr_matrix(
            (np.ones(vertices.size), (vertices.ravel(), np.repeat(np.arange(len(vertices)), corners))),
            shape=(nvertices, len(vertices)),
        )
        rows, cells = incidence.nonzero()
        matrix = _fit(space, rows.astype(np.int64), cells.astype(np.int64), nvertices)
        weak = np.flatnonzero(~matrix[1])
        operator = matrix[0]
        if weak.size:
            operator = operator.tolil()
            for vertex in weak:
                points, weights = _enlarged_patch(space, incidence, int(vertex), nq)
                operator.rows[vertex] = points.tolist()
                operator.data[vertex] = weights.tolist()
            operator = operator.tocsr()
        self._operator = csr_matrix(_vertices_to_nodes(space, nvertices) @ operator)

    def __call__(self, values: Array) -> Array:
        """Nodal values, shape (nnodes, k), of point values, shape (npt, k) (or (nnodes,) of (npt,))."""
        return np.asarray(self._operator @ values)


def _fit(
    space: Space, rows: NDArray[np.int64], cells: NDArray[np.int64], nvertices: int
) -> tuple[csr_matrix, NDArray[np.bool_]]:
    """Weights of the linear fits of all vertices at once, and which fits are determined."""
    nq = space.points_per_cell
    vertex = np.repeat(rows, nq)
    point = (cells[:, None] * nq + np.arange(nq)).ravel()
    offset = space.points[point] - space.nodes[vertex]
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


def _enlarged_patch(space: Space, incidence: csr_matrix, vertex: int, nq: int) -> tuple[NDArray[np.int64], Array]:
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
    return points, fraction + (space.nodes[vertex] - centre) @ gradient


def _vertices_to_nodes(space: Space, nvertices: int) -> csr_matrix:
    """Vertices as they are; a midside node the mean of its side's ends, a centre node that of all corners."""
    mesh = space.host_mesh.mesh
    rows, columns, values = [np.arange(nvertices)], [np.arange(nvertices)], [np.ones(nvertices)]
    if space.order == 2:
        nfacets = mesh.facets.shape[1]
        rows.append(np.repeat(nvertices + np.arange(nfacets), 2))
        columns.append(mesh.facets.T.ravel())
        values.append(np.full(2 * nfacets, 0.5))
        if space.element == "Q2":
            nelem = space.nelements
            rows.append(np.repeat(nvertices + nfacets + np.arange(nelem), 4))
            columns.append(mesh.t.T.ravel())
            values.append(np.full(4 * nelem, 0.25))
    return csr_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(space.nnodes, nvertices)
    )
