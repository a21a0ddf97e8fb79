"""Reading a TOML file that a user gave."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from granfabric.cases.errors import InputError

from .text_file import decoded

LARGEST_FILE = 10_000_000
"""[byte] A scene written by hand has a few thousand; the largest path that the schema admits has less than this."""

HEADING = re.compile(r"[ \t]*(\[\[?)[ \t]*([A-Za-z0-9_-]+(?:[ \t]*\.[ \t]*[A-Za-z0-9_-]+)*)[ \t]*\]\]?[ \t]*(?:#.*)?")
TWICE = re.compile(r"(?:Cannot (?:overwrite|declare|mutate)|Duplicate)")
"""What the reader of TOML says of a key or a table that is there already."""
LINE = re.compile(r"\(at line (\d+)")


def read_table(file: Path, lists: Iterable[str] = ()) -> dict[str, Any]:
    """Content of a TOML file.

    Parameters
    ----------
    file : Path
    lists : iterable of str
        Tables of which there may be several, so that each is written ``[[name]]``.

    Raises
    ------
    InputError
        If it cannot be read or is not TOML.
    """
    try:
        if file.exists() and not file.is_file():  # a device or a pipe may never end
            raise OSError(0, "it is a folder, a device or a pipe")
        size = file.stat().st_size
        if size > LARGEST_FILE:
            raise OSError(0, f"{size / 1e6:.0f} MB is more than the {LARGEST_FILE / 1e6:.0f} MB that a scene may have")
        text = decoded(file.read_bytes(), file)
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror or os.strerror(error.errno or 0)}") from error
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{file}: not valid TOML: {_explained(str(error), text, set(lists))}") from error
    except ValueError as error:  # Python's own on integers of thousands of digits
        raise InputError(f"{file}: not valid TOML: {error}") from error
    except RecursionError as error:
        raise InputError(f"{file}: not valid as a scene: tables nested too deeply") from error


def _explained(said: str, text: str, lists: set[str]) -> str:
    """What the reader of TOML says, in words of a scene where it is about something given twice."""
    place = LINE.search(said)
    if not TWICE.match(said) or place is None:
        return said
    number = int(place[1])
    rows = text.split("\n")
    row = rows[number - 1] if number <= len(rows) else ""
    heading = HEADING.fullmatch(row)
    if heading is None:
        key = row.partition("=")[0].strip()
        return f"line {number}: {key if key.isprintable() and len(key) < 80 else 'a key'} is given twice"
    name = re.sub(r"\s", "", heading[2])
    single = [
        place
        for place, other in enumerate(rows, 1)
        if (found := HEADING.fullmatch(other)) and found[1] == "[" and re.sub(r"\s", "", found[2]) == name
    ]
    if name in lists and single:
        return (
            f"line {single[0]}: [{name}] is one of several that follow each other: write [[{name}]] each time, "
            "with two brackets"
        )
    return f"line {number}: the table [{name}] is there already"
