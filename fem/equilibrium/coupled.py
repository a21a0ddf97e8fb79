"""Coupled runs: stages in steps that grow and are cut; nothing is committed that has not converged."""

from __future__ import annotations

import logging
import math
from functools import partial
from typing import Any

import numpy as np

from granfabric.fem.linear_solvers.direct import FactorisationError
from granfabric.fem.vectors import Array

from .changing_body import begin_body
from .checkpoint import SolverMemory
from .control import ControlError
from .newton import newton_step
from .results import RunSummary, StepResult
from .run import SMALLEST_PROPOSAL, STOPPED, Run, StepCounts
from .stage_start import external_force, stage_start, target_displacement

logger = logging.getLogger(__name__)

# Steps that would leave less than this fraction of themselves are stretched to the end of the stage.
SLIVER = 1e-9


class CoupledRun(Run):
    """A run in which displacements and the law's stress are iterated on, step by step."""

    def __init__(self, *arguments: Any, **more: Any) -> None:
        super().__init__(*arguments, **more)
        self._step = 0
        self._reference = np.zeros(self._problem.space.ndofs)
        self._held: Array | None = None

    def execute(self, resume: StepResult | None, memory: SolverMemory | None) -> RunSummary:
        first = 0
        if resume is not None:
            first = self._restore(resume)
            self._step = resume.step
            self._reference = np.array(resume.stage_start.reference)
            self._held = resume.stage_start.held
            self._system.refresh_internal_force()
        for index in range(first, len(self._problem.stages)):
            again = index == first
            fraction, message = self._stage(index, resume if again else None, memory if again else None)
            if message:
                return self._summary(False, message, index, fraction)
        return self._summary(True, "all stages completed", len(self._problem.stages) - 1, 1.0)

    def _continue_from(self, memory: SolverMemory) -> None:
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
        self._accounting.continue_from(memory.counters, memory.seconds)
        try:
            system.restore_factor(memory.factor)
        except FactorisationError as error:
            raise ControlError(f"the checkpoint's matrix cannot be factorised: {error}") from None

    def _stage(self, index: int, resume: StepResult | None, memory: SolverMemory | None) -> tuple[float, str]:
        """Run one stage; the fraction reached and a message if it could not be finished."""
        control, system = self._control, self._system
        terms = self._problem.program.terms[index]
        nominal = 1.0 / terms.stage.increments
        if self._stopped():
            return 0.0 if resume is None else resume.fraction, STOPPED
        with self._accounting.phase("setup"):
            if resume is None:
                begin_body(system, self._problem, index)
            system.constrain(terms.constrained)
            system.material.law = self._problem.law_of(index)
        if memory is None:
            # A new stage turns the direction of loading, for which the last converged tangent is a bad guide.
            report = system.material.still_tangent(control.tangent_kind)
            if report.failed:
                reason = system.worst(report)[1]
                return 0.0, f"stage {terms.stage.name!r} starts from a state without a tangent: {reason}"
        with self._accounting.phase("setup"):
            if resume is not None:
                start = resume.stage_start
            else:
                start = stage_start(
                    self._problem, index, system.displacement, system.internal_force, self._reference, self._held
                )
                self._reference, self._held = start.reference, start.held
        system.start_scale(external_force(self._problem, index, start, 0.0))
        target = target_displacement(terms, start)
        fraction = 0.0 if resume is None else resume.fraction
        increment = control.first_factor * nominal if resume is None else resume.next_increment
        last_correction: Array | None = None
        last_increment = increment
        if memory is not None:
            self._continue_from(memory)
            last_correction, last_increment = memory.last_correction, memory.last_increment
        cuts, iterations, factorisations = 0, 0, self._accounting.factorisations
        while fraction < 1.0:
            if self._stopped():
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
                self._note_failure(outcome.failed_point, outcome.reason)
                last_correction = None
                logger.info("stage %s at %.6g: %s", terms.stage.name, end, outcome.reason)
                system.material.still_tangent(control.tangent_kind)
                increment = tried * min(max(outcome.proposed_factor, SMALLEST_PROPOSAL), control.cut)
                if increment < control.smallest_factor * nominal:
                    return fraction, (
                        f"no load step larger than {control.smallest_factor:g} of the nominal one converges: "
                        f"{outcome.reason}"
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
            done = self._accounting.factorisations - factorisations
            assert system.material.committed_report is not None
            substeps = int(system.material.committed_report.substeps.sum())
            counts = StepCounts(iterations, done, cuts, substeps, tuple(outcome.residuals))
            self._hand_out(
                partial(
                    self._result, index, start, self._step, fraction, system.displacement, external, counts, increment
                ),
                partial(self._memory, last_correction, last_increment),
            )
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
