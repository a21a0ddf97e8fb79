"""Pore fluid in scenes: keys and their messages, decision and audit, files, the shipped undrained biaxial test."""

from __future__ import annotations

import csv
import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from granfabric import read_results
from granfabric.cases.effects.compare import distance, run_field
from granfabric.cases.effects.decision import decide_field, decide_point
from granfabric.cases.field.locking import locks
from granfabric.cases.field.prepare import prepare
from granfabric.cases.records.pore_columns import boiling
from granfabric.cases.scene import build
from granfabric.cases.scene.effects_choice import everything, resolve_effects
from granfabric.cases.scene.reader import load
from granfabric.constitutive.path import Leg, drive
from granfabric.constitutive.pore_fluid import fluid_stiffness
from granfabric.constitutive.stiffness import moduli_per_contact

WATER = "material.fluid_bulk_stiffness=2.2e9"

POINT = """
kind = "point"
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
fluid_bulk_stiffness = 2.2e9
[closure]
force_change = "mean_field"
[initial]
stress = [-100e3, -100e3, 0.0]
[[path]]
control = ["stress", "strain", "stress"]
target = [-100e3, -6e-5, 0.0]
increments = 10
[output]
pictures = false
"""

FIELD = """
kind = "field"
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
fluid_bulk_stiffness = 2.2e9
[closure]
force_change = "mean_field"
[mesh]
rectangle = { width = 1.0, height = 2.0, nx = 2, ny = 3 }
element = "P2"
[initial]
stress = [-100e3, -100e3, 0.0]
[[stage]]
name = "initial"
increments = 1
fixed = [{ boundary = "bottom" }, { boundary = "top" }]
pressure = [{ boundary = "left", value = 100e3 }, { boundary = "right", value = 100e3 }]
[[stage]]
name = "press"
increments = 4
displacement = [{ boundary = "top", component = "y", value = -5e-5 }]
[output]
pictures = false
"""


def write(folder: Path, text: str, *replaced: tuple[str, str]) -> Path:
    for old, new in replaced:
        assert old in text
        text = text.replace(old, new)
    file = folder / "scene.toml"
    file.write_text(text)
    return file


def history(folder: Path) -> dict[str, np.ndarray]:
    rows = list(csv.reader((folder / "history.csv").open()))
    table = zip(*rows[1:], strict=True)
    return {
        name: np.array(values) if name == "stage" else np.array(values, dtype=float)
        for name, values in zip(rows[0], table, strict=True)
    }


@pytest.fixture(scope="module")
def undrained():
    """The shipped scene on one cell across, and its steps."""
    loaded = load("undrained_biaxial", ["mesh.rectangle.nx=1", "mesh.rectangle.ny=2"])
    prepared = prepare(loaded)
    from granfabric.fem.equilibrium.stepping import solve

    steps = []
    assert solve(prepared.problem, prepared.control, on_step=steps.append).finished
    return loaded, prepared, steps


def test_shipped_scene_is_the_point_path_and_skempton(undrained) -> None:
    """A drained and two undrained legs of one point, driven alone; and B and A in closed form."""
    loaded, prepared, steps = undrained
    law = build.law(loaded, resolve_effects(loaded.scene))
    shear = prepared.problem.stages[-1]
    assert shear.name == "shear"
    strain = steps[-1].strain[0, 1]
    legs = [
        Leg(target=(-250e3, -250e3, 0.0), increments=5, drained=True),
        Leg(target=(-300e3, -300e3, 0.0), increments=5),
        Leg(("stress", "strain", "stress"), (-300e3, strain, 0.0), 20),
    ]
    alone = drive(law, (-100e3, -100e3, 0.0), legs, pore_pressure=100e3)
    assert alone.finished
    columns = alone.columns
    u = np.array([step.state[:, -1] for step in steps])
    assert np.ptp(u, axis=1).max() < 1e-3
    assert u[:, 0] == pytest.approx(columns["pore_pressure"][[0, *range(1, 31)]], rel=1e-6)
    assert [step.stress[0, 1] for step in steps] == pytest.approx(columns["stress_yy"], rel=1e-6)
    # Skempton's B of an isotropic packing, at its state after consolidation
    material = law.materials[0]
    z = columns["coordination"][5]
    bulk = moduli_per_contact(1e9, 0.8448, 1.0, material.bulk_reduction, material.shear_reduction)[0] * z
    b = 1.0 / (1.0 + bulk / fluid_stiffness(material))
    assert (columns["pore_pressure"][10] - 100e3) / 50e3 == pytest.approx(b, rel=1e-4)
    # A begins at 1/2, that of an isotropic elastic skeleton in the plane, and falls as the fabric turns anisotropic
    rise = columns["pore_pressure"][10:] - columns["pore_pressure"][10]
    a = rise[1:] / (b * 2.0 * columns["q"][11:])
    assert a[0] == pytest.approx(0.5, abs=2e-4)
    assert np.all(np.diff(a) < 0.0)
    # the numbers of the text
    assert columns["pore_pressure"][-1] == pytest.approx(U_END, abs=50.0)
    assert a[-1] == pytest.approx(A_END, abs=5e-4)


