"""What a sweep keeps: its plan in `run.json`, one line a run in `index.csv`, the chosen numbers in `results.csv`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from granfabric.cases.errors import InputError, short
from granfabric.cases.records import files
from granfabric.cases.records.resumption import differences, earlier_record
from granfabric.cases.scene.reader import parse_assignment

from .plan import Plan, Run
from .results import Result

KIND = "sweep"
INDEX, RESULTS, PICTURE = "index.csv", "results.csv", "results.png"
NOT_BEGUN = "not begun"
SHOWN = 4


@dataclass
class State:
    """How far a run of the sweep is.

    Attributes
    ----------
    outcome : str
        As in its `run.json`, or ``not begun``.
    message : str
    seconds : float
        That it took.
    numbers : dict of str to float
        Results by their text.
    """

    outcome: str = NOT_BEGUN
    message: str = ""
    seconds: float = math.nan
    numbers: dict[str, float] = field(default_factory=dict)


def cell(text: str) -> Any:
    """A value as tables hold it: numbers as such, texts without quotation marks."""
    with suppress(InputError):
        value = parse_assignment(f"value={text}")[1]
        if isinstance(value, str):
            return value
        if isinstance(value, float) or (isinstance(value, int) and not isinstance(value, bool)):
            return text
    return text


def write_tables(folder: Path, plan: Plan, results: Sequence[Result], states: Mapping[str, State]) -> None:
    """Write both tables, in the order of the plan."""
    index, numbers = [], []
    for run in plan.runs:
        state = states[run.name]
        values = [cell(run.values[key]) if key in run.values else "" for key in plan.keys]
        seconds = "" if math.isnan(state.seconds) else round(state.seconds, 3)
        index.append([run.name, *values, state.outcome, seconds, state.message])
        found = [state.numbers.get(result.text, math.nan) for result in results]
        numbers.append([run.name, *values, *("" if math.isnan(value) else float(value) for value in found)])
    files.write_text(folder / INDEX, files.csv_text(["run", *plan.keys, "outcome", "seconds", "message"], index))
    heads = ["run", *plan.keys, *(result.text for result in results)]
    files.write_text(folder / RESULTS, files.csv_text(heads, numbers))


def plan_data(plan: Plan, marks: Mapping[str, str]) -> list[dict[str, Any]]:
    """The plan as `run.json` holds it, with what tells the input of each run."""
    return [{"name": run.name, "values": run.values, "input": marks[run.name]} for run in plan.runs]


def earlier_sweep(folder: Path) -> dict[str, Any]:
    """The record of the sweep to go on with.

    Raises
    ------
    InputError
    """
    record = earlier_record(folder)
    if record.get("kind") != KIND or not isinstance(record.get("runs"), list):
        raise InputError(f"--resume: {str(folder)!r} holds no sweep to go on with, but a {record.get('kind')!r}")
    return record


def check_same(folder: Path, earlier: dict[str, Any], scene: dict[str, Any], data: Sequence[dict[str, Any]]) -> None:
    """Refuse to go on with another sweep; further runs may have come.

    Raises
    ------
    InputError
        Naming what changed.
    """
    found = differences(earlier["scene"].get("base", {}), json.loads(json.dumps(scene)))
    now = {entry["name"]: entry for entry in data}
    for entry in earlier["runs"]:
        other = now.get(entry["name"])
        if other is None:
            found.append(f"the run {entry['name']} is not asked for any more")
        elif other["values"] != entry["values"]:
            keys = [key for key in {**entry["values"], **other["values"]}
                    if entry["values"].get(key) != other["values"].get(key)]  # fmt: skip
            said = ", ".join(
                f"{key} was {entry['values'].get(key, 'not set')} and is {other['values'].get(key, 'not set')}"
                for key in keys
            )
            found.append(f"the run {entry['name']}: {said}")
        elif other["input"] != entry["input"] and not found:
            found.append(f"the input of the run {entry['name']} is another")
    if found:
        more = f" and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
        raise InputError(
            f"--resume: this is not the sweep in {str(folder)!r}: {'; '.join(found[:SHOWN])}{more} "
            "(take another folder with -o, or replace it with --overwrite)"
        )


def refuse_earlier(folder: Path, overwrite: bool) -> None:
    """Refuse to replace a sweep, of which every run may have taken hours, without being asked.

    Raises
    ------
    InputError
    """
    record = files.read_record(folder)
    if record is None or record.get("kind") != KIND or overwrite:
        return
    runs = record.get("runs")
    names = [entry.get("name") for entry in runs if isinstance(entry, dict)] if isinstance(runs, list) else []
    done = sum(isinstance(name, str) and outcome_of(folder / name)[0] == "finished" for name in names)
    raise InputError(
        f"the output folder {str(folder)!r} holds a sweep ({done} of {len(names)} runs finished); go on with it by "
        "--resume, replace it with --overwrite, or choose another folder with -o"
    )


def remove_runs(folder: Path, record: dict[str, Any] | None) -> None:
    """Remove what the runs of an earlier sweep wrote, and their folders if nothing else is in them.

    Raises
    ------
    InputError
        If one cannot be removed.
    """
    runs = (record or {}).get("runs")
    if not isinstance(runs, list) or (record or {}).get("kind") != KIND:
        return
    for entry in runs:
        name = entry.get("name") if isinstance(entry, dict) else None
        if not isinstance(name, str) or Path(name).name != name or name in (".", ".."):
            continue
        place = folder / name
        if place.is_dir() and files.read_record(place) is not None:
            files.prepare_output(place)
            with suppress(OSError):
                place.rmdir()


def outcome_of(folder: Path) -> tuple[str, str, float]:
    """Outcome, message and time of a run in its folder."""
    record = files.whole_record(folder)
    if record is None:
        return NOT_BEGUN, "", math.nan
    total = record["timing"].get("total")
    return record["outcome"], record["message"], float(total) if isinstance(total, int | float) else math.nan


def named(run: Run) -> str:
    """A run as it is spoken of."""
    return f"run {run.name}" if not run.origin else f"run {run.name} ({short(run.origin)[1:-1]})"
