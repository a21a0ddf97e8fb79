"""A boundary-value problem put together in Python, with the files of a run."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from granfabric.cases.errors import InputError, several, short, unknown
from granfabric.cases.field.body_report import BodyReport
from granfabric.cases.field.probes import outside
from granfabric.cases.records import files
from granfabric.cases.records.field_history import FieldHistory
from granfabric.cases.records.field_recorder import FieldRecorder
from granfabric.cases.records.numbers import names_of_numbers
from granfabric.cases.records.record import Record
from granfabric.cases.records.units import units
from granfabric.cases.scene.owner import Owner
from granfabric.cases.scene.schema_probe import LONGEST_NAME, NAME
from granfabric.fem.equilibrium.checkpoint import CheckpointFolder
from granfabric.fem.equilibrium.control import StepControl
from granfabric.fem.equilibrium.results import RunSummary, StepResult
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.loads.kinds import Displacement, Fixed, RigidBody
from granfabric.fem.loads.problem import Problem
from granfabric.fem.output.compression import Compression

from .results import Results, read_results
from .scenes import _Silent

__all__ = ["solve_to_folder"]

Array = NDArray[np.float64]

SUPPORTS = (Fixed, Displacement, RigidBody)


def solve_to_folder(
    problem: Problem,
    folder: str | Path,
    control: StepControl | None = None,
    on_step: Callable[[StepResult], None] | None = None,
    stop: Callable[[], bool] | None = None,
    every: int = 1,
    overwrite: bool = False,
    *,
    compression: Compression = "none",
    probes: Mapping[str, ArrayLike] | None = None,
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
    compression : {"none", "fast", "small"}
        Of the fields: "none" takes least time, "small" least room.
    probes : mapping of str to array_like, shape (2,) or (n, 2), optional
        Places [m] by the name of a probe: their values at every step go to ``probe_NAME.csv``. A name has letters,
        digits, _ and - only.

    Returns
    -------
    Results
        `outcome` is "finished", "stopped" or "failed".

    Raises
    ------
    InputError
        If the folder cannot be used, or a probe or an option is not legal; then nothing was written.

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
    places = _checked(problem, every, compression, probes or {})
    folder = Path(folder)
    name = folder.resolve().name
    owner = Owner("field", name, name)
    with files.held(folder, owner, overwrite):
        files.prepare_output(folder, owner, overwrite)
        record = Record(folder, name, {"title": name, "kind": "field"}, is_scene=False)
        record.write()
        summary, stopped = _solve(problem, record, control or StepControl(), on_step, stop, every, compression, places)
        record.outcome = "finished" if summary.finished else "stopped" if stopped else "failed"
        record.message = summary.message
        record.details["counters"] = dict(summary.counters)
        record.details["linear_solver"] = summary.solver
        record.timing.update(summary.seconds)
        record.write()
    return read_results(folder)


def _checked(problem: Problem, every: int, compression: str, probes: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """Places of the probes, shape (n, 2) each.

    Raises
    ------
    InputError
    """
    if isinstance(every, bool) or not isinstance(every, int | np.integer) or every < 1:
        raise InputError(f"every = {every!r} is not a number of steps from 1 on")
    if compression not in get_args(Compression):
        raise InputError(unknown("compression =", str(compression), get_args(Compression)))
    found: dict[str, Array] = {}
    for name, given in probes.items():
        if not isinstance(name, str) or not re.fullmatch(NAME, name) or len(name) > LONGEST_NAME:
            raise InputError(
                f"probes: the name {short(name)} has to consist of 1 to {LONGEST_NAME} letters, digits, _ and -"
            )
        if name.lower() in {other.lower() for other in found}:  # one file each, also where case does not count
            raise InputError(f"probes: two probes have the name {name.lower()!r}")
        try:
            places = np.atleast_2d(np.asarray(given, dtype=np.float64))
        except (TypeError, ValueError):
            places = np.empty(0)
        if places.ndim != 2 or places.shape[1] != 2 or not len(places) or not np.isfinite(places).all():
            raise InputError(f"probes: {name!r} needs a place (x, y) or several of them [m], not {short(given)}")
        found[name] = places
    if wrong := list(outside(problem.space, found).values() if found else ()):
        raise several(wrong)
    return found


def _solve(
    problem: Problem,
    record: Record,
    control: StepControl,
    on_step: Callable[[StepResult], None] | None,
    stop: Callable[[], bool] | None,
    every: int,
    compression: Compression,
    probes: dict[str, Array],
) -> tuple[RunSummary, bool]:
    """How the run ended, and whether it was stopped on request."""
    loads = [load for stage in problem.stages for load in stage.loads]
    boundaries = list(dict.fromkeys(load.boundary for load in loads if hasattr(load, "boundary")))
    supported = list(dict.fromkeys(load.boundary for load in loads if isinstance(load, SUPPORTS)))
    history = FieldHistory(problem.space, problem.law.description, boundaries, supported, problem.program)
    space = problem.space
    record.details["numbers"] = names_of_numbers(space.host_mesh)
    record.details["size"] = {
        "elements": space.nelements, "degrees_of_freedom": space.ndofs, "integration_points": space.npoints,
    }  # fmt: skip
    record.details["columns"] = units(history.names)
    record.write()
    report_body, silent = BodyReport(problem, record), _Silent(None)
    checkpoints = CheckpointFolder(record.folder, record.name)
    recorder = FieldRecorder(
        record.folder,
        problem,
        history,
        every,
        lambda completed, text: None,
        checkpoints,
        compression=compression,
        probes=probes,
    )
    requested = False

    def both(step: StepResult) -> None:
        report_body(step, silent)
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
