"""From a scene's name or file, and `--set` assignments, to a checked scene."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from granfabric.cases.errors import InputError, several, short, unknown

from . import accuracy, catalogue, schema_law_kind
from .keys import label, value_at
from .kinds import kind_of, require_kind
from .material_file import read_material
from .owner import Owner
from .schema import MODELS, TABLE_LISTS, Scene
from .toml_file import read_table
from .validation_messages import messages

BARE_WORD = re.compile(r"(?:\.{0,2}/)*[A-Za-z_][A-Za-z0-9_./-]*")
"""A value of `--set` that is not TOML but looks like this is taken as text: the shell needs no double quotes."""


COMMANDS = {"point": "point", "field": "run", "dem": "dem", "specimen": "dem"}
"""Command that computes each kind of scene."""

KIND_NAMES = {
    "point": "a point scene", "field": "a boundary-value problem", "dem": "a DEM scene of a periodic packing",
    "specimen": "a DEM scene of a specimen",
}  # fmt: skip

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

    @property
    def owner(self) -> Owner:
        """Whose results a run of the scene writes."""
        return Owner(self.scene.kind, self.name, self.scene.title, self.file)

    def origin(self, keys: Sequence[Any], text: str = "") -> str:
        """Where a key was given: the scene file, `--set` or the material file; `text` is what is said of it."""
        return _origin(self.file, self.assigned, keys, self.included, text)

    def label(self, keys: Sequence[Any]) -> str:
        """A key as a user counts it, see `keys.label`."""
        return label(keys, self.scene)

    @property
    def called(self) -> str:
        """What a command finds the scene by: its name if it is shipped, else its file."""
        return self.name if self.file.is_relative_to(catalogue.HOME) else str(self.file)

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
                f"use `granfabric {COMMANDS[self.scene.kind]} {self.called}`"
            )

    def error(self, keys: Sequence[Any], text: str) -> InputError:
        """Error about a key, beginning with where it was given."""
        return self.errors([(keys, text)])

    def errors(self, found: Sequence[tuple[Sequence[Any], str]]) -> InputError:
        """Errors about several keys, one a line."""
        return several([f"{self.origin(keys, text)}: {text}" for keys, text in found])


def _origin(
    file: Path,
    assigned: Sequence[tuple[str, ...]],
    keys: Sequence[Any],
    included: Origins | None = None,
    text: str = "",
) -> str:
    path = tuple(str(key) for key in keys)
    for given in assigned:
        if path and path[: len(given)] == given:
            # numbers in what was typed count from 0, those in what is said from 1
            return f"--set {'.'.join(given)}" if any(part.isdecimal() for part in given) else "--set"
    origins = included or {}
    if path in origins:
        return str(origins[path])
    # said of a whole table, but about a key that the other file gave
    words = set(re.findall(r"\w+", text))
    for key, other in origins.items():
        if key[: len(path)] == path and key[-1] in words:
            return str(other)
    return str(file)


def parse_assignment(text: str) -> tuple[tuple[str, ...], Any]:
    """Key and value of one `--set key=value`; the value is TOML, a bare word is a text.

    Raises
    ------
    InputError
    """
    key, equals, value = text.partition("=")
    path = tuple(part.strip() for part in key.split("."))
    if not equals or not all(part and part.isprintable() for part in path):
        raise InputError(f"--set {short(text)} is not of the form key=value, for instance material.coordination=3.9")
    if "\n" in value:  # a further line could hold further keys
        raise InputError(f"--set {'.'.join(path)}: the value has more than one line")
    try:
        return path, tomllib.loads(f"value = {value}")["value"]
    except (ValueError, RecursionError) as error:
        if BARE_WORD.fullmatch(value.strip()):
            return path, value.strip()
        raise InputError(
            f'--set {".".join(path)}: {short(value)} is not a TOML value such as 3.9, true, "text" or [1.0, 2.0]'
        ) from error


def assign(table: dict[str, Any], path: tuple[str, ...], value: Any) -> tuple[str, ...]:
    """Put a value at a key of nested tables and lists; missing tables are made.

    Entries of lists go by their number, from 0, or by their name if they have one: ``stage.initial.increments``.

    Returns
    -------
    tuple of str
        The key with numbers for names; of one in a table that was missing, the key of that table.

    Raises
    ------
    InputError
    """
    shown = ".".join(path)
    here: Any = table
    taken: list[str] = []
    made = 0
    for depth, part in enumerate(path):
        last = depth == len(path) - 1
        if isinstance(here, list):
            place: Any = _entry(here, part)
            if place is None:
                inside = ".".join(path[:depth])
                names = [entry["name"] for entry in here if isinstance(entry, dict) and "name" in entry]
                known = f" or named {', '.join(map(str, names))}" if names else ""
                raise InputError(
                    f"--set {shown}: {inside!r} has {len(here)} entries, numbered from 0{known}; {part!r} is none"
                )
        elif isinstance(here, dict):
            place = part
            if not last and part not in here:
                here[part] = {}
                made = made or depth + 1
        else:
            raise InputError(f"--set {shown}: {'.'.join(path[:depth])!r} is a single value and has no {part!r}")
        taken.append(str(place))
        if last:
            here[place] = value
        else:
            here = here[place]
    return tuple(taken[: made or None])


def _entry(entries: list[Any], part: str) -> int | None:
    """Number of an entry of a list given by its number or its name."""
    for number, entry in enumerate(entries):
        if isinstance(entry, dict) and entry.get("name") == part:
            return number
    return int(part) if part.isdecimal() and len(part) < 19 and int(part) < len(entries) else None


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
        A sentence on every error, one a line.
    """
    require_kind(table, file)
    kind = table["kind"]
    if not isinstance(kind, str) or kind not in MODELS:
        raise InputError(f"{_origin(file, assigned, ['kind'])}: {unknown('kind =', str(kind), MODELS)}")
    model = MODELS[kind]
    try:
        return model.model_validate(table)
    except ValidationError as error:
        found = messages(error, model, table)
        raise several([f"{_origin(file, assigned, keys, included, text)}: {text}" for keys, text in found]) from error


