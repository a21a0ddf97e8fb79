"""`granfabric cost`: run studies, write their files, keep finished ones whatever happens."""

from __future__ import annotations

import math
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from granfabric.cases.cost.catalogue import STUDIES, chosen
from granfabric.cases.cost.page import page
from granfabric.cases.cost.study import Effort, Row, Study, StudyError, StudyStopped
from granfabric.cases.cost.work import compute_study
from granfabric.cases.engine.choice import Choice
from granfabric.cases.engine.jobs import Ended, Job
from granfabric.cases.engine.machine import threads
from granfabric.cases.errors import InputError, RunError
from granfabric.cases.records import files, lock
from granfabric.cases.records.record import versions
from granfabric.cases.terminal.compile_watch import watching
from granfabric.cases.terminal.interruption import interrupt_request
from granfabric.cases.terminal.screen import Screen

RECORD, PAGE, STORE = "cost.json", "cost.md", "dem"
FORMAT = 1
KIND = "cost"
COMPILATION_SECONDS = 60
"""Rough time to compile all kernels, for the message on first use."""
ROUNDS, QUICK_ROUNDS = 3, 1


@dataclass(frozen=True)
class Outcome:
    """How the command ended: `finished`, or `stopped` on request; and which studies were finished by it."""

    outcome: str
    studies: tuple[str, ...]


def read_record(folder: Path) -> dict[str, Any] | None:
    """The `cost.json` of a folder if it is one of ours, else None."""
    try:
        data = files.read_json(folder / RECORD)
    except (OSError, ValueError):
        return None
    ours = isinstance(data, dict) and data.get("program") == files.PROGRAM and data.get("kind") == KIND
    return data if ours and isinstance(data.get("studies"), dict) else None


def run_cost(
    name: str | None,
    folder: Path,
    screen: Screen,
    quick: bool = False,
    resume: bool = False,
    overwrite: bool = False,
    choice: Choice | None = None,
) -> Outcome:
    """Compute the named study, or all, and write table, picture and page.

    What is asked for is computed anew, unless `resume` asks to keep what has finished. Studies that are in the folder
    already and not asked for stay, with the time at which they were made. A study's files are replaced when it has
    finished, never before; one that cannot be computed does not keep the others from being.

    Parameters
    ----------
    name : str or None
        None for all studies.
    folder : Path
        New, empty, or of an earlier `granfabric cost`.
    screen : Screen
    quick : bool
        Few and small settings.
    resume : bool
        Pass over studies that finished in this folder, in the same size.
    overwrite : bool
        Replace the results of another command.
    choice : Choice, optional
        Who computes the studies; this process, one after the other, if not given. Side by side they disturb each
        other's times a little, and nothing else of the tables.

    Raises
    ------
    InputError
        If there is no such study or the folder holds something else; then nothing was written.
    RunError
        If a study could not be computed; the others are on disk.
    """
    asked = chosen(name)
    choice = choice or Choice()
    choice.check()
    _take_folder(folder, overwrite)
    with lock.held(folder):
        return _run(asked, folder, screen, quick, resume, choice)


def _run(
    asked: Sequence[Study], folder: Path, screen: Screen, quick: bool, resume: bool, choice: Choice
) -> Outcome:
    """Compute studies in a folder that is held."""
    record = _begin(folder)
    screen.keep_log(folder / files.LOG, versions())
    studies = [study for study in asked if not (resume and record["studies"].get(study.name, {}).get("quick") is quick)]
    done: list[str] = []
    failed: list[str] = []

    def finish(study: Study, rows: list[Row], duration: float) -> None:
        _write(folder, record, study, rows, duration, quick)
        done.append(study.name)
        for text in record["studies"][study.name]["findings"]:
            screen.say(f"  {text}")

    def fail(study: Study, why: str) -> None:
        failed.append(f"study {study.name}: {why}")
        screen.say(failed[-1])

    with (
        watching(screen.announce_compilation(COMPILATION_SECONDS)),
        interrupt_request(lambda: screen.say("stopping (Ctrl-C again stops at once)")) as stop,
        threads(choice.threads or 1),
    ):
        side_by_side = choice.scheduler is not None or (choice.workers or 1) > 1
        if side_by_side:
            _side_by_side(studies, choice, folder, screen, quick, stop, finish, fail)
            if stop.requested:
                return _stopped(studies, done, folder, screen)
        for place, study in enumerate([] if side_by_side else studies):
            screen.say(f"study {place + 1} of {len(studies)}, {study.name}: {study.question}")
            try:
                rows, duration = _compute(study, quick, screen, stop, folder / STORE)
            except (StudyStopped, KeyboardInterrupt):
                return _stopped(studies, done, folder, screen)
            except StudyError as error:
                fail(study, str(error))
                continue
            finish(study, rows, duration)
    kept = [other for other in record["studies"] if other not in done]
    if kept:
        screen.say(f"kept from earlier: {', '.join(kept)}")
    if failed:
        raise RunError(f"{'; '.join(failed)}; finished: {', '.join(done) or 'none'}")
    screen.say(f"page, tables and pictures in {folder / PAGE}")
    return Outcome("finished", tuple(done))


