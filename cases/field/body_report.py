"""What a field run says about stages that change the body: what goes, what comes, which forces fade."""

from __future__ import annotations

from typing import Any

import numpy as np

from granfabric.cases.records.record import Record
from granfabric.cases.terminal.screen import Screen
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.summary import cell_areas

HELD = 1e-12
"""Forces that are held count as none below this fraction of those that fade."""


class BodyReport:
    """Tells each change of the body once, with the first step of its stage.

    Parameters
    ----------
    problem : Problem
    record : Record
        What is told is recorded there too.
    earlier : dict, optional
        Record of the run to go on with.
    """

    def __init__(self, problem: Problem, record: Record, earlier: dict[str, Any] | None = None) -> None:
        self._record = record
        self._problem = problem
        kept = [entry for entry in (earlier or {}).get("body", []) if isinstance(entry, dict) and "stage" in entry]
        self.told: list[dict[str, Any]] = kept
        if kept:
            record.details["body"] = kept
        self._areas = cell_areas(problem.space.host_mesh) if problem.changes_body else np.zeros(0)

    def __call__(self, step: StepResult, screen: Screen) -> None:
        """Receive a step; say and record what its stage changes, if that has not been told."""
        if step.active is None or any(entry["stage"] == step.stage for entry in self.told):
            return
        places = [stage.name for stage in self._problem.stages]
        index = places.index(step.stage)
        terms = self._problem.program.terms[index]
        body, start = terms.body, step.stage_start
        assert body is not None
        if not body.changes and body.released == body.released_before:
            return
        fading = start.fading.copy()
        fading[terms.released] = 0.0
        entry: dict[str, Any] = {
            "stage": step.stage,
            "deactivated": list(terms.stage.deactivate),
            "deactivated_area": float(self._areas[body.removed].sum()),
            "activated": list(terms.stage.activate),
            "activated_area": float(self._areas[body.placed].sum()),
            "released": body.released,
            "fading": _sum(fading),
            "held": 0.0 if start.held is None else _sum(start.held),
        }
        self.told.append(entry)
        self._record.details["body"] = self.told
        screen.say(_text(entry))


def _sum(force: np.ndarray) -> float:
    """Sum of the magnitudes of nodal forces [N/m]."""
    return float(np.hypot(force[0::2], force[1::2]).sum())


def _text(entry: dict[str, Any]) -> str:
    said = []
    for key, word in (("deactivated", "takes away"), ("activated", "adds")):
        if entry[key]:
            names = ", ".join(map(repr, entry[key]))
            said.append(f"{word} {names} ({entry[f'{key}_area']:.4g} m^2)")
    change = " and ".join(said) or "releases what is held from excavations"
    if not said and entry["fading"] == 0.0:
        return f'stage "{entry["stage"]}": its supports take over what is held from excavations'
    held = f", {entry['held']:.4g} N/m are held at its end" if entry["held"] > HELD * entry["fading"] else ""
    return f'stage "{entry["stage"]}" {change}; forces of {entry["fading"]:.4g} N/m fade over it{held}'
