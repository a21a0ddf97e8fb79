"""Rigid bodies and springs on a boundary, and a displacement that leads the loads of a stage."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from .schema_amplitude import CYCLES, OWN_AMPLITUDE, AmplitudeValue, CycleCount, Value, check_cycles
from .schema_base import Pair, Section

Boundary = Annotated[str, Field(description="physical curve of the mesh, or the name of a part of one")]


class RigidLoad(Section):
    """A rigid body joined to a boundary: a footing, a platen; pushed by a force, or moved as a whole.

    What is neither displaced nor held follows from force and moment. All per length out of plane; rotation and moment
    anticlockwise.
    """

    boundary: Boundary
    rough: bool = Field(default=True, description="false: nodes slide along the boundary")
    force: Pair = Field(default=[0.0, 0.0], description="x, y, at the end of the stage [N/m]")
    moment: float = Field(default=0.0, description="about the point, at the end of the stage [N m/m]")
    point: Pair | None = Field(
        default=None, description="where the force acts and the displacement is that of [m]; the middle of the boundary"
    )
    displacement_x: float | None = Field(default=None, description="of the point, total at the end of the stage [m]")
    displacement_y: float | None = Field(default=None, description="of the point, total at the end of the stage [m]")
    rotation: Literal["free", "fixed"] | float = Field(
        default="free", description='"free", "fixed", or the total at the end of the stage [rad]'
    )
    amplitude: AmplitudeValue = Field(default=None, description=OWN_AMPLITUDE)
    cycles: CycleCount = Field(default=None, description=CYCLES)

    _cycles = model_validator(mode="after")(check_cycles)


class SpringLoad(Section):
    """Springs between a boundary and ground that does not move, without force where the stage finds the boundary."""

    boundary: Boundary
    normal: Value = Field(default=0.0, description="stiffness per area across the boundary, or an expression [Pa/m]")
    tangential: Value = Field(default=0.0, description="stiffness per area along the boundary, or an expression [Pa/m]")

    @model_validator(mode="after")
    def _stiff(self) -> SpringLoad:
        for name in ("normal", "tangential"):
            value = getattr(self, name)
            if not isinstance(value, str) and value < 0.0:
                raise ValueError(f"{name} = {value:g} is negative; a stiffness per area is in [0, inf) Pa/m")
        if self.normal == 0.0 and self.tangential == 0.0:
            raise ValueError("a spring without stiffness; give normal or tangential [Pa/m]")
        return self


class ControlSection(Section):
    """A displacement that leads: the loads which the stage names follow it with one factor, past a peak as well."""

    target: float = Field(description="displacement at the end of the stage [m], of a rotation the angle in rad")
    component: Literal["x", "y", "rotation"] = Field(default="y", description="what is led; rotation of a rigid body")
    point: Pair | None = Field(default=None, description="the node nearest to it is led [m]")
    rigid: str | None = Field(default=None, description="boundary of a rigid body that is led instead")

    @model_validator(mode="after")
    def _one(self) -> ControlSection:
        if (self.point is None) == (self.rigid is None):
            raise ValueError("control needs either point or rigid, the boundary of a rigid body")
        if self.point is not None and self.component == "rotation":
            raise ValueError("only a rigid body has a rotation; of a point take component x or y")
        return self