def _whole(folder: Path, name: str, entry: Any) -> bool:
    """Whether an entry of a record is a study of today's, with all its columns and its table."""
    if name not in STUDIES or not isinstance(entry, dict) or not (folder / f"{name}.csv").is_file():
        return False
    rows = entry.get("rows")
    columns = {column.name for column in STUDIES[name].columns}
    return isinstance(rows, list) and bool(rows) and all(isinstance(row, dict) and set(row) == columns for row in rows)


def _stopped(studies: Sequence[Study], done: Sequence[str], folder: Path, screen: Screen) -> Outcome:
    missing = [study.name for study in studies if study.name not in done]
    screen.say(f"stopped; finished: {', '.join(done) or 'none'}; not computed: {', '.join(missing)}; see {folder}")
    return Outcome("stopped", tuple(done))


def _compute(study: Study, quick: bool, screen: Screen, stop: Any, store: Path) -> tuple[list[Row], float]:
    since = time.perf_counter()
    with screen.progress(study.name, 1.0) as show:

        def advance(done: int, total: int, text: str) -> None:
            if stop():
                raise StudyStopped
            show(done / total, text)

        rows = study.rows(Effort(quick, QUICK_ROUNDS if quick else ROUNDS, advance, store))
    return rows, time.perf_counter() - since


def _side_by_side(
    studies: Sequence[Study],
    choice: Choice,
    folder: Path,
    screen: Screen,
    quick: bool,
    stop: Any,
    finish: Callable[[Study, list[Row], float], None],
    fail: Callable[[Study, str], None],
) -> None:
    """Studies as pieces of work of their own; each is written by this process when it has finished."""
    named = {study.name: study for study in studies}
    with choice.engine(folder, screen, stop, len(studies)) as engine, screen.progress("cost", len(studies)) as show:
        screen.say(f"{len(studies)} {'study' if len(studies) == 1 else 'studies'}; {engine.text}")
        ended = 0

        def follow(job: Job, came: Ended) -> list[Job]:
            nonlocal ended
            ended += 1
            study, work = named[job.key], came.value
            if isinstance(came.error, OSError):
                raise RunError(f"results cannot be written any more: {came.error}")
            if came.error is not None or work.failure:
                fail(study, str(came.error) if came.error is not None else work.failure)
            elif not work.stopped:
                screen.say(f"study {study.name}: {study.question}")
                finish(study, work.rows, work.duration)
            return []

        arguments = (quick, QUICK_ROUNDS if quick else ROUNDS, folder / STORE)
        function = f"{compute_study.__module__}:{compute_study.__name__}"
        kernels = ("mean_field", "shifted_distribution", "host", "dem")
        jobs = [Job(name, name, function, (name, *arguments), kernels) for name in named]
        engine.carry_out(jobs, follow, lambda work: show(ended + sum(work.values()), "; ".join(work)), stop)


def _take_folder(folder: Path, overwrite: bool) -> None:
    """Make the folder, unless it holds something else.

    Raises
    ------
    InputError
    """
    if read_record(folder) is None:
        if not overwrite and folder.is_dir() and files.read_record(folder) is not None:
            raise InputError(
                f"the output folder {str(folder)!r} holds the result of another command; choose a new or empty folder "
                "with -o, or replace it with --overwrite"
            )
        files.check_output(folder)
    elif not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"the output folder {str(folder)!r} cannot be written: it is write-protected")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"the output folder {str(folder)!r} cannot be made: {error.strerror}") from error


def _begin(folder: Path) -> dict[str, Any]:
    """The record of the studies in a folder that is held; one without studies in a new one."""
    empty: dict[str, Any] = {"program": files.PROGRAM, "kind": KIND, "format": FORMAT, "studies": {}}
    found = read_record(folder)
    if found is None:
        files.prepare_output(folder)
        # from here on the folder is ours, also if the first study does not finish
        files.write_json(folder / RECORD, empty)
        return empty
    kept = {name: entry for name, entry in found["studies"].items() if _whole(folder, name, entry)}
    return {**empty, "studies": kept}


def _write(
    folder: Path, record: dict[str, Any], study: Study, rows: Sequence[Row], duration: float, quick: bool
) -> None:
    names = [column.name for column in study.columns]
    table = [["" if _missing(row[name]) else row[name] for name in names] for row in rows]
    files.write_text(folder / f"{study.name}.csv", files.csv_text(names, table))
    study.draw(folder / f"{study.name}.png", rows)
    record["studies"][study.name] = {
        "question": study.question,
        "knobs": dict(study.knobs),
        "columns": {column.name: {"meaning": column.meaning, "unit": column.unit} for column in study.columns},
        "findings": study.findings(rows),
        "rows": [{name: None if _missing(row[name]) else row[name] for name in names} for row in rows],
        "quick": quick,
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "duration": round(duration, 3),
    }
    record["studies"] = {name: record["studies"][name] for name in STUDIES if name in record["studies"]}
    record["versions"] = versions()
    record["machine"] = f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors, one used"
    files.write_json(folder / RECORD, record)
    files.write_text(folder / PAGE, page(record, [(STUDIES[name], _rows(record, name)) for name in record["studies"]]))


def _rows(record: dict[str, Any], name: str) -> list[Row]:
    """Rows of a study from the record; what is missing there is NaN."""
    rows = record["studies"][name]["rows"]
    return [{key: math.nan if value is None else value for key, value in row.items()} for row in rows]


def _missing(value: Any) -> bool:
    return isinstance(value, float) and not math.isfinite(value)
