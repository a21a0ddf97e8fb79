"""Rank 0 leads, the others assist: who does what when, and how all of them end."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

import numba
import numpy as np

from granfabric.fem.equilibrium.checkpoint import Checkpoint
from granfabric.fem.equilibrium.control import ControlError, StepControl
from granfabric.fem.equilibrium.results import RunSummary, StepResult
from granfabric.fem.loads.problem import Problem
from granfabric.fem.output.series_files import OutputError

from .distribution import Distribution, DistributionError
from .dividing import divide
from .engine import world
from .pieces import PieceOutput, PieceWriter
from .restoring import divide_checkpoint
from .run import CallbackError, DistributedCoupledRun, DistributedUncoupledRun

logger = logging.getLogger(__name__)

_SOLVE, _GO = 1, 2
NAP = 0.01
"""Seconds between two looks of a rank that has nothing to do."""

_AGREED_ERRORS = (DistributionError, ControlError, OutputError)
"""Raised on all ranks together: the team stays together."""


class Team:
    """All ranks of a communicator, `mpi4py.MPI.COMM_WORLD` if none is given.

    As a context manager on rank 0 it lets the others go at the end; where an error or Ctrl-C comes in the middle of
    what all ranks do together, it ends them.
    """

    def __init__(self, comm: Any = None) -> None:
        self.comm = world() if comm is None else comm
        self._together = False
        if self.comm.size > 1:
            numba.set_num_threads(1)  # the ranks are the threads

    @property
    def leads(self) -> bool:
        """Whether this is rank 0."""
        return bool(self.comm.rank == 0)

    def __enter__(self) -> Team:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._together:
            self.end(f"{type(error).__name__}: {error}" if error is not None else "broken off")
        if self.leads:
            self._call(_GO)

    def end(self, sentence: str) -> None:
        """End all ranks at once, exit code 1."""
        sys.stderr.write(f"granfabric: rank {self.comm.rank}: {sentence}\n")
        sys.stderr.flush()
        if self.comm.size > 1:
            self.comm.Abort(1)

    def _call(self, word: int = 0) -> int:
        """Tell the word of rank 0 to all. Who waits for it sleeps: MPI's own waiting would keep a core busy."""
        told = np.array([word])
        request = self.comm.Ibcast(told, root=0)
        while not request.Test():
            time.sleep(NAP)
        return int(told[0])

    def assist(self) -> None:
        """What the other ranks do until rank 0 lets them go."""
        while True:
            if self._call() == _GO:
                return
            try:
                self._run(None, None, None, None, None, None, time.perf_counter, None)
            except _AGREED_ERRORS:
                continue
            except CallbackError:
                continue
            except BaseException as error:
                self.end(f"{type(error).__name__}: {error}")
                raise

    def solve(
        self,
        problem: Problem,
        control: StepControl | None = None,
        on_step: Callable[[StepResult], None] | None = None,
        stop: Callable[[], bool] | None = None,
        resume: StepResult | Checkpoint | None = None,
        on_checkpoint: Callable[[Checkpoint], None] | None = None,
        clock: Callable[[], float] = time.perf_counter,
        pieces: PieceOutput | None = None,
    ) -> RunSummary:
        """Run all stages on all ranks; called on rank 0 while the others `assist`.

        Arguments, results and errors as of `granfabric.fem.equilibrium.stepping.solve`; callbacks are called on rank
        0 with the results of all ranks. From a checkpoint, of this or of another number of ranks, steps follow that
        agree within Newton's tolerance. With `pieces` each rank writes the fields of its own cells, before `on_step` is
        called.

        Raises
        ------
        DistributionError
            If the two hosts do not agree on elements or integration points.
        OutputError
            If a rank cannot write its files.
        """
        self._call(_SOLVE)
        self._together = True
        try:
            return self._run(problem, control or StepControl(), on_step, stop, resume, on_checkpoint, clock, pieces)
        except _AGREED_ERRORS:
            self._together = False
            raise
        except Exception:
            # an error of a callback has been told to all; any other one leaves the ranks in the middle of something
            self._together = not self._told
            raise

    _told = False

    def _run(self, problem: Problem | None, control: StepControl | None, on_step: Any, stop: Any, resume: Any,
             on_checkpoint: Any, clock: Any, pieces: PieceOutput | None) -> RunSummary:  # fmt: skip
        comm = self.comm
        self._told = False
        wanted = on_step is not None or on_checkpoint is not None, on_checkpoint is not None, pieces is not None
        control, wanted = comm.bcast((control, wanted), root=0)
        assert control is not None
        distribution = Distribution(comm, None if problem is None else problem.space)
        local = divide(distribution, problem)
        kind = DistributedUncoupledRun if local.law.description.linear_response else DistributedCoupledRun
        run = kind(local, control, self._telling(on_step), stop, self._telling(on_checkpoint), clock)
        run.whole = problem
        run.wanted, run.checkpoints, in_pieces = wanted
        memory = None
        if isinstance(resume, Checkpoint):
            resume, memory = resume.result, resume.memory
        resume, memory = divide_checkpoint(local, resume, memory)
        if in_pieces:
            run.pieces = PieceWriter(local, problem, pieces)
            run.pieces.begin(resume)
        summary = run.execute(resume, memory)
        if run.pieces is not None:
            run.pieces.finish()
        self._together = False
        moved = distribution.nodes.bytes_moved + distribution.points.bytes_moved
        moved += 0 if run.pieces is None else run.pieces.bytes_moved
        logger.info("rank %d gave and took %d bytes", comm.rank, moved)
        return summary

    def _telling(self, callback: Any) -> Any:
        """A callback whose errors are known to be told to all ranks."""
        if callback is None:
            return None

        def called(result: Any) -> None:
            try:
                callback(result)
            except BaseException:
                self._told = True
                raise

        return called

