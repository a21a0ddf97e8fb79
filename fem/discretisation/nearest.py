"""The place on the boundary of a mesh that is nearest to a place outside, curved sides included."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.mesh.host_mesh import HostMesh

Array = NDArray[np.float64]

PIECES = 40
"""Pieces into which a side is divided, and then the two next to the nearest of these."""


def nearest_on_boundary(host: HostMesh, place: Array, curved: bool) -> Array:
    """Nearest place on the boundary, shape (2,) [m].

    Parameters
    ----------
    host : HostMesh
    place : ndarray, shape (2,)
    curved : bool
        Whether sides are as curved as elements of second order are.
    """
    mesh = host.mesh
    facets = mesh.boundary_facets()
    a, b = mesh.p.T[mesh.facets[0, facets]], mesh.p.T[mesh.facets[1, facets]]
    middle = (a + b) / 2
    if curved and host.curved is not None:
        middle = host.curved.p.T[mesh.p.shape[1] + facets]
    along = np.linspace(-1.0, 1.0, PIECES + 1)
    lines = _side(a, middle, b, along)
    distance = np.linalg.norm(lines - place, axis=2)
    side, piece = np.unravel_index(int(distance.argmin()), distance.shape)
    width, s = 2.0 / PIECES, float(along[piece])
    nearest = lines[side, piece]
    for _ in range(12):
        near = np.clip(np.linspace(s - width, s + width, PIECES + 1), -1.0, 1.0)
        line = _side(a[side : side + 1], middle[side : side + 1], b[side : side + 1], near)[0]
        best = int(np.linalg.norm(line - place, axis=1).argmin())
        s, nearest, width = float(near[best]), line[best], 2.0 * width / PIECES
    return np.asarray(nearest)


def _side(a: Array, middle: Array, b: Array, s: Array) -> Array:
    """Places along sides, shape (nsides, ns, 2); s from -1 to 1."""
    s = s[None, :, None]
    return a[:, None] * s * (s - 1) / 2 + middle[:, None] * (1 - s**2) + b[:, None] * s * (s + 1) / 2
