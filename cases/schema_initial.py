"""State before any loading."""

from __future__ import annotations

import math

from pydantic import Field, model_validator

from .schema_base import Section, Triple


class Initial(Section):
    """State before any loading."""

    stress: Triple = Field(description="xx, yy, xy [Pa], tension positive")

    @model_validator(mode="after")
    def _compressive(self) -> Initial:
        xx, yy, xy = self.stress
        pressure, deviator = -(xx / 2 + yy / 2), math.hypot(xx / 2 - yy / 2, xy)
        if not pressure > deviator:
            raise ValueError(
                f"the initial stress has to press in every direction (tension is positive): mean pressure "
                f"{pressure:g} Pa is not above the deviator {deviator:g} Pa; for a pressure of 100 kPa write "
                "[-100e3, -100e3, 0.0]"
            )
        return self


class PointInitial(Section):
    """State of a point before any loading; with `state` from the middle of a run, as `failed_point.toml` has it."""

    stress: Triple = Field(description="xx, yy, xy [Pa], tension positive")
    state: dict[str, float | list[float]] | None = Field(
        default=None, description="every state variable of the law by name, if not those of the packing"
    )

    @model_validator(mode="after")
    def _compressive(self) -> PointInitial:
        if self.state is None:
            Initial(stress=self.stress)
        elif not self.stress[0] / 2 + self.stress[1] / 2 < 0.0:  # in the middle of a run q may exceed p
            raise ValueError("the initial stress needs a positive mean pressure (tension is positive)")
        return self


class FieldInitial(Initial):
    """State before any loading, everywhere."""

    balance: bool = Field(default=False, description="balance the initial stress by constant reference forces")
