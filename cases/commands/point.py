"""One material point along a path of stress or strain: `granfabric point`."""

from __future__ import annotations

import time
from pathlib import Path

from granfabric.cases.effects import audit as effects_audit
from granfabric.cases.effects import report as effects_report
from granfabric.cases.effects.resolve import resolve_point
from granfabric.cases.field import memory
from granfabric.cases.grains.law import GrainsLaw
from granfabric.cases.grains.point_path import drive_point
from granfabric.cases.records import files, pore_columns
from granfabric.cases.records.pulling import pulling_stress
from granfabric.cases.records.record import Record, resolved, versions
from granfabric.cases.records.replay import start_state
from granfabric.cases.records.units import units
from granfabric.cases.scene import build, magnitudes
from granfabric.cases.scene.drainage import without_fluid
from granfabric.cases.scene.effects_choice import resolve_effects
from granfabric.cases.scene.point_path import legs_of, remarks
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.scene.schema_law_kind import is_grains
from granfabric.cases.terminal.compile_watch import watching
from granfabric.cases.terminal.interruption import interrupt_request
from granfabric.cases.terminal.screen import Screen, spread
from granfabric.constitutive.path import PathHistory, drive

from . import point_start
from .point_start import PointStart

COMPILATION_SECONDS = 75
"""Rough time to compile the kernels of the point law, for the message on first use."""

BYTES_PER_STEP = 1000
"""Memory that a row of the history takes."""

AUDITED_INCREMENTS = 20_000
"""Longest path that is gone through again for what was left out."""

TABLE_COLUMNS = ("step", "p", "q", "coordination", "fabric_anisotropy", "normal_force_anisotropy", "mean_normal_force")


def run_point(loaded: LoadedScene, folder: Path, screen: Screen, overwrite: bool = False) -> Record:
    """Compute a point scene and write its files.

    Parameters
    ----------
    loaded : LoadedScene
        Of kind "point".
    folder : Path
        Result folder: new, empty, or of an earlier run of the same scene, which is replaced.
    screen : Screen
    overwrite : bool
        Replace results of another scene too.

    Returns
    -------
    Record
        As written to `run.json`; `outcome` is "finished", "stopped" or "failed".

    Raises
    ------
    InputError
        If the scene is of another kind or the folder cannot be used; then nothing was written.
    RunError
        If the run broke off within the first step; later interruptions wait for its files.
    """
    since, owner = time.perf_counter(), loaded.owner
    loaded.require("point")
    increments = refuse_too_long(loaded)
    legs = legs_of(loaded.scene)
    files.check_output(folder, owner, overwrite)
    initial = loaded.scene.initial.stress
    doubts = (*without_fluid(loaded), *magnitudes.hints(loaded, -0.5 * (initial[0] + initial[1])))
    for text in (*remarks(loaded.scene), *doubts):
        screen.say(text)
    made = point_start.begin(loaded, screen) if is_grains(loaded.scene) else _begin(loaded, screen)
    loaded, scene, effects, law = made.loaded, made.loaded.scene, made.effects, made.law
    with files.held(folder, owner, overwrite):
        files.prepare_output(folder, owner, overwrite)
        record = Record(folder, loaded.name, resolved(loaded, effects), scene_file=owner.place, since=since)
        if made.decision is not None:
            record.details["decision"] = effects_report.as_data(made.decision)
        record.write()
        screen.keep_log(folder / files.LOG, versions())
        total = sum(leg.increments for leg in legs)
        with interrupt_request(screen.announce_stop) as stop:
            with (
                watching(screen.announce_compilation(COMPILATION_SECONDS)) as watch,
                screen.progress(loaded.name, total) as advance,
                record.phase("path"),
            ):

                def on_step(done: int, of: int) -> None:
                    # From now on there is a history to lose. Steps are short once the kernels are compiled.
                    stop.shielded = True
                    advance(done, f"step {done} of {of}")

                try:
                    if isinstance(law, GrainsLaw):
                        assert made.state is not None
                        history = drive_point(law, scene.initial.stress, legs, made.state, on_step, stop)
                    else:
                        start = build.pore_pressure(loaded, law)
                        history = drive(law, scene.initial.stress, legs, on_step, stop, made.state, start)
                except KeyboardInterrupt as error:
                    raise record.broken_off("interrupted within the first step") from error
            record.timing["compilation"] = made.compilation + watch.seconds
            record.timing["path"] -= watch.seconds
            names = list(history.columns)
            record.details["columns"] = units(names)
            rows = list(zip(*(history.columns[name].tolist() for name in names)))
            try:
                files.write_text(folder / files.HISTORY, files.csv_text(names, rows))
            except OSError as error:
                raise record.broken_off(f"results cannot be written: {error}") from error
            record.details["steps"] = len(rows) - 1
            record.outcome = "finished" if history.finished else "stopped" if stop.requested else "failed"
            record.message = history.message
            record.write()
        if scene.output.pictures:
            from granfabric.cases.pictures.draw import draw

            with record.phase("pictures"):
                draw(folder, record.scene)
            record.write()
        _report(history, record, screen)
        if history.finished and made.decision is not None and made.state is None and increments <= AUDITED_INCREMENTS:
            with record.phase("audit"):
                audit = effects_audit.audit_point(loaded, history)
            effects_audit.conclude(audit, loaded, record, screen)
            record.write()
        return record


