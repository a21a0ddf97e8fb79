"""Study: what the files of a run cost, by how many steps are written and how they are compressed."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.records import series
from granfabric.cases.records.field_history import FieldHistory
from granfabric.cases.records.field_recorder import FieldRecorder
from granfabric.cases.terminal.clock import best_of
from granfabric.constitutive.parameters import Integration
from granfabric.fem.equilibrium.checkpoint import CheckpointFolder
from granfabric.fem.equilibrium.control import StepControl
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.output.compression import Compression

from .biaxial import Biaxial
from .draw import work_precision
from .front import cheapest, mark_fronts
from .study import COMMON_COLUMNS, Axes, Column, Effort, Row, Study, StudyError

Array = NDArray[np.float64]

ACROSS, QUICK_ACROSS = 12, 3
STEPS, QUICK_STEPS = 32, 8
EVERY, QUICK_EVERY = (1, 2, 4, 8, 16, 32), (1, 2, 4, 8)
FINER = 2
"""Load steps of the reference over those of the run."""
KINDS: tuple[Compression, ...] = get_args(Compression)
FIELD = "coordination"
SERIES = ("result", "points")

AXES = Axes(
    error="error of $z$ between what is written [-]",
    seconds="processor time of the files [s]",
    count="size of the files [bytes]",
    facet_titles={"biaxial": "biaxial test between rough platens"},
)


class _Run:
    """A biaxial test that has been solved, to be written in many ways."""

    def __init__(self, across: int, increments: int) -> None:
        self.problem = Biaxial(across, increments, Integration()).problem
        self.steps: list[StepResult] = []
        since = time.process_time()
        summary = solve(self.problem, StepControl(), on_step=self.steps.append)
        self.seconds = time.process_time() - since
        if not summary.finished:
            raise StudyError(f"the biaxial test did not come to its end: {summary.message}")
        last = self.problem.stages[-1].name  # before it nothing changes: stress and loads are in balance
        self.times = {0: 0.0} | {step.step: step.fraction if step.stage == last else 0.0 for step in self.steps}

    def write(self, folder: Path, every: int, compression: Compression) -> None:
        """All files of the run, but for checkpoints."""
        history = FieldHistory(self.problem.space, self.problem.law.description, [], [], self.problem.program)
        recorder = FieldRecorder(
            folder, self.problem, history, every, lambda done, text: None, CheckpointFolder(folder, "cost"),
            compression=compression,
        )  # fmt: skip
        with recorder:
            for step in self.steps:
                recorder(step)
            recorder.close()

    def written(self, every: int, compression: Compression) -> None:
        """The same in a folder that is removed again."""
        with TemporaryDirectory() as place:
            self.write(Path(place), every, compression)


def read_back(folder: Path, times: dict[int, float]) -> tuple[Array, Array]:
    """Times of the steps in a folder, each once, shape (n,), and z at the nodes in their files, shape (n, nnodes)."""
    found = series.steps(folder, SERIES[0])
    values = [np.asarray(series.read(file).point_data[FIELD], dtype=np.float64) for file in found.values()]
    once, chosen = np.unique([times[step] for step in found], return_index=True)
    return once, np.array(values)[chosen]


def error_between(times: Array, values: Array, wanted: Array, reference: Array) -> float:
    """Largest relative error, at all nodes and wanted times, of values that are linear between those written."""
    right = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    share = ((wanted - times[right - 1]) / (times[right] - times[right - 1]))[:, None]
    between = (1.0 - share) * values[right - 1] + share * values[right]
    return float(np.abs(between / reference - 1.0).max())


def rows(effort: Effort) -> list[Row]:
    """All numbers of steps with each compression; see `Study.rows`."""
    across = QUICK_ACROSS if effort.quick else ACROSS
    number = QUICK_STEPS if effort.quick else STEPS
    settings = [(kind, every) for kind in KINDS for every in (QUICK_EVERY if effort.quick else EVERY)]
    total = len(settings) * (effort.rounds + 1) + 2
    effort.advance(0, total, "reference")
    finer = _Run(across, FINER * number)
    with TemporaryDirectory() as place:
        finer.write(Path(place), 1, "none")
        wanted, reference = read_back(Path(place), finer.times)
    effort.advance(1, total, "the run that is written")
    run = _Run(across, number)
    table: list[Row] = []
    for count, (kind, every) in enumerate(settings):
        effort.advance(2 + count, total, f"{kind}, every {every}")
        with TemporaryDirectory() as place:
            run.write(Path(place), every, kind)
            times, values = read_back(Path(place), run.times)
            made = [file for name in SERIES for file in series.steps(Path(place), name).values()]
            size = sum(file.stat().st_size for file in made)
        table.append(
            {
                "facet": "biaxial",
                "series": kind,
                "setting": "every step" if every == 1 else f"every {every} steps",
                "error": error_between(times, values, wanted, reference),
                "seconds": 0.0,
                "count": size,
                "every": every,
                "steps_written": len(made) // len(SERIES),
                "bytes_a_step": size * len(SERIES) / len(made),
                "share": 0.0,
            }
        )
    calls = [partial(run.written, every, kind) for kind, every in settings]
    seconds = best_of(calls, effort.rounds, lambda done: effort.advance(2 + len(settings) + done, total, "timing"))
    for row, each in zip(table, seconds, strict=True):
        row["seconds"], row["share"] = each, each / run.seconds
    mark_fronts(table)
    return table


def draw(path: Path, table: Sequence[Row]) -> None:
    """The work-precision picture of the files."""
    steps = [row["every"] for row in table]
    title = f"Files of the biaxial test, every {min(steps)} ... {max(steps)} steps"
    work_precision(path, title, AXES, table, legend={kind: f"compression: {kind}" for kind in KINDS})


def findings(table: Sequence[Row]) -> list[str]:
    """What the numbers say."""
    whole = {row["series"]: row for row in table if row["every"] == 1}
    plain = whole["none"]
    said = [
        f"Fields of every step, not compressed: {plain['bytes_a_step'] / 1e3:.3g} kB and "
        f"{1e3 * plain['seconds'] / plain['steps_written']:.3g} ms a step, {plain['share']:.2g} times the "
        "processor time of the run without them."
    ]
    said += [
        f"Compression {name!r}: {row['count'] / plain['count']:.2g} of the size in "
        f"{row['seconds'] / plain['seconds']:.2g} times the time."
        for name, row in whole.items()
        if name != "none"
    ]
    for error in (1e-2, 1e-3, 1e-4):
        best = cheapest([row for row in table if row["series"] == "none"], error, "count")
        if best is not None:
            said.append(
                f"z between the steps within {error:g} takes {best['setting']}: {best['count'] / plain['count']:.2g} "
                "of the size of all."
            )
    return said


STUDY = Study(
    name="output",
    title="Files of a run",
    question="What do the files of a run cost, and what is lost if fewer steps are written?",
    knobs=(
        ("output.every", "1 ... 32 of 32 load steps"),
        ("output.compression", ", ".join(KINDS)),
        ("scene", f"biaxial, {ACROSS} x {2 * ACROSS} squares halved into P2 triangles"),
        ("reference", f"{FINER * STEPS} load steps, all of them written"),
        ("error", "of z at the nodes as read from the files, linear between the steps written; relative, the largest"),
        ("time", "of fields, points and history.csv, in the run's own thread and in that which writes beside it"),
    ),
    columns=(
        *COMMON_COLUMNS,
        Column("every", "fields every so many steps"),
        Column("steps_written", "steps with fields, the first and the last included"),
        Column("bytes_a_step", "size of the fields and points of a step", "bytes"),
        Column("share", "processor time of the files over that of the run without them"),
    ),
    rows=rows,
    draw=draw,
    findings=findings,
)
