"""A field known at scattered points, evaluated at others: a quadratic polynomial through the nearest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]

NEIGHBOURS = 18
"""Points for the six coefficients; on boundaries they lie on one side."""


def local_fit(known: Array, values: Array, wanted: Array) -> Array:
    """Weighted least-squares fit of a quadratic polynomial around each wanted place.

    Second-order polynomials come out exactly; on a boundary the fit extrapolates by half an element. The six points
    nearest count most, so that a jump further away does little.

    Parameters
    ----------
    known : ndarray, shape (n, 2)
    values : ndarray, shape (n, k)
    wanted : ndarray, shape (m, 2)

    Returns
    -------
    ndarray, shape (m, k)
    """
    count = min(NEIGHBOURS, len(known))
    distance, near = cKDTree(known).query(wanted, k=count)
    reach = distance[:, -1:] * 1.01
    offset = (known[near] - wanted[:, None, :]) / reach[:, :, None]
    x, y = offset[:, :, 0], offset[:, :, 1]
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2)
    root = np.sqrt((1.0 - (distance / reach) ** 2) ** 2)[:, :, None]
    inverse = np.linalg.pinv(root * terms, rcond=1e-8)
    return np.asarray(np.einsum("mj,mjk->mk", inverse[:, 0, :], root * values[near]))
