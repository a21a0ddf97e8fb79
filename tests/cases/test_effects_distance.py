"""How far runs with different effects lie apart: made-up outcomes of known distance, through both cost studies."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from granfabric.cases.cost import decisions, effects
from granfabric.cases.cost.study import Effort
from granfabric.cases.effects.compare import Outcome, distance, run_field, run_point
from granfabric.cases.effects.decision import Decision
from granfabric.cases.effects.probe import Paths
from granfabric.cases.effects.trial import QUANTITIES, Trial, differences, follow, largest
from granfabric.cases.field.prepare import prepare
from granfabric.cases.scene.effects_choice import EffectSet
from granfabric.cases.scene.reader import load
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Material

POINTS, NODES = 4, 3
P = 2e5


def trial(**changed: Any) -> Trial:
    """Isotropic stress, strain that grows with the node, z = 4, no fabric; parts replaced."""
    stress = np.tile([-P, -P, 0.0], (NODES, POINTS, 1))
    strain = np.tile(np.arange(NODES)[:, None, None] * np.array([1e-5, -1e-5, 0.0]), (1, POINTS, 1))
    made = Trial(
        stress, strain, np.full((NODES, POINTS), 4.0), np.zeros((NODES, POINTS, 2)), np.full(POINTS, NODES - 1), 7
    )
    return replace(made, **changed)


FRACTIONS = np.full(POINTS, 1 / POINTS)


def test_differences_of_each_quantity() -> None:
    """Stress over p as a tensor's norm, strain over that of the scene, z relative, a_c absolute; largest of the way."""
    plain = trial()
    assert all((values == 0.0).all() for values in differences(plain, plain, FRACTIONS).values())
    stress = plain.stress.copy()
    stress[1, 0], stress[2, 1] = (-1.1 * P, -P, 0.0), (-P, -P, 0.05 * P)
    found = differences(plain, trial(stress=stress), FRACTIONS)
    assert found["stress"] == pytest.approx([0.1, np.sqrt(2) * 0.05, 0, 0]) and found["strain"].max() == 0.0
    # where strain was prescribed, what that stress would have been as strain: C^-1 of it, over the scene's largest
    stiffness = np.tile(np.diag([2e9, 1e9, 1e9]), (POINTS, 1, 1))
    found = differences(plain, trial(stress=stress), FRACTIONS, stiffness)
    size = np.sqrt(2) * 2e-5
    assert found["strain"] == pytest.approx([0.1 * P / 2e9 / size, np.sqrt(0.5) * 0.05 * P / 1e9 / size, 0, 0])
    strain = plain.strain.copy()
    strain[2, 2] += [3e-6, 0.0, 0.0]
    strain[1, 3] += [0.0, 0.0, 4e-6]
    found = differences(plain, trial(strain=strain), FRACTIONS)
    assert found["strain"] == pytest.approx([0, 0, 3e-6 / size, np.sqrt(0.5) * 4e-6 / size])
    z = plain.coordination.copy()
    z[1, 1] = 3.6
    assert differences(plain, trial(coordination=z), FRACTIONS)["coordination"] == pytest.approx([0, 0.1, 0, 0])
    fabric = plain.fabric.copy()
    fabric[2, 3] = [0.03, -0.04]
    found = differences(plain, trial(fabric=fabric), FRACTIONS)
    assert found["fabric"] == pytest.approx([0, 0, 0, 0.05])
    assert set(found) == set(QUANTITIES) and largest(found) == pytest.approx([0, 0, 0, 0.05])


def test_points_that_could_not_be_followed() -> None:
    """Short of the reference: without bound. Where the reference itself ended, what comes after does not count."""
    z = np.full((NODES, POINTS), 4.0)
    z[2, 0] = 3.0
    reached = np.array([1, 2, 2, 2])
    found = differences(trial(), trial(reached=reached), FRACTIONS)
    assert np.isinf(found["stress"]).tolist() == [True, False, False, False]
    found = differences(trial(reached=reached), trial(coordination=z), FRACTIONS)
    assert found["coordination"].max() == 0.0


