"""Scenes of a specimen of disks between two platens and two membranes: `granfabric dem`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from granfabric.dem_ref.specimen.cut import SpecimenOptions
from granfabric.dem_ref.specimen.run import LARGEST

from .schema_base import Positive, Scene, Section
from .schema_dem import Packing

DEFAULTS = SpecimenOptions()

NEEDS: dict[str, str] = {"compression": "axial_strain", "force": "axial_stress", "rest": ""}
ADMITS: dict[str, tuple[str, ...]] = {
    "compression": ("axial_strain", "stress_ratio"),
    "force": ("axial_stress",),
    "rest": (),
}
"""Keys of a leg."""


class SpecimenSection(Section):
    """What bounds the disks: rigid platens below and above, flexible membranes on both sides."""

    height_to_width: Annotated[float, Field(ge=0.1, le=10.0)] | None = Field(
        default=None,
        description="of the specimen [-]: the largest that the cell of the packing holds is cut; all of it, about a "
        "square, if not given",
    )
    platen_friction: Annotated[float, Field(ge=0.0, le=1000.0)] = Field(
        default=DEFAULTS.platen_friction, description="between disks and platens [-]; 0 is smooth"
    )
    lateral_pressure: Positive | None = Field(
        default=None, description="of the membranes [Pa]; that of the packing if not given"
    )
    unit_weight: Annotated[float, Field(ge=0.0, le=1e9)] = Field(
        default=DEFAULTS.unit_weight, description="of the disks, downwards [N/m3]; 0 for no gravity"
    )
    consolidation_friction: Annotated[float, Field(ge=0.0, le=1000.0)] = Field(
        default=DEFAULTS.consolidation_friction,
        description="between disks, and at most that on platens, while the specimen comes together after the cut [-]",
    )


class SpecimenLegSection(Section):
    """One leg: the upper platen moves, carries a force until all is at rest, or stands still until then."""

    loading: Literal["compression", "force", "rest"] = Field(description="what the upper platen does")
    axial_strain: Annotated[float, Field(ge=-LARGEST, le=LARGEST)] | None = Field(
        default=None,
        description="of compression: at the end, since the consolidation, compression positive; a smaller one than "
        "before unloads [-]",
    )
    stress_ratio: Annotated[float, Field(gt=-1.0, lt=1.0)] | None = Field(
        default=None,
        description="of compression: axial less lateral stress over their sum at which the leg ends before [-]",
    )
    axial_stress: Annotated[float, Field(ge=0.0, le=1e300)] | None = Field(
        default=None, description="of force: over the width after the consolidation, compression positive [Pa]"
    )

    @model_validator(mode="after")
    def _keys_fit(self) -> SpecimenLegSection:
        given = {name for name, value in self if value is not None and name != "loading"}
        needed = NEEDS[self.loading]
        if needed and needed not in given:
            raise ValueError(f"loading = {self.loading!r} needs {needed}")
        for name in sorted(given - set(ADMITS[self.loading])):
            takes = ", ".join(ADMITS[self.loading]) or "no other key"
            raise ValueError(f"loading = {self.loading!r} does not take {name} (it takes: {takes})")
        return self


class SpecimenRates(Section):
    """How slow the loading is, and what counts as rest."""

    inertial_number: Annotated[float, Field(ge=1e-12, le=0.1)] = Field(
        default=3e-6,
        description="of a compression: rate of strain times the time that pressure takes to move a disk by its size "
        "[-]",
    )
    unbalanced_force: Annotated[float, Field(ge=1e-8, le=1e-2)] = Field(
        default=DEFAULTS.at_rest,
        description="root mean square resultant on a disk with two contacts or more, over the mean contact force, at "
        "rest [-]",
    )
    longest_rest: Annotated[int, Field(ge=1000, le=1_000_000_000)] = Field(
        default=DEFAULTS.longest_rest, description="steps in which the specimen has to come to rest"
    )


class SpecimenOutput(Section):
    """Cadence of the history and of the files for ParaView."""

    strain_step: Annotated[float, Field(ge=1e-9, le=0.1)] | None = Field(
        default=None,
        description="axial strain between two records of a compression [-]; a fortieth of the largest axial strain if "
        "not given",
    )
    every: Annotated[int, Field(ge=0, le=1_000_000)] = Field(
        default=5, description="disks and contacts every so many records, and the last; 0 for none"
    )
    checkpoint_seconds: Annotated[float, Field(ge=0.0, le=1e6)] = Field(
        default=30.0, description="least time between checkpoints [s]; 0 for one at each record"
    )
    field_cells: Annotated[int, Field(ge=0, le=1000)] = Field(
        default=8,
        description="cells across the specimen of a grid on which contacts, fabric, stress and strain are averaged, "
        "along it as many of the same size, written as often as disks; 0 for none",
    )
    field_kernel: Literal["gaussian", "lucy", "heaviside"] = Field(
        default="lucy", description="of the average on the grid"
    )
    field_scale: Positive | None = Field(
        default=None,
        description="of the kernel over the mean diameter: its radius, of gaussian its standard deviation [-]; "
        "1.5 cells, at least 4 mean diameters, if not given, of gaussian a third of that",
    )
    pictures: bool = Field(default=True, description="draw at the end of the run")


class SpecimenScene(Scene):
    """A specimen of disks between platens and membranes."""

    kind: Literal["specimen"] = Field(description="for `granfabric dem`; follows from the tables if not given")
    packing: Packing = Field(default=Packing(), description="what the specimen is cut from")
    specimen: SpecimenSection = Field(default=SpecimenSection(), description="what bounds it")
    path: Annotated[list[SpecimenLegSection], Field(min_length=1, max_length=10_000)] = Field(
        description="legs of the loading"
    )
    rates: SpecimenRates = Field(default=SpecimenRates(), description="how slow the loading is")
    output: SpecimenOutput = Field(default=SpecimenOutput(), description="what is written")

    @model_validator(mode="after")
    def _grid(self) -> SpecimenScene:
        if self.output.field_cells == 1:
            raise ValueError("output.field_cells = 1 is no grid; legal are 0 for none, and 2 to 1000")
        return self
