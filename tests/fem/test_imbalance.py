"""The imbalance of the initial state, against sums of nodal forces that can be written down."""

from __future__ import annotations

import numpy as np
import pytest

from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.imbalance import InitialImbalance, initial_imbalance
from granfabric.fem.loads.kinds import BodyForce, Displacement, Fixed, FixedPoint, Pressure, Stage
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import rectangle
from granfabric.fem.mesh.shapes import plate_with_hole, quarter_ring

P = 100e3
WEIGHT = 17e3
UNIFORM = (-P, -P, 0.0)
ELEMENTS = ["P1", "P2", "Q1", "Q2"]


def mesh_of(element: str, width: float, height: float, nx: int, ny: int):
    return rectangle(width, height, nx, ny, "triangle" if element[0] == "P" else "quad")


def imbalance(space: Space, loads: list, stress, name: str = "initial", **options) -> InitialImbalance:
    law = LinearElasticLaw(ElasticMaterial(1e8, 0.3))
    return initial_imbalance(Problem(space, law, [Stage(name, loads)], initial_stress=stress, **options))


def sides(space: Space, value: float) -> list:
    """Platens that hold y alone, so that every node is free in x, and pressure on the sides."""
    held = [Fixed("bottom", ("y",)), Fixed("top", ("y",)), FixedPoint((0.0, 0.0), ("x",))]
    return [*held[:2], *(Pressure(side, value) for side in ("left", "right"))]


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize(("width", "cells"), [(1.0, 4), (1.0, 16), (10.0, 4)])
@pytest.mark.parametrize(("pressure", "fraction"), [(P, 0.0), (0.99 * P, 0.01), (0.0, 1.0), (-P, 2.0), (10 * P, 0.9)])
def test_pressure_on_the_sides(element: str, width: float, cells: int, pressure: float, fraction: float) -> None:
    """Whatever element, mesh and slenderness: what is missing of the pressure over the larger of what should and does
    act.
    """
    space = Space(mesh_of(element, width, 2.0, cells, cells), element)
    found = imbalance(space, sides(space, pressure), UNIFORM)
    assert found.fraction == pytest.approx(fraction, rel=1e-12, abs=1e-13)
    assert found.total == pytest.approx(2 * 2.0 * abs(P - pressure), rel=1e-12, abs=1e-6)
    if fraction:
        assert found.place[0] in (0.0, width)
        assert np.hypot(*found.resultant) < 1e-9 * found.total


@pytest.mark.parametrize("cells", [2, 5, 40])
@pytest.mark.parametrize("factor", [1.0, 0.1, -1.0, 0.0, 1.02])
def test_weight(cells: int, factor: float) -> None:
    """A column under its weight and a surcharge, with another weight: over surcharge, weight and reaction."""
    width, height = 10.0, 5.0
    space = Space(rectangle(width, height, 4, cells), "P1")
    offset = height - space.points[:, 1]
    stress = np.stack([-(P + 8e3 * offset), -(P + WEIGHT * offset), 0.0 * offset], axis=1)
    held = [Fixed("bottom"), Fixed("left", ("x",)), Fixed("right", ("x",))]
    found = imbalance(space, [*held, Pressure("top", P), BodyForce((0.0, -factor * WEIGHT))], stress)
    body = WEIGHT * width * height * (1.0 - 1.0 / (2 * cells))  # part of the lowest row goes into the base
    acting = P * width + body, max(P * width + body, P * width + factor * body)
    expected = abs(1.0 - factor) * body / max(acting[0] + (P * width + body), acting[1])
    assert found.fraction == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert found.resultant[0] == pytest.approx(0.0, abs=1e-6)
    assert found.resultant[1] == pytest.approx((1.0 - factor) * -body, rel=1e-9, abs=1e-5)


@pytest.mark.parametrize("element", ELEMENTS)
def test_the_size_of_the_elements_does_not_matter(element: str) -> None:
    """Forces in the body, where Euclidean norms of nodal forces would fall with the square root of the size."""
    fractions = []
    for cells in (8, 48):
        space = Space(mesh_of(element, 1.0, 1.0, cells, cells), element)
        found = imbalance(space, [*sides(space, P), BodyForce((0.0, -WEIGHT))], UNIFORM)
        fractions.append(found.fraction)
    assert fractions[0] == pytest.approx(fractions[1], rel=0.15)
    # the weight over the reactions of both platens
    assert fractions[1] == pytest.approx(WEIGHT / (2 * P), rel=0.05)


def test_what_supports_carry_is_balanced() -> None:
    """All sides held: nothing is out of balance, with whatever stress; and nothing is divided by zero."""
    space = Space(rectangle(1.0, 1.0, 30, 30), "P1")
    held = [Fixed(side) for side in ("bottom", "top", "left", "right")]
    assert imbalance(space, held, (-P, -2 * P, 0.3 * P)).fraction < 1e-13
    assert imbalance(space, held, (0.0, 0.0, 0.0)).fraction == 0.0
    # a weight that is small against the stress is a small imbalance, although hardly anything else acts on free nodes
    light = imbalance(space, [*held, BodyForce((0.0, -0.01 * P))], UNIFORM)
    assert 0.004 < light.fraction < 0.005


def test_a_direction_in_which_hardly_anything_acts() -> None:
    """Rounding in a direction without forces of its own is no imbalance."""
    space = Space(rectangle(1.0, 1.0, 30, 30), "P2")
    loads = [Fixed("bottom"), Pressure("top", P)]
    assert imbalance(space, loads, (0.0, -P, 0.0)).fraction < 1e-10


@pytest.mark.parametrize(("element", "cells", "most"), [("P1", 4, 1e-12), ("P2", 4, 1e-12), ("P2", 16, 1e-12)])
def test_curved_boundaries_in_balance(element: str, cells: int, most: float) -> None:
    """Pressure on curved sides against the stress inside, by quadrature of both."""
    ring = Space(quarter_ring(1.0, 3.0, cells, cells, "triangle"), element)
    loads = [Fixed("bottom", ("y",)), Fixed("left", ("x",)), Pressure("inner", P), Pressure("outer", P)]
    assert imbalance(ring, loads, UNIFORM).fraction < most
    plate = Space(plate_with_hole(1.0, 4.0, 4.0, cells, cells, "triangle"), element)
    loads = [Fixed("bottom", ("y",)), Fixed("left", ("x",)), *(Pressure(s, P) for s in ("hole", "right", "top"))]
    assert imbalance(plate, loads, UNIFORM).fraction < most


def test_without_a_stage_for_the_outset() -> None:
    """Loads of a first stage of another name come up during it: everything is out of balance at first."""
    space = Space(rectangle(1.0, 2.0, 4, 8), "P2")
    loads = [*sides(space, P), Displacement("top", "y", 0.0)]
    loads = [load for load in loads if not (isinstance(load, Fixed) and load.boundary == "top")]
    found = imbalance(space, loads, UNIFORM, "press")
    assert found.fraction == pytest.approx(1.0, rel=1e-12)
    assert found.fraction_at_end < 1e-13
    half = imbalance(space, sides(space, 0.5 * P), UNIFORM, "press")
    assert half.fraction_at_end == pytest.approx(0.5, rel=1e-12)
    assert imbalance(space, sides(space, 0.5 * P), UNIFORM).fraction_at_end == pytest.approx(0.5, rel=1e-12)
