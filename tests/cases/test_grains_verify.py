"""`granfabric verify SCENE`: one scene by the law and by grains at its points."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from granfabric.cases.commands.verify_kinds import verify_as_asked
from granfabric.cases.commands.verify_scene import run_verify_scene
from granfabric.cases.engine.choice import Choice
from granfabric.cases.errors import InputError
from granfabric.cases.records import files
from granfabric.cases.scene.reader import load
from granfabric.cases.terminal.screen import Screen

QUICK = ["mesh.rectangle.nx=1", "mesh.rectangle.ny=1", "mesh.element=P1", "stage.1.increments=2"]
QUICK += ["stage.1.displacement.0.value=-3e-6", "output.pictures=false"]


def test_law_and_grains_are_compared_at_the_end(tmp_path):
    record = run_verify_scene("biaxial_smooth", tmp_path, 60, 2, QUICK, Screen(quiet=True))
    assert record.outcome == "finished"
    names, rows = files.read_rows(tmp_path / "scene_comparison.csv")
    table = {row[0]: dict(zip(names[1:], row[1:])) for row in rows}
    reaction = table["reaction_top_y, increment over initial"]
    law, grains = files.read_rows(tmp_path / "law/history.csv"), files.read_rows(tmp_path / "grains/history.csv")
    for key, (columns, steps) in (("law", law), ("grains", grains)):
        place = columns.index("reaction_top_y")
        start, end = float(steps[0][place]), float(steps[-1][place])
        assert float(reaction[key]) == pytest.approx((end - start) / start, rel=1e-12)
        assert float(table["mean change of z"][key]) < 0.0
        assert float(table["change of a_c along x at points"][key]) < 0.0  # compressed along y
    assert float(table["initial z"]["law"]) == pytest.approx(3.896, abs=1e-3)
    assert 0.05 < float(reaction["grains"]) < float(reaction["law"]) * 1.5
    assert np.isfinite(float(table["q/p at points"]["rms"]))
    assert np.asarray(Image.open(tmp_path / "scene_comparison.png")).std() > 5.0
    # the grains are a scene of their own, with the contacts of the law's material
    made, own = load(str(tmp_path / "grains.toml")).scene, load("biaxial_smooth").scene
    assert made.packing.normal_stiffness == own.material.normal_stiffness and made.solver.tolerance == 1e-4


@pytest.mark.parametrize(
    ("scene", "given", "text"),
    [
        ("grains_biaxial", [], "grains stand at its points already"),
        ("biaxial_inclusion", [], "one with one material|scenes with one material"),
        ("random_specimen", [], "no coordination that varies"),
        ("undrained_biaxial", [], "grains at the points are dry"),
        ("p_constant", [], "is not a boundary-value problem"),
    ],
)
def test_scenes_that_grains_cannot_follow_are_refused(tmp_path, scene, given, text):
    with pytest.raises(InputError, match=text):
        run_verify_scene(scene, tmp_path / "out", 60, 2, given, Screen(quiet=True))
    assert not (tmp_path / "out").exists()


def test_options_of_other_comparisons_are_refused(tmp_path):
    with pytest.raises(InputError, match="--quick does not go with a scene"):
        verify_as_asked("biaxial", tmp_path, None, None, None, None, [], [], True, Choice(), Screen(quiet=True), False)
    with pytest.raises(InputError, match=r"--particles 10 is outside \[50, 20000\]"):
        run_verify_scene("biaxial", tmp_path, 10, None, [], Screen(quiet=True))