def outcome(made: Trial, keys: list[tuple[str, float]] | None = None, seconds: float = 1.0, **more: Any) -> Outcome:
    chosen = keys or [("press", 0.5), ("press", 1.0)]
    counters = {"law_calls": 11, "factorisations": 3, "linear_solves": 5}
    return Outcome(made, chosen, seconds, {**counters, **more.pop("counters", {})}, False, True)


def test_distance_is_exceeded_on_less_than_a_hundredth_of_the_area() -> None:
    z = np.full((NODES, POINTS), 4.0)
    z[1] = [4.0, 4.04, 4.08, 4.2]
    weights = np.array([0.5, 0.3, 0.195, 0.005])
    found = distance(outcome(trial()), outcome(trial(coordination=z)), weights)
    assert (found.error, found.largest, found.quantity) == (pytest.approx(0.02), pytest.approx(0.05), "coordination")
    # the quantity with the largest error is named
    fabric = np.full((NODES, POINTS, 2), [0.03, 0.04])
    found = distance(outcome(trial()), outcome(trial(coordination=z, fabric=fabric)), weights)
    assert (found.error, found.quantity) == (pytest.approx(0.05), "fabric")


def test_distance_is_over_the_steps_that_both_have() -> None:
    z = np.full((NODES, POINTS), 4.0)
    z[1], z[2] = 4.4, 4.04
    other = outcome(trial(coordination=z), [("press", 0.25), ("press", 1.0)])
    assert distance(outcome(trial()), other, FRACTIONS).error == pytest.approx(0.01)
    same = outcome(trial(coordination=z), [("press", 0.5), ("press", 1.0)])
    assert distance(outcome(trial()), same, FRACTIONS).error == pytest.approx(0.1)


def far(fraction: float, seconds: float, **more: Any) -> Outcome:
    """An outcome whose z lies that far from the plain one."""
    return outcome(trial(coordination=np.full((NODES, POINTS), 4.0 * (1 + fraction))), seconds=seconds, **more)


def one_point(made: Outcome) -> Outcome:
    whole = made.trial
    first = Trial(
        whole.stress[:, :1], whole.strain[:, :1], whole.coordination[:, :1], whole.fabric[:, :1], whole.reached[:1], 7
    )
    return replace(made, trial=first)


def test_the_study_of_effects_compares_each_set_with_everything(monkeypatch: pytest.MonkeyPatch) -> None:
    space = SimpleNamespace(weights=np.ones(POINTS))
    prepared = SimpleNamespace(problem=SimpleNamespace(space=space))
    scene = SimpleNamespace(scene=None)
    sets = {"everything": "all", "without a": "a", "no effect": "none"}
    answers = {"all": far(0.0, 2.0), "a": far(0.03, 1.0, counters={"law_calls": 7}), "none": far(0.3, 0.5)}
    monkeypatch.setattr(effects, "tests", lambda across: {"biaxial": (scene, prepared)})
    monkeypatch.setattr(effects, "effect_sets", lambda given: sets)
    monkeypatch.setattr(effects, "run_field", lambda loaded, made, chosen: answers[chosen])
    table = {row["setting"]: row for row in effects.rows(Effort(quick=True, rounds=1))}
    assert list(table) == list(sets)
    assert [row["error"] for row in table.values()] == pytest.approx([0.0, 0.03, 0.3])
    assert [row["error_at_worst_point"] for row in table.values()] == pytest.approx([0.0, 0.03, 0.3])
    assert [row["seconds"] for row in table.values()] == [2.0, 1.0, 0.5]
    assert [row["relative_time"] for row in table.values()] == [1.0, 0.5, 0.25]
    assert [row["count"] for row in table.values()] == [11, 7, 11]
    row = table["without a"]
    assert (row["quantity"], row["factorisations"], row["linear_solves"], row["uncoupled"]) == ("coordination", 3, 5, 0)
    # stress and state twice, strain and its increment, two tangents: 8 bytes each
    assert row["state_columns"] == 7 and row["memory_per_point"] == 8 * (2 * (3 + 7) + 6 + 18)
    assert row["facet"] == "biaxial" and table["everything"]["on_front"] == 1


