"""Loads that begin on top of one that an earlier stage left under another name are told; replacing ones are not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from granfabric.cases.field.adding_loads import adding
from granfabric.cases.field.prepare import read_or_make_mesh
from granfabric.cases.scene.reader import load

GROUND = """
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
[initial]
stress = [-100e3, -100e3, 0.0]
[mesh]
rectangle = { width = 10.0, height = 5.0, nx = 4, ny = 2 }
element = "P1"
part = [{ name = "half", boundary = "top", x = [0.0, 5.0] }, { name = "other", boundary = "top", x = [5.0, 10.0] }]
[output]
pictures = false
[[stage]]
name = "initial"
increments = 1
fixed = [{ boundary = "bottom" }, { boundary = "left", components = ["x"] }, { boundary = "right", components = ["x"] }]
pressure = [{ boundary = "half", value = 100e3 }, { boundary = "other", value = 100e3 }]
[[stage]]
name = "more"
increments = 1
"""
WEIGHT = "stage.initial.body_force=[{value=[0.0, -17e3]}]"
HALF = "which stage 1 \"initial\" left; they share 5 m"
BOTH = [
    f"note: stage 2 \"more\": pressure 1: the pressure on 'top' adds to that on {name!r}, {HALF}"
    for name in ("half", "other")
]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (["stage.more.pressure=[{boundary='top', value=101e3}]"], BOTH),
        (["stage.more.pressure=[{boundary='top', value=101e3}]", "stage.more.keep=false"], []),
        (["stage.more.pressure=[{boundary='half', value=101e3}]"], []),
        (["stage.more.pressure=[{boundary='top', value=0.0}]"], []),
        (["stage.more.pressure=[{boundary='top', value=0.0, gradient=[1.0, 0.0]}]"], BOTH),
        (["stage.more.pressure=[{boundary='right', value=101e3}]"], []),  # they meet at a corner
        (["stage.more.traction=[{boundary='top', value=[0.0, -1e3]}]"], []),  # of another kind
        (
            ["stage.more.pressure=[{boundary='top', value=101e3}, {boundary='half', value=0.0}]"],
            BOTH[1:],
        ),
        (["stage.initial.pressure=[{boundary='half', value=1e5}, {boundary='top', value=1e3}]",
          "stage.more.pressure=[{boundary='top', value=2e3}]"], []),  # together from the outset
        ([WEIGHT, "stage.more.body_force=[{value=[0.0, -1e3], region='all'}]"],
         ["note: stage 2 \"more\": body_force 1: the body force on 'all' adds to that on the whole mesh, which stage 1 "
          "\"initial\" left; they share 50 m^2"]),
        ([WEIGHT, "stage.more.body_force=[{value=[0.0, -1e3]}]"], []),
    ],
)  # fmt: skip
def test_what_adds_to_what_is_there(tmp_path: Path, changes: list[str], said: list[str]) -> None:
    (tmp_path / "own.toml").write_text(GROUND)
    loaded = load(str(tmp_path / "own.toml"), changes)
    assert adding(loaded, read_or_make_mesh(loaded)) == said


def test_a_run_says_so_and_the_pressures_do_add(granfabric: Callable, tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(GROUND)
    changes = ["--set", "stage.more.pressure=[{boundary='top', value=1e3}]"]
    result = granfabric("run", tmp_path / "own.toml", "-o", tmp_path / "out", *changes)
    assert result.code == 0 and all(note in result.out for note in BOTH)
    header, *_, last = (tmp_path / "out" / "history.csv").read_text().splitlines()
    force = float(last.split(",")[header.split(",").index("reaction_bottom_y")])
    assert force == pytest.approx(10.0 * 101e3, rel=1e-6)
