"""Stages that change the body: what they take away, what they add."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from .schema_base import Section

Regions = Annotated[list[Annotated[str, Field(min_length=1)]], Field(max_length=1000)]


class ChangingBody(Section):
    """What a stage takes away and adds: regions of the mesh.

    A region that a stage activates before any stage deactivates it is not there from the outset.
    """

    deactivate: Regions = Field(default=[], description="physical surfaces that are taken away, as by an excavation")
    activate: Regions = Field(
        default=[],
        description="physical surfaces that are added; if no earlier stage takes them away, they are not there before",
    )
    release: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        default=1.0,
        description="share of the forces of excavated parts, this stage's and held ones, released at its end [-]",
    )
    fill_pressure: Annotated[float, Field(ge=0.0)] = Field(
        default=0.0, description="isotropic pressure under which what is added is placed [Pa], compression positive"
    )
    reset_displacements: bool = Field(
        default=False, description="displacements and strains count from the beginning of this stage"
    )

    @model_validator(mode="after")
    def _regions(self) -> ChangingBody:
        for key, names in (("deactivate", self.deactivate), ("activate", self.activate)):
            for name in names:
                if names.count(name) > 1:
                    raise ValueError(f"{key} names region {name!r} twice")
        both = set(self.deactivate) & set(self.activate)
        if both:
            raise ValueError(f"region {min(both)!r} is both in deactivate and in activate")
        if self.fill_pressure and not self.activate:
            raise ValueError(f"fill_pressure = {self.fill_pressure:g}, but the stage activates no region")
        return self
