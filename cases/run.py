"""A boundary-value problem: `granfabric run`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

import constitutive.warm_up
import fem.warm_up
from fem.checkpoint import Checkpoint, CheckpointError, CheckpointFolder
from fem.control import ControlError, StepControl
from fem.linear_solver import LinearSolverError, make_solver
from fem.loads import (
    BodyForce,
    Displacement,
    Fixed,
    FixedPoint,
    LoadError,
    Pressure,
    Stage,
    Traction,
)
from fem.mesh import HostMesh, MeshError, read_mesh, rectangle
from fem.output import OutputError
from fem.problem import Problem
from fem.results import RunSummary
from fem.space import Space
from fem.stepping import solve

from . import build, files, resumption
from .compile_watch import CompileWatch, watching
from .early_kernels import EarlyKernels
from .effects_choice import resolve_effects
from .errors import InputError
from .field_history import FieldHistory
from .field_recorder import FieldRecorder
from .groups import check_groups, material_index, named_boundaries
from .interruption import stop_wish
from .record import Record, resolved
from .replay import write_failed_point
from .scene import LoadedScene
from .screen import Screen, spread

COMPILATION_SECONDS = 40
"""Rough time to compile the kernels of law and host on two cores, for the message on first use."""


def stages(scene: Any) -> list[Stage]:
    """Stages of a field scene with their loads."""
    made = []
    for part in scene.stage:
        loads: list[Any] = [Fixed(load.boundary, tuple(load.components)) for load in part.fixed]
        loads += [FixedPoint((load.point[0], load.point[1]), tuple(load.components)) for load in part.fixed_point]
        loads += [Displacement(load.boundary, load.component, load.value) for load in part.displacement]
        loads += [Pressure(load.boundary, load.value) for load in part.pressure]
        loads += [Traction(load.boundary, (load.value[0], load.value[1])) for load in part.traction]
        loads += [BodyForce((load.value[0], load.value[1]), load.region) for load in part.body_force]
        made.append(Stage(part.name, loads, part.increments, part.keep))
    return made


def read_or_make_mesh(loaded: LoadedScene) -> HostMesh:
    """Mesh of a field scene.

    Raises
    ------
    InputError
        If the mesh file is not usable.
    """
    mesh = loaded.scene.mesh
    if mesh.rectangle is not None:
        shape = mesh.rectangle
        return rectangle(shape.width, shape.height, shape.nx, shape.ny, shape.cell)
    try:
        return read_mesh(loaded.file.parent / mesh.file)
    except MeshError as error:
        raise loaded.error(["mesh", "file"], f"mesh.file: {error}") from error


@dataclass(frozen=True)
class Prepared:
    """A field scene turned into a problem; nothing has been computed or written."""

    problem: Problem
    control: StepControl
    boundaries: list[str]
    supported: list[str]
    effects: Any


def prepare(loaded: LoadedScene) -> Prepared:
    """Check everything about a field scene that can be checked before computing.

    Raises
    ------
    InputError
    """
    scene = loaded.scene
    loaded.require("field")
    mesh = read_or_make_mesh(loaded)
    check_groups(loaded, mesh)
    index = material_index(loaded, mesh)
    effects = resolve_effects(scene)
    law = build.law(loaded, effects)
    try:
        space = Space(mesh, scene.mesh.element, scene.mesh.quadrature_degree)
    except MeshError as error:
        raise loaded.error(["mesh"], f"mesh: {error}") from error
    try:
        problem = Problem(
            space,
            law,
            stages(scene),
            initial_stress=scene.initial.stress,
            material_index=None if index is None else index[space.point_cell],
            balance_initial_stress=scene.initial.balance,
        )
    except (LoadError, MeshError) as error:
        raise loaded.error(["stage"], f"stage: {error}") from error
    try:
        control = StepControl(**scene.solver.model_dump())
    except ControlError as error:
        raise loaded.error(["solver"], f"solver: {error}") from error
    try:
        make_solver(control.linear_solver)
    except LinearSolverError as error:
        raise loaded.error(["solver"], f"solver.linear_solver: {error}") from error
    return Prepared(problem, control, *named_boundaries(scene), effects)


def run_field(
    loaded: LoadedScene, folder: Path, screen: Screen, resume: bool = False, kernels: EarlyKernels | None = None
) -> Record:
    """Compute a field scene and write its files.

    Parameters
    ----------
    loaded : LoadedScene
        Of kind "field".
    folder : Path
        Result folder: new, empty, or of an earlier run, which is replaced.
    screen : Screen
    resume : bool
        Go on with the run in the folder after its last checkpoint; the results are those of a run in one go, to the
        last bit.
    kernels : EarlyKernels, optional
        Where the law's kernels are being compiled.

    Returns
    -------
    Record
        As written to `run.json`; `outcome` is "finished", "stopped" or "failed".

    Raises
    ------
    InputError
        If anything about the scene or the folder is not legal, or another input than that of the run to go on with;
        then nothing was written.
    RunError
        If the run broke off within a step; what was reached before is on disk.
    """
    with watching(screen.announce_compilation(COMPILATION_SECONDS)) as watch, stop_wish(screen.announce_stop) as stop:
        files.check_output(folder)
        earlier = resumption.earlier_record(folder) if resume else None
        prepared = prepare(loaded)
        problem = prepared.problem
        record = Record(folder, loaded.name, resolved(loaded, prepared.effects))
        digest = resumption.mesh_digest(record.scene)
        checkpoints = CheckpointFolder(folder, resumption.identity(record.scene, digest))
        resumed = None
        if earlier is not None:
            resumption.check_same_input(folder, earlier, record.scene, digest)
            if earlier["outcome"] == "finished":
                screen.say(f"the run in {folder} is finished; nothing to do")
                checkpoints.remove()
                record.outcome, record.message = "finished", earlier["message"]
                return record
            resumed = _last_checkpoint(checkpoints, earlier, screen)
        record.details["mesh_digest"] = digest
        record.details["size"] = {
            "elements": problem.space.nelements,
            "degrees_of_freedom": problem.space.ndofs,
            "integration_points": problem.space.npoints,
        }
        if resumed is None:
            files.prepare_output(folder)
            record.write()
        else:
            record.details["resumed_after_step"] = resumed.result.step
        waited = _compile(kernels, watch, stop, loaded.scene.output.pictures)
        with (
            screen.progress(loaded.name, sum(stage.increments for stage in problem.stages)) as advance,
            record.phase("run"),
        ):
            history = FieldHistory(problem.space, problem.law.description, prepared.boundaries, prepared.supported)
            try:
                recorder = FieldRecorder(
                    folder, problem, history, loaded.scene.output.every, advance, checkpoints, resumed
                )
                files.remove_unfinished(folder)
                record.write()
                summary = solve(
                    problem,
                    prepared.control,
                    on_step=recorder,
                    stop=stop,
                    resume=resumed,
                    on_checkpoint=recorder.save,
                )
                recorder.close()
            except (OutputError, OSError) as error:
                raise record.broken_off(f"results cannot be written any more: {error}") from error
            except KeyboardInterrupt as error:
                raise record.broken_off("interrupted within a step") from error
        _finish(record, summary, stop.wished)
        if summary.failed_point is not None and record.outcome == "failed":
            write_failed_point(folder, summary.failed_point, problem.law.description, record.scene)
        record.timing["compilation"] = watch.seconds + waited
        record.write()
        if loaded.scene.output.pictures:
            from .plots import draw

            with record.phase("pictures"):
                draw(folder, record.scene)
            record.write()
        if record.outcome == "finished":
            checkpoints.remove()
    _report(history, summary, record, screen)
    return record


def _last_checkpoint(checkpoints: CheckpointFolder, earlier: dict[str, Any], screen: Screen) -> Checkpoint | None:
    """Where to go on; None if the run had not accepted a step yet."""
    try:
        resumed, complaints = checkpoints.load()
    except CheckpointError as error:
        raise InputError(f"cannot go on: {error} (start anew without --resume)") from error
    for text in complaints:
        screen.say(f"{text}; going on from the one before")
    other = resumption.other_versions(earlier)
    if other:
        screen.say(f"other versions than when the run began ({', '.join(other)}): last digits may differ")
    if resumed is None:
        screen.say("no step was finished; starting at the beginning")
    else:
        screen.say(f"going on after step {resumed.result.step}")
    return resumed


def _compile(kernels: EarlyKernels | None, watch: CompileWatch, stop: Callable[[], bool], pictures: bool) -> float:
    """Share compiling with the other process, then the host's kernels; seconds spent waiting for the other."""
    if kernels is None or not kernels.running:
        return 0.0
    watch.announce()
    constitutive.warm_up.compile_late(lambda: kernels.running and not stop())
    fem.warm_up.warm_up()
    if pictures:  # imported now, it costs no time later
        import_module("cases.plots_field")
    return kernels.wait(stop)


