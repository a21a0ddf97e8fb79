"""Everything that came of a map, as tables, texts and figures take it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from granfabric.cases.scene.measured import Inputs, from_data, mean_of

from .compare import Cell, MapRow, cell, rows_of
from .materials import MapMaterial
from .paths import MapPath
from .table import by_cell, where_refused
from .tasks import INPUTS, KERNELS, LAW, PACKING, Done, Task


@dataclass
class MapPlan:
    """What a map is asked for, and what came of it so far.

    Attributes
    ----------
    materials : list of MapMaterial
    paths : dict of str to MapPath
    seeds : list of int
    particles : int
    closures : tuple of str
    done : dict
        What came of each task, by its key.
    held : list of Task
        Of the law, while its kernels are `compiling` in a process of their own.
    compiling : bool
    """

    materials: list[MapMaterial]
    paths: dict[str, MapPath]
    seeds: list[int]
    particles: int
    closures: tuple[str, ...]
    done: dict[tuple[str, int, str, str], Done] = field(default_factory=dict)
    held: list[Task] = field(default_factory=list)
    compiling: bool = False

    @property
    def size(self) -> int:
        """Tasks in all: a packing, its inputs, and two for each path."""
        return len(self.materials) * len(self.seeds) * (2 + 2 * len(self.paths))

    @property
    def first(self) -> list[tuple[MapMaterial, int]]:
        """Packings, seed by seed, so that a map of few packings is whole early."""
        return [(material, seed) for seed in self.seeds for material in self.materials]

    def failures_of(self, material: str, seed: int, path: str = "") -> list[str]:
        """Why there is nothing of a packing, or of a path on it."""
        whats = [(PACKING, ""), (INPUTS, ""), (path, ""), (LAW, path)]
        found = [self.done.get((material, seed, what, on)) for what, on in whats]
        return [f"{material}, seed {seed}{_of(what)}: {entry.failure}" for (what, _), entry in zip(whats, found)
                if entry is not None and entry.failure]  # fmt: skip


def _of(what: str) -> str:
    return {PACKING: "", INPUTS: ", inputs"}.get(what, f", {what}")


@dataclass
class MapResult:
    """A map.

    Attributes
    ----------
    materials, paths, seeds, particles, closures
        As asked for.
    cells : list of Cell
        Material by material, path by path.
    rows : list of MapRow
    inputs : dict of str to Inputs
        Mean over the packings of a material.
    refusals, failures : list of str
        Sentences.
    """

    materials: list[MapMaterial]
    paths: dict[str, MapPath]
    seeds: list[int]
    particles: int
    closures: tuple[str, ...]
    cells: list[Cell]
    rows: list[MapRow]
    inputs: dict[str, Inputs]
    refusals: list[str]
    failures: list[str]


def result_of(plan: MapPlan) -> MapResult:
    """The map of what was computed; what is missing is told."""
    cells, inputs = [], {}
    failures: list[str] = []
    for material in plan.materials:
        measured = [plan.done.get((material.name, seed, INPUTS, "")) for seed in plan.seeds]
        found = [from_data(entry.values) for entry in measured if entry is not None and entry.values]
        if found:
            inputs[material.name] = mean_of(found)
        for name, path in plan.paths.items():
            packings = {}
            missing: list[str] = []
            for seed in plan.seeds:
                dem = plan.done.get((material.name, seed, name, ""))
                law = plan.done.get((material.name, seed, LAW, name))
                if dem is not None and law is not None and dem.values and law.values:
                    packings[seed] = (dem.values, law.values)
                missing += plan.failures_of(material.name, seed, name)
            cells.append(cell(material.name, name, path, plan.closures, packings, missing))
            failures += missing
    rows = [row for one in cells for row in rows_of(one)]
    return MapResult(
        plan.materials, plan.paths, plan.seeds, plan.particles, plan.closures, cells, rows, inputs,
        _refusals(cells, rows), list(dict.fromkeys(failures)),
    )  # fmt: skip


def _refusals(cells: Sequence[Cell], rows: Sequence[MapRow]) -> list[str]:
    """A line for each path that a closure refused, and for inputs that it does not take."""
    known = by_cell(rows)
    said = []
    for one in cells:
        for closure, refusals in one.refusals.items():
            row = known[one.material, one.path, closure, "coordination"]
            of_inputs = [entry for entry in refusals if entry.of_inputs]
            said += [f"{one.material}, seed {entry.seed}: the inputs: {entry.message}" for entry in of_inputs]
            if row.refused_packings:
                said.append(f"{one.material}, {one.path}, {closure}: {where_refused(row)}: {row.message}")
    return list(dict.fromkeys(said))


def following(plan: MapPlan, task: Task, done: Done) -> list[Task]:
    """Note down what came of a task; the tasks that can be done now."""
    if task.what == KERNELS:
        plan.compiling = False
        released, plan.held = plan.held, []
        return released
    plan.done[task.key] = done
    if done.failure or done.stopped:
        return []
    if task.what == PACKING:
        return [_like(task, what) for what in (INPUTS, *plan.paths)]
    name, seed = task.material.name, task.seed
    inputs = plan.done.get((name, seed, INPUTS, ""))
    if inputs is None or not inputs.values:
        return []
    if task.what == INPUTS:
        ready = [path for path in plan.paths if _is_there(plan, name, seed, path)]
    else:
        ready = [task.what] if task.what in plan.paths else []
    tasks = [
        _like(task, LAW, path, {"inputs": inputs.values, "history": plan.done[name, seed, path, ""].values["history"]},
              plan.closures)
        for path in ready
    ]  # fmt: skip
    if plan.compiling:
        plan.held += tasks
        return []
    return tasks


def _is_there(plan: MapPlan, name: str, seed: int, path: str) -> bool:
    entry = plan.done.get((name, seed, path, ""))
    return entry is not None and bool(entry.values)


def _like(
    task: Task, what: str, path: str = "", given: dict | None = None, closures: tuple[str, ...] = ()
) -> Task:
    return Task(task.folder, task.particles, task.material, task.seed, what, path, given or {}, closures)
