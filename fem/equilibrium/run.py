"""What coupled and uncoupled runs have in common: how they begin, hand out results, are restored and end."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.accounting import Accounting
from granfabric.fem.loads.problem import Problem
from granfabric.fem.vectors import Array

from .changing_body import restore_body
from .checkpoint import Checkpoint, SolverMemory
from .control import ControlError, StepControl
from .initial import boundary_sums, named_nodes
from .residual import Equilibrium
from .results import FailedPoint, RunSummary, StageStart, StepResult
from .tied_results import rigid_bodies, spring_forces, support_forces

logger = logging.getLogger(__name__)

STOPPED = "stopped on request"
# A law's proposal for the next attempt is used between this and the control's own cut.
SMALLEST_PROPOSAL = 0.1


class StepCounts(NamedTuple):
    """What a step has taken since the last one; see `StepResult`."""

    iterations: int
    factorisations: int
    cuts: int
    substeps: int
    residuals: tuple[float, ...] = ()


class Run:
    """A run of a problem; arguments as of `granfabric.fem.equilibrium.stepping.solve`.

    `granfabric.fem.equilibrium.coupled` and `granfabric.fem.equilibrium.uncoupled` say how it gets from step to step.
    """

    def __init__(
        self,
        problem: Problem,
        control: StepControl,
        on_step: Callable[[StepResult], None] | None = None,
        stop: Callable[[], bool] | None = None,
        on_checkpoint: Callable[[Checkpoint], None] | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._problem = problem
        self._control = control
        self._on_step = on_step
        self._stop = stop
        self._on_checkpoint = on_checkpoint
        self._accounting = Accounting(clock=clock)
        with self._accounting.phase("setup"):
            self._system = self._make_system()
            self._nodes = self._make_nodes()
        self._failed_point: FailedPoint | None = None

    def _make_system(self) -> Equilibrium:
        return Equilibrium(self._problem, self._control, self._accounting)

    def _make_nodes(self) -> dict[str, NDArray[np.int64]]:
        return named_nodes(self._problem.space)

    def execute(self, resume: StepResult | None, memory: SolverMemory | None) -> RunSummary:
        """Run all stages, or what is left of them; see `granfabric.fem.equilibrium.stepping.solve`."""
        raise NotImplementedError

    def _stopped(self) -> bool:
        return self._stop is not None and self._stop()

    def _summary(self, finished: bool, message: str, stage: int, fraction: float) -> RunSummary:
        logger.info("linear solver %s: %s", self._system.solver_name, self._accounting.counters())
        return RunSummary(
            finished,
            message,
            self._problem.stages[stage].name,
            fraction,
            self._system.solver_name,
            self._accounting.counters(),
            dict(self._accounting.seconds),
            self._failed_point,
            self._band_fraction(finished),
        )

    def _band_fraction(self, finished: bool) -> float:
        """Where the last tangents let shear bands form; none where no tangent is used."""
        return 0.0

    def _restore(self, resume: StepResult) -> int:
        """Take the fields of a step over; index of its stage.

        Raises
        ------
        ControlError
            If it does not belong to this problem.
        """
        index = self._stage_of(resume)
        system, space = self._system, self._problem.space
        for name, shape, given in (
            ("displacement", (space.ndofs,), resume.displacement),
            ("stress", (space.npoints, 3), resume.stress),
            ("strain", (space.npoints, 3), resume.strain),
            ("state", (space.npoints, self._problem.law.description.nstate), resume.state),
        ):
            if np.shape(given) != shape:
                raise ControlError(
                    f"the step to go on from has a {name} of shape {np.shape(given)}, this problem {shape}"
                )
        restore_body(system, self._problem, index)
        material = system.material
        for ours, values in (
            (material.stress_start, resume.stress),
            (material.strain_start, resume.strain),
            (material.state_start, resume.state),
        ):
            ours[:] = values if system.part is None else values[system.part.points]
        system.displacement[:] = resume.displacement
        return index

    def _stage_of(self, resume: StepResult) -> int:
        """Index of the stage of a step.

        Raises
        ------
        ControlError
            If this problem has no such stage.
        """
        names = [stage.name for stage in self._problem.stages]
        if resume.stage not in names:
            raise ControlError(f"the step to go on from belongs to stage {resume.stage!r}, not one of {names}")
        return names.index(resume.stage)

    def _note_failure(self, point: int, message: str) -> None:
        """Keep what is needed to replay a failed point alone; -1 where it was not a point that failed."""
        if point < 0:
            self._failed_point = None
            return
        material, part = self._system.material, self._system.part
        x, y = self._problem.space.points[point]
        row = point if part is None else int(np.searchsorted(part.points, point))
        index = 0 if material.material_index is None else int(material.material_index[row])
        self._failed_point = FailedPoint(
            point,
            (float(x), float(y)),
            material.stress_start[row].copy(),
            material.last_increment[row].copy(),
            material.state_start[row].copy(),
            index,
            message,
        )

    def _hand_out(self, result: Callable[[], StepResult], memory: Callable[[], SolverMemory]) -> None:
        """Make a result, and give it to those who asked for results or checkpoints."""
        if self._on_step is None and self._on_checkpoint is None:
            return
        with self._accounting.phase("state"):
            made = result()
        with self._accounting.phase("output"):
            if self._on_step is not None:
                self._on_step(made)
            if self._on_checkpoint is not None:
                self._on_checkpoint(Checkpoint(made, memory()))

    def _result(
        self,
        index: int,
        start: StageStart,
        step: int,
        fraction: float,
        displacement: Array,
        external: Array,
        counts: StepCounts,
        next_increment: float,
        load_factor: float,
    ) -> StepResult:
        system, material = self._system, self._system.material
        terms = self._problem.program.terms[index]
        support = support_forces(terms, system.internal_force, external)
        whole = index == 0 and self._problem.starts_loaded
        program = self._problem.program
        bodies = rigid_bodies(program, index, displacement, support, 1.0 if whole else fraction, load_factor, start)
        report = material.committed_report
        assert report is not None
        return StepResult(
            terms.stage.name,
            step,
            fraction,
            displacement.copy(),
            boundary_sums(self._nodes, support),
            system.of_space(material.stress_start),
            system.of_space(material.strain_start),
            system.of_space(material.state_start),
            system.of_space(report.status),
            counts.iterations,
            counts.factorisations,
            counts.cuts,
            counts.residuals,
            counts.substeps,
            report.limited,
            next_increment,
            start,
            load_factor,
            bodies,
            spring_forces(program, index, displacement, start),
            None if terms.body is None else terms.body.active,
            support,
        )
