"""From a scene's name or file, and `--set` assignments, to a checked scene."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from . import catalogue
from .complaints import sentence
from .errors import InputError, unknown
from .schema import MODELS, Scene

BARE_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_./-]*")
"""A value of `--set` that is not TOML but looks like this is taken as text: the shell needs no double quotes."""


@dataclass(frozen=True)
class LoadedScene:
    """A checked scene, with what is needed to speak about it.

    Parameters
    ----------
    name : str
        Name of the file without its ending.
    file : Path
        Where it was read from; mesh files are relative to its folder.
    scene : Scene
        The checked content with all defaults filled in.
    assigned : tuple of tuple
        Keys given by `--set`.
    """

    name: str
    file: Path
    scene: Any
    assigned: tuple[tuple[str, ...], ...] = ()

    def origin(self, keys: Sequence[Any]) -> str:
        """Where a key was given: the file, or `--set`."""
        return _origin(self.file, self.assigned, keys)

    def error(self, keys: Sequence[Any], text: str) -> InputError:
        """Error about a key, beginning with where it was given."""
        return InputError(f"{self.origin(keys)}: {text}")


def _origin(file: Path, assigned: Sequence[tuple[str, ...]], keys: Sequence[Any]) -> str:
    path = tuple(str(key) for key in keys)
    for given in assigned:
        if path and path[: len(given)] == given:
            return "--set"
    return str(file)


def read_table(file: Path) -> dict[str, Any]:
    """Content of a TOML file.

    Raises
    ------
    InputError
        If it cannot be read or is not TOML.
    """
    try:
        return tomllib.loads(file.read_bytes().decode("utf-8"))
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: not a text in UTF-8 (byte {error.start})") from error
    except ValueError as error:  # tomllib's own error, and Python's on integers of thousands of digits
        raise InputError(f"{file}: not valid TOML: {error}") from error
    except RecursionError as error:
        raise InputError(f"{file}: not valid as a scene: tables nested too deeply") from error
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}") from error


def parse_assignment(text: str) -> tuple[tuple[str, ...], Any]:
    """Key and value of one `--set key=value`; the value is TOML, a bare word is a text.

    Raises
    ------
    InputError
    """
    key, equals, value = text.partition("=")
    path = tuple(part.strip() for part in key.split("."))
    if not equals or not all(part and part.isprintable() for part in path):
        raise InputError(f"--set {text!r} is not of the form key=value, for instance material.coordination=3.9")
    if "\n" in value:  # a further line could hold further keys
        raise InputError(f"--set {'.'.join(path)}: the value has more than one line")
    try:
        return path, tomllib.loads(f"value = {value}")["value"]
    except (ValueError, RecursionError) as error:
        if BARE_WORD.fullmatch(value.strip()):
            return path, value.strip()
        raise InputError(
            f'--set {".".join(path)}: {value!r} is not a TOML value such as 3.9, true, "text" or [1.0, 2.0]'
        ) from error


def assign(table: dict[str, Any], path: tuple[str, ...], value: Any) -> None:
    """Put a value at a key of nested tables and lists (lists by number from 0); missing tables are made.

    Raises
    ------
    InputError
    """
    shown = ".".join(path)
    here: Any = table
    for depth, part in enumerate(path):
        last = depth == len(path) - 1
        if isinstance(here, list):
            if not part.isdecimal() or int(part) >= len(here):
                inside = ".".join(path[:depth])
                raise InputError(
                    f"--set {shown}: {inside!r} has {len(here)} entries, numbered from 0; {part!r} is none"
                )
            place: Any = int(part)
        elif isinstance(here, dict):
            place = part
            if not last and part not in here:
                here[part] = {}
        else:
            raise InputError(f"--set {shown}: {'.'.join(path[:depth])!r} is a single value and has no {part!r}")
        if last:
            here[place] = value
        else:
            here = here[place]


def check(table: dict[str, Any], file: Path, assigned: Sequence[tuple[str, ...]] = ()) -> Scene:
    """Check a table against the schema of its kind.

    Raises
    ------
    InputError
        One sentence on the gravest error.
    """
    kinds = ", ".join(MODELS)
    if "kind" not in table:
        raise InputError(f"{file}: 'kind' is missing (legal: {kinds})")
    kind = table["kind"]
    if not isinstance(kind, str) or kind not in MODELS:
        raise InputError(f"{_origin(file, assigned, ['kind'])}: {unknown('kind =', str(kind), MODELS)}")
    model = MODELS[kind]
    try:
        return model.model_validate(table)
    except ValidationError as error:
        keys, text = sentence(error, model, table)
        raise InputError(f"{_origin(file, assigned, keys)}: {text}") from error


def load(scene: str, assignments: Sequence[str] = ()) -> LoadedScene:
    """Find, read, change and check a scene.

    Parameters
    ----------
    scene : str
        Shipped name, scene file or folder.
    assignments : sequence of str
        ``key=value`` texts that override the file.

    Raises
    ------
    InputError
        With one sentence that names the file, the key, the value, what is legal and the nearest legal name.
    """
    file = catalogue.find(scene)
    table = read_table(file)
    assigned = []
    for text in assignments:
        path, value = parse_assignment(text)
        assign(table, path, value)
        assigned.append(path)
    return LoadedScene(file.stem, file, check(table, file, assigned), tuple(assigned))
