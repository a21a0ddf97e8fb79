"""Laws with a linear stress response: one solve a stage, states afterwards, the same answer as step by step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fem_meshes import ELASTIC, distorted
from test_checkpoint import same

from granfabric.constitutive.contract import Status, UpdateReport
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Material
from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.checkpoint import CheckpointFolder
from granfabric.fem.equilibrium.control import StepControl
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.loads.kinds import BodyForce, Displacement, Fixed, Pressure, Stage
from granfabric.fem.loads.problem import Problem

GRAINS = Material(
    coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9, bulk_reduction=0.88, shear_reduction=0.69
)
OFF = ContactLaw([GRAINS], effects=Effects(stiffness_feedback=False))
START = (-1e5, -1e5, 0.0)
SIDES = [Pressure("left", 1e5), Pressure("right", 1e5)]
STAGES = [
    Stage("initial", [Fixed("bottom"), Fixed("top"), *SIDES], 2),
    Stage("press", [Displacement("top", "y", -4e-5)], 6),
    Stage("shear", [Displacement("top", "x", 3e-5)], 3),
    # other constraints than before: the top is let go sideways, and its reactions fade
    Stage(
        "release",
        [Fixed("bottom"), Fixed("top", ("y",)), *SIDES, BodyForce((0.0, -1e3))],
        4,
        keep=False,
    ),
]


class Declared:
    """A law that is told to be linear, or not, and counts what it is asked."""

    def __init__(self, inner, linear, fails_beyond=np.inf):
        self._inner, self._linear, self._bound = inner, linear, fails_beyond
        self.calls = self.tangents = 0

    @property
    def description(self):
        return replace(self._inner.description, linear_response=self._linear)

    def initial_state(self, stress, material_index=None):
        return self._inner.initial_state(stress, material_index)

    def update(self, strain, stress, state, stress_end, state_end, tangent=None, *arguments):
        self.calls += 1
        self.tangents += tangent is not None
        report = self._inner.update(strain, stress, state, stress_end, state_end, tangent, *arguments)
        shear = np.hypot(stress_end[:, 0] - stress_end[:, 1], 2 * stress_end[:, 2]) / 2
        bad = shear > self._bound
        if bad.any():
            status = report.status.copy()
            status[bad] = Status.NOT_ADMISSIBLE
            stress_end[bad], state_end[bad] = stress[bad], state[bad]
            return UpdateReport(status, report.substeps, report.rejected, 0.5)
        return report


@pytest.fixture(scope="module")
def space():
    return Space(distorted("P2", 5), "P2")


def computed(space, law, control=None, stages=STAGES, **options):
    steps = []
    problem = Problem(space, law, stages, START, balance_initial_stress=options.pop("balance", False))
    summary = solve(problem, control or StepControl(), on_step=steps.append, **options)
    return steps, summary


@pytest.mark.parametrize("balance", [False, True])
@pytest.mark.parametrize("closure", [Closure(), Closure(tangential="self_consistent")])
def test_the_answer_is_that_of_step_by_step(space, closure, balance):
    law = ContactLaw([GRAINS], closure, Effects(stiffness_feedback=False))
    ours, uncoupled = computed(space, law, balance=balance)
    theirs, coupled = computed(space, Declared(law, False), StepControl(tolerance=1e-12), balance=balance)
    assert uncoupled.finished and coupled.finished, (uncoupled.message, coupled.message)
    assert [(step.step, step.stage) for step in ours] == [(step.step, step.stage) for step in theirs]
    for our, their in zip(ours, theirs):
        scale = np.abs(their.displacement).max()
        np.testing.assert_allclose(our.displacement, their.displacement, rtol=0, atol=1e-8 * max(scale, 1e-9))
        np.testing.assert_allclose(our.stress, their.stress, rtol=0, atol=1e-3)  # of 1e5 Pa
        np.testing.assert_allclose(our.strain, their.strain, rtol=0, atol=1e-8 * max(scale, 1e-9))
        np.testing.assert_allclose(our.state, their.state, rtol=0, atol=1e-6)
        for name, force in their.reactions.items():
            np.testing.assert_allclose(our.reactions[name], force, rtol=0, atol=1e-2)


def test_one_solve_a_stage_one_factorisation_for_equal_supports_no_tangents(space):
    law = Declared(OFF, True)
    steps, summary = computed(space, law, stages=STAGES[:3])
    counters = summary.counters
    assert counters["factorisations"] == 1 and counters["matrix_assemblies"] == 1
    # the initial stage is in equilibrium, which needs no solve
    assert counters["linear_solves"] == 2 and counters["line_searches"] == counters["cuts"] == 0
    assert [step.iterations for step in steps] == [0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0]
    assert sum(step.factorisations for step in steps) == 1
    # the stiffness of the initial state once, then one call a result, but for the stage in which nothing moves
    assert law.tangents == 1 and law.calls == 1 + len(steps) - 2 == counters["law_calls"]
    _, other = computed(space, Declared(OFF, True))
    assert other.counters["factorisations"] == 2  # the last stage holds other degrees of freedom


def test_steps_between_results_are_passed_over(space):
    every = Declared(OFF, True)
    all_steps, _ = computed(space, every)
    few = Declared(OFF, True)
    steps, summary = computed(space, few, StepControl(report_every=4))
    # each fourth step, counted through, and the ends of stages
    assert [step.step for step in steps] == [2, 4, 8, 11, 12, 15]
    assert summary.counters["steps"] == 6 and few.calls == 6 and few.calls < every.calls
    for step in steps:
        (same_step,) = [other for other in all_steps if other.step == step.step]
        assert same_step.fraction == step.fraction and same_step.stage == step.stage
        np.testing.assert_array_equal(step.displacement, same_step.displacement)
        # the law divides what it is given by its own tolerance of 1e-6
        np.testing.assert_allclose(step.state, same_step.state, rtol=0, atol=3e-5)
        np.testing.assert_allclose(step.stress, same_step.stress, rtol=1e-12, atol=1e-6)


@pytest.mark.parametrize("every", [1, 4])
def test_the_same_bits_follow_from_every_checkpoint(space, every, tmp_path):
    control = StepControl(report_every=every)
    store = CheckpointFolder(tmp_path, "mine")
    loaded = []

    def save(checkpoint):
        store.save(checkpoint)
        loaded.append(store.read(store.files()[-1]))

    whole, summary = computed(space, OFF, control, on_checkpoint=save)
    assert summary.finished and len(loaded) == len(whole)
    for number, checkpoint in enumerate(loaded):
        same(checkpoint.result, whole[number])
        again, end = computed(space, OFF, control, resume=checkpoint)
        assert end.finished and end.counters == summary.counters
        assert len(again) == len(whole) - number - 1
        for ours, theirs in zip(again, whole[number + 1 :]):
            same(ours, theirs)


def test_a_failed_point_ends_the_run_and_can_be_replayed(space):
    steps, _ = computed(space, OFF)
    shear = [np.hypot(step.stress[:, 0] - step.stress[:, 1], 2 * step.stress[:, 2]).max() / 2 for step in steps]
    bound = 0.5 * (shear[4] + shear[5])
    stopped, summary = computed(space, Declared(OFF, True, bound), StepControl(smallest_factor=1e-2))
    assert not summary.finished and summary.stage == "press" and "admissible" in summary.message
    assert len(stopped) == 5 and summary.fraction == stopped[-1].fraction
    point = summary.failed_point
    assert point is not None and np.abs(point.strain_increment).max() > 0
    stress, state = point.stress_start[None, :].copy(), point.state_start[None, :].copy()
    stress_end, state_end = np.empty_like(stress), np.empty_like(state)
    law = Declared(OFF, True, bound)
    report = law.update(point.strain_increment[None, :].copy(), stress, state, stress_end, state_end)
    assert report.failed == 1


def test_a_stop_is_clean(space):
    seen = []
    steps, summary = computed(space, OFF, stop=lambda: len(seen) >= 3 or seen.append(0))
    assert not summary.finished and summary.message == "stopped on request" and len(steps) == 3


def test_a_law_that_breaks_its_promise_is_found_out(space):
    steps, summary = computed(space, Declared(ContactLaw([GRAINS]), True))
    assert not summary.finished and "declares a linear stress response" in summary.message
    assert all(step.stage == "initial" for step in steps)


def test_linear_elasticity_in_one_solve(space):
    law = Declared(LinearElasticLaw(ElasticMaterial(1000.0, 0.3)), True)
    stages = [Stage("press", [Fixed("bottom"), Fixed("top", ("x",)), Displacement("top", "y", -0.01)], 5)]
    steps, theirs = [], []
    assert solve(Problem(space, law, stages), on_step=steps.append).counters["linear_solves"] == 1
    solve(Problem(space, ELASTIC, stages), StepControl(tolerance=1e-13), on_step=theirs.append)
    for our, their in zip(steps, theirs):
        np.testing.assert_allclose(our.displacement, their.displacement, rtol=0, atol=1e-13)


@pytest.mark.parametrize("feedback", [False, True])
def test_points_whose_rates_are_clipped_are_counted(space, feedback):
    """a_n = 2 q/p passes its limit in some points, in a run with one solve a stage as in one step by step."""
    grains = replace(GRAINS, force_anisotropy_ratio=2.0)
    law = ContactLaw([grains], effects=Effects(stiffness_feedback=feedback))
    stages = [STAGES[0], Stage("press", [Displacement("top", "y", -3e-4)], 30)]
    steps: list = []
    summary = solve(Problem(space, law, stages, START), StepControl(), on_step=steps.append)
    assert summary.finished, summary.message
    counted = [step.limited for step in steps]
    assert counted == [int(np.count_nonzero(step.status == Status.LIMITED)) for step in steps]
    assert counted[0] == 0 and any(0 < number < space.npoints for number in counted)
    assert all(step.substeps >= space.npoints for step in steps[2:])
