"""The point law against the DEM on many materials and paths: `granfabric verify --paths ... --materials ...`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from granfabric.cases.engine.choice import Choice
from granfabric.cases.engine.jobs import Ended, Engine, Job, WorkerLost
from granfabric.cases.records import files
from granfabric.cases.records.record import Record, versions
from granfabric.cases.scene.material_file import material_text
from granfabric.cases.scene.measured import as_data, from_data, warnings
from granfabric.cases.scene.owner import Owner
from granfabric.cases.terminal.compile_watch import watching
from granfabric.cases.terminal.interruption import InterruptRequest, interrupt_request
from granfabric.cases.terminal.screen import Screen
from granfabric.cases.verify.dem_side import STORE
from granfabric.cases.verify.map.closures import CLOSURES, QUICK_CLOSURES
from granfabric.cases.verify.map.compare import CURVE_COLUMNS, MAP_COLUMNS, curve_rows
from granfabric.cases.verify.map.materials import chosen_materials, refuse_twins
from granfabric.cases.verify.map.paths import chosen_paths
from granfabric.cases.verify.map.result import MapPlan, MapResult, following, result_of
from granfabric.cases.verify.map.table import PAIRS, blocks, markdown, told_closures
from granfabric.cases.verify.map.tasks import INPUTS, KERNELS, LAW, PACKING, Done, Task, slug

from .verify import COMPILATION_SECONDS, OWNER, PARTICLES, SEEDS, TITLE, refuse_numbers

QUICK_PARTICLES, QUICK_SEEDS = 400, 2
TABLE, CURVES, PAGE = "map.csv", "map_curves.csv", "map.md"


@dataclass(frozen=True)
class MapRequest:
    """What of the map is asked for; None for what follows from the others.

    Attributes
    ----------
    paths, materials : str or None
        Comma-separated names.
    assignments : sequence of str
        ``material.KEY=VALUE`` for every packing.
    quick : bool
        Few and small packings, and where nothing else is said a few materials and paths.
    particles, seeds : int or None
    choice : Choice
        Who computes.
    """

    paths: str | None = None
    materials: str | None = None
    assignments: Sequence[str] = ()
    quick: bool = False
    particles: int | None = None
    seeds: int | None = None
    choice: Choice = field(default_factory=Choice)

    @property
    def is_map(self) -> bool:
        """Whether the map is meant, and not the comparison without it."""
        return self.quick or bool(self.assignments) or self.paths is not None or self.materials is not None

    def plan(self) -> MapPlan:
        """Checked.

        Raises
        ------
        InputError
        """
        particles = self.particles or (QUICK_PARTICLES if self.quick else PARTICLES)
        seeds = self.seeds or (QUICK_SEEDS if self.quick else SEEDS)
        materials = chosen_materials(self.materials, self.assignments, self.quick)
        refuse_twins(materials)
        return MapPlan(
            materials, chosen_paths(self.paths, self.quick), list(range(1, seeds + 1)), particles,
            QUICK_CLOSURES if self.quick else CLOSURES,
        )  # fmt: skip


def run_map(request: MapRequest, folder: Path, screen: Screen, overwrite: bool = False) -> Record:
    """Compare the point law with the DEM on materials and paths, and write tables and figures.

    Everything of the DEM that the folder has is used again, begun runs are finished.

    Parameters
    ----------
    request : MapRequest
    folder : Path
        New, empty, or of an earlier comparison; tables and figures there are replaced.
    screen : Screen
    overwrite : bool
        Replace results of a scene too.

    Returns
    -------
    Record
        As written to `run.json`. Its outcome is `failed` if something of the DEM is missing; the rest is there.

    Raises
    ------
    InputError
        If what is asked for or the folder is not legal; then nothing was written.
    RunError
        If the run broke off; finished parts of the DEM are on disk.
    """
    refuse_numbers(request.particles, request.seeds)
    request.choice.check()
    plan = request.plan()
    owner = Owner(OWNER.kind, OWNER.name, OWNER.title)
    with files.held(folder, owner, overwrite):
        files.prepare_output(folder, owner, overwrite)
        record = Record(folder, "verify", _scene(plan), is_scene=False)
        record.write()
        screen.keep_log(folder / files.LOG, versions())
        with watching(screen.announce_compilation(COMPILATION_SECONDS)) as watch:
            with interrupt_request(screen.announce_stop) as stop:
                try:
                    with record.phase("dem_and_law", watch):
                        record.details["processes"] = _compute(plan, folder / STORE, request.choice, screen, stop)
                    if stop.requested:
                        record.outcome = "stopped"
                        record.message = "stopped; the same command goes on from here"
                except KeyboardInterrupt as error:
                    raise record.broken_off("interrupted within a step; the same command goes on from here") from error
                except OSError as error:
                    raise record.broken_off(f"results cannot be written any more: {error}") from error
            record.timing["compilation"] = watch.seconds
            result = None
            if record.outcome != "stopped":
                try:
                    result = result_of(plan)
                    _write(result, plan, record)
                except KeyboardInterrupt as error:
                    raise record.broken_off("interrupted while drawing; the same command goes on from here") from error
        record.details["computed_now"] = _computed(plan)
        record.details["seconds"] = _seconds(plan)
        record.write()
        _report(result, plan, record, screen)
        return record


def _scene(plan: MapPlan) -> dict[str, Any]:
    """What was asked for, for the record."""
    return {
        "title": TITLE,
        "kind": "verify",
        "particles": plan.particles,
        "seeds": plan.seeds,
        "paths": list(plan.paths),
        "closures": list(plan.closures),
        "materials": {material.name: asdict(material.options) for material in plan.materials},
    }


def _compute(plan: MapPlan, store: Path, choice: Choice, screen: Screen, stop: InterruptRequest) -> int:
    """The DEM and the law, side by side; by how many."""
    store.mkdir(exist_ok=True)
    with choice.engine(store, screen, stop) as engine:
        _compute_by(engine, plan, store, screen, stop)
        return engine.workers


def _compute_by(engine: Engine, plan: MapPlan, store: Path, screen: Screen, stop: InterruptRequest) -> None:
    counts = ((len(plan.materials), "material"), (len(plan.paths), "path"), (len(plan.seeds), "packing"))
    said = ", ".join(f"{count} {word}{'s' if count > 1 else ''}" for count, word in counts)
    screen.say(f"{said} a material of {plan.particles} disks; {engine.text}")
    first = [Task(store, plan.particles, material, seed, PACKING) for material, seed in plan.first]
    if engine.workers > 1:
        plan.compiling = True
        first.insert(1, Task(store, plan.particles, plan.materials[0], 0, KERNELS, closures=plan.closures))
    with screen.progress("map", float(plan.size)) as advance:

        def watched(at_work: dict[str, float]) -> None:
            advance(len(plan.done) + sum(at_work.values()), "; ".join(at_work))

        def follow(job: Job, ended: Ended) -> list[Job]:
            task, done = job.arguments[0], ended.value
            if isinstance(ended.error, WorkerLost):
                done = Done(failure=str(ended.error))
            elif ended.error is not None:
                raise ended.error
            _say(task, done, screen)
            return [task.job for task in following(plan, task, done)]

        engine.carry_out([task.job for task in first], follow, watched, stop)


def _say(task: Task, done: Done, screen: Screen) -> None:
    """What is worth saying about a task that is done."""
    if done.failure:
        screen.say(f"warning: {task.text}: {done.failure}")
    elif done.stopped:
        screen.note(f"{task.text}: stopped, kept")
    else:
        screen.note(f"{task.text}: {done.seconds:.1f} s{'' if done.computed else ', read'}")
    if task.what == INPUTS and done.values:
        for line in warnings(from_data(done.values)):
            screen.say(f"{task.material.name}, seed {task.seed}: {line}")


def _computed(plan: MapPlan) -> int:
    """Parts of the DEM that were not on disk."""
    return sum(
        entry.computed and not entry.failure and not entry.stopped
        for key, entry in plan.done.items()
        if key[2] not in (LAW, KERNELS)
    )


def _seconds(plan: MapPlan) -> dict[str, float]:
    """Time by kind of work, over all processes, without compilation."""
    spent: dict[str, float] = {}
    for (_, _, what, _), entry in plan.done.items():
        spent[what] = spent.get(what, 0.0) + entry.seconds
    return {name: round(value, 3) for name, value in spent.items()}


def _write(result: MapResult, plan: MapPlan, record: Record) -> None:
    """Tables, figures, and the measured inputs of each material."""
    from granfabric.cases.verify.map.pictures import draw_map

    folder = record.folder
    files.write_text(folder / TABLE, files.csv_text(MAP_COLUMNS, [row.row() for row in result.rows]))
    curves = [row for one in result.cells for row in curve_rows(one)]
    files.write_text(folder / CURVES, files.csv_text((*CURVE_COLUMNS, *result.closures), curves))
    count = len(result.seeds)
    for name, measured in result.inputs.items():
        origin = f"{name}, mean of {count} packings" if count > 1 else f"{name}, one packing"
        text = material_text(measured.values, origin, measured.errors, measured.missing)
        files.write_text(folder / f"material_{slug(name)}.toml", text)
    files.write_text(folder / PAGE, markdown(result))
    with record.phase("pictures"):
        draw_map(folder, result)
    record.outcome = "failed" if result.failures else "finished"
    record.message = "; ".join(result.failures)
    record.details["measured"] = {name: as_data(measured) for name, measured in result.inputs.items()}
    record.details["refused"] = result.refusals


def _report(result: MapResult | None, plan: MapPlan, record: Record, screen: Screen) -> None:
    if result is not None:
        for closure in told_closures(result.closures):
            for quantities, head in PAIRS:
                title = f"{closure}: largest error (law - DEM) along the path, {head}"
                for head_row, *rows in blocks(result, closure, quantities, screen.console.width):
                    screen.table(title, head_row, rows, words=("material",))
        for line in result.refusals:
            screen.say(f"refused: {line}")
    seconds = record.details["seconds"]
    law = seconds.get(LAW, 0.0)
    screen.say(
        f"{record.details['computed_now']} parts of the DEM computed; all processes together: DEM "
        f"{sum(seconds.values()) - law:.1f} s, law {law:.1f} s, without compilation"
    )
    if record.outcome != "finished":
        screen.say(f"{record.outcome}: {record.message}", insist=True)
    screen.say(f"{record.timing['total']:.1f} s in all; results in {record.folder}")
