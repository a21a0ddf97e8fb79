"""Sections of a scene file that the point law declares: names, defaults and bounds exist once, there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any, Literal, get_type_hints

from pydantic import Field, create_model, model_validator

from granfabric.constitutive.effects import Effects
from granfabric.constitutive.parameters import (
    CLOSURE_NUMBERS,
    INTEGRATION_NUMBERS,
    Closure,
    Integration,
    Material,
    ParameterError,
)

from .docstrings import parameter_texts
from .schema_base import Section


def _material_section() -> type[Section]:
    entries: dict[str, Any] = {}
    for variable in Material.variables():
        default = ... if variable.default is None else variable.default
        text = f"{variable.meaning} [{variable.unit}]"
        entries[variable.name] = (float, Field(default, ge=variable.lower, le=variable.upper, description=text))
    return create_model("MaterialSection", __base__=Section, __doc__="One granular material.", **entries)


def _declared_section(
    name: str,
    declaration: type,
    text: str,
    bounds: Mapping[str, tuple[float, float]],
    decided: tuple[str, ...] = (),
    checked_here: bool = False,
) -> type[Section]:
    """Section with the fields and defaults of a frozen dataclass, which also checks the values.

    Fields named in `decided` may be "auto", and are if nothing is said. The bounds are for readers of the schema; if
    `checked_here` they are checked of the very key, so that the file it came from can be named.
    """
    hints = get_type_hints(declaration)
    entries: dict[str, Any] = {}
    texts = parameter_texts(declaration)
    for entry in fields(declaration):
        default: Any = ... if entry.default is MISSING else entry.default
        hint = hints[entry.name]
        if entry.name in decided:
            hint, default = hint | Literal["auto"], "auto"
        meaning = texts.get(entry.name)
        limits: dict[str, Any] = {}
        if entry.name in bounds:
            lower, upper = bounds[entry.name]
            if checked_here:
                limits, meaning = {"ge": lower, "le": upper}, (meaning or "").rstrip(".")
            else:
                limits = {"json_schema_extra": {"minimum": lower, "maximum": upper}}
        if hint is float:
            meaning = f"{meaning} [-]"  # all of them are ratios
        entries[entry.name] = (hint, Field(default, description=meaning, **limits))

    def check(section: Any) -> Any:
        try:
            declaration(**{name: value for name, value in section.model_dump().items() if value != "auto"})
        except ParameterError as error:
            raise ValueError(str(error)) from error
        return section

    validators: Any = {"check": model_validator(mode="after")(check)}
    return create_model(name, __base__=Section, __doc__=text, __validators__=validators, **entries)


def _effects_section() -> type[Section]:
    texts = parameter_texts(Effects)
    entries: dict[str, Any] = {
        name: (bool | Literal["auto"], Field("auto", description=texts.get(name))) for name in Effects.names()
    }
    entries["tolerance"] = (
        float | None,
        Field(None, ge=1e-8, le=1.0, description="error that leaving out effects on auto may make [-]"),
    )
    return create_model(
        "EffectsSection", __base__=Section, __doc__="Mechanisms: on, off, or decided by the program.", **entries
    )


MaterialSection: Any = _material_section()
ClosureSection: Any = _declared_section(
    "ClosureSection",
    Closure,
    "How the change of contact forces is closed.",
    CLOSURE_NUMBERS,
    ("force_change",),
    checked_here=True,
)
IntegrationSection: Any = _declared_section(
    "IntegrationSection", Integration, "Numerics of the update at a point.", INTEGRATION_NUMBERS
)
EffectsSection: Any = _effects_section()
NamedMaterialSection: Any = create_model(
    "NamedMaterialSection",
    __base__=MaterialSection,
    __doc__="One of several materials, with the region of the mesh that it fills.",
    region=(str, Field(..., description="physical surface of the mesh")),
)
