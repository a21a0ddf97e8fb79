"""One run of a sweep, as a piece of work for a process or another machine."""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console

from granfabric.cases.errors import InputError, RunError
from granfabric.cases.pictures import formats
from granfabric.cases.records import files, lock
from granfabric.cases.records.record import Record
from granfabric.cases.scene.reader import COMMANDS, LoadedScene, load
from granfabric.cases.sweep.record import State
from granfabric.cases.sweep.results import evaluate, results_of
from granfabric.cases.terminal.interruption import asked_of
from granfabric.cases.terminal.screen import Screen

from . import accuracy_report

PATIENCE = 60.0
"""[s] A folder that another process holds is waited for: one that was thought lost may still be at its end."""
PAUSE = 0.5


class Unseen(Screen):
    """Says nothing but to the log file of its run; progress goes to whoever asked for it."""

    def __init__(self, report: Callable[[float], None], command: Sequence[str]) -> None:
        super().__init__(Console(file=io.StringIO()), quiet=True)
        self.command = command
        self._report = report

    def say(self, text: str, insist: bool = False) -> None:
        self.log(text)

    @contextmanager
    def progress(self, what: str, total: float) -> Iterator[Callable[[float, str], None]]:
        yield lambda completed, text: self._report(completed / total if total else 1.0)


def run_one(
    scene: str,
    assignments: tuple[str, ...],
    folder: str,
    here: str,
    results: tuple[str, ...],
    kinds: tuple[str, ...],
    report: Callable[[float], None],
    stop: Callable[[], bool],
) -> State:
    """Compute a scene in a folder of its own, or go on where it was; what came of it, as data.

    Parameters
    ----------
    scene : str
        Shipped name or file.
    assignments : tuple of str
    folder : str
        Result folder of this run alone.
    here : str
        Working folder of the command, for files that are named by assignments.
    results : tuple of str
        Numbers that are taken from its files.
    kinds : tuple of str
        Formats of its pictures.
    report, stop : callable
    """
    since = time.monotonic()
    while True:
        try:
            loaded = load(scene, assignments, Path(here))
            words = [COMMANDS[loaded.scene.kind], scene, *(word for text in assignments for word in ("--set", text))]
            screen = Unseen(report, [*words, "-o", folder])
            with asked_of(stop), lock.command(), screen.listening(), formats.written_as(kinds):
                record = _compute(loaded, Path(folder), screen)
            numbers = evaluate(Path(folder), results_of(results, loaded.scene.kind))
            return State(record.outcome, record.message, record.timing.get("total", 0.0), numbers)
        except lock.HeldError as error:
            if stop() or time.monotonic() - since > PATIENCE:
                return State("failed", str(error))
            time.sleep(PAUSE)
        except (InputError, RunError, OSError) as error:
            return State("stopped" if isinstance(error, RunError) and stop() else "failed", str(error))
        except MemoryError:
            return State("failed", "there is not enough memory for this")


def _compute(loaded: LoadedScene, folder: Path, screen: Screen) -> Record:
    accuracy_report.announce(loaded, screen)
    begun = files.whole_record(folder) is not None
    record = None
    if begun and loaded.scene.kind != "point":
        try:
            record = _run(loaded, folder, screen, resume=True)
        except lock.HeldError:
            raise
        except InputError as error:
            screen.say(f"beginning anew: {error}")
    if record is None:
        record = _run(loaded, folder, screen, resume=False)
    accuracy_report.report(loaded, record, screen)
    return record


def _run(loaded: LoadedScene, folder: Path, screen: Screen, resume: bool) -> Record:
    if loaded.scene.kind == "point":
        from .point import run_point

        return run_point(loaded, folder, screen, overwrite=True)
    if loaded.scene.kind in ("dem", "specimen"):
        from .dem import run_disks

        return run_disks(loaded, folder, screen, resume, overwrite=True)
    from .run import run_field

    return run_field(loaded, folder, screen, resume, overwrite=True)