def test_the_study_of_decisions_compares_the_decided_run_with_everything(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = load("p_constant", ["effects.tolerance=0.05"])
    full = decisions.everything(loaded.scene)
    chosen = full.with_effect("contact_gain", False)
    asked: list[EffectSet] = []

    def run(given: Any, chosen_set: EffectSet) -> Outcome:
        asked.append(chosen_set)
        return one_point(far(0.0, 3.0) if chosen_set == full else far(0.04, 1.0))

    monkeypatch.setattr(decisions, "run_point", run)
    monkeypatch.setattr(decisions, "decide_point", lambda given: Decision(chosen, error=0.01, tolerance=0.05))
    row = decisions.compared(loaded)
    assert asked == [chosen, full]
    assert row["error"] == pytest.approx(0.04, rel=1e-9) and row["estimate"] == 0.01 and row["tolerance"] == 0.05
    assert (row["seconds"], row["seconds_everything"], row["speedup"]) == (1.0, 3.0, 3.0)
    assert (row["within"], row["finished"], row["left_out"], row["quantity"]) == (1, 1, "contact_gain", "coordination")
    monkeypatch.setattr(decisions, "decide_point", lambda given: Decision(chosen, error=0.01, tolerance=0.03))
    assert decisions.compared(loaded)["within"] == 0


def test_runs_with_and_without_loss_of_contacts_do_lie_apart() -> None:
    """To first order a point at constant p loses (2 P0/pi) of q/p: nothing made up here."""
    loaded = load("p_constant", ["path.0.increments=3"])
    full = decisions.everything(loaded.scene)
    one, other = run_point(loaded, full), run_point(loaded, full.with_effect("contact_loss", False))
    assert one.finished and len(one.keys) == 3 and one.trial.columns > other.trial.columns - 1
    found = distance(one, other, np.ones(1))
    lost = 1 - one.trial.coordination[-1, 0] / 4.06
    assert 0.09 < lost < 0.11
    # the reference is the first of the two; the fabric of the other is next to nothing
    assert 1 / (1 - lost) - 1 < found.error == pytest.approx(np.linalg.norm(one.trial.fabric[-1, 0]), rel=1e-3)
    assert found.quantity == "fabric"
    assert distance(one, one, np.ones(1)).error == 0.0


def test_a_field_run_keeps_all_its_steps_and_points() -> None:
    loaded = load("biaxial_smooth", ["mesh.rectangle.nx=2", "mesh.rectangle.ny=2", "stage.1.increments=2"])
    prepared = prepare(loaded)
    found = run_field(loaded, prepared, decisions.everything(loaded.scene))
    points = prepared.problem.space.npoints
    assert found.finished and [key[0] for key in found.keys][-1] == loaded.scene.stage[-1].name
    assert found.trial.stress.shape == (1 + len(found.keys), points, 3)
    np.testing.assert_allclose(found.trial.coordination[0], loaded.scene.material.coordination)
    assert found.trial.coordination[-1].max() < loaded.scene.material.coordination
    assert found.counters["law_calls"] > 0 and found.seconds > 0


def test_points_whose_rates_are_clipped_are_followed_on() -> None:
    """The flag is no failure: a fabric beyond one is driven like the others, and what fails stays where it is."""
    contact_law = ContactLaw([Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)])
    strain = np.zeros((3, 3, 3))
    strain[1:, :2] = [[2e-6, -2e-6, 0.0]], [[4e-6, -4e-6, 0.0]]
    strain[1:, 2] = [1e-3, 1e-3, 0.0]  # far beyond zero pressure
    paths = Paths(
        strain, np.tile([-P, -P, 0.0], (3, 3, 1)), np.ones(3) / 3, np.zeros((3, 2)), np.zeros(3, dtype=np.int32),
        np.full(3, 4.06), np.array([[0.0, 0.0], [-1.0, 0.0], [0.0, 0.0]]),
    )  # fmt: skip
    found = follow(contact_law, paths)
    assert found.reached.tolist() == [2, 2, 0]
    assert (np.diff(found.stress[:, :2, 0], axis=0) != 0.0).all()
    np.testing.assert_array_equal(found.stress[2, 2], [-P, -P, 0.0])
    np.testing.assert_allclose(found.fabric[0, 1], [-1.0, 0.0])
    assert np.hypot(*found.fabric[-1, 1]) > 1.0
