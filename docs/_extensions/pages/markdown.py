"""Pieces of Markdown."""

from __future__ import annotations

import re
from collections.abc import Sequence

LEGEND = "% Written by docs/_extensions when the site is built; changes here are lost."


def cell(text: str) -> str:
    """Text that cannot break out of the cell of a table."""
    return " ".join(text.split()).replace("|", "\\|")


def prose(text: str) -> str:
    """Plain text with nothing in it that Markdown would take for markup, except code in backticks."""
    parts = re.split(r"(``.*?``|`.*?`)", " ".join(text.split()))
    return "".join(part if part.startswith("`") else re.sub(r"([<>*_$\[\]])", r"\\\1", part) for part in parts)


def code(text: object) -> str:
    """Text as it is typed."""
    plain = " ".join(str(text).split())
    return f"`{plain}`" if plain else ""


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table; cells are Markdown themselves."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(cell(entry) for entry in row) + " |" for row in rows]
    return "\n".join(lines)


def number(value: object) -> str:
    """A number as one would write it in a scene file."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        return str(value)
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def bound(sign: str, value: float) -> str:
    """A bound of a quantity; one at the end of the range of numbers is none, one next to zero is zero left out."""
    if abs(value) >= 1e300:
        return ""
    if sign == "≥" and 0.0 < value <= 1e-300:
        return "> 0"
    return f"{sign} {number(value)}"


def page(*parts: str) -> str:
    """Parts with empty lines between them."""
    return "\n\n".join([LEGEND, *(part for part in parts if part)]) + "\n"
