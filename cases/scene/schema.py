"""What a scene file may hold, as pydantic models; the larger sections are in `schema_*.py`.

Unknown keys are refused, and nothing is converted: a number in quotes is not a number. All quantities are in SI
units; stresses and strains are tension positive, components in the order xx, yy, xy.
"""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, model_validator

from granfabric.constitutive.parameters import Material

from .accuracy import COARSEST, FINEST, Accuracy
from .schema_base import Control, Increments, Scene, Section, Triple
from .schema_closed_form import ClosedForm
from .schema_dem import DemScene, Packing
from .schema_initial import FieldInitial, PointInitial, RandomState
from .schema_law import ClosureSection, EffectsSection, IntegrationSection, MaterialSection, NamedMaterialSection
from .schema_law_kind import LawSection, check_law, is_grains
from .schema_mesh import Mesh
from .schema_probe import Probe
from .schema_specimen import SpecimenScene
from .schema_stage import DRAINED, Solver, StageSection

MapName = Literal[
    "coordination",
    "coordination_change",
    "fabric_anisotropy",
    "mean_pressure",
    "stress_ratio",
    "stress_xx",
    "stress_yy",
    "stress_xy",
    "displacement_x",
    "displacement_y",
    "pore_pressure",
]
"""Fields that the picture of a field run may show; `plots_maps.py` knows how."""


class PathLeg(Section):
    """One leg of a path: targets at its end, reached in equal increments, or a rotation at constant p and q."""

    control: Annotated[list[Control], Field(min_length=3, max_length=3)] | None = Field(
        default=None, description='per component xx, yy, xy: "stress" or "strain"'
    )
    target: Triple | None = Field(
        default=None, description="value at the end of the leg [Pa or -], shear strain as gamma_xy"
    )
    relative: bool = Field(
        default=False, description="target counts from stress and strain at the start of the leg, not from zero"
    )
    rotation_degrees: Annotated[float, Field(ge=-36_000, le=36_000)] | None = Field(
        default=None, description="rotation of the principal stress axes over the leg, anticlockwise [degrees]"
    )
    increments: Increments = Field(default=20, description="equal increments of the leg")
    drained: bool = Field(default=False, description=DRAINED)

    @model_validator(mode="after")
    def _one_way(self) -> PathLeg:
        if self.rotation_degrees is None and (self.control is None or self.target is None):
            raise ValueError("a leg needs either control and target, or rotation_degrees")
        if self.rotation_degrees is not None and not (self.control is None and self.target is None):
            raise ValueError("a leg with rotation_degrees takes neither control nor target")
        if self.rotation_degrees is not None and self.relative:
            raise ValueError("relative = true goes with a target; rotation_degrees always turns from the start")
        return self


class Output(Section):
    """What a field run writes besides history.csv and run.json."""

    every: Annotated[int, Field(ge=1, le=1_000_000)] = Field(
        default=1, description="fields every so many steps, and the last"
    )
    pictures: bool = Field(default=True, description="draw at the end of the run")


class FieldOutput(Output):
    """What a field run writes besides history.csv and run.json, and what its picture shows."""

    compression: Literal["none", "fast", "small"] = Field(
        default="none",
        description='of files: "none" takes least time, "small" least room at twenty times the time of "fast"',
    )
    maps: Annotated[list[MapName], Field(max_length=4)] = Field(
        default=[], description="fields of the last step that are drawn; chosen by what varies if not given"
    )
    curve: Annotated[list[Annotated[str, Field(min_length=1)]], Field(min_length=2, max_length=2)] | None = Field(
        default=None, description="two columns of history.csv, abscissa and ordinate, of the first curve"
    )
    probe: Annotated[list[Probe], Field(max_length=200)] = Field(
        default=[], description="places and lines whose values are written at every step"
    )

    @model_validator(mode="after")
    def _probes_differ(self) -> FieldOutput:
        names = [probe.name.lower() for probe in self.probe]  # one file each, also where case does not count
        twice = next((name for place, name in enumerate(names) if name in names[:place]), None)
        if twice is not None:
            raise ValueError(f"output.probe: two probes have the name {twice!r}")
        return self


