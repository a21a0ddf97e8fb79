"""What all sections of a scene file share."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

Control = Literal["stress", "strain"]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Triple = Annotated[list[float], Field(min_length=3, max_length=3)]
Positive = Annotated[float, Field(gt=0.0)]
Increments = Annotated[int, Field(ge=1, le=10_000_000)]
Text = Annotated[str, Field(max_length=20_000)]


class Section(BaseModel):
    """A table of a scene file: unknown keys are errors, values are not converted, numbers are finite."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


def _printable(text: str) -> str:
    """A line that a terminal shows as it is."""
    if not text.isprintable():
        raise ValueError(f"{text!r} holds control characters")
    return text


Line = Annotated[str, AfterValidator(_printable)]


class Scene(Section):
    """What every scene has."""

    title: Annotated[Line, Field(min_length=1, max_length=200)] = Field(description="one line, for lists and pictures")
    group: Annotated[Line, Field(max_length=80)] = Field(default="", description="heading in the list of scenes")
    description: Text = Field(default="", description="question, set-up, expected numbers")
