"""Grains at the points of scenes whose body changes, with rigid bodies, springs and controls."""

from __future__ import annotations

import re

import meshio
import numpy as np
import pytest
from test_grains_scenes import FIELD, POINT, own_store, quiet, scene  # noqa: F401  (the fixture is for all tests here)
from test_grains_workers import kill
from test_scene_stages import layers_file

from granfabric.cases.commands.run import run_field
from granfabric.cases.engine.choice import Choice
from granfabric.cases.errors import InputError, RunError
from granfabric.cases.grains.spread_law import SpreadGrainsLaw
from granfabric.cases.records import files
from granfabric.cases.records.field_recorder import FieldRecorder

HEAD = FIELD.split("[mesh]")[0]
STAGES = f"""{HEAD}
[mesh]
file = "layers.msh"
element = "P1"
[initial]
from = "weight"
k0 = 0.7
[[stage]]
name = "initial"
increments = 1
fixed = [
    {{ boundary = "bottom" }},
    {{ boundary = "left", components = ["x"] }},
    {{ boundary = "right", components = ["x"] }},
]
body_force = [{{ value = [0.0, -17e3] }}]
pressure = [{{ boundary = "middle", value = 30e3 }}]
[[stage]]
name = "dig"
increments = 2
deactivate = ["trench"]
release = 0.3
[[stage]]
name = "rest"
increments = 1
release = 0.3
reset_displacements = true
[[stage]]
name = "fill"
increments = 3
activate = ["trench", "fill"]
fill_pressure = 25e3
pressure = [{{ boundary = "middle", value = 0.0 }}, {{ boundary = "top", value = 25e3 }}]
[output]
pictures = false
"""


