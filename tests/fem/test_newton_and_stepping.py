"""Convergence of Newton's method, cut-backs, limits, stopping and going on."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from fem_meshes import ELASTIC, PLASTIC, distorted, nodal, run

from granfabric.constitutive.contract import Status, UpdateReport
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.control import ControlError
from granfabric.fem.equilibrium.stepping import StepControl, solve
from granfabric.fem.linear_solvers.direct import LinearSolverError
from granfabric.fem.loads.kinds import Displacement, Fixed, Pressure, Stage
from granfabric.fem.loads.problem import Problem

PRESS = [Fixed("bottom"), Fixed("top", ("x",)), Displacement("top", "y", -0.01)]


@pytest.fixture(scope="module")
def space():
    return Space(distorted("P2", 6), "P2")


class Fragile:
    """A law that fails where an increment is larger than a bound, and counts."""

    def __init__(self, inner, bound, proposal=0.3):
        self._inner, self._bound, self._proposal = inner, bound, proposal
        self.failures = self.calls = 0

    @property
    def description(self):
        return self._inner.description

    def initial_state(self, stress, material_index=None):
        return self._inner.initial_state(stress, material_index)

    def update(self, strain_increment, stress_start, state_start, stress_end, state_end, *arguments):
        report = self._inner.update(strain_increment, stress_start, state_start, stress_end, state_end, *arguments)
        self.calls += 1
        status = report.status.copy()
        status[np.abs(strain_increment).max(axis=1) > self._bound] = Status.TOO_MANY_SUBSTEPS
        if (status > Status.LIMITED).any():
            self.failures += 1
            return UpdateReport(status, report.substeps, report.rejected, self._proposal)
        return report


class FailsOnce(Fragile):
    """A law that fails at one call, counted from 1, whatever is asked."""

    def __init__(self, inner, call):
        super().__init__(inner, np.inf, 0.5)
        self._call = call

    def update(self, *arguments):
        self._bound = -1.0 if self.calls + 1 == self._call else np.inf
        return super().update(*arguments)


def test_last_steps_are_quadratic_with_tight_linear_solves(space):
    control = StepControl(tolerance=1e-13, forcing=1e-12)
    steps, summary = run(space, PLASTIC, [Stage("press", PRESS, 4)], control)
    assert summary.finished
    orders = []
    for step in steps[1:]:
        assert (step.state[:, 1] > 0).any()
        residuals = [value for value in step.residuals if value > 1e-13]
        for older, old, new in zip(residuals, residuals[1:], residuals[2:]):
            if old < 1e-3 and new > 1e-12:  # in the basin, above rounding
                orders.append(np.log(new / old) / np.log(old / older))
    assert len(orders) >= 3
    assert np.median(orders) > 1.8 and min(orders) > 1.5


def test_linear_problem_takes_one_solve_and_one_factorisation(space):
    steps, summary = run(space, ELASTIC, [Stage("press", PRESS, 5)], StepControl(forcing=1e-10))
    assert summary.finished and len(steps) == 5
    assert summary.counters["factorisations"] == 1
    assert summary.counters["linear_solves"] == 5
    # One tangent query at zero increment and one evaluation a step: none where only the boundary has moved.
    assert summary.counters["law_calls"] == 6


def test_kept_factor_gives_the_same_answer_as_factorising_always(space):
    control = StepControl(tolerance=1e-11)
    kept, few = run(space, PLASTIC, [Stage("press", PRESS, 4)], control)
    fresh, many = run(space, PLASTIC, [Stage("press", PRESS, 4)], StepControl(tolerance=1e-11, keep_factor=False))
    assert few.counters["factorisations"] <= 2 * 4 < many.counters["factorisations"]
    scale = np.abs(fresh[-1].stress).max()
    np.testing.assert_allclose(kept[-1].stress, fresh[-1].stress, rtol=0, atol=1e-7 * scale)


def test_superlu_gives_the_same_answer(space):
    results = [
        run(space, PLASTIC, [Stage("press", PRESS, 2)], StepControl(tolerance=1e-11, linear_solver=name))
        for name in ("auto", "superlu")
    ]
    assert results[1][1].solver == "superlu"
    np.testing.assert_allclose(results[0][0][-1].stress, results[1][0][-1].stress, rtol=0, atol=1e-7)


def test_forced_cut_back_gives_the_same_answer(space):
    # Elastic: the answer does not depend on the steps at all. The whole load at once strains some points too much.
    law = Fragile(ELASTIC, 0.01)
    control = StepControl(tolerance=1e-12)
    cut, summary = run(space, law, [Stage("press", PRESS)], control)
    whole, _ = run(space, ELASTIC, [Stage("press", PRESS)], control)
    assert summary.finished and summary.counters["cuts"] >= 1 and law.failures >= 1
    assert sum(step.cuts for step in cut) == summary.counters["cuts"]
    assert cut[-1].fraction == 1.0 and len(cut) > 1
    scale = np.abs(whole[-1].stress).max()
    np.testing.assert_allclose(cut[-1].stress, whole[-1].stress, rtol=0, atol=1e-10 * scale)
    np.testing.assert_allclose(cut[-1].displacement, whole[-1].displacement, rtol=0, atol=1e-12)


def test_a_failed_attempt_leaves_no_trace(space):
    # The law fails once; with steps halved from then on the run must be that of twice as many steps.
    law = FailsOnce(PLASTIC, call=2)
    control = StepControl(tolerance=1e-12, grow=1.0)
    cut, summary = run(space, law, [Stage("press", PRESS, 4)], control)
    assert summary.finished and summary.counters["cuts"] == 1
    smooth, _ = run(space, PLASTIC, [Stage("press", PRESS, 8)], control)
    assert [step.fraction for step in cut] == pytest.approx([step.fraction for step in smooth], rel=1e-14)
    scale = np.abs(smooth[-1].stress).max()
    np.testing.assert_allclose(cut[-1].stress, smooth[-1].stress, rtol=0, atol=1e-9 * scale)
    np.testing.assert_allclose(cut[-1].state, smooth[-1].state, rtol=0, atol=1e-9 * scale)


def test_steps_grow_back_after_a_cut_and_hit_the_end(space):
    law = Fragile(ELASTIC, 0.012)
    steps, summary = run(space, law, [Stage("press", PRESS), Stage("hold", [])], StepControl(first_factor=0.1))
    assert summary.finished
    press = np.diff([0.0, *(step.fraction for step in steps if step.stage == "press")])
    assert press[1] > 1.2 * press[0]  # growth from the small first step
    ends = [step.fraction for step in steps if step.stage == "press"]
    assert ends[-1] == 1.0 and steps[-1].stage == "hold" and steps[-1].fraction == 1.0


def test_iteration_limit_is_a_failure_and_is_never_reported_as_convergence(space):
    control = StepControl(maximum_iterations=1, tolerance=1e-12, forcing=1e-2, smallest_factor=0.1)
    steps, summary = run(space, PLASTIC, [Stage("press", PRESS, 2)], control)
    assert not summary.finished and summary.stage == "press"
    assert "within 1 iterations" in summary.message and "no load step larger than 0.1" in summary.message
    assert all(step.residuals[-1] <= 1e-12 for step in steps)
    assert summary.fraction == (steps[-1].fraction if steps else 0.0)


def test_a_point_that_always_fails_ends_the_run_with_the_point_to_replay(space):
    law = Fragile(PLASTIC, 1e-6)
    steps, summary = run(space, law, [Stage("press", PRESS)], StepControl(smallest_factor=1e-2))
    assert not summary.finished and not steps
    failed = summary.failed_point
    assert failed is not None and f"point {failed.point}" in summary.message
    assert failed.position == pytest.approx(tuple(space.points[failed.point]))
    assert np.abs(failed.strain_increment).max() > 1e-6
    # Alone it does the same.
    end, state = np.zeros((1, 3)), np.zeros((1, 2))
    report = law.update(failed.strain_increment[None], failed.stress_start[None], failed.state_start[None], end, state)
    assert report.failed == 1


def test_stop_ends_cleanly_between_steps(space):
    steps = []
    problem = Problem(space, PLASTIC, [Stage("press", PRESS, 5)])
    summary = solve(problem, StepControl(), on_step=steps.append, stop=lambda: len(steps) == 2)
    assert not summary.finished and summary.message == "stopped on request"
    assert len(steps) == 2 and summary.fraction == pytest.approx(0.4)


@pytest.mark.parametrize("after", [1, 3, 4])
def test_going_on_from_any_step_ends_at_the_same_place(space, after):
    stages = [Stage("press", PRESS, 3), Stage("free", [Fixed("bottom")], 2, keep=False)]
    control = StepControl(tolerance=1e-12)
    steps, _ = run(space, PLASTIC, stages, control)
    again = []
    summary = solve(Problem(space, PLASTIC, stages), control, on_step=again.append, resume=steps[after - 1])
    assert summary.finished
    assert [step.step for step in again] == [step.step for step in steps[after:]]
    assert [step.fraction for step in again] == pytest.approx([step.fraction for step in steps[after:]], rel=1e-14)
    scale = np.abs(steps[0].stress).max()
    np.testing.assert_allclose(again[-1].stress, steps[-1].stress, rtol=0, atol=1e-9 * scale)
    np.testing.assert_allclose(again[-1].state, steps[-1].state, rtol=0, atol=1e-9 * scale)
    np.testing.assert_allclose(again[-1].strain, steps[-1].strain, rtol=0, atol=1e-12)


def test_going_on_from_a_foreign_step_is_refused(space):
    steps, _ = run(space, ELASTIC, [Stage("press", PRESS)])
    with pytest.raises(ControlError, match="state of shape"):
        solve(Problem(space, PLASTIC, [Stage("press", PRESS)]), resume=steps[-1])
    with pytest.raises(ControlError, match="belongs to stage 'press'"):
        solve(Problem(space, ELASTIC, [Stage("pull", PRESS)]), resume=steps[-1])


def test_records_are_copies(space):
    steps, _ = run(space, PLASTIC, [Stage("press", PRESS, 2)])
    assert np.abs(nodal(steps[0])).max() < 0.6 * np.abs(nodal(steps[1])).max()
    assert not np.shares_memory(steps[0].stress, steps[1].stress)


def test_supports_balance_the_loads(space):
    stages = [Stage("press", [Fixed("bottom"), Pressure("top", 0.4)])]
    steps, _ = run(space, PLASTIC, stages, StepControl(tolerance=1e-10))
    assert steps[-1].reactions["bottom"] == pytest.approx((0.0, 0.4 * 2.0), abs=1e-8)


def test_one_and_two_threads_agree_to_the_bit(space):
    before = numba.get_num_threads()
    results = []
    try:
        for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(threads)
            results.append(run(space, PLASTIC, [Stage("press", PRESS, 2)])[0][-1])
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(results[0].stress, results[1].stress)
    np.testing.assert_array_equal(results[0].displacement, results[1].displacement)


def test_unknown_linear_solver_is_refused():
    with pytest.raises(ControlError, match="'pardiso' is not one of auto, cholmod, superlu"):
        StepControl(linear_solver="pardiso")
    assert issubclass(LinearSolverError, ValueError)
