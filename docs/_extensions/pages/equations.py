"""Where each equation of the source stands in the code: numbers in brackets in docstrings."""

from __future__ import annotations

import re

from .markdown import code, prose
from .sources import ROOMS, Thing, things

COUNT = 13
"""Equations of the source."""

_BRACKETS = re.compile(r"\[([^\[\]]+)\]")
_NUMBERS = r"\d{1,2}(?:\s*(?:,|-|and|to)\s*\d{1,2})*"
_NAMED = re.compile(rf"\b(?:eqs?\.?|equations?)\s*({_NUMBERS})")
_BARE = re.compile(rf"^{_NUMBERS}$")
_UNNAMED_ROOMS = ("granfabric.constitutive.network", "granfabric.constitutive.integration")
"""Where the bracket may hold the number alone; elsewhere it may be an interval or an index."""


def _expanded(text: str) -> set[int]:
    found: set[int] = set()
    for part in re.split(r"\s*(?:,|and)\s*", text):
        ends = [int(entry) for entry in re.split(r"\s*(?:-|to)\s*", part) if entry]
        found |= set(range(ends[0], ends[-1] + 1)) if ends else set()
    return found


def numbers(thing: Thing) -> set[int]:
    """Equations that a docstring names, for instance ``[Pouragha & Wan 2017, eqs 9, 10]``, ``[eq. 7]`` or ``[7]``."""
    found: set[int] = set()
    for bracket in _BRACKETS.findall(" ".join(thing.text.split())):
        if named := _NAMED.search(bracket):
            found |= _expanded(named.group(1))
        elif _BARE.match(bracket.strip()) and thing.name.startswith(_UNNAMED_ROOMS):
            found |= _expanded(bracket.strip())
    return {number for number in found if 1 <= number <= COUNT}


def places() -> dict[int, list[Thing]]:
    """For each equation, what names it; the law first."""
    found: dict[int, list[Thing]] = {number: [] for number in range(1, COUNT + 1)}
    for package in ROOMS:
        for thing in things(package):
            for number in numbers(thing):
                found[number].append(thing)
    return found


def spellings(number: str) -> list[str]:
    """What a person may type to find an equation; the search of the site passes over numbers that stand alone."""
    return [f"equation {number}", f"eq. {number}", f"eq {number}", f"[{number}]", f"equation ({number})"]


def link(thing: Thing, short: bool = False) -> str:
    """A link to where it is documented; `short` shows the last part of the name alone."""
    if thing.name.startswith("granfabric.cases"):
        return code(thing.name)
    role = {"module": "mod", "class": "class", "function": "func", "method": "meth", "data": "data"}[thing.kind]
    shown = thing.name.rsplit(".", 1)[1] if short else thing.name.removeprefix("granfabric.")
    return f"{{py:{role}}}`{shown} <{thing.name}>`"


def listing(number: int) -> str:
    """Markdown list of where an equation stands."""
    return "\n".join(f"- {link(thing)}: {prose(thing.summary)}" for thing in places()[number])