def _include_material(
    table: dict[str, Any], folder: Path, earlier: Origins | None = None, wins: bool = False
) -> Origins:
    """Replace the key `material_file` of a scene by the tables of that file; which keys came from there.

    Keys that the scene has itself are kept unless the file `wins`; those of an `earlier` material file go. In a scene
    with tables ``[materials.NAME]`` the file's material fills in what each of them leaves open; what they say
    themselves always stays, or they would all become the same.
    """
    name = table.get("material_file")
    if not isinstance(name, str) or not name:
        return {}  # the check refuses it
    kind = table.get("kind", kind_of(table))
    if not isinstance(kind, str) or kind not in MODELS or "material_file" not in MODELS[kind].model_fields:
        return {}
    del table["material_file"]
    file = catalogue.material(name, folder)
    contents = read_material(file)
    for keys in earlier or {}:
        own = value_at(table, keys[:-1])
        if isinstance(own, dict):
            own.pop(keys[-1], None)
    origins: Origins = {}
    each = table.get("materials")
    for section, entries in contents.items():
        places: dict[tuple[str, ...], Any] = {}
        if section == "material" and isinstance(each, dict) and section not in table:
            places = {("materials", name): own for name, own in each.items()}
        for place, own in (places or {(section,): table.setdefault(section, {})}).items():
            if not isinstance(own, dict):
                continue
            for key, value in entries.items():
                if key not in own or (wins and not places):
                    own[key] = value
                    origins[(*place, key)] = file
    return origins


PATH_KEYS = (("mesh", "file"), ("material_file",), ("packing", "grading_file"), ("law", "packing_file"))
"""Keys that name a file."""


def _from_here(table: dict[str, Any], path: tuple[str, ...], here: Path) -> None:
    """Make a path that was given by `--set` absolute: it is meant from the working folder, not from the scene's."""
    for key in PATH_KEYS:
        value = value_at(table, key) if path == key[: len(path)] else None
        if isinstance(value, str) and value and (key != ("material_file",) or catalogue.is_path(value)):
            value_at(table, key[:-1])[key[-1]] = os.path.abspath(here / Path(value).expanduser())


def load(scene: str, assignments: Sequence[str] = (), here: Path | None = None) -> LoadedScene:
    """Find, read, change and check a scene.

    Parameters
    ----------
    scene : str
        Shipped name, scene file or folder.
    assignments : sequence of str
        ``key=value`` texts that override the file. The tables of a material file named in the scene yield to the
        scene's own keys; those of ``material_file=...`` given here replace them (but see ``[materials.NAME]`` in
        `docs/scenes.md`) and yield to keys given here. Paths are relative to where they are written: the working folder
        here, the folder of the file there.
    here : Path, optional
        The working folder, if it is not that of this process.

    Raises
    ------
    InputError
        With a sentence for each error: the file, the key, the value, what is legal and the nearest legal name.
    """
    file = catalogue.find(scene)
    table = read_table(file, TABLE_LISTS)
    parsed = [parse_assignment(text) for text in assignments]
    # a file first: a key that is given by itself means more than one among those of a file
    parsed.sort(key=lambda entry: entry[0] != ("material_file",))
    included = _include_material(table, file.parent)
    assigned = []
    for path, value in parsed:
        taken = assign(table, path, value)
        _from_here(table, path, here or Path())
        assigned.append(taken)
        if path == ("material_file",):
            new = _include_material(table, here or Path(), included, wins=True)
            included = new or included
    table.setdefault("title", _title(file))
    kind = kind_of(table)
    if kind is not None:
        table.setdefault("kind", kind)
    choice = accuracy.apply(table)
    schema_law_kind.fill(table)
    return LoadedScene(file.stem, file, check(table, file, assigned, included), tuple(assigned), included, choice)


def _title(file: Path) -> str:
    """Title of a scene that gives none: the name of its file."""
    return (file.stem if file.stem.isprintable() else repr(file.stem))[:200]
