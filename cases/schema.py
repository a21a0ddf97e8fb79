"""What a scene file may hold, as pydantic models; the larger sections are in `schema_*.py`.

Unknown keys are refused, and nothing is converted: a number in quotes is not a number. All quantities are in SI
units; stresses and strains are tension positive, components in the order xx, yy, xy.
"""

# ruff: noqa: RUF012  (pydantic copies the default lists of its models)

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from .accuracy import Accuracy
from .schema_base import Control, Increments, Scene, Section, Triple
from .schema_dem import DemScene
from .schema_initial import FieldInitial, PointInitial
from .schema_law import ClosureSection, EffectsSection, IntegrationSection, MaterialSection, NamedMaterialSection
from .schema_mesh import Mesh
from .schema_stage import Solver, StageSection


class PathLeg(Section):
    """One leg of a path: targets at its end, reached in equal increments, or a rotation at constant p and q."""

    control: Annotated[list[Control], Field(min_length=3, max_length=3)] | None = Field(
        default=None, description='per component xx, yy, xy: "stress" or "strain"'
    )
    target: Triple | None = Field(
        default=None, description="value at the end of the leg [Pa or -], shear strain as gamma_xy"
    )
    rotation_degrees: Annotated[float, Field(ge=-36_000, le=36_000)] | None = Field(
        default=None, description="turn of the principal stress axes over the leg, anticlockwise"
    )
    increments: Increments = 20

    @model_validator(mode="after")
    def _one_way(self) -> PathLeg:
        if self.rotation_degrees is None and (self.control is None or self.target is None):
            raise ValueError("a leg needs either control and target, or rotation_degrees")
        if self.rotation_degrees is not None and not (self.control is None and self.target is None):
            raise ValueError("a leg with rotation_degrees takes neither control nor target")
        return self


class Output(Section):
    """What a field run writes besides history.csv and run.json."""

    every: Annotated[int, Field(ge=1, le=1_000_000)] = Field(
        default=1, description="fields every so many steps, and the last"
    )
    pictures: bool = True


class LawScene(Scene):
    """What scenes have that use the point law."""

    material_file: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="tables [material] and [closure] as `granfabric dem` measures them"
    )
    accuracy: Accuracy | None = Field(
        default=None, description="chooses integrator, tolerances and directions where the scene leaves them open"
    )
    closure: ClosureSection = ClosureSection()
    effects: EffectsSection = EffectsSection()
    integration: IntegrationSection = IntegrationSection()


class PointScene(LawScene):
    """One material point along a path of stress or strain."""

    kind: Literal["point"]
    material: MaterialSection
    initial: PointInitial
    path: Annotated[list[PathLeg], Field(min_length=1, max_length=10_000)]
    output: Output = Output()


class FieldScene(LawScene):
    """A boundary-value problem."""

    kind: Literal["field"]
    material: MaterialSection | None = None
    materials: dict[str, NamedMaterialSection] = {}
    mesh: Mesh
    initial: FieldInitial
    stage: Annotated[list[StageSection], Field(min_length=1, max_length=1000)]
    solver: Solver = Solver()
    output: Output = Output()

    @model_validator(mode="after")
    def _materials(self) -> FieldScene:
        if (self.material is None) == (not self.materials):
            raise ValueError("a field scene needs either [material] or one [materials.NAME] for each region")
        return self


MODELS: dict[str, type[Scene]] = {"point": PointScene, "field": FieldScene, "dem": DemScene}
"""Model of each kind of scene; a new kind is added here."""


def json_schema() -> dict[str, Any]:
    """JSON schema of all kinds of scene, for editors."""
    from pydantic import TypeAdapter

    union: Any = Annotated[PointScene | FieldScene | DemScene, Field(discriminator="kind")]
    return TypeAdapter(union).json_schema()
