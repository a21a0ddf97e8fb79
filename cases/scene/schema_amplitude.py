"""Values that depend on the place, and how loads go through a stage: keys that several tables of a stage share."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from granfabric.fem.loads.amplitude import NAMES, PERIODIC, amplitude
from granfabric.fem.loads.checks import LoadError
from granfabric.fem.loads.expression import Expression, ExpressionError

from .schema_base import Pair


def _parse(value: Any) -> Any:
    if isinstance(value, str):
        try:
            Expression(value)
        except ExpressionError as error:
            shown = value if len(value) <= 60 else value[:57] + "..."
            raise ValueError(f"{shown!r} is no expression: {error}") from None
    elif isinstance(value, bool) or not isinstance(value, (int, float)):
        shown = repr(value) if len(repr(value)) <= 60 else repr(value)[:57] + "..."
        raise ValueError(f"{shown} is neither a number nor an expression in x and y in quotes")
    return value


Value = Annotated[float | str, BeforeValidator(_parse)]
"""A number, or an expression in x and y."""
ValuePair = Annotated[list[Value], Field(min_length=2, max_length=2)]

Name = Literal["ramp", "step", "sine", "triangle", "haversine"]


def _check_amplitude(value: Any) -> Any:
    if value is None:
        return value
    if isinstance(value, str) or not isinstance(value, list):
        if value not in NAMES:
            raise ValueError(
                f"{value!r:.60} is not one of {', '.join(NAMES)}, nor a table of pairs [fraction of the stage, factor]"
            )
        return value
    try:
        amplitude(value)
    except LoadError as error:
        raise ValueError(str(error)) from None
    return value


AmplitudeValue = Annotated[Name | list[Pair] | None, BeforeValidator(_check_amplitude)]
CycleCount = Annotated[float, Field(gt=0.0, le=10_000.0)] | None

AMPLITUDE = (
    "way from the value at the start of the stage (0) to the given one (1): a name, or rows [fraction of the stage, "
    "factor] [-]"
)
OWN_AMPLITUDE = f"that of the stage if not given: {AMPLITUDE}"
CYCLES = "number of cycles in the stage, 1 if not given [-]"


def check_cycles(section: Any) -> Any:
    """Refuse cycles without an amplitude that has some."""
    if section.cycles is not None and section.amplitude not in PERIODIC:
        raise ValueError(f"cycles = {section.cycles:g} goes with an amplitude that has cycles: {', '.join(PERIODIC)}")
    return section


def check_gradient(section: Any) -> Any:
    """Refuse a gradient on top of an expression."""
    if isinstance(section.value, str) and any(section.gradient):
        raise ValueError("a gradient goes with a number; an expression holds x and y itself")
    return section
