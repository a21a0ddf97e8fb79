"""Receives the steps of a boundary-value problem: history, fields, checkpoints, progress.

Fields and checkpoints are written by a thread while the run goes on; within `with` nothing of them is left undone.
"""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import InputError
from granfabric.fem.equilibrium.checkpoint import Checkpoint, CheckpointFolder
from granfabric.fem.equilibrium.initial import initial_result
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.loads.problem import Problem
from granfabric.fem.output.compression import Compression
from granfabric.fem.output.fields import FieldWriter, Grids
from granfabric.fem.output.series_files import OutputError, SeriesFiles

from . import files
from .background import BackgroundWriter
from .field_history import FieldHistory
from .probe_files import ProbeFile


class FieldRecorder:
    """Files of a run, brought up to date with each accepted step; the checkpoint last, so that it vouches for the rest.

    Parameters
    ----------
    folder : Path
    problem : Problem
    history : FieldHistory
        Without rows.
    every : int
        Fields are written each so many steps, at the start and at the end.
    advance : callable
        Told the load steps done and a line on the last one.
    checkpoints : CheckpointFolder
    resumed : Checkpoint, optional
        Go on after this step. What was written beyond it is removed.
    compression : {"none", "fast", "small"}
        Of the fields.
    probes : dict of str to ndarray, shape (n, 2), optional
        Places [m] by the name of a probe.
    in_pieces : bool
        Somebody else writes the fields, in pieces.

    Attributes
    ----------
    series : SeriesFiles
    written : int
        Last step whose fields are written, -1 if none is.
    closing : float
        Seconds that the end waited for files.

    Raises
    ------
    InputError
        If the files of the earlier part of the run are gone or damaged.
    OSError
    """

    def __init__(
        self,
        folder: Path,
        problem: Problem,
        history: FieldHistory,
        every: int,
        advance: Callable[[float, str], None],
        checkpoints: CheckpointFolder,
        resumed: Checkpoint | None = None,
        compression: Compression = "none",
        probes: dict[str, NDArray[np.float64]] | None = None,
        in_pieces: bool = False,
    ) -> None:
        self._in_pieces, self._compression = in_pieces, compression
        self.closing = 0.0
        self._background = BackgroundWriter()
        self._folder = folder
        self._every = every
        self._advance = advance
        self._checkpoints = checkpoints
        self._stages = problem.stages
        self._places = {stage.name: place for place, stage in enumerate(problem.stages)}
        self.history = history
        if resumed is None:
            self._last = initial_result(problem)
            self._open_series(problem, bool(probes))
            self.history.add(self._last)
            self._write_history()
            self.written = -1
            self._probes = self._probe_files(problem, probes or {})
            for probe in self._probes:
                probe.begin()
            return
        self._last = resumed.result
        done = self._last.step
        # A linear problem passes over the steps between results.
        continue_history(folder, history, done, problem.law.description.linear_response)
        try:
            self._open_series(problem, bool(probes), lambda step: step <= done and self._due(step))
        except OutputError as error:
            raise InputError(f"cannot go on: {error}") from error
        self._probes = self._probe_files(problem, probes or {})
        for probe in self._probes:
            probe.go_on([row[0] for row in history.rows])
        self._write_history()
        self.written = done if self._due(done) else -1
        self._show(self._last)

    def _open_series(self, problem: Problem, probed: bool, keep: Callable[[int], bool] | None = None) -> None:
        space, law, index = problem.space, problem.law.description, problem.material_index
        self._writer: FieldWriter | None = None
        self._grids: Grids | None = None
        if self._in_pieces:
            self.series = SeriesFiles(self._folder, keep)
            self._grids = Grids(space, law, index) if probed else None
            return
        self._grids = self._writer = FieldWriter(self._folder, space, law, keep, index, self._compression)
        self.series = self._writer.series

    def _probe_files(self, problem: Problem, probes: dict[str, NDArray[np.float64]]) -> list[ProbeFile]:
        if self._grids is None:
            return []
        law, recovery = problem.law.description, self._grids.recovery
        return [ProbeFile(self._folder, name, at, problem.space, law, recovery) for name, at in probes.items()]

    def __enter__(self) -> FieldRecorder:
        """Fields of the initial state, where the run begins with it."""
        if self._last.step == 0 and self.written < 0:
            self._write_probes(self._last)
            self._write_fields(self._last)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._background.__exit__(kind, error, trace)

    @property
    def writing(self) -> float:
        """Seconds that the thread was at work."""
        return self._background.seconds

    @property
    def last(self) -> StepResult:
        """The last accepted step, or the initial state."""
        return self._last

    def _due(self, step: int) -> bool:
        return step % self._every == 0

    def __call__(self, step: StepResult) -> None:
        """Receive an accepted step."""
        self.history.add(step)
        self._write_history()
        self._last = step
        self._write_probes(step)
        if self._due(step.step):
            self._write_fields(step)
        self._show(step)

    def save(self, checkpoint: Checkpoint) -> None:
        """Receive the checkpoint of the same step."""
        kept = checkpoint.copied()
        self._background.submit(lambda: self._checkpoints.save(kept))

    def close(self) -> None:
        """Make sure that everything is on disk, the last step's fields too."""
        since = time.perf_counter()
        if self.written != self._last.step:
            self._write_fields(self._last)
        self._background.finish()
        self.closing = time.perf_counter() - since

    def _show(self, step: StepResult) -> None:
        place = self._places[step.stage]
        done = sum(stage.increments for stage in self._stages[:place]) + step.fraction * self._stages[place].increments
        self._advance(done, f"{step.stage}: step {step.step}, {step.iterations} iterations")

    def _write_history(self) -> None:
        files.write_text(self._folder / files.HISTORY, files.csv_text(self.history.names, self.history.rows))

    def _write_probes(self, step: StepResult) -> None:
        if self._probes:
            self._background.submit(lambda: self._add_to_probes(step))

    def _add_to_probes(self, step: StepResult) -> None:
        assert self._grids is not None
        if self._grids.follow_body(step.active):
            for probe in self._probes:
                probe.take_up(self._grids.space, self._grids.recovery)
        part = self._grids.of_part(step)
        for probe in self._probes:
            probe.add(part)

    def _write_fields(self, step: StepResult) -> None:
        at, writer = self._places[step.stage] + step.fraction, self._writer
        if writer is not None:
            self._background.submit(lambda: writer.write(step, at))
        self.written = step.step


