"""Study: what each effect costs, and what leaving it out does, on three small tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from granfabric.cases.effects.compare import Outcome, distance, run_field
from granfabric.cases.field.prepare import Prepared, prepare
from granfabric.cases.field.stage_loads import stages
from granfabric.cases.pictures.style import BLUE, ORANGE, picture
from granfabric.cases.scene.effects_choice import EffectSet, all_names, everything
from granfabric.cases.scene.reader import LoadedScene, load
from granfabric.fem.discretisation.space import Space
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import rectangle

from .biaxial import HEIGHT, WIDTH
from .front import mark_fronts
from .study import COMMON_COLUMNS, Column, Effort, Row, Study, StudyError

ACROSS, QUICK_ACROSS = 5, 2
FACETS = {
    "biaxial": "biaxial test",
    "rotation": "biaxial, then shear",
    "unloading": "biaxial test and back",
}
EVERYTHING = "everything"
PRESS = {"boundary": "top", "component": "y", "value": -9e-6}
STAGES: dict[str, list[dict[str, Any]]] = {
    "biaxial": [],
    "rotation": [{"name": "shear", "increments": 10, "displacement": [{**PRESS, "component": "x", "value": 5e-6}]}],
    "unloading": [{"name": "back", "increments": 10, "displacement": [{**PRESS, "value": 0.0}]}],
}


def tests(across: int) -> dict[str, tuple[LoadedScene, Prepared]]:
    """The shipped biaxial test on a coarse regular mesh, alone and with a further stage each; memory is on."""
    made = {}
    for name, further in STAGES.items():
        loaded = load("biaxial", ["closure.force_change=shifted_distribution", "output.every=1"])
        model = type(loaded.scene)
        table = loaded.scene.model_dump(exclude_unset=True)
        table["stage"] = [*table["stage"], *further]
        table["stage"][1]["increments"] = 10
        loaded = replace(loaded, scene=model.model_validate(table))
        prepared = prepare(loaded)
        space = Space(rectangle(WIDTH, HEIGHT, across, 2 * across), loaded.scene.mesh.element)
        problem = Problem(
            space, prepared.problem.law, stages(loaded.scene), initial_stress=loaded.scene.initial.stress
        )
        made[name] = loaded, replace(prepared, problem=problem)
    return made


def effect_sets(scene: Any) -> dict[str, EffectSet]:
    """Everything, everything but one, and nothing but the loss of contacts."""
    full = everything(scene)
    sets = {EVERYTHING: full}
    for name in all_names():
        if full.has(name):
            sets[f"without {name}"] = full.with_effect(name, False)
    bare = full
    for name in all_names():
        if name != "contact_loss":
            bare = bare.with_effect(name, False)
    sets["contact_loss alone"] = bare
    sets["no effect"] = bare.with_effect("contact_loss", False)
    return sets


def rows(effort: Effort) -> list[Row]:
    """All effect sets on all tests; see `Study.rows`."""
    made = tests(QUICK_ACROSS if effort.quick else ACROSS)
    sets = {name: effect_sets(loaded.scene) for name, (loaded, _) in made.items()}
    total = sum(map(len, sets.values())) * (effort.rounds + 1)
    done = 0
    table: list[Row] = []
    for name, (loaded, prepared) in made.items():
        weights = prepared.problem.space.weights / prepared.problem.space.weights.sum()
        run_field(loaded, prepared, sets[name][EVERYTHING])  # kernels are warm from here on
        outcomes: dict[str, Outcome] = {}
        best: dict[str, float] = {}
        for _ in range(effort.rounds):
            for title, chosen in sets[name].items():
                effort.advance(done, total, f"{FACETS[name]}: {title}")
                outcome = run_field(loaded, prepared, chosen)
                if not outcome.finished:
                    raise StudyError(f"{FACETS[name]} did not come to its end: {title}")
                outcomes[title] = outcome
                best[title] = min(best.get(title, np.inf), outcome.seconds)
                done += 1
        table += [
            _row(name, title, outcomes[EVERYTHING], outcome, best, weights) for title, outcome in outcomes.items()
        ]
        mark_fronts(table[-len(outcomes) :])
    return table


def _row(name: str, title: str, full: Outcome, outcome: Outcome, best: dict[str, float], weights: Any) -> Row:
    found = distance(full, outcome, weights)
    return {
        "facet": name,
        "series": title,
        "setting": title,
        "error": found.error,
        "seconds": best[title],
        "count": outcome.counters["law_calls"],
        "error_at_worst_point": found.largest,
        "quantity": found.quantity,
        "relative_time": best[title] / best[EVERYTHING],
        "state_columns": outcome.trial.columns,
        # stress and state twice, start and end of a step; strain, its increment, and where iterated two tangents
        "memory_per_point": 8 * (2 * (3 + outcome.trial.columns) + 6 + (0 if outcome.uncoupled else 18)),
        "uncoupled": int(outcome.uncoupled),
        "factorisations": outcome.counters["factorisations"],
        "linear_solves": outcome.counters["linear_solves"],
    }


def draw(path: Path, table: Sequence[Row]) -> None:
    """Bars: time over that of everything, and error."""
    facets = [facet for facet in FACETS if any(row["facet"] == facet for row in table)]
    with picture(path, 11.0, 0.8 + 2.7 * len(facets)) as figure:
        grid = figure.subplots(len(facets), 2, squeeze=False, sharey="row")
        for place, facet in enumerate(facets):
            members = [row for row in table if row["facet"] == facet][::-1]
            heights, names = np.arange(len(members)), [row["setting"] for row in members]
            grid[place, 0].barh(heights, [row["relative_time"] for row in members], color=BLUE)
            grid[place, 0].set_yticks(heights, names)
            letters = "abcdef"
            grid[place, 0].set_title(f"({letters[2 * place]}) {FACETS[facet]}: time / everything")
            grid[place, 1].barh(heights, [max(row["error"], 1e-8) for row in members], left=0, color=ORANGE)
            grid[place, 1].set(xscale="log", xlim=(1e-6, 2.0))
            grid[place, 1].axvline(1e-2, color="#888888", linewidth=1.0, linestyle="--")
            grid[place, 1].set_title(f"({letters[2 * place + 1]}) error (99 % of the area)")
        figure.suptitle("What each effect costs, and what leaving it out does", x=0.01, ha="left", fontsize=13)


def findings(table: Sequence[Row]) -> list[str]:
    """What the numbers say."""
    said = []
    for facet, title in FACETS.items():
        members = [row for row in table if row["facet"] == facet and row["setting"] not in (EVERYTHING, "no effect")]
        if not members:
            continue
        small = [row for row in members if row["error"] <= 1e-2]
        if small:
            fastest = min(small, key=lambda row: row["relative_time"])
            said.append(
                f"{title}: {fastest['setting']} has an error of {fastest['error']:.1e} and takes "
                f"{fastest['relative_time']:.0%} of the time of everything."
            )
        gravest = max(members, key=lambda row: row["error"])
        said.append(f"{title}: gravest is {gravest['setting']}, {gravest['error']:.1e} ({gravest['quantity']}).")
    return said


STUDY = Study(
    name="effects",
    title="What effects cost",
    question="What does each effect cost in time and memory, and what is wrong without it?",
    knobs=(
        ("effects", "everything, everything but one, contact loss alone, none"),
        ("scenes", f"the biaxial test on {ACROSS} x {2 * ACROSS} squares halved into P2 triangles, alone, with shear "
         "of the upper platen after it, and unloaded"),
        ("closure", "shifted distribution, of which leaving out force_change makes the mean field"),
        ("error", "against everything, over all steps: stress over p, strain over its root mean square, z relative, "
         "a_c; the largest of them, exceeded on less than 1 % of the area"),
    ),
    columns=(
        *COMMON_COLUMNS,
        Column("error_at_worst_point", "the same at the worst point"),
        Column("quantity", "quantity with the largest error"),
        Column("relative_time", "processor time over that of everything"),
        Column("state_columns", "state columns of a point"),
        Column("memory_per_point", "memory of stress, strain, state and tangents of a point", "B"),
        Column("uncoupled", "1 if displacements come from one linear solve a stage"),
        Column("factorisations", "factorisations"),
        Column("linear_solves", "linear solves"),
    ),
    rows=rows,
    draw=draw,
    findings=findings,
)  # fmt: skip