def written(folder):
    """All files of results, by name."""
    return {file.name: file.read_bytes() for file in folder.iterdir() if file.suffix in (".vtu", ".csv", ".pvd")}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The trench dug and filled again, in one go."""
    folder, store = tmp_path_factory.mktemp("stages"), tmp_path_factory.getbasetemp() / "packings"
    layers_file(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("granfabric.cases.grains.store.default_folder", lambda: store)
        assert run_field(scene(folder, STAGES), folder / "out", quiet()).outcome == "finished"
    return folder / "out"


def points(folder, step):
    """Data of the integration points after a step."""
    return meshio.read(folder / f"points_{step:04d}.vtu")


def test_excavation_unloads_and_a_fill_begins_with_fresh_packings(whole):
    names, rows = files.read_rows(whole / "history.csv")
    steps = {int(row[0]): dict(zip(names, row)) for row in rows}
    assert [steps[step]["stage"] for step in (1, 2, 4, 5)] == ["initial", "dig", "rest", "fill"]
    before, dug, filled, last = (points(whole, step) for step in (1, 3, 5, max(steps)))
    assert (len(before.points), len(dug.points), len(last.points)) == (32, 28, 48)
    wall = np.hypot(*(dug.points[:, :2] - [1.2, 1.5]).T).argmin()
    there = np.hypot(*(before.points[:, :2] - dug.points[wall, :2]).T).argmin()
    # the wall of the trench loses a part of what held it, and contacts
    assert dug.point_data["stress"][wall, 0] > 0.95 * before.point_data["stress"][there, 0]
    assert dug.point_data["coordination"].mean() < before.point_data["coordination"].mean()
    steps_done = filled.point_data["motion_steps"]
    fresh = (filled.points[:, 1] > 2.0) | ((filled.points[:, 1] > 1.0) & (filled.points[:, 0] < 1.0))
    assert fresh.sum() == 20 and steps_done[fresh].max() < np.median(steps_done[~fresh])
    # a third of the way to the full load only the weight of the fill and its surcharge have come
    assert -30e3 < last.point_data["stress"][last.points[:, 1] > 2.5][:, 4].mean() < -20e3


def test_going_on_within_a_changed_body_gives_the_same_files(tmp_path, whole, monkeypatch):
    layers_file(tmp_path)
    loaded, save = scene(tmp_path, STAGES), FieldRecorder.save
    for step in (2, 5):

        def stopped(recorder, checkpoint, step=step):
            save(recorder, checkpoint)
            if checkpoint.result.step >= step:
                raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(FieldRecorder, "save", stopped)
            with pytest.raises(RunError, match="interrupted within a step"):
                run_field(loaded, tmp_path / f"{step}", quiet())
        assert run_field(loaded, tmp_path / f"{step}", quiet(), resume=True).outcome == "finished"
        assert written(tmp_path / f"{step}") == written(whole)


def test_workers_follow_a_body_that_changes(tmp_path, whole, monkeypatch):
    """One is killed when the fill has come, so that packings of all ages are held by another one afterwards."""
    layers_file(tmp_path)
    original, calls = SpreadGrainsLaw.update, [0]

    def update(shared, *arguments, **more):
        calls[0] += len(arguments[0]) == 48
        if calls[0] == 2:
            calls[0] += 1
            kill(shared._crew, 1)
        return original(shared, *arguments, **more)

    monkeypatch.setattr(SpreadGrainsLaw, "update", update)
    record = run_field(scene(tmp_path, STAGES), tmp_path / "out", quiet(), choice=Choice(workers=2))
    assert record.outcome == "finished" and calls[0] > 3
    assert written(tmp_path / "out") == written(whole)


def test_fill_without_pressure_is_refused_by_name(tmp_path):
    layers_file(tmp_path)
    text = STAGES.replace("fill_pressure = 25e3\n", "")
    with pytest.raises(InputError, match=r'stage 4 "fill": fill_pressure = 0 Pa: without pressure a packing carries'):
        run_field(scene(tmp_path, text), tmp_path / "out", quiet())
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("source", ["weight", "gravity"])
def test_ground_of_grains_begins_under_its_weight(tmp_path, source):
    layers_file(tmp_path)
    first, last = STAGES.split('[[stage]]\nname = "dig"')[0], STAGES.split('[output]')[1]
    text = first.replace('boundary = "middle"', 'boundary = "top"').replace('"weight"', f'"{source}"')
    record = run_field(scene(tmp_path, f"{text}[output]{last}"), tmp_path / "out", quiet())
    assert record.outcome == "finished"
    data = points(tmp_path / "out", 1)
    stress = data.point_data["stress"]
    np.testing.assert_allclose(stress[:, 4], -30e3 - 17e3 * (3.0 - data.points[:, 1]), rtol=2e-2)
    np.testing.assert_allclose(stress[:, 0], 0.7 * stress[:, 4], rtol=2e-2)


JOINED = {
    "rigid": (
        'fixed = [{ boundary = "bottom" }]\nrigid = [{ boundary = "top", rotation = "fixed", force = [0.0, -5e3] }]',
        'rigid = [{ boundary = "top", rotation = "fixed", displacement_y = -1e-5 }]',
    ),
    "springs": (
        'fixed = [{ boundary = "bottom" }, { boundary = "top" }]\nspring = [{ boundary = "left", normal = 1e13 }]',
        'displacement = [{ boundary = "top", component = "y", value = -1e-5 }]',
    ),
    "control": (
        'fixed = [{ boundary = "bottom" }]',
        'pressure = [{ boundary = "top", value = 130e3 }]\ncontrol = { point = [0.0, 0.1], target = -1e-5 }',
    ),
}


@pytest.mark.parametrize("kind", JOINED)
def test_rigid_bodies_springs_and_controls(tmp_path, kind):
    first, second = JOINED[kind]
    text = FIELD.replace('fixed = [{ boundary = "bottom" }, { boundary = "top" }]', first)
    text = text.replace('displacement = [{ boundary = "top", component = "y", value = -1e-5 }]', second)
    if kind == "control":
        left = 'pressure = [{ boundary = "left"'
        text = text.replace(left, left.replace("[", '[{ boundary = "top", value = 100e3 }, '))
    record = run_field(scene(tmp_path, text), tmp_path / "out", quiet())
    assert record.outcome == "finished"
    names, rows = files.read_rows(tmp_path / "out" / "history.csv")
    last = dict(zip(names, rows[-1]))
    if kind == "rigid":
        assert float(last["displacement_top_y"]) == pytest.approx(-1e-5, rel=1e-9)
    elif kind == "control":
        carried = 100e3 + 30e3 * float(last["load_factor"])
        assert carried > 110e3 and -float(last["stress_yy"]) == pytest.approx(carried, rel=1e-3)
        assert meshio.read(tmp_path / "out/result_0005.vtu").point_data["displacement"][:, 1].min() < -0.99e-5
    else:  # a wall that does not give way: the left side stays where it was
        field = meshio.read(tmp_path / "out/result_0005.vtu")
        left, right = (np.abs(field.points[:, 0] - x) < 1e-9 for x in (0.0, 0.05))
        moved = field.point_data["displacement"][:, 0]
        assert np.abs(moved[left]).max() < 0.1 * np.abs(moved[right]).max()


def test_random_state_is_refused_by_name(tmp_path):
    given = ["seed=1", "standard_deviation=0.1", "correlation_length=[0.01, 0.01]"]
    with pytest.raises(InputError, match=r"random_state does not go with law.kind = 'grains'"):
        scene(tmp_path, FIELD, *(f"random_state.{text}" for text in given))


def test_sweep_of_scenes_with_grains(tmp_path, granfabric):
    for name, text in (("field", FIELD), ("point", POINT)):
        (tmp_path / f"{name}.toml").write_text(text)
        asked = ("sweep", tmp_path / f"{name}.toml", "--set", "packing.friction=0.3,0.5", "--workers", 1)
        done = granfabric(*asked, "--result", "coordination", "-o", tmp_path / name)
        assert done.code == 0, done.err
        one = tmp_path / name / "friction=0.3"
        single = granfabric("run" if name == "field" else "point", one / "scene.toml", "-o", tmp_path / f"{name}_alone")
        assert single.code == 0, single.err
        assert (one / "history.csv").read_bytes() == (tmp_path / f"{name}_alone" / "history.csv").read_bytes()
    given = ("--set", "closure.fluctuation=0.1,0.2", "-o", tmp_path / "no")
    refused = granfabric("sweep", tmp_path / "field.toml", *given)
    assert refused.code == 2 and "closure does not go with law.kind = 'grains'" in refused.err


def test_commands_that_have_nothing_to_do_with_grains_say_so(tmp_path, granfabric):
    (tmp_path / "field.toml").write_text(FIELD)
    refused = granfabric("convergence", tmp_path / "field.toml", "-o", tmp_path / "out")
    assert refused.code == 2 and re.search("law.kind = 'grains': no closed form is known of disks", refused.err)
    assert not (tmp_path / "out").exists()
