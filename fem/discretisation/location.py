"""Where a place lies in a mesh: its cell, and the shape functions of that cell there, curved sides included."""

from __future__ import annotations

from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ELEMENTS: dict[str, Any] = {
    "triangle": skfem.ElementTriP1,
    "triangle6": skfem.ElementTriP2,
    "quad": skfem.ElementQuad1,
    "quad9": skfem.ElementQuad2,
}
"""Element of each kind of cell; the order of its nodes is that of VTK's cell."""

INSIDE = 1e-8
"""Distance from the reference cell, in its own coordinates, up to which a place counts as inside."""
EDGE = 1e-5
"""The same for straight cells, where a place on their edge counts as inside in spite of rounding."""
BULGE = 0.25
"""Fraction of its size by which a box around the nodes of a curved cell is enlarged to hold the cell."""
ITERATIONS = 50
CONVERGED = 1e-12
"""Newton's last correction in reference coordinates."""


class Locator:
    """Finds places in a plane mesh.

    Parameters
    ----------
    nodes : ndarray, shape (nnodes, 2)
        [m].
    kind : {"triangle", "triangle6", "quad", "quad9"}
        Of all cells.
    cells : ndarray of int, shape (ncells, nodes per cell)
        In VTK's order.
    """

    def __init__(self, nodes: Array, kind: str, cells: NDArray[np.int64]) -> None:
        self._element = _ELEMENTS[kind]()
        self._triangular = kind.startswith("triangle")
        self._nodes, self._cells = nodes, cells
        corners = nodes[cells]
        low, high = corners.min(axis=1), corners.max(axis=1)
        margin = (BULGE if kind in ("triangle6", "quad9") else EDGE) * (high - low).max(axis=1, keepdims=True)
        self._low, self._high = low - margin, high + margin

    def find(self, places: Array, beyond: float = INSIDE) -> tuple[NDArray[np.int64], Array]:
        """Nodes and weights of the cell around each place.

        Parameters
        ----------
        places : ndarray, shape (n, 2)
            [m].
        beyond : float
            How far outside of a cell, in its reference coordinates, a place may lie.

        Returns
        -------
        nodes : ndarray of int, shape (n, nodes per cell)
            Of the cell; -1 where a place lies outside of the mesh.
        weights : ndarray, shape (n, nodes per cell)
            A nodal field has the value ``(weights * field[nodes]).sum(axis=1)`` there; NaN outside. On a side that two
            cells share the weights are those of one of them.
        """
        width = self._cells.shape[1]
        nodes, weights = np.full((len(places), width), -1), np.full((len(places), width), np.nan)
        for number, place in enumerate(places):
            near = np.flatnonzero(((place >= self._low) & (place <= self._high)).all(axis=1))
            best = beyond
            for cell in near:
                reference = self._reference(place, self._nodes[self._cells[cell]])
                if reference is None:
                    continue
                outside = self._outside(reference)
                if outside <= best:
                    nodes[number] = self._cells[cell]
                    weights[number] = self._shape(reference)[0]
                    best = outside
                if outside <= 0.0:
                    break
        return nodes, weights

    def _shape(self, reference: Array) -> tuple[Array, Array]:
        """Values (nodes,) and gradients (nodes, 2) of the shape functions at a place of the reference cell."""
        parts = [self._element.lbasis(reference[:, None], i) for i in range(self._cells.shape[1])]
        values = np.array([np.broadcast_to(value, (1,))[0] for value, _ in parts])
        return values, np.array([np.broadcast_to(np.asarray(slope), (2, 1))[:, 0] for _, slope in parts])

    def _reference(self, place: Array, corners: Array) -> Array | None:
        """Reference coordinates of a place by Newton's method; None where the map has no inverse that it finds."""
        here = np.full(2, 1.0 / 3.0 if self._triangular else 0.5)
        for _ in range(ITERATIONS):
            values, slopes = self._shape(here)
            jacobian = corners.T @ slopes
            determinant = jacobian[0, 0] * jacobian[1, 1] - jacobian[0, 1] * jacobian[1, 0]
            if determinant == 0.0 or not np.isfinite(here).all():
                return None
            step = np.linalg.solve(jacobian, place - values @ corners)
            # a long step leaves the cell, where the map of a curved one may fold over
            here = here + step / max(1.0, float(np.abs(step).max()))
            if np.abs(step).max() < CONVERGED:
                return here
        return None

    def _outside(self, reference: Array) -> float:
        """How far a reference place lies outside of the reference cell; not above zero inside."""
        x, y = reference
        return float(max(-x, -y, x + y - 1.0) if self._triangular else max(-x, -y, x - 1.0, y - 1.0))
