"""Load stepping: stages in steps that grow and are cut; nothing is committed that has not converged."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.accounting import Accounting
from granfabric.fem.linear_solvers.direct import FactorisationError
from granfabric.fem.loads.load_program import StageTerms
from granfabric.fem.loads.problem import Problem

from .checkpoint import Checkpoint, SolverMemory
from .control import ControlError, StepControl
from .initial import boundary_sums, named_nodes
from .newton import StepOutcome, newton_step
from .residual import Equilibrium
from .results import FailedPoint, RunSummary, StageStart, StepResult
from .stage_start import external_force, stage_start, target_displacement
from .uncoupled import OneWayRun

__all__ = ["ControlError", "FailedPoint", "RunSummary", "StageStart", "StepControl", "StepResult", "solve"]

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)

# A proposal of the law for the next attempt is used between this and the control's own cut.
SMALLEST_PROPOSAL = 0.1
# Steps that would leave less than this fraction of themselves are stretched to the end of the stage.
SLIVER = 1e-9

STOPPED = "stopped on request"


def solve(
    problem: Problem,
    control: StepControl | None = None,
    on_step: Callable[[StepResult], None] | None = None,
    stop: Callable[[], bool] | None = None,
    resume: StepResult | Checkpoint | None = None,
    on_checkpoint: Callable[[Checkpoint], None] | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> RunSummary:
    """Run all stages.

    A law with a linear stress response is not iterated on, see `fem.one_way`; all others are, step by step.

    Parameters
    ----------
    problem : Problem
    control : StepControl, optional
    on_step : callable, optional
        Called with each accepted step.
    stop : callable, optional
        Asked before each attempt; True ends the run cleanly.
    resume : StepResult or Checkpoint, optional
        Go on after this step of the same problem. From a checkpoint the same bits follow; from a step alone Newton's
        iterates may differ within the tolerance, because the predictor starts from the tangent of a zero increment
        instead of the last converged one.
    on_checkpoint : callable, optional
        Called after `on_step` with all that the rest of the run depends on. The solver's own arrays: to be saved or
        copied within the call.
    clock : callable
        Seconds, for the times of the phases, see `fem.accounting.Accounting`.

    Returns
    -------
    RunSummary
        `finished` is False if a step could not be made small enough or the run was stopped.

    Raises
    ------
    ControlError
        If `resume` does not belong to the problem.
    LinearSolverError
        If the chosen linear solver is not installed.
    """
    kind = OneWayRun if problem.law.description.linear_response else _Run
    run = kind(problem, control or StepControl(), on_step, stop, on_checkpoint, clock)
    if isinstance(resume, Checkpoint):
        return run.execute(resume.result, resume.memory)
    return run.execute(resume, None)


class _Run:
    def __init__(
        self,
        problem: Problem,
        control: StepControl,
        on_step: Callable[[StepResult], None] | None,
        stop: Callable[[], bool] | None,
        on_checkpoint: Callable[[Checkpoint], None] | None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._problem = problem
        self._control = control
        self._on_step = on_step
        self._stop = stop
        self._on_checkpoint = on_checkpoint
        self._accounting = Accounting(clock=clock)
        with self._accounting.phase("setup"):
            self._system = Equilibrium(problem, control, self._accounting)
            space = problem.space
            self._nodes = named_nodes(space)
        self._step = 0
        self._reference = np.zeros(space.ndofs)
        self._failed_point: FailedPoint | None = None

    def execute(self, resume: StepResult | None, memory: SolverMemory | None) -> RunSummary:
        first = 0
        if resume is not None:
            first = self._restore(resume)
        try:
            for index in range(first, len(self._problem.stages)):
                again = index == first
                fraction, message = self._stage(index, resume if again else None, memory if again else None)
                if message:
                    return self._summary(False, message, index, fraction)
        finally:
            logger.info("linear solver %s: %s", self._system.solver_name, self._accounting.counters())
        return self._summary(True, "all stages completed", len(self._problem.stages) - 1, 1.0)

    def _summary(self, finished: bool, message: str, stage: int, fraction: float) -> RunSummary:
        return RunSummary(
            finished,
            message,
            self._problem.stages[stage].name,
            fraction,
            self._system.solver_name,
            self._accounting.counters(),
            dict(self._accounting.seconds),
            self._failed_point,
        )

    def _restore(self, resume: StepResult) -> int:
        names = [stage.name for stage in self._problem.stages]
        system, material = self._system, self._system.material
        if resume.stage not in names:
            raise ControlError(f"the step to go on from belongs to stage {resume.stage!r}, not one of {names}")
        for name, ours, given in (
            ("displacement", system.displacement, resume.displacement),
            ("stress", material.stress_start, resume.stress),
            ("strain", material.strain_start, resume.strain),
            ("state", material.state_start, resume.state),
        ):
            if ours.shape != np.shape(given):
                raise ControlError(
                    f"the step to go on from has a {name} of shape {np.shape(given)}, this problem {ours.shape}"
                )
            ours[:] = given
        self._step = resume.step
        self._reference = np.array(resume.stage_start.reference)
        system.refresh_internal_force()
        return names.index(resume.stage)

    def _take_up(self, memory: SolverMemory) -> None:
        """Solvers go on as if they had never stopped."""
        system = self._system
        for name, ours, given in (
            ("tangent", system.material.tangent_start, memory.tangent),
            ("correction", system.free, memory.last_correction),
            ("matrix", np.empty(system.pattern_size()), memory.factor.values),
        ):
            if given is not None and ours.shape != given.shape:
                raise ControlError(f"the checkpoint has a {name} of shape {given.shape}, this problem {ours.shape}")
        system.material.tangent_start[:] = memory.tangent
        system.force_scale = memory.force_scale
        self._accounting.take_up(memory.counters, memory.seconds)
        try:
            system.restore_factor(memory.factor)
        except FactorisationError as error:
            raise ControlError(f"the checkpoint's matrix cannot be factorised: {error}") from None

    def _stage(self, index: int, resume: StepResult | None, memory: SolverMemory | None) -> tuple[float, str]:
        """Run one stage; the fraction reached and a message if it could not be finished."""
        control, system = self._control, self._system
        terms = self._problem.program.terms[index]
        nominal = 1.0 / terms.stage.increments
        if self._stop is not None and self._stop():
            return 0.0 if resume is None else resume.fraction, STOPPED
        with self._accounting.phase("setup"):
            system.constrain(terms.constrained)
        if memory is None:
            # A new stage turns the direction of loading, for which the last converged tangent is a bad guide.
            report = system.material.still_tangent(control.tangent_kind)
            if report.failed:
                return 0.0, f"stage {terms.stage.name!r} starts from a state without a tangent: {report.message}"
        with self._accounting.phase("setup"):
            if resume is not None:
                start = resume.stage_start
            else:
                start = stage_start(
                    self._problem, index, system.displacement, system.internal_force, self._reference
                )
                self._reference = start.reference
        system.start_scale(external_force(self._problem, index, start, 0.0))
        target = target_displacement(terms, start)
        fraction = 0.0 if resume is None else resume.fraction
        increment = control.first_factor * nominal if resume is None else resume.next_increment
        last_correction: Array | None = None
        last_increment = increment
        if memory is not None:
            self._take_up(memory)
            last_correction, last_increment = memory.last_correction, memory.last_increment
        cuts, iterations, factorisations = 0, 0, self._accounting.factorisations
        while fraction < 1.0:
            if self._stop is not None and self._stop():
                return fraction, STOPPED
            steps_left = max(1, math.ceil((1.0 - fraction) / increment * (1.0 - SLIVER)))
            tried = (1.0 - fraction) / steps_left
            end = 1.0 if steps_left == 1 else fraction + tried
            with self._accounting.phase("boundary"):
                here = start.displacement[terms.constrained]
                prescribed = here + end * (target - here)
                external = external_force(self._problem, index, start, end)
                guess = None if last_correction is None else last_correction * (tried / last_increment)
            outcome = newton_step(system, prescribed, external, guess)
            iterations += outcome.iterations
            if not outcome.converged:
                self._accounting.cuts += 1
                cuts += 1
                self._note_failure(outcome)
                last_correction = None
                logger.info("stage %s at %.6g: %s", terms.stage.name, end, outcome.reason)
                system.material.still_tangent(control.tangent_kind)
                increment = tried * min(max(outcome.proposed_factor, SMALLEST_PROPOSAL), control.cut)
                if increment < control.smallest_factor * nominal:
                    return fraction, (
                        f"stage {terms.stage.name!r} came to {fraction:.6g} of its loads; no step larger than "
                        f"{control.smallest_factor:g} of the nominal one converges: {outcome.reason}"
                    )
                continue
            last_correction = (outcome.displacement - system.displacement)[system.free]
            last_increment = tried
            system.commit(outcome.displacement, external)
            fraction = end
            self._step += 1
            self._accounting.steps += 1
            self._failed_point = None
            if outcome.iterations <= control.easy_iterations:
                increment = min(max(increment, tried) * control.grow, control.largest_factor * nominal)
            if self._on_step is not None or self._on_checkpoint is not None:
                done = self._accounting.factorisations - factorisations
                with self._accounting.phase("state"):
                    result = self._result(terms, start, external, outcome, fraction, increment, iterations, done, cuts)
                with self._accounting.phase("output"):
                    if self._on_step is not None:
                        self._on_step(result)
                    if self._on_checkpoint is not None:
                        self._on_checkpoint(Checkpoint(result, self._memory(last_correction, last_increment)))
            cuts, iterations, factorisations = 0, 0, self._accounting.factorisations
        return fraction, ""

    def _memory(self, last_correction: Array, last_increment: float) -> SolverMemory:
        system = self._system
        return SolverMemory(
            system.material.tangent_start,
            last_correction,
            last_increment,
            system.force_scale,
            system.factor_memory(),
            self._accounting.counters(),
            dict(self._accounting.seconds),
        )

    def _note_failure(self, outcome: StepOutcome) -> None:
        point, material = outcome.failed_point, self._system.material
        if point < 0:
            self._failed_point = None
            return
        x, y = self._problem.space.points[point]
        index = 0 if material.material_index is None else int(material.material_index[point])
        self._failed_point = FailedPoint(
            point,
            (float(x), float(y)),
            material.stress_start[point].copy(),
            material.last_increment[point].copy(),
            material.state_start[point].copy(),
            index,
            outcome.reason,
        )

    def _result(
        self,
        terms: StageTerms,
        start: StageStart,
        external: Array,
        outcome: StepOutcome,
        fraction: float,
        increment: float,
        iterations: int,
        factorisations: int,
        cuts: int,
    ) -> StepResult:
        system, material = self._system, self._system.material
        support = np.zeros(system.space.ndofs)
        support[terms.constrained] = (system.internal_force - external)[terms.constrained]
        report = material.committed_report
        assert report is not None
        return StepResult(
            terms.stage.name,
            self._step,
            fraction,
            system.displacement.copy(),
            boundary_sums(self._nodes, support),
            material.stress_start.copy(),
            material.strain_start.copy(),
            material.state_start.copy(),
            report.status.copy(),
            iterations,
            factorisations,
            cuts,
            tuple(outcome.residuals),
            int(report.substeps.sum()),
            report.limited,
            increment,
            start,
        )
