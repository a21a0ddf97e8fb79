"""How several values of a key are written: `--set KEY=VALUE,VALUE,...`.

A comma parts two values where it stands outside brackets, braces and quotation marks: ``[-1e5, -1e5, 0]`` and
``"a, b"`` are one value each. ``LO:HI:N`` stands for N numbers at equal distances from LO to HI, both included, and
``LO:HI:N:log`` for N numbers at equal ratios; between whole numbers all stay whole if they can. Each value is what
`--set` of the other commands takes.
"""

from __future__ import annotations

import math
import re

import numpy as np

from granfabric.cases.errors import InputError, short
from granfabric.cases.scene.reader import parse_assignment

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
SPAN = re.compile(rf"\s*({NUMBER}):({NUMBER}):(\d+)(:log)?\s*")
BOUNDS = re.compile(rf"\s*({NUMBER}):({NUMBER})(:log)?\s*")
MOST_VALUES = 100_000
CLOSING = {"[": "]", "{": "}"}


def parted(text: str) -> list[str]:
    """Text between commas that stand outside brackets, braces and quotation marks.

    Raises
    ------
    ValueError
        If a bracket or quotation mark is not closed.
    """
    parts, begin, inside, quote = [], 0, list[str](), ""
    escaped = False
    for place, letter in enumerate(text):
        if quote:
            if escaped:
                escaped = False
            elif letter == "\\" and quote == '"':
                escaped = True
            elif letter == quote:
                quote = ""
        elif letter in "\"'":
            quote = letter
        elif letter in CLOSING:
            inside.append(CLOSING[letter])
        elif letter in "]}":
            if not inside or inside.pop() != letter:
                raise ValueError(f"{letter!r} closes nothing")
        elif letter == "," and not inside:
            parts.append(text[begin:place])
            begin = place + 1
    if quote or inside:
        raise ValueError(f"{(quote or inside[-1])!r} is missing")
    return [*parts, text[begin:]]


def plain(value: float) -> str:
    """A number as it is written in a scene, with all its digits."""
    return repr(float(value))


def values_of(assignment: str) -> tuple[str, list[str]]:
    """Key and values of one `--set KEY=VALUE,VALUE,...`, each value as text.

    Raises
    ------
    InputError
    """
    key, equals, text = assignment.partition("=")
    key = ".".join(part.strip() for part in key.split("."))
    if not equals or not text.strip():
        parse_assignment(assignment if not equals else f"{key}=0")  # says what is wrong with the key
        raise InputError(f"--set {key}: a value is missing")
    try:
        parts = parted(text)
    except ValueError as error:
        raise InputError(f"--set {key}: {short(text)} cannot be parted into values: {error}") from error
    found: list[str] = []
    for part in parts:
        if not part.strip():
            raise InputError(f"--set {key}: {short(text)} has nothing between two commas")
        span = SPAN.fullmatch(part)
        if span is None:
            parse_assignment(f"{key}={part.strip()}")
            found.append(part.strip())
        else:
            found += _spread(key, part.strip(), span)
    twice = sorted({value for value in found if found.count(value) > 1}) if len(found) <= 1000 else []
    if twice:
        raise InputError(f"--set {key}: {short(twice[0])} is given twice")
    return key, found


def _spread(key: str, text: str, span: re.Match[str]) -> list[str]:
    low, high, number, log = float(span[1]), float(span[2]), int(span[3]), bool(span[4])
    if not 2 <= number <= MOST_VALUES or not math.isfinite(high - low) or low == high:
        raise InputError(
            f"--set {key}: {short(text)} is not LO:HI:N with two different numbers and N in [2, {MOST_VALUES}]"
        )
    if log:
        _refuse_signs(f"--set {key}", text, low, high)
        values = np.geomspace(low, high, number)
    else:
        values = np.linspace(low, high, number)
    values[0], values[-1] = low, high
    whole = all(re.fullmatch(r"[+-]?\d+", span[end]) for end in (1, 2)) and (values == np.round(values)).all()
    if whole and not log:
        return [str(int(value)) for value in values]
    # 0.30000000000000004 is nobody's value: fifteen digits are what a number between two given ones has
    return [plain(float(f"{value:.15g}")) for value in values]


def _refuse_signs(option: str, text: str, low: float, high: float) -> None:
    if low * high <= 0.0:
        raise InputError(f"{option}: {short(text)}: with :log both ends are above zero, or both below")


def bounds_of(text: str) -> tuple[str, float, float, bool]:
    """Key, ends and whether by ratios, of one `--latin KEY=LO:HI` or `KEY=LO:HI:log`.

    Raises
    ------
    InputError
    """
    key, equals, rest = text.partition("=")
    key = ".".join(part.strip() for part in key.split("."))
    found = BOUNDS.fullmatch(rest)
    if not equals or not key or found is None:
        raise InputError(
            f"--latin {short(text)} is not of the form KEY=LO:HI or KEY=LO:HI:log, for instance "
            "material.coordination=3.6:4.2"
        )
    parse_assignment(f"{key}=0")
    low, high, log = float(found[1]), float(found[2]), bool(found[3])
    if not low < high or not math.isfinite(high - low):
        raise InputError(f"--latin {key}: {rest.strip()} does not go from a smaller number to a larger one")
    if log:
        _refuse_signs(f"--latin {key}", rest.strip(), low, high)
    return key, low, high, log
