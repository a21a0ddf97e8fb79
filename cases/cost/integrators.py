"""Study: which integrator, at which tolerance, for which size of strain increment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from granfabric.cases.terminal.clock import best_of
from granfabric.constitutive.parameters import Closure, Integration, Integrator

from .batch import Batch, End, distance, follow, initial_state, law_of, make_batch
from .draw import work_precision
from .front import cheapest, mark_fronts, slope
from .study import COMMON_COLUMNS, Axes, Column, Effort, Row, Study, StudyError

EMBEDDED: tuple[Integrator, ...] = ("modified_euler", "bogacki_shampine", "dormand_prince", "kennedy_carpenter")
NAMES = {
    "forward_euler": "forward Euler, fixed",
    "modified_euler": "modified Euler 2(1)",
    "bogacki_shampine": "Bogacki-Shampine 3(2)",
    "dormand_prince": "Dormand-Prince 5(4)",
    "kennedy_carpenter": "Kennedy-Carpenter 3(2), implicit",
}
ORDERS = {"forward_euler": 1, "modified_euler": 2, "bogacki_shampine": 3, "dormand_prince": 5, "kennedy_carpenter": 3}


@dataclass(frozen=True)
class Facet:
    """A closure and a size of increments; the path is the same in all.

    Parameters
    ----------
    closure : Closure
    increments : int
    points, reference_increments : int
    finest : dict of str to float
        Tolerances below this are left out because of what they would cost, by integrator; none otherwise.
    most_fixed : int
        Fixed substeps over the whole path beyond which nothing new is learned.
    """

    closure: Closure
    increments: int
    points: int = 512
    reference_increments: int = 3200
    finest: dict[str, float] = field(default_factory=dict)
    most_fixed: int = 6400


FACETS = {
    "mean field, 1e-4": Facet(Closure(), 1),
    "mean field, 1e-6": Facet(Closure(), 100),
    "shifted distribution, 1e-4": Facet(
        Closure(force_change="shifted_distribution"),
        1,
        points=48,
        reference_increments=400,
        finest={name: 1e-6 if name == "modified_euler" else 1e-8 for name in EMBEDDED},
        most_fixed=256,
    ),
    "fluctuating, 1e-4": Facet(
        Closure(force_change="fluctuating", tangential="self_consistent"),
        1,
        points=48,
        reference_increments=400,
        finest={name: 1e-6 if name == "modified_euler" else 1e-8 for name in EMBEDDED},
        most_fixed=256,
    ),
}
QUICK_FACETS = tuple(FACETS)[:1]
TOLERANCES = tuple(10.0**-power for power in range(2, 11))
SUBSTEPS = tuple(2**power for power in range(11))
REFERENCE_TOLERANCE = 1e-12
ROUNDING = 1e-14
"""No error below this means anything: about fifty roundings."""

AXES = Axes(
    error="largest error of $\\sigma/p$, $z$, $a_c$ [-]",
    seconds="processor time per point and path [s]",
    count="evaluations of the rates per point and path",
    facet_titles={
        "mean field, 1e-4": "mean field, one strain increment of $10^{-4}$",
        "mean field, 1e-6": "mean field, 100 increments of $10^{-6}$",
        "shifted distribution, 1e-4": "shifted distribution, one increment of $10^{-4}$",
        "fluctuating, 1e-4": "fluctuating weak forces, one increment of $10^{-4}$",
    },
)


def _settings(quick: bool, facet: Facet) -> list[Integration]:
    made = [
        Integration(integrator="forward_euler", substeps=number)
        for number in (SUBSTEPS[:8:2] if quick else SUBSTEPS)
        if number == 1 or number * facet.increments <= facet.most_fixed
    ]
    for integrator in EMBEDDED:
        made += [
            Integration(integrator=integrator, tolerance=tolerance, maximum_substeps=10_000_000)
            for tolerance in (TOLERANCES[1:8:3] if quick else TOLERANCES)
            if tolerance >= 0.99 * facet.finest.get(integrator, 0.0)
        ]
    return made


def _substeps(number: int) -> str:
    return "1 substep" if number == 1 else f"{number} substeps"


def reference(batch: Batch, closure: Closure, increments: int) -> tuple[End, float]:
    """The end of the paths as exactly as it can be had, and how exactly that is.

    A path is straight, so its end does not depend on the increments. Many short ones resolve where an arc of loss
    closes or opens, which error control steps over without notice; the distance to half as many tells the uncertainty.

    Raises
    ------
    StudyError
        If a point fails on its path.
    """
    law = law_of(
        Integration(integrator="dormand_prince", tolerance=REFERENCE_TOLERANCE, maximum_substeps=10_000_000), closure
    )
    start = initial_state(law, batch)
    end, half = (follow(law, batch, start, number) for number in (increments, increments // 2))
    if end.failed or half.failed:
        raise StudyError(f"{end.failed} of {len(batch.stress)} points cannot follow their reference path")
    return end, max(float(distance(end, half).max()), ROUNDING)


def rows(effort: Effort) -> list[Row]:
    """All integrators on the same paths; see `Study.rows`."""
    facets = {name: FACETS[name] for name in (QUICK_FACETS if effort.quick else FACETS)}
    plan = [(name, setting) for name, facet in facets.items() for setting in _settings(effort.quick, facet)]
    total = len(plan) * (effort.rounds + 1)
    batches = {name: make_batch(16 if effort.quick else facet.points) for name, facet in facets.items()}
    exact: dict[str, tuple[End, float]] = {}
    for name, facet in facets.items():
        effort.advance(0, total, f"reference, {name}")
        twin = next((other for other in exact if facets[other].closure == facet.closure), None)
        increments = 400 if effort.quick else facet.reference_increments
        exact[name] = exact[twin] if twin else reference(batches[name], facet.closure, increments)
    table: list[Row] = []
    calls = []
    for place, (name, setting) in enumerate(plan):
        effort.advance(place, total, f"{setting.integrator}, {name}")
        facet, batch = facets[name], batches[name]
        points = len(batch.stress)
        law = law_of(setting, facet.closure)
        calls.append(partial(follow, law, batch, initial_state(law, batch), facet.increments))
        end = calls[-1]()
        goal, uncertainty = exact[name]
        errors = np.maximum(distance(end, goal), uncertainty)
        fixed = setting.integrator == "forward_euler"
        table.append(
            {
                "facet": name,
                "series": NAMES[setting.integrator],
                "setting": _substeps(setting.substeps)
                if fixed
                else f"tolerance 1e{round(np.log10(setting.tolerance))}",
                "error": float(errors.max()) if not end.failed else float("nan"),
                "seconds": 0.0,
                "count": end.evaluations / points,
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
    times = best_of(calls, effort.rounds, lambda done: effort.advance(len(plan) + done, total, "timing"))
    for row, seconds in zip(table, times):
        row["seconds"] = seconds / len(batches[row["facet"]].stress)
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
    least = FACETS[facet].increments
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
        if not members:
            continue
        plain = title[0].upper() + title[1:].replace("$10^{-4}$", "1e-4").replace("$10^{-6}$", "1e-6")
        for error in (1e-3, 1e-6, 1e-9):
            best, counted = cheapest(members, error), cheapest(members, error, "count")
            if best is None or counted is None:
                continue
            # settings that take the same substeps differ by the clock alone; the first of them stands for all
            best = next(row for row in members if (row["count"], row["error"]) == (best["count"], best["error"]))
            text = (
                f"{plain}: an error of {error:g} costs least with {best['series']}, {best['setting']} "
                f"({best['seconds'] * 1e6:.3g} µs and {best['count']:.3g} evaluations of the rates a point and path)"
            )
            if counted["series"] != best["series"]:
                text += f"; fewest evaluations take {counted['series']}, {counted['setting']} ({counted['count']:.3g})"
            said.append(text + ".")
    uncertain = max(row["reference_uncertainty"] for row in table)
    said.append(f"The references are known to {uncertain:.1e}.")
    orders = {name: observed_order(table, name, "mean field, 1e-4") for name in ORDERS}
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
            "Dormand-Prince 5(4) and the implicit Kennedy-Carpenter 3(2) under error control",
        ),
        ("tolerance", "1e-2 ... 1e-10 (shifted distribution and fluctuating: to 1e-8, modified Euler to 1e-6)"),
        ("fixed substeps", "1 ... 1024 an increment, up to 6400 a path"),
        ("increment", "strain of 1e-4 in one increment, or in 100 of 1e-6"),
        ("closure", "mean field; shifted distribution, fluctuating (one increment)"),
        (
            "points",
            "512 (shifted distribution, fluctuating: 48): a quarter biaxial under turned axes, the others compressed "
            "and sheared in random directions from q/p up to 0.2, so that loading, unloading and rotation occur",
        ),
        (
            "reference",
            f"Dormand-Prince, 3200 increments (400) under tolerance {REFERENCE_TOLERANCE:g}; errors "
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
