"""Problems by both hosts, on any number of ranks; a line of JSON each: `compare_hosts.py NAME:LAW scene:NAME ...`.

Problems are those of `problems.py` and shipped scenes, the latter solved to 1e-10 of the nodal forces. Largest
differences over all steps, each relative to the largest value of its kind.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
from problems import LAWS, PROBLEMS

from granfabric.cases.effects.resolve import resolve_field
from granfabric.cases.field.prepare import prepare
from granfabric.cases.scene.reader import load
from granfabric.fem.equilibrium.checkpoint import Checkpoint
from granfabric.fem.equilibrium.stepping import StepControl, solve
from granfabric.fem.fenicsx.team import Team
from granfabric.fem.loads.problem import Problem

FIELDS = ("displacement", "stress", "strain", "state", "support")
SUMS = ("reactions", "rigid", "springs")


def differences(ours: list[Any], theirs: list[Any]) -> dict[str, float]:
    assert [step.fraction for step in ours] == [step.fraction for step in theirs]
    found: dict[str, float] = {}

    def add(key: str, one: Any, other: Any, size: float) -> None:
        largest = float(np.abs(np.subtract(one, other)).max(initial=0.0))
        found[key] = max(found.get(key, 0.0), largest / (size or 1.0))

    for key in FIELDS:
        size = max(float(np.abs(getattr(step, key)).max(initial=0.0)) for step in ours)
        for mine, yours in zip(ours, theirs):
            add(key, getattr(mine, key), getattr(yours, key), size)
    force = max(float(np.abs(step.support).max()) for step in ours)
    for mine, yours in zip(ours, theirs):
        assert (mine.active is None) == (yours.active is None)
        if mine.active is not None:
            assert np.array_equal(mine.active, yours.active)
        for key in SUMS:
            one, other = getattr(mine, key), getattr(yours, key)
            assert one.keys() == other.keys()
            for name in one:
                add(key, one[name], other[name], force)
        add("load factor", mine.load_factor, yours.load_factor, 1.0)
        add("iterations", mine.iterations, yours.iterations, 1.0)
        start, other = mine.stage_start, yours.stage_start
        for key in ("fading", "reference", "spring_offsets", "held"):
            one, two = getattr(start, key), getattr(other, key)
            assert (one is None) == (two is None), key
            if one is not None and len(one):
                add("start", one, two, force)
    return found


def prepared(name: str) -> tuple[Problem, StepControl]:
    kind, _, other = name.partition(":")
    if kind != "scene":
        return PROBLEMS[kind](LAWS[other]), StepControl(tolerance=1e-11)
    loaded = load(other, ["solver.tolerance=1e-10"])
    _, found, _ = resolve_field(loaded, prepare(loaded))
    return found.problem, found.control


def main() -> None:
    team = Team()
    if not team.leads:
        team.assist()
        return
    with team:
        for name in sys.argv[1:]:
            problem, control = prepared(name)
            resumes = not name.startswith("scene:")
            ours: list[Any] = []
            theirs: list[Any] = []
            kept: list[Checkpoint] = []
            solve(problem, control, ours.append)
            summary = team.solve(
                problem, control, theirs.append, on_checkpoint=lambda given, kept=kept: kept.append(given.copied())
            )
            assert summary.finished, (name, summary.message)
            found = differences(ours, theirs)
            # both hosts go on from what ranks left in the middle
            for place in range(0, len(kept) - 1, 2) if resumes else ():
                for going_on in (team.solve, solve):
                    rest: list[Any] = []
                    assert going_on(problem, control, rest.append, resume=kept[place]).finished
                    again = differences(ours[place + 1 :], rest)
                    found["resumed"] = max(found.get("resumed", 0.0), again["displacement"], again["stress"])
            print(json.dumps({"problem": name, "ranks": team.comm.size, "steps": len(ours), **found}), flush=True)


if __name__ == "__main__":
    main()
