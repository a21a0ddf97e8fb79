"""The point law against the DEM: `granfabric verify`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.engine.choice import Choice
from granfabric.cases.engine.jobs import Ended, Job
from granfabric.cases.errors import InputError
from granfabric.cases.records import files
from granfabric.cases.records.record import Record, versions
from granfabric.cases.scene.material_file import material_text
from granfabric.cases.scene.measured import as_data, mean_of, warnings
from granfabric.cases.scene.owner import Owner
from granfabric.cases.terminal.compile_watch import watching
from granfabric.cases.terminal.interruption import InterruptRequest, interrupt_request
from granfabric.cases.terminal.screen import Screen
from granfabric.cases.verify import dem_side
from granfabric.cases.verify.closures import CLOSURE_COLUMNS, PROBE_COLUMNS, closure_rows, probe_rows
from granfabric.cases.verify.dem_side import DEM_ERRORS, LOADINGS, STORE, DemStore, RunGivenUpError, SeedResult, Stopped
from granfabric.cases.verify.evaluate import evaluate
from granfabric.cases.verify.paths import PATH_COLUMNS
from granfabric.cases.verify.study import Study
from granfabric.cases.verify.table import COLUMNS, TABLE_LEVELS, Comparison, largest_errors
from granfabric.constitutive.parameters import ParameterError

Array = NDArray[np.float64]

PARTICLES, SEEDS = 2500, 1
LEAST_PARTICLES, MOST_PARTICLES, MOST_SEEDS = 200, 200_000, 100
COMPILATION_SECONDS = 60
TITLE = "Point law against DEM"
OWNER = Owner("verify", "verify", TITLE)


def run_verify(
    folder: Path,
    particles: int,
    seeds: int,
    screen: Screen,
    overwrite: bool = False,
    choice: Choice | None = None,
) -> Record:
    """Compare the point law with the DEM on the source's two loadings and write tables and figures.

    DEM runs of the same input in the folder are used again; begun ones are finished.

    Parameters
    ----------
    folder : Path
        New, empty, or of an earlier comparison; tables and figures there are replaced.
    particles : int
        Disks of a packing.
    seeds : int
        Packings, with seeds 1, 2, ...; the standard deviation between them measures the errors.
    screen : Screen
    overwrite : bool
        Replace results of a scene too.
    choice : Choice, optional
        Who computes the packings; this process, one after the other, if not given.

    Returns
    -------
    Record
        As written to `run.json`.

    Raises
    ------
    InputError
        If a number or the folder is not legal; then nothing was written.
    RunError
        If the run broke off; finished DEM runs are on disk.
    """
    refuse_numbers(particles, seeds)
    choice = choice or Choice()
    choice.check()
    with files.held(folder, OWNER, overwrite):
        files.prepare_output(folder, OWNER, overwrite)
        numbers = list(range(1, seeds + 1))
        scene = {"title": TITLE, "kind": "verify", "particles": particles, "seeds": numbers}
        record = Record(folder, "verify", scene, is_scene=False)
        record.write()
        screen.keep_log(folder / files.LOG, versions())
        study = None
        with (
            watching(screen.announce_compilation(COMPILATION_SECONDS)) as watch,
            interrupt_request(screen.announce_stop) as stop,
        ):
            try:
                with record.phase("dem", watch):
                    computed: set[int] = set()
                    if choice.workers or choice.scheduler:
                        computed = _side_by_side(folder / STORE, particles, numbers, choice, screen, stop)
                    results = _measured(DemStore(folder / STORE, particles, watch.clock), numbers, screen, stop)
                    for result in results:
                        result.computed = result.computed or result.seed in computed
                with record.phase("model", watch):
                    study = evaluate(results)
            except Stopped:
                record.outcome = "stopped"
                record.message = "stopped; the same command goes on from here"
            except (*DEM_ERRORS, ParameterError) as error:
                record.outcome, record.message = "failed", str(error)
            except KeyboardInterrupt as error:
                raise record.broken_off("interrupted within a step") from error
            except OSError as error:
                raise record.broken_off(f"results cannot be written any more: {error}") from error
        record.timing["compilation"] = watch.seconds
        if study is not None:
            try:
                _write(study, record)
            except KeyboardInterrupt as error:
                raise record.broken_off("interrupted while drawing; the same command goes on from here") from error
        record.write()
        _report(study, record, screen)
        return record


def refuse_numbers(particles: int | None, seeds: int | None) -> None:
    """Refuse numbers out of bounds; None is not given.

    Raises
    ------
    InputError
    """
    for name, value, least, most in (
        ("--particles", particles, LEAST_PARTICLES, MOST_PARTICLES),
        ("--seeds", seeds, 1, MOST_SEEDS),
    ):
        if value is not None and not least <= value <= most:
            raise InputError(f"{name} {value} is outside [{least}, {most}]")


def _side_by_side(
    store: Path, particles: int, seeds: Sequence[int], choice: Choice, screen: Screen, stop: InterruptRequest
) -> set[int]:
    """Have the DEM's results of all seeds computed; they are read from their folder afterwards.

    Returns
    -------
    set of int
        Seeds that were not there already.
    """
    store.mkdir(exist_ok=True)
    failed: list[str] = []
    computed: set[int] = set()
    with choice.engine(store, screen, stop, len(seeds)) as engine, screen.progress("DEM", float(len(seeds))) as advance:
        screen.say(f"{len(seeds)} packings; {engine.text}")
        done = 0

        def follow(job: Job, ended: Ended) -> list[Job]:
            nonlocal done
            done += 1
            if isinstance(ended.error, OSError):
                raise ended.error
            said, new = (str(ended.error), True) if ended.error is not None else ended.value
            if said:
                failed.append(said)
            elif new:
                computed.add(job.arguments[2])
            return []

        function = f"{dem_side.__name__}:complete_seed"
        jobs = [Job(f"seed-{s}", f"seed {s}", function, (store, particles, s), ("dem",)) for s in seeds]
        engine.carry_out(jobs, follow, lambda work: advance(done + sum(work.values()), "; ".join(work)), stop)
    if failed:
        raise RunGivenUpError("; ".join(failed))
    if stop.requested:
        raise Stopped
    return computed


def _measured(store: DemStore, seeds: Sequence[int], screen: Screen, stop: InterruptRequest) -> list[SeedResult]:
    """The DEM's results for all seeds."""
    results = []
    with screen.progress("DEM", float(len(seeds))) as advance:
        for place, seed in enumerate(seeds):

            def report(text: str, fraction: float, place: int = place, seed: int = seed) -> None:
                advance(place + fraction, f"packing {place + 1} of {len(seeds)} (seed {seed}): {text}")

            results.append(store.complete(seed, report, stop))
            for line in warnings(results[-1].measured):
                screen.say(f"seed {seed}: {line}")
            if stop.requested and seed != seeds[-1]:
                raise Stopped
    return results


