"""A space of some elements of another one, with nodes of its own: what is written and drawn of a part of a body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.mesh.curved import curved_mesh
from granfabric.fem.mesh.host_mesh import HostMesh

from .space import Space


@dataclass(frozen=True)
class RestrictedSpace:
    """A part of a space.

    Parameters
    ----------
    space : Space
        Of the elements that are there; without named boundaries.
    cells, nodes, points : ndarray of int
        Numbers of its elements, nodes and integration points in the whole space.
    """

    space: Space
    cells: NDArray[np.int64]
    nodes: NDArray[np.int64]
    points: NDArray[np.int64]


def restricted_space(space: Space, active: NDArray[np.bool_]) -> RestrictedSpace:
    """The part of a space that consists of its active elements, shape of the mask (nelem,)."""
    cells = np.flatnonzero(active)
    made = Space(restricted_mesh(space, active), space.element, space.quadrature_degree)
    nodes = np.empty(made.nnodes, dtype=np.int64)
    nodes[made.element_nodes] = space.element_nodes[cells]
    return RestrictedSpace(made, cells, nodes, np.flatnonzero(active[space.point_cell]))


def restricted_mesh(space: Space, active: NDArray[np.bool_]) -> HostMesh:
    """Mesh of the active elements of a space, in the same order; without named boundaries."""
    host = space.host_mesh
    cells = np.flatnonzero(active)
    used, corners = np.unique(host.mesh.t[:, cells], return_inverse=True)
    corners = corners.reshape(host.mesh.t.shape[0], -1)
    # ascending numbers stay ascending, so that sides and corners keep their order
    mesh = type(host.mesh)(np.ascontiguousarray(host.mesh.p[:, used]), np.ascontiguousarray(corners))
    curved = None
    if host.curved is not None:
        facet = np.full(host.mesh.facets.shape[1], -1, dtype=np.int64)
        facet[host.mesh.t2f[:, cells]] = mesh.t2f
        old = np.flatnonzero(facet >= 0)
        middles = host.curved.p.T[host.mesh.p.shape[1] + old]
        curved = curved_mesh(mesh, facet[old], middles)
    number = np.full(len(active), -1, dtype=np.int64)
    number[cells] = np.arange(len(cells))
    regions = {name: number[index[active[index]]] for name, index in host.regions.items()}
    return HostMesh(mesh, {}, regions, curved)
