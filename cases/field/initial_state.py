"""Initial stress and state at the integration points of a field scene."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.records.field_history import invariants
from granfabric.cases.scene import build, pore_fluid
from granfabric.cases.scene.reader import LoadedScene
from granfabric.constitutive.effective_stress import with_pressure
from granfabric.constitutive.law import ContactLaw

from .random_field import random_field

Array = NDArray[np.float64]


def stress(loaded: LoadedScene, points: Array) -> Array:
    """Initial stress, linear in place, shape (npt, 3) [Pa], tension positive.

    Raises
    ------
    InputError
        If it is not compressive in every direction everywhere.
    """
    initial = loaded.scene.initial
    offset = points - np.asarray(initial.reference_point)
    rise = np.array([initial.stress_gradient_x, initial.stress_gradient_y])
    values = np.asarray(initial.stress) + offset @ rise
    pressure, deviator = invariants(values)
    if not (pressure > deviator).all():
        worst = int(np.argmin(pressure - deviator))
        x, y = points[worst]
        raise loaded.error(
            ["initial"],
            "initial: the stress must be compressive in every direction (tension is positive), but at "
            f"({x:.4g}, {y:.4g}) m the mean pressure {pressure[worst]:.4g} Pa is not above the deviator "
            f"{deviator[worst]:.4g} Pa",
        )
    return values


def with_water(
    loaded: LoadedScene, law: ContactLaw, points: Array, effective: Array, material_index: NDArray[np.int32] | None
) -> tuple[Array, Array | None]:
    """Total stress, shape (npt, 3) [Pa], and state, if it is not what the law makes of that stress alone.

    Raises
    ------
    InputError
        As `random_state`.
    """
    if not law.effects.pore_fluid or not pore_fluid.is_given(loaded.scene):
        return effective, random_state(loaded, law, points, effective, material_index)
    pressure = pore_fluid.at_start(loaded.scene, points)
    total = with_pressure(effective, -pressure)
    state = random_state(loaded, law, points, total, material_index, pore_pressure=pressure)
    if state is None:
        state = law.initial_state(total, material_index, pore_pressure=pressure)
    return total, state


def random_state(
    loaded: LoadedScene,
    law: ContactLaw,
    points: Array,
    initial_stress: Array,
    material_index: NDArray[np.int32] | None,
    **water: Array,
) -> Array | None:
    """State with a random coordination number, shape (npt, nstate); None if the scene has no random state.

    Raises
    ------
    InputError
        If the variation leaves the physical bounds of the coordination number.
    """
    random = loaded.scene.random_state
    if random is None:
        return None
    lengths = random.correlation_length
    field = random_field(points, random.seed, (lengths[0], lengths[1]), random.correlation)
    means = np.array([material.coordination for material, _ in build.materials(loaded.scene)])
    index: Any = 0 if material_index is None else material_index
    coordination = means[index] + random.standard_deviation * field
    low, high = _bounds(loaded, law)
    if not (coordination > low).all() or not (coordination < high).all():
        raise loaded.error(
            ["random_state"],
            f"random_state: the coordination number would run from {coordination.min():.4g} to "
            f"{coordination.max():.4g}, outside of ({low:g}, {high:g}); use a smaller standard_deviation",
        )
    return law.initial_state(initial_stress, material_index, coordination=coordination, **water)


def _bounds(loaded: LoadedScene, law: ContactLaw) -> tuple[float, float]:
    """Coordination numbers at which shear stiffness vanishes and at which every neighbour is in contact."""
    isostatic = law.closure.shear_stiffness == "isostatic"
    low = max(material.isostatic_coordination if isostatic else 0.0 for material in law.materials)
    return low, min(material.neighbours for material in law.materials)
