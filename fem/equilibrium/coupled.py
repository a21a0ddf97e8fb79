"""Coupled runs: stages in steps that grow and are cut; nothing is committed that has not converged."""

from __future__ import annotations

import logging
import math
from functools import partial
from typing import Any

import numpy as np

from granfabric.fem.linear_solvers.direct import FactorisationError
from granfabric.fem.vectors import Array

from .bands import band_fraction
from .changing_body import begin_body
from .checkpoint import SolverMemory
from .control import ControlError
from .led_step import Lead, led_step
from .newton import newton_step
from .results import RunSummary, StageStart, StepResult
from .run import SMALLEST_PROPOSAL, STOPPED, Run, StepCounts
from .stage_start import (
    carried_by_ties,
    counted_anew,
    external_force,
    stage_start,
    target_displacement,
)

logger = logging.getLogger(__name__)

# Steps that would leave less than this fraction of themselves are stretched to the end of the stage.
SLIVER = 1e-9


class CoupledRun(Run):
    """A run in which displacements and the law's stress are iterated on, step by step."""

    def __init__(self, *arguments: Any, **more: Any) -> None:
        super().__init__(*arguments, **more)
        self._step = 0
        self._reference = np.zeros(self._problem.space.ndofs)
        self._start: StageStart | None = None
        self._factors: list[float] = []  # what controls of the stages before have come to, 1 for stages without

    def execute(self, resume: StepResult | None, memory: SolverMemory | None) -> RunSummary:
        first = 0
        if resume is not None:
            first = self._restore(resume)
            self._step = resume.step
            self._reference = np.array(resume.stage_start.reference)
            self._start = resume.stage_start
            self._factors = resume.stage_start.load_factors.tolist()
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
            ("tangent", system.material.tangent_start, memory.tangent if memory.has_tangent else None),
            ("correction", np.empty(system.unknowns.count), memory.last_correction),
            ("matrix", np.empty(system.pattern_size()), memory.factor.values),
        ):
            if given is not None and ours.shape != given.shape:
                raise ControlError(f"the checkpoint has a {name} of shape {given.shape}, this problem {ours.shape}")
        if memory.has_tangent:
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
                self._start = counted_anew(self._problem, index, self._start, system.displacement)
                begin_body(system, self._problem, index)
            system.constrain(terms)
            system.material.law = self._problem.law_of(index)
        if memory is None or not memory.has_tangent:
            # A new stage turns the direction of loading, for which the last converged tangent is a bad guide.
            report = system.material.still_tangent(control.tangent_kind)
            if report.failed:
                reason = system.worst(report)[1]
                return 0.0, f"stage {terms.stage.name!r} starts from a state without a tangent: {reason}"
        with self._accounting.phase("setup"):
            if resume is not None:
                start = resume.stage_start
            else:
                factors = np.array(self._factors if self._problem.program.controlled else [])
                start = stage_start(
                    self._problem,
                    index,
                    system.displacement,
                    system.internal_force,
                    self._reference,
                    self._start,
                    factors,
                )
                self._reference, self._start = start.reference, start
            system.set_springs(start.spring_offsets)
        system.start_scale(external_force(self._problem, index, start, 0.0))
        target = target_displacement(terms, start)
        fraction = 0.0 if resume is None else resume.fraction
        load_factor = 0.0 if resume is None or terms.led is None else resume.load_factor
        following = self._problem.program.forces(index, tuple(start.load_factors)).following
        turned = 0.0
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
            if fraction in terms.corners and fraction != turned:
                # the direction of loading turns within the stage
                turned, last_correction = fraction, None
                system.material.still_tangent(control.tangent_kind)
            corner = next(place for place in terms.corners if place > fraction)
            steps_left = max(1, math.ceil((corner - fraction) / increment * (1.0 - SLIVER)))
            tried = (corner - fraction) / steps_left
            end = corner if steps_left == 1 else fraction + tried
            with self._accounting.phase("boundary"):
                prescribed = terms.moved(end, start.displacement[terms.constrained], target)
                carried = carried_by_ties(terms, start, end)
                if carried is not None and fraction > 0.0:
                    before = carried_by_ties(terms, start, fraction)
                    assert before is not None
                    carried = carried - before
                external = external_force(self._problem, index, start, end)
                guess = None if last_correction is None else last_correction * (tried / last_increment)
            if terms.led is None:
                outcome = newton_step(system, prescribed, external, guess, carried)
            else:
                assert following is not None
                direction, at_start = terms.lead(start.displacement)
                amount = (terms.led.target - at_start) * (end - fraction)
                lead = Lead(direction, amount, following, load_factor)
                outcome = led_step(system, prescribed, external, lead, carried)
                external = external + outcome.load_factor * following
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
            last_correction = system.unknowns.of(outcome.displacement - system.displacement)
            last_increment = tried
            system.commit(outcome.displacement, external)
            fraction = end
            load_factor = fraction if terms.led is None else outcome.load_factor
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
                    self._result,
                    index,
                    start,
                    self._step,
                    fraction,
                    system.displacement,
                    external,
                    counts,
                    increment,
                    load_factor,
                ),
                partial(self._memory, last_correction, last_increment),
            )
            cuts, iterations, factorisations = 0, 0, self._accounting.factorisations
        self._factors.append(1.0 if terms.led is None else load_factor)
        return fraction, ""

    def _last_tangent(self, finished: bool) -> Array:
        """Tangent of the end; of a run that could not go on the last trial's, as its start has that of no increment."""
        material = self._system.material
        committed = finished or not self._system.any(material.tangent_end)
        return material.tangent_start if committed else material.tangent_end

    def _band_fraction(self, finished: bool) -> float:
        part = self._system.part
        return band_fraction(self._last_tangent(finished), (self._problem.space if part is None else part).weights)

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
