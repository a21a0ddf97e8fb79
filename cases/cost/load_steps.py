"""Study: into how many load steps a test is divided."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from granfabric.cases.terminal.clock import best_of
from granfabric.constitutive.parameters import Integration
from granfabric.fem.equilibrium.control import StepControl

from .biaxial import Biaxial
from .draw import work_precision
from .front import cheapest, mark_fronts, slope
from .study import COMMON_COLUMNS, Axes, Column, Effort, Row, Study

ACROSS, QUICK_ACROSS = 6, 3
STEPS, QUICK_STEPS = (1, 2, 4, 8, 16, 32, 64), (1, 2, 4, 8)
REFERENCE_STEPS, QUICK_REFERENCE_STEPS = 256, 32
INTEGRATION = Integration(integrator="dormand_prince", tolerance=1e-11)
"""So tight that only the load steps make an error."""
CONTROL = StepControl(tolerance=1e-11, maximum_iterations=30, easy_iterations=30)

AXES = Axes(
    error="error of the mean $q/p$, $z$, $a_c$ [-]",
    seconds="processor time of the run [s]",
    count="calls of the law, each for all points",
    facet_titles={"biaxial": "biaxial test between rough platens"},
)
QUANTITIES = ("stress ratio q/p", "coordination number z (relative)", "fabric anisotropy a_c")


def rows(effort: Effort) -> list[Row]:
    """All numbers of steps; one row for each of q/p, z and a_c; see `Study.rows`."""
    across = QUICK_ACROSS if effort.quick else ACROSS
    counts = QUICK_STEPS if effort.quick else STEPS
    total = len(counts) * (effort.rounds + 1) + 1
    effort.advance(0, total, "reference")
    finest = QUICK_REFERENCE_STEPS if effort.quick else REFERENCE_STEPS
    reference, _, reference_end = Biaxial(across, finest, INTEGRATION).run(CONTROL)
    tests = [Biaxial(across, number, INTEGRATION) for number in counts]
    table: list[Row] = []
    for place, (number, test) in enumerate(zip(counts, tests)):
        effort.advance(1 + place, total, f"{number} load steps")
        means, summary, end = test.run(CONTROL)
        columns = test.problem.law.description.columns("coordination")
        pointwise = np.abs(end.state[:, columns] / reference_end.state[:, columns] - 1.0).max()
        for name, error in zip(QUANTITIES, means.errors(reference)):
            table.append(
                {
                    "facet": "biaxial",
                    "series": name,
                    "setting": f"{number} load steps",
                    "error": error,
                    "seconds": 0.0,
                    "count": summary.counters["law_calls"],
                    "load_steps": number,
                    "accepted_steps": summary.counters["steps"],
                    "cuts": summary.counters["cuts"],
                    "newton_iterations": summary.counters["newton_iterations"],
                    "factorisations": summary.counters["factorisations"],
                    "krylov_iterations": summary.counters["krylov_iterations"],
                    "error_of_points": float(pointwise),
                }
            )
    calls = [partial(test.run, CONTROL) for test in tests]
    times = best_of(calls, effort.rounds, lambda done: effort.advance(1 + len(counts) + done, total, "timing"))
    for row in table:
        row["seconds"] = times[counts.index(row["load_steps"])]
    for name in QUANTITIES:  # errors of different quantities do not compete
        mark_fronts([row for row in table if row["series"] == name])
    return table


def draw(path: Path, table: Sequence[Row]) -> None:
    """The work-precision picture of the load steps."""
    legend = dict(
        zip(QUANTITIES, ("stress ratio $q/p$", "coordination number $z$ (relative)", "fabric anisotropy $a_c$"))
    )
    steps = [row["load_steps"] for row in table]
    title = f"Number of load steps of the biaxial test, {min(steps)} ... {max(steps)}"
    work_precision(path, title, AXES, table, front=False, legend=legend)


def order(table: Sequence[Row], quantity: str) -> float:
    """Observed order in the size of the load step, coarsest step left out."""
    members = [row for row in table if row["series"] == quantity and row["load_steps"] > 1]
    return -slope([row["load_steps"] for row in members], [row["error"] for row in members])


def findings(table: Sequence[Row]) -> list[str]:
    """What the numbers say."""
    said = [
        "Observed orders in the size of the step: "
        + ", ".join(f"{name} {order(table, name):.2f}" for name in QUANTITIES)
        + "."
    ]
    worst: dict[int, Row] = {}
    for row in table:
        if row["load_steps"] not in worst or row["error"] > worst[row["load_steps"]]["error"]:
            worst[row["load_steps"]] = row
    for error in (1e-5, 1e-7, 1e-9):
        best = cheapest(list(worst.values()), error, "count")
        if best is not None:
            said.append(
                f"All means within {error:g} take {best['setting']}: {best['count']} calls of the law, "
                f"{best['seconds']:.3g} s."
            )
    cut = [row["load_steps"] for row in worst.values() if row["cuts"]]
    if cut:
        said.append(f"Steps had to be cut with {', '.join(str(number) for number in cut)} load steps.")
    return said


STUDY = Study(
    name="load_steps",
    title="Number of load steps",
    question="How many load steps does a wanted accuracy of the mean response need?",
    knobs=(
        ("increments", "1 ... 64 load steps of the compression"),
        ("scene", f"biaxial, {ACROSS} x {2 * ACROSS} squares halved into P2 triangles"),
        ("point law", "Dormand-Prince with tolerance 1e-11 and Newton to 1e-11, so that only the steps make an error"),
        ("reference", f"{REFERENCE_STEPS} load steps"),
        ("error", "of the volume means at the end: q/p and a_c absolute, z relative"),
    ),
    columns=(
        *COMMON_COLUMNS,
        Column("load_steps", "load steps asked for"),
        Column("accepted_steps", "steps taken, initial stage included"),
        Column("cuts", "abandoned attempts at a load step"),
        Column("newton_iterations", "corrections by a linear solve, predictors included"),
        Column("factorisations", "factorisations"),
        Column("krylov_iterations", "Krylov iterations"),
        Column("error_of_points", "largest relative error of z of all integration points"),
    ),
    rows=rows,
    draw=draw,
    findings=findings,
)
