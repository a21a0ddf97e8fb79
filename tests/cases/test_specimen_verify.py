"""`granfabric verify SCENE --specimens N`: which scenes specimens follow, and what the table says."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from granfabric.cases.commands.verify_scene import Judges, run_verify_scene
from granfabric.cases.engine.choice import Choice
from granfabric.cases.errors import InputError, RunError
from granfabric.cases.records import files
from granfabric.cases.scene.reader import load
from granfabric.cases.terminal.screen import Screen
from granfabric.cases.verify import specimen_task
from granfabric.cases.verify.scene_plan import SpecimenPlan, plan_of
from granfabric.cases.verify.scene_specimens import with_error

QUICK = ["mesh.rectangle.nx=1", "mesh.rectangle.ny=2", "mesh.element=P1", "stage.1.increments=2"]
QUICK += ["stage.1.displacement.0.value=-1.2e-5", "output.pictures=false"]


def test_plans_of_shipped_scenes() -> None:
    rough, smooth = plan_of(load("biaxial")), plan_of(load("biaxial_smooth"))
    assert rough.is_rough and not smooth.is_rough and rough.pressure == 100e3
    assert (rough.width, rough.height) == (pytest.approx(0.05), pytest.approx(0.1))
    assert rough.strains == {"initial": 0.0, "compression": pytest.approx(9e-5)}
    cycles = plan_of(load("cyclic_biaxial"))
    assert cycles.strains["load 1"] == pytest.approx(6e-5) and cycles.strains["unload 2"] == 0.0
    assert cycles.targets("unload 2", 1.0) == pytest.approx([6e-5, 0.0, 6e-5, 0.0])
    assert cycles.targets("unload 1", 0.5) == pytest.approx([6e-5, 3e-5])


def test_legs_in_one_sense_are_one() -> None:
    plan = SpecimenPlan(1.0, 2.0, 1e5, True, {"a": 1e-4, "b": 2e-4, "c": 2e-4, "d": 1e-4})
    assert plan.targets("b", 0.5) == pytest.approx([1.5e-4])
    assert plan.targets("d", 1.0) == pytest.approx([2e-4, 1e-4])


@pytest.mark.parametrize(
    ("scene", "given", "words"),
    [
        ("simple_shear_specimen", [], "initial stress is not the same in all directions"),
        ("pressurised_cavity", [], "the mesh has no boundary 'right'"),
        ("strip_footing", [], "--specimens: "),
        ("biaxial_smooth", ["stage.1.displacement.0.component=x"], "x of boundary 'top' is moved"),
        ("biaxial_smooth", ["stage.0.pressure.0.value=90e3"], "is not the initial one of 100000 Pa"),
        ("biaxial_smooth", ["stage.0.fixed.0.components=['x', 'y']"], "one of its ends is held sideways"),
        ("biaxial_smooth", ["stage.1.body_force=[{value=[0.0, -1.0]}]"], "has body_force"),
        ("biaxial_smooth", ["stage.1.amplitude=smooth"], "amplitude"),
        ("biaxial_smooth", ["stage.1.displacement.0.value=0.0"], "nothing is compressed"),
    ],
)
def test_what_specimens_cannot_follow_is_refused_for_them_alone(
    tmp_path: Path, scene: str, given: list[str], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        run_verify_scene(scene, tmp_path / "out", 60, 2, given, Screen(quiet=True), judges=Judges(1, 200))
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_three_judges_in_one_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("granfabric.cases.engine.choice.cores", lambda: 1)  # specimens in this process
    judges = Judges(specimens=2, disks=120, measured=True)
    record = run_verify_scene("biaxial_smooth", tmp_path, 60, 2, QUICK, Screen(quiet=True), judges=judges)
    assert record.outcome == "finished", record.message
    names, rows = files.read_rows(tmp_path / "scene_comparison.csv")
    table = {row[0]: dict(zip(names[1:], row[1:])) for row in rows}
    reaction = table["reaction_top_y, increment over initial"]
    assert 0.05 < float(reaction["specimens"]) < 1.0 and float(reaction["standard_error"]) > 0.0
    assert float(table["mean change of z"]["specimens"]) < 0.0
    assert np.isfinite(float(table["q/p at points"]["law_rms"]))
    # at the points z is shared out among all of them: no specimen's mean is far from that of its disks
    assert 3.0 < float(table["initial z"]["specimens"]) < 4.2
    assert record.details["specimens"]["computed"] == 2 and record.details["specimens"]["platens"] == "smooth"
    assert np.asarray(Image.open(tmp_path / "scene_comparison.png")).std() > 5.0
    # the law has been given what the packings of the specimens have
    measured = tomllib.loads((tmp_path / "material.toml").read_text())["material"]
    law = tomllib.loads((tmp_path / "law" / "scene.toml").read_text())["material"]
    assert law["coordination"] == measured["coordination"] != load("biaxial_smooth").scene.material.coordination


@pytest.mark.slow
def test_results_do_not_depend_on_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    judges = Judges(specimens=3, disks=120)
    monkeypatch.setattr("granfabric.cases.engine.choice.cores", lambda: 1)
    tables = []
    for name, choice in (("one", None), ("two", Choice(workers=2))):
        given = (tmp_path / name, 60, 2, QUICK, Screen(quiet=True))
        assert run_verify_scene("biaxial_smooth", *given, judges=judges, choice=choice).outcome == "finished"
        tables.append((tmp_path / name / "scene_comparison.csv").read_bytes())
    assert tables[0] == tables[1]


def test_a_specimen_that_does_not_come_to_rest_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*arguments: object) -> None:
        raise RunError("a specimen was given up: it moves")

    monkeypatch.setattr(specimen_task, "compressed", fails)
    plan = SpecimenPlan(1.0, 1.0, 1e5, False, {"a": 1e-4})
    task = specimen_task.SpecimenTask(1, 60, plan, 1e9, 1.0, ("a", 1.0), {}, 1)
    assert specimen_task.carry_out(task, lambda part: None, lambda: False) == "a specimen was given up: it moves"
    assert specimen_task.carry_out(task, lambda part: None, lambda: True) is None


def test_mean_and_standard_error() -> None:
    assert with_error([1.0, 2.0, 3.0]) == (2.0, pytest.approx(1.0 / np.sqrt(3.0)))
    assert with_error([1.0]) == (1.0, "")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("biaxial", "--specimens", 0), "--specimens 0 is outside [1, 100]"),
        (("biaxial", "--specimen-particles", 500), "--specimen-particles goes with --specimens N"),
        (("biaxial", "--specimens", 1, "--specimen-particles", 10), "--specimen-particles 10 is outside [100, 200000]"),
        (("--specimens", 2), "--specimens goes with a scene"),
        (("--measured",), "--measured goes with a scene"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    granfabric: Callable, tmp_path: Path, options: tuple, words: str
) -> None:
    result = granfabric("verify", *options, "-o", tmp_path / "out")
    assert result.code == 2 and words in result.err, result.err
    assert not (tmp_path / "out").exists()
