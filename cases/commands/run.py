"""A boundary-value problem: `granfabric run`."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granfabric.cases.effects import audit as effects_audit
from granfabric.cases.effects import report as effects_report
from granfabric.cases.effects.decision import Decision
from granfabric.cases.effects.resolve import is_undecided, resolve_field
from granfabric.cases.engine.choice import Choice
from granfabric.cases.errors import InputError, RunError
from granfabric.cases.field import comparison, grains_run, initial_balance, locking, mesh_error_estimate, mesh_table
from granfabric.cases.field.body_report import BodyReport
from granfabric.cases.field.prepare import prepare
from granfabric.cases.records import files, pore_columns, resumption
from granfabric.cases.records.field_history import FieldHistory
from granfabric.cases.records.field_recorder import FieldRecorder
from granfabric.cases.records.numbers import names_of_numbers, region_at
from granfabric.cases.records.pulling import pulling_stress
from granfabric.cases.records.record import Record, resolved, versions
from granfabric.cases.records.replay import write_failed_point
from granfabric.cases.records.units import units
from granfabric.cases.scene import build, effects_choice
from granfabric.cases.scene.drainage import without_fluid
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.scene.schema_law_kind import is_grains
from granfabric.cases.terminal.compile_watch import CompileWatch, watching
from granfabric.cases.terminal.early_kernels import EarlyKernels
from granfabric.cases.terminal.interruption import interrupt_request
from granfabric.cases.terminal.screen import Screen, spread
from granfabric.constitutive import warm_up as constitutive_warm_up
from granfabric.constitutive.effective_stress import effective_stress
from granfabric.fem import warm_up as fem_warm_up
from granfabric.fem.equilibrium.checkpoint import Checkpoint, CheckpointError, CheckpointFolder
from granfabric.fem.equilibrium.control import ControlError
from granfabric.fem.equilibrium.results import RunSummary, StepResult
from granfabric.fem.loads.problem import Problem
from granfabric.fem.output.fields import OutputError

from . import hosts

if TYPE_CHECKING:
    from granfabric.fem.fenicsx.team import Team

COMPILATION_SECONDS = 12
"""Rough time to compile the kernels of law and host on two cores, for the message on first use."""
UNBOUNDED = 0.5
"""q/p of a failed point from which the message tells that only sliding bounds it."""


def run_field(
    loaded: LoadedScene,
    folder: Path,
    screen: Screen,
    resume: bool = False,
    kernels: EarlyKernels | None = None,
    overwrite: bool = False,
    team: Team | None = None,
    choice: Choice | None = None,
) -> Record:
    """Compute a field scene and write its files.

    Parameters
    ----------
    loaded : LoadedScene
        Of kind "field".
    folder : Path
        Result folder: new, empty, or of an earlier run of the same scene, which is replaced.
    screen : Screen
    resume : bool
        Go on with the run in the folder after its last checkpoint; the results are those of a run in one go, to the
        last bit.
    kernels : EarlyKernels, optional
        Where the law's kernels are being compiled.
    overwrite : bool
        Replace results of another scene too.
    team : Team, optional
        Ranks of the host "fenicsx"; the own host computes if not given.
    choice : Choice, optional
        Workers that hold the points of a scene with grains; the threads of this process if not given.

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
    since, owner = time.perf_counter(), loaded.owner
    with (
        watching(screen.announce_compilation(COMPILATION_SECONDS)) as watch,
        interrupt_request(screen.announce_stop) as stop,
        ExitStack() as hold,
    ):
        files.check_output(folder, owner, overwrite or resume)
        grains_run.check(loaded, choice)
        earlier = None
        if resume:
            resumption.earlier_record(folder)
            hold.enter_context(files.held(folder, owner, resume=True))
            earlier = resumption.earlier_record(folder)
        grains = is_grains(loaded.scene)
        if not grains:
            effects_choice.check(loaded)
        prepared = prepare(loaded)
        hosts.check(team, loaded, prepared.problem)
        for text in without_fluid(loaded):
            screen.say(text)
        if earlier is not None and not grains and is_undecided(earlier):
            same, as_begun, _ = resolve_field(loaded, prepared, earlier)
            scene = resolved(same, as_begun.effects)
            resumption.check_same_input(folder, earlier, scene, resumption.mesh_digest(scene))
            screen.say("no step was finished; starting at the beginning")
            earlier = None
        second_order = loaded.scene.mesh.element.endswith("2")
        mesh_table.show(prepared.problem.space.host_mesh, screen, second_order)
        waited = 0.0 if earlier is not None else _compile(loaded, kernels, watch, stop)
        decision: Decision | None = None
        if grains:
            prepared = grains_run.begin(loaded, prepared, screen, stop, hold, choice)
        else:
            loaded, prepared, decision = resolve_field(loaded, prepared, earlier, stop())
        problem = prepared.problem
        record = Record(
            folder, loaded.name, resolved(loaded, prepared.effects), scene_file=owner.place, since=since
        )
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
            resumed = grains_run.taken_up(problem.law, _last_checkpoint(checkpoints, earlier, screen))
        record.details["host"] = hosts.as_data(team)
        record.details["mesh_digest"] = digest
        record.details["mesh_groups"] = mesh_table.as_data(problem.space.host_mesh, second_order)
        record.details["numbers"] = names_of_numbers(problem.space.host_mesh, loaded.scene.materials)
        record.details["size"] = {
            "elements": problem.space.nelements,
            "degrees_of_freedom": problem.space.ndofs,
            "integration_points": problem.space.npoints,
        }
        hold.enter_context(files.held(folder, owner, overwrite, resume))
        if resumed is None:
            files.prepare_output(folder, owner, overwrite or resume)
            record.write()
        else:
            record.details["resumed_after_step"] = resumed.result.step
        screen.keep_log(folder / files.LOG, versions())
        if earlier is not None:
            waited = _compile(loaded, kernels, watch, stop)
        else:
            if decision is not None:
                record.details["decision"] = effects_report.as_data(decision)
                effects_report.announce(decision, problem.law.description.linear_response, screen)
        if not grains:
            locking.tell(loaded.scene, record, screen)
        balance = initial_balance.Balance(problem, getattr(loaded.scene.initial, "from") == "gravity")
        if earlier is not None:
            initial_balance.continue_from(balance, earlier, record)
        initial_balance.announce(balance, loaded, problem, record, screen)
        report_body = BodyReport(problem, record, earlier)
        with (
            screen.progress(loaded.name, sum(stage.increments for stage in problem.stages)) as advance,
            record.phase("run", watch),
        ):
            advance = grains_run.watched(problem.law, advance, stop)
            history = FieldHistory(
                problem.space, problem.law.description, prepared.boundaries, prepared.supported, problem.program
            )
            record.details["columns"] = units(history.names)
            try:
                recorder = FieldRecorder(
                    folder,
                    problem,
                    history,
                    loaded.scene.output.every,
                    advance,
                    checkpoints,
                    resumed,
                    loaded.scene.output.compression,
                    prepared.probes,
                    hosts.in_pieces(team),
                )
                files.remove_unfinished(folder)
                record.write()
                stress_paths = effects_audit.StressPaths(problem)

                def on_step(step: StepResult) -> None:
                    stress_paths.add(step)
                    initial_balance.report_release(balance, step, record, screen)
                    report_body(step, screen)
                    recorder(step)

                with recorder:
                    summary = hosts.solving(team, recorder, loaded.scene.output)(
                        problem,
                        prepared.control,
                        on_step=on_step,
                        stop=stop,
                        resume=resumed,
                        on_checkpoint=grains_run.kept(problem.law, recorder.save),
                        clock=watch.clock,
                    )
                    recorder.close()
            except ControlError as error:
                raise InputError(f"cannot go on: {error} (start anew without --resume)") from error
            except (OutputError, OSError) as error:
                raise record.broken_off(f"results cannot be written any more: {error}") from error
            except KeyboardInterrupt as error:
                more = grains_run.how_to_go_on(problem.law)
                raise record.broken_off(f"interrupted within a step{more}") from error
            except RunError as error:  # workers that are gone
                raise record.broken_off(str(error)) from error
        _finish(record, summary, stop.requested, balance, problem)
        record.timing["output"] += recorder.closing
        record.timing["writer"] = recorder.writing
        if summary.failed_point is not None and record.outcome == "failed":
            write_failed_point(folder, summary.failed_point, problem.law, record.scene)
        record.timing["compilation"] = watch.seconds + waited
        audit = None
        # of a run that goes on the stress paths of the first part are not known
        if record.outcome == "finished" and resumed is None and not grains:
            with record.phase("audit", watch):
                audit = effects_audit.audit_field(loaded, problem, stress_paths)
        if record.outcome == "finished" and loaded.scene.closed_form is not None:
            comparison.write(folder, record, comparison.compare(loaded, problem, recorder.last))
        if record.outcome == "finished":
            with record.phase("mesh_error", watch):
                mesh_error_estimate.estimate(folder, record, problem, recorder.last)
        record.write()
        if loaded.scene.output.pictures:
            from granfabric.cases.pictures.draw import draw

            with record.phase("pictures"):
                draw(folder, record.scene)
            record.write()
        if record.outcome == "finished":
            checkpoints.remove()
    _report(history, summary, record, screen)
    mesh_error_estimate.report(record, screen)
    comparison.report(record, screen)
    if audit is not None:
        effects_audit.conclude(audit, loaded, record, screen)
        record.write()
    return record


