"""What all sections of a scene file share."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from granfabric.cases.errors import short

Control = Literal["stress", "strain"]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Triple = Annotated[list[float], Field(min_length=3, max_length=3)]
Positive = Annotated[float, Field(gt=0.0)]
Increments = Annotated[int, Field(ge=1, le=10_000_000)]
Text = Annotated[str, Field(max_length=20_000)]


UNIT = re.compile(r"\[(-|degrees|m|Pa|Pa/m|N/m3|N/m|N m/m|rad|s|Pa or -)\]")
"""A unit within the description of a key, where it is written once; every key that takes a real number has one."""


def _tell_units(schema: dict[str, Any], model: type[BaseModel]) -> None:
    """Give each key of a table in the JSON schema its unit as an entry of its own, for reference and editors."""
    for entry in schema.get("properties", {}).values():
        if found := UNIT.search(entry.get("description", "")):
            entry["unit"] = found.group(1)


class Section(BaseModel):
    """A table of a scene file: unknown keys are errors, values are not converted, numbers are finite."""

    model_config = ConfigDict(
        extra="forbid", strict=True, frozen=True, allow_inf_nan=False, json_schema_extra=_tell_units
    )


def _printable(text: str) -> str:
    """A line that a terminal shows as it is."""
    if not text.isprintable():
        raise ValueError(f"{short(text)} holds control characters")
    return text


Line = Annotated[str, AfterValidator(_printable)]


class Scene(Section):
    """What every scene has."""

    title: Annotated[Line, Field(min_length=1, max_length=200)] = Field(
        description="one line, for lists and pictures; the name of the file if not given"
    )
    group: Annotated[Line, Field(max_length=80)] = Field(default="", description="heading in the list of scenes")
    description: Text = Field(default="", description="question, set-up, expected numbers")
