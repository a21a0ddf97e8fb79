"""Initial stress and state at the integration points of a field scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.records.field_history import invariants
from granfabric.cases.scene import build, pore_fluid
from granfabric.cases.scene.reader import LoadedScene
from granfabric.constitutive.effective_stress import with_pressure
from granfabric.constitutive.law import ContactLaw
from granfabric.fem.discretisation.space import Space
from granfabric.fem.loads.bodies import inactive_at_outset
from granfabric.fem.loads.fills import stress_with_fills
from granfabric.fem.loads.geostatic import geostatic_stress
from granfabric.fem.loads.kinds import LoadError, Stage
from granfabric.fem.mesh.checks import MeshError

from .random_field import random_field

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def stress(loaded: LoadedScene, space: Space, stages: Sequence[Stage], wet: bool) -> Array:
    """Initial effective stress, shape (npt, 3) [Pa], tension positive: linear in place, or from weight and surcharge.

    Where nothing is from the outset it is that of the placement. `wet` tells whether the law has pore fluid.

    Raises
    ------
    InputError
        If it is not compressive in every direction everywhere, or does not follow from the weight.
    LoadError, MeshError
        If stages change the body in a way that is not possible.
    """
    there = ~inactive_at_outset(space.host_mesh, stages)[space.point_cell]
    source = getattr(loaded.scene.initial, "from")
    values = (
        _linear(loaded, space.points, there) if source == "stress" else _geostatic(loaded, space, stages, wet, there)
    )
    return values if there.all() else stress_with_fills(space, stages, values)


def _geostatic(loaded: LoadedScene, space: Space, stages: Sequence[Stage], wet: bool, there: Mask) -> Array:
    """Stress from weight; of wet ground weight gives the total stress, and K0 is that of the effective one."""
    initial = loaded.scene.initial
    source = getattr(initial, "from")
    try:
        total = geostatic_stress(space, stages, initial.k0, level=source == "weight")
    except (LoadError, MeshError) as error:
        raise loaded.error(["initial"], f'initial.from = "{source}": {error}') from error
    if not wet or not pore_fluid.is_given(loaded.scene):
        return total
    carried = np.zeros_like(total)
    ratio = total[there, 0] / total[there, 1]
    carried[there, 1] = total[there, 1] + pore_fluid.at_start(loaded.scene, space.points)[there]
    carried[there, 0] = ratio * carried[there, 1]
    light = np.flatnonzero(there & (carried[:, 1] >= 0.0))
    if light.size:
        x, y = space.points[light[0]]
        raise loaded.error(
            ["initial"],
            f'initial.from = "{source}": at ({x:.4g}, {y:.4g}) m the pore pressure is not below the weight of what '
            "lies above, so that the grains carry nothing there",
        )
    return carried


def refuse_beyond_law(
    loaded: LoadedScene, law: ContactLaw, values: Array, material_index: NDArray[np.int32] | None
) -> None:
    """See that sliding admits the initial stress.

    Raises
    ------
    InputError
        With the values of K0 that it admits, if they gave the stress.
    """
    if not law.effects.sliding:
        return
    index = np.zeros(len(values), dtype=np.int64) if material_index is None else material_index
    peak = np.array([material.peak_stress_ratio for material in law.materials])[index]
    cohesion = np.array([material.apparent_cohesion for material in law.materials])[index]
    pressure, deviator = invariants(values)
    beyond = np.flatnonzero((pressure > 0.0) & (deviator >= peak * (pressure + cohesion)))
    if not beyond.size:
        return
    point = int(beyond[0])
    text = (
        f"q/(p + c) = {deviator[point] / (pressure[point] + cohesion[point]):.4g} somewhere in it, but sliding admits "
        f"less than material.peak_stress_ratio = {peak[point]:g}"
    )
    if getattr(loaded.scene.initial, "from") == "stress":
        raise loaded.error(["initial", "stress"], f"initial.stress has {text}")
    least = (1.0 - peak[point]) / (1.0 + peak[point])
    raise loaded.error(
        ["initial", "k0"],
        f"initial.k0 gives {text}; without cohesion k0 has to lie between {least:.3g} and {1 / least:.3g}",
    )


def _linear(loaded: LoadedScene, points: Array, there: Mask) -> Array:
    """Stress that is linear in place, checked where something is."""
    initial = loaded.scene.initial
    offset = points - np.asarray(initial.reference_point)
    rise = np.array([initial.stress_gradient_x, initial.stress_gradient_y])
    values = np.asarray(initial.stress) + offset @ rise
    pressure, deviator = invariants(values)
    margin = np.where(there, pressure - deviator, np.inf)
    if not (margin > 0.0).all():
        worst = int(np.argmin(margin))
        x, y = points[worst]
        raise loaded.error(
            ["initial"],
            "initial: the stress must be compressive in every direction (tension is positive), but at "
            f"({x:.4g}, {y:.4g}) m the mean pressure {pressure[worst]:.4g} Pa is not above the deviator "
            f"{deviator[worst]:.4g} Pa",
        )
    return values


def with_water(
    loaded: LoadedScene,
    law: ContactLaw,
    space: Space,
    stages: Sequence[Stage],
    effective: Array,
    material_index: NDArray[np.int32] | None,
) -> tuple[Array, Array | None]:
    """Total stress, shape (npt, 3) [Pa], and state, if it is not what the law makes of that stress alone.

    What is not there from the outset is placed without pore pressure.

    Raises
    ------
    InputError
        As `random_state`.
    """
    if not law.effects.pore_fluid or not pore_fluid.is_given(loaded.scene):
        return effective, random_state(loaded, law, space.points, effective, material_index)
    pressure = pore_fluid.at_start(loaded.scene, space.points)
    pressure[inactive_at_outset(space.host_mesh, stages)[space.point_cell]] = 0.0
    total = with_pressure(effective, -pressure)
    state = random_state(loaded, law, space.points, total, material_index, pore_pressure=pressure)
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
