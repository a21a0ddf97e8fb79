"""A specimen of disks between platens and membranes: `granfabric dem` with a scene of the kind "specimen"."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from granfabric.cases.errors import InputError, RunError
from granfabric.cases.records import files
from granfabric.cases.records.dem_series import FieldGrid
from granfabric.cases.records.record import Record, resolved, versions
from granfabric.cases.records.specimen_series import SpecimenSeries, history_text
from granfabric.cases.records.units import units
from granfabric.cases.scene.dem_path import PathError, packing_options
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.scene.specimen_path import specimen_legs, specimen_options, strain_step
from granfabric.cases.terminal.compile_watch import CompileWatch, watching
from granfabric.cases.terminal.interruption import InterruptRequest, interrupt_request
from granfabric.cases.terminal.screen import Screen, spread
from granfabric.dem_ref.dynamics.motion import UnstableMotionError
from granfabric.dem_ref.dynamics.packing import PackingError
from granfabric.dem_ref.inputs.probes import ProbeError
from granfabric.dem_ref.sample.disks import Sample, SampleError, load_sample
from granfabric.dem_ref.sample.neighbours import CellTooSmallError
from granfabric.dem_ref.specimen.membrane import MembraneError
from granfabric.dem_ref.specimen.run import SpecimenRun

from .dem import COMPILATION_SECONDS, StoppedError, made_packing, resting, take_over

PHASES = ("packing", "loading")


def run_specimen(
    loaded: LoadedScene, folder: Path, screen: Screen, resume: bool = False, overwrite: bool = False
) -> Record:
    """Compute a scene of a specimen and write its files; parameters, results and errors as of `dem.run_dem`."""
    loaded.require("specimen")
    scene = loaded.scene
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
        kept: tuple[Sample | None, SpecimenRun | None] = (None, None)
        if resume:
            take_over(folder, record)  # refuses before anything is made
        hold.enter_context(files.held(folder, owner, overwrite, resume))
        if resume:
            take_over(folder, record)
            kept = _kept(folder, loaded)
        else:
            files.prepare_output(folder, owner, overwrite)
        record.write()
        screen.keep_log(folder / files.LOG, versions())
        run = kept[1]
        try:
            if run is None:
                made = kept[0] or made_packing(scene, packed, record, screen, stop, watch)
                sample = resting(made, record, screen)
                run = SpecimenRun(sample, specimen_options(scene), specimen_legs(scene), strain_step(scene))
            _load(loaded, run, record, screen, stop, watch)
        except StoppedError:
            record.outcome, record.message = "stopped", "stopped while packing"
        except (PackingError, CellTooSmallError, SampleError, ProbeError, UnstableMotionError, MembraneError) as error:
            record.outcome, record.message = "failed", str(error)
        except KeyboardInterrupt as error:
            raise record.broken_off("interrupted within a step") from error
        except OSError as error:
            raise record.broken_off(f"results cannot be written any more: {error}") from error
    record.timing["compilation"] = watch.seconds
    record.write()  # before the pictures: an interruption of theirs does not make the run unfinished
    if run is not None and run.specimen.rows and scene.output.pictures:
        from granfabric.cases.pictures.draw import draw

        try:
            with record.phase("pictures"):
                draw(folder, record.scene)
        except KeyboardInterrupt as error:
            raise RunError(f"interrupted while drawing; `granfabric plot {folder}` makes the pictures") from error
    record.write()
    _report(run, record, screen)
    return record


def _kept(folder: Path, loaded: LoadedScene) -> tuple[Sample | None, SpecimenRun | None]:
    """Packing and checkpoint of the run to go on with; refuses damaged ones before anything is changed."""
    packing, checkpoint, scene = folder / files.PACKING, folder / files.CHECKPOINT, loaded.scene
    try:
        sample = load_sample(packing) if packing.is_file() else None
        if sample is None or not checkpoint.is_file():
            return sample, None
        return sample, SpecimenRun.resume(
            checkpoint, specimen_options(scene), specimen_legs(scene), strain_step(scene)
        )
    except SampleError as error:
        raise InputError(f"cannot go on: {error} (start anew without --resume)") from error


def _load(
    loaded: LoadedScene, run: SpecimenRun, record: Record, screen: Screen, stop: InterruptRequest, watch: CompileWatch
) -> None:
    """Carry the specimen along its path, on from the checkpoint if there is one."""
    folder, output, specimen = record.folder, loaded.scene.output, run.specimen
    before, spent = specimen.steps_done, record.timing.get("loading", 0.0)
    grid = FieldGrid(output.field_cells, output.field_kernel, output.field_scale) if output.field_cells else None
    series = SpecimenSeries(folder, run, output.every, len(specimen.rows) - 1, grid)

    def on_record(state: SpecimenRun) -> None:
        if state.specimen.rows:
            files.write_text(folder / files.HISTORY, history_text(state))
            series.add(state)

    with screen.progress(loaded.name, 1.0) as advance, record.phase("loading", watch):

        def progress(state: SpecimenRun) -> None:
            at = "consolidation"
            if state.specimen.start is not None:
                number = min(state.leg + 1, len(state.legs))
                at = f"leg {number}, axial strain {state.specimen.axial_strain:.3g}"
            unbalanced = f"unbalanced force {state.specimen.unbalanced_force:.1e}"
            advance(state.completed_fraction(), f"{at}, {unbalanced}")

        on_record(run)
        run.execute(progress, stop, on_record, folder / files.CHECKPOINT, output.checkpoint_seconds)
        on_record(run)
    record.outcome = "stopped" if not run.finished else "failed" if run.reason else "finished"
    record.message = "" if run.finished else "stopped; continue with --resume"
    if run.reason:
        where = "" if specimen.start is None else f"leg {min(run.leg_of_row[-1], len(run.legs))}: "
        record.message = f"{where}{run.reason}"
    record.details["not_reached"] = run.not_reached
    record.details["dem_steps"] = specimen.steps_done
    record.details["records"] = len(specimen.rows)
    record.details["columns"] = units(run.history() if specimen.rows else ())
    if specimen.start is not None:
        record.details["specimen"] = {
            "disks": specimen.sample.count,
            "height": specimen.start.height,
            "width": specimen.start.width,
            "lateral_pressure": specimen.pressure,
        }
    steps, seconds = specimen.steps_done - before, record.timing["loading"] - spent
    if steps > 0 and seconds > 0.0:
        record.details["million_particle_steps_a_second"] = steps * specimen.sample.count / seconds / 1e6


_TABLE = ("stress_ratio", "coordination", "fabric_anisotropy", "sliding_fraction")


def _report(run: SpecimenRun | None, record: Record, screen: Screen) -> None:
    if run is not None and run.specimen.rows:
        h = run.history()
        rows = [
            [
                f"{int(h['leg'][row])}",
                f"{h['axial_strain'][row] * 1e6:.1f}",
                f"{h['volumetric_strain'][row] * 1e6:.1f}",
                f"{h['axial_stress'][row] / 1e3:.2f}",
                *(f"{h[name][row]:.4f}" for name in _TABLE),
            ]
            for row in spread(len(h["leg"]), 9)
        ]
        head = ["leg", "axial [1e-6]", "volume [1e-6]", "axial [kPa]", "q/p", "z", "a_c", "sliding"]
        screen.table(record.scene["title"], head, rows)
        start = run.specimen.start
        assert start is not None
        screen.say(
            f"{run.specimen.sample.count} disks, {start.width:.4g} m wide and {start.height:.4g} m high, under "
            f"{run.specimen.pressure / 1e3:.4g} kPa; unbalanced force up to {h['unbalanced_force'].max():.1e}"
        )
        for line in run.not_reached:
            screen.say(line, insist=True)
    if record.outcome != "finished":
        screen.say(f"{record.outcome}: {record.message}", insist=True)
    phases = ", ".join(
        f"{name} {record.timing[name]:.1f} s" for name in (*PHASES, "compilation") if name in record.timing
    )
    screen.say(f"{phases}; results in {record.folder}")