def continue_history(folder: Path, history: FieldHistory, last: int, gaps: bool = False) -> None:
    """Rows of `history.csv` up to a step; what was written beyond it will be computed again.

    With `gaps`, not every step has a row.

    Raises
    ------
    InputError
        If the file is gone, damaged or lacks steps.
    """
    path = folder / files.HISTORY
    try:
        names, lines = files.read_rows(path)
        rows = [[_value(cell) for cell in line] for line in lines[: last + 1]]
        if gaps:
            rows = [row for row in rows if row[0] <= last]
        history.continue_from(names, rows)
    except (OSError, ValueError, TypeError, IndexError, csv.Error) as error:
        raise InputError(f"cannot go on: {path} cannot be used ({error})") from error
    whole = all(len(row) == len(names) for row in rows) and all(
        isinstance(cell, int) or (isinstance(cell, float) and math.isfinite(cell))
        for row in rows
        for name, cell in zip(names, row)
        if name != "stage"
    )
    steps = [row[0] for row in rows]
    expected = sorted({0, *steps, last}) if gaps else list(range(last + 1))
    if not whole or steps != expected:
        raise InputError(f"cannot go on: {path} does not hold the steps 0 to {last}")


def _value(text: str) -> Any:
    """The number or text that `files.csv_text` wrote."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
