"""Runs of laws with a linear stress response: displacements first, by one linear solve a stage; states follow.

A law whose stress depends linearly on the strain (`LawDescription.linear_response`) leaves equilibrium untouched by
whatever its state does. So every stage is solved once (`LinearSolution`), and the law is called only where a result is
wanted, without tangents, over the whole strain since the last one: it divides that into the substeps which its state
needs. No state is known between results.
"""

from __future__ import annotations

import logging
from functools import partial
from typing import Any

import numpy as np

from granfabric.fem.linear_solvers.tangent import FactorMemory
from granfabric.fem.loads.amplitude import positions
from granfabric.fem.vectors import Array

from .checkpoint import SolverMemory
from .linear_solution import LinearSolution, LinearSolutionError, StageSolution
from .results import RunSummary, StepResult
from .run import SMALLEST_PROPOSAL, STOPPED, Run, StepCounts
from .stage_start import external_force

logger = logging.getLogger(__name__)

# The residual counts as zero below this multiple of the rounding of its own sums.
ROUNDING_MULTIPLE = 1e3


class UncoupledRun(Run):
    """A run of a problem whose law has a linear stress response.

    Results are handed out at every `StepControl.report_every`-th step, steps being the equal increments of the stages
    counted through, and at the end of each stage. Step control by factors does not apply: lengths of steps make no
    error in the displacements, and in the states none beyond the law's own tolerance.
    """

    def __init__(self, *arguments: Any, **more: Any) -> None:
        super().__init__(*arguments, **more)
        self._scale = self._system.norm(self._system.internal_force)
        self._committed = 0.0
        self._failure = ""

    def execute(self, resume: StepResult | None, memory: SolverMemory | None) -> RunSummary:
        stages = self._problem.stages
        first, fraction = 0, 0.0
        index = 0
        try:
            stages_solved = LinearSolution(self._problem, self._system)
            if resume is not None:
                first, fraction = self._stage_of(resume), resume.fraction
            for index in range(len(stages)):
                before = self._accounting.factorisations
                solution = stages_solved.next_stage()
                done = self._accounting.factorisations - before
                if index < first:
                    continue
                if index == first and resume is not None:
                    self._restore(resume)
                if index == first and memory is not None:
                    # What was spent to get here is part of the earlier count.
                    self._restart_accounting(memory)
                    self._scale = max(self._scale, memory.force_scale)
                reached = self._stage(index, solution, fraction if index == first else 0.0, done)
                if reached < 1.0:
                    return self._summary(False, self._failure, index, reached)
        except LinearSolutionError as error:
            return self._summary(False, f"stage {stages[index].name!r}: {error}", index, 0.0)
        return self._summary(True, "all stages completed", len(stages) - 1, 1.0)

    def _restart_accounting(self, memory: SolverMemory) -> None:
        seconds = dict(self._accounting.seconds)
        for name in self._accounting.counters():
            setattr(self._accounting, name, 0)
        self._accounting.continue_from(memory.counters, memory.seconds)
        logger.info("the displacements of the stages were solved again in %.2f s", sum(seconds.values()))

    def _wanted(self, index: int, fraction: float) -> list[tuple[int, float]]:
        """Step numbers and positions within a stage, beyond a position, at which results are wanted."""
        terms = self._problem.program.terms
        before = sum(len(positions(part.corners, part.stage.increments)) for part in terms[:index])
        places = positions(terms[index].corners, terms[index].stage.increments)
        return [
            (before + step, place)
            for step, place in enumerate(places, 1)
            if place > fraction and ((before + step) % self._control.report_every == 0 or step == len(places))
        ]

    def _stage(self, index: int, solution: StageSolution, fraction: float, factorisations: int) -> float:
        """Follow the states through a stage; the fraction reached at the last result.

        Solves and factorisations of the stage are told with its first result.
        """
        self._committed = fraction
        self._system.constrain(self._problem.program.terms[index])
        self._system.set_springs(solution.start.spring_offsets)
        solves, factorisations = (solution.solves, factorisations) if fraction == 0.0 else (0, 0)
        for step, end in self._wanted(index, fraction):
            if self._stopped():
                self._failure = STOPPED
                return fraction
            cuts = self._accounting.cuts
            substeps = self._advance(index, solution, end)
            if substeps < 0:
                return fraction
            load_factor = self._factor(index, solution, end)
            external = external_force(self._problem, index, solution.start, end, load_factor)
            displacement = solution.start.displacement + solution.displacement_at(end)
            self._system.displacement[:] = displacement
            if not self._balanced(index, end, external):
                return fraction
            fraction = end
            self._accounting.steps += 1
            counts = StepCounts(solves, factorisations, self._accounting.cuts - cuts, substeps)
            increment = 1.0 / self._problem.stages[index].increments
            self._hand_out(
                partial(
                    self._result,
                    index,
                    solution.start,
                    step,
                    end,
                    displacement,
                    external,
                    counts,
                    increment,
                    load_factor,
                ),
                self._memory,
            )
            solves, factorisations = 0, 0
        return fraction

    def _advance(self, index: int, solution: StageSolution, end: float) -> int:
        """States at a position within the stage; substeps over all points, -1 if a point cannot get there."""
        if not self._system.any(solution.strain) and not solution.varying:
            # a zero increment changes nothing, so the law need not be asked
            self._committed = end
            return 0
        if solution.varying:
            # not along a straight line: each increment is followed, reported or not
            within = [
                place for place in positions(solution.corners, solution.increments) if self._committed < place < end
            ]
            substeps = 0
            for place in [*within, end]:
                count = self._follow(index, solution, place)
                if count < 0:
                    return -1
                substeps += count
            return substeps
        return self._follow(index, solution, end)

    def _factor(self, index: int, solution: StageSolution, fraction: float) -> float:
        """Factor of the loads that follow a control; without one the position."""
        return fraction * solution.load_factor if self._problem.program.terms[index].led is not None else fraction

    def _follow(self, index: int, solution: StageSolution, end: float) -> int:
        """The same along a straight line."""
        control, material = self._control, self._system.material
        nominal = 1.0 / self._problem.stages[index].increments
        tried, substeps = end - self._committed, 0
        while self._committed < end:
            # A position is set, not summed up, so that the end is met exactly.
            last = tried >= (end - self._committed) * (1.0 - 1e-9)
            position = end if last else self._committed + tried
            report = material.follow(solution.strain_between(self._committed, position))
            if report.failed:
                self._accounting.cuts += 1
                point, message = self._system.worst(report)
                self._note_failure(point, message)
                tried = (position - self._committed) * min(
                    max(report.proposed_step_factor, SMALLEST_PROPOSAL), control.cut
                )
                if tried < control.smallest_factor * nominal:
                    self._failure = (
                        f"no load step larger than {control.smallest_factor:g} of the nominal one can be followed: "
                        f"{message}"
                    )
                    return -1
                continue
            material.commit()
            self._failed_point = None
            self._committed = position
            substeps += int(report.substeps.sum())
            tried *= control.grow
        return substeps

    def _balanced(self, index: int, fraction: float, external: Array) -> bool:
        """Whether the law's own stress is in equilibrium, as it has to be if its response is linear."""
        system = self._system
        with self._accounting.phase("assembly"):
            system.refresh_internal_force()
            rounding = np.finfo(np.float64).eps * system.norm(system.forces.magnitude)
            residual = system.norm(system.unknowns.reduce(external - system.internal_force))
            self._scale = max(self._scale, system.norm(system.internal_force), system.norm(external))
        allowed = max(
            self._control.tolerance * self._scale, self._control.absolute_tolerance, ROUNDING_MULTIPLE * rounding
        )
        if residual <= allowed:
            return True
        self._failure = (
            f"stage {self._problem.stages[index].name!r} at {fraction:.6g}: law "
            f"{self._problem.law.description.name!r} declares a linear stress response, but its stress leaves a "
            f"residual of {residual / self._scale:.1e} of the nodal forces"
        )
        return False

    def _memory(self) -> SolverMemory:
        return SolverMemory(
            np.empty((0, 3, 3)),
            None,
            0.0,
            self._scale,
            FactorMemory(),
            self._accounting.counters(),
            dict(self._accounting.seconds),
        )
