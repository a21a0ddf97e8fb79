"""Every rank writes the files of its own cells; rank 0 writes which of them make a whole."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.discretisation.restricted import restricted_mesh
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.results import StageStart, StepResult
from granfabric.fem.loads.problem import Problem
from granfabric.fem.output.compression import Compression
from granfabric.fem.output.fields import Grids, Piece
from granfabric.fem.output.series_files import (
    FIELDS,
    POINTS,
    OutputError,
    SeriesFiles,
    file_name,
    piece_name,
)
from granfabric.fem.output.vtu import Described, write_pieces

from . import dialect
from .distribution import Distribution
from .engine import dolfinx
from .local_problem import LocalProblem

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

RINGS, RINGS_OF_FEW_POINTS = 1, 4
"""Rings of cells of other ranks around those of a rank from whose points its nodes' values are recovered: the patch of
a vertex, and where its points may be too few for a linear field the larger ones that `Projection` takes."""
ENOUGH_POINTS = 3
"""Integration points of a cell that determine a linear field."""


@dataclass(frozen=True)
class PieceOutput:
    """What is to be written.

    Parameters
    ----------
    series : SeriesFiles
    every : int
        Fields are written each so many steps, at the start and at the end.
    compression : {"none", "fast", "small"}
    written : int
        Step that is written already, where a run goes on; -1 if none.
    """

    series: SeriesFiles
    every: int = 1
    compression: Compression = "none"
    written: int = -1


class Surroundings:
    """A rank's cells with those of other ranks around them, as a space of the own host; values at their points.

    Parameters
    ----------
    distribution : Distribution
    whole : Space or None
        On rank 0; None elsewhere.

    Attributes
    ----------
    space : Space or None
        None on a rank that has no cells.
    piece : Piece or None
    """

    def __init__(self, distribution: Distribution, whole: Space | None) -> None:
        comm = self._comm = distribution.comm
        self._distribution = distribution
        told: Any = None
        if whole is not None:
            owner, number = distribution.elements.owners()
            gives: list[list[Numbers]] = [[np.empty(0, np.int64)] * comm.size for _ in range(comm.size)]
            takes: list[list[Numbers]] = []
            for rank in reversed(range(comm.size)):
                around = surrounded(whole, owner == rank)
                cells = np.flatnonzero(around)
                from_rank = owner[cells]
                takes.insert(0, [np.flatnonzero(from_rank == other) for other in range(comm.size)])
                for other in range(comm.size):
                    gives[other][rank] = number[cells[from_rank == other]]
                told = None
                if len(cells):
                    told = (restricted_mesh(whole, around), whole.element_nodes[cells], cells, from_rank == rank)
                if rank:
                    comm.send(told, dest=rank)
            exchanged = comm.scatter(list(zip(gives, takes)), root=0)
        else:
            told = comm.recv(source=0)
            exchanged = comm.scatter(None, root=0)
        self._gives, self._takes = exchanged
        self.space: Space | None = None
        self.piece: Piece | None = None
        self._place = np.empty(0, dtype=np.int64)  # which of the space's cells each of the rank's is
        if told is not None:
            host, element_nodes, cells, own = told
            shape = distribution.outline
            self.space = Space(host, shape.element, shape.quadrature_degree)
            nodes = np.empty(self.space.nnodes, dtype=np.int64)
            nodes[self.space.element_nodes] = element_nodes
            self.piece = Piece(own, cells, nodes)
            self._place = np.searchsorted(cells, distribution.cell_numbers)
        self._moved = dolfinx().fem.Function(distribution.displacements)
        self._table = dialect.dof_table(distribution.displacements)[: distribution.nelements]
        self.bytes_moved = 0

    def of_points(self, own: Array) -> Array:
        """Values at the points of the space, shape (npt, k), of those at the rank's points; by all ranks together."""
        nq, columns = self._distribution.points_per_cell, own.shape[1]
        ours = np.empty((len(self._place), nq, columns))
        ours[:, self._distribution.point_order] = own.reshape(len(self._place), nq, columns)
        width = nq * columns
        rank = self._comm.rank
        sizes = [0 if other == rank else len(cells) * width for other, cells in enumerate(self._gives)]
        counts = [0 if other == rank else len(cells) * width for other, cells in enumerate(self._takes)]
        others = [cells for other, cells in enumerate(self._gives) if other != rank]
        send = np.concatenate([ours[cells].ravel() for cells in others]) if others else np.empty(0)
        received = np.empty(sum(counts))
        self._comm.Alltoallv([send, sizes], [received, counts])
        self.bytes_moved += send.nbytes + received.nbytes
        values = np.empty((0 if self.space is None else self.space.nelements, nq, columns))
        values[self._place] = ours
        begin = 0
        for cells, count in zip(self._takes, counts):
            if count:
                values[cells] = received[begin : begin + count].reshape(-1, nq, columns)
                begin += count
        return values.reshape(-1, columns)

    def of_cells(self, own: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """A mask of the cells of the space from that of the rank's."""
        nq = self._distribution.points_per_cell
        at_points = np.repeat(own.astype(np.float64), nq)[:, None]
        return np.asarray(self.of_points(at_points)[::nq, 0] > 0.5)

    def of_nodes(self, own: Array) -> Array:
        """Displacements, shape (ndofs of the space,), at the nodes of the rank's cells; zero at others."""
        self._moved.x.array[: len(own)] = own
        self._moved.x.scatter_forward()
        if self.space is None:
            return np.empty(0)
        at_nodes = np.empty((*self._table.shape, 2))
        at_nodes[:, self._distribution.node_order] = np.asarray(self._moved.x.array).reshape(-1, 2)[self._table]
        values = np.zeros((self.space.nnodes, 2))
        values[self.space.element_nodes[self._place]] = at_nodes
        return values.ravel()


def surrounded(space: Space, own: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Some cells and those around them that take part in the recovery at their nodes."""
    corners = space.host_mesh.mesh.t
    chosen = own.copy()
    for _ in range(RINGS if space.points_per_cell >= ENOUGH_POINTS else RINGS_OF_FEW_POINTS):
        touched = np.zeros(space.host_mesh.mesh.p.shape[1], dtype=bool)
        touched[corners[:, chosen]] = True
        chosen = touched[corners].any(axis=0)
    return chosen


class PieceWriter:
    """Writes the pieces of a run; every call is made by all ranks together.

    Parameters
    ----------
    problem : LocalProblem
    whole : Problem or None
        On rank 0.
    output : PieceOutput or None
        On rank 0.

    Raises
    ------
    OutputError
        From the calls, on all ranks.
    """

    def __init__(self, problem: LocalProblem, whole: Problem | None, output: PieceOutput | None) -> None:
        self._problem = problem
        self._comm = problem.space.comm
        self._series = None if output is None else output.series
        head = None
        if output is not None:
            head = (output.series.folder.resolve(), output.every, output.compression, output.written)
        self._folder: Path
        self._compression: Compression
        self._folder, self._every, self._compression, self._written = self._comm.bcast(head, root=0)
        self._around = Surroundings(problem.space, None if whole is None else whole.space)
        index = None
        if problem.material_index is not None:
            index = self._around.of_points(problem.material_index.astype(np.float64)[:, None])[:, 0].astype(np.int32)
        space, piece = self._around.space, self._around.piece
        self._grids: Grids | None = None
        if space is not None:
            self._grids = Grids(space, problem.law.description, index, self._compression, piece)
        self._active: tuple[NDArray[np.bool_], NDArray[np.bool_]] | None = None
        self._last: StepResult | None = None

    @property
    def bytes_moved(self) -> int:
        """Sent and received by this rank so far."""
        return self._around.bytes_moved

    def begin(self, resumed: StepResult | None) -> None:
        """The initial state, or the step to go on from, which is on disk or will be written at the end."""
        if resumed is not None:
            self._last = resumed
            return
        problem = self._problem
        space, nothing = problem.space, np.zeros(problem.space.ndofs)
        body = problem.program.terms[0].body
        self(
            StepResult(
                problem.stages[0].name, 0, 0.0, nothing, {}, problem.initial_stress, np.zeros((space.npoints, 3)),
                problem.initial_state, np.zeros(space.npoints, dtype=np.int8), 0, 0, 0, (), 0, 0, 0.0,
                StageStart(nothing, nothing, nothing), active=None if body is None else body.active,
            )
        )  # fmt: skip

    def __call__(self, step: StepResult) -> None:
        """Receive this rank's part of a step."""
        self._last = step
        if step.step % self._every == 0:
            self._write(step)

    def finish(self) -> None:
        """See that the last step is on disk."""
        if self._last is not None and self._written != self._last.step:
            self._write(self._last)

    def _write(self, own: StepResult) -> None:
        described, error = None, ""
        step = self._surrounded(own)
        try:
            described = self._write_piece(step)
        except OSError as caught:
            error = caught.strerror or str(caught)
        told = self._comm.gather((described, error), root=0)
        if told is not None and self._series is not None:
            error = next((text for _, text in told if text), "")
            try:
                if not error:
                    self._write_whole(own, [each for each, _ in told], self._series)
            except OSError as caught:
                error = caught.strerror or str(caught)
        error = self._comm.bcast(error, root=0)
        if error:
            raise OutputError(f"output folder {self._folder} cannot be written: {error}")
        self._written = own.step

    def _surrounded(self, own: StepResult) -> StepResult:
        """A step with the values of the cells around."""
        around = self._around
        columns = np.concatenate([own.stress, own.strain, own.state, own.status[:, None].astype(np.float64)], axis=1)
        at_points = around.of_points(columns)
        active = own.active
        if active is not None:
            if self._active is None or self._active[0] is not active:
                self._active = active, around.of_cells(active)
            active = self._active[1]
        return replace(
            own,
            displacement=around.of_nodes(own.displacement),
            stress=at_points[:, :3],
            strain=at_points[:, 3:6],
            state=at_points[:, 6:-1],
            status=at_points[:, -1].astype(np.int8),
            active=active,
        )

    def _write_piece(self, step: StepResult) -> dict[str, Described] | None:
        """This rank's files; None if nothing of it is there."""
        piece = self._around.piece
        if piece is None or self._grids is None:
            return None
        if not (piece.own if step.active is None else piece.own & step.active).any():
            return None
        names = {series: piece_name(series, step.step, self._comm.rank) for series in (FIELDS, POINTS)}
        return self._grids.write_files(self._folder, names, step)

    def _write_whole(self, step: StepResult, told: list[dict[str, Described] | None], series: SeriesFiles) -> None:
        there = [rank for rank, each in enumerate(told) if each is not None]
        described = told[there[0]]
        assert described is not None
        stages = [stage.name for stage in self._problem.stages]
        for name in (FIELDS, POINTS):
            file = file_name(name, step.step, ".pvtu")
            pieces = [piece_name(name, step.step, rank) for rank in there]
            write_pieces(self._folder / file, described[name], pieces, self._compression)
            series.add(name, stages.index(step.stage) + step.fraction, file)
