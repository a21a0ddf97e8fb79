"""`accuracy` in a scene: what it chooses, that explicit settings win, and that the reported error is honest."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import get_args

import pytest

from granfabric.cases.commands.accuracy_field import means
from granfabric.cases.cost.batch import distance, follow, initial_state, law_of, make_batch
from granfabric.cases.records.files import read_csv
from granfabric.cases.scene import catalogue
from granfabric.cases.scene.accuracy import COARSEST, FINEST, TABLE, settings_for
from granfabric.cases.scene.reader import load
from granfabric.constitutive.parameters import Closure, ForceChange, Integration

CLOSURES = [Closure(distribution="maximum_entropy")] + [
    Closure(force_change=choice, tangential=tangential)
    for choice in get_args(ForceChange)
    for tangential in (("neglected", "self_consistent") if choice == "mean_field" else ("self_consistent",))
]
POINT_SCENES = ("p_constant", "lateral_constant", "unload_reload", "axes_rotation", "simple_shear", "isotropic")
FIELD = """
title = "Coarse block between rough platens"
kind = "field"
accuracy = {accuracy}
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
bulk_reduction = 0.88
shear_reduction = 0.69
[closure]
force_change = "mean_field"
[mesh]
rectangle = {{ width = 0.05, height = 0.1, nx = 2, ny = 4 }}
element = "P2"
[output]
pictures = false
[initial]
stress = [-100e3, -100e3, 0.0]
[[stage]]
name = "initial"
fixed = [{{ boundary = "bottom" }}, {{ boundary = "top" }}]
pressure = [{{ boundary = "left", value = 100e3 }}, {{ boundary = "right", value = 100e3 }}]
[[stage]]
name = "compression"
displacement = [{{ boundary = "top", component = "y", value = -9e-6 }}]
[[stage]]
name = "release"
displacement = [{{ boundary = "top", component = "y", value = -6e-6 }}]
"""


def test_table_is_ordered_and_meets_its_own_promise() -> None:
    for coarse, fine in pairwise(TABLE):
        assert fine.accuracy < coarse.accuracy and fine.tolerance < coarse.tolerance
        assert fine.solver_tolerance < coarse.solver_tolerance and fine.directions >= coarse.directions
    assert TABLE[0].accuracy == COARSEST and TABLE[-1].accuracy == FINEST
    for row in TABLE:
        assert row.measured < row.accuracy and row.solver_tolerance < row.accuracy
        assert settings_for(row.accuracy) is row
    assert settings_for(3e-4) is settings_for(1e-4)  # the next finer one


@pytest.mark.parametrize("closure", CLOSURES, ids=lambda closure: f"{closure.force_change}-{closure.tangential}")
@pytest.mark.parametrize("row", TABLE, ids=lambda row: f"{row.accuracy:g}")
def test_settings_reach_their_accuracy_on_other_paths(row, closure: Closure) -> None:
    state_form = closure.force_change == "shifted_distribution"
    batch = make_batch(8 if state_form else 24)
    directions = row.directions_for(closure.force_change)
    law = law_of(Integration(integrator=row.integrator, tolerance=row.tolerance, directions=directions), closure)
    exact = law_of(Integration(integrator="bogacki_shampine", tolerance=1e-11, directions=64), closure)
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


@pytest.mark.parametrize("closure", get_args(ForceChange))
@pytest.mark.parametrize("name", POINT_SCENES)
def test_shipped_paths_keep_within_their_accuracy(
    granfabric: Callable, name: str, closure: str, tmp_path: Path
) -> None:
    """Every path that is shipped, increments left open: the error against a much tighter run is what was asked for."""
    text = catalogue.find(name).read_text()
    if "rotation_degrees" in text:  # elsewhere increments make no error
        text = "\n".join(line for line in text.splitlines() if not line.startswith("increments"))
    scene = tmp_path / f"{name}.toml"
    scene.write_text(text)
    errors = []
    for accuracy in ("1e-2", "1e-4", "1e-6"):
        said = (f"accuracy={accuracy}", f"closure.force_change={closure}", "output.pictures=false")
        arguments = [argument for text in said for argument in ("--set", text)]
        result = granfabric("point", scene, *arguments, "-o", tmp_path / accuracy)
        assert result.code == 0, result.err
        entry = json.loads((tmp_path / accuracy / "run.json").read_text())["accuracy"]
        errors.append(entry["achieved"]["largest"])
        assert errors[-1] < float(accuracy)
    # what the directions of the averages leave is the same for every accuracy, 2e-8 at most
    assert errors[-1] <= max(errors[0], 5e-8)


def field(granfabric: Callable, folder: Path, accuracy: str, *more: str) -> tuple[dict, tuple[float, float, float]]:
    """Run the block; its record and its means at the end."""
    scene = folder / "block.toml"
    scene.write_text(FIELD.format(accuracy=accuracy))
    arguments = [argument for text in more for argument in ("--set", text)]
    result = granfabric("run", scene, *arguments, "-o", folder / "out")
    assert result.code == 0, result.err
    assert "error estimate" in result.out
    return json.loads((folder / "out" / "run.json").read_text()), means(read_csv(folder / "out" / "history.csv"), -1)


def test_a_field_run_keeps_within_its_accuracy_and_says_so(granfabric: Callable, tmp_path: Path) -> None:
    """Loading and unloading of a coarse block: load steps too are chosen, and assessed honestly."""
    exact = field(granfabric, tmp_path, "1e-7", "stage.1.increments=48", "stage.2.increments=48")[1]
    for accuracy in ("1e-2", "1e-4", "1e-6"):
        record, found = field(granfabric, tmp_path, accuracy)
        errors = [abs(found[0] - exact[0]), abs(found[1] / exact[1] - 1.0), abs(found[2] - exact[2])]
        assert max(errors) < float(accuracy)
        entry = record["accuracy"]
        assert entry["chosen"]["stage.1.increments"] == settings_for(float(accuracy)).load_steps
        assert entry["expected"] < float(accuracy)
        estimate = entry["load_steps"]
        # load steps dominate; the estimate is of their order, never many times too small
        assert max(errors) < 5 * estimate["largest"] + entry["expected"]
        assert record["timing"]["accuracy"] >= estimate["seconds"] > 0


def test_increments_of_the_scene_win(granfabric: Callable, tmp_path: Path) -> None:
    record, _ = field(granfabric, tmp_path, '"quick"', "stage.1.increments=5")
    chosen = record["accuracy"]["chosen"]
    assert "stage.1.increments" not in chosen and chosen["stage.2.increments"] == settings_for(1e-3).load_steps
    assert record["scene"]["stage"][1]["increments"] == 5
