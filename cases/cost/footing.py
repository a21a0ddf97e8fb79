"""Study: elements and mesh size once more, on a rigid strip footing on a von Mises half square.

The edge of the footing is a singular point, and the limit load makes the response nearly incompressible: what the thick
cylinder lacks. Square of 5 m (half of a symmetric problem), bottom fixed, sides on rollers; the top edge x <= 1 m is
pressed down by 5 cm and may slide.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from granfabric.cases.terminal.clock import LONG, best_of
from granfabric.constitutive.plain_laws.von_mises import VonMisesLaw, VonMisesMaterial
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.control import StepControl
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.loads.kinds import Displacement, Fixed, Load, Stage
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import HostMesh, rectangle

from .draw import work_precision
from .front import cheapest, mark_fronts, slope
from .mesh import ELEMENTS
from .study import COMMON_COLUMNS, Axes, Column, Effort, Row, Study, StudyError

SIZE, FOOTING, SETTLEMENT, STEPS = 5.0, 1.0, 0.05, 10
YOUNGS_MODULUS, POISSONS_RATIO, YIELD_STRESS, HARDENING = 1000.0, 0.3, float(np.sqrt(3.0)), 10.0
TOLERANCE = 1e-8
SIZES = {1: (10, 20, 40, 80, 160), 2: (5, 10, 20, 40, 80)}
"""Cells along each side, by the order of the element; multiples of 5, so that a node is at the edge of the footing."""
QUICK_SIZES = {1: (5, 10, 20), 2: (5, 10, 20)}
REFERENCE_ELEMENTS = ("P2", "Q2")
"""Elements whose values on the three finest meshes are extrapolated to the reference."""

AXES = Axes(
    error="relative error of the mean pressure [-]",
    seconds="processor time, from the mesh to the solution [s]",
    count="degrees of freedom",
    facet_titles={"footing": "rigid strip footing, von Mises"},
)


@dataclass(frozen=True)
class Solution:
    """What a mesh and an element make of the footing.

    Parameters
    ----------
    pressure : float
        Mean pressure under the footing at the end [Pa].
    degrees_of_freedom, elements, points : int
    counters : dict of str to int
        As the solver counts them.
    seconds : float
        Processor time, from the mesh to the solution.
    """

    pressure: float
    degrees_of_freedom: int
    elements: int
    points: int
    counters: dict[str, int]
    seconds: float


def footing_mesh(cell: str, cells: int) -> HostMesh:
    """The square in `cells` by `cells` quadrilaterals, or each of them halved into triangles."""
    host = rectangle(SIZE, SIZE, cells, cells, cell)
    middle = host.mesh.p[:, host.mesh.facets].mean(axis=1)
    top = host.facets("top")
    return replace(host, boundaries={**host.boundaries, "footing": top[middle[0, top] < FOOTING]})


def compute(mesh: HostMesh, element: str) -> Solution:
    """Press the footing down.

    Raises
    ------
    StudyError
        If the solver does not finish.
    """
    since = time.process_time()
    space = Space(mesh, element)
    law = VonMisesLaw(VonMisesMaterial(YOUNGS_MODULUS, POISSONS_RATIO, YIELD_STRESS, HARDENING))
    loads: list[Load] = [
        Fixed("bottom"),
        Fixed("left", ("x",)),
        Fixed("right", ("x",)),
        Displacement("footing", "y", -SETTLEMENT),
    ]
    steps: list[StepResult] = []

    def keep(step: StepResult) -> None:
        steps[:] = [step]

    problem = Problem(space, law, [Stage("press", loads, STEPS)])
    summary = solve(problem, StepControl(tolerance=TOLERANCE, maximum_iterations=30), on_step=keep)
    if not summary.finished:
        raise StudyError(f"the footing with {element} elements was not solved: {summary.message}")
    pressure = -float(steps[-1].reactions["footing"][1]) / FOOTING
    seconds = time.process_time() - since
    return Solution(pressure, space.ndofs, space.nelements, space.npoints, dict(summary.counters), seconds)


def extrapolate(values: Sequence[float]) -> float:
    """Limit of the last three values of a sequence on meshes of halved size, whatever the order (Aitken).

    Raises
    ------
    StudyError
        If they do not converge.
    """
    first, second, third = values[-3:]
    before, last = second - first, third - second
    if not abs(last) < abs(before):
        raise StudyError(f"the values {first:g}, {second:g}, {third:g} do not converge with the mesh")
    return third - last**2 / (last - before)


def rows(effort: Effort) -> list[Row]:
    """All elements on all meshes; see `Study.rows`."""
    sizes = QUICK_SIZES if effort.quick else SIZES
    plan = [(element, number) for element in ELEMENTS for number in sizes[int(element[1])]]
    meshes = {(element, number): footing_mesh(ELEMENTS[element], number) for element, number in plan}
    compute(footing_mesh("triangle", 5), "P2")  # compile before the clock runs
    found: dict[tuple[str, int], Solution] = {}
    for place, (element, number) in enumerate(plan):
        effort.advance(place, len(plan) + 1, f"{element}, {number} x {number} cells")
        found[element, number] = compute(meshes[element, number], element)
    limits = [extrapolate([found[key].pressure for key in plan if key[0] == element]) for element in REFERENCE_ELEMENTS]
    reference = sum(limits) / len(limits)
    short = [key for key in plan if found[key].seconds < LONG]
    times = best_of(
        [partial(compute, meshes[key], key[0]) for key in short],
        effort.rounds,
        lambda done: effort.advance(len(plan), len(plan) + 1, "timing"),
    )
    seconds = {key: solution.seconds for key, solution in found.items()} | dict(zip(short, times))
    table: list[Row] = [
        {
            "facet": "footing",
            "series": element,
            "setting": f"{number} x {number} cells",
            "error": abs(solution.pressure / reference - 1.0),
            "seconds": seconds[element, number],
            "count": solution.degrees_of_freedom,
            "cells": number,
            "elements": solution.elements,
            "points": solution.points,
            "mean_pressure": solution.pressure,
            "reference_uncertainty": abs(limits[0] - limits[1]) / 2.0 / reference,
            **{name: solution.counters[name] for name in COUNTERS},
        }
        for (element, number), solution in found.items()
    ]
    mark_fronts(table)
    return table


COUNTERS = ("newton_iterations", "factorisations", "krylov_iterations", "law_calls", "cuts")


def order(table: Sequence[Row], element: str) -> float:
    """Observed order in the cell size, from the three finest meshes."""
    members = sorted((row for row in table if row["series"] == element), key=lambda row: row["cells"])[-3:]
    return -slope([row["cells"] for row in members], [row["error"] for row in members])


def draw(path: Path, table: Sequence[Row]) -> None:
    """The work-precision picture of the footing."""
    legend = {element: f"{element}, observed order {order(table, element):.2f}" for element in ELEMENTS}
    title = "Elements and mesh size, mean pressure under a footing"
    work_precision(path, title, AXES, table, legend=legend)


def findings(table: Sequence[Row]) -> list[str]:
    """What the numbers say."""
    orders = ", ".join(f"{element} {order(table, element):.2f}" for element in ELEMENTS)
    said = [
        f"Observed orders in the cell size: {orders}; the edge of the footing limits all elements to about one.",
        f"The reference is known to {table[0]['reference_uncertainty']:.1e} (difference of the extrapolations of "
        f"{' and '.join(REFERENCE_ELEMENTS)}).",
    ]
    for error in (0.05, 0.02, 0.01):
        best = cheapest(table, error)
        if best is not None:
            said.append(
                f"An error of {error:g} costs least with {best['series']}, {best['setting']}: {best['count']} degrees "
                f"of freedom, {best['seconds']:.3g} s, {best['factorisations']} factorisations."
            )
    finest = {row["series"]: row for row in sorted(table, key=lambda row: row["cells"])}
    said.append(
        "With the finest mesh of each: "
        + ", ".join(f"{name} {finest[name]['error']:.1e} in {finest[name]['seconds']:.3g} s" for name in ELEMENTS)
        + "."
    )
    return said


STUDY = Study(
    name="footing",
    title="Elements and mesh size on a footing",
    question="Which element is cheapest where the solution is singular and nearly incompressible?",
    knobs=(
        ("element", "P1, P2, Q1, Q2"),
        ("cells", "10 ... 160 along each side (linear), 5 ... 80 (quadratic)"),
        (
            "scene",
            f"half of a rigid strip footing, 5 m x 5 m, pressed down by {SETTLEMENT:g} m in {STEPS} steps; plane "
            f"strain, von Mises, E = {YOUNGS_MODULUS:g} Pa, nu = {POISSONS_RATIO:g}, yield stress sqrt(3) Pa, "
            f"H = {HARDENING:g} Pa",
        ),
        ("reference", "Aitken's extrapolation of the three finest meshes, mean of P2 and Q2"),
        ("error", "of the mean pressure under the footing at the end, relative"),
        ("time", "best of several; runs longer than a second are measured once"),
    ),
    columns=(
        *COMMON_COLUMNS,
        Column("cells", "cells along each side"),
        Column("elements", "elements"),
        Column("points", "integration points"),
        Column("mean_pressure", "mean pressure under the footing at the end", "Pa"),
        Column("reference_uncertainty", "how exactly the reference is known, relative"),
        Column("newton_iterations", "corrections by a linear solve, predictors included"),
        Column("factorisations", "factorisations"),
        Column("krylov_iterations", "Krylov iterations"),
        Column("law_calls", "calls of the law, each for all points"),
        Column("cuts", "abandoned attempts at a load step"),
    ),
    rows=rows,
    draw=draw,
    findings=findings,
)
