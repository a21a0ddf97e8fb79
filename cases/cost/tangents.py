"""Study: which tangent, and whether a factor is kept."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, get_args

from granfabric.cases.pictures.style import BLACK, BLUE, ORANGE, picture
from granfabric.cases.terminal.clock import best_of
from granfabric.constitutive.contract import TangentKind
from granfabric.constitutive.parameters import Integration
from granfabric.fem.equilibrium.control import StepControl

from .biaxial import Biaxial
from .front import mark_fronts
from .study import COMMON_COLUMNS, Column, Effort, Row, Study

KINDS: tuple[TangentKind, ...] = get_args(TangentKind)
ACROSS, QUICK_ACROSS = 12, 3
INCREMENTS, QUICK_INCREMENTS = 20, 4
TOLERANCE = 1e-8
MOST_ITERATIONS = 200
"""So many that no tangent makes a step fail: what is compared is the way, not the steps."""

BARS = (
    ("newton_iterations", "Newton iterations", "{:.0f}"),
    ("factorisations", "factorisations", "{:.0f}"),
    ("krylov_iterations", "Krylov iterations", "{:.0f}"),
    ("law_calls", "calls of the law, all points", "{:.0f}"),
    ("seconds", "processor time [s]", "{:.3g}"),
)


def _control(kind: TangentKind, keep: bool) -> StepControl:
    return StepControl(
        tolerance=TOLERANCE,
        maximum_iterations=MOST_ITERATIONS,
        easy_iterations=MOST_ITERATIONS,
        tangent_kind=kind,
        keep_factor=keep,
    )


def rows(effort: Effort) -> list[Row]:
    """All tangents, with and without a kept factor; see `Study.rows`."""
    across, increments = (QUICK_ACROSS, QUICK_INCREMENTS) if effort.quick else (ACROSS, INCREMENTS)
    test = Biaxial(across, increments, Integration())
    plan = [(kind, keep) for kind in KINDS for keep in (False, True)]
    total = len(plan) * (effort.rounds + 1) + 1
    effort.advance(0, total, "reference")
    reference = test.run(StepControl(tolerance=1e-12, maximum_iterations=50))[0]
    table: list[Row] = []
    for place, (kind, keep) in enumerate(plan):
        effort.advance(1 + place, total, f"{kind} tangent, factor {'kept' if keep else 'renewed'}")
        means, summary, _ = test.run(_control(kind, keep))
        counters = summary.counters
        table.append(
            {
                "facet": "biaxial",
                "series": f"{kind} tangent",
                "setting": "factor kept" if keep else "factor renewed at each solve",
                "error": max(means.errors(reference)),
                "seconds": 0.0,
                "count": counters["law_calls"],
                "tangent_kind": kind,
                "keep_factor": int(keep),
                **{name: counters[name] for name in COUNTERS},
            }
        )
    calls = [partial(test.run, _control(kind, keep)) for kind, keep in plan]
    times = best_of(calls, effort.rounds, lambda done: effort.advance(1 + len(plan) + done, total, "timing"))
    for row, seconds in zip(table, times):
        row["seconds"] = seconds
    mark_fronts(table)
    return table


COUNTERS = ("steps", "cuts", "newton_iterations", "factorisations", "krylov_iterations", "law_calls", "line_searches")


def draw(path: Path, table: Sequence[Row]) -> None:
    """Bars of counts and time."""
    with picture(path, 11.0, 6.4) as figure:
        panels = figure.subplots(2, 3).ravel()
        for place, (axes, (column, label, form)) in enumerate(zip(panels, BARS)):
            axes.set(title=f"({'abcde'[place]}) {label}")
            _bars(axes, table, column, form)
        panels[-1].axis("off")
        handles, names = panels[0].get_legend_handles_labels()
        panels[-1].legend(handles, names, loc="center", fontsize=11)
        figure.suptitle("Tangents in the biaxial test, whole run", x=0.01, ha="left", fontsize=13)


def _bars(axes: Any, table: Sequence[Row], column: str, form: str) -> None:
    kinds = list(dict.fromkeys(row["tangent_kind"] for row in table))
    largest = max(row[column] for row in table)
    for keep, colour, label, shift in (
        (0, ORANGE, "factor renewed at each solve", 0.2),
        (1, BLUE, "factor kept as preconditioner", -0.2),
    ):
        for place, kind in enumerate(kinds):
            row = next((row for row in table if row["tangent_kind"] == kind and row["keep_factor"] == keep), None)
            if row is None:
                continue
            axes.barh(place + shift, row[column], 0.36, color=colour, label=label if place == 0 else None)
            axes.text(row[column] + 0.015 * largest, place + shift, form.format(row[column]), va="center", fontsize=9,
                      color=BLACK)  # fmt: skip
    axes.set_yticks(range(len(kinds)), kinds)
    axes.set_xlim(0, 1.17 * largest if largest else 1.0)
    axes.grid(axis="y", visible=False)


def findings(table: Sequence[Row]) -> list[str]:
    """What the numbers say."""
    fastest = min(table, key=lambda row: row["seconds"])
    said = [
        f"Least time: {fastest['series']}, {fastest['setting']} ({fastest['seconds']:.3g} s, "
        f"{fastest['newton_iterations']} Newton iterations, {fastest['factorisations']} factorisations, "
        f"{fastest['krylov_iterations']} Krylov iterations)."
    ]
    for kind in KINDS:
        pair = {row["keep_factor"]: row for row in table if row["tangent_kind"] == kind}
        said.append(
            f"{kind.capitalize()} tangent: {pair[0]['newton_iterations']} Newton iterations; keeping the factor saves "
            f"{pair[0]['factorisations'] - pair[1]['factorisations']} of {pair[0]['factorisations']} factorisations "
            f"and takes {pair[1]['seconds'] / pair[0]['seconds']:.2f} of the time."
        )
    worst = max(row["error"] for row in table)
    said.append(f"All ways lead to the same end: means differ from the reference by at most {worst:.1e}.")
    return said


STUDY = Study(
    name="tangents",
    title="Tangents and kept factors",
    question="Which tangent brings Newton's method to equilibrium at least cost, and is keeping a factor worth it?",
    knobs=(
        ("tangent_kind", "elastic, continuum, propagated through the substeps"),
        ("keep_factor", "off: factorise at each solve; on: an old factor preconditions a Krylov method"),
        ("scene", f"biaxial, {ACROSS} x {2 * ACROSS} squares halved into P2 triangles, {INCREMENTS} load steps"),
        ("tolerance", f"Newton to a relative residual of {TOLERANCE:g}"),
        ("reference", "propagated tangent to a residual of 1e-12"),
        ("error", "largest of q/p, z relative, a_c, volume means at the end"),
    ),
    columns=(
        *COMMON_COLUMNS,
        Column("tangent_kind", "name in a scene"),
        Column("keep_factor", "1 if a factor is kept"),
        Column("steps", "load steps"),
        Column("cuts", "abandoned attempts at a load step"),
        Column("newton_iterations", "corrections by a linear solve, predictors included"),
        Column("factorisations", "factorisations"),
        Column("krylov_iterations", "Krylov iterations"),
        Column("law_calls", "calls of the law, each for all points"),
        Column("line_searches", "shortened corrections"),
    ),
    rows=rows,
    draw=draw,
    findings=findings,
)
