"""What ties, changes and leads: both hosts, on one, two and three ranks, at every point of every step."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from problems import PROBLEMS
from ranks import on_ranks

SCENES = {
    2: ("tunnel", "slope", "rigid_footing", "retaining_wall", "layered_oedometer", "undrained_biaxial"),
    3: ("tunnel", "rigid_footing"),
}
PATIENCE = 600.0
"""Seconds: three ranks wait busily for each other on two cores."""
SCRIPT = Path(__file__).with_name("compare_hosts.py")
ALLOWED = 1e-8
"""Of the largest value of its kind; both hosts iterate to 1e-11 of the nodal forces, of shipped scenes to 1e-10."""


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_both_hosts_agree(ranks: int) -> None:
    names = [f"{kind}:{law}" for kind in PROBLEMS if kind != "joint" for law in ("elastic", "plastic")]
    names.append("joint:contact")
    done = on_ranks(ranks, str(SCRIPT), *names, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr
    check(done.stdout, names, ranks)


@pytest.mark.slow
@pytest.mark.parametrize("ranks", list(SCENES))
def test_both_hosts_agree_on_shipped_scenes(ranks: int) -> None:
    names = [f"scene:{name}" for name in SCENES[ranks]]
    done = on_ranks(ranks, str(SCRIPT), *names, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr
    check(done.stdout, names, ranks)


def check(text: str, names: list[str], ranks: int) -> None:
    told = [json.loads(line) for line in text.splitlines() if line.startswith("{")]
    assert [each["problem"] for each in told] == names
    for each in told:
        assert each["ranks"] == ranks
        assert each["steps"] >= 2
        for key, value in each.items():
            if key not in ("problem", "ranks", "steps", "iterations"):
                assert value <= ALLOWED, (each["problem"], key, value)
        assert each["iterations"] <= 1
