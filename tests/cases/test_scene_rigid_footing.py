"""A footing by force: closed forms of a punch, balance, history and screen; loads of scenes in general."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from granfabric.cases.commands.convergence import CONSTANT_STIFFNESS
from granfabric.cases.field.comparison import moduli
from granfabric.cases.scene.reader import load

COARSE = ("mesh.rectangle.nx=24", "mesh.rectangle.ny=12")
ONE_STEP = (*CONSTANT_STIFFNESS, "stage.vertical.increments=1", "stage.eccentric.increments=1")


def test_rotation_of_smooth_and_rough_punch(solve_scene: Callable) -> None:
    """Rough over smooth is 1 + 4 eta^2 (Muskhelishvili's problem of the punch); both are less on ground that ends."""
    turned = {}
    for rough in ("true", "false"):
        sets = [f"stage.{stage}.rigid.0.rough={rough}" for stage in ("vertical", "eccentric")]
        _, steps = solve_scene("rigid_footing", *ONE_STEP, *sets)
        before, after = (step.rigid["footing"] for step in steps[-2:])
        turned[rough] = before[2] - after[2]
        assert after[3:] == pytest.approx((0.0, -40e3, -8e3), abs=1e-4)
    bulk, shear = moduli(load("rigid_footing").scene.material)
    kappa = 1 + 2 * shear / bulk
    smooth = 8e3 * (kappa + 1) / (2 * np.pi * shear)
    eta = np.log(kappa) / (2 * np.pi)
    assert turned["false"] / turned["true"] == pytest.approx(1 + 4 * eta**2, rel=2e-3)
    assert smooth == pytest.approx(12.37e-6, rel=1e-3)
    assert turned["false"] == pytest.approx(11.47e-6, rel=1e-3)
    assert turned["true"] == pytest.approx(10.53e-6, rel=1e-3)


def test_the_scene_says_what_its_text_says(granfabric: Callable, tmp_path: Path) -> None:
    result = granfabric("run", "rigid_footing", "-o", tmp_path / "out", "--set", "output.every=100")
    assert result.code == 0, result.err
    with (tmp_path / "out" / "history.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    last = {name: float(value) for name, value in rows[-1].items() if name != "stage"}
    vertical = float(next(row for row in reversed(rows) if row["stage"] == "vertical")["rigid_footing_rotation"])
    assert vertical - last["rigid_footing_rotation"] == pytest.approx(11.57e-6, rel=2e-3)
    assert last["rigid_footing_displacement_y"] == pytest.approx(-61.5e-6, rel=2e-3)
    assert last["coordination_smallest"] == pytest.approx(3.37, abs=0.01)
    assert last["rigid_footing_force_y"] == pytest.approx(-40e3, rel=1e-6)
    assert last["rigid_footing_moment"] == pytest.approx(-8e3, rel=1e-6)
    # weight, surcharge and footing stand on the base
    total = 12 * 6 * 18e3 + 12 * 20e3 + 40e3
    assert last["reaction_bottom_y"] == pytest.approx(total, rel=1e-6)


def test_expressions_amplitudes_springs_snapping_and_control_in_a_scene(granfabric: Callable, tmp_path: Path) -> None:
    """What the keys say is in the history: two cycles, a led settlement, a spring; what moved to nodes is told."""
    sets = [
        *COARSE,
        "mesh.part=[{name='footing', boundary='top', x=[5.1, 6.9], snap=true}]",
        "stage.vertical.rigid=[{boundary='footing', force=[0.0, -10e3], rotation='fixed'}]",
        "stage.vertical.control={rigid='footing', component='y', target=-2e-5}",
        "stage.eccentric.rigid=[]",
        "stage.eccentric.pressure=[{boundary='top', value='20e3 + 1e3*x/12'}]",
        "stage.eccentric.spring=[{boundary='right', normal=1e6}]",
        "stage.eccentric.amplitude='sine'",
        "stage.eccentric.cycles=1.25",
        "output.pictures=false",
    ]
    result = granfabric(
        "run", "rigid_footing", "-o", tmp_path / "out", *(part for one in sets for part in ("--set", one))
    )
    assert result.code == 0, result.err
    assert "its ends moved by up to 0.1 m to nodes: x = [5, 7], 2 m long" in " ".join(result.out.split())
    with (tmp_path / "out" / "history.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    led = [row for row in rows if row["stage"] == "vertical"]
    assert float(led[-1]["rigid_footing_displacement_y"]) == pytest.approx(-2e-5, rel=1e-9)
    assert float(led[-1]["load_factor"]) * -10e3 == pytest.approx(float(led[-1]["rigid_footing_force_y"]), rel=1e-6)
    cycle = {float(row["fraction"]): row for row in rows if row["stage"] == "eccentric"}
    assert {0.2, 0.6, 1.0} <= {round(place, 12) for place in cycle}
    bottom = {round(place, 12): float(row["reaction_bottom_y"]) for place, row in cycle.items()}
    assert bottom[0.2] - bottom[0.6] == pytest.approx(2 * 0.5 * 1e3 * 12, rel=1e-6)
    assert bottom[1.0] == pytest.approx(bottom[0.2], rel=1e-9)
    assert float(rows[-1]["spring_right_x"]) == pytest.approx(0.0, abs=1e-3)  # the side is held
    for row in rows:
        assert row["spring_right_y"] == "0.0" or abs(float(row["spring_right_y"])) < 1e-6


def test_a_run_that_was_stopped_goes_on_with_the_same_bits(granfabric: Callable, tmp_path: Path) -> None:
    from granfabric.cases.field.prepare import prepare
    from granfabric.fem.equilibrium.stepping import solve

    prepared = prepare(load("rigid_footing", list(COARSE)))
    whole: list = []
    assert solve(prepared.problem, prepared.control, on_step=whole.append).finished
    kept: list = []
    seen = []

    def save(checkpoint: object) -> None:
        from granfabric.fem.equilibrium.checkpoint import CheckpointFolder

        CheckpointFolder(tmp_path, "same").save(checkpoint)  # type: ignore[arg-type]
        kept.append(checkpoint)

    solve(prepared.problem, prepared.control, on_step=seen.append, on_checkpoint=save, stop=lambda: len(seen) >= 8)
    from granfabric.fem.equilibrium.checkpoint import CheckpointFolder

    last, _ = CheckpointFolder(tmp_path, "same").load()
    rest: list = []
    assert solve(prepared.problem, prepared.control, on_step=rest.append, resume=last).finished
    np.testing.assert_array_equal(rest[-1].displacement, whole[-1].displacement)
    assert rest[-1].rigid == whole[-1].rigid


BAD = [
    ("stage.vertical.pressure=[{boundary='top', value='20e3 +* x'}]", "character 7: '*' is out of place"),
    ("stage.vertical.pressure=[{boundary='top', value='1/(x - x)'}]", "values of '1/(x - x)', the first at ("),
    ("stage.vertical.pressure=[{boundary='top', value='x', gradient=[1.0, 0.0]}]", "a gradient goes with a number"),
    ("stage.vertical.traction=[{boundary='top', value=['x']}]", "has 1 entries, it needs exactly 2"),
    ("stage.vertical.pressure=[{boundary='top', value=[1.0]}]", "neither a number nor an expression"),
    ("stage.vertical.amplitude='ramps'", "'ramps' is not one of ramp, step, sine"),
    ("stage.vertical.amplitude=[[0.0, 0.0], [2.0, 1.0]]", "ends at 2; a stage ends at 1"),
    ("stage.vertical.cycles=2", "cycles = 2 goes with an amplitude that has cycles"),
    ("stage.initial.amplitude='step'", "act from the outset"),
    ("stage.vertical.rigid.0.displacement_y=-1e-3", "a displacement and a force along y"),
    ("stage.vertical.rigid.0.rotation='held'", "rotation = 'held' is not one of free, fixed"),
    ("stage.vertical.rigid.0.rough=1", "rough"),
    ("stage.vertical.rigid.0.boundary='foting'", "the nearest is 'footing'"),
    ("stage.vertical.spring=[{boundary='left'}]", "a spring without stiffness"),
    ("stage.vertical.spring=[{boundary='left', normal=-1.0}]", "is negative"),
    ("stage.vertical.control={target=-1e-3}", "either point or rigid"),
    ("stage.vertical.control={target=-1e-3, rigid='top'}", "there is none"),
    ("stage.vertical.fixed=[{boundary='footing'}]", "has a support and a rigid body"),
    ("mesh.part=[{name='footing', boundary='top', x=[5.1, 7.0]}]", "snap = true moves the ends"),
    ("mesh.part=[{name='footing', boundary='top', x=[5.05, 5.1], snap=true}]", "for the larger part between"),
]


@pytest.mark.parametrize(("assignment", "words"), BAD, ids=[words[:30] for _, words in BAD])
def test_bad_values_end_with_one_sentence(assignment: str, words: str, granfabric: Callable, tmp_path: Path) -> None:
    result = granfabric("run", "rigid_footing", "-o", tmp_path / "out", "--set", assignment)
    assert result.code == 2 and words in result.err, result.err
    assert result.err.count("\n") == 1 and not (tmp_path / "out").exists()
