"""What a scene says about pore fluid: whether a material has one, and the pore pressure before any loading."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

EFFECT, BULK = "pore_fluid", "fluid_bulk_stiffness"


def has_fluid(section: Any) -> bool:
    """Whether a material's table gives a fluid."""
    return bool(getattr(section, BULK) > 0.0)


def is_given(scene: Any) -> bool:
    """Whether a scene gives a pore pressure before any loading."""
    initial = scene.initial
    gradient = getattr(initial, "pore_pressure_gradient", ())
    return bool(initial.pore_pressure or any(gradient) or getattr(initial, "water_level", None) is not None)


def at_start(scene: Any, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pore pressure of a field scene before any loading, shape (npt,) [Pa], compression positive.

    Hydrostatic below the water level and zero above it, or linear in place.
    """
    initial = scene.initial
    if initial.water_level is not None:
        depth: NDArray[np.float64] = np.maximum(initial.water_level - points[:, 1], 0.0)
        return initial.water_unit_weight * depth
    offset = points - np.asarray(initial.reference_point)
    made: NDArray[np.float64] = initial.pore_pressure + offset @ np.asarray(initial.pore_pressure_gradient)
    return made
