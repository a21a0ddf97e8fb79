"""Error of the mesh, estimated from the stresses themselves.

The finite element stress is less smooth than the stress that it approximates. Around every vertex a polynomial of the
element's order is fitted to the integration points of the elements there (least squares, weighted by area: the patch
recovery of Zienkiewicz & Zhu 1992, IJNME 33, 1331); the polynomials of an element's corners, blended by its hat
functions, give a recovered stress that converges faster where the solution is smooth. The difference to it is the
estimate. Different materials have patches of their own: stress jumps between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .space import Space

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_SMALLEST_EIGENVALUE = 1e-4
"""Of the normal matrix in coordinates scaled to the patch: below, the points do not determine the polynomial."""
_MOST_RINGS = 4


@dataclass(frozen=True)
class MeshError:
    """Estimated error of a stress field.

    Parameters
    ----------
    relative : float
        Norm over the body of recovered minus computed stress, over the norm of the recovered one; 0 if there is none.
    of_cells : ndarray, shape (nelem,)
        Fraction of each element: its norm over that of the recovered stress of the whole body; the squares add up to
        that of `relative`.
    """

    relative: float
    of_cells: Array


def stress_error(space: Space, stress: Array, region: NDArray[np.integer] | None = None) -> MeshError:
    """Estimate the discretisation error of a stress field.

    Parameters
    ----------
    space : Space
    stress : ndarray, shape (npt, 3)
        xx, yy, xy [Pa]. Take the change since the initial stress: what is there from the start tells nothing.
    region : ndarray of int, shape (nelem,), optional
        Number of the material of each element; one for all if not given.
    """
    recovered = _Patches(space, region).recover(stress)
    whole = float(np.sqrt(space.weights @ np.sum(recovered**2, axis=1)))
    if whole == 0.0:
        return MeshError(0.0, np.zeros(space.nelements))
    square = space.weights * np.sum((recovered - stress) ** 2, axis=1)
    of_cells = np.sqrt(np.bincount(space.point_cell, weights=square, minlength=space.nelements)) / whole
    return MeshError(float(np.sqrt(square.sum())) / whole, of_cells)


class _Patches:
    """Elements around each vertex, separately for every material that meets there."""

    def __init__(self, space: Space, region: NDArray[np.integer] | None) -> None:
        self._space = space
        corners = space.host_mesh.mesh.t.T.astype(np.int64)
        self._corners = corners
        self._region = np.zeros(len(corners), dtype=np.int64) if region is None else np.asarray(region, dtype=np.int64)
        # a patch is a pair of vertex and region
        pair = corners * (self._region.max() + 1) + self._region[:, None]
        _, of_corner = np.unique(pair, return_inverse=True)
        self._of_corner = of_corner.reshape(corners.shape)
        self._number = int(self._of_corner.max()) + 1

    def recover(self, values: Array) -> Array:
        """Blended polynomials at the integration points, shape (npt, k), fitted to values of that shape."""
        space, nq = self._space, self._space.points_per_cell
        cells, patch = np.repeat(np.arange(len(self._corners)), self._corners.shape[1]), self._of_corner.ravel()
        centre, radius, coefficients, weak = self._fit(cells, patch, values)
        if weak.size:
            around = [self._enlarged(int(number), values) for number in weak]
            for number, (middle, size, fitted) in zip(weak, around):
                centre[number], radius[number], coefficients[number] = middle, size, fitted
        result = np.zeros_like(values)
        hats = np.tile(self._hats(), (space.nelements, 1))
        for corner in range(self._corners.shape[1]):
            number = np.repeat(self._of_corner[:, corner], nq)
            terms = self._terms((space.points - centre[number]) / radius[number, None])
            result += hats[:, [corner]] * np.einsum("nm,nmk->nk", terms, coefficients[number])
        return result

    def _terms(self, place: Array) -> Array:
        x, y = place[:, 0], place[:, 1]
        linear = [np.ones(len(x)), x, y]
        return np.stack(linear if self._space.order == 1 else [*linear, x * x, x * y, y * y], axis=1)

    def _fit(self, cells: Indices, patch: Indices, values: Array) -> tuple[Array, Array, Array, Indices]:
        """Centres, radii and polynomials of all patches at once, and the numbers of those that are not determined."""
        space, nq = self._space, self._space.points_per_cell
        point = (cells[:, None] * nq + np.arange(nq)).ravel()
        number = np.repeat(patch, nq)

        def add(what: Array) -> Array:
            return np.asarray(np.bincount(number, weights=what, minlength=self._number), dtype=np.float64)

        weight = space.weights[point]
        weight = weight / add(weight)[number]
        centre = np.stack([add(weight * space.points[point, i]) for i in range(2)], axis=1)
        offset = space.points[point] - centre[number]
        radius = np.sqrt(add(weight * np.sum(offset**2, axis=1)))
        radius[radius == 0.0] = 1.0  # a single point
        terms = self._terms(offset / radius[number, None])
        size = terms.shape[1]
        normal, right = np.empty((self._number, size, size)), np.empty((self._number, size, values.shape[1]))
        for i in range(size):
            for j in range(size):
                normal[:, i, j] = add(weight * terms[:, i] * terms[:, j])
            for k in range(values.shape[1]):
                right[:, i, k] = add(weight * terms[:, i] * values[point, k])
        determined = np.linalg.eigvalsh(normal)[:, 0] > _SMALLEST_EIGENVALUE
        normal[~determined] = np.eye(size)
        fitted = np.linalg.solve(normal, right).astype(np.float64)
        return centre, radius, fitted, np.flatnonzero(~determined).astype(np.int64)

    def _enlarged(self, number: int, values: Array) -> tuple[Array, float, Array]:
        """The same for one patch, with rings of neighbours of its region added until it is determined."""
        space, nq = self._space, self._space.points_per_cell
        cells = np.flatnonzero((self._of_corner == number).any(axis=1))
        own = self._region == self._region[cells[0]]
        for _ in range(_MOST_RINGS):
            cells = np.flatnonzero(own & np.isin(self._corners, self._corners[cells]).any(axis=1))
            point = (cells[:, None] * nq + np.arange(nq)).ravel()
            weight = space.weights[point] / space.weights[point].sum()
            centre = weight @ space.points[point]
            offset = space.points[point] - centre
            radius = float(np.sqrt(weight @ np.sum(offset**2, axis=1))) or 1.0
            terms = self._terms(offset / radius)
            if np.linalg.eigvalsh(terms.T @ (weight[:, None] * terms))[0] > _SMALLEST_EIGENVALUE:
                break
        root = np.sqrt(weight)[:, None]
        # where even these do not determine it, the smallest polynomial
        return centre, radius, np.linalg.lstsq(root * terms, root * values[point], rcond=1e-6)[0]

    def _hats(self) -> Array:
        """Hat functions of a cell's corners at its integration points, shape (nq, corners)."""
        corners = self._corners.shape[1]
        at_nodes = np.eye(corners)
        if self._space.order == 2:
            # midside nodes follow the corners, in scikit-fem's order of sides, then the centre of a quadrilateral
            sides = [(0, 1), (1, 2), (0, 2)] if corners == 3 else [(0, 1), (1, 2), (2, 3), (0, 3)]
            middle = np.array([[0.5 * (corner in side) for corner in range(corners)] for side in sides])
            at_nodes = np.concatenate([at_nodes, middle] + ([np.full((1, 4), 0.25)] if corners == 4 else []))
        return self._space.shape_values @ at_nodes
