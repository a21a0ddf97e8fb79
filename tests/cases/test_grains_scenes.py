"""Scenes with grains at their points: schema, packings and their store, runs, going on, failed points."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import meshio
import numpy as np
import pytest

from granfabric.cases.commands.effects import show_effects
from granfabric.cases.commands.point import run_point
from granfabric.cases.commands.run import run_field
from granfabric.cases.errors import InputError, RunError
from granfabric.cases.grains.law import GrainsLaw
from granfabric.cases.grains.point_path import drive_point
from granfabric.cases.grains.store import PackingStore
from granfabric.cases.records import files
from granfabric.cases.scene.reader import load
from granfabric.cases.scene.schema_law_kind import remarks
from granfabric.cases.terminal.screen import Screen
from granfabric.constitutive.path import Leg
from granfabric.dem_ref.dynamics.packing import PackingOptions
from granfabric.dem_ref.measures.contacts import (
    contacts_of,
    coordination_number,
    fabric_anisotropy,
    love_weber_stress,
    unbalanced_force,
)
from granfabric.dem_ref.sample.disks import load_sample, save_sample

FIELD = """
[law]
kind = "grains"
packings = 2
strain_step = 2e-7
rest = 1e-4
[packing]
particles = 50
[mesh]
element = "P1"
rectangle = { width = 0.05, height = 0.1, nx = 1, ny = 2 }
[initial]
stress = [-100e3, -100e3, 0.0]
[[stage]]
name = "initial"
increments = 1
fixed = [{ boundary = "bottom" }, { boundary = "top" }]
pressure = [{ boundary = "left", value = 100e3 }, { boundary = "right", value = 100e3 }]
[[stage]]
name = "compression"
increments = 4
displacement = [{ boundary = "top", component = "y", value = -1e-5 }]
[output]
pictures = false
"""
POINT = """
[law]
kind = "grains"
[packing]
particles = 50
[initial]
stress = [-100e3, -100e3, 0.0]
[[path]]
control = ["stress", "strain", "stress"]
target = [-100e3, -4e-5, 0.0]
increments = 2
[output]
pictures = false
"""


@pytest.fixture(autouse=True)
def own_store(tmp_path_factory, monkeypatch):
    """Packings of these tests are kept once for all of them, and apart from a user's."""
    folder = tmp_path_factory.getbasetemp() / "packings"
    monkeypatch.setattr("granfabric.cases.grains.store.default_folder", lambda: folder)
    return folder


def scene(tmp_path: Path, text: str, *given: str):
    file = tmp_path / "mine.toml"
    file.write_text(text)
    return load(str(file), list(given))


def quiet() -> Screen:
    return Screen(quiet=True)


REFUSED = {
    "material_file=dense_disks": "material does not go with law.kind = 'grains': the disks of \\[packing\\]",
    "effects.sliding=true": "effects does not go with law.kind",
    "closure.fluctuation=0.1": "closure does not go with law.kind",
    "integration.tolerance=1e-6": "integration does not go with law.kind",
    "accuracy=1e-4": "accuracy does not go with law.kind",
    "initial.pore_pressure=1e3": "initial.pore_pressure does not go with law.kind = 'grains': grains are dry",
    "packing.stiffness_to_pressure=1e4": "kn over p follows from packing.normal_stiffness and the initial stress",
    "packing.particles=30000": "packing.particles = 30000 is outside its bounds \\[50, 20000\\]",
    "packing.normal_stiffness=1e3": "is 0.01; packings are made for 50 to 1e\\+06",
    "law.packing_file=packing.npz": "packing does not go with law.packing_file",
    "law.tangent=exact": "law.tangent = 'exact' is not one of secant, network",
    "law.rest=0.5": "law.rest = 0.5 is outside its bounds \\[1e-09, 0.01\\]",
    "law.strainstep=1e-8": "the nearest is 'strain_step'",
    "law.kind=grain": "law.kind = 'grain' is not one of contact, grains; the nearest is 'grains'",
    "law.kind=contact": "packing goes with a DEM scene or with law.kind = 'grains'",
}


@pytest.mark.parametrize("given", REFUSED)
@pytest.mark.parametrize("text", [FIELD, POINT])
def test_what_makes_no_sense_is_refused_by_name(tmp_path, text, given):
    command = run_field if text is FIELD else run_point
    with pytest.raises(InputError, match=REFUSED[given]):
        command(scene(tmp_path, text, given), tmp_path / "out", quiet())
    assert not (tmp_path / "out").exists()


def test_law_keys_without_grains_are_refused(tmp_path):
    text = FIELD.replace("[law]", "[unused]")
    with pytest.raises(InputError, match=r"the tables do not agree on it"):
        scene(tmp_path, text)
    with pytest.raises(InputError, match=r"law\.packings goes with law.kind = 'grains'"):
        load("biaxial_smooth", ["law.packings=3"])
    with pytest.raises(InputError, match=r"'material' is missing \(the granular material\)"):
        head, tail = POINT.split("[packing]")[0], POINT.split("[initial]")[1]
        scene(tmp_path, head.replace("grains", "contact") + "[initial]" + tail)
    assert load("biaxial_smooth", ["law.kind=contact"]).scene.law.kind == "contact"


