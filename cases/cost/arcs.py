"""Study: closed-form integrals over the arcs of loss and gain against quadrature."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from granfabric.cases.terminal.clock import best_of
from granfabric.constitutive.parameters import Closure, Integration, Integrator

from .batch import PATH_STRAIN, End, distance, follow, initial_state, law_of, make_batch
from .draw import work_precision
from .front import cheapest, mark_fronts
from .study import COMMON_COLUMNS, Axes, Column, Effort, Row, Study, StudyError

INTEGRATOR: Integrator = "bogacki_shampine"
SUBSTEPS = 16
"""Fixed, so that every setting takes the same substeps and only the integrals differ."""
DIRECTIONS = (4, 8, 16, 32, 64, 128)
"""On each arc; around the circle likewise, for which a scene says twice as many."""
REFERENCE_DIRECTIONS = 256
ROUNDING = 1e-14
"""Smaller errors are raised to this: what is left are roundings of 64 evaluations."""
ENOUGH = 1e-10
"""Below any tolerance that the integration in time is given in practice."""
DEFAULT_DIRECTIONS = Integration().directions
CLOSURES = {
    "harmonic": Closure(distribution="harmonic"),
    "maximum_entropy": Closure(distribution="maximum_entropy"),
    "shifted_distribution": Closure(force_change="shifted_distribution"),
}
RULES = {"harmonic": 2.0, "maximum_entropy": 2.0, "shifted_distribution": 0.5}
"""One arc of loss and one of gain, each with its own Gauss points; or half as many directions over the circle."""

AXES = Axes(
    error="largest error of $\\sigma/p$, $z$, $a_c$ [-]",
    seconds="processor time per point and path [s]",
    count="evaluations of the integrand per point and path",
    facet_titles={
        "harmonic": "mean field, harmonic distribution",
        "maximum_entropy": "mean field, maximum-entropy distribution",
        "shifted_distribution": "shifted distribution of weak forces",
    },
)


def _integration(directions: int) -> Integration:
    """Numerics with Gauss points, or with the closed form for 0 directions."""
    if directions == 0:
        return Integration(integrator=INTEGRATOR, substeps=SUBSTEPS, arc_integration="closed_form")
    return Integration(integrator=INTEGRATOR, substeps=SUBSTEPS, arc_integration="gauss", directions=directions)


def rows(effort: Effort) -> list[Row]:
    """Both distributions and the shifted one, all numbers of directions; see `Study.rows`."""
    batch = make_batch(16 if effort.quick else 64)
    points = len(batch.stress)
    directions = DIRECTIONS[1:4] if effort.quick else DIRECTIONS
    plan = [("harmonic", 0)]
    # those around the circle come to the same numbers
    plan += [(name, number if RULES[name] > 1.0 else 2 * number) for name in CLOSURES for number in directions]
    total = len(plan) * (effort.rounds + 1)

    def path(name: str, number: int) -> Callable[[], End]:
        law = law_of(_integration(number), CLOSURES[name])
        return partial(follow, law, batch, initial_state(law, batch), 1)

    references = {name: path(name, REFERENCE_DIRECTIONS)() for name in CLOSURES}
    for name, end in references.items():
        if end.failed:
            raise StudyError(f"{end.failed} of {points} points cannot follow their reference path with {name}")
    table: list[Row] = []
    calls = [path(name, number) for name, number in plan]
    for place, ((name, number), call) in enumerate(zip(plan, calls)):
        effort.advance(place, total, f"{name}, {number or 'no'} directions")
        end = call()
        errors = np.maximum(distance(end, references[name]), ROUNDING)
        evaluations = end.evaluations / points
        series = "equally spaced directions" if name == "shifted_distribution" else "Gauss points on each arc"
        table.append(
            {
                "facet": name,
                "series": series if number else "closed form",
                "setting": f"{number} directions" if number else "closed form",
                "error": float(errors.max()) if not end.failed else float("nan"),
                "seconds": 0.0,
                "count": evaluations * max(1.0, RULES[name] * number),
                "directions": number,
                "rate_evaluations": evaluations,
                "error_median": float(np.median(errors)),
                "distance_from_harmonic": float(distance(references[name], references["harmonic"]).max()),
                "failed_points": end.failed,
            }
        )
    times = best_of(calls, effort.rounds, lambda done: effort.advance(len(plan) + done, total, "timing"))
    for row, seconds in zip(table, times):
        row["seconds"] = seconds / points
    mark_fronts(table)
    return table


def draw(path: Path, table: Sequence[Row]) -> None:
    """The work-precision picture of the arcs."""
    work_precision(path, "Integrals over directions, strain path of $10^{-4}$", AXES, table)


def findings(table: Sequence[Row]) -> list[str]:
    """What the numbers say."""
    said = []
    by_place = {(row["facet"], row["directions"]): row for row in table}
    closed = by_place.get(("harmonic", 0))
    for name, title in AXES.facet_titles.items():
        members = [row for row in table if row["facet"] == name and row["directions"]]
        best = cheapest(members, ENOUGH, "count")
        if best is not None:
            text = f"{title[0].upper()}{title[1:]}: {best['directions']} directions leave an error of "
            said.append(f"{text}{best['error']:.1e}" + (" or less." if best["error"] <= ROUNDING else "."))
        default = by_place.get((name, DEFAULT_DIRECTIONS))
        if closed is not None and default is not None:
            said.append(
                f"{title[0].upper()}{title[1:]}: {DEFAULT_DIRECTIONS} directions (the default) take "
                f"{default['seconds'] / closed['seconds']:.3g} times the time of the harmonic closed form."
            )
    for name in ("maximum_entropy", "shifted_distribution"):
        some = next((row for row in table if row["facet"] == name), None)
        if some is not None:
            said.append(
                f"At the end of the paths {AXES.facet_titles[name]} is up to {some['distance_from_harmonic']:.2g} from "
                "the harmonic mean field: a difference of the model, not an error of either."
            )
    return said


STUDY = Study(
    name="arcs",
    title="Closed-form arcs against quadrature, and the closures",
    question="How many directions does the quadrature over the arcs need, and what does the closed form save?",
    knobs=(
        ("directions", "4 ... 128, or the closed form (harmonic mean field only)"),
        (
            "closure",
            "mean field, harmonic or maximum entropy (Gauss points on each arc); shifted distribution "
            "(directions equally spaced over the circle)",
        ),
        ("count", "evaluations of the integrand, one for each evaluation of the rates with the closed form"),
        ("path", f"strain of {PATH_STRAIN:g} in one increment, {SUBSTEPS} fixed Bogacki-Shampine substeps"),
        ("points", "64, chosen as for the integrators"),
        ("reference", f"{REFERENCE_DIRECTIONS} directions"),
        ("error", "largest over all points of stress over p, z relative, a_c"),
    ),
    columns=(
        *COMMON_COLUMNS,
        Column("directions", "on each arc or over the circle, 0 for the closed form"),
        Column("rate_evaluations", "evaluations of the rates per point and path"),
        Column("error_median", "median error of the points"),
        Column("distance_from_harmonic", "largest difference of the references: of the models, not an error"),
        Column("failed_points", "points that the law refused"),
    ),
    rows=rows,
    draw=draw,
    findings=findings,
)
