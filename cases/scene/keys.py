"""Keys of a scene as a user counts them: `stage 1 "initial": pressure 2: value`.

`--set` has ``stage.0.pressure.1.value`` for the same key, or ``stage.initial.pressure.1.value``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel

from granfabric.cases.errors import short

LONGEST_NAME = 40


def value_at(data: Any, keys: Sequence[Any]) -> Any:
    """What a scene, as tables or as checked, has at a key; None if there is nothing."""
    here = data
    for key in keys:
        if isinstance(key, int) and isinstance(here, Sequence) and not isinstance(here, str):
            here = here[key] if 0 <= key < len(here) else None
        elif isinstance(here, Mapping):
            here = here.get(key)
        elif isinstance(here, BaseModel):
            here = getattr(here, str(key), None)
        else:
            return None
    return here


def _shown(part: Any) -> str:
    text = str(part)
    return text if text.isprintable() and len(text) <= 60 else short(text)


def split(keys: Sequence[Any], data: Any) -> tuple[str, str]:
    """Where a key stands, and the key there.

    Parameters
    ----------
    keys : sequence of str and int
        Numbers count entries of lists from 0.
    data : dict or model
        The scene, for the names of its tables.

    Returns
    -------
    place : str
        Tables of which there are several, with number (from 1) and name; empty if the key is in none of them.
    key : str
        The rest, joined by dots; empty if the key is such a table itself.
    """
    places: list[str] = []
    rest: list[str] = []
    entries: list[int] = []
    for depth, part in enumerate(keys):
        if not isinstance(part, int):
            rest.append(_shown(part))
            continue
        item = value_at(data, keys[: depth + 1])
        if isinstance(item, (Mapping, BaseModel)) and rest:
            name = value_at(item, ["name"])
            named = isinstance(name, str) and name.isprintable() and 0 < len(name) <= LONGEST_NAME
            places.append(f"{'.'.join(rest)} {part + 1}" + (f' "{name}"' if named else ""))
            rest = []
        else:
            entries.append(part)
    key = ".".join(rest)
    for entry in entries:
        key = f"entry {entry + 1} of {key}"
    return ": ".join(places), key


def label(keys: Sequence[Any], data: Any) -> str:
    """Place and key in one, for the beginning of a sentence."""
    return ": ".join(part for part in split(keys, data) if part)