def test_tolerance_of_the_solver_follows_the_law(tmp_path):
    assert scene(tmp_path, FIELD).scene.solver.tolerance == 1e-4
    assert scene(tmp_path, FIELD, "solver.tolerance=1e-5").scene.solver.tolerance == 1e-5
    assert load("biaxial_smooth").scene.solver.tolerance == 1e-8


def test_packings_are_made_once_and_damaged_files_anew(tmp_path):
    options = PackingOptions()
    store = PackingStore(50, options, tmp_path)
    first = store.at_rest(1)
    target = np.array([-0.9e5, -1.1e5, 0.05e5])
    assert PackingOptions().normal_stiffness / options.stiffness_to_pressure == 1e5
    loaded = store.under(1, target)
    assert store.made == 2 and len(list(tmp_path.glob("*.npz"))) == 2
    np.testing.assert_allclose(love_weber_stress(loaded), target, atol=1e-3 * 1e5)
    assert unbalanced_force(loaded) <= 1e-5
    again = PackingStore(50, options, tmp_path)
    assert np.array_equal(again.under(1, target).position, loaded.position) and again.made == 0
    file = again.file(1, None)
    file.write_bytes(file.read_bytes()[:1000])
    assert np.array_equal(again.at_rest(1).position, first.position) and again.made == 1
    assert again.file(2, None) != file != PackingStore(50, PackingOptions(friction=0.4), tmp_path).file(1, None)
    assert PackingStore(50, options, Path("/proc/nowhere")).at_rest(1).count == 50  # keeps nothing, but works


def test_servo_and_point_path_lead_a_packing_to_the_same_state(own_store):
    """Two drivers that share no code: the DEM's servo, and strain increments at rest corrected by Broyden's method."""
    store, target = PackingStore(100, PackingOptions(), own_store), (-0.9e5, -1.1e5, 0.0)
    base, loaded = store.at_rest(1), store.under(1, np.array(target))
    law, stress = GrainsLaw([base]), love_weber_stress(base)
    history = drive_point(law, stress, [Leg(target=target, increments=10)], law.initial_state(stress[None]))
    assert history.finished
    contacts = contacts_of(loaded)
    z, fabric = coordination_number(loaded, contacts).all_particles, fabric_anisotropy(contacts)
    assert history.columns["coordination"][-1] == pytest.approx(z, abs=2.0 / 100.0 + 1e-12)
    np.testing.assert_allclose(history.state[0, law.description.columns("fabric_anisotropy")], fabric, atol=5e-3)


def test_stress_that_no_packing_carries_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"mine.toml: initial.stress = \[-20000, -180000, 0\] Pa: a packing of 50"):
        run_point(scene(tmp_path, POINT, "initial.stress=[-20e3, -180e3, 0.0]"), tmp_path / "out", quiet())


def test_point_follows_prescribed_stress(tmp_path):
    record = run_point(scene(tmp_path, POINT), tmp_path / "out", quiet())
    assert record.outcome == "finished" and "decision" not in record.details
    names, rows = files.read_rows(tmp_path / "out" / "history.csv")
    last = {name: float(value) for name, value in zip(names, rows[-1])}
    assert last["strain_yy"] == pytest.approx(-4e-5, rel=1e-12)
    assert last["stress_xx"] == pytest.approx(-100e3, abs=1.0) and abs(last["stress_xy"]) < 1.0
    assert last["q"] / last["p"] > 0.1 and last["motion_steps"] > 1000
    assert "packing" not in names
    again = run_point(load(str(tmp_path / "out" / "scene.toml")), tmp_path / "again", quiet())
    assert again.outcome == "finished"
    assert (tmp_path / "out/history.csv").read_bytes() == (tmp_path / "again/history.csv").read_bytes()


def test_initial_stress_may_vary_from_point_to_point(tmp_path):
    given = ["initial.stress=[-100e3, -110e3, 0.0]", "initial.stress_gradient_y=[1e5, 1e5, 0.0]"]
    given += ["stage.1.increments=1", "initial.balance=true", "stage.1.displacement.0.value=-1e-7"]
    record = run_field(scene(tmp_path, FIELD, *given), tmp_path / "out", quiet())
    assert record.outcome == "finished"
    stress = meshio.read(tmp_path / "out/points_0000.vtu").point_data["stress"]
    assert np.ptp(stress[:, 0]) > 1e3