def _write(study: Study, record: Record) -> None:
    """Tables, figures, and the measured inputs."""
    from granfabric.cases.verify.pictures import draw_verify
    from granfabric.cases.verify.text import summary

    folder = record.folder
    files.write_text(folder / "verify.csv", files.csv_text(COLUMNS, [row.row() for row in study.rows]))
    files.write_text(folder / "paths.csv", files.csv_text(PATH_COLUMNS, [row.row() for row in study.path_rows]))
    files.write_text(folder / "probes.csv", files.csv_text(PROBE_COLUMNS, probe_rows(study)))
    files.write_text(folder / "closures.csv", files.csv_text(CLOSURE_COLUMNS, closure_rows(study)))
    measured = mean_of(result.measured for result in study.results)
    count = len(study.results)
    origin = f"mean of {count} packings" if count > 1 else "one packing"
    text = material_text(measured.values, origin, measured.errors, measured.missing)
    files.write_text(folder / files.MATERIAL, text)
    files.write_text(folder / "verify.md", summary(study))
    with record.phase("pictures"):
        draw_verify(folder, study)
    record.outcome = "finished"
    record.message = "; ".join([*study.shortfalls, *study.messages])
    record.details["inputs"] = measured.values
    record.details["measured"] = as_data(measured)
    record.details["dem_computed_now"] = [result.seed for result in study.results if result.computed]
    record.details["seconds"] = {name: round(value, 6) for name, value in study.seconds.items()}


def _report(study: Study | None, record: Record, screen: Screen) -> None:
    if study is not None:
        worst = largest_errors(study.rows)
        for loading, text in LOADINGS.items():
            rows = []
            for closure in study.closures:
                found = [worst.get((loading, closure, name)) for name in _SHOWN]
                rows.append([closure, *(_shown(name, entry) for name, entry in zip(_SHOWN, found))])
            head = ["closure", "z [%]", "a_c", "a_n", "a_t", "f/f0 [%]"]
            title = f"{text}: largest error (model - DEM) at q/p = {', '.join(f'{ratio:g}' for ratio in TABLE_LEVELS)}"
            screen.table(title, head, rows)
        screen.table(
            "largest errors: loadings, cycles, rotation, probes; microseconds of an update with its tangent",
            ["closure", "z [%]", "a_c", "a_n", "a_t", "f [%]", "z", "a_c", "z", "a_c", "z [%]", "a_c [%]", "us"],
            [[str(row[0]), *(f"{value:.3g}" for value in row[1:])] for row in closure_rows(study)],
        )
        dem = sum(value for name, value in study.seconds.items() if name != "model")
        computed = record.details["dem_computed_now"]
        read = len(study.results) - len(computed)
        screen.say(
            f"packings of {record.scene['particles']} disks: {len(computed)} computed, {read} read; DEM {dem:.1f} s, "
            f"model {study.seconds['model']:.3f} s, compilation {record.timing['compilation']:.1f} s"
        )
        for line in study.shortfalls:
            screen.say(line)
    if record.outcome != "finished":
        screen.say(f"{record.outcome}: {record.message}", insist=True)
    screen.say(f"{record.timing['total']:.1f} s in all; results in {record.folder}")


_SHOWN = (
    "coordination", "fabric_anisotropy", "normal_force_anisotropy", "tangential_force_anisotropy", "mean_normal_force"
)  # fmt: skip


def _shown(quantity: str, entry: Comparison | None) -> str:
    if entry is None:
        return "-"
    if quantity in ("coordination", "mean_normal_force"):
        return f"{100.0 * entry.error / entry.dem:+.2f}"
    return f"{entry.error:+.4f}"
