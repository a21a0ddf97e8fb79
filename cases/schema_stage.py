"""Loads, stages of loading, and how they are stepped through."""

# ruff: noqa: RUF012  (pydantic copies the default lists of its models)

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from .schema_base import Increments, Line, Pair, Section

Component = Literal["x", "y"]


class FixedLoad(Section):
    """Components of the displacement of a boundary held where they are at the start of the stage."""

    boundary: str
    components: Annotated[list[Component], Field(min_length=1, max_length=2)] = ["x", "y"]


class FixedPointLoad(Section):
    """The node nearest to a point held where it is, to stop a rigid motion."""

    point: Pair = Field(description="x, y [m]")
    components: Annotated[list[Component], Field(min_length=1, max_length=2)] = ["x", "y"]


class DisplacementLoad(Section):
    """One component of the displacement of a boundary, at the end of the stage."""

    boundary: str
    component: Component
    value: float = Field(description="[m], from the unloaded shape")


class PressureLoad(Section):
    """Pressure on a boundary, compression positive, at the end of the stage."""

    boundary: str
    value: float = Field(description="[Pa]")


class TractionLoad(Section):
    """Force per area on a boundary, at the end of the stage."""

    boundary: str
    value: Pair = Field(description="x, y [Pa]")


class BodyForceLoad(Section):
    """Force per volume, at the end of the stage."""

    value: Pair = Field(description="x, y [N/m3]")
    region: str | None = None


class StageSection(Section):
    """One stage of loading: all loads go linearly from their values at the end of the stage before to these.

    A first stage named "initial" holds its loads from the outset, in balance with the initial stress.
    """

    name: Annotated[Line, Field(min_length=1, max_length=80)]
    increments: Increments = 20
    keep: bool = Field(default=True, description="keep what earlier stages set and this one does not name")
    fixed: list[FixedLoad] = []
    fixed_point: list[FixedPointLoad] = []
    displacement: list[DisplacementLoad] = []
    pressure: list[PressureLoad] = []
    traction: list[TractionLoad] = []
    body_force: list[BodyForceLoad] = []


class Solver(Section):
    """Global iteration and load stepping; factors are relative to the nominal step of a stage."""

    linear_solver: Literal["auto", "cholmod", "superlu"] = "auto"
    tolerance: Annotated[float, Field(ge=1e-15, le=1e-1)] = Field(
        default=1e-8, description="residual over nodal forces"
    )
    maximum_iterations: Annotated[int, Field(ge=1, le=10_000)] = 12
    first_factor: Annotated[float, Field(ge=1e-12, le=1e12)] = 1.0
    smallest_factor: Annotated[float, Field(ge=1e-12, le=1.0)] = 1e-4
    largest_factor: Annotated[float, Field(ge=1e-12, le=1e12)] = 1.0
    grow: Annotated[float, Field(ge=1.0, le=100.0)] = 1.5
    tangent_kind: Literal["propagated", "continuum", "elastic"] = "propagated"

    @model_validator(mode="after")
    def _ordered(self) -> Solver:
        if not self.smallest_factor <= self.first_factor <= self.largest_factor:
            raise ValueError(
                f"first_factor = {self.first_factor:g} is not between smallest_factor = {self.smallest_factor:g} and "
                f"largest_factor = {self.largest_factor:g}"
            )
        return self
