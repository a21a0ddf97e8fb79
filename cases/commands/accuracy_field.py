"""What the load steps of a finished field run cost in accuracy: against a run of the same scene in half as many."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from granfabric.cases.field.prepare import prepare
from granfabric.cases.records import files
from granfabric.cases.records.field_history import FieldHistory
from granfabric.cases.scene.effects_choice import recorded, with_decided
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.loads.kinds import INITIAL

ORDER = 2
"""Of the error in the size of the load step (study `load_steps`): strain goes straight within a step."""


def _twin(loaded: Any) -> tuple[Any, float]:
    """The scene in half as many load steps and the ratio of their numbers; in twice as many if none can be halved."""
    numbers = [1 if part.name == INITIAL else part.increments for part in loaded.scene.stage]
    fewer = [max(1, number // 2) for number in numbers]
    chosen = fewer if fewer != numbers else [2 * number for number in numbers]
    parts = [part.model_copy(update={"increments": number}) for part, number in zip(loaded.scene.stage, chosen)]
    scene = loaded.scene.model_copy(update={"stage": parts})
    # stages that cannot be halved have one step in both: those that can set the ratio
    changed = [(old, new) for old, new in zip(numbers, chosen) if old != new]
    ratio = sum(old for old, _ in changed) / sum(new for _, new in changed)
    return replace(loaded, scene=scene), ratio


def means(columns: dict[str, Any], row: int) -> tuple[float, float, float]:
    """q/p of the mean stress, mean coordination number, mean fabric anisotropy of a row of a history."""
    return (
        float(columns["q"][row]) / float(columns.get("effective_p", columns["p"])[row]),
        float(columns["coordination"][row]),
        float(columns["fabric_anisotropy"][row]),
    )


def load_step_error(loaded: Any, folder: Path, stop: Callable[[], bool]) -> dict[str, float] | None:
    """Estimate of the error of the load steps, at the end of the run; None if the other run did not get there.

    With the error in proportion to the square of the step, the difference between n and m steps is
    ``(n/m)^2 - 1`` times the error of the run in n.

    Parameters
    ----------
    loaded : LoadedScene
        Of kind "field".
    folder : Path
        Its results.
    stop : callable
        Asked in between; True gives up.

    Returns
    -------
    dict of str to float, or None
        `stress_ratio` (mean q/p, absolute), `coordination` (mean, relative), `fabric_anisotropy` (mean, absolute), the
        `largest` of these, and `seconds` that the other run took.
    """
    since = time.perf_counter()
    record = files.read_record(folder)
    assert record is not None
    twin, ratio = _twin(with_decided(loaded, recorded(loaded.scene, record)))
    prepared = prepare(twin)
    problem = prepared.problem
    history = FieldHistory(problem.space, problem.law.description, [], [])
    last: list[StepResult] = []

    def keep(step: StepResult) -> None:
        last[:] = [step]

    summary = solve(problem, prepared.control, on_step=keep, stop=stop)
    if not summary.finished or not last:
        return None
    history.add(last[0])
    other = means(dict(zip(history.names, zip(*history.rows))), -1)
    own = means(files.read_csv(folder / files.HISTORY), -1)
    fraction = abs(ratio**ORDER - 1.0)
    errors = {
        "stress_ratio": abs(own[0] - other[0]) / fraction,
        "coordination": abs(own[1] / other[1] - 1.0) / fraction,
        "fabric_anisotropy": abs(own[2] - other[2]) / fraction,
    }
    return {**errors, "largest": max(errors.values()), "seconds": time.perf_counter() - since}
