"""A scene against its closed form on finer and finer meshes: `granfabric convergence`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from granfabric.cases.errors import InputError, RunError
from granfabric.cases.field import closed_forms, comparison
from granfabric.cases.field.initial_balance import Balance
from granfabric.cases.field.prepare import prepare
from granfabric.cases.pictures.style import BLUE, RED, picture
from granfabric.cases.records import files
from granfabric.cases.records.record import versions
from granfabric.cases.scene.reader import LoadedScene, load
from granfabric.cases.scene.schema_law_kind import is_grains
from granfabric.cases.terminal.screen import Screen
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.equilibrium.stepping import solve

CONSTANT_STIFFNESS = ("effects.contact_loss=false", "effects.contact_gain=false")
"""Closed forms hold for an elastic body: the network is kept as it is."""

COLUMNS = ("refine", "size", "degrees_of_freedom", "stress_error", "stress_order", "displacement_error")
LAST = "displacement_order"
TABLE, PICTURE = "convergence.csv", "convergence.png"


@dataclass(frozen=True)
class Level:
    """One mesh of the series.

    Parameters
    ----------
    refine : int
        Factor on the numbers of cells.
    size : float
        Square root of the mean area of the elements [m].
    degrees_of_freedom : int
    stress_error : float
        As in `comparison.Comparison`.
    displacement_error : float or None
    """

    refine: int
    size: float
    degrees_of_freedom: int
    stress_error: float
    displacement_error: float | None


def solve_level(loaded: LoadedScene, refine: int) -> Level:
    """Solve a scene with constant stiffness and compare it with its closed form.

    Raises
    ------
    InputError
        If the scene has no closed form.
    RunError
        If the solver does not finish.
    """
    if loaded.scene.closed_form is None:
        raise InputError(f"{loaded.file}: the scene names no closed form, so that there is nothing to converge to")
    problem, control = (prepared := prepare(loaded)).problem, prepared.control
    last: list[StepResult] = []

    def keep(step: StepResult) -> None:
        last[:] = [step]

    summary = solve(problem, control, on_step=keep)
    if not summary.finished:
        reminder = Balance(problem).reminder(summary.stage)
        raise RunError(f"the mesh refined {refine} times was not solved: {summary.message}{reminder}")
    found = comparison.compare(loaded, problem, last[0])
    space = problem.space
    size = float(np.sqrt(space.weights.sum() / space.nelements))
    return Level(refine, size, space.ndofs, found.stress_error, found.displacement_error)


def order(coarse: Level, fine: Level, name: str) -> float | None:
    """Exponent of the mesh size with which an error falls between two meshes."""
    before, after = getattr(coarse, name), getattr(fine, name)
    if before is None or after is None or not after > 0:
        return None
    return float(np.log(before / after) / np.log(coarse.size / fine.size))


def run_convergence(
    scene: str,
    assignments: Sequence[str],
    refinements: Sequence[int],
    folder: Path,
    screen: Screen,
    overwrite: bool = False,
) -> list[Level]:
    """Solve a scene on several meshes; write `convergence.csv` and `convergence.png`.

    Parameters
    ----------
    scene : str
        With a parametric mesh and a closed form.
    assignments : sequence of str
        As for `load`.
    refinements : sequence of int
        Factors on the numbers of cells, ascending.
    folder : Path
    screen : Screen
    overwrite : bool
        Replace results of another scene, or of a run, too.

    Raises
    ------
    InputError, RunError
    """
    if len(refinements) < 2 or list(refinements) != sorted(set(refinements)):
        raise InputError(
            f"--refine {','.join(map(str, refinements))}: give two or more ascending factors such as 1,2,4"
        )
    first = load(scene, assignments)  # before keys are given that other kinds do not know
    first.require("field")
    if is_grains(first.scene):
        text = "law.kind = 'grains': no closed form is known of disks, so that there is nothing to converge to"
        raise first.error(["law", "kind"], text)
    every = [load(scene, [*assignments, *CONSTANT_STIFFNESS, f"mesh.refine={factor}"]) for factor in refinements]
    owner = replace(every[0].owner, kind="convergence")
    files.check_output(folder, owner, overwrite)
    since = time.perf_counter()
    levels = [solve_level(loaded, factor) for loaded, factor in zip(every, refinements)]
    orders = {
        name: [None, *(order(coarse, fine, name) for coarse, fine in pairwise(levels))]
        for name in ("stress_error", "displacement_error")
    }
    rows = [
        [level.refine, level.size, level.degrees_of_freedom, level.stress_error, stress_order]
        + [level.displacement_error, displacement_order]
        for level, stress_order, displacement_order in zip(levels, orders["stress_error"], orders["displacement_error"])
    ]
    title = every[0].scene.title
    form = closed_forms.TITLES[every[0].scene.closed_form.name]
    screen.table(
        f"{title}: relative error against {form}, and its order in the mesh size",
        ["refine", "h [m]", "dofs", "stress", "order", "displacement", "order"],
        [
            [str(refine), f"{size:.3g}", str(dofs), *(_shown(value) for value in rest)]
            for refine, size, dofs, *rest in rows
        ],
    )
    with files.held(folder, owner, overwrite):
        files.prepare_output(folder, owner, overwrite)
        record = {"program": files.PROGRAM, "kind": owner.kind, "name": owner.name, "scene_file": owner.place}
        files.write_json(folder / files.RECORD, {**record, "outcome": "finished", "scene": {"title": title}})
        screen.keep_log(folder / files.LOG, versions())
        files.write_text(
            folder / TABLE, files.csv_text([*COLUMNS, LAST], [["" if v is None else v for v in r] for r in rows])
        )
        _draw(folder / PICTURE, levels, f"{title}\nagainst {form}, {every[0].scene.mesh.element} elements")
    screen.say(f"{time.perf_counter() - since:.1f} s; results in {folder}")
    return levels


def _shown(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def _draw(path: Path, levels: list[Level], title: str) -> None:
    """Errors over the mesh size, with the order between the two finest meshes."""
    size = [level.size for level in levels]
    with picture(path, 5.6, 4.4) as figure:
        axes: Any = figure.add_subplot()
        for name, colour, marker in (("stress_error", BLUE, "o"), ("displacement_error", RED, "s")):
            errors = [getattr(level, name) for level in levels]
            slope = order(levels[-2], levels[-1], name)
            if slope is not None:
                label = f"{name.removesuffix('_error')}, order {slope:.2f}"
                axes.loglog(size, errors, color=colour, marker=marker, label=label)
        axes.set(xlabel="mesh size $h$ [m]", ylabel="relative error [-]", title=title)
        axes.legend()
