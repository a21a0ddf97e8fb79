"""What a curve does not tell: material file, `--set` keys, what is held and where the free parameters begin."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, field_validator

from granfabric.cases.errors import InputError, several, short, unknown
from granfabric.cases.scene import catalogue
from granfabric.cases.scene.material_file import LAW_TABLES, closure_table, read_material
from granfabric.cases.scene.reader import assign, parse_assignment
from granfabric.cases.scene.schema_base import Section, Triple
from granfabric.cases.scene.schema_law import ClosureSection, EffectsSection, IntegrationSection, MaterialSection
from granfabric.cases.scene.validation_messages import messages
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.parameters import CLOSURE_NUMBERS, Closure, Integration, Material, ParameterError

from .columns import LEGAL

FORCE_CHANGE = "shifted_distribution"
"""Closure if nobody names one."""
NUMERICS = {"integrator": "dormand_prince", "tolerance": 1e-8}
"""Of the update: differences of curves with close parameters are taken, so that the error has to be far below them."""
SLIDING = ("peak_stress_ratio", "first_yield_stress_ratio", "reference_plastic_strain", "hardening_exponent",
           "dilatancy", "constant_volume_stress_ratio", "apparent_cohesion")  # fmt: skip
FIRST_STIFFNESS = 1e4
"""Normal stiffness over the mean pressure at which a fit of it begins."""


CONTROLS = ("stress", "strain")


SCALES = (1e-12, 1e12)
"""Smallest and largest scale of a column."""


class InitialSection(Section):
    """State before any loading, where the first row of a curve does not tell it."""

    stress: Triple | None = Field(default=None, description="xx, yy, xy [Pa], tension positive")


class Settings(Section):
    """Keys of `--set`, besides those of a material file."""

    material: MaterialSection
    closure: ClosureSection = Field(default=ClosureSection())
    effects: EffectsSection = Field(default=EffectsSection())
    integration: IntegrationSection = Field(default=IntegrationSection())
    initial: InitialSection = Field(default=InitialSection())
    control: Any = Field(default="stress")
    start: Literal["material", "row"] = Field(default="material")
    scale: dict[str, float] = Field(default={})

    @field_validator("control")
    @classmethod
    def _known(cls, value: Any) -> Any:
        several_kinds = isinstance(value, list) and len(value) == 3
        if not all(kind in CONTROLS for kind in (value if several_kinds else [value])):
            raise ValueError(f"{short(value)} is neither of 'stress', 'strain' nor three of them for xx, yy, xy")
        return value

    @field_validator("scale")
    @classmethod
    def _above_zero(cls, value: dict[str, float]) -> dict[str, float]:
        for name, scale in value.items():
            if not SCALES[0] <= scale <= SCALES[1]:
                raise ValueError(f"{name} = {scale:g} is outside [{SCALES[0]:g}, {SCALES[1]:g}]")
        return value


KEYS = ("material_file", *Settings.model_fields)


@dataclass
class Given:
    """What was given, before the curves complete it.

    Attributes
    ----------
    table : dict
        Tables as in a scene.
    assigned : set of str
        Names of parameters given by `--set`, which are held.
    from_file : set of str
        Names of parameters from the material file.
    file : Path or None
        The material file.
    """

    table: dict[str, Any]
    assigned: set[str] = field(default_factory=set)
    from_file: set[str] = field(default_factory=set)
    file: Path | None = None


@dataclass(frozen=True)
class Base:
    """The law before anything is fitted.

    Attributes
    ----------
    values : dict of str to float
        Every number of material and closure.
    origins : dict of str to str
        "set", "file", "rows" (the first rows of the curves) or "default".
    closure : dict of str to str
        Choices of the closure.
    effects : Effects
    integration : Integration
    settings : Settings
    """

    values: dict[str, float]
    origins: dict[str, str]
    closure: dict[str, Any]
    effects: Effects
    integration: Integration
    settings: Any

    def material_of(self, values: Mapping[str, float]) -> Material:
        """Material with these values.

        Raises
        ------
        ParameterError
        """
        return Material(**{name: values[name] for name in MATERIAL_NAMES})

    def closure_of(self, values: Mapping[str, float]) -> Closure:
        """Closure with these values.

        Raises
        ------
        ParameterError
        """
        numbers: dict[str, Any] = {name: values[name] for name in CLOSURE_NUMBERS}
        return Closure(**self.closure, **numbers)


MATERIAL_NAMES = tuple(variable.name for variable in Material.variables())
NUMBERS = (*MATERIAL_NAMES, *CLOSURE_NUMBERS)
"""Every parameter that may be free."""


def given(assignments: Sequence[str], material_file: str | None = None) -> Given:
    """Read the material file and `--set` assignments; see `Settings` for the keys.

    Raises
    ------
    InputError
    """
    parsed = [parse_assignment(text) for text in assignments]
    for keys, value in parsed:
        if keys[0] not in KEYS:
            raise InputError(f"--set {'.'.join(keys)}: {unknown('the key', keys[0], KEYS)}")
        if keys == ("material_file",):
            if material_file is not None:
                raise InputError("--set material_file and --material-file both name one; give it once")
            if not isinstance(value, str) or not value:
                raise InputError(f"--set material_file: {value!r} is not the name of a material file")
    named = [value for keys, value in parsed if keys == ("material_file",)]
    name = material_file if material_file is not None else (named[-1] if named else None)
    found = Given({"material": {}, "closure": {}})
    if name is not None:
        found.file = catalogue.material(name, Path())
        contents = read_material(found.file)
        for section in LAW_TABLES:
            found.table[section] |= contents.get(section, {})
        found.from_file = {key for section in LAW_TABLES for key in found.table[section]}
    for keys, value in parsed:
        path: tuple[str, ...] = keys
        if path == ("material_file",):
            continue
        if path[0] == "scale":
            if len(keys) == 2:
                path, value = ("scale",), {**found.table.get("scale", {}), keys[1]: value}
            if isinstance(value, dict):
                value = {_column(name): scale for name, scale in value.items()}
        if path in (("material",), ("closure",)) and not isinstance(value, dict):
            raise InputError(f"--set {path[0]}: {short(value)} is not a table; set its keys one by one")
        assign(found.table, path, value)
        if path[0] in LAW_TABLES:
            found.assigned |= {path[1]} if len(path) > 1 else set(value if isinstance(value, dict) else ())
    return found


def _column(name: str) -> str:
    full = LEGAL.get(name)
    if full is None:
        raise InputError(f"--set scale.{name}: {unknown('the column', name, list(LEGAL))}")
    return full


def first_settings(found: Given) -> Any:
    """Settings that are needed to read curves: the others are checked with them.

    Raises
    ------
    InputError
    """
    table = {key: value for key, value in found.table.items() if key not in ("material", "closure")}
    return _validated(table | {"material": _PLACEHOLDER}, found)


_PLACEHOLDER = {"coordination": 4.0, "solid_fraction": 0.8, "normal_stiffness": 1e9}


def complete(
    found: Given, first_rows: Mapping[str, float], pressure: float, strain: bool, free: Sequence[str], place: str
) -> Base:
    """Fill in what the first rows tell and defaults.

    Parameters
    ----------
    found : Given
    first_rows : mapping of str to float
        Values of the first rows by parameter: coordination, initial fabric.
    pressure : float
        Mean pressure at the start [Pa].
    strain : bool
        Whether the curves tell strains beside stresses, from which a stiffness follows.
    free : sequence of str
        Parameters that were asked to be free; sliding is on if one of it is among them.
    place : str
        The curves, for sentences.

    Raises
    ------
    InputError
        If something is missing that no curve tells, or out of bounds.
    """
    table = {**found.table, "material": dict(found.table["material"]), "closure": dict(found.table["closure"])}
    material = table["material"]
    rows = set()
    for name, value in first_rows.items():
        if name not in material:
            material[name] = value
            rows.add(name)
    if "normal_stiffness" not in material and (strain or "normal_stiffness" in free):
        material["normal_stiffness"] = FIRST_STIFFNESS * pressure
    missing = {
        "coordination": "no column coordination (z) tells it",
        "normal_stiffness": "no strain under prescribed stress determines it",
        "solid_fraction": "no column tells it",
    }
    lacking = [
        f"{place}: material.{name} is not given, and {reason}: give it by --set material.{name}=... or --material-file"
        for name, reason in missing.items()
        if name not in material
    ]
    if lacking:
        raise several(lacking)
    if "force_change" not in table["closure"]:
        numbers = {"material": material, "closure": table["closure"]}
        table["closure"] = {"force_change": FORCE_CHANGE, **closure_table(numbers)}
    table["integration"] = {**NUMERICS, **table.get("integration", {})}
    settings = _validated(table, found)
    sliding = "peak_stress_ratio" in material or any(name in SLIDING for name in free)
    if settings.effects.sliding is True and not sliding:
        raise InputError("--set effects.sliding = true needs material.peak_stress_ratio, which is not given")
    if settings.closure.force_change == "auto":
        raise InputError('--set closure.force_change: "auto" decides for a scene; a fit needs one of them by name')
    closure = settings.closure.model_dump()
    values = {**settings.material.model_dump(), **{name: closure.pop(name) for name in CLOSURE_NUMBERS}}
    base = Base(
        {name: float(values[name]) for name in NUMBERS},
        {name: _origin(name, found, rows) for name in NUMBERS},
        closure,
        _effects(settings, sliding),
        Integration(**settings.integration.model_dump()),
        settings,
    )
    if not all(math.isfinite(value) for value in base.values.values()):
        raise InputError(f"{place}: a parameter is not finite")
    return base


def _origin(name: str, found: Given, rows: set[str]) -> str:
    if name in found.assigned:
        return "set"
    if name in found.from_file:
        return "file"
    return "rows" if name in rows else "default"


def _effects(settings: Any, sliding: bool) -> Effects:
    """Effects as asked for; those on "auto" are on, sliding if there are parameters for it, pore fluid never."""
    said = settings.effects.model_dump(exclude={"tolerance"})
    auto = dict.fromkeys(said, True) | {"sliding": sliding, "pore_fluid": False}
    chosen = {name: value if isinstance(value, bool) else auto[name] for name, value in said.items()}
    try:
        return Effects(**chosen)
    except ParameterError as error:
        raise InputError(f"--set: {error}") from error


def _validated(table: dict[str, Any], found: Given) -> Any:
    try:
        return Settings.model_validate(table)
    except ValidationError as error:
        said = []
        for keys, text in messages(error, Settings, table):
            key = str(keys[1]) if len(keys) > 1 else ""
            from_file = keys and keys[0] in LAW_TABLES and key in found.from_file - found.assigned
            said.append(f"{found.file if from_file else '--set'}: {text}")
        raise several(said) from error


def initial_stress(settings: Any) -> NDArray[np.float64] | None:
    """Stress at the start as given."""
    return None if settings.initial.stress is None else np.array(settings.initial.stress, dtype=float)
