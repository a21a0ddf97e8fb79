"""Every shipped field scene by both hosts, point by point."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from granfabric.cases.effects.resolve import resolve_field
from granfabric.cases.field.prepare import prepare
from granfabric.cases.scene import catalogue
from granfabric.cases.scene.reader import load
from granfabric.fem.equilibrium.stepping import StepControl, solve
from granfabric.fem.fenicsx.team import Team

OWN_ALONE = {"grains_biaxial"}
"""Scenes with grains at the points."""
FIELDS = sorted({entry.name for entry in catalogue.shipped().values() if entry.kind == "field"} - OWN_ALONE)
UNSTABLE = {"footing_capacity"}
"""Beyond its limit load Newton's iterates decide which of many solutions is found: compared by its reactions."""
TIGHTER = {"slope": 1e-10, "tunnel": 1e-10}
"""Tolerance where strains near a free surface hang on small forces, and differ by more than what is left of these."""
TIMES_TOLERANCE = 100.0
"""Both hosts end their iterations below the tolerance, not at the same place."""


@pytest.mark.slow
@pytest.mark.parametrize("name", FIELDS)
def test_both_hosts_agree(name: str) -> None:
    loaded = load(name, [f"solver.tolerance={TIGHTER[name]}"] if name in TIGHTER else [])
    loaded, prepared, _ = resolve_field(loaded, prepare(loaded))
    ours: list[Any] = []
    theirs: list[Any] = []
    first = solve(prepared.problem, prepared.control, on_step=ours.append)
    with Team() as team:
        second = team.solve(prepared.problem, prepared.control, on_step=theirs.append)
    assert first.finished == second.finished
    tolerance = TIMES_TOLERANCE * max(prepared.control.tolerance, StepControl().tolerance)
    if name in UNSTABLE:
        last, other = ours[-1].reactions, theirs[-1].reactions
        largest = max(np.abs(pair).max() for pair in last.values())
        for boundary, pair in last.items():
            assert np.abs(np.subtract(pair, other[boundary])).max() < 1e-2 * largest
        return
    assert [step.fraction for step in ours] == [step.fraction for step in theirs]
    for mine, yours in zip(ours, theirs):
        for key in ("displacement", "stress", "strain", "state"):
            a, b = getattr(mine, key), getattr(yours, key)
            assert np.abs(a - b).max() <= tolerance * np.abs(a).max(initial=0.0) + 1e-300, (key, mine.step)
        largest = max((np.abs(pair).max() for pair in mine.reactions.values()), default=0.0)
        for boundary, pair in mine.reactions.items():
            assert np.abs(np.subtract(pair, yours.reactions[boundary])).max() <= tolerance * largest
        assert mine.iterations == pytest.approx(yours.iterations, abs=1)