class LawScene(Scene):
    """What scenes have that use the point law."""

    material_file: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="tables [material] and [closure], as measured on disks: a file, relative to this one, or a shipped "
        "name",
    )
    accuracy: Accuracy | None = Field(
        default=None,
        description="error to aim at [-]: chooses integrator, tolerances and directions that the scene leaves open",
        json_schema_extra={"minimum": FINEST, "maximum": COARSEST},
    )
    closure: ClosureSection = Field(default=ClosureSection(), description="how the change of forces is closed")
    effects: EffectsSection = Field(default=EffectsSection(), description="mechanisms: true, false or auto")
    integration: IntegrationSection = Field(default=IntegrationSection(), description="numerics at a point")
    law: LawSection | None = Field(default=None, description="contact law or grains; the former if not given")
    packing: Packing | None = Field(default=None, description="disks at the points, with law.kind = 'grains'")


class PointScene(LawScene):
    """One material point along a path of stress or strain."""

    kind: Literal["point"] = Field(description="for `granfabric point`; follows from the tables if not given")
    material: MaterialSection | None = Field(default=None, description="the granular material")
    initial: PointInitial = Field(description="state before any loading")
    path: Annotated[list[PathLeg], Field(min_length=1, max_length=10_000)] = Field(description="legs of the path")
    output: Output = Field(default=Output(), description="what is written")

    @model_validator(mode="after")
    def _fits_the_law(self) -> PointScene:
        check_law(self)
        return self


class FieldScene(LawScene):
    """A boundary-value problem."""

    kind: Literal["field"] = Field(description="for `granfabric run`; follows from the tables if not given")
    material: MaterialSection | None = Field(default=None, description="the granular material, if there is one")
    materials: dict[str, NamedMaterialSection] = Field(default={}, description="several materials by name")
    mesh: Mesh = Field(description="mesh and element")
    initial: FieldInitial = Field(description="state before any loading")
    random_state: RandomState | None = Field(default=None, description="random initial coordination number")
    stage: Annotated[list[StageSection], Field(min_length=1, max_length=1000)] = Field(description="stages of loading")
    closed_form: ClosedForm | None = Field(default=None, description="closed form that the run is compared with")
    solver: Solver = Field(default=Solver(), description="global iteration and load stepping")
    output: FieldOutput = Field(default=FieldOutput(), description="what is written and drawn")

    @model_validator(mode="after")
    def _materials(self) -> FieldScene:
        check_law(self)
        if not is_grains(self) and (self.material is None) == (not self.materials):
            raise ValueError("a field scene needs either [material] or one [materials.NAME] for each region")
        return self

    @model_validator(mode="after")
    def _form_is_given(self) -> FieldScene:
        if self.closed_form is None and any(stage.closed_form for stage in self.stage):
            raise ValueError("a stage takes the traction of a closed form, but the scene has no [closed_form]")
        return self


NUMBERS = tuple(variable.name for variable in Material.variables())
"""Keys of a material."""

MODELS: dict[str, type[Scene]] = {
    "point": PointScene, "field": FieldScene, "dem": DemScene, "specimen": SpecimenScene
}  # fmt: skip
"""Model of each kind of scene; a new kind is added here."""

TABLE_LISTS = ("path", "stage")
"""Tables of which a scene has several, written ``[[path]]``."""


def json_schema() -> dict[str, Any]:
    """JSON schema of all kinds of scene, for editors."""
    union: Any = Annotated[PointScene | FieldScene | DemScene | SpecimenScene, Field(discriminator="kind")]
    schema = TypeAdapter(union).json_schema()
    # The title may be the file's name, the kind follows from the tables.
    for model in MODELS.values():
        table = schema["$defs"][model.__name__]
        table["required"] = [key for key in table["required"] if key not in ("title", "kind")]
    # What a material file gives need not stand in the scene; editors, unlike the check, do not see that file.
    for name in ("MaterialSection", "NamedMaterialSection", "PointScene"):
        table = schema["$defs"][name]
        table["required"] = [key for key in table["required"] if key not in (*NUMBERS, "material")]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "granfabric scene",
        "description": "SI units; stresses and strains tension positive, components in the order xx, yy, xy.",
        **schema,
    }


def schema_text() -> str:
    """The file `cases/scenes/schema.json`; `granfabric schema > cases/scenes/schema.json` renews it."""
    return json.dumps(json_schema(), indent=1) + "\n"
