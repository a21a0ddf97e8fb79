"""Coupled and uncoupled runs on several ranks: the steps of the own host, results collected on rank 0."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.equilibrium.bands import band_fraction
from granfabric.fem.equilibrium.checkpoint import Checkpoint, SolverMemory
from granfabric.fem.equilibrium.control import ControlError
from granfabric.fem.equilibrium.coupled import CoupledRun
from granfabric.fem.equilibrium.initial import boundary_sums, named_nodes
from granfabric.fem.equilibrium.residual import Equilibrium
from granfabric.fem.equilibrium.results import FailedPoint, StageStart, StepResult
from granfabric.fem.equilibrium.run import Run
from granfabric.fem.equilibrium.uncoupled import UncoupledRun
from granfabric.fem.linear_solvers.tangent import FactorMemory
from granfabric.fem.loads.problem import Problem

from .local_problem import LocalProblem
from .material import ReducedReport
from .system import DistributedEquilibrium

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)


class CallbackError(RuntimeError):
    """Whoever received a result on rank 0 failed; the error itself is raised there."""


class _Collected(Run):
    """What runs on several ranks have in common.

    Attributes
    ----------
    whole : Problem or None
        The problem of all ranks, on rank 0.
    wanted : bool
        Whether rank 0 asked for results.
    """

    whole: Problem | None = None
    wanted: bool = False
    _problem: Any

    def _make_system(self) -> Equilibrium:
        return DistributedEquilibrium(self._problem, self._control, self._accounting)

    def _make_nodes(self) -> dict[str, NDArray[np.int64]]:
        return {}

    @property
    def _comm(self) -> Any:
        return self._problem.space.comm

    def _stopped(self) -> bool:
        return bool(self._comm.bcast(self._stop is not None and self._stop(), root=0))

    def _note_failure(self, point: int, message: str) -> None:
        report = self._system.material.report
        if point < 0 or not isinstance(report, ReducedReport):
            self._failed_point = None
            return
        found = None
        if self._comm.rank == report.worst_rank:
            material, local = self._system.material, report.worst_local
            x, y = self._problem.space.places[local]
            found = FailedPoint(
                report.worst_number,
                (float(x), float(y)),
                material.stress_start[local].copy(),
                material.last_increment[local].copy(),
                material.state_start[local].copy(),
                0 if material.material_index is None else int(material.material_index[local]),
                message,
            )
        self._failed_point = self._comm.bcast(found, root=report.worst_rank)

    def _hand_out(self, result: Callable[[], StepResult], memory: Callable[[], SolverMemory]) -> None:
        if not self.wanted:
            return
        with self._accounting.phase("state"):
            made = result()
            remembered = memory() if self.checkpoints else None
        error: BaseException | None = None
        with self._accounting.phase("output"):
            if self.whole is not None:
                try:
                    if self._on_step is not None:
                        self._on_step(made)
                    if self._on_checkpoint is not None:
                        assert remembered is not None
                        self._on_checkpoint(Checkpoint(made, remembered))
                except BaseException as caught:
                    error = caught
            failed = self._comm.bcast(error is not None, root=0)
        if error is not None:
            raise error
        if failed:
            raise CallbackError

    checkpoints: bool = False
    _last_start: tuple[StageStart, StageStart] | None = None

    def _of_nodes(self, own: Array) -> Array:
        whole = self._problem.space.nodes.gather(own.reshape(-1, 2))
        return np.empty(0) if whole is None else whole.ravel()

    def _of_points(self, own: Array) -> Array:
        whole = self._problem.space.points.gather(own)
        return np.empty((0, *own.shape[1:])) if whole is None else whole

    def _result(self, index: int, start: StageStart, *arguments: Any) -> StepResult:
        own = super()._result(index, start, *arguments)
        # what a stage remembers stays the same over its steps
        if self._last_start is None or self._last_start[0] is not start:
            parts = (self._of_nodes(part) for part in (start.displacement, start.fading, start.reference))
            self._last_start = (start, StageStart(*parts))
        system, terms = self._system, self._problem.program.terms[index]
        external = arguments[3]
        support = np.zeros(self._problem.space.ndofs)
        support[terms.constrained] = (system.internal_force - external)[terms.constrained]
        forces = self._of_nodes(support)
        reactions: dict[str, tuple[float, float]] = {}
        if self.whole is not None:
            reactions = boundary_sums(named_nodes(self.whole.space), forces)
        return replace(
            own,
            displacement=self._of_nodes(own.displacement),
            reactions=reactions,
            stress=self._of_points(own.stress),
            strain=self._of_points(own.strain),
            state=self._of_points(own.state),
            status=self._of_points(own.status.astype(np.float64)).astype(np.int8),
            substeps=int(self._comm.allreduce(own.substeps)),
            stage_start=self._last_start[1],
            support=forces,
        )

    def _memory(self, *arguments: Any) -> SolverMemory:
        own: SolverMemory = super()._memory(*arguments)  # type: ignore[misc]
        correction = None
        if self._comm.bcast(own.last_correction is not None, root=0):
            full = np.full(self._problem.space.ndofs, np.nan)
            assert own.last_correction is not None
            self._system.unknowns.expand(own.last_correction, full)
            correction = self._of_nodes(full)
            correction = correction[~np.isnan(correction)]
        return replace(
            own, tangent=self._of_points(own.tangent), last_correction=correction, factor=FactorMemory()
        )


class DistributedCoupledRun(_Collected, CoupledRun):
    """`CoupledRun` on several ranks."""

    def _band_fraction(self, finished: bool) -> float:
        tangent = self._of_points(self._last_tangent(finished))
        fraction = 0.0 if self.whole is None else band_fraction(tangent, self.whole.space.weights)
        return float(self._comm.bcast(fraction, root=0))


class DistributedUncoupledRun(_Collected, UncoupledRun):
    """`UncoupledRun` on several ranks."""


def divide_checkpoint(
    problem: LocalProblem, whole: Problem | None, resume: StepResult | None, memory: SolverMemory | None
) -> tuple[StepResult | None, SolverMemory | None]:
    """This rank's part of the step to go on from, which rank 0 has.

    Raises
    ------
    ControlError
        On all ranks, if it does not belong to the problem.
    """
    space = problem.space
    comm = space.comm
    head: Any = None
    if resume is not None:
        plain = replace(resume, displacement=_NONE, stress=_NONE, strain=_NONE, state=_NONE,
                        status=np.empty(0, dtype=np.int8),
                        stage_start=StageStart(_NONE, _NONE, _NONE), reactions={}, support=None)  # fmt: skip
        rest = None
        if memory is not None:
            rest = replace(memory, tangent=_NONE, last_correction=None, factor=FactorMemory())
        correction = memory is not None and memory.last_correction is not None
        head = (plain, rest, correction, len(resume.displacement), resume.state.shape)
    head = comm.bcast(head, root=0)
    if head is None:
        return None, None
    plain, rest, correction, ndofs, shape = head
    width = problem.initial_state.shape[1]
    names = [stage.name for stage in problem.stages]
    if plain.stage not in names:
        raise ControlError(f"the step to go on from belongs to stage {plain.stage!r}, not one of {names}")
    if ndofs != 2 * space.nodes.total or tuple(shape) != (space.points.total, width):
        raise ControlError(
            f"the step to go on from has {ndofs} degrees of freedom and a state of shape {tuple(shape)}, this problem "
            f"{2 * space.nodes.total} and {(space.points.total, width)}"
        )

    def of_nodes(vector: Array | None) -> Array:
        return space.nodes.scatter(None if vector is None else vector.reshape(-1, 2), (2,)).ravel()

    starts = None if resume is None else resume.stage_start
    made = replace(
        plain,
        displacement=of_nodes(None if resume is None else resume.displacement),
        stress=space.points.scatter(None if resume is None else resume.stress, (3,)),
        strain=space.points.scatter(None if resume is None else resume.strain, (3,)),
        state=space.points.scatter(None if resume is None else resume.state, (width,)),
        stage_start=StageStart(
            *(of_nodes(None if starts is None else part) for part in
              ((starts.displacement, starts.fading, starts.reference) if starts else (None, None, None)))
        ),
    )  # fmt: skip
    if rest is None:
        return made, None
    last = None
    if correction:
        full = None
        if whole is not None and memory is not None and resume is not None:
            full = _of_all(whole, resume.stage, memory.last_correction)
        free = np.ones(space.ndofs, dtype=bool)
        free[problem.program.terms[_number(problem.stages, plain.stage)].constrained] = False
        last = of_nodes(full)[free]
    tangent = np.empty((0, 3, 3))
    if not problem.law.description.linear_response:
        tangent = space.points.scatter(None if memory is None else memory.tangent, (3, 3))
    return made, replace(rest, tangent=tangent, last_correction=last)


def _number(stages: Any, name: str) -> int:
    return [stage.name for stage in stages].index(name)


def _of_all(whole: Problem, stage: str, of_free: Array | None) -> Array:
    """Values of the free degrees of freedom of a stage among all, zero elsewhere."""
    free = np.ones(whole.space.ndofs, dtype=bool)
    free[whole.program.terms[_number(whole.stages, stage)].constrained] = False
    full = np.zeros(whole.space.ndofs)
    if of_free is None or of_free.shape != (int(free.sum()),):
        return full  # a guess that is no use does no harm
    full[free] = of_free
    return full


_NONE = np.empty(0)
