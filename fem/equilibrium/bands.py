"""Where the tangent lets a shear band form: loss of ellipticity (Rudnicki & Rice 1975, J. Mech. Phys. Solids 23, 371).

In a band with normal n the rate of deformation may differ from that beside it when the acoustic tensor
``Q = n . D . n`` is singular. Where det Q <= 0 for some n, the equations of equilibrium are no longer elliptic: their
solution need not be unique, changes with the mesh, and Newton's method loses its way. With flow that is not associated
this happens before the peak.
"""

from __future__ import annotations

import numpy as np

from granfabric.fem.vectors import Array

DIRECTIONS = 90
"""Normals over half a turn."""
UNSYMMETRIC = 1e-6
"""Unsymmetry of tangents, relative to their size, below which no point is looked at: such points slide on nothing."""
SINGULAR = 1e-6
"""Determinant, relative to the largest over the normals, that counts as none."""


def band_fraction(tangent: Array, weights: Array) -> float:
    """Area fraction of the points whose acoustic tensor has a negative determinant in some direction.

    Parameters
    ----------
    tangent : ndarray, shape (npt, 3, 3)
        [Pa]; xx, yy, engineering xy.
    weights : ndarray, shape (npt,)
        Areas of the points.

    Returns
    -------
    float
        0 where all tangents are symmetric, to rounding, or one is not finite.
    """
    if not np.isfinite(tangent).all():
        return 0.0
    size = np.abs(tangent).max(axis=(1, 2))
    chosen = np.abs(tangent - tangent.transpose(0, 2, 1)).max(axis=(1, 2)) > UNSYMMETRIC * size
    if not chosen.any():
        return 0.0
    part = tangent[chosen]
    least, most = np.full(len(part), np.inf), np.zeros(len(part))
    for angle in np.pi / DIRECTIONS * np.arange(DIRECTIONS):
        x, y = np.cos(angle), np.sin(angle)
        normal = np.array([[x, 0.0, y], [0.0, y, x]])
        acoustic = np.einsum("ik,pkl,jl->pij", normal, part, normal)
        determinant = acoustic[:, 0, 0] * acoustic[:, 1, 1] - acoustic[:, 0, 1] * acoustic[:, 1, 0]
        least, most = np.minimum(least, determinant), np.maximum(most, np.abs(determinant))
    lost = np.zeros(len(tangent), dtype=bool)
    lost[chosen] = least < -SINGULAR * most
    return float(weights[lost].sum() / weights.sum())
