"""Study: which element, on how fine a mesh."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from granfabric.cases.terminal.clock import best_of

from .cylinder import compute, measure, quarter_ring
from .draw import work_precision
from .front import cheapest, mark_fronts, slope
from .study import COMMON_COLUMNS, Axes, Column, Effort, Row, Study

ELEMENTS = {"P1": "triangle", "Q1": "quad", "P2": "triangle", "Q2": "quad"}
SIZES = {1: (4, 8, 16, 32, 64, 128), 2: (2, 4, 8, 16, 32, 64)}
"""Cells along each side, by the order of the element."""
QUICK_SIZES = {1: (4, 8, 16), 2: (2, 4, 8)}

AXES = Axes(
    error="relative error of the displacement, $L_2$ norm [-]",
    seconds="processor time, from the mesh to the solution [s]",
    count="degrees of freedom",
    facet_titles={"cylinder": "thick cylinder under pressure, linear elastic"},
)


def rows(effort: Effort) -> list[Row]:
    """All elements on all meshes; see `Study.rows`."""
    sizes = QUICK_SIZES if effort.quick else SIZES
    plan = [(element, number) for element in ELEMENTS for number in sizes[int(element[1])]]
    total = len(plan) * (effort.rounds + 1)
    meshes = {(element, number): quarter_ring(ELEMENTS[element], number) for element, number in plan}
    table: list[Row] = []
    for place, (element, number) in enumerate(plan):
        effort.advance(place, total, f"{element}, {number} x {number} cells")
        solution = measure(meshes[element, number], element)
        table.append(
            {
                "facet": "cylinder",
                "series": element,
                "setting": f"{number} x {number} cells",
                "error": solution.displacement_error,
                "seconds": 0.0,
                "count": solution.degrees_of_freedom,
                "cells": number,
                "elements": solution.elements,
                "points": solution.points,
                "nonzeros": solution.nonzeros,
                "factorisations": solution.factorisations,
                "law_calls": solution.law_calls,
                "stress_error": solution.stress_error,
            }
        )
    calls = [partial(compute, meshes[element, number], element) for element, number in plan]
    times = best_of(calls, effort.rounds, lambda done: effort.advance(len(plan) + done, total, "timing"))
    for row, seconds in zip(table, times):
        row["seconds"] = seconds
    mark_fronts(table)
    return table


def draw(path: Path, table: Sequence[Row]) -> None:
    """The work-precision picture of elements and meshes."""
    legend = {element: f"{element}, observed order {order(table, element):.2f}" for element in ELEMENTS}
    work_precision(path, "Elements and mesh size against Lamé's closed form", AXES, table, legend=legend)


def order(table: Sequence[Row], element: str, error: str = "error") -> float:
    """Observed order in the cell size, from the three finest meshes."""
    members = sorted((row for row in table if row["series"] == element), key=lambda row: row["cells"])[-3:]
    return -slope([row["cells"] for row in members], [row[error] for row in members])


def findings(table: Sequence[Row]) -> list[str]:
    """What the numbers say."""
    orders = ", ".join(
        f"{element} {order(table, element):.2f} ({order(table, element, 'stress_error'):.2f})" for element in ELEMENTS
    )
    said = [f"Observed orders in the cell size, displacement (stress): {orders}."]
    for error in (1e-2, 1e-3, 1e-4, 1e-5):
        best = cheapest(table, error)
        if best is not None:
            said.append(
                f"An error of {error:g} costs least with {best['series']}, {best['setting']}: {best['count']} degrees "
                f"of freedom, {best['seconds'] * 1e3:.3g} ms."
            )
    linear = [row for row in table if row["series"] in ("P1", "Q1")]
    if linear:
        finest = min(linear, key=lambda row: row["error"])
        same = cheapest([row for row in table if row["series"] in ("P2", "Q2")], finest["error"])
        if same is not None:
            said.append(
                f"The most accurate linear mesh ({finest['series']}, {finest['setting']}, error {finest['error']:.1e}) "
                f"takes {finest['seconds'] / same['seconds']:.3g} times the time of {same['series']}, "
                f"{same['setting']}, which is as accurate."
            )
    return said


STUDY = Study(
    name="mesh",
    title="Elements and mesh size",
    question="Which element reaches a wanted accuracy of a boundary-value problem at least cost?",
    knobs=(
        ("element", "P1, P2, Q1, Q2"),
        ("cells", "4 ... 128 along each side (linear), 2 ... 64 (quadratic)"),
        ("scene", "quarter of a thick cylinder, radii 1 m and 2 m, under internal pressure; elastic, plane strain"),
        ("reference", "Lamé's closed form, whose tractions and displacements act on the straight-sided mesh"),
        ("error", "L2 norm of the displacement error over that of the displacement"),
    ),
    columns=(
        *COMMON_COLUMNS,
        Column("cells", "cells along each side"),
        Column("elements", "elements"),
        Column("points", "integration points"),
        Column("nonzeros", "entries of the stiffness matrix"),
        Column("factorisations", "factorisations of a solution"),
        Column("law_calls", "calls of the law, each for all points"),
        Column("stress_error", "L2 norm of the stress error at the integration points, relative"),
    ),
    rows=rows,
    draw=draw,
    findings=findings,
)
