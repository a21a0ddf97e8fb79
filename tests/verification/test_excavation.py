"""Excavation and fill against closed forms: Kirsch's hole made in stressed ground, a column that is filled in layers.

Sources: Kirsch's plate with a hole, Timoshenko & Goodier, Theory of Elasticity, 3rd ed. (1970), section 35; layers that
are placed one after the other in oedometric conditions, by integration (each carries what is placed on it, and settles
from when it is placed).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from granfabric.cases.field import closed_forms
from granfabric.cases.scene.schema_closed_form import ClosedForm, HoleInPlate
from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.stepping import StepControl, solve
from granfabric.fem.loads.kinds import BodyForce, Fixed, Stage, Traction
from granfabric.fem.loads.problem import Problem

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "fem"))
from changing_meshes import column, plate_and_core

E, NU = 1e9, 0.25
LAW = LinearElasticLaw(ElasticMaterial(E, NU))
G = E / (2 * (1 + NU))
K = G / (1 - 2 * NU)  # of the plane: lambda + G
STRESS = (-100e3, -60e3, 0.0)
FORM = HoleInPlate(radius=1.0, stress=list(STRESS))
KIRSCH = closed_forms.traction(ClosedForm(hole_in_plate=FORM), 1.0)
ROLLERS = [Fixed("bottom", ("y",)), Fixed("left", ("x",))]


def uniform(x, y, nx, ny):
    return np.stack([STRESS[0] * nx + 0 * ny, STRESS[1] * ny + 0 * nx], axis=1)


def nothing(x, y, nx, ny):
    return np.zeros((len(x), 2))


def run(host, stages, stress=STRESS):
    space = Space(host, "P2")
    steps = []
    summary = solve(Problem(space, LAW, stages, initial_stress=stress), StepControl(), on_step=steps.append)
    assert summary.finished
    return space, steps


def far(traction):
    return [Traction("right", traction), Traction("top", traction)]


def excavated(n):
    _, whole = plate_and_core(n)
    initial = Stage("initial", [*ROLLERS, *far(uniform)])
    return run(whole, [initial, Stage("hole", far(KIRSCH), 2, deactivate=["core"])])


@pytest.fixture(scope="module")
def coarse():
    return excavated(4)


def test_excavation_is_the_release_of_a_boundary_pressure(coarse):
    space, steps = coarse
    alone, _ = plate_and_core(4)
    initial = Stage("initial", [*ROLLERS, *far(uniform), Traction("hole", uniform)])
    release = [*far(KIRSCH), Traction("hole", nothing)]
    other, others = run(alone, [initial, Stage("hole", release, 2)])
    for one, two in zip(steps, others):
        there = np.array([np.argmin(np.linalg.norm(space.nodes - place, axis=1)) for place in other.nodes])
        ours = one.displacement.reshape(-1, 2)[there]
        theirs = two.displacement.reshape(-1, 2)
        assert np.abs(ours - theirs).max() <= 1e-11 * np.abs(others[-1].displacement).max()


def test_nothing_is_left_of_the_core(coarse):
    space, steps = coarse
    last = steps[-1]
    core = space.host_mesh.cells("core")
    assert not last.active[core].any() and last.active.sum() == space.nelements - len(core)
    absent = ~last.active[space.point_cell]
    assert not last.stress[absent].any() and not last.strain[absent].any()
    middle = np.argmin(np.linalg.norm(space.nodes, axis=1))
    assert not last.displacement.reshape(-1, 2)[middle].any()
    assert steps[0].active.all()


def test_the_hole_is_kirschs_in_the_limit():
    errors = []
    for n in (4, 8, 16):
        space, steps = excavated(n)
        fine = Space(space.host_mesh, "P2", quadrature_degree=6)
        there = steps[-1].active[fine.point_cell]
        x, y = fine.points[there].T
        exact = closed_forms.hole_in_plate_displacement(FORM, x, y, K, G)
        exact -= np.stack(
            [
                (STRESS[0] + STRESS[1]) / (4 * K) * x + (STRESS[0] - STRESS[1]) / (4 * G) * x,
                (STRESS[0] + STRESS[1]) / (4 * K) * y - (STRESS[0] - STRESS[1]) / (4 * G) * y,
            ],
            axis=1,
        )
        computed = fine.interpolate(steps[-1].displacement.reshape(-1, 2))[there]
        weights = fine.weights[there]
        size = np.sqrt(weights @ np.sum(exact**2, axis=1))
        of_displacement = np.sqrt(weights @ np.sum((computed - exact) ** 2, axis=1)) / size
        here = steps[-1].active[space.point_cell]
        truth = closed_forms.hole_in_plate_stress(FORM, *space.points[here].T)
        change = np.sum((steps[-1].stress[here] - truth) ** 2, axis=1)
        of_stress = np.sqrt(space.weights[here] @ change / (space.weights[here] @ np.sum(truth**2, axis=1)))
        errors.append([of_displacement, of_stress])
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    print(errors, orders)
    assert errors[-1][0] < 1e-4 and errors[-1][1] < 1e-3
    assert orders[-1, 0] > 2.7 and orders[-1, 1] > 1.8


def settlement(y, layers, weight, modulus):
    """Settlement at a height, of layers of 1 m that are placed one after the other, each from where it is placed."""
    own = max(int(np.ceil(y - 1e-9)), 1)  # an interface belongs to the layer below, which is there first
    found = 0.0
    for stage in range(own, layers + 1):
        base = stage - 1.0
        below = min(y, base)
        found += weight * 1.0 * below / modulus
        if y > base:
            found += weight * ((stage - base) ** 2 - (stage - y) ** 2) / (2 * modulus)
    return -found


def test_a_column_filled_in_layers():
    layers, weight = 4, 20e3
    host = column(layers)
    sides = [Fixed("bottom"), Fixed("left", ("x",)), Fixed("right", ("x",))]
    stages = [Stage("initial", [*sides, BodyForce((0.0, -weight))])]
    stages += [Stage(f"layer {k}", [], 2, activate=[f"layer_{k}"]) for k in range(2, layers + 1)]
    lam = K - G
    first_stress = np.zeros((len(Space(host, "P2").points), 3))
    space = Space(host, "P2")
    depth = 1.0 - space.points[:, 1]
    first_stress[:, 1] = -weight * depth
    first_stress[:, 0] = lam / (lam + 2 * G) * first_stress[:, 1]
    space, steps = run(host, stages, first_stress)
    last = steps[-1].displacement.reshape(-1, 2)
    exact = np.array([settlement(y, layers, weight, lam + 2 * G) for y in space.nodes[:, 1]])
    # the first layer was there in balance, without moving
    own = np.array([settlement(y, 1, weight, lam + 2 * G) if y <= 1 + 1e-9 else 0.0 for y in space.nodes[:, 1]])
    assert np.abs(last[:, 1] - (exact - own)).max() <= 1e-9 * np.abs(exact).max()
    assert np.abs(last[:, 0]).max() <= 1e-9 * np.abs(exact).max()
    vertical = -weight * (layers - space.points[:, 1])
    assert np.abs(steps[-1].stress[:, 1] - vertical).max() <= 1e-6 * weight
    # while it grows, what carries is the layers that are there
    total = [-step.reactions["bottom"][1] for step in steps]
    assert total[-1] == pytest.approx(-layers * weight) and total[0] == pytest.approx(-weight)