def _finish(record: Record, summary: RunSummary, stopped: bool) -> None:
    record.outcome = "finished" if summary.finished else "stopped" if stopped else "failed"
    record.message = summary.message
    record.details["counters"] = dict(summary.counters)
    record.details["linear_solver"] = summary.solver
    record.details["reached"] = {"stage": summary.stage, "fraction": summary.fraction}
    record.timing.update(summary.seconds)


def _report(history: FieldHistory, summary: RunSummary, record: Record, screen: Screen) -> None:
    columns = dict(zip(history.names, zip(*history.rows)))
    axial = max(("strain_xx", "strain_yy", "strain_xy"), key=lambda name: float(np.abs(columns[name]).max()))
    rows = []
    for row in spread(len(history.rows), 8):
        p, q = columns["p"][row], columns["q"][row]
        rows.append(
            [
                str(columns["step"][row]),
                columns["stage"][row],
                f"{columns[axial][row] * 1e6:.1f}",
                f"{q / p:.4f}",
                f"{columns['coordination'][row]:.4f}",
                f"{columns['coordination_smallest'][row]:.4f}",
                f"{columns['fabric_anisotropy'][row]:.4f}",
                f"{columns['fabric_anisotropy_largest'][row]:.4f}",
                str(columns["iterations"][row]),
            ]
        )
    strain = axial.replace("strain", "eps")
    names = ["step", "stage", f"{strain} [1e-6]", "q/p", "z", "z min", "a_c", "a_c max", "it."]
    screen.table(f"{record.scene['title']}: means and extremes", names, rows)
    size = record.details["size"]
    screen.say(
        f"{size['degrees_of_freedom']} degrees of freedom, {size['integration_points']} integration points; "
        f"{len(history.rows) - 1} steps, {summary.counters.get('factorisations', 0)} factorisations ({summary.solver})"
    )
    if record.outcome != "finished":
        screen.say(f"{record.outcome} in stage {summary.stage!r} at {summary.fraction:.0%}: {summary.message}")
    screen.say(
        f"{record.timing['total']:.1f} s in all, of which compilation {record.timing['compilation']:.1f} s, "
        f"law {summary.seconds.get('law', 0.0):.1f} s, linear solver "
        f"{summary.seconds.get('factorise', 0.0) + summary.seconds.get('solve', 0.0):.1f} s; results in {record.folder}"
    )
