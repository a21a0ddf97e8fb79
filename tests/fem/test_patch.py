"""Fields that the elements represent exactly come out exactly, on distorted meshes."""

from __future__ import annotations

import numpy as np
import pytest
from fem_meshes import ELASTIC, ELEMENTS, PLASTIC, distorted, nodal, run

from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.stepping import StepControl
from granfabric.fem.loads.kinds import Displacement, Fixed, FixedPoint, Pressure, Stage, Traction

SIDES = ("bottom", "right", "top", "left")
GRADIENT = np.array([[1e-3, 4e-4], [-7e-4, 2e-3]])
STRAIN = np.array([GRADIENT[0, 0], GRADIENT[1, 1], GRADIENT[0, 1] + GRADIENT[1, 0]])


def linear_displacements():
    return [
        Displacement(side, component, lambda x, y, i=i: GRADIENT[i, 0] * x + GRADIENT[i, 1] * y)
        for side in SIDES
        for i, component in enumerate(("x", "y"))
    ]


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("law", [ELASTIC, PLASTIC], ids=["elastic", "von Mises"])
def test_linear_displacements_of_the_boundary_give_uniform_strain(element, law):
    space = Space(distorted(element), element)
    steps, summary = run(space, law, [Stage("stretch", linear_displacements(), 2)], StepControl(tolerance=1e-14))
    assert summary.finished, summary.message
    last = steps[-1]
    scale = np.abs(STRAIN).max()
    np.testing.assert_allclose(last.strain, np.tile(STRAIN, (space.npoints, 1)), rtol=0, atol=1e-12 * scale)
    np.testing.assert_allclose(nodal(last), space.nodes @ GRADIENT.T, rtol=0, atol=1e-12 * scale * 2)
    spread = np.ptp(last.stress, axis=0).max()
    assert spread <= 1e-11 * np.abs(last.stress).max()
    if law is PLASTIC:
        assert (last.state[:, 1] > 1e-4).all()  # the test is about plastic flow


@pytest.mark.parametrize("element", ELEMENTS)
def test_uniform_tractions_give_uniform_stress(element):
    space = Space(distorted(element), element)
    stress = np.array([2.0, -1.0, 0.5])

    def traction(x, y, nx, ny):
        return np.stack([stress[0] * nx + stress[2] * ny, stress[2] * nx + stress[1] * ny], axis=1)

    loads = [Traction(side, traction) for side in SIDES]
    loads += [FixedPoint((0.0, 0.0)), FixedPoint((2.0, 0.0), ("y",))]
    steps, summary = run(space, ELASTIC, [Stage("pull", loads)], StepControl(tolerance=1e-13))
    assert summary.finished, summary.message
    np.testing.assert_allclose(steps[-1].stress, np.tile(stress, (space.npoints, 1)), rtol=0, atol=1e-12 * 2)
    # The supports of an equilibrated body carry nothing.
    assert np.abs(list(steps[-1].reactions.values())).max() <= 1e-11


@pytest.mark.parametrize("element", ELEMENTS)
def test_uniform_pressure_is_in_balance_with_uniform_initial_stress(element):
    space = Space(distorted(element), element)
    stage = Stage("initial", [Fixed("bottom"), Fixed("top"), Pressure("left", 3.0), Pressure("right", 3.0)])
    steps, summary = run(space, ELASTIC, [stage], initial_stress=(-3.0, -5.0, 0.0))
    assert summary.finished, summary.message
    assert summary.counters["linear_solves"] == 0
    assert (steps[-1].displacement == 0.0).all()
    assert steps[-1].reactions["top"] == pytest.approx((0.0, -10.0), abs=1e-13 * 10)
    assert steps[-1].reactions["bottom"] == pytest.approx((0.0, 10.0), abs=1e-13 * 10)