def _last_checkpoint(checkpoints: CheckpointFolder, earlier: dict[str, Any], screen: Screen) -> Checkpoint | None:
    """Where to go on; None if the run had not accepted a step yet."""
    try:
        resumed, damages = checkpoints.load()
    except CheckpointError as error:
        raise InputError(f"cannot go on: {error} (start anew without --resume)") from error
    for text in damages:
        screen.say(f"{text}; going on from the one before")
    other = resumption.other_versions(earlier)
    if other:
        screen.say(f"other versions than when the run began ({', '.join(other)}): last digits may differ")
    if resumed is None:
        screen.say("no step was finished; starting at the beginning")
    else:
        screen.say(f"going on after step {resumed.result.step}")
    return resumed


def _compile(
    loaded: LoadedScene, kernels: EarlyKernels | None, watch: CompileWatch, stop: Callable[[], bool]
) -> float:
    """Compile the host's kernels and the law's second one while another process compiles the first one.

    Returns
    -------
    float
        Seconds spent waiting for the other process.
    """
    if kernels is None or not kernels.running:
        return 0.0
    watch.announce()
    fem_warm_up.warm_up()
    for name in build.kernels(loaded)[1:]:
        if kernels.running and not stop() and not constitutive_warm_up.cached(name):
            constitutive_warm_up.warm_up(name)
    if loaded.scene.output.pictures:  # imported now, it costs no time later
        import_module("granfabric.cases.pictures.field")
    return kernels.wait(stop)


