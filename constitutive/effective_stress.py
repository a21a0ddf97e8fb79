"""Effective stress of points of any law: what its state says about pore pressure.

The arrays of the contract hold the total stress, in equilibrium with loads; where a law carries a pore pressure, its
skeleton carries ``sigma' = sigma + u m`` with ``m = (1, 1, 0)`` [Terzaghi 1936].
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .contract import Array, LawDescription, Variable

PORE_PRESSURE = Variable("pore_pressure", "pore pressure u, compression positive", "Pa", default=0.0)
"""State column of a law with pore fluid, its last."""


def effective_stress(stress: Array, state: Array, description: LawDescription) -> Array:
    """Effective stress of points of any law: their stress itself if no pore fluid is carried.

    Parameters
    ----------
    stress, state : ndarray, shapes (..., 3), (..., nstate)
        Tension positive [Pa].
    description : LawDescription

    Returns
    -------
    ndarray, shape (..., 3)
    """
    if not description.has_state(PORE_PRESSURE.name):
        return stress
    return with_pressure(stress, state[..., description.columns(PORE_PRESSURE.name)][..., 0])


def with_pressure(stress: Array, pore_pressure: Any) -> Array:
    """``stress + u m``: effective stress from total stress, or with -u the other way; shape (..., 3)."""
    made = np.array(stress, dtype=np.float64)
    made[..., 0] += pore_pressure
    made[..., 1] += pore_pressure
    return made
