"""Study: which integrator, at which tolerance, for which size of strain increment."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from constitutive.parameters import Integration

from .batch import Batch, End, distance, follow, initial_state, law_of, make_batch, rate_evaluations
from .clock import best_of
from .draw import work_precision
from .front import cheapest, mark_fronts, slope
from .study import COMMON_COLUMNS, Axes, Column, Effort, Row, Study, StudyError

EMBEDDED = ("modified_euler", "bogacki_shampine", "dormand_prince")
NAMES = {
    "forward_euler": "forward Euler, fixed",
    "modified_euler": "modified Euler 2(1)",
    "bogacki_shampine": "Bogacki-Shampine 3(2)",
    "dormand_prince": "Dormand-Prince 5(4)",
}
ORDERS = {"forward_euler": 1, "modified_euler": 2, "bogacki_shampine": 3, "dormand_prince": 5}
INCREMENTS = {"1e-4": 1, "1e-6": 100}
"""Increments of the path by their size; the path is the same."""
TOLERANCES = tuple(10.0**-power for power in range(2, 11))
SUBSTEPS = tuple(2**power for power in range(11))
MOST_FIXED = 6400
"""Fixed substeps over the whole path beyond which nothing new is learned."""
REFERENCE_TOLERANCE = 1e-12
REFERENCE_INCREMENTS, QUICK_REFERENCE_INCREMENTS = 3200, 400
ROUNDING = 1e-14
"""No error below this means anything: about fifty roundings."""

AXES = Axes(
    error="largest error of $\\sigma/p$, $z$, $a_c$ [-]",
    seconds="processor time per point and path [s]",
    count="evaluations of the rates per point and path",
    facet_titles={
        "1e-4": "one strain increment of $10^{-4}$",
        "1e-6": "the same path in 100 increments of $10^{-6}$",
    },
)


def _settings(quick: bool, increments: int) -> list[Integration]:
    fixed = SUBSTEPS[:8:2] if quick else SUBSTEPS
    tolerances = TOLERANCES[1:8:3] if quick else TOLERANCES
    made = [
        Integration(integrator="forward_euler", substeps=number)
        for number in fixed
        if number == 1 or number * increments <= MOST_FIXED
    ]
    for integrator in EMBEDDED:
        made += [
            Integration(integrator=integrator, tolerance=tolerance, maximum_substeps=10_000_000)  # type: ignore[arg-type]
            for tolerance in tolerances
        ]
    return made


def _substeps(number: int) -> str:
    return "1 substep" if number == 1 else f"{number} substeps"


def reference(batch: Batch, quick: bool) -> tuple[End, float]:
    """The end of the paths as exactly as it can be had, and how exactly that is.

    A path is straight, so its end does not depend on the increments. Many short ones resolve where an arc of loss
    closes or opens, which error control steps over without notice; the distance to half as many tells the uncertainty.

    Raises
    ------
    StudyError
        If a point fails on its path.
    """
    law = law_of(Integration(integrator="dormand_prince", tolerance=REFERENCE_TOLERANCE, maximum_substeps=10_000_000))
    start = initial_state(law, batch)
    increments = QUICK_REFERENCE_INCREMENTS if quick else REFERENCE_INCREMENTS
    end, half = (follow(law, batch, start, number) for number in (increments, increments // 2))
    if end.failed or half.failed:
        raise StudyError(f"{end.failed} of {len(batch.stress)} points cannot follow their reference path")
    return end, max(float(distance(end, half).max()), ROUNDING)


def rows(effort: Effort) -> list[Row]:
    """All integrators on the same paths; see `Study.rows`."""
    batch = make_batch(16 if effort.quick else 512)
    points, start = len(batch.stress), initial_state(law_of(Integration()), batch)
    plan = [
        (facet, increments, setting)
        for facet, increments in list(INCREMENTS.items())[: 1 if effort.quick else None]
        for setting in _settings(effort.quick, increments)
    ]
    total = len(plan) * (effort.rounds + 1)
    effort.advance(0, total, "reference")
    exact, uncertainty = reference(batch, effort.quick)
    table: list[Row] = []
    for place, (facet, increments, setting) in enumerate(plan):
        text = f"{setting.integrator}, increment {facet}"
        effort.advance(place, total, text)
        end = follow(law_of(setting), batch, start, increments)
        errors = np.maximum(distance(end, exact), uncertainty)
        fixed = setting.integrator == "forward_euler"
        table.append(
            {
                "facet": facet,
                "series": NAMES[setting.integrator],
                "setting": _substeps(setting.substeps) if fixed else f"tolerance {setting.tolerance:.0e}",
                "error": float(errors.max()) if not end.failed else float("nan"),
                "seconds": 0.0,
                "count": rate_evaluations(end, setting.integrator) / points,
                "integrator": setting.integrator,
                "tolerance": 0.0 if fixed else setting.tolerance,
                "fixed_substeps": setting.substeps,
                "substeps": end.accepted / points,
                "rejected": end.rejected / points,
                "error_median": float(np.median(errors)),
                "error_biaxial": float(errors[batch.biaxial].max()),
                "error_random": float(errors[~batch.biaxial].max()),
                "reference_uncertainty": uncertainty,
                "failed_points": end.failed,
            }
        )
    calls = [partial(follow, law_of(setting), batch, start, increments) for _, increments, setting in plan]
    times = best_of(calls, effort.rounds, lambda done: effort.advance(len(plan) + done, total, "timing"))
    for row, seconds in zip(table, times):
        row["seconds"] = seconds / points
    mark_fronts(table)
    return table


def draw(path: Path, table: Sequence[Row]) -> None:
    """The work-precision picture of the integrators."""
    work_precision(path, "Integrators at a point, strain path of $10^{-4}$", AXES, table)


def observed_order(table: Sequence[Row], integrator: str, facet: str) -> float:
    """Order of the error in the number of substeps on the biaxial path, from the asymptotic settings.

    Rejected substeps are no part of it. Errors at the level of the reference, and settings that take one substep an
    increment, do not tell an order.
    """
    least = INCREMENTS[facet]
    chosen = [
        row
        for row in table
        if row["facet"] == facet
        and row["integrator"] == integrator
        and row["substeps"] > 2 * least
        and row["error_biaxial"] > 10 * row["reference_uncertainty"]
    ]
    return -slope([row["substeps"] for row in chosen], [row["error_biaxial"] for row in chosen])


def findings(table: Sequence[Row]) -> list[str]:
    """What the numbers say."""
    said = []
    for facet, title in AXES.facet_titles.items():
        members = [row for row in table if row["facet"] == facet]
        plain = title.replace("$10^{-4}$", "1e-4").replace("$10^{-6}$", "1e-6")
        for error in (1e-3, 1e-6, 1e-9):
            best = cheapest(members, error)
            counted = cheapest(members, error, "count")
            if best is None or counted is None:
                continue
            text = (
                f"{plain.capitalize()}: an error of {error:g} costs least with {best['series']}, {best['setting']} "
                f"({best['seconds'] * 1e6:.3g} µs and {best['count']:.3g} evaluations of the rates a point and path)"
            )
            if counted["series"] != best["series"]:
                text += f"; fewest evaluations take {counted['series']}, {counted['setting']} ({counted['count']:.3g})"
            said.append(text + ".")
    said.append(f"The reference is known to {table[0]['reference_uncertainty']:.1e}.")
    orders = {name: observed_order(table, name, "1e-4") for name in ORDERS}
    known = [f"{NAMES[name]} {order:.1f}" for name, order in orders.items() if np.isfinite(order)]
    said.append("Observed orders in the number of substeps, biaxial path: " + ", ".join(known) + ".")
    return said


STUDY = Study(
    name="integrators",
    title="Integrators of the point law",
    question="Which integrator reaches a wanted accuracy of the point update at least cost?",
    knobs=(
        (
            "integrator",
            "forward Euler with fixed substeps; modified Euler 2(1), Bogacki-Shampine 3(2), "
            "Dormand-Prince 5(4) under error control",
        ),
        ("tolerance", "1e-2 ... 1e-10"),
        ("fixed substeps", f"1 ... 1024, up to {MOST_FIXED} a path"),
        ("increment", "strain of 1e-4 in one increment, or in 100 of 1e-6"),
        (
            "points",
            "512: a quarter biaxial under turned axes, the others compressed and sheared in random directions "
            "from q/p up to 0.2, so that loading, unloading and turning axes occur",
        ),
        (
            "reference",
            f"Dormand-Prince, {REFERENCE_INCREMENTS} increments under tolerance {REFERENCE_TOLERANCE:g}; errors "
            "below its uncertainty (against half as many) are raised to it",
        ),
        ("error", "largest over all points of stress over p, z relative, a_c"),
    ),
    columns=(
        *COMMON_COLUMNS,
        Column("integrator", "name in a scene"),
        Column("tolerance", "tolerance of error control, 0 without"),
        Column("fixed_substeps", "fixed substeps an increment, 0 under error control"),
        Column("substeps", "accepted substeps per point and path"),
        Column("rejected", "rejected substeps per point and path"),
        Column("error_median", "median error of the points"),
        Column("error_biaxial", "largest error of the biaxial points"),
        Column("error_random", "largest error of the random directions"),
        Column("reference_uncertainty", "how exactly the reference is known; smaller errors are raised to it"),
        Column("failed_points", "points that the law refused"),
    ),
    rows=rows,
    draw=draw,
    findings=findings,
)
