"""Effects on "auto": what decides, that what is left out is as small as it says, contradictions."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from granfabric.cases.effects import resolve as effects_resolve
from granfabric.cases.effects.decision import decide_field, decide_point
from granfabric.cases.effects.numbers import numbers, quantile
from granfabric.cases.effects.probe import field_paths
from granfabric.cases.effects.sample import sample
from granfabric.cases.effects.trial import differences, drive_point, largest
from granfabric.cases.field.prepare import prepare
from granfabric.cases.scene import effects_choice
from granfabric.cases.scene.point_path import legs_of
from granfabric.cases.scene.reader import load
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Material

HEAD = """
title = "A specimen"
kind = "field"
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
bulk_reduction = 0.88
shear_reduction = 0.69
[mesh]
rectangle = { width = 0.05, height = 0.1, nx = 3, ny = 6 }
[initial]
stress = [-100e3, -100e3, 0.0]
[output]
pictures = false
"""
INITIAL = """
[[stage]]
name = "initial"
increments = 1
fixed = [{ boundary = "bottom", components = ["y"] }, { boundary = "top", components = ["y"] }]
fixed_point = [{ point = [0.0, 0.0] }]
pressure = [{ boundary = "left", value = 100e3 }, { boundary = "right", value = 100e3 }]
"""
PRESS = """
[[stage]]
name = "press"
increments = 10
displacement = [{ boundary = "top", component = "y", value = -9e-6 }]
"""
BACK = """
[[stage]]
name = "back"
increments = 10
displacement = [{ boundary = "top", component = "y", value = 0.0 }]
"""
SIDEWAYS = """
[[stage]]
name = "sideways"
increments = 10
fixed = [{ boundary = "bottom" }]
displacement = [{ boundary = "top", component = "x", value = 2e-6 }, { boundary = "top", component = "y", value = 0.0 }]
"""


def field(tmp_path: Path, text: str, *settings: str):
    file = tmp_path / "scene.toml"
    file.write_text(HEAD + INITIAL + text)
    return load(str(file), settings)


def decided(tmp_path: Path, text: str, *settings: str):
    loaded = field(tmp_path, text, *settings)
    return decide_field(loaded, prepare(loaded))


def by_name(decision):
    return {entry.name: entry for entry in decision.assessed}


def test_the_probe_of_a_uniform_specimen_is_uniaxial_strain_of_the_initial_stiffness(tmp_path):
    loaded = field(tmp_path, PRESS)
    prepared = prepare(loaded)
    paths = field_paths(prepared.problem, prepared.control)
    m, phi, z, kn = loaded.scene.material, 0.846, 4.06, 1e9
    k = z * phi * kn / (2 * np.pi) * m.bulk_reduction
    g = z * phi * kn / (2 * np.pi) * m.shear_reduction  # kt = kn
    # lateral stress kept: (K+G) e_xx + (K-G) e_yy = 0, so s_yy = 4 K G/(K+G) e_yy
    expected = 4 * k * g / (k + g) * (-9e-6 / 0.1)
    np.testing.assert_allclose(paths.stress[-1, :, 1] - paths.stress[0, :, 1], expected, rtol=1e-9)
    np.testing.assert_allclose(paths.stress[-1, :, 0], -100e3, rtol=1e-9)
    facts = numbers(paths, [Material(**m.model_dump())], Closure())
    p, q = 100e3 - expected / 2, -expected / 2
    assert facts.stress_ratio == pytest.approx(q / p, rel=1e-9)
    assert facts.pressure_rise == pytest.approx(np.log(p / 100e3), rel=1e-9)
    assert facts.off_axis < 1e-9 and facts.turn_degrees < 1e-6 and facts.reversal < 1e-9
    back = field(tmp_path, PRESS + BACK)
    again = prepare(back)
    facts = numbers(field_paths(again.problem, again.control), [Material(**m.model_dump())], Closure())
    assert facts.reversal == pytest.approx(max(q / p, np.log(p / 100e3)), rel=1e-6)


def test_what_cannot_act_is_left_out_without_error_and_without_columns(tmp_path):
    found = by_name(decided(tmp_path, PRESS))
    rotation = found["principal_rotation"]
    assert not rotation.on and rotation.error < 1e-12 and rotation.columns > 0
    gain = found["contact_gain"]
    # at kn/p = 1e4 next to no gap is narrow enough
    assert not gain.on and 0 < gain.error < 1e-3
    assert found["contact_loss"].on


def test_axes_that_turn_are_followed(tmp_path):
    decision = decided(tmp_path, SIDEWAYS)
    assert by_name(decision)["principal_rotation"].on and decision.chosen.effects.principal_rotation
    assert decision.numbers.off_axis > 0.03


def test_memory_is_for_unloading(tmp_path):
    gentle = PRESS.replace("-9e-6", "-1.5e-6")
    setting = "closure.force_change=auto"
    assert decided(tmp_path, gentle, setting, "effects.tolerance=0.03").chosen.force_change == "mean_field"
    assert (
        decided(tmp_path, PRESS + BACK, setting, "effects.tolerance=0.03").chosen.force_change == "shifted_distribution"
    )


def test_isostatic_shear_stiffness_needs_the_feedback(tmp_path):
    soft = decided(tmp_path, SIDEWAYS, "closure.shear_stiffness=isostatic")
    assert soft.chosen.effects.stiffness_feedback
    few = decided(tmp_path, PRESS.replace("-9e-6", "-1e-7"), "closure.shear_stiffness=isostatic")
    assert not few.chosen.effects.stiffness_feedback and few.chosen.effects.linear_response


def test_the_tolerance_comes_from_the_scene_or_its_accuracy(tmp_path):
    assert effects_choice.tolerance(field(tmp_path, PRESS).scene) == 1e-2
    assert effects_choice.tolerance(field(tmp_path, PRESS, "accuracy=1e-4").scene) == 1e-4
    assert effects_choice.tolerance(field(tmp_path, PRESS, "accuracy=standard").scene) == 1e-5
    assert effects_choice.tolerance(field(tmp_path, PRESS, "accuracy=1e-4", "effects.tolerance=0.1").scene) == 0.1
    strict = decided(tmp_path, PRESS, "effects.tolerance=1e-7")
    assert strict.chosen.effects.contact_gain and strict.chosen.effects.stiffness_feedback
    assert not strict.chosen.effects.principal_rotation


def test_what_the_scene_says_is_kept(tmp_path):
    said = ("effects.contact_gain=true", "effects.contact_loss=false", "closure.force_change=mean_field")
    decision = decided(tmp_path, PRESS, *said)
    assert by_name(decision)["force_change"].asked is False
    assert decision.chosen.effects.contact_gain and not decision.chosen.effects.contact_loss
    loss = by_name(decision)["contact_loss"]
    assert loss.asked is False and loss.error > 1e-2
    left = [entry.name for entry in decision.left_out()]
    # sliding has no parameters here, and nothing spreads without a memory: neither was left out
    assert "principal_rotation" in left and not {"contact_loss", "sliding", "irreversible_spread"} & set(left)


@pytest.mark.parametrize("scene", ["p_constant", "lateral_constant", "axes_rotation", "unload_reload", "simple_shear"])
@pytest.mark.parametrize("tolerance", ["3e-2", "1e-3"])
def test_a_point_with_what_was_decided_stays_within_the_tolerance(scene, tolerance):
    loaded = load(scene, [f"effects.tolerance={tolerance}"])
    decision = decide_point(loaded)
    full = effects_choice.everything(loaded.scene)
    material = Material(**loaded.scene.material.model_dump())
    start, legs = loaded.scene.initial.stress, legs_of(loaded.scene)
    outcomes = [
        drive_point(ContactLaw([material], Closure(), set_.effects), start, legs) for set_ in (full, decision.chosen)
    ]
    error = float(largest(differences(*outcomes, np.ones(1))).max())
    assert error <= float(tolerance)
    # and what was found beforehand is that error
    assert error == pytest.approx(decision.error, rel=0.05, abs=2e-5)


def test_contradictions_are_refused(granfabric: Callable, tmp_path: Path):
    if "irreversible_spread" in Effects.names():
        result = granfabric("point", "p_constant", "-o", tmp_path / "a", "--set", "effects.irreversible_spread=true")
        assert result.code == 2 and "shifted_distribution" in result.err
    asked = ("--set", "effects.tangential_memory=true")
    result = granfabric("point", "p_constant", "-o", tmp_path / "a", *asked)
    assert result.code == 2 and "does not tell when contacts slip" in result.err
    for number in ("slip", "tangential_force_ratio"):
        more = ("--set", "material_file=dense_disks", "--set", f"closure.{number}=0")
        result = granfabric("point", "p_constant", "-o", tmp_path / "a", *asked, *more)
        assert result.code == 2 and "needs contacts that slip" in result.err
    more = ("--set", "closure.force_change=shifted_distribution", "--set", "closure.tangential=self_consistent")
    result = granfabric("point", "p_constant", "-o", tmp_path / "a", *asked, *more)
    assert result.code == 2 and "needs contacts that slip" in result.err
    if "sliding" in Effects.names():
        result = granfabric("point", "p_constant", "-o", tmp_path / "b", "--set", "effects.sliding=true")
        assert result.code == 2 and "peak_stress_ratio" in result.err
    result = granfabric("effects", "dem_biaxial")
    assert result.code == 2 and "no effects to decide" in result.err
    result = granfabric("effects", "p_constant", "--set", "effects.tolerance=0.0")
    assert result.code == 2 and "effects.tolerance" in result.err
    assert not (tmp_path / "a").exists() and not (tmp_path / "b").exists()


def test_memory_of_tangential_forces_is_for_stresses_that_turn_back(granfabric: Callable, tmp_path: Path):
    """Nothing to remember on a first loading; on a loop it is needed, and left out by hand the audit says so."""
    disks, tolerance = "material_file=dense_disks", "effects.tolerance=1e-2"
    first = decide_point(load("p_constant", [disks, tolerance]))
    assert by_name(first)["tangential_memory"].error < 1e-9
    assert "tangential_memory" in [entry.name for entry in first.left_out()]
    loop = decide_point(load("unload_reload", [disks, tolerance, "closure.force_change=shifted_distribution"]))
    assert loop.chosen.has("tangential_memory") and by_name(loop)["tangential_memory"].error > 5e-3
    assert loop.numbers is not None and loop.numbers.turning_back == pytest.approx(0.2, abs=1e-9)
    off = ("--set", "effects.tangential_memory=false", "--set", "effects.tolerance=5e-3")
    more = ("--set", disks, "--set", "closure.force_change=shifted_distribution")
    result = granfabric("point", "unload_reload", "-o", tmp_path / "a", *more, *off)
    assert result.code == 0 and "tangential_memory is off and would have changed" in result.out + result.err


def test_the_command_prints_a_table_and_the_run_three_lines_and_a_record(granfabric: Callable, tmp_path: Path):
    loaded = field(tmp_path, PRESS)
    result = granfabric("effects", loaded.file)
    assert result.code == 0
    for name in (*Effects.names(), "force_change", "several_materials", "body_force"):
        assert name in result.out
    run = granfabric("run", loaded.file, "-o", tmp_path / "out")
    assert run.code == 0
    begun = [line.split(":")[0] for line in run.out.splitlines()]
    first = begun.index("effects")
    assert begun[first : first + 3] == ["effects", "left out (estimated error of each)", "elastic probe"]
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    entries = {entry["name"]: entry for entry in record["decision"]["effects"]}
    assert entries["contact_gain"]["on"] is False and entries["contact_gain"]["asked"] == "auto"
    assert record["scene"]["effects"]["contact_gain"] is False
    # the scene as written runs without a probe, to the same numbers
    again = granfabric("run", tmp_path / "out" / "scene.toml", "-o", tmp_path / "again")
    assert again.code == 0 and "no probe" in again.out
    histories = [(tmp_path / name / "history.csv").read_text() for name in ("out", "again")]
    assert histories[0] == histories[1]


def test_a_scene_that_the_probe_cannot_follow_keeps_everything(tmp_path):
    # lifted by far more than the pressure can take
    decision = decided(tmp_path, PRESS.replace("-9e-6", "9e-5"))
    assert "nothing is left out" in decision.note and decision.error == 0.0
    assert decision.chosen == effects_choice.everything(field(tmp_path, PRESS).scene)
    assert decision.numbers.low_pressure_fraction > 0.9


def test_the_sample_speaks_for_the_area(tmp_path):
    loaded = field(tmp_path, SIDEWAYS, "mesh.rectangle.nx=9", "mesh.rectangle.ny=18")
    prepared = prepare(loaded)
    paths = field_paths(prepared.problem, prepared.control)
    points, fractions = sample(paths)
    assert len(points) < len(paths.weights) and len(np.unique(points)) == len(points)
    assert fractions.sum() == pytest.approx(1.0)
    for power in ((1, 0), (0, 1), (2, 0), (1, 1)):
        values = np.prod((paths.places / [0.05, 0.1]) ** power, axis=1)
        assert fractions @ values[points] == pytest.approx(paths.weights @ values, abs=0.03)
    ratio = np.hypot(paths.stress[-1, :, 0] - paths.stress[-1, :, 1], 2 * paths.stress[-1, :, 2])
    pressure = -(paths.stress[-1, :, 0] + paths.stress[-1, :, 1])
    assert int(np.argmax(ratio / pressure)) in points


def test_quantiles_are_of_the_area():
    values, weights = np.array([5.0, 1.0, 3.0]), np.array([0.005, 0.5, 0.495])
    assert quantile(values, weights) == 3.0
    assert quantile(values, weights, 1.0) == 5.0
    assert quantile(values, weights, 0.4) == 1.0
    assert quantile(np.array([]), np.array([])) == 0.0


def test_the_problem_of_the_decided_scene_starts_from_the_same_state(tmp_path):
    loaded = field(tmp_path, PRESS)
    prepared = prepare(loaded)
    _, made, decision = effects_resolve.resolve_field(loaded, prepared)
    assert made.problem.law.effects == decision.chosen.effects
    ours, theirs = made.problem, prepared.problem
    column = ours.law.description.columns("coordination")
    np.testing.assert_array_equal(
        ours.initial_state[:, column], theirs.initial_state[:, theirs.law.description.columns("coordination")]
    )
    assert ours.law.description.nstate < theirs.law.description.nstate
