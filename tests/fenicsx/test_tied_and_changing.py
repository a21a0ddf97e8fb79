"""What ties, changes and leads: both hosts, on one, two and three ranks, at every point of every step."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from problems import PROBLEMS
from ranks import on_ranks

SCRIPT = Path(__file__).with_name("compare_hosts.py")
ALLOWED = 1e-8
"""Of the largest value of its kind; both hosts iterate to 1e-11 of the nodal forces."""


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_both_hosts_agree(ranks: int) -> None:
    names = [f"{kind}:{law}" for kind in PROBLEMS if kind != "joint" for law in ("elastic", "plastic")]
    names.append("joint:contact")
    done = on_ranks(ranks, str(SCRIPT), *names)
    assert done.returncode == 0, done.stderr
    told = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert [each["problem"] for each in told] == names
    for each in told:
        assert each["ranks"] == ranks
        assert each["steps"] >= 2
        for key, value in each.items():
            if key not in ("problem", "ranks", "steps", "iterations"):
                assert value <= ALLOWED, (each["problem"], key, value)
        assert each["iterations"] <= 1