def test_packing_of_ones_own_is_loaded_to_the_initial_stress(tmp_path, own_store):
    save_sample(tmp_path / "own.npz", PackingStore(50, PackingOptions(), own_store).at_rest(3))
    head, tail = POINT.split("[packing]")[0], POINT.split("particles = 50")[1]
    text = f'{head}packing_file = "own.npz"{tail}'
    record = run_point(scene(tmp_path, text, "initial.stress=[-90e3, -110e3, 5e3]"), tmp_path / "out", quiet())
    assert record.outcome == "finished"
    assert record.scene["law"]["packing_file"] == str(tmp_path / "own.npz")
    with pytest.raises(InputError, match=r"law.packing_file: .*none.npz: no such file"):
        run_point(scene(tmp_path, text, "law.packing_file=none.npz"), tmp_path / "other", quiet())


def test_fields_are_written_without_the_packings(tmp_path):
    record = run_field(scene(tmp_path, FIELD), tmp_path / "out", quiet())
    assert record.outcome == "finished" and record.details["counters"]["cuts"] == 0
    assert "effects" not in record.scene and "audit" not in record.timing
    for series in ("result", "points"):
        data = meshio.read(tmp_path / f"out/{series}_0005.vtu").point_data
        assert "coordination" in data and "sliding_fraction" in data and "packing" not in data
    names, rows = files.read_rows(tmp_path / "out" / "history.csv")
    last = dict(zip(names, rows[-1]))
    assert float(last["coordination"]) < float(rows[0][names.index("coordination")])
    assert float(last["reaction_top_y"]) < -1.1 * 100e3 * 0.05


def test_run_that_is_interrupted_within_a_call_goes_on_to_the_same_bits(tmp_path, monkeypatch):
    loaded = scene(tmp_path, FIELD)
    assert run_field(loaded, tmp_path / "whole", quiet()).outcome == "finished"
    calls, original = [0], GrainsLaw._advance

    def interrupted(law, point, arrays, kind):
        calls[0] += 1
        if calls[0] == 14:
            os.kill(os.getpid(), signal.SIGINT)
        return original(law, point, arrays, kind)

    monkeypatch.setattr(GrainsLaw, "_advance", interrupted)
    with pytest.raises(RunError, match=r"interrupted within a step .--resume goes on"):
        run_field(loaded, tmp_path / "out", quiet())
    assert calls[0] == 14  # no further point was begun
    assert json.loads((tmp_path / "out/run.json").read_text())["outcome"] == "stopped"
    monkeypatch.setattr(GrainsLaw, "_advance", original)
    record = run_field(loaded, tmp_path / "out", quiet(), resume=True)
    assert record.outcome == "finished" and record.details["resumed_after_step"] >= 1
    for name in ("history.csv", "points_0005.vtu"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_failed_point_replays_alone_from_its_packing(tmp_path):
    given = ["stage.1.displacement.0.value=4e-4", "stage.1.increments=2", "solver.smallest_factor=0.5"]
    out = tmp_path / "out"
    record = run_field(scene(tmp_path, FIELD, *given), out, quiet())
    assert record.outcome == "failed" and "failed_point.toml holds it" in record.message
    packing = load_sample(out / "failed_point.npz")
    alone = load(str(out / "failed_point.toml"))
    np.testing.assert_allclose(love_weber_stress(packing), alone.scene.initial.stress, rtol=1e-9)
    replayed = run_point(alone, tmp_path / "replayed", quiet())
    assert replayed.outcome == "failed"
    reason = replayed.message.split(": ", 1)[1]
    assert reason in record.message


def test_grains_have_no_effects_to_decide(tmp_path):
    with pytest.raises(InputError, match="has no effects to decide"):
        show_effects(scene(tmp_path, FIELD), quiet())


def test_tolerance_beyond_what_packings_answer_is_told(tmp_path):
    assert not list(remarks(scene(tmp_path, FIELD).scene))
    said = list(remarks(scene(tmp_path, FIELD, "solver.tolerance=1e-8").scene))
    assert len(said) == 1 and said[0].startswith("warning: solver.tolerance = 1e-08")


@pytest.mark.slow
def test_shipped_scene_gives_its_numbers(tmp_path):
    record = run_field(load("grains_biaxial", ["output.pictures=false"]), tmp_path / "out", quiet())
    assert record.outcome == "finished" and record.details["counters"]["cuts"] == 0
    names, rows = files.read_rows(tmp_path / "out" / "history.csv")
    first, last = ({name: row[place] for place, name in enumerate(names)} for row in (rows[0], rows[-1]))
    assert float(last["q"]) / float(last["p"]) == pytest.approx(0.254, abs=1e-3)
    assert float(first["coordination"]) == pytest.approx(3.889, abs=1e-3)
    assert float(last["coordination"]) == pytest.approx(3.735, abs=2e-3)
    assert float(last["coordination_smallest"]) == pytest.approx(3.64, abs=1e-2)
    assert float(last["reaction_top_y"]) / float(first["reaction_top_y"]) == pytest.approx(1.736, abs=2e-3)


def test_grains_stay_with_the_own_host(tmp_path):
    with pytest.raises(InputError, match="runs on the own host only"):
        run_field(scene(tmp_path, FIELD), tmp_path / "out", quiet(), team=object())
