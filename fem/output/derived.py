"""What is read off a stress: pressure, deviator, their ratio, principal stresses and directions, all in the plane.

The major principal stress is the most compressive one, the smaller number where tension is positive.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ISOTROPIC = 1e-12
"""q over the largest component up to which a stress has no principal directions."""

DERIVED = (
    *("p", "q", "stress_ratio", "principal_stress_major", "principal_stress_minor"),
    *("principal_direction_major", "principal_direction_minor"),
)
"""Names of `derived`."""


def pressure_and_deviator(stress: Array) -> tuple[Array, Array]:
    """Mean pressure (compression positive) and deviator q = (s1 - s2)/2 [Pa].

    Parameters
    ----------
    stress : ndarray, shape (n, 3)
        xx, yy, xy, tension positive [Pa].

    Returns
    -------
    p, q : ndarray, shape (n,)
    """
    return -(stress[:, 0] + stress[:, 1]) / 2, np.hypot((stress[:, 0] - stress[:, 1]) / 2, stress[:, 2])


def stress_ratio(p: Array, q: Array) -> Array:
    """q/p [-]; not a number where there is no pressure."""
    ratio = np.full(len(p), np.nan)
    np.divide(q, p, out=ratio, where=p > 0.0)
    return ratio


def invariants(stress: Array, carried: Array) -> dict[str, Array]:
    """``p``, ``q`` [Pa] of stresses and ``stress_ratio`` [-] of what the skeleton carries of them, shapes (n, 3)."""
    p, q = pressure_and_deviator(stress)
    return {"p": p, "q": q, "stress_ratio": stress_ratio(*pressure_and_deviator(carried))}


def derived(stress: Array, carried: Array) -> dict[str, Array]:
    """Invariants, principal stresses, shape (n,) [Pa], and their directions: unit vectors, shape (n, 3).

    A direction is given upwards or, along x, to the right; a stress that is isotropic to rounding has none (zeros).

    Parameters
    ----------
    stress, carried : ndarray, shape (n, 3)
        xx, yy, xy, tension positive [Pa]; of pore fluid and skeleton, and of the skeleton alone.
    """
    found = invariants(stress, carried)
    p, q = found["p"], found["q"]
    found["principal_stress_major"], found["principal_stress_minor"] = -p - q, -p + q
    # of the most tensile stress, from x
    angle = 0.5 * np.arctan2(stress[:, 2], (stress[:, 0] - stress[:, 1]) / 2)
    has = q > ISOTROPIC * np.abs(stress).max(axis=1, initial=0.0)
    x, y = np.where(has, np.cos(angle), 0.0), np.where(has, np.sin(angle), 0.0)
    found["principal_direction_major"] = _upwards(-y, x)
    found["principal_direction_minor"] = _upwards(x, y)
    return found


def _upwards(x: Array, y: Array) -> Array:
    """A direction as a vector that points upwards, or to the right, shape (n, 3)."""
    y = np.where(np.abs(y) < 1e-15, 0.0, y)
    sign = np.where((y < 0.0) | ((y == 0.0) & (x < 0.0)), -1.0, 1.0)
    return np.column_stack([sign * x, sign * y, np.zeros(len(x))])
