"""The contact law behind the same contract in the same host: homogeneous fields, Newton, kept factors."""

from __future__ import annotations

import numpy as np
import pytest
from fem_meshes import ELEMENTS, distorted, run

from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Material
from granfabric.constitutive.path import Leg, drive
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.stepping import StepControl
from granfabric.fem.loads.kinds import Displacement, Fixed, FixedPoint, Pressure, Stage
from granfabric.fem.mesh.host_mesh import rectangle

PRESSURE = 1e5
# Softer than uniform strain has it, so that Poisson's ratio is not zero and platens matter.
LAW = ContactLaw(
    [
        Material(
            coordination=4.06,
            solid_fraction=0.846,
            normal_stiffness=1e4 * PRESSURE,
            bulk_reduction=0.88,
            shear_reduction=0.69,
        )
    ]
)
SIDES = ("bottom", "right", "top", "left")


@pytest.mark.parametrize("element", ELEMENTS)
def test_every_point_of_a_homogeneous_test_equals_the_point_driver(element):
    # Strain prescribed through a linear displacement of the boundary: compression along y, extension along x, shear.
    gradient = np.array([[3e-5, 2e-5], [1e-5, -8e-5]])
    strain = (gradient[0, 0], gradient[1, 1], gradient[0, 1] + gradient[1, 0])
    space = Space(distorted(element), element)
    loads = [
        Displacement(side, component, lambda x, y, i=i: gradient[i, 0] * x + gradient[i, 1] * y)
        for side in SIDES
        for i, component in enumerate(("x", "y"))
    ]
    steps, summary = run(
        space,
        LAW,
        [Stage("strain", loads, 5)],
        StepControl(tolerance=1e-14),
        initial_stress=(-PRESSURE, -PRESSURE, 0.0),
        balance_initial_stress=True,
    )
    assert summary.finished, summary.message
    history = drive(LAW, (-PRESSURE, -PRESSURE, 0.0), [Leg(("strain",) * 3, strain, 5)])
    assert history.finished
    last = steps[-1]
    np.testing.assert_allclose(last.stress, np.tile(history.stress, (space.npoints, 1)), rtol=0, atol=1e-10 * PRESSURE)
    expected = np.tile(history.state, (space.npoints, 1))
    np.testing.assert_allclose(last.state, expected, rtol=1e-10, atol=1e-10)
    assert abs(history.state[0, 0] - 4.06) > 0.01  # contacts were lost


def test_smooth_platens_keep_the_specimen_homogeneous():
    space = Space(distorted("P2"), "P2")
    loads = [
        Fixed("bottom", ("y",)),
        Fixed("top", ("y",)),
        FixedPoint((0.0, 0.0)),
        Pressure("left", PRESSURE),
        Pressure("right", PRESSURE),
    ]
    stages = [Stage("initial", loads), Stage("compression", [Displacement("top", "y", -1e-4)], 4)]
    steps, summary = run(space, LAW, stages, StepControl(tolerance=1e-13), initial_stress=(-PRESSURE, -PRESSURE, 0.0))
    assert summary.finished, summary.message
    last = steps[-1]
    np.testing.assert_allclose(last.stress[:, 0], -PRESSURE, rtol=1e-9)
    assert np.ptp(last.stress[:, 1]) <= 1e-9 * PRESSURE and np.abs(last.stress[:, 2]).max() <= 1e-9 * PRESSURE
    assert last.reactions["top"][1] == pytest.approx(last.stress[:, 1].mean() * 2.0, rel=1e-9)
    assert np.ptp(last.state[:, 0]) <= 1e-9


def rough_platens(forcing=None, tolerance=1e-8, steps=5, n=6):
    space = Space(rectangle(1.0, 2.0, n, 2 * n), "P2")
    loads = [Fixed("bottom"), Fixed("top"), Pressure("left", PRESSURE), Pressure("right", PRESSURE)]
    stages = [Stage("initial", loads), Stage("compression", [Displacement("top", "y", -4e-4)], steps)]
    control = StepControl(tolerance=tolerance, forcing=forcing)
    return run(space, LAW, stages, control, initial_stress=(-PRESSURE, -PRESSURE, 0.0))


@pytest.mark.parametrize("steps", [1, 2])
def test_newton_is_quadratic_with_the_propagated_tangent(steps):
    # Large steps of ten and twenty substeps; linear solves far more exact than they need be. The tangent freezes the
    # sizes of the substeps, which is not seen here.
    records, summary = rough_platens(forcing=1e-13, tolerance=1e-10, steps=steps)
    assert summary.finished, summary.message
    assert records[-1].substeps > 5 * records[-1].status.size
    older, old, new = records[1].residuals
    assert old < 1e-4 and new > 1e-13  # in the basin, above rounding
    assert np.log(new / old) / np.log(old / older) > 1.9


def test_a_mild_nonlinearity_needs_less_than_one_factorisation_a_step():
    steps, summary = rough_platens()
    assert summary.finished, summary.message
    assert summary.counters["factorisations"] < summary.counters["steps"]
    assert all(step.iterations <= 3 for step in steps)
    # The ends hold the specimen sideways: the fields are far from uniform.
    assert np.ptp(steps[-1].state[:, 0]) > 0.05
