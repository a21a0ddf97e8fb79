"""State before any loading."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Field, create_model, model_validator

from .schema_base import Pair, Positive, Section, Triple

STRESS = "xx, yy, xy [Pa], tension positive; the effective stress, where there is pore fluid"
PRESSURE = "of the pore fluid [Pa], compression positive; added to the initial stress, which is the effective one"


class Initial(Section):
    """State before any loading."""

    stress: Triple = Field(description=STRESS)

    @model_validator(mode="after")
    def _compressive(self) -> Initial:
        xx, yy, xy = self.stress
        pressure, deviator = -(xx / 2 + yy / 2), math.hypot(xx / 2 - yy / 2, xy)
        if not pressure > deviator:
            raise ValueError(
                f"the initial stress must be compressive in every direction (tension is positive): mean pressure "
                f"{pressure:g} Pa is not above the deviator {deviator:g} Pa; for a pressure of 100 kPa write "
                "[-100e3, -100e3, 0.0]"
            )
        return self


class PointInitial(Section):
    """State of a point before any loading; with `state` from the middle of a run, as `failed_point.toml` has it."""

    stress: Triple = Field(description=STRESS)
    pore_pressure: float = Field(default=0.0, description=PRESSURE)
    state: dict[str, float | list[float]] | None = Field(
        default=None, description="every state variable of the law by name, if not those of the packing"
    )

    @model_validator(mode="after")
    def _compressive(self) -> PointInitial:
        if self.state is None:
            Initial(stress=self.stress)
        elif not self.stress[0] / 2 + self.stress[1] / 2 < 0.0:  # in the middle of a run q may exceed p
            raise ValueError("the initial stress needs a positive mean pressure (tension is positive)")
        if self.state is not None and self.pore_pressure:
            raise ValueError("pore_pressure goes with the state of a packing; a whole state has one of its own")
        return self


K0 = Annotated[float, Field(gt=0.0, le=100.0)]

_SOURCE: Any = {  # "from" is a word of Python
    "from": (
        Literal["stress", "weight", "gravity"],
        Field(
            "stress",
            description="given by `stress`; geostatic, from weight and surcharge of the first stage, below level "
            "ground; or an estimate of that below sloping ground, which the first stage brings into equilibrium",
        ),
    )
}
_Source: Any = create_model("_Source", __base__=Section, **_SOURCE)


class FieldInitial(_Source):  # type: ignore[misc]
    """State before any loading, everywhere. With a gradient, `stress` holds at the `reference_point`.

    With `from = "weight"` the vertical stress is what lies above: weights are the `body_force` of the first stage,
    which has to be named "initial", surcharge its pressure on the surface; the horizontal stress is `k0` times that.
    With `from = "gravity"` displacements count from the end of the first stage.
    """

    stress: Triple | None = Field(default=None, description=STRESS)
    stress_gradient_x: Triple = Field(default=[0.0, 0.0, 0.0], description="rise of xx, yy, xy along x [Pa/m]")
    stress_gradient_y: Triple = Field(
        default=[0.0, 0.0, 0.0],
        description="rise of xx, yy, xy along y [Pa/m]; of yy the unit weight, where the ground is level",
    )
    reference_point: Pair = Field(default=[0.0, 0.0], description="where `stress` holds: x, y [m]")
    k0: K0 | dict[str, K0] | None = Field(
        default=None,
        description="horizontal over vertical (effective) stress where weight gives it [-], of all or by region: "
        "`{ upper = 0.5, lower = 0.6 }`",
    )
    pore_pressure: float = Field(default=0.0, description=PRESSURE + "; with a gradient, at the `reference_point`")
    pore_pressure_gradient: Pair = Field(default=[0.0, 0.0], description="rise of it along x and y [Pa/m]")
    water_level: float | None = Field(
        default=None, description="y of the water table [m]: hydrostatic pore pressure below it, none above it"
    )
    water_unit_weight: Positive = Field(default=9810.0, description="by which it rises below the water table [N/m3]")
    balance: bool = Field(
        default=False,
        description="constant reference forces balance what initial stress and loads at the outset leave; otherwise it "
        "fades out over the first stage",
    )

    @model_validator(mode="after")
    def _complete(self) -> FieldInitial:
        source = getattr(self, "from")
        if source == "stress":
            if self.stress is None:
                raise ValueError('stress is missing (or from = "weight" with k0)')
            if self.k0 is not None:
                raise ValueError('k0 goes with from = "weight" or from = "gravity"')
            if not any(self.stress_gradient_x) and not any(self.stress_gradient_y):
                Initial(stress=self.stress)
            return self
        if self.k0 is None:
            raise ValueError(f'from = "{source}" needs k0, horizontal over vertical stress')
        if self.k0 == {}:
            raise ValueError("k0 names no region")
        given = [key for key in ("stress", "stress_gradient_x", "stress_gradient_y") if key in self.model_fields_set]
        if given and any(any(getattr(self, key) or ()) for key in given):
            raise ValueError(f'from = "{source}" takes the stress from the weight; leave out {", ".join(given)}')
        if source == "gravity" and self.balance:
            raise ValueError('from = "gravity" brings the initial stress into equilibrium; leave out balance')
        return self

    @model_validator(mode="after")
    def _one_pressure(self) -> FieldInitial:
        if self.water_level is not None and (self.pore_pressure or any(self.pore_pressure_gradient)):
            raise ValueError(
                "water_level gives a pore pressure of its own: leave out pore_pressure and pore_pressure_gradient"
            )
        return self


class RandomState(Section):
    """Random variation of the initial coordination number about that of the material, from place to place."""

    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = Field(description="the same seed gives the same specimen")
    standard_deviation: Annotated[float, Field(ge=0.0, le=2.0)] = Field(description="of the coordination number z [-]")
    correlation_length: Annotated[list[Positive], Field(min_length=2, max_length=2)] = Field(
        description="along x and y [m]"
    )
    correlation: Literal["gaussian", "exponential"] = Field(
        default="gaussian", description="exp(-d^2) or exp(-d), d being the distance over the correlation length"
    )