def _finish(
    record: Record,
    summary: RunSummary,
    stopped: bool,
    balance: initial_balance.Balance,
    problem: Problem,
) -> None:
    record.outcome = "finished" if summary.finished else "stopped" if stopped else "failed"
    record.message = summary.message
    if record.outcome == "failed":
        record.message += _failed_place(record, summary, problem) + balance.reminder(summary.stage)
    record.details["counters"] = dict(summary.counters)
    record.details["linear_solver"] = summary.solver
    if summary.band_fraction > 0.0:
        record.details["band_fraction"] = summary.band_fraction
    record.details["reached"] = {"stage": summary.stage, "fraction": summary.fraction}
    record.timing.update(summary.seconds)


def _failed_place(record: Record, summary: RunSummary, problem: Problem) -> str:
    """Where the law could not be followed, how far the stress had come there, and what bounds it."""
    failed = summary.failed_point
    if failed is None:
        return ""
    xx, yy, xy = effective_stress(failed.stress_start, failed.state_start, problem.law.description).tolist()
    pressure, deviator = -0.5 * (xx + yy), float(np.hypot(0.5 * (xx - yy), xy))
    said = f" (point {failed.point} at ({failed.position[0]:.4g}, {failed.position[1]:.4g}) m"
    mesh = problem.space.host_mesh
    if len(mesh.regions) > 1 and (region := region_at(mesh, int(problem.space.point_cell[failed.point]))):
        said += f" in region {region!r}"
    ratio = deviator / pressure if pressure > 0.0 else 0.0
    if ratio:
        said += f", q/p = {ratio:.3g}"
    if ratio > UNBOUNDED and "effects" in record.scene and not record.scene["effects"]["sliding"]:
        said += "; without effects.sliding the law has no strength, and q/p grows with the strain"
    return f"{said}; {files.FAILED_POINT} holds it)"


def _report(history: FieldHistory, summary: RunSummary, record: Record, screen: Screen) -> None:
    columns = dict(zip(history.names, zip(*history.rows)))
    axial = max(("strain_xx", "strain_yy", "strain_xy"), key=lambda name: float(np.abs(columns[name]).max()))
    rows = []
    for row in spread(len(history.rows), 8):
        p, q = columns["effective_p" if "effective_p" in columns else "p"][row], columns["q"][row]
        rows.append(
            [
                str(columns["step"][row]),
                columns["stage"][row],
                f"{columns[axial][row] * 1e6:.1f}",
                f"{q / p:.4f}" if p else "-",
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
    if summary.band_fraction > 0.0:
        screen.say(
            f"shear bands may form at the end of the run on {100 * summary.band_fraction:.2g} % of the area, where the "
            "acoustic tensor of the tangent is not positive: equilibrium need not be unique, and load and pattern "
            "depend on the mesh"
        )
    limited = [int(count) for count in columns["limited_points"]]
    if any(limited):
        first = next(row for row, count in enumerate(limited) if count)
        screen.say(
            f"rates were clipped at the limit of realisability, at up to {max(limited)} of "
            f"{size['integration_points']} points, first in step {columns['step'][first]}"
        )
    pulls = pulling_stress(record.scene, columns["step"], columns["stress_ratio_largest"], " at some points")
    if pulls:
        screen.say(pulls)
        record.details["pulling"] = pulls
        record.write()
    pore_columns.tell(columns, "pore_pressure_smallest", record, screen)
    if record.outcome != "finished":
        where = f"{record.outcome} in stage {summary.stage!r} at {summary.fraction:.0%}"
        screen.say(f"{where}: {record.message}", insist=True)
    screen.say(
        f"{record.timing['total']:.1f} s in all, of which compilation {record.timing['compilation']:.1f} s, "
        f"law {summary.seconds.get('law', 0.0):.1f} s, linear solver "
        f"{summary.seconds.get('factorise', 0.0) + summary.seconds.get('solve', 0.0):.1f} s; results in {record.folder}"
    )
