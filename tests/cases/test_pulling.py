"""A run whose stress pulls says so: grains without cohesion carry no tension, whatever the exit code."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from granfabric.cases.records.pulling import pulling_stress

SHEAR = """
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
[effects]
contact_loss = false
contact_gain = false
stiffness_feedback = false
[initial]
stress = [-100e3, -100e3, 0.0]
[output]
pictures = false
[[path]]
control = ["strain", "strain", "strain"]
target = [2e-4, -2e-4, 0.0]
increments = 4
"""
PLATE = """
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
[effects]
contact_loss = false
contact_gain = false
stiffness_feedback = false
[initial]
stress = [-100e3, -100e3, 0.0]
[mesh]
rectangle = { width = 1.0, height = 1.0, nx = 2, ny = 2 }
element = "P1"
[output]
pictures = false
[[stage]]
name = "initial"
increments = 1
fixed = [{ boundary = "bottom", components = ["y"] }]
fixed_point = [{ point = [0.0, 0.0] }]
pressure = [
  { boundary = "left", value = 100e3 }, { boundary = "right", value = 100e3 }, { boundary = "top", value = 100e3 }
]
[[stage]]
name = "pull"
increments = 4
pressure = [{ boundary = "left", value = -20e3 }, { boundary = "right", value = -20e3 }]
"""


def test_steps_and_ratios_of_the_warning() -> None:
    sand = {"material": {"apparent_cohesion": 0.0}}
    said = pulling_stress(sand, [0, 1, 2, 3], [0.0, 1.0, 1.2, 1.1], " at some points")
    assert said.startswith("warning: from step 2 on q exceeds p at some points (q/p up to 1.2): one principal stress")
    assert pulling_stress({"material": {}}, [0, 1], [0.0, 1.0]) == ""
    cohesive = {"apparent_cohesion": 5e3}
    assert pulling_stress({"material": cohesive}, [0, 1], [0.0, 1.5]) == ""
    assert pulling_stress({"material": None, "materials": {"clay": cohesive, "sand": {}}}, [0, 1], [0.0, 1.5]) == ""
    assert pulling_stress({"material": None, "materials": {"sand": {}}}, [0, 1], [0.0, 1.5]) != ""


@pytest.mark.parametrize(("command", "text"), [("point", SHEAR), ("run", PLATE)])
def test_a_run_into_tension_says_so_even_when_quiet(
    granfabric: Callable, tmp_path: Path, command: str, text: str
) -> None:
    (tmp_path / "own.toml").write_text(text)
    result = granfabric(command, tmp_path / "own.toml", "-q", "-o", tmp_path / "out")
    told = [line for line in result.out.splitlines() if "exceeds p" in line]
    assert len(told) == 1 and told[0].startswith("warning: from step ")
    assert json.loads((tmp_path / "out" / "run.json").read_text())["pulling"] == told[0]