def test_shipped_scene_tells_its_numbers() -> None:
    text = load("undrained_biaxial").scene.description
    assert f"{U_END / 1e3:.1f} kPa" in text
    assert f"A = {A_END:.3f}" in text


def test_off_it_costs_nothing(tmp_path: Path) -> None:
    """Without a fluid, or with the effect off, the law has no column, and the same bits."""
    laws = []
    for given in ([], [WATER, "effects.pore_fluid=false"]):
        loaded = load("biaxial_smooth", given)
        laws.append(build.law(loaded, resolve_effects(loaded.scene)))
    stress = np.array([[-1e5, -1.1e5, 2e3]])
    ends = []
    for law in laws:
        assert not law.description.has_state("pore_pressure")
        state = law.initial_state(stress)
        end, state_end, tangent = np.empty_like(stress), np.empty_like(state), np.empty((1, 3, 3))
        law.update(np.array([[1e-6, -3e-6, 1e-6]]), stress, state, end, state_end, tangent)
        ends.append((end.tobytes(), state_end.tobytes(), tangent.tobytes()))
    assert ends[0] == ends[1]


def test_auto_is_on_only_with_a_fluid_that_matters(tmp_path: Path) -> None:
    assert not everything(load("biaxial_smooth").scene).has("pore_fluid")
    file = write(tmp_path, POINT)
    decision = decide_point(load(str(file)))
    assert decision.chosen.has("pore_fluid")
    entry = next(entry for entry in decision.assessed if entry.name == "pore_fluid")
    assert entry.error > 0.1
    assert entry.columns == 1
    # a fluid as soft as air changes nothing that could be seen
    decision = decide_point(load(str(file), ["material.fluid_bulk_stiffness=1e3"]))
    assert not decision.chosen.has("pore_fluid")
    assert [left.name for left in decision.left_out()].count("pore_fluid") == 1


def test_estimate_of_a_field_is_about_right(tmp_path: Path) -> None:
    """What leaving the fluid out would change, as estimated before the run and as two runs have it."""
    loaded = load(str(write(tmp_path, FIELD)))
    prepared = prepare(loaded)
    decision = decide_field(loaded, prepared)
    entry = next(entry for entry in decision.assessed if entry.name == "pore_fluid")
    assert entry.on
    full = decision.chosen
    weights = prepared.problem.space.weights / prepared.problem.space.weights.sum()
    on, off = (run_field(loaded, prepared, chosen) for chosen in (full, full.with_effect("pore_fluid", False)))
    true = distance(on, off, weights).error
    assert 0.3 < entry.error / true < 3.0


@pytest.mark.parametrize(
    ("table", "scene", "words"),
    [
        ("point", ["effects.pore_fluid=true", "material.fluid_bulk_stiffness=0.0"], "fluid_bulk_stiffness [Pa]"),
        ("point", ["initial.pore_pressure=1e4", "material.fluid_bulk_stiffness=0.0"], "initial: a pore pressure"),
        ("point", ["initial.pore_pressure=1e4", "effects.pore_fluid=false"], "leaves nothing that carries"),
        ("point", ["effects.pore_fluid=1"], "effects.pore_fluid"),
        ("point", ["material.fluid_bulk_stiffness=-1.0"], "material.fluid_bulk_stiffness"),
        ("point", ["material.fluid_porosity=1.5"], "material.fluid_porosity"),
        ("point", ["material.solid_fraction=1.0"], "needs pores"),
        ("point", ["material.porosity=0.3"], "solid_fraction"),
        ("point", ["path.0.drained=1"], "path 1: drained"),
        ("point", ["initial.water_level=1.0"], "initial.water_level"),
        ("field", ["stage.press.drained='yes'"], "drained"),
        ("field", ["initial.water_level=1.0", "initial.pore_pressure=1.0"], "leave out pore_pressure"),
        ("field", ["initial.water_unit_weight=0.0", "initial.water_level=1.0"], "initial.water_unit_weight"),
        ("field", ["initial.pore_pressure_gradient=[1.0]"], "initial.pore_pressure_gradient"),
        ("field", ["initial.pore_presure=1.0"], "pore_pressure"),
    ],
)
def test_bad_input(granfabric: Callable, tmp_path: Path, table: str, scene: list[str], words: str) -> None:
    file = write(tmp_path, {"point": POINT, "field": FIELD}[table])
    sets = [part for entry in scene for part in ("--set", entry)]
    command = {"point": "point", "field": "run"}[table]
    result = granfabric(command, file, "-o", tmp_path / "out", *sets)
    assert result.code == 2, result.out
    assert words in result.err
    assert not (tmp_path / "out").exists()


