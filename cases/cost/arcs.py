"""Study: closed-form integrals over the arcs of loss and gain against quadrature."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np

from constitutive.parameters import Closure, Distribution, Integration, Integrator

from .batch import PATH_STRAIN, distance, follow, initial_state, law_of, make_batch, rate_evaluations
from .clock import best_of
from .draw import work_precision
from .front import cheapest, mark_fronts
from .study import COMMON_COLUMNS, Axes, Column, Effort, Row, Study, StudyError

INTEGRATOR: Integrator = "bogacki_shampine"
SUBSTEPS = 16
"""Fixed, so that every setting takes the same substeps and only the integrals differ."""
DIRECTIONS = (4, 8, 16, 32, 64, 128)
REFERENCE_DIRECTIONS = 256
ROUNDING = 1e-14
"""Smaller errors are raised to this: what is left are roundings of 64 evaluations."""
ARCS = 2
"""One arc of loss and one of gain, each with its own Gauss points."""

AXES = Axes(
    error="largest error of $\\sigma/p$, $z$, $a_c$ [-]",
    seconds="processor time per point and path [s]",
    count="evaluations of the integrand per point and path (closed form: 1 each time)",
    facet_titles={"harmonic": "harmonic distribution", "maximum_entropy": "maximum-entropy distribution"},
)


def _integration(directions: int) -> Integration:
    """Numerics with Gauss points, or with the closed form for 0 directions."""
    if directions == 0:
        return Integration(integrator=INTEGRATOR, substeps=SUBSTEPS, arc_integration="closed_form")
    return Integration(integrator=INTEGRATOR, substeps=SUBSTEPS, arc_integration="gauss", directions=directions)


def rows(effort: Effort) -> list[Row]:
    """Both distributions, all numbers of directions; see `Study.rows`."""
    batch = make_batch(16 if effort.quick else 256)
    points, start = len(batch.stress), initial_state(law_of(_integration(0)), batch)
    directions = DIRECTIONS[1:4] if effort.quick else DIRECTIONS
    plan = [
        (distribution, number)
        for distribution in get_args(Distribution)
        for number in ((0,) if distribution == "harmonic" else ()) + directions
    ]
    total = len(plan) * (effort.rounds + 1)
    closures = {name: Closure(distribution=name) for name in get_args(Distribution)}
    references = {
        name: follow(law_of(_integration(REFERENCE_DIRECTIONS), closure), batch, start, 1)
        for name, closure in closures.items()
    }
    for name, end in references.items():
        if end.failed:
            raise StudyError(f"{end.failed} of {points} points cannot follow their reference path with {name}")
    apart = distance(references["maximum_entropy"], references["harmonic"])
    table: list[Row] = []
    for place, (distribution, number) in enumerate(plan):
        effort.advance(place, total, f"{distribution}, {number or 'no'} directions")
        end = follow(law_of(_integration(number), closures[distribution]), batch, start, 1)
        errors = np.maximum(distance(end, references[distribution]), ROUNDING)
        evaluations = rate_evaluations(end, INTEGRATOR) / points
        table.append(
            {
                "facet": distribution,
                "series": "Gauss points on each arc" if number else "closed form",
                "setting": f"{number} directions" if number else "closed form",
                "error": float(errors.max()) if not end.failed else float("nan"),
                "seconds": 0.0,
                "count": evaluations * (ARCS * number if number else 1),
                "directions": number,
                "rate_evaluations": evaluations,
                "error_median": float(np.median(errors)),
                "distance_of_distributions": float(apart.max()),
                "failed_points": end.failed,
            }
        )
    calls = [partial(follow, law_of(_integration(number), closures[name]), batch, start, 1) for name, number in plan]
    times = best_of(calls, effort.rounds, lambda done: effort.advance(len(plan) + done, total, "timing"))
    for row, seconds in zip(table, times):
        row["seconds"] = seconds / points
    mark_fronts(table)
    return table


def draw(path: Path, table: Sequence[Row]) -> None:
    """The work-precision picture of the arcs."""
    work_precision(path, "Integrals over the arcs of loss and gain, strain path of $10^{-4}$", AXES, table)


def findings(table: Sequence[Row]) -> list[str]:
    """What the numbers say."""
    said = []
    closed = next((row for row in table if row["directions"] == 0), None)
    for distribution in get_args(Distribution):
        members = [row for row in table if row["facet"] == distribution and row["directions"]]
        best = cheapest(members, 1e-10, "count")
        if best is not None:
            said.append(
                f"{distribution.replace('_', ' ').capitalize()}: {best['directions']} Gauss points an arc leave an "
                f"error of {best['error']:.1e}, below any tolerance of the integration in time."
            )
    shared = {row["directions"]: row for row in table if row["facet"] == "harmonic"}
    other = {row["directions"]: row for row in table if row["facet"] == "maximum_entropy"}
    if closed is not None and 32 in shared and 32 in other:
        said.append(
            f"The closed form costs {closed['seconds'] / shared[32]['seconds']:.2g} of the time of 32 Gauss points; "
            f"maximum entropy with 32 points takes {other[32]['seconds'] / closed['seconds']:.3g} times the time of "
            "the harmonic closed form."
        )
    if table:
        said.append(
            f"The two distributions are up to {table[0]['distance_of_distributions']:.2g} apart at the end of the "
            "paths: a difference of the model, not an error of either."
        )
    return said


STUDY = Study(
    name="arcs",
    title="Closed-form arcs against quadrature",
    question="How many directions does the quadrature over the arcs need, and what does the closed form save?",
    knobs=(
        ("directions", "4 ... 128 Gauss points on each arc, or the closed form (harmonic distribution only)"),
        ("distribution", "harmonic, maximum entropy"),
        ("path", f"strain of {PATH_STRAIN:g} in one increment, {SUBSTEPS} fixed Bogacki-Shampine substeps"),
        ("points", "256, chosen as for the integrators"),
        ("reference", f"{REFERENCE_DIRECTIONS} Gauss points on each arc"),
        ("error", "largest over all points of stress over p, z relative, a_c"),
    ),
    columns=(
        *COMMON_COLUMNS,
        Column("directions", "Gauss points on each arc, 0 for the closed form"),
        Column("rate_evaluations", "evaluations of the rates per point and path"),
        Column("error_median", "median error of the points"),
        Column("distance_of_distributions", "largest difference of the two references: of the models, not an error"),
        Column("failed_points", "points that the law refused"),
    ),
    rows=rows,
    draw=draw,
    findings=findings,
)
