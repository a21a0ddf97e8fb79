"""Whether there was ground at a place before, or comes later, where stages change the body."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

__all__ = ["ground_there"]

_CHANGED = {"deactivated": "is gone since", "activated": "is not there before"}


def ground_there(
    stage_of: Mapping[int, str],
    written: Sequence[int],
    step: int,
    is_there: Callable[[int], bool],
    changes: Sequence[Mapping[str, Any]],
) -> str:
    """What to say of a place at which nothing is at a step; empty if nothing ever was.

    Parameters
    ----------
    stage_of : mapping of int to str
        Stage of each step.
    written : sequence of int
        Steps with fields, in order.
    step : int
        One of them.
    is_there : callable
        Whether the place lies in the mesh of a written step.
    changes : sequence of mapping
        `body` of `run.json`: what each stage took away and added.
    """
    stages = list(dict.fromkeys(stage_of.values()))
    # the body changes with the first step of a stage, so that one step of each tells
    last = {stage_of[number]: number for number in written if number in stage_of}
    for word, others in (
        ("deactivated", [number for number in reversed(last.values()) if number < step]),
        ("activated", [number for number in last.values() if number > step]),
    ):
        without = step
        for number in others:
            if is_there(number):
                first, second = sorted((stages.index(stage_of[number]), stages.index(stage_of[without])))
                between = stages[first + 1 : second + 1]
                known = [entry["stage"] for entry in changes if entry.get(word) and entry.get("stage") in between]
                names = " or ".join(f'"{name}"' for name in known or between)
                many = "stage" if len(known or between) == 1 else "one of the stages"
                return f"the ground there {_CHANGED[word]} {many} {names}"
            without = number
    return ""
