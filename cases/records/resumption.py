"""Going on with a run: `--resume`. The input has to be the same; what is different is named."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from granfabric.cases.errors import InputError, short
from granfabric.cases.scene.keys import label

from . import files
from .record import versions

SHOWN = 4
"""Differences named before the rest is only counted."""


def mesh_digest(scene: dict[str, Any]) -> str | None:
    """SHA-256 of the mesh file of a scene as resolved; None if it has none."""
    file = scene.get("mesh", {}).get("file")
    return None if not file else hashlib.sha256(Path(file).read_bytes()).hexdigest()


def _plain(scene: dict[str, Any]) -> dict[str, Any]:
    """The scene as JSON gives it back, without the place of the mesh file: its content is compared instead."""
    table = json.loads(json.dumps(scene))
    if table.get("mesh", {}).get("file"):
        table["mesh"]["file"] = Path(table["mesh"]["file"]).name
    return table


def identity(scene: dict[str, Any], digest: str | None) -> str:
    """Text that tells the input of a run."""
    text = json.dumps([_plain(scene), digest], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _leaves(table: Any, keys: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    if not isinstance(table, (dict, list)) or not table:
        yield keys, table
        return
    for key, value in table.items() if isinstance(table, dict) else enumerate(table):
        yield from _leaves(value, (*keys, key))


def differences(then: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Keys whose values differ between two scenes as resolved, with both values."""
    before, after = dict(_leaves(_plain(then))), dict(_leaves(_plain(now)))
    found = []
    for key in dict.fromkeys([*before, *after]):
        if key not in after:
            found.append(f"{label(key, then)} was {short(before[key])} and is gone")
        elif key not in before:
            found.append(f"{label(key, now)} is {short(after[key])} and was not given")
        elif before[key] != after[key]:
            found.append(f"{label(key, now)} was {short(before[key])} and is {short(after[key])}")
    return found


def earlier_record(folder: Path) -> dict[str, Any]:
    """The `run.json` of the run to go on with.

    Raises
    ------
    InputError
        If there is none.
    """
    record = files.whole_record(folder)
    if record is None:
        raise InputError(f"--resume: {str(folder)!r} holds no run to go on with (no {files.RECORD} of {files.PROGRAM})")
    return record


def check_same_input(folder: Path, record: dict[str, Any], scene: dict[str, Any], digest: str | None) -> None:
    """Refuse to go on with another input than the run began with.

    Raises
    ------
    InputError
        Naming what changed.
    """
    found = differences(record["scene"], scene)
    if not found and record.get("mesh_digest") != digest:
        found.append(f"the content of the mesh file {scene['mesh'].get('file')!r} is another")
    if found:
        more = f" and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
        raise InputError(
            f"--resume: the input is not that of the run in {str(folder)!r}: {'; '.join(found[:SHOWN])}{more} "
            "(start anew without --resume, or in another folder with -o)"
        )


def other_versions(record: dict[str, Any]) -> list[str]:
    """Packages whose version is another than when the run began; last digits may then differ."""
    then, now = record.get("versions", {}), versions()
    return [f"{name} {then[name]} -> {now[name]}" for name in now if name in then and then[name] != now[name]]
