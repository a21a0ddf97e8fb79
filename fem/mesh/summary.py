"""What a mesh consists of: its groups with their sizes, what is in no group, and what is worth a look."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .host_mesh import HostMesh
from .topology import twin_sides

IntArray = NDArray[np.int64]
Array = NDArray[np.float64]

# Gauss points on [-1, 1] for the length of a side that is a parabola.
_PLACES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True)
class Group:
    """A boundary or region.

    Parameters
    ----------
    name : str
        Empty for what is in no group.
    kind : {"boundary", "region"}
    index : ndarray of int
        Its sides or cells.
    size : float
        Length [m] or area [m^2].
    """

    name: str
    kind: str
    index: IntArray
    size: float


def side_lengths(host: HostMesh, curved: bool = True) -> Array:
    """Length of each side [m], along its curve if the mesh has curved sides and they are wanted."""
    mesh = host.mesh
    start, end = mesh.p[:, mesh.facets[0]], mesh.p[:, mesh.facets[1]]
    lengths = np.linalg.norm(end - start, axis=0)
    if host.curved is not None and curved:
        bend = _bend(host)
        bent = np.flatnonzero(np.linalg.norm(bend, axis=0) > 0)
        # x(s) = middle + s/2 (end - start) + (1 - s^2) bend, s from -1 to 1
        speed = (end - start)[:, bent, None] / 2 - 2 * bend[:, bent, None] * _PLACES
        lengths[bent] = np.linalg.norm(speed, axis=0) @ _WEIGHTS
    return lengths


def cell_areas(host: HostMesh, curved: bool = True) -> Array:
    """Area of each cell [m^2], within its curves if the mesh has curved sides and they are wanted."""
    mesh = host.mesh
    x, y = mesh.p[:, mesh.t]
    signed = 0.5 * (x * np.roll(y, -1, axis=0) - np.roll(x, -1, axis=0) * y).sum(axis=0)
    if host.curved is not None and curved:
        start, end = mesh.p[:, mesh.facets[0]], mesh.p[:, mesh.facets[1]]
        bend = _bend(host)
        # between a chord and its parabola, positive where the curve lies to the right of the chord
        gain = (2.0 / 3.0) * (bend[0] * (end - start)[1] - bend[1] * (end - start)[0])
        ahead = mesh.t == mesh.facets[0][mesh.t2f]  # whether the cell runs along its side from its first end on
        signed = signed + np.where(ahead, gain[mesh.t2f], -gain[mesh.t2f]).sum(axis=0)
    return np.abs(signed)


def _bend(host: HostMesh) -> Array:
    """How far the middle of each side is from the middle of its ends [m], shape (2, nsides)."""
    mesh = host.mesh
    middles = host.curved.p[:, mesh.p.shape[1] : mesh.p.shape[1] + mesh.facets.shape[1]]
    return middles - mesh.p[:, mesh.facets].mean(axis=1)


def groups(host: HostMesh, curved: bool = True) -> list[Group]:
    """Boundaries and regions in the order of the mesh, then what is in none of them, if anything is.

    Of the sides in no boundary those of the outline count.

    Parameters
    ----------
    host : HostMesh
    curved : bool
        Whether the curved sides count, as for elements of second order.
    """
    lengths, areas = side_lengths(host, curved), cell_areas(host, curved)
    outline = host.mesh.f2t[1] < 0
    bare_side, bare_cell = outline.copy(), np.ones(len(areas), dtype=bool)
    found = []
    for name, index in host.boundaries.items():
        bare_side[index] = False
        found.append(Group(name, "boundary", index, float(lengths[index].sum())))
    rest = []
    for name, index in host.regions.items():
        bare_cell[index] = False
        found.append(Group(name, "region", index, float(areas[index].sum())))
    for kind, bare, sizes in (("boundary", bare_side, lengths), ("region", bare_cell, areas)):
        index = np.flatnonzero(bare)
        if index.size:
            rest.append(Group("", kind, index, float(sizes[index].sum())))
    return found + rest


def remarks(host: HostMesh) -> list[str]:
    """Sentences on what may be otherwise than it looks: the file's groups, boundaries on one of two faces."""
    found = list(host.remarks)
    twins = twin_sides(host.mesh)
    other = np.full(host.mesh.facets.shape[1], -1, dtype=np.int64)
    other[twins[:, 0]], other[twins[:, 1]] = twins[:, 1], twins[:, 0]
    named = np.zeros(len(other), dtype=bool)
    for index in host.boundaries.values():
        named[index] = True
    for name, index in host.boundaries.items():
        one_faced = index[other[index] >= 0]
        one_faced = one_faced[~named[other[one_faced]]]
        if one_faced.size:
            share = "the sides" if one_faced.size == len(index) else f"{one_faced.size} of the {len(index)} sides"
            found.append(
                f"{share} of the boundary {name!r} lie on one of two faces with nodes of their own, and the other face "
                "is in no boundary: what acts on the boundary acts on one face only"
            )
    return found
