"""A boundary-value problem put together in Python, with the files of a run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from granfabric.cases.records import files
from granfabric.cases.records.field_history import FieldHistory
from granfabric.cases.records.field_recorder import FieldRecorder
from granfabric.cases.records.record import Record
from granfabric.cases.scene.owner import Owner
from granfabric.fem.equilibrium.checkpoint import CheckpointFolder
from granfabric.fem.equilibrium.control import StepControl
from granfabric.fem.equilibrium.results import RunSummary, StepResult
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.loads.kinds import Displacement, Fixed, RigidBody
from granfabric.fem.loads.problem import Problem

from .results import Results, read_results

__all__ = ["solve_to_folder"]

SUPPORTS = (Fixed, Displacement, RigidBody)


def solve_to_folder(
    problem: Problem,
    folder: str | Path,
    control: StepControl | None = None,
    on_step: Callable[[StepResult], None] | None = None,
    stop: Callable[[], bool] | None = None,
    every: int = 1,
    overwrite: bool = False,
) -> Results:
    """Solve a problem and write what `granfabric run` writes: history, fields for ParaView, record.

    Parameters
    ----------
    problem : Problem
    folder : str or Path
        New, empty, or of an earlier call, which is replaced. Its name is the title of the run.
    control : StepControl, optional
    on_step : callable, optional
        Called with each accepted `StepResult`.
    stop : callable, optional
        Asked before each attempt; True ends the run cleanly.
    every : int
        Fields are written each so many steps, at the start and at the end.
    overwrite : bool
        Replace results of a scene too.

    Returns
    -------
    Results
        `outcome` is "finished", "stopped" or "failed".

    Raises
    ------
    InputError
        If the folder cannot be used.

    Examples
    --------
    >>> import granfabric as gf
    >>> mesh = gf.rectangle(0.05, 0.1, 2, 4)
    >>> law = gf.ContactLaw([gf.Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)])
    >>> hold = [gf.Fixed("bottom", ("y",)), gf.Fixed("left", ("x",))]
    >>> start = gf.Stage("initial", [*hold, gf.Pressure("right", 1e5), gf.Pressure("top", 1e5)])
    >>> press = gf.Stage("compression", [gf.Pressure("top", 1.2e5)], increments=4)
    >>> problem = gf.Problem(gf.Space(mesh, "P2"), law, [start, press], initial_stress=(-1e5, -1e5, 0.0))
    >>> results = gf.solve_to_folder(problem, tmp / "field")
    >>> round(results.at(0.02, 0.05)["stress_yy"])
    -120000
    """
    folder = Path(folder)
    name = folder.resolve().name
    owner = Owner("field", name, name)
    with files.held(folder, owner, overwrite):
        files.prepare_output(folder, owner, overwrite)
        record = Record(folder, name, {"title": name, "kind": "field"}, is_scene=False)
        record.write()
        summary, stopped = _solve(problem, record, control or StepControl(), on_step, stop, every)
        record.outcome = "finished" if summary.finished else "stopped" if stopped else "failed"
        record.message = summary.message
        record.details["counters"] = dict(summary.counters)
        record.timing.update(summary.seconds)
        record.write()
    return read_results(folder)


def _solve(
    problem: Problem,
    record: Record,
    control: StepControl,
    on_step: Callable[[StepResult], None] | None,
    stop: Callable[[], bool] | None,
    every: int,
) -> tuple[RunSummary, bool]:
    """How the run ended, and whether it was stopped on request."""
    loads = [load for stage in problem.stages for load in stage.loads]
    boundaries = list(dict.fromkeys(load.boundary for load in loads if hasattr(load, "boundary")))
    supported = list(dict.fromkeys(load.boundary for load in loads if isinstance(load, SUPPORTS)))
    history = FieldHistory(problem.space, problem.law.description, boundaries, supported, problem.program)
    checkpoints = CheckpointFolder(record.folder, record.name)
    recorder = FieldRecorder(record.folder, problem, history, every, lambda completed, text: None, checkpoints)
    requested = False

    def both(step: StepResult) -> None:
        recorder(step)
        if on_step is not None:
            on_step(step)

    def asked() -> bool:
        nonlocal requested
        requested = requested or (stop is not None and stop())
        return requested

    with recorder:
        summary = solve(problem, control, on_step=both, stop=asked)
        recorder.close()
    return summary, requested
