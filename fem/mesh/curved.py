"""Curved sides: from a straight-sided mesh to one of second order with the middles of some sides moved."""

from __future__ import annotations

from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray

from .checks import MeshError

# Corners of the reference element and its middle: where a curved element is checked for being folded.
_PLACES = {
    3: np.array([[0.0, 1.0, 0.0, 0.5, 0.5, 0.0, 1.0 / 3.0], [0.0, 0.0, 1.0, 0.0, 0.5, 0.5, 1.0 / 3.0]]),
    4: np.array([[0.0, 1.0, 1.0, 0.0, 0.5, 1.0, 0.5, 0.0, 0.5], [0.0, 0.0, 1.0, 1.0, 0.0, 0.5, 1.0, 0.5, 0.5]]),
}


def curved_mesh(mesh: Any, facets: NDArray[np.int64], middles: NDArray[np.float64]) -> Any:
    """Second-order mesh with the same corners, cells and facets.

    The middle of a quadrilateral follows its sides as in a serendipity element: half the sum of the middles of the
    sides less a quarter of the sum of the corners.

    Parameters
    ----------
    mesh : skfem.MeshTri1 or skfem.MeshQuad1
    facets : ndarray of int, shape (n,)
        Sides that are not straight.
    middles : ndarray, shape (n, 2)
        Where their middles lie [m].

    Raises
    ------
    MeshError
        If a side bends so far that an element folds over.
    """
    corners = mesh.t.shape[0]
    sides = mesh.p[:, mesh.facets].mean(axis=1)
    sides[:, facets] = np.asarray(middles, dtype=np.float64).T
    parts = [mesh.p, sides]
    if corners == 4:
        parts.append(sides[:, mesh.t2f].sum(axis=1) / 2 - mesh.p[:, mesh.t].sum(axis=1) / 4)
    kind = skfem.MeshTri2 if corners == 3 else skfem.MeshQuad2
    curved = kind(np.ascontiguousarray(np.concatenate(parts, axis=1)), mesh.t)
    orientation = np.sign(mesh.mapping().detDF(np.array([[1.0 / 3.0], [1.0 / 3.0]])))
    folded = (curved.mapping().detDF(_PLACES[corners]) * orientation <= 0.0).any(axis=1)
    if folded.any():
        x, y = mesh.p[:, mesh.t[:, int(np.argmax(folded))]].mean(axis=1)
        raise MeshError(f"the element at ({x:.6g}, {y:.6g}) has a side that bends so far that it folds over")
    return curved
