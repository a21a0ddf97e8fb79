"""Parametric meshes with curved sides: grids of a unit square, mapped."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .host_mesh import HostMesh, MeshError, build_mesh

Array = NDArray[np.float64]
Map = Callable[[Array, Array], tuple[Array, Array]]

# Relative distance of a mapped middle from the straight one below which a side counts as straight.
_STRAIGHT = 1e-9


def mapped_grid(mapping: Map, across: int, along: int, cell: str, names: tuple[str, str, str, str]) -> HostMesh:
    """Grid of the unit square (s, t), mapped into the plane.

    Parameters
    ----------
    mapping : callable
        ``mapping(s, t)`` returns x and y [m] of arrays of equal shape; it must not turn the square over.
    across, along : int
        Cells in direction s and t.
    cell : {"triangle", "quad"}
        Triangles halve each cell.
    names : tuple of str
        Boundaries s = 0, s = 1, t = 0, t = 1. The region is ``all``.

    Raises
    ------
    MeshError
    """
    if cell not in ("triangle", "quad"):
        raise MeshError(f"cell = {cell!r} is not one of 'triangle', 'quad'")
    if across < 1 or along < 1:
        raise MeshError(f"a grid of {across} x {along} cells is empty")
    i, j = (index.ravel() for index in np.meshgrid(np.arange(across + 1), np.arange(along + 1)))
    place = np.stack([i / across, j / along], axis=1)
    node = np.arange(len(place)).reshape(along + 1, across + 1)
    a, b, c, d = (part.ravel() for part in (node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]))
    cells = np.stack([a, b, c, d], axis=1)
    if cell == "triangle":
        cells = np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)
    pairs = np.unique(np.sort(np.stack([cells, np.roll(cells, -1, axis=1)], axis=2).reshape(-1, 2), axis=1), axis=0)
    points = np.stack(mapping(place[:, 0], place[:, 1]), axis=1)
    halfway = place[pairs].mean(axis=1)
    middles = np.stack(mapping(halfway[:, 0], halfway[:, 1]), axis=1)
    ends = points[pairs]
    bent = np.linalg.norm(middles - ends.mean(axis=1), axis=1) > _STRAIGHT * np.linalg.norm(
        ends[:, 1] - ends[:, 0], axis=1
    )
    curves = dict(zip(names, (node[:, 0], node[:, -1], node[0], node[-1])))
    return build_mesh(
        points,
        cells,
        {name: np.stack([line[:-1], line[1:]], axis=1) for name, line in curves.items()},
        {"all": np.arange(len(cells))},
        (pairs[bent], middles[bent]),
    )


def quarter_ring(inner_radius: float, outer_radius: float, n_radial: int, n_around: int, cell: str) -> HostMesh:
    """Quarter of a ring around the origin, x and y positive, graded so that all cells have the same shape.

    Parameters
    ----------
    inner_radius, outer_radius : float
        [m].
    n_radial, n_around : int
        Cells along the radius and around.
    cell : {"triangle", "quad"}

    Returns
    -------
    HostMesh
        With boundaries ``inner, outer, bottom`` (y = 0) ``, left`` (x = 0) and region ``all``.

    Raises
    ------
    MeshError
    """
    if not 0 < inner_radius < outer_radius:
        raise MeshError(f"a ring from radius {inner_radius:g} m to {outer_radius:g} m is empty")

    def polar(s: Array, t: Array) -> tuple[Array, Array]:
        radius = inner_radius * (outer_radius / inner_radius) ** s
        x, y = radius * np.cos(np.pi / 2 * t), radius * np.sin(np.pi / 2 * t)
        return np.where(t == 1, 0.0, x), np.where(t == 0, 0.0, y)

    return mapped_grid(polar, n_radial, n_around, cell, ("inner", "outer", "bottom", "left"))


def plate_with_hole(radius: float, width: float, height: float, n_radial: int, n_around: int, cell: str) -> HostMesh:
    """Quarter of a rectangular plate with a circular hole around the origin, x and y positive.

    Lines run from the hole to the outer sides, with cells that grow as they would in a ring.

    Parameters
    ----------
    radius : float
        Of the hole [m].
    width, height : float
        Of the quarter, from the centre of the hole [m].
    n_radial : int
        Cells from the hole outwards.
    n_around : int
        Cells around the hole, even: half of them reach the right side, half the top.
    cell : {"triangle", "quad"}

    Returns
    -------
    HostMesh
        With boundaries ``hole, right, top, bottom`` (y = 0) ``, left`` (x = 0) and region ``all``.

    Raises
    ------
    MeshError
    """
    if not 0 < radius < min(width, height):
        raise MeshError(f"a hole of radius {radius:g} m does not fit into a quarter of {width:g} m x {height:g} m")
    if n_around % 2:
        raise MeshError(f"n_around = {n_around} is odd; half of the cells reach the right side, half the top")
    ratio = min(width, height) / radius
    diagonal = np.arctan2(height, width)

    def blend(s: Array, t: Array) -> tuple[Array, Array]:
        up, back = np.minimum(2 * t, 1.0), np.maximum(2 * t - 1, 0.0)
        angle = diagonal * up + (np.pi / 2 - diagonal) * back
        fraction = (ratio**s - 1) / (ratio - 1)
        x = (1 - fraction) * radius * np.cos(angle) + fraction * width * (1 - back)
        y = (1 - fraction) * radius * np.sin(angle) + fraction * height * up
        return np.where(t == 1, 0.0, x), np.where(t == 0, 0.0, y)

    mesh = mapped_grid(blend, n_radial, n_around, cell, ("hole", "outside", "bottom", "left"))
    outside = mesh.boundaries.pop("outside")
    at_right = np.isclose(mesh.mesh.p[0, mesh.mesh.facets[:, outside]].mean(axis=0), width, rtol=1e-12)
    mesh.boundaries.update(right=outside[at_right], top=outside[~at_right])
    return mesh