def test_point_run(granfabric: Callable, tmp_path: Path) -> None:
    file = write(tmp_path, POINT, ("[[path]]", "pore_pressure = 20e3\n[[path]]"), ("-100e3, -6e-5", "-120e3, -6e-5"))
    result = granfabric("point", file, "-o", tmp_path / "out")
    assert result.code == 0, result.err
    columns = history(tmp_path / "out")
    u = columns["pore_pressure"]
    assert u[0] == 20e3
    assert columns["stress_xx"] == pytest.approx(np.full(11, -120e3))
    assert columns["effective_p"] == pytest.approx(columns["p"] - u)
    assert columns["effective_stress_xx"] == pytest.approx(columns["stress_xx"] + u)
    volumetric = columns["strain_xx"] + columns["strain_yy"]
    assert u - 20e3 == pytest.approx(-2.2e9 / 0.154 * volumetric, rel=1e-6, abs=1e-3)
    assert "pore pressure 20 to" in result.out
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert record["scene"]["effects"]["pore_fluid"] is True
    assert not any(entry["name"] == "pore_fluid" for entry in record["audit"])


def test_audit_tells_what_a_drained_run_has_left_out(granfabric: Callable, tmp_path: Path) -> None:
    """A fluid that is given and switched off: what it would have changed, and how to turn it on."""
    for text, command in ((POINT, "point"), (FIELD, "run")):
        out = tmp_path / command
        result = granfabric(command, write(tmp_path, text), "-o", out, "--set", "effects.pore_fluid=false")
        assert result.code == 0, result.err
        record = json.loads((out / "run.json").read_text())
        assert "effects.pore_fluid=true" in record["upgrade"]
        assert "pore_fluid is off and would have changed" in result.out
        assert "pore_pressure" not in history(out)
    # where all stages drain nothing is missing
    parts = [(f"increments = {number}", f"increments = {number}\ndrained = true") for number in (1, 4)]
    file = write(tmp_path, FIELD, *parts)
    result = granfabric("run", file, "-o", tmp_path / "run", "--set", "effects.pore_fluid=false")
    assert result.code == 0, result.err
    assert "effects.pore_fluid=true" not in json.loads((tmp_path / "run" / "run.json").read_text())["upgrade"]


def test_field_files(granfabric: Callable, tmp_path: Path) -> None:
    result = granfabric("run", write(tmp_path, FIELD), "-o", tmp_path / "out")
    assert result.code == 0, result.err
    columns = history(tmp_path / "out")
    assert columns["effective_p"] == pytest.approx(columns["p"] - columns["pore_pressure"])
    assert columns["pore_pressure_smallest"][-1] < columns["pore_pressure"][-1] < columns["pore_pressure_largest"][-1]
    results = read_results(tmp_path / "out").points
    total, effective = results.field("stress"), results.field("effective_stress")
    u = results.field("pore_pressure")
    assert effective - total == pytest.approx(np.column_stack([u, u, 0 * u]), abs=1e-3)
    ratio = np.hypot(0.5 * (effective[:, 0] - effective[:, 1]), effective[:, 2]) / -effective[:, :2].mean(axis=1)
    assert columns["stress_ratio_largest"][-1] == pytest.approx(ratio.max(), rel=1e-5)
    assert "effective_stress" in read_results(tmp_path / "out").names()


