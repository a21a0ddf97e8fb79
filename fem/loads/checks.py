"""What loads are made of, read and checked: numbers, pairs, expressions, functions of place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.arrays import ArrayError, finite

from .expression import Expression, ExpressionError

Array = NDArray[np.float64]
Field = Callable[..., Any]
Value = float | str | Field
"""A number, the text of an expression in x and y, or a function of place."""

COMPONENTS = ("x", "y")


class LoadError(ValueError):
    """A load or a stage is not possible; the text names it and says what is legal."""


def check_component(owner: str, component: str) -> None:
    """Refuse what is not a direction."""
    if component not in COMPONENTS:
        raise LoadError(f"{owner}: component {component!r} is not one of 'x', 'y'")


def check_finite(owner: str, *values: Any) -> None:
    """Refuse what is neither a finite number nor a function of place."""
    for value in values:
        if callable(value):
            continue
        number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
        if not number or not np.isfinite(value):
            raise LoadError(f"{owner} = {value!r} is not a finite number")


def scalar(owner: str, value: Any) -> Any:
    """A number or a function of place; of a text the expression."""
    if isinstance(value, str):
        try:
            return Expression(value)
        except ExpressionError as error:
            raise LoadError(f"{owner} = {value[:80]!r}: {error}") from None
    check_finite(owner, value)
    return value


def pair(owner: str, value: Any, expressions: bool = False) -> tuple[Any, Any]:
    """Two components; one, or three of another code, would be stretched or shifted without a word."""
    if not isinstance(value, (Sequence, np.ndarray)) or isinstance(value, str) or np.shape(value) != (2,):
        raise LoadError(f"{owner} = {value!r} is not a pair of numbers, x and y")
    if not expressions:
        check_finite(owner, *value)
        return value[0], value[1]
    return scalar(f"x of {owner}", value[0]), scalar(f"y of {owner}", value[1])


def several(owner: str, given: Any) -> list[Any]:
    """A list of what was given, which may be read only once."""
    try:
        return list(given)
    except TypeError:
        raise LoadError(f"{owner} must be in a list, got a {type(given).__name__}") from None


def values_at(owner: str, value: Any, shape: tuple[int, ...], *places: Array) -> Array:
    """What a constant or a callable is at n places, shape (n, *shape); a constant may come out of a callable too.

    Raises
    ------
    LoadError
        If it is of another shape, which would be another load, or not finite; then with the first such place.
    """
    if isinstance(value, tuple) and any(callable(part) for part in value):
        came = np.stack(
            [np.broadcast_to(values_at(owner, part, (), *places), len(places[0])) for part in value], axis=-1
        )
    else:
        came = value(*places) if callable(value) else value
    wanted = (len(places[0]), *shape)
    try:
        if np.shape(came) == shape:
            return np.broadcast_to(finite(owner, came, shape), wanted)
        return finite(owner, came, wanted)
    except ArrayError as error:
        raise LoadError(f"{error}{_first_place(value, came, wanted, places)}") from None


def _first_place(value: Any, came: Any, wanted: tuple[int, ...], places: tuple[Array, ...]) -> str:
    """Where a function of place is not finite."""
    if np.shape(came) != wanted or np.asarray(came).dtype.kind not in "iuf":
        return ""
    bad = np.flatnonzero(~np.isfinite(np.asarray(came, dtype=np.float64)).reshape(len(places[0]), -1).all(axis=1))
    if not len(bad):
        return ""
    said = f" of {value.text!r}" if isinstance(value, Expression) else ""
    x, y = (float(place[bad[0]]) for place in places[:2])
    return f" ({len(bad)} of {len(places[0])} values{said}, the first at ({x:.6g}, {y:.6g}) m)"
