"""Coupled and uncoupled runs on several ranks: the steps of the own host, results collected on rank 0."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.equilibrium.bands import band_fraction
from granfabric.fem.equilibrium.checkpoint import Checkpoint, SolverMemory
from granfabric.fem.equilibrium.coupled import CoupledRun
from granfabric.fem.equilibrium.initial import boundary_sums, named_nodes
from granfabric.fem.equilibrium.residual import Equilibrium
from granfabric.fem.equilibrium.results import FailedPoint, StageStart, StepResult
from granfabric.fem.equilibrium.run import Run
from granfabric.fem.equilibrium.tied_results import rigid_bodies, spring_forces
from granfabric.fem.equilibrium.uncoupled import UncoupledRun
from granfabric.fem.linear_solvers.tangent import FactorMemory
from granfabric.fem.loads.problem import Problem

from .material import ReducedReport
from .pieces import PieceWriter
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
            part = self._system.part
            x, y = self._problem.space.places[local if part is None else part.points[local]]
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
        if self.pieces is not None and self._own is not None:
            with self._accounting.phase("output"):
                self.pieces(self._own)
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
    pieces: PieceWriter | None = None
    _own: StepResult | None = None
    _last_start: tuple[StageStart, StageStart] | None = None

    def _of_nodes(self, own: Array) -> Array:
        whole = self._problem.space.nodes.gather(own.reshape(-1, 2))
        return np.empty(0) if whole is None else whole.ravel()

    def _of_points(self, own: NDArray[Any]) -> NDArray[Any]:
        whole = self._problem.space.points.gather(own)
        return np.empty((0, *own.shape[1:]), dtype=own.dtype) if whole is None else whole

    _supported: tuple[int, NDArray[np.int64], Any] = (-1, np.empty(0, dtype=np.int64), None)

    def _of_supports(self, index: int, own: Array) -> Array:
        """Forces of the supports: of the few degrees of freedom that have some, which are told once a stage."""
        space = self._problem.space
        if self._supported[0] != index:
            terms = self._problem.program.terms[index]
            dofs = terms.constrained if terms.ties is None else np.union1d(terms.constrained, terms.ties.dofs)
            numbers = 2 * space.node_numbers[dofs // 2] + dofs % 2
            self._supported = index, dofs, self._comm.gather(numbers, root=0)
        _, dofs, numbers = self._supported
        told = self._comm.gather(own[dofs], root=0)
        space.nodes.bytes_moved += own[dofs].nbytes
        if told is None:
            return np.empty(0)
        whole = np.zeros(2 * space.nodes.total)
        for places, values in zip(numbers, told):
            whole[places] = values
        return whole

    def _result(self, index: int, start: StageStart, *arguments: Any) -> StepResult:
        own = self._own = super()._result(index, start, *arguments)
        # what a stage remembers stays the same over its steps
        if self._last_start is None or self._last_start[0] is not start:
            self._last_start = (start, self._whole_start(start))
        whole_start = self._last_start[1]
        assert own.support is not None
        displacement, forces = self._of_nodes(own.displacement), self._of_supports(index, own.support)
        active = None
        if self.whole is not None:
            program = self.whole.program
            full = 1.0 if index == 0 and self.whole.starts_loaded else own.fraction
            body = program.terms[index].body
            active = None if body is None else body.active
            own = replace(
                own,
                reactions=boundary_sums(self._named, forces),
                rigid=rigid_bodies(program, index, displacement, forces, full, own.load_factor, whole_start),
                springs=spring_forces(program, index, displacement, whole_start),
            )
        return replace(
            own,
            displacement=displacement,
            active=active,
            stress=self._of_points(own.stress),
            strain=self._of_points(own.strain),
            state=self._of_points(own.state),
            status=self._of_points(own.status),
            substeps=int(self._comm.allreduce(own.substeps)),
            stage_start=whole_start,
            support=forces,
        )

    @cached_property
    def _named(self) -> dict[str, NDArray[np.int64]]:
        return {} if self.whole is None else named_nodes(self.whole.space)

    def _whole_start(self, start: StageStart) -> StageStart:
        """What all ranks remember of the start of a stage, on rank 0."""
        displacement, fading, reference = map(self._of_nodes, (start.displacement, start.fading, start.reference))
        offsets = [self._of_nodes(row) for row in start.spring_offsets]
        held = None if start.held is None else self._of_nodes(start.held)
        rows = np.array(offsets) if offsets else np.empty((0, 0))
        return StageStart(displacement, fading, reference, rows, start.load_factors, held)

    def _memory(self, *arguments: Any) -> SolverMemory:
        # tangents, factor and the start of the next predictor are found anew, which costs less than to collect them
        own: SolverMemory = super()._memory(*arguments)  # type: ignore[misc]
        return replace(own, tangent=np.empty((0, 3, 3)), last_correction=None, factor=FactorMemory())


class DistributedCoupledRun(_Collected, CoupledRun):
    """`CoupledRun` on several ranks."""

    def _band_fraction(self, finished: bool) -> float:
        part, tangent = self._system.part, self._last_tangent(finished)
        weights = (self._problem.space if part is None else part).weights
        area = float(weights.sum())
        lost = band_fraction(tangent, weights) * area if len(weights) else 0.0
        lost, area, good = self._comm.allreduce(np.array([lost, area, 0.0 if np.isfinite(tangent).all() else 1.0]))
        return float(lost / area) if good == 0.0 else 0.0


class DistributedUncoupledRun(_Collected, UncoupledRun):
    """`UncoupledRun` on several ranks."""