def test_resumed_run_has_the_same_bits(granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stopped within the undrained stage, and again at a drained one that follows."""
    from granfabric.cases.records.field_recorder import FieldRecorder

    move = 'displacement = [{ boundary = "top", component = "y", value = -8e-5 }]'
    more = f'[[stage]]\nname = "drain"\ndrained = true\nincrements = 3\n{move}\n[output]'
    file = write(tmp_path, FIELD, ("[output]", more))
    assert granfabric("run", file, "-o", tmp_path / "whole").code == 0
    save = FieldRecorder.save
    for place in (3, 6):

        def broken(self, checkpoint, place=place):
            save(self, checkpoint)
            if checkpoint.result.step == place:
                raise KeyboardInterrupt

        out = tmp_path / f"part{place}"
        monkeypatch.setattr(FieldRecorder, "save", broken)
        granfabric("run", file, "-o", out)
        monkeypatch.setattr(FieldRecorder, "save", save)
        result = granfabric("run", file, "-o", out, "--resume")
        assert result.code == 0, result.err
        assert (out / "history.csv").read_bytes() == (tmp_path / "whole" / "history.csv").read_bytes()
    u = history(tmp_path / "whole")["pore_pressure"]
    assert u[5] > 1e3
    assert np.array_equal(u[5:], np.full(4, u[5]))


def test_water_level_and_gradient(tmp_path: Path) -> None:
    """Hydrostatic below the water table, nothing above it; and linear in place about the reference point."""
    file = write(tmp_path, FIELD)
    problem = prepare(load(str(file), ["initial.water_level=1.2"])).problem
    u = problem.initial_state[:, -1]
    y = problem.space.points[:, 1]
    assert u == pytest.approx(9810.0 * np.maximum(1.2 - y, 0.0))
    assert problem.initial_stress[:, 1] == pytest.approx(-100e3 - u)
    linear = ["pore_pressure=2e3", "pore_pressure_gradient=[1e3, -5e3]", "reference_point=[0.0, 1.0]"]
    problem = prepare(load(str(file), [f"initial.{text}" for text in linear])).problem
    x, y = problem.space.points.T
    assert problem.initial_state[:, -1] == pytest.approx(2e3 + 1e3 * x - 5e3 * (y - 1.0))


def test_random_state_keeps_the_pore_pressure(tmp_path: Path) -> None:
    table = "[random_state]\nseed = 1\nstandard_deviation = 0.05\ncorrelation_length = [0.5, 0.5]\n[mesh]"
    file = write(tmp_path, FIELD, ("[mesh]", table))
    problem = prepare(load(str(file), ["initial.pore_pressure=3e4"])).problem
    assert np.array_equal(problem.initial_state[:, -1], np.full(problem.space.npoints, 3e4))
    assert np.ptp(problem.initial_state[:, 0]) > 0.01


def test_a_failed_point_is_replayed_from_its_effective_stress(granfabric: Callable, tmp_path: Path) -> None:
    """A point that may not take the substeps which its tolerance asks for fails alone as it does in the field."""
    numerics = "[integration]\ntolerance = 1e-9\nmaximum_substeps = 4\n[solver]\nsmallest_factor = 0.3\n[mesh]"
    parts = [("[mesh]", numerics), ("0.0]\n", "0.0]\npore_pressure = 5e4\n"), ("100e3 }", "150e3 }")]
    file = write(tmp_path, FIELD, *parts, ("value = -5e-5", "value = -5e-4"))
    result = granfabric("run", file, "-o", tmp_path / "out", "--set", "effects.tolerance=1e-8")
    assert result.code == 1, result.out
    failed = tmp_path / "out" / "failed_point.toml"
    scene = tomllib.loads(failed.read_text())
    assert "pore_pressure" in scene["initial"]["state"]
    again = granfabric("point", failed, "-o", tmp_path / "again")
    assert again.code == 1
    told = json.loads((tmp_path / "again" / "run.json").read_text())["message"]
    assert told.partition(": ")[2] in json.loads((tmp_path / "out" / "run.json").read_text())["message"]


def test_warnings(granfabric: Callable, tmp_path: Path) -> None:
    """Linear elements lock, water boils."""
    scene = load(str(write(tmp_path, FIELD)), ["effects.pore_fluid=true"]).scene
    assert locks(scene) == ""
    for element, better in (("P1", "P2"), ("Q1", "Q2")):
        mesh = scene.mesh.model_copy(update={"element": element})
        assert f"mesh.element = '{better}'" in locks(scene.model_copy(update={"mesh": mesh}))
    result = granfabric("run", write(tmp_path, FIELD), "-o", tmp_path / "out", "--set", "mesh.element=P1")
    assert "P1 elements lock" in result.out
    assert boiling([0.0, -99e3], [0, 1]) == ""
    assert "from step 7 on" in boiling([0.0, -101e3, -150e3], [3, 7, 8])
    assert "-150 kPa" in boiling([0.0, -101e3, -150e3], [3, 7, 8])


U_END, A_END = 184.1e3, 0.497
