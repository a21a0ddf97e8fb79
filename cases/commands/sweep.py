"""Many runs of one scene with other values: `granfabric sweep`."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from granfabric.cases.engine import kernels
from granfabric.cases.engine.choice import Choice
from granfabric.cases.engine.jobs import Ended, Job
from granfabric.cases.errors import InputError, several
from granfabric.cases.pictures import formats
from granfabric.cases.records import files
from granfabric.cases.records.record import Record, resolved, versions
from granfabric.cases.records.resumption import identity, mesh_digest, other_versions
from granfabric.cases.scene import build
from granfabric.cases.scene.owner import Owner
from granfabric.cases.scene.reader import LoadedScene, load
from granfabric.cases.scene.schema_law_kind import is_grains
from granfabric.cases.sweep import record as kept
from granfabric.cases.sweep.field_columns import refuse_missing
from granfabric.cases.sweep.plan import Plan, Request, Run, plan_of
from granfabric.cases.sweep.record import NOT_BEGUN, State
from granfabric.cases.sweep.results import Result, results_of
from granfabric.cases.terminal.interruption import interrupt_request
from granfabric.cases.terminal.screen import Screen, spread

from .ready import refuse_unready
from .sweep_run import run_one

COMPILATION_SECONDS = 20
"""Rough time to compile the kernels, by whichever process comes first."""
PICTURES = "output.pictures"
MOST_WRONG = 200
"""Errors of runs after which no more are checked."""
SAVE_SECONDS = 5.0
"""Least time between two writings of the tables while runs are at work."""
SHOWN_RUNS, SHOWN_FAILURES, SHOWN_WRONG = 12, 20, 4


@dataclass(frozen=True)
class Sweep:
    """What is asked for.

    Attributes
    ----------
    scene : str
        Shipped name, file or folder.
    request : Request
        What varies, and what else is set.
    results : sequence of str
        Numbers to take from each run; sensible ones if empty.
    pictures : bool
        Make those of each run too.
    choice : Choice
        Who computes.
    """

    scene: str
    request: Request
    results: Sequence[str] = ()
    pictures: bool = False
    choice: Choice = field(default_factory=Choice)


@dataclass
class _Checked:
    """A plan all runs of which are legal."""

    plan: Plan
    base: dict[str, Any]
    marks: dict[str, str]
    results: list[Result]
    loaded: LoadedScene
    called: str
    kernels: tuple[str, ...]


def run_sweep(
    sweep: Sweep,
    folder: Path,
    screen: Screen,
    resume: bool = False,
    overwrite: bool = False,
    then: Callable[[Record, Plan, dict[str, State]], None] | None = None,
) -> Record:
    """Compute all runs, each in a folder of its own, and write the tables and the picture.

    Parameters
    ----------
    sweep : Sweep
    folder : Path
        New or empty, or that of the sweep to go on with.
    screen : Screen
    resume : bool
        Take what has finished in the folder, go on with what was begun; further runs may have come.
    overwrite : bool
        Replace an earlier sweep, or results of another scene.
    then : callable, optional
        Called with record, plan and states when the tables are written.

    Returns
    -------
    Record
        As written to `run.json`. Its outcome is `failed` if a run is; the others are there.

    Raises
    ------
    InputError
        If anything about any run is not legal; then nothing was written.
    RunError
        If nobody is left to work; what has finished is on disk.
    """
    since = time.perf_counter()
    sweep.choice.check()
    checked = _check(sweep, screen)
    plan, loaded = checked.plan, checked.loaded
    owner = Owner(kept.KIND, loaded.name, loaded.scene.title, loaded.file)
    earlier = None
    if resume:
        earlier = kept.earlier_sweep(folder)
        kept.check_same(folder, earlier, checked.base, kept.plan_data(plan, checked.marks))
    else:
        kept.refuse_earlier(folder, overwrite)
        files.check_output(folder, owner, overwrite)
    with files.held(folder, owner, overwrite, resume):
        if earlier is None:
            kept.remove_runs(folder, files.read_record(folder))
            files.prepare_output(folder, owner, overwrite)
        scene = {"title": loaded.scene.title, "kind": kept.KIND, "base": checked.base}
        record = Record(folder, loaded.name, scene, is_scene=False, scene_file=owner.place, since=since)
        record.details["keys"] = list(plan.keys)
        record.details["results"] = [result.text for result in checked.results]
        record.details["runs"] = kept.plan_data(plan, checked.marks)
        record.write()
        screen.keep_log(folder / files.LOG, versions())
        if earlier is not None and (other := other_versions(earlier)):
            screen.say(f"warning: other versions than when the sweep began ({', '.join(other)}): digits may differ")
        states = {run.name: _found(folder, run, checked, resume) for run in plan.runs}
        with interrupt_request(lambda: screen.say("stopping the runs (Ctrl-C again stops at once)")) as stop:
            try:
                with record.phase("runs"):
                    _compute(sweep, checked, folder, states, record, screen, stop)
            except KeyboardInterrupt as error:
                kept.write_tables(folder, plan, checked.results, states)
                raise record.broken_off("interrupted; --resume goes on from here") from error
            except OSError as error:
                raise record.broken_off(f"results cannot be written any more: {error}") from error
            stopped = stop.requested
        _conclude(record, plan, states, stopped)
        kept.write_tables(folder, plan, checked.results, states)
        if then is not None:
            then(record, plan, states)
        record.write()
        with record.phase("pictures"):
            _draw(folder, checked, screen)
        record.write()
        _report(record, checked, states, screen)
        return record


def _check(sweep: Sweep, screen: Screen) -> _Checked:
    """Read and check every run before anything is computed.

    Raises
    ------
    InputError
    """
    load(sweep.scene)  # an error of the scene itself is told as that
    plan = plan_of(sweep.request)
    if not sweep.pictures:
        plan = Plan(plan.keys, [_without_pictures(run) for run in plan.runs])
    wrong: dict[str, list[Run]] = {}
    marks: dict[str, str] = {}
    kinds: dict[str, LoadedScene] = {}
    base: dict[str, Any] = {}
    digests: dict[Any, str | None] = {}
    groups: set[str] = set()
    with screen.progress("checking", float(len(plan.runs))) as advance:
        for place, run in enumerate(plan.runs):
            try:
                loaded = load(sweep.scene, run.assignments)
                refuse_unready(loaded)
                table = resolved(loaded, None)
                file = table.get("mesh", {}).get("file")
                if file not in digests:
                    digests[file] = mesh_digest(table)
                marks[run.name] = identity(table, digests[file])
                kinds.setdefault(loaded.scene.kind, loaded)
                groups.update(_kernels(loaded))
                base = base or table
            except InputError as error:
                for line in str(error).split("\n"):
                    wrong.setdefault(line, []).append(run)
                if sum(map(len, wrong.values())) >= MOST_WRONG:
                    break
            advance(place + 1.0, f"{place + 1} of {len(plan.runs)}")
    if wrong:
        raise several([text for line, runs in wrong.items() for text in _of_runs(line, runs, len(plan.runs))])
    if len(kinds) > 1:
        raise InputError(f"runs of different kinds ({', '.join(kinds)}) are no sweep; leave 'kind' as it is")
    ((kind, loaded),) = kinds.items()
    results = results_of(sweep.results, kind)
    if kind == "field":
        refuse_missing(results, loaded)
    # what is the same in all runs: the scene as it stands with what has one value, the first of what has several
    called = loaded.called if loaded.called == loaded.name else str(loaded.file.resolve())
    return _Checked(plan, _common(base, plan), marks, results, loaded, called, tuple(sorted(groups)))


def _of_runs(line: str, runs: Sequence[Run], of: int) -> list[str]:
    """A message, with the runs of which it tells: by line or sample if they have one, else by their names."""
    if any(run.origin for run in runs):
        return [f"{run.origin}: {_without_option(line)}" for run in runs]
    if len(runs) == of:
        return [line]
    more = f" and {len(runs) - SHOWN_WRONG} more" if len(runs) > SHOWN_WRONG else ""
    many = "run" if len(runs) == 1 else "runs"
    return [f"{many} {', '.join(run.name for run in runs[:SHOWN_WRONG])}{more}: {line}"]


def _without_option(line: str) -> str:
    """A message on a key without the option by which it was not given."""
    return line.removeprefix("--set: ").removeprefix("--set ")


def _common(base: dict[str, Any], plan: Plan) -> dict[str, Any]:
    """The scene of the first run without what varies."""
    tops = {key.split(".")[0] for key in plan.keys} & {"material_file", "accuracy"}
    table = {key: value for key, value in base.items() if not tops or key in ("title", "kind")}
    for key in plan.keys:
        here: Any = table
        *path, last = key.split(".")
        for part in path:
            here = here.get(part) if isinstance(here, dict) else None
        if isinstance(here, dict):
            here.pop(last, None)
        else:
            table.pop(path[0] if path else last, None)
    return table


def _without_pictures(run: Run) -> Run:
    if any(text.partition("=")[0].strip() in (PICTURES, "output") for text in run.assignments):
        return run
    return Run(run.name, run.values, (*run.assignments, f"{PICTURES}=false"), run.origin)


def _kernels(loaded: LoadedScene) -> tuple[str, ...]:
    """Groups of compiled kernels that a run calls."""
    if loaded.scene.kind in ("dem", "specimen"):
        return ("dem",)
    law = ("dem",) if is_grains(loaded.scene) else tuple(build.kernels(loaded))
    return (*law, "host") if loaded.scene.kind == "field" else law


def _found(folder: Path, run: Run, checked: _Checked, resume: bool) -> State:
    """What is there of a run already."""
    from granfabric.cases.sweep.results import evaluate

    if not resume:
        return State()
    outcome, message, seconds = kept.outcome_of(folder / run.name)
    if outcome not in ("finished", "failed"):
        return State()
    return State(outcome, message, seconds, evaluate(folder / run.name, checked.results))


def _compute(
    sweep: Sweep, checked: _Checked, folder: Path, states: dict[str, State], record: Record, screen: Screen, stop: Any
) -> None:
    """Have the runs computed that are not there yet."""
    plan = checked.plan
    todo = [run for run in plan.runs if states[run.name].outcome == NOT_BEGUN]
    done = len(plan.runs) - len(todo)
    many = "run" if len(plan.runs) == 1 else "runs"
    there = f", {done} of them there already" if done else ""
    if not todo:
        screen.say(f"{len(plan.runs)} {many}{there}; nothing to do")
        record.details["workers"] = 0
        return
    here, place = str(Path.cwd()), folder.resolve()
    texts = tuple(result.text for result in checked.results)
    function = f"{run_one.__module__}:{run_one.__name__}"
    jobs = [
        Job(run.name, run.name, function,
            (checked.called, run.assignments, str(place / run.name), here, texts, formats.chosen()), checked.kernels)
        for run in todo
    ]  # fmt: skip
    saved = time.monotonic()
    total = float(len(plan.runs))
    with sweep.choice.engine(folder, screen, stop, len(todo)) as engine, screen.progress("runs", total) as show:
        record.details["workers"] = engine.workers
        screen.say(f"{len(plan.runs)} {many} of {checked.loaded.name}{there}; {engine.text}")
        if sweep.choice.scheduler is None and kernels.missing(checked.kernels):
            screen.announce_compilation(COMPILATION_SECONDS)()

        def follow(job: Job, ended: Ended) -> list[Job]:
            nonlocal done, saved
            if isinstance(ended.error, OSError):
                raise ended.error
            state = ended.value if ended.error is None else State("failed", str(ended.error))
            states[job.key] = state
            done += 1
            if state.outcome == "failed":
                screen.say(f"warning: {job.key}: {state.message}")
            else:
                screen.note(f"{job.key}: {state.outcome}, {state.seconds:.1f} s")
            if time.monotonic() - saved > SAVE_SECONDS:
                saved = time.monotonic()
                kept.write_tables(folder, plan, checked.results, states)
            return []

        def advance(at_work: dict[str, float]) -> None:
            named = list(at_work)
            more = f" and {len(named) - 4} more" if len(named) > 4 else ""
            show(done + sum(at_work.values()), f"{done} of {len(plan.runs)}; {'; '.join(named[:4])}{more}")

        engine.carry_out(jobs, follow, advance, stop)


def _conclude(record: Record, plan: Plan, states: dict[str, State], stopped: bool) -> None:
    """Outcome of the whole."""
    outcomes = [state.outcome for state in states.values()]
    record.details["finished"] = outcomes.count("finished")
    record.details["failed"] = [run.name for run in plan.runs if states[run.name].outcome == "failed"]
    left = len(outcomes) - outcomes.count("finished") - len(record.details["failed"])
    if left:
        why = "stopped" if stopped else "broken off"
        record.outcome = "stopped"
        record.message = f"{why}; {left} of {len(outcomes)} runs are left, --resume goes on from here"
    elif record.details["failed"]:
        record.outcome = "failed"
        many = "run" if len(outcomes) == 1 else "runs"
        record.message = f"{len(record.details['failed'])} of {len(outcomes)} {many} failed, see {kept.INDEX}"
    else:
        record.outcome = "finished"


def _draw(folder: Path, checked: _Checked, screen: Screen) -> None:
    from granfabric.cases.sweep.pictures import draw_sweep

    if not draw_sweep(folder, checked.loaded.scene.title):
        screen.say(f"no {kept.PICTURE}: nothing that was computed has numbers to draw")


def _report(record: Record, checked: _Checked, states: dict[str, State], screen: Screen) -> None:
    plan = checked.plan
    heads = ["run", *(result.text for result in checked.results), "outcome"]
    rows = []
    for place in spread(len(plan.runs), SHOWN_RUNS):
        run = plan.runs[place]
        numbers = [states[run.name].numbers.get(result.text, math.nan) for result in checked.results]
        shown = ["-" if math.isnan(value) else f"{value:.6g}" for value in numbers]
        rows.append([run.name, *shown, states[run.name].outcome])
    screen.table(f"{record.scene['title']}: {len(plan.runs)} runs", heads, rows, words=("run", "outcome"))
    for name in record.details["failed"][:SHOWN_FAILURES]:
        screen.say(f"failed: {name}: {states[name].message}", insist=True)
    if record.outcome != "finished":
        screen.say(f"{record.outcome}: {record.message}", insist=True)
    computed = [state.seconds for state in states.values() if not math.isnan(state.seconds)]
    screen.say(
        f"{record.details['finished']} of {len(plan.runs)} runs finished, {sum(computed):.1f} s in all of them, "
        f"{record.timing['total']:.1f} s here; results in {record.folder}{os.sep}{kept.RESULTS}"
    )
