"""Loads, stages of loading, and how they are stepped through."""

# ruff: noqa: RUF012  (pydantic copies the default lists of its models)

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from .schema_amplitude import (
    AMPLITUDE,
    CYCLES,
    OWN_AMPLITUDE,
    AmplitudeValue,
    CycleCount,
    Value,
    ValuePair,
    check_cycles,
    check_gradient,
)
from .schema_base import Increments, Line, Pair, Section
from .schema_bodies import Boundary, ControlSection, RigidLoad, SpringLoad
from .schema_body import ChangingBody
from .schema_closed_form import ClosedFormLoad

Component = Literal["x", "y"]
Components = Annotated[list[Component], Field(min_length=1, max_length=2, description="directions that are held")]


DRAINED = "pore fluid can leave: its pressure stays as it is, the skeleton carries every change"


class FixedLoad(Section):
    """Components of the displacement of a boundary held where they are at the start of the stage."""

    boundary: Boundary
    components: Components = ["x", "y"]


class FixedPointLoad(Section):
    """The node nearest to a point held where it is, to stop a rigid motion."""

    point: Pair = Field(description="x, y [m]")
    components: Components = ["x", "y"]


class DisplacementLoad(Section):
    """One component of the displacement of a boundary, at the end of the stage."""

    boundary: Boundary
    component: Component = Field(description="direction of the displacement")
    value: Value = Field(
        description="[m], from the unloaded shape: a number (with a gradient, at the origin) or an expression"
    )
    gradient: Pair = Field(default=[0.0, 0.0], description="rise of the value along x and y [-]")
    amplitude: AmplitudeValue = Field(default=None, description=OWN_AMPLITUDE)
    cycles: CycleCount = Field(default=None, description=CYCLES)

    _cycles = model_validator(mode="after")(check_cycles)
    _gradient = model_validator(mode="after")(check_gradient)


class PressureLoad(Section):
    """Pressure on a boundary, compression positive, at the end of the stage."""

    boundary: Boundary
    value: Value = Field(description="[Pa]: a number (with a gradient, at the origin) or an expression")
    gradient: Pair = Field(default=[0.0, 0.0], description="rise of the pressure along x and y [Pa/m]")
    amplitude: AmplitudeValue = Field(default=None, description=OWN_AMPLITUDE)
    cycles: CycleCount = Field(default=None, description=CYCLES)

    _cycles = model_validator(mode="after")(check_cycles)
    _gradient = model_validator(mode="after")(check_gradient)


class TractionLoad(Section):
    """Force per area on a boundary, at the end of the stage."""

    boundary: Boundary
    value: ValuePair = Field(description="x, y [Pa], numbers or expressions")
    amplitude: AmplitudeValue = Field(default=None, description=OWN_AMPLITUDE)
    cycles: CycleCount = Field(default=None, description=CYCLES)

    _cycles = model_validator(mode="after")(check_cycles)


class BodyForceLoad(Section):
    """Force per volume, at the end of the stage."""

    value: ValuePair = Field(description="x, y [N/m3], numbers or expressions")
    region: str | None = Field(default=None, description="physical surface that carries it; everything if not given")
    amplitude: AmplitudeValue = Field(default=None, description=OWN_AMPLITUDE)
    cycles: CycleCount = Field(default=None, description=CYCLES)

    _cycles = model_validator(mode="after")(check_cycles)


class StageSection(ChangingBody):
    """One stage of loading: all loads go from their values at the end of the stage before to these.

    They go linearly, or as `amplitude` says.

    A first stage named "initial" holds its loads from the outset, in balance with the initial stress. What they do not
    balance, which the run says before its first step, fades out over the first stage; of a first stage with another
    name no load acts at the outset. Later stages may take regions away and add others: loads act on what is there.
    """

    name: Annotated[Line, Field(min_length=1, max_length=80)] = Field(description="of the stage; names must differ")
    increments: Increments = Field(default=20, description="load steps to begin with")
    drained: bool = Field(default=False, description=DRAINED)
    keep: bool = Field(default=True, description="keep what earlier stages set and this one does not name")
    fixed: list[FixedLoad] = Field(default=[], description="boundaries held where they are")
    fixed_point: list[FixedPointLoad] = Field(default=[], description="nodes held where they are")
    displacement: list[DisplacementLoad] = Field(default=[], description="boundaries moved")
    pressure: list[PressureLoad] = Field(default=[], description="boundaries under pressure")
    traction: list[TractionLoad] = Field(default=[], description="boundaries under force per area")
    body_force: list[BodyForceLoad] = Field(default=[], description="force per volume, for instance gravity")
    closed_form: list[ClosedFormLoad] = Field(
        default=[], description="boundaries under the traction of the scene's closed form, beside other loads"
    )
    rigid: list[RigidLoad] = Field(default=[], description="boundaries tied to rigid bodies")
    spring: list[SpringLoad] = Field(default=[], description="boundaries on springs")
    amplitude: AmplitudeValue = Field(default="ramp", description=f"of loads without one of their own: {AMPLITUDE}")
    cycles: CycleCount = Field(default=None, description=CYCLES)
    control: ControlSection | None = Field(default=None, description="displacement that leads the loads of the stage")

    _cycles = model_validator(mode="after")(check_cycles)


class Solver(Section):
    """Global iteration and load stepping; factors are relative to the nominal step of a stage."""

    linear_solver: Literal["auto", "cholmod", "superlu"] = Field(
        default="auto", description="direct solver; auto takes the fastest that is installed"
    )
    tolerance: Annotated[float, Field(ge=1e-15, le=1e-1)] = Field(
        default=1e-8, description="residual over nodal forces [-]"
    )
    maximum_iterations: Annotated[int, Field(ge=1, le=10_000)] = Field(
        default=12, description="Newton iterations before a step is cut"
    )
    first_factor: Annotated[float, Field(ge=1e-12, le=1e12)] = Field(default=1.0, description="first step [-]")
    smallest_factor: Annotated[float, Field(ge=1e-12, le=1.0)] = Field(
        default=1e-4, description="step below which the run gives up [-]"
    )
    largest_factor: Annotated[float, Field(ge=1e-12, le=1e12)] = Field(default=1.0, description="largest step [-]")
    grow: Annotated[float, Field(ge=1.0, le=100.0)] = Field(
        default=1.5, description="growth of the step after an easy one [-]"
    )
    tangent_kind: Literal["propagated", "continuum", "elastic"] = Field(
        default="propagated", description="exact derivative of the update, that of the rates, or the stiffness alone"
    )

    @model_validator(mode="after")
    def _ordered(self) -> Solver:
        if not self.smallest_factor <= self.first_factor <= self.largest_factor:
            raise ValueError(
                f"first_factor = {self.first_factor:g} is not between smallest_factor = {self.smallest_factor:g} and "
                f"largest_factor = {self.largest_factor:g}"
            )
        return self
