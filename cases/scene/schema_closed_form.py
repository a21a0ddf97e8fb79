"""Closed forms that a field scene may be compared with; `closed_forms.py` holds the formulas."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from .schema_base import Pair, Positive, Section, Triple


class ThickCylinder(Section):
    """Ring around the origin under pressure inside and outside (Lame)."""

    inner_radius: Positive = Field(description="[m]")
    outer_radius: Positive = Field(description="[m]")
    inner_pressure: float = Field(default=0.0, description="rise since the initial state [Pa]")
    outer_pressure: float = Field(default=0.0, description="rise since the initial state [Pa]")

    @model_validator(mode="after")
    def _not_empty(self) -> ThickCylinder:
        if not self.inner_radius < self.outer_radius:
            raise ValueError(f"the outer radius {self.outer_radius:g} is not above the inner {self.inner_radius:g}")
        return self


class HoleInPlate(Section):
    """Circular hole in a plate without end under uniform stress (Kirsch)."""

    radius: Positive = Field(description="of the hole [m]")
    centre: Pair = Field(default=[0.0, 0.0], description="of the hole: x, y [m]")
    stress: Triple = Field(default=[0.0, 0.0, 0.0], description="far away: change since the initial state [Pa]")
    pressure: float = Field(default=0.0, description="in the hole: rise since the initial state [Pa]")


class StripLoad(Section):
    """Uniform pressure on a strip of the surface of a half-plane (Flamant, Boussinesq)."""

    half_width: Positive = Field(description="of the strip [m]")
    centre: Pair = Field(description="of the strip, on the surface: x, y [m]; the body lies below")
    pressure: float = Field(description="rise since the initial state [Pa]")


class ClosedForm(Section):
    """Stress change since the initial state in closed form, for constant stiffness; the run is compared with it.

    One form, and if wanted a line along which both are tabulated and drawn.
    """

    thick_cylinder: ThickCylinder | None = Field(default=None, description="Lame's ring under pressure")
    hole_in_plate: HoleInPlate | None = Field(default=None, description="Kirsch's hole in a plate under stress")
    strip_load: StripLoad | None = Field(default=None, description="Flamant's strip load on a half-plane")
    line: Annotated[list[Pair], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="first and last point [m] of the line along which stresses are compared"
    )
    components: Annotated[list[Literal["xx", "yy", "xy"]], Field(min_length=1, max_length=3)] = Field(
        default=["xx", "yy"], description="stress components shown along the line"
    )

    @model_validator(mode="after")
    def _one_form(self) -> ClosedForm:
        given = [name for name in FORMS if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"closed_form takes exactly one of {', '.join(FORMS)}, not {len(given)}")
        if self.line is not None and self.line[0] == self.line[1]:
            raise ValueError("closed_form.line: the two points coincide")
        return self

    @property
    def name(self) -> str:
        """Key of the form that is given."""
        return next(name for name in FORMS if getattr(self, name) is not None)


FORMS = ("thick_cylinder", "hole_in_plate", "strip_load")


class ClosedFormLoad(Section):
    """Tractions of the closed form on a boundary, at the end of the stage, on top of what else acts there."""

    boundary: str = Field(description="physical curve of the mesh")
    factor: float = Field(default=1.0, description="fraction of the closed form's traction [-]")
