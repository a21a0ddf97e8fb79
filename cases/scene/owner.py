"""Whose results a folder holds: those of one scene are never replaced by another's without being asked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from granfabric.cases.errors import InputError


@dataclass(frozen=True)
class Owner:
    """What a result folder belongs to.

    The same scene with other values, from `--set` or after an edit, is the same owner: to try values one after the
    other in one folder is a habit, and each run says in `run.json` with which it was made.

    Parameters
    ----------
    kind, name, title : str
        As in `run.json`.
    file : Path or None
        The scene file; None for what no scene file describes.
    """

    kind: str
    name: str
    title: str
    file: Path | None = None

    @property
    def place(self) -> str | None:
        """Absolute path of the scene file, as it is recorded."""
        return None if self.file is None else str(self.file.resolve())


def is_another(folder: Path, record: dict[str, Any], owner: Owner) -> bool:
    """Whether the results in a folder, by their `run.json`, are those of another scene.

    A scene is known by its file. If that file is gone (moved, or not recorded), name and title tell. The copy of the
    scene in the result folder itself is the same scene.
    """
    scene = record.get("scene")
    title = scene.get("title") if isinstance(scene, dict) else None
    if record.get("kind") != owner.kind:
        return True
    place = record.get("scene_file")
    if owner.file is not None:
        if owner.place == place or owner.file.resolve().parent == folder.resolve():
            return False
        if isinstance(place, str) and Path(place).is_file():
            return True
    return (record.get("name"), title) != (owner.name, owner.title)


def refuse_another(folder: Path, record: dict[str, Any], owner: Owner) -> None:
    """Refuse to replace the results of another scene.

    Raises
    ------
    InputError
    """
    if not is_another(folder, record, owner):
        return
    what = f"{record.get('kind', 'unknown')} {record.get('name', '')!r}"
    place = record.get("scene_file")
    origin = f" ({place})" if isinstance(place, str) else ""
    state = {"finished": "finished run", "running": "unfinished run"}.get(str(record.get("outcome")), "run")
    raise InputError(
        f"the output folder {str(folder)!r} holds a {state} of another scene, {what}{origin}; choose another folder "
        "with -o, or replace it with --overwrite"
    )
