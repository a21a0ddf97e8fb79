"""Stages of a checked field scene as the host takes them."""

from __future__ import annotations

from typing import Any

from granfabric.fem.loads.amplitude import RAMP, Amplitude, amplitude
from granfabric.fem.loads.control import LoadControl
from granfabric.fem.loads.expression import Expression
from granfabric.fem.loads.kinds import (
    BodyForce,
    Displacement,
    Fixed,
    FixedPoint,
    Pressure,
    RigidBody,
    Spring,
    Stage,
    Traction,
)

from . import closed_forms


def place_function(value: float | str, gradient: list[float]) -> Any:
    """A number, or a function of place: an expression, or what rises from the number at the origin."""
    if isinstance(value, str):
        return Expression(value)
    if not any(gradient):
        return value
    return lambda x, y: value + gradient[0] * x + gradient[1] * y


def _way(part: Any) -> Amplitude | None:
    """Amplitude of a load or a stage; None if it has none of its own."""
    if part.amplitude is None:
        return None
    return amplitude(part.amplitude, 1.0 if part.cycles is None else part.cycles)


def _rigid(load: Any) -> RigidBody:
    return RigidBody(
        load.boundary,
        load.rough,
        (load.force[0], load.force[1]),
        load.moment,
        None if load.point is None else (load.point[0], load.point[1]),
        (load.displacement_x, load.displacement_y),
        load.rotation,
        _way(load),
    )


def stages(scene: Any) -> list[Stage]:
    """Stages of a field scene with their loads."""
    made: list[Stage] = []
    for part in scene.stage:
        loads: list[Any] = [Fixed(load.boundary, tuple(load.components)) for load in part.fixed]
        loads += [FixedPoint((load.point[0], load.point[1]), tuple(load.components)) for load in part.fixed_point]
        loads += [
            Displacement(load.boundary, load.component, place_function(load.value, load.gradient), _way(load))
            for load in part.displacement
        ]
        loads += [
            Pressure(load.boundary, place_function(load.value, load.gradient), _way(load)) for load in part.pressure
        ]
        loads += [
            Traction(load.boundary, (load.value[0], load.value[1]), amplitude=_way(load)) for load in part.traction
        ]
        loads += [
            Traction(
                load.boundary, closed_forms.traction(scene.closed_form, load.factor), "traction of the closed form"
            )
            for load in part.closed_form
        ]
        loads += [BodyForce((load.value[0], load.value[1]), load.region, _way(load)) for load in part.body_force]
        loads += [_rigid(load) for load in part.rigid]
        loads += [Spring(load.boundary, load.normal, load.tangential) for load in part.spring]
        control = None
        if (led := part.control) is not None:
            point = None if led.point is None else (led.point[0], led.point[1])
            control = LoadControl(led.target, led.component, point, led.rigid)
        # an estimate is no place to count displacements from: the first stage has brought it into equilibrium
        settled = len(made) == 1 and getattr(scene.initial, "from") == "gravity"
        made.append(
            Stage(
                part.name,
                loads,
                part.increments,
                part.keep,
                part.drained,
                _way(part) or RAMP,
                control,
                deactivate=part.deactivate,
                activate=part.activate,
                release=part.release,
                fill_pressure=part.fill_pressure,
                reset_displacements=part.reset_displacements or settled,
            )
        )
    return made