def refuse_too_long(loaded: LoadedScene) -> int:
    """Increments of all legs of a point scene.

    Raises
    ------
    InputError
        If their history does not fit into memory.
    """
    increments = sum(leg.increments for leg in loaded.scene.path)
    memory.refuse_beyond(BYTES_PER_STEP * increments, f"{loaded.file}: path, {increments} increments in all,")
    return increments


def _begin(loaded: LoadedScene, screen: Screen) -> PointStart:
    """Decide the effects of the contact law, and make it."""
    with watching(screen.announce_compilation(COMPILATION_SECONDS)) as early:
        loaded, decision = resolve_point(loaded)
    effects_report.announce(decision, None, screen)
    effects = resolve_effects(loaded.scene)
    law = build.law(loaded, effects)
    return PointStart(loaded, law, start_state(loaded, law.description), effects, decision, early.seconds)


def _report(history: PathHistory, record: Record, screen: Screen) -> None:
    columns = history.columns
    carried = columns.get("effective_p", columns["p"])
    chosen = spread(len(columns["step"]), 8)
    rows = []
    for row in chosen:
        p, q = carried[row], columns["q"][row]
        values = [f"{int(columns['step'][row])}", f"{p / 1e3:.2f}", f"{q / p:.3f}"]
        rows.append(values + [f"{columns[name][row]:.4f}" for name in TABLE_COLUMNS[3:]])
    pressure = "p' [kPa]" if "effective_p" in columns else "p [kPa]"
    screen.table(record.scene["title"], ["step", pressure, "q/p", "z", "a_c", "a_n", "f/f0"], rows)
    limited = columns["limited"]
    if limited.any():
        screen.say(
            f"rates were clipped at the limit of realisability in {int(limited.sum())} of {record.details['steps']} "
            f"steps, first in step {int(columns['step'][limited.argmax()])}"
        )
    if record.outcome != "finished":
        screen.say(f"{record.outcome} after {record.details['steps']} steps: {record.message}", insist=True)
    ratios = [q / p if p > 0.0 else 0.0 for p, q in zip(carried, columns["q"])]
    pulls = pulling_stress(record.scene, [int(step) for step in columns["step"]], ratios)
    if pulls:
        screen.say(pulls)
        record.details["pulling"] = pulls
        record.write()
    pore_columns.tell(columns, "pore_pressure", record, screen)
    screen.say(
        f"{record.details['steps']} steps in {record.timing['path']:.2f} s "
        f"(compilation {record.timing['compilation']:.1f} s); results in {record.folder}"
    )
