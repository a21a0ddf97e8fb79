"""What a contact law can start from: checks of its initial state."""

from __future__ import annotations

import numpy as np

from .arrays import finite
from .contract import Array
from .material_table import PAR_Z
from .parameters import Material, ParameterError


def given_coordination(given: object, npt: int) -> Array:
    """Coordination numbers of a caller, shape (npt,), within the bounds of the parameter.

    Raises
    ------
    ArrayError, ParameterError
    """
    bounds = Material.variables()[PAR_Z]
    z = finite("coordination", given, (npt,))
    wrong = (z < bounds.lower) | (z > bounds.upper)
    if wrong.any():
        raise ParameterError(
            f"coordination = {z[wrong][0]:g} is outside its physical bounds [{bounds.lower:g}, {bounds.upper:g}]"
        )
    return z


def check_fabric(name: str, fabric: tuple[float, float], distribution: str) -> None:
    """Refuse a fabric anisotropy that the directional distribution of contacts cannot have.

    Raises
    ------
    ParameterError
    """
    magnitude, entropy = float(np.hypot(*fabric)), distribution == "maximum_entropy"
    limit = 2.0 if entropy else 1.0
    if magnitude >= limit and not (magnitude == limit and not entropy):
        raise ParameterError(
            f"{name} has the magnitude {magnitude:g}, but the {distribution} "
            f"distribution admits {'less than 2' if entropy else 'at most 1'}"
        )


def check_state(state: Array, stress: Array) -> None:
    """Refuse a state that no forces carry.

    Raises
    ------
    ParameterError
    """
    wrong = ~np.isfinite(state).all(axis=1)
    if wrong.any():
        point = int(np.argmax(wrong))
        raise ParameterError(
            f"the initial stress {stress[point].tolist()} Pa at point {point} has no admissible state: no forces "
            "that push in every direction carry it in this fabric"
        )
