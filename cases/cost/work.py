"""A study as a piece of work of its own, for a process or another machine."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from .catalogue import STUDIES
from .study import Effort, Row, StudyError, StudyStopped


@dataclass(frozen=True)
class Worked:
    """What came of a study: its rows and the time that they took [s], or why there are none."""

    rows: list[Row] = field(default_factory=list)
    duration: float = 0.0
    failure: str = ""
    stopped: bool = False


def compute_study(
    name: str,
    quick: bool,
    rounds: int,
    store: Path,
    report: Callable[[float], None],
    stop: Callable[[], bool],
) -> Worked:
    """Compute a study.

    Parameters
    ----------
    name : str
    quick : bool
        Few and small settings.
    rounds : int
        Each time is the best of so many.
    store : Path
        For packings and runs of the DEM.
    report, stop : callable
    """
    since = time.perf_counter()

    def advance(done: int, total: int, text: str) -> None:
        if stop():
            raise StudyStopped
        report(done / total)

    try:
        rows = STUDIES[name].rows(Effort(quick, rounds, advance, store))
    except StudyStopped:
        return Worked(stopped=True)
    except StudyError as error:
        return Worked(failure=str(error))
    return Worked(rows, time.perf_counter() - since)
