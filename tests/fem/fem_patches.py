"""Patch recovery written out for one patch at a time: what the tests hold the vectorised code against."""

from __future__ import annotations

import numpy as np
from fem_meshes import cell_of

from granfabric.fem.discretisation.space import Space
from granfabric.fem.mesh.host_mesh import HostMesh, build_mesh, rectangle


def graded(element: str, n: int = 5, growth: float = 1.35) -> HostMesh:
    """Rectangle 2 x 1 whose cells grow by a factor each, from the left and from below; inner nodes a little moved."""
    host = rectangle(2.0, 1.0, n, n, cell_of(element))
    places = np.concatenate([[0.0], np.cumsum(growth ** np.arange(n))])
    places /= places[-1]
    points = host.mesh.p.T.copy()
    points[:, 0] = 2.0 * np.interp(points[:, 0] / 2.0, np.linspace(0, 1, n + 1), places)
    points[:, 1] = np.interp(points[:, 1], np.linspace(0, 1, n + 1), places)
    inner = (points[:, 0] > 0) & (points[:, 0] < 2) & (points[:, 1] > 0) & (points[:, 1] < 1)
    size = np.minimum(points[:, 0] / 2.0, points[:, 1])[:, None]
    points[inner] += 0.08 * (size * np.random.default_rng(2).uniform(-1, 1, points.shape) * [2.0, 1.0])[inner]
    lines = {name: host.mesh.facets[:, facets].T for name, facets in host.boundaries.items()}
    return build_mesh(points, host.mesh.t.T, lines, host.regions)


def corner_fractions(space: Space) -> np.ndarray:
    """Hat functions of each cell's corners at its integration points, shape (npt, corners), from the points' places."""
    corners = space.host_mesh.mesh.t.T
    places = space.host_mesh.mesh.p.T
    fractions = []
    for point, cell in zip(space.points, space.point_cell):
        own = places[corners[cell]]
        if len(own) == 3:
            fractions.append(np.linalg.solve(np.vstack([own.T, np.ones(3)]), [*point, 1.0]))
            continue
        u = np.zeros(2)
        for _ in range(30):  # inverse of the bilinear map
            hats, by_u, by_v = _bilinear(u)
            u = u + np.linalg.solve(np.column_stack([own.T @ by_u, own.T @ by_v]), point - hats @ own)
        fractions.append(_bilinear(u)[0])
    return np.array(fractions)


def _bilinear(u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hat functions of the corners (0,0), (1,0), (1,1), (0,1) and their derivatives."""
    x, y = u
    hats = np.array([(1 - x) * (1 - y), x * (1 - y), x * y, (1 - x) * y])
    return hats, np.array([-(1 - y), 1 - y, y, -y]), np.array([-(1 - x), -x, x, 1 - x])


def fit(space: Space, cells: np.ndarray, values: np.ndarray, order: int, weighted: bool = True, least: float = 0.0):
    """Polynomial through the points of the cells, least squares weighted by area, as a function; is it determined?

    It is, if in coordinates scaled to the patch no eigenvalue of the normal matrix is below `least` (or next to zero).
    """
    chosen = np.isin(space.point_cell, cells)
    fraction = space.weights[chosen] if weighted else np.ones(chosen.sum())
    fraction = fraction / fraction.sum()
    centre = fraction @ space.points[chosen]
    radius = np.sqrt(fraction @ np.sum((space.points[chosen] - centre) ** 2, axis=1)) or 1.0
    root, terms = np.sqrt(fraction)[:, None], _terms((space.points[chosen] - centre) / radius, order)
    found = np.linalg.lstsq(root * terms, root * values[chosen], rcond=1e-9)[0]
    smallest = np.linalg.eigvalsh((root * terms).T @ (root * terms))[0]
    return (lambda place: _terms((place - centre) / radius, order) @ found), bool(smallest > max(least, 1e-12))


def _terms(x: np.ndarray, order: int) -> np.ndarray:
    linear = [np.ones(len(x)), x[:, 0], x[:, 1]]
    return np.stack(linear if order == 1 else [*linear, x[:, 0] ** 2, x[:, 0] * x[:, 1], x[:, 1] ** 2], axis=1)
