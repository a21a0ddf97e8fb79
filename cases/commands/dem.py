"""Packing, measurement and loading of disks by the discrete element method: `granfabric dem`."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from granfabric.cases.errors import InputError, RunError
from granfabric.cases.records import files
from granfabric.cases.records.dem_series import DemSeries, FieldGrid, history_text
from granfabric.cases.records.record import Record, resolved, versions
from granfabric.cases.records.units import units
from granfabric.cases.scene.dem_path import PathError, leg_numbers, packing_options, run_options
from granfabric.cases.scene.material_file import material_text, read_material, refusal
from granfabric.cases.scene.measured import Inputs, as_data, from_data, inputs_of, measure_inputs, refused, warnings
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.terminal.compile_watch import CompileWatch, watching
from granfabric.cases.terminal.interruption import InterruptRequest, interrupt_request
from granfabric.cases.terminal.screen import Screen, spread
from granfabric.dem_ref.dynamics.motion import UnstableMotionError
from granfabric.dem_ref.dynamics.packing import PackingError, PackingOptions
from granfabric.dem_ref.inputs.probes import ProbeError, at_rest
from granfabric.dem_ref.inputs.sliding import measure_sliding_with_errors
from granfabric.dem_ref.inputs.weak_contacts import LOOP_STRESS_RATIO
from granfabric.dem_ref.loading.legs import axial_stress_ratio
from granfabric.dem_ref.loading.run import DemRun, RunOptions
from granfabric.dem_ref.measures.contacts import contacts_of, coordination_number, unbalanced_force
from granfabric.dem_ref.preparation.compaction import Prepared, prepare_packing
from granfabric.dem_ref.preparation.grading import grading_of, largest_departure
from granfabric.dem_ref.sample.disks import Sample, SampleError, load_sample, save_sample
from granfabric.dem_ref.sample.neighbours import CellTooSmallError

COMPILATION_SECONDS = 15
"""Rough time to compile the kernels of the DEM, for the message on first use."""


PHASES = ("packing", "measuring", "loading")

NEAR = 0.01
"""A leg driven to a stress ratio has reached it within this."""


class StoppedError(Exception):
    """Ctrl-C between two parts of the packing."""


def measured_inputs(
    sample: Sample, rattlers: str = "included", loop_stress_ratio: float = LOOP_STRESS_RATIO
) -> dict[str, float]:
    """The values of `measured.measure_inputs`, by the names of scene keys, without what the packing does not give."""
    return measure_inputs(sample, rattlers, loop_stress_ratio).values


def run_dem(
    loaded: LoadedScene, folder: Path, screen: Screen, resume: bool = False, overwrite: bool = False
) -> Record:
    """Compute a DEM scene and write its files.

    Parameters
    ----------
    loaded : LoadedScene
        Of kind "dem".
    folder : Path
        Result folder: new, empty, or of an earlier run of the same scene, which is replaced, or continued with
        `resume`.
    screen : Screen
    resume : bool
        Go on from the packing or the checkpoint in the folder.
    overwrite : bool
        Replace results of another scene too.

    Returns
    -------
    Record
        As written to `run.json`; `outcome` is "finished", "stopped" or "failed".

    Raises
    ------
    InputError
        If the scene is of another kind, a leg does not follow, or the folder cannot be used; then nothing was written.
    RunError
        If the run broke off within a step; what was written before can be resumed.
    """
    scene = loaded.scene
    loaded.require("dem")
    try:
        options = run_options(scene)
    except PathError as error:
        raise loaded.error(["path"], str(error)) from error
    try:
        packed = packing_options(scene, loaded.file.parent)
    except PathError as error:
        raise loaded.error(["packing", "grading_file"], str(error)) from error
    owner = loaded.owner
    record = Record(folder, loaded.name, resolved(loaded, None), scene_file=owner.place)
    with (
        watching(screen.announce_compilation(COMPILATION_SECONDS)) as watch,
        interrupt_request(screen.announce_stop) as stop,
        ExitStack() as hold,
    ):
        kept: tuple[Sample | None, DemRun | None] = (None, None)
        if resume:
            take_over(folder, record)  # refuses before anything is made
        hold.enter_context(files.held(folder, owner, overwrite, resume))
        if resume:
            take_over(folder, record)
            kept = _kept(folder, options)
        else:
            files.prepare_output(folder, owner, overwrite)
        record.write()
        screen.keep_log(folder / files.LOG, versions())
        try:
            sample = resting(kept[0] or made_packing(scene, packed, record, screen, stop, watch), record, screen)
            _measure(scene, sample, record, screen, watch)
            run = kept[1] or DemRun(sample, options)
            _load(loaded, run, sample, record, screen, stop, watch)
            if scene.measure.sliding and run.finished:
                _measure_sliding(scene, run, record, screen)
        except StoppedError:
            record.outcome, record.message = "stopped", "stopped while packing"
            run = None
        except (PackingError, CellTooSmallError, SampleError, ProbeError, UnstableMotionError) as error:
            record.outcome, record.message = "failed", str(error)
            run = None
        except KeyboardInterrupt as error:
            raise record.broken_off("interrupted within a step") from error
        except OSError as error:
            raise record.broken_off(f"results cannot be written any more: {error}") from error
    record.timing["compilation"] = watch.seconds
    record.write()  # before the pictures: an interruption of theirs does not make the run unfinished
    if run is not None and scene.output.pictures:
        from granfabric.cases.pictures.draw import draw

        try:
            with record.phase("pictures"):
                draw(folder, record.scene)
        except KeyboardInterrupt as error:
            raise RunError(f"interrupted while drawing; `granfabric plot {folder}` makes the pictures") from error
    record.write()
    _report(run, record, screen)
    return record


def run_disks(
    loaded: LoadedScene, folder: Path, screen: Screen, resume: bool = False, overwrite: bool = False
) -> Record:
    """Compute a scene of the DEM: a periodic packing (`run_dem`) or a specimen (`specimen.run_specimen`)."""
    if loaded.scene.kind == "specimen":
        from .specimen import run_specimen

        return run_specimen(loaded, folder, screen, resume, overwrite)
    return run_dem(loaded, folder, screen, resume, overwrite)


def take_over(folder: Path, record: Record) -> None:
    """Go on with the record of a folder; refuse one that holds no DEM run of the same scene."""
    earlier = files.whole_record(folder)
    if earlier is None or earlier.get("kind") != record.scene["kind"]:
        raise InputError(f"{str(folder)!r} holds no DEM run to resume; leave out --resume to begin one")
    for section in ("packing", "specimen", "path", "rates", "measure", "output"):
        if earlier["scene"].get(section) != record.scene.get(section):
            raise InputError(
                f"{str(folder)!r} holds a run with another [{section}]; resume it with the same scene and --set, "
                "or leave out --resume to begin anew"
            )
    record.started = earlier.get("started", record.started)
    for phase in PHASES:
        if phase in earlier.get("timing", {}):
            record.timing[phase] = earlier["timing"][phase]
    for entry in ("preparation", "material", "measured", "sliding", "million_particle_steps_a_second"):
        if entry in earlier:
            record.details[entry] = earlier[entry]


def _kept(folder: Path, options: RunOptions) -> tuple[Sample | None, DemRun | None]:
    """Packing and checkpoint of the run to go on with; refuses damaged ones before anything is changed."""
    packing, checkpoint = folder / files.PACKING, folder / files.CHECKPOINT
    try:
        sample = load_sample(packing) if packing.is_file() else None
        return sample, DemRun.resume(checkpoint, options) if sample is not None and checkpoint.is_file() else None
    except SampleError as error:
        raise InputError(f"cannot go on: {error} (start anew without --resume)") from error


def made_packing(
    scene: Any, options: PackingOptions, record: Record, screen: Screen, stop: InterruptRequest, watch: CompileWatch
) -> Sample:
    """The packing, made and stored."""
    with screen.progress("packing", 1.0) as advance, record.phase("packing", watch):

        def report(text: str, fraction: float) -> None:
            advance(fraction, text)
            if stop.requested:
                raise StoppedError

        made = prepare_packing(scene.packing.particles, scene.packing.seed, options, report)
    save_sample(record.folder / files.PACKING, made.sample)
    _tell_preparation(made, options, record, screen)
    return made.sample


def _tell_preparation(made: Prepared, options: PackingOptions, record: Record, screen: Screen) -> None:
    """Say and record how the packing was compacted and graded, as measured on it."""
    grading = grading_of(made.sample.radius)
    record.details["preparation"] = {"friction": made.friction, "trials": made.trials, "diameters": grading}
    if options.grading is not None:
        record.details["preparation"]["grading_departure"] = largest_departure(made.sample.radius, options.grading)
    if made.friction > 0.0:
        searched = f", found in {len(made.trials)} compactions" if made.trials else ""
        screen.say(
            f"compacted with friction {made.friction:.4g}{searched}; solid fraction {made.sample.solid_fraction:.4f}"
        )
    if options.distribution in ("lognormal", "given"):
        screen.say(
            f"diameters {grading['smallest']:.4g} to {grading['largest']:.4g} m, mean {grading['mean']:.4g} m; "
            f"{grading['d10']:.4g}, {grading['d50']:.4g} and {grading['d90']:.4g} m pass 10, 50 and 90 % of the area"
        )


def resting(sample: Sample, record: Record, screen: Screen) -> Sample:
    """The packing at rest: itself, or a copy held at its stress until it is."""
    resting = at_rest(sample)
    if resting is not sample:
        unbalanced = unbalanced_force(sample)
        record.details["settled_from_unbalanced_force"] = unbalanced
        screen.say(
            f"the packing is not at rest (unbalanced force {unbalanced:.2g}): a copy, held at its stress until it is, "
            "is measured and loaded"
        )
    return resting


def _measure(scene: Any, sample: Sample, record: Record, screen: Screen, watch: CompileWatch) -> None:
    """Measure the inputs of the point law once, to `material.toml`."""
    contacts = contacts_of(sample)
    z = coordination_number(sample, contacts)
    record.details["packing"] = {
        "particles": sample.count,
        "contacts": contacts.count,
        "void_ratio": sample.void_ratio,
        "coordination": z.all_particles,
        "coordination_without_rattlers": z.without_rattlers,
        "unbalanced_force": unbalanced_force(sample, contacts),
    }
    path = record.folder / files.MATERIAL
    if path.is_file() or not scene.measure.material:
        return
    with screen.progress("measuring", 1.0) as advance, record.phase("measuring", watch):
        advance(0.0, "probes and a loop on copies of the packing")
        try:
            measured = measure_inputs(sample, scene.measure.rattlers, scene.measure.loop_stress_ratio)
        except (ProbeError, SampleError) as error:
            record.details["material"] = f"not measured: {error}"
            screen.say(f"the inputs of the point law could not be measured: {error}", insist=True)
            return
    files.write_text(path, material_text(measured.values, record.scene["title"], measured.errors, measured.missing))
    record.details["material"] = files.MATERIAL
    record.details["measured"] = as_data(measured)


def _measure_sliding(scene: Any, run: DemRun, record: Record, screen: Screen) -> None:
    """Add the parameters of sliding, from the first leg, to `material.toml`."""
    path = record.folder / files.MATERIAL
    if not path.is_file():
        return
    tables = read_material(path)
    both = {**tables["material"], **tables.get("closure", {})}
    measured = {name: value for name, value in both.items() if isinstance(value, float)}
    history = run.history()
    # the last record of a leg already bears the number of the next
    last = int(np.argmax(history["segment"] > 0)) or len(history["segment"]) - 1
    history = {name: column[: last + 1] for name, column in history.items()}
    try:
        found, misfit = measure_sliding_with_errors(history, measured, scene.measure.rattlers)
    except SampleError as error:
        record.details["sliding"] = f"not measured: {error}"
        screen.say(f"the parameters of sliding could not be measured: {error}", insist=True)
        return
    sliding = {name: entry.value for name, entry in found.items()}
    before = from_data(record.details.get("measured"))
    every = before.joined(inputs_of(found))
    text = material_text(measured | sliding, record.scene["title"], every.errors, before.missing)
    files.write_text(path, text)
    record.details["sliding"] = {**sliding, "misfit": misfit}
    record.details["measured"] = as_data(every)
    screen.say(
        f"sliding: peak {sliding['peak_stress_ratio']:.3f}, reference strain "
        f"{sliding['reference_plastic_strain']:.2e}, dilatancy {sliding['dilatancy']:.2f} from q/p = "
        f"{sliding['constant_volume_stress_ratio']:.2f} on; q/p at given strain within {100 * misfit:.1f} % of the run"
    )


def _load(
    loaded: LoadedScene,
    run: DemRun,
    sample: Sample,
    record: Record,
    screen: Screen,
    stop: InterruptRequest,
    watch: CompileWatch,
) -> None:
    """Carry the sample along its path, on from the checkpoint if there is one."""
    folder, output = record.folder, record.scene["output"]
    checkpoint = folder / files.CHECKPOINT
    resumed = checkpoint.is_file()
    before, spent = run.motion.steps_done, record.timing.get("loading", 0.0)
    grid = None
    if output["field_cells"]:
        grid = FieldGrid(output["field_cells"], output["field_kernel"], output.get("field_scale"))
    series = DemSeries(folder, sample, output["every"], len(run.rows) - 1 if resumed else -1, grid)

    def on_record(state: DemRun) -> None:
        files.write_text(folder / files.HISTORY, history_text(state))
        series.add(len(state.rows) - 1, state.sample, last=state.finished)

    numbers = leg_numbers(loaded.scene)
    with screen.progress(loaded.name, 1.0) as advance, record.phase("loading", watch):

        def progress(state: DemRun) -> None:
            row = state.rows[-1]
            leg = numbers[min(int(row[-1]), len(numbers) - 1)]
            advance(state.completed_fraction(), f"leg {leg}, q/p = {_ratio(row[8], row[7])}")

        on_record(run)
        run.execute(progress, stop, on_record, checkpoint, output["checkpoint_seconds"])
    on_record(run)
    record.outcome = "stopped" if not run.finished else "failed" if run.reason else "finished"
    record.message = "" if run.finished else "stopped; continue with --resume"
    if run.reason:
        record.message = f"leg {numbers[run.segment - 1]}: {run.reason}"
    record.details["not_reached"] = _not_reached(run, numbers)
    record.details["dem_steps"] = run.motion.steps_done
    record.details["records"] = len(run.rows)
    record.details["columns"] = units(run.history())
    steps, seconds = run.motion.steps_done - before, record.timing["loading"] - spent
    if steps > 0 and seconds > 0.0:
        record.details["million_particle_steps_a_second"] = steps * sample.count / seconds / 1e6


def _not_reached(run: DemRun, numbers: list[int]) -> list[str]:
    """Legs that ended at their largest strain, not at their stress ratio, or ran past it."""
    h = run.history()
    found = []
    for place, segment in enumerate(run.options.segments):
        after = np.flatnonzero(h["segment"] > place)  # the last record of a leg already bears the number of the next
        given_up = bool(run.reason) and place == run.segment - 1
        if segment.kind != "biaxial" or segment.stress_ratio is None or len(after) == 0 or given_up:
            continue
        stress = np.array([h[f"stress_{name}"][after[0]] for name in ("xx", "yy", "xy")])
        ratio = axial_stress_ratio(stress, segment.angle)
        if np.sign(segment.shear_strain) * (segment.stress_ratio - ratio) > NEAR:
            found.append(
                f"leg {numbers[place]} ended at its largest strain of {abs(segment.shear_strain):g}, at q/p = "
                f"{ratio:.3f} instead of {segment.stress_ratio:g}"
            )
        elif abs(segment.stress_ratio - ratio) > NEAR:
            found.append(
                f"leg {numbers[place]} ran past its end, to q/p = {ratio:.3f} instead of {segment.stress_ratio:g}: the "
                "loading is too fast for the packing (see [rates])"
            )
    return found


def _ratio(q: float, p: float, digits: int = 3) -> str:
    """q/p, or a dash where no pressure is left."""
    return f"{q / p:.{digits}f}" if p > 0.0 else "-"


def _report(run: DemRun | None, record: Record, screen: Screen) -> None:
    if run is not None:
        h = run.history()
        rows = [
            [
                f"{int(h['segment'][max(row - 1, 0)]) + 1}",  # the last record of a leg counts it as done
                f"{(h['strain_xx'][row] - h['strain_yy'][row]) * 1e6:.1f}",
                f"{h['p'][row] / 1e3:.2f}",
                _ratio(h["q"][row], h["p"][row], 4),
                *(f"{h[name][row]:.4f}" for name in _TABLE),
            ]
            for row in spread(len(h["p"]), 9)
        ]
        head = ["part", "e_xx-e_yy [1e-6]", "p [kPa]", "q/p", "z", "a_c", "a_n", "a_t", "f/f0", "sliding"]
        screen.table(record.scene["title"], head, rows)
        packing = record.details["packing"]
        screen.say(
            f"{packing['particles']} disks, void ratio {packing['void_ratio']:.4f}, z {packing['coordination']:.3f} "
            f"({packing['coordination_without_rattlers']:.3f} without rattlers); "
            f"inertial number up to {h['inertial_number'].max():.1e}, "
            f"unbalanced force up to {h['unbalanced_force'].max():.1e}"
        )
        for line in record.details["not_reached"]:
            screen.say(line, insist=True)
    measured = from_data(record.details.get("measured"))
    doubtful = doubts(measured)
    for line in doubtful:
        screen.say(f"{files.MATERIAL}: {line}", insist=True)
    if record.outcome != "finished":
        screen.say(f"{record.outcome}: {record.message}", insist=True)
    phases = ", ".join(
        f"{name} {record.timing[name]:.1f} s" for name in (*PHASES, "compilation") if name in record.timing
    )
    many = "s" if len(doubtful) > 1 else ""
    warned = f"; {len(doubtful)} warning{many} on {files.MATERIAL}" if doubtful else ""
    if illegal := refused(measured):
        warned += f", the law will refuse {', '.join(illegal)}"
    screen.say(f"{phases}; results in {record.folder}{warned}")


def doubts(measured: Inputs) -> list[str]:
    """One line for each measured value that is in doubt, or that the law will refuse."""
    said = warnings(measured)
    complaint = "" if refused(measured) or not measured.values else refusal(measured.values)
    return [*said, f"the law will refuse it: {complaint}"] if complaint else said


_TABLE = (
    "coordination", "fabric_anisotropy", "normal_force_anisotropy", "tangential_force_anisotropy",
    "mean_normal_force", "sliding_fraction",
)  # fmt: skip
