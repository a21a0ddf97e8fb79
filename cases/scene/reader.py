"""From a scene's name or file, and `--set` assignments, to a checked scene."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from granfabric.cases.errors import InputError, unknown

from . import accuracy, catalogue
from .material_file import read_material
from .schema import MODELS, Scene
from .toml_file import read_table
from .validation_messages import sentence

BARE_WORD = re.compile(r"(?:\.{0,2}/)*[A-Za-z_][A-Za-z0-9_./-]*")
"""A value of `--set` that is not TOML but looks like this is taken as text: the shell needs no double quotes."""


COMMANDS = {"point": "point", "field": "run", "dem": "dem"}
"""Command that computes each kind of scene."""

KIND_NAMES = {"point": "a point scene", "field": "a boundary-value problem", "dem": "a DEM scene"}

Origins = dict[tuple[str, ...], Path]
"""File from which a key came, where that is not the scene file."""


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
    included : dict
        Keys that came from a material file, with that file.
    accuracy : accuracy.Choice, optional
        What the scene's `accuracy` made of it, if it has one.
    """

    name: str
    file: Path
    scene: Any
    assigned: tuple[tuple[str, ...], ...] = ()
    included: Origins = field(default_factory=dict)
    accuracy: accuracy.Choice | None = None

    def origin(self, keys: Sequence[Any]) -> str:
        """Where a key was given: the scene file, `--set` or the material file."""
        return _origin(self.file, self.assigned, keys, self.included)

    def require(self, kind: str) -> None:
        """See that the scene is of a kind.

        Raises
        ------
        InputError
            With the command that computes a scene of its kind.
        """
        if self.scene.kind != kind:
            raise InputError(
                f"{self.file}: kind = {self.scene.kind!r} is not {KIND_NAMES[kind]}; "
                f"use `granfabric {COMMANDS[self.scene.kind]} {self.name}`"
            )

    def error(self, keys: Sequence[Any], text: str) -> InputError:
        """Error about a key, beginning with where it was given."""
        return InputError(f"{self.origin(keys)}: {text}")


def _origin(
    file: Path, assigned: Sequence[tuple[str, ...]], keys: Sequence[Any], included: Origins | None = None
) -> str:
    path = tuple(str(key) for key in keys)
    for given in assigned:
        if path and path[: len(given)] == given:
            return "--set"
    return str((included or {}).get(path, file))


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


def check(
    table: dict[str, Any],
    file: Path,
    assigned: Sequence[tuple[str, ...]] = (),
    included: Origins | None = None,
) -> Scene:
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
        raise InputError(f"{_origin(file, assigned, keys, included)}: {text}") from error


def _include_material(table: dict[str, Any], folder: Path, wins: bool) -> Origins:
    """Replace the key `material_file` of a scene by the tables of that file; which keys came from there.

    Keys that the scene has itself are kept unless the file `wins`. In a scene with tables ``[materials.NAME]`` the
    file's material fills in what each of them leaves open; it never wins there, which would make them all the same.
    """
    name, kind = table.get("material_file"), table.get("kind")
    if not isinstance(name, str) or not isinstance(kind, str) or kind not in MODELS:
        return {}  # the check refuses it
    if "material_file" not in MODELS[kind].model_fields:
        return {}
    del table["material_file"]
    file = catalogue.material(name, folder)
    origins: Origins = {}
    several = table.get("materials")
    for section, entries in read_material(file).items():
        places: dict[tuple[str, ...], Any] = {}
        if section == "material" and isinstance(several, dict) and section not in table and not wins:
            places = {("materials", name): own for name, own in several.items()}
        for place, own in (places or {(section,): table.setdefault(section, {})}).items():
            if not isinstance(own, dict):
                continue
            for key, value in entries.items():
                if wins or key not in own:
                    own[key] = value
                    origins[(*place, key)] = file
    return origins


def load(scene: str, assignments: Sequence[str] = ()) -> LoadedScene:
    """Find, read, change and check a scene.

    Parameters
    ----------
    scene : str
        Shipped name, scene file or folder.
    assignments : sequence of str
        ``key=value`` texts that override the file, in this order. The tables of a material file named in the scene
        yield to the scene's own keys; those of ``material_file=...`` given here replace them.

    Raises
    ------
    InputError
        With one sentence that names the file, the key, the value, what is legal and the nearest legal name.
    """
    file = catalogue.find(scene)
    table = read_table(file)
    included = _include_material(table, file.parent, wins=False)
    assigned = []
    for text in assignments:
        path, value = parse_assignment(text)
        assign(table, path, value)
        if path == ("material_file",):
            included |= _include_material(table, Path(), wins=True)
        assigned.append(path)
    choice = accuracy.apply(table)
    return LoadedScene(file.stem, file, check(table, file, assigned, included), tuple(assigned), included, choice)
