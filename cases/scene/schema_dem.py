"""Scenes of the discrete element method: a packing of disks and its loading."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from granfabric.dem_ref.dynamics.packing import PREPARATION
from granfabric.dem_ref.inputs.weak_contacts import LOOP_STRESS_RATIO
from granfabric.dem_ref.measures.coarse_graining import GAUSSIAN_REACH

from .schema_base import Control, Positive, Scene, Section, Triple

Loading = Literal["constant_pressure", "constant_lateral_stress", "isotropic", "invariants", "rotation", "components"]

NEEDS: dict[str, tuple[str, ...]] = {
    "constant_pressure": ("stress_ratio",),
    "constant_lateral_stress": ("stress_ratio",),
    "isotropic": ("pressure_ratio",),
    "invariants": (),
    "rotation": ("rotation_degrees",),
    "components": ("control", "target"),
}
ADMITS: dict[str, tuple[str, ...]] = {
    "constant_pressure": ("largest_strain", "direction_degrees"),
    "constant_lateral_stress": ("largest_strain", "direction_degrees"),
    "isotropic": (),
    "invariants": ("pressure_ratio", "stress_ratio", "direction_degrees"),
    "rotation": (),
    "components": ("relative",),
}
"""Keys of a leg that a loading must have, and may have besides."""


class Packing(Section):
    """Disks in a periodic cell, compacted with or without friction, friction as wanted afterwards."""

    particles: Annotated[int, Field(ge=50, le=1_000_000)] = Field(default=2000, description="number of disks")
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = Field(
        default=1, description="the same seed gives the same packing"
    )
    stiffness_to_pressure: Annotated[float, Field(ge=50.0, le=1e6)] = Field(
        default=1e4, description="normal contact stiffness over mean pressure, kn/p [-]"
    )
    normal_stiffness: Positive = Field(default=1e9, description="kn [Pa]")
    stiffness_ratio: Annotated[float, Field(ge=1e-6, le=1.0)] = Field(default=1.0, description="kt/kn [-]")
    friction: Annotated[float, Field(ge=0.0, le=1000.0)] = Field(
        default=0.5, description="coefficient after packing [-]"
    )
    preparation_friction: Annotated[float, Field(ge=0.0, le=1000.0)] | None = Field(
        default=None,
        description="coefficient during compaction [-], at most that after packing: the larger, the looser; none if "
        "not given",
    )
    coordination: Annotated[float, Field(ge=2.5, le=5.0)] | None = Field(
        default=None,
        description="wanted coordination number [-], counted as measure.rattlers says: the friction during compaction "
        "that gives it is searched, to within 0.01 or the scatter of a packing of that size",
    )
    solid_fraction: Annotated[float, Field(ge=0.6, le=0.95)] | None = Field(
        default=None,
        description="wanted area of the disks over that of the cell [-]: the friction during compaction that gives it "
        "is searched",
    )
    diameter_ratio: Annotated[float, Field(ge=1.0, le=5.0)] = Field(
        default=1.25, description="largest over smallest [-]"
    )
    distribution: Literal["uniform", "uniform_area", "bidisperse", "monodisperse", "lognormal", "given"] = Field(
        default="uniform",
        description="of the diameters: uniform by number or by area, two sizes, one, lognormal by number between the "
        "extremes of diameter_ratio, or as grading_file gives it",
    )
    size_deviation: Annotated[float, Field(gt=0.0, le=3.0)] | None = Field(
        default=None,
        description="of lognormal: standard deviation of the logarithm of the diameter [-]; a quarter of "
        "ln(diameter_ratio) if not given",
    )
    grading_file: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="CSV file, relative to this one, with size (diameter in m) and passing_by_area, passing_by_mass or "
        "passing_by_number, from 0 to 1 or 100 per cent",
    )
    mean_diameter: Positive = Field(default=1.0, description="by number [m]")

    @model_validator(mode="after")
    def _keys_fit(self) -> Packing:
        given = [name for name in PREPARATION if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f"{' and '.join(given)} are given; one of them decides the friction during compaction")
        if self.preparation_friction is not None and self.preparation_friction > self.friction:
            raise ValueError(
                f"preparation_friction = {self.preparation_friction:g} is above friction = {self.friction:g}: a "
                "packing falls together when its friction falls"
            )
        if self.size_deviation is not None and self.distribution != "lognormal":
            raise ValueError(f"size_deviation goes with distribution = 'lognormal', not with {self.distribution!r}")
        if self.distribution == "given" and self.grading_file is None:
            raise ValueError("distribution = 'given' needs grading_file")
        if self.grading_file is not None:
            if self.distribution != "given":
                raise ValueError(f"grading_file goes with distribution = 'given', not with {self.distribution!r}")
            # a scene as resolved holds defaults of these too
            for name, default in (("mean_diameter", 1.0), ("diameter_ratio", 1.25)):
                if getattr(self, name) != default:
                    raise ValueError(f"{name} follows from grading_file; leave it out")
        return self


class DemLeg(Section):
    """One leg of loading. Ratios of pressure refer to the packing; directions are those of the major compression."""

    loading: Loading = Field(description="what is driven and what is held")
    stress_ratio: Annotated[float, Field(gt=-1.0, lt=1.0)] | None = Field(
        default=None, description="q/p at the end, negative across the direction [-]"
    )
    pressure_ratio: Annotated[float, Field(gt=0.0, le=100.0)] | None = Field(
        default=None, description="mean pressure at the end over that of the packing [-]"
    )
    direction_degrees: Annotated[float, Field(ge=-360.0, le=360.0)] | None = Field(
        default=None, description="from the x axis [degrees]; that of the leg before, 90 (along y) at first"
    )
    largest_strain: Annotated[float, Field(gt=0.0, le=0.5)] | None = Field(
        default=None, description="change of the driven strain at which a leg ends at the latest [-]; 0.02 if not given"
    )
    rotation_degrees: Annotated[float, Field(ge=-36_000, le=36_000)] | None = Field(
        default=None, description="rotation of the principal stress axes at constant p and q, anticlockwise [degrees]"
    )
    control: Annotated[list[Control], Field(min_length=3, max_length=3)] | None = Field(
        default=None, description='per component xx, yy, xy: "stress" or "strain"'
    )
    target: Triple | None = Field(
        default=None, description="value at the end of the leg [Pa or -], tension positive, shear strain as gamma_xy"
    )
    relative: bool = Field(
        default=False, description="target counts from stress and strain at the start of the leg, not from zero"
    )

    @model_validator(mode="after")
    def _keys_fit(self) -> DemLeg:
        given = {name for name, value in self if value is not None and value is not False and name != "loading"}
        if self.relative and self.loading != "components":
            raise ValueError(
                f"relative = true goes with loading = 'components', not with {self.loading!r}, whose ratios are those "
                "of the stress at the end"
            )
        for name in NEEDS[self.loading]:
            if name not in given:
                raise ValueError(f"loading = {self.loading!r} needs {name}")
        legal = {*NEEDS[self.loading], *ADMITS[self.loading]}
        for name in sorted(given - legal):
            raise ValueError(f"loading = {self.loading!r} does not take {name} (it takes: {', '.join(sorted(legal))})")
        if self.loading == "invariants" and not given:
            raise ValueError("loading = 'invariants' needs pressure_ratio, stress_ratio or direction_degrees")
        if self.rotation_degrees == 0.0:
            raise ValueError("rotation_degrees = 0 turns nothing")
        return self


class Rates(Section):
    """How slow the loading is; the rate adapts to stay below both limits."""

    inertial_number: Annotated[float, Field(ge=1e-12, le=0.1)] = Field(
        default=1e-5, description="rate of strain times the time that pressure takes to move a disk by its size [-]"
    )
    unbalanced_force: Annotated[float, Field(ge=1e-8, le=1.0)] = Field(
        default=3e-4, description="root mean square resultant over the mean contact force [-]"
    )


class Measure(Section):
    """Measurement of the inputs of the point law on the packing, written to material.toml."""

    material: bool = Field(default=True, description="measure, and write material.toml")
    rattlers: Literal["included", "excluded"] = Field(
        default="included", description="counting of the coordination number in material.toml"
    )
    loop_stress_ratio: Annotated[float, Field(gt=0.0, le=0.5)] = Field(
        default=LOOP_STRESS_RATIO, description="q/p of the loops that give the force anisotropy, slip and scatter [-]"
    )
    sliding: bool = Field(
        default=False,
        description="the parameters of sliding as well, from the first leg: driven by strain at constant pressure "
        "well beyond the peak of q/p",
    )

    @model_validator(mode="after")
    def _sliding_needs_the_others(self) -> Measure:
        if self.sliding and not self.material:
            raise ValueError("sliding = true needs material = true: the moduli take the elastic strain off")
        return self


class DemOutput(Section):
    """Cadence of the history and of the files for ParaView."""

    stress_step: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        default=0.01, description="a record when p or q has moved by this much of the initial p [-]"
    )
    strain_step: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        default=1e-4, description="or when the strain has moved by this much [-]"
    )
    every: Annotated[int, Field(ge=0, le=1_000_000)] = Field(
        default=5, description="particles and contacts every so many records, and the last; 0 for none"
    )
    checkpoint_seconds: Annotated[float, Field(ge=0.0, le=1e6)] = Field(
        default=30.0, description="least time between checkpoints [s]; 0 for one at each record"
    )
    field_cells: Annotated[int, Field(ge=0, le=1000)] = Field(
        default=0,
        description="cells along each side of a grid on which contacts, fabric, stress and strain are averaged, "
        "written as often as particles; 0 for none",
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


class DemScene(Scene):
    """A sample of disks under loading."""

    kind: Literal["dem"] = Field(description="for `granfabric dem`; follows from the tables if not given")
    packing: Packing = Field(default=Packing(), description="the disks")
    path: Annotated[list[DemLeg], Field(min_length=1, max_length=10_000)] = Field(description="legs of the loading")
    rates: Rates = Field(default=Rates(), description="how slow the loading is")
    measure: Measure = Field(default=Measure(), description="measurement of the inputs of the point law")
    output: DemOutput = Field(default=DemOutput(), description="what is written")

    @model_validator(mode="after")
    def _kernel_fits(self) -> DemScene:
        output = self.output
        if output.field_cells == 1:
            raise ValueError("output.field_cells = 1 is no grid; legal are 0 for none, and 2 to 1000")
        if output.field_scale is None or not output.field_cells:
            return self
        reach = output.field_scale * (GAUSSIAN_REACH if output.field_kernel == "gaussian" else 1.0)
        side = float(0.96 * self.packing.particles**0.5)  # of the cell, in mean diameters, to a tenth
        if reach < 0.65 * side / output.field_cells:
            raise ValueError(
                f"output.field_scale = {output.field_scale:g} reaches {reach:.3g} mean diameters, less than from the "
                f"middle of a cell of the grid to its corner ({0.71 * side / output.field_cells:.3g}): some disks "
                "would belong to no cell; take more field_cells or a larger field_scale"
            )
        if reach > 0.55 * side:
            raise ValueError(
                f"output.field_scale = {output.field_scale:g} reaches {reach:.3g} mean diameters, beyond half of the "
                f"packing ({0.5 * side:.3g})"
            )
        return self
