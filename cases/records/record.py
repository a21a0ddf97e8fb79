"""`run.json`: what was computed, with what, how it ended and where the time went."""

from __future__ import annotations

import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

from granfabric.cases.errors import RunError
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.scene.schema_law_kind import is_grains
from granfabric.cases.scene.toml_text import to_toml
from granfabric.cases.terminal.compile_watch import CompileWatch
from granfabric.constitutive.effects import Effects

from . import files

FORMAT = 1
PACKAGES = ("granfabric", "numpy", "numba", "scipy", "scikit-fem", "meshio")

Outcome = Literal["running", "finished", "stopped", "failed"]


def versions() -> dict[str, str]:
    """Versions of everything that can change a number."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def resolved(loaded: LoadedScene, effects: Effects | None) -> dict[str, Any]:
    """The scene with all defaults filled in, effects decided and files by their absolute paths."""
    table = loaded.scene.model_dump(exclude_none=True, exclude_defaults=False)
    if is_grains(table):
        for section in ("closure", "effects", "integration"):
            table.pop(section, None)
        table.get("packing", {}).pop("stiffness_to_pressure", None)
    if effects is not None:
        table["effects"] = {**table["effects"], **asdict(effects)}
    for section, key in (("mesh", "file"), ("packing", "grading_file"), ("law", "packing_file")):
        if table.get(section, {}).get(key):
            table[section][key] = str((loaded.file.parent / table[section][key]).resolve())
    return {"title": table.pop("title"), "kind": table.pop("kind"), **table}


@dataclass
class Record:
    """The content of `run.json`, written when a run begins, and again when it ends.

    A folder whose record still says "running" belongs to a run that is under way or was killed; its files are whole.
    `since` is when the run began by `time.perf_counter`: of the time from then on `timing` tells the parts.
    """

    folder: Path
    name: str
    scene: dict[str, Any]
    outcome: Outcome = "running"
    message: str = ""
    details: dict[str, Any] = field(default_factory=dict)
    timing: dict[str, float] = field(default_factory=dict)
    started: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    is_scene: bool = True
    scene_file: str | None = None
    since: float = field(default_factory=time.perf_counter)

    @contextmanager
    def phase(self, name: str, watch: CompileWatch | None = None) -> Iterator[None]:
        """Add the time of the block to a phase, with a watch without the time spent compiling."""
        clock = time.perf_counter if watch is None else watch.clock
        since = clock()
        try:
            yield
        finally:
            self.timing[name] = self.timing.get(name, 0.0) + clock() - since

    def write(self) -> None:
        """Write `run.json` and, if it is a scene that can be run again, the scene as resolved."""
        self.timing["total"] = time.perf_counter() - self.since
        data = {
            "program": files.PROGRAM,
            "format": FORMAT,
            "name": self.name,
            "kind": self.scene["kind"],
            **({"scene_file": self.scene_file} if self.scene_file is not None else {}),
            "outcome": self.outcome,
            "message": self.message,
            "started": self.started,
            "versions": versions(),
            "effects": self.scene.get("effects", {}),
            "timing": {name: round(seconds, 6) for name, seconds in self.timing.items()},
            **self.details,
            "scene": self.scene,
        }
        files.write_json(self.folder / files.RECORD, data)
        if self.is_scene:
            files.write_text(self.folder / files.SCENE, to_toml(self.scene))

    def broken_off(self, message: str) -> RunError:
        """Close the record of a run that ended within a step, if that can still be written; the error to raise."""
        self.outcome, self.message = "stopped", message
        with suppress(OSError):
            self.write()
        return RunError(f"{message}; what was computed before is in {self.folder}")
