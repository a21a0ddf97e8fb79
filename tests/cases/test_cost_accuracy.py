"""`accuracy` in a scene: what it chooses, that explicit settings win, and that the reported error is honest."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from cases.accuracy import COARSEST, FINEST, TABLE, settings_for
from cases.cost.batch import distance, follow, initial_state, law_of, make_batch
from cases.scene import load
from constitutive.parameters import Closure, Integration


def test_table_is_ordered_and_meets_its_own_promise() -> None:
    for coarse, fine in pairwise(TABLE):
        assert fine.accuracy < coarse.accuracy and fine.tolerance < coarse.tolerance
        assert fine.solver_tolerance < coarse.solver_tolerance and fine.directions >= coarse.directions
    assert TABLE[0].accuracy == COARSEST and TABLE[-1].accuracy == FINEST
    for row in TABLE:
        assert row.measured < row.accuracy and row.solver_tolerance < row.accuracy
        assert settings_for(row.accuracy) is row
    assert settings_for(3e-4) is settings_for(1e-4)  # the next finer one


@pytest.mark.parametrize("closure", [Closure(), Closure(distribution="maximum_entropy")])
@pytest.mark.parametrize("row", TABLE, ids=lambda row: f"{row.accuracy:g}")
def test_settings_reach_their_accuracy_on_other_paths(row, closure: Closure) -> None:
    batch = make_batch(24)
    law = law_of(Integration(integrator=row.integrator, tolerance=row.tolerance, directions=row.directions), closure)
    exact = law_of(Integration(integrator="bogacki_shampine", tolerance=1e-11, directions=32), closure)
    error = distance(
        follow(law, batch, initial_state(law, batch), 3), follow(exact, batch, initial_state(exact, batch), 30)
    )
    assert error.max() < row.accuracy


def test_what_the_scene_leaves_open_is_filled_in() -> None:
    loaded = load("biaxial", ["accuracy=1e-4"])
    assert loaded.scene.integration.tolerance == 1e-5 and loaded.scene.solver.tolerance == 1e-6
    assert loaded.accuracy is not None and not loaded.accuracy.kept
    assert load("biaxial").accuracy is None
    assert load("p_constant", ["accuracy=reference"]).scene.integration.tolerance == 1e-9


def test_explicit_settings_win_and_are_named() -> None:
    loaded = load("p_constant", ["accuracy=quick", "integration.tolerance=1e-9"])
    assert loaded.scene.integration.tolerance == 1e-9
    assert loaded.accuracy is not None and loaded.accuracy.kept == {"integration.tolerance": 1e-9}
    assert "kept as the scene sets it: integration.tolerance = 1e-09" in loaded.accuracy.text()
    fixed = load("p_constant", ["accuracy=quick", "integration.substeps=7"])
    assert fixed.scene.integration.substeps == 7 and fixed.scene.integration.tolerance == Integration().tolerance
    assert fixed.accuracy is not None and fixed.accuracy.kept == {"integration.substeps": 7}


@pytest.mark.parametrize("value", ["fast", "0.5", "1e-12", "true", "[1]", "1"])
def test_illegal_accuracy_is_one_sentence(granfabric: Callable, tmp_path: Path, value: str) -> None:
    result = granfabric("point", "p_constant", "--set", f"accuracy={value}", "-o", tmp_path / "new")
    assert result.code == 2 and result.err.count("\n") == 1
    assert "accuracy" in result.err and "reference" in result.err
    assert not (tmp_path / "new").exists()


def test_a_point_run_reports_what_it_achieved(granfabric: Callable, tmp_path: Path) -> None:
    errors = {}
    for accuracy in ("1e-2", "1e-6"):
        arguments = ("--set", f"accuracy={accuracy}", "--set", "output.pictures=false", "--set", "path.0.increments=1")
        result = granfabric("point", "p_constant", *arguments, "-o", tmp_path / accuracy)
        assert result.code == 0 and "error estimate" in result.out
        entry = json.loads((tmp_path / accuracy / "run.json").read_text())["accuracy"]
        errors[accuracy] = entry["achieved"]["largest"]
        assert 0.0 < errors[accuracy] <= float(accuracy)
    assert errors["1e-6"] < errors["1e-2"]
