"""What a scene file may hold, as pydantic models.

The sections `material`, `closure`, `effects` and `integration` are derived from the declarations of the point law, so
that names, defaults and bounds exist once. Unknown keys are refused, and nothing is converted: a number in quotes is
not a number. All quantities are in SI units; stresses and strains are tension positive, components in the order
xx, yy, xy.
"""

# ruff: noqa: RUF012  (pydantic copies the default lists of its models)

from __future__ import annotations

from dataclasses import MISSING, fields
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import Field, create_model, model_validator

from constitutive.effects import Effects
from constitutive.parameters import Closure, Integration, Material, ParameterError

from .accuracy import Accuracy
from .schema_base import Control, Increments, Pair, Positive, Scene, Section, Triple
from .schema_dem import DemScene

Component = Literal["x", "y"]


def _material_section() -> type[Section]:
    entries: dict[str, Any] = {}
    for variable in Material.variables():
        default = ... if variable.default is None else variable.default
        text = f"{variable.meaning} [{variable.unit}]"
        entries[variable.name] = (float, Field(default, ge=variable.lower, le=variable.upper, description=text))
    return create_model("MaterialSection", __base__=Section, __doc__="One granular material.", **entries)


def _declared_section(name: str, declaration: type, text: str) -> type[Section]:
    """Section with the fields and defaults of a frozen dataclass, which also checks the values."""
    hints = get_type_hints(declaration)
    entries: dict[str, Any] = {}
    for entry in fields(declaration):
        entries[entry.name] = (hints[entry.name], ... if entry.default is MISSING else entry.default)

    def check(section: Any) -> Any:
        try:
            declaration(**section.model_dump())
        except ParameterError as error:
            raise ValueError(str(error)) from error
        return section

    validators: Any = {"check": model_validator(mode="after")(check)}
    return create_model(name, __base__=Section, __doc__=text, __validators__=validators, **entries)


def _effects_section() -> type[Section]:
    entries: dict[str, Any] = dict.fromkeys(Effects.names(), (bool | Literal["auto"], "auto"))
    return create_model(
        "EffectsSection", __base__=Section, __doc__="Mechanisms: on, off, or decided by the program.", **entries
    )


MaterialSection: Any = _material_section()
ClosureSection: Any = _declared_section("ClosureSection", Closure, "How the change of contact forces is closed.")
IntegrationSection: Any = _declared_section("IntegrationSection", Integration, "Numerics of the update at a point.")
EffectsSection: Any = _effects_section()
NamedMaterialSection: Any = create_model(
    "NamedMaterialSection",
    __base__=MaterialSection,
    __doc__="One of several materials, with the region of the mesh that it fills.",
    region=(str, Field(..., description="physical surface of the mesh")),
)


class Initial(Section):
    """State before any loading."""

    stress: Triple = Field(description="xx, yy, xy [Pa], tension positive")

    @model_validator(mode="after")
    def _compressive(self) -> Initial:
        xx, yy, xy = self.stress
        pressure, deviator = -(xx + yy) / 2, ((xx - yy) ** 2 / 4 + xy**2) ** 0.5
        if not pressure > deviator:
            raise ValueError(
                f"the initial stress has to press in every direction (tension is positive): mean pressure "
                f"{pressure:g} Pa is not above the deviator {deviator:g} Pa; for a pressure of 100 kPa write "
                "[-100e3, -100e3, 0.0]"
            )
        return self


class FieldInitial(Initial):
    """State before any loading, everywhere."""

    balance: bool = Field(default=False, description="balance the initial stress by constant reference forces")


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


class Rectangle(Section):
    """A rectangular specimen, meshed regularly; boundaries bottom, right, top, left, region all."""

    width: Positive
    height: Positive
    nx: Annotated[int, Field(ge=1, le=5000)]
    ny: Annotated[int, Field(ge=1, le=5000)]
    cell: Literal["triangle", "quad"] = "triangle"


class Mesh(Section):
    """Mesh and finite element."""

    file: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="Gmsh file, relative to the scene file"
    )
    rectangle: Rectangle | None = None
    element: Literal["P1", "P2", "Q1", "Q2"] = "P2"
    quadrature_degree: Annotated[int, Field(ge=1, le=20)] | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Mesh:
        if (self.file is None) == (self.rectangle is None):
            raise ValueError("the mesh needs either file or rectangle, not both")
        if self.rectangle is not None:
            letter = {"triangle": "P", "quad": "Q"}[self.rectangle.cell]
            if self.element[0] != letter:
                raise ValueError(
                    f"element {self.element} does not fit {self.rectangle.cell} cells; use {letter}{self.element[1]}"
                )
        return self


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

    name: Annotated[str, Field(min_length=1, max_length=80)]
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
    initial: Initial
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
