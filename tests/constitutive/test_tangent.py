"""Taylor remainder of the propagated tangent."""

import numpy as np
import pytest
from contact_law_cases import ALL_CLOSURES, EFFECT_SETS, SHIFTED, Points, closure_name, effects_name, law, material

from granfabric.constitutive.integration.runge_kutta import TABLEAUS
from granfabric.constitutive.parameters import Closure

STRESS = np.array([(-1.2e5, -0.85e5, 1e4), (-1.0e5, -1.0e5, 0.0), (-0.7e5, -1.1e5, -2e4), (-1.3e5, -1.1e5, 0.0)])
INCREMENT = np.array([(-3e-5, 2e-5, 2e-5), (-3e-5, 1e-5, -1e-5), (2e-5, 2e-5, 1e-5), (-2e-5, -3e-5, 4e-6)])
DIRECTION = np.array([(0.3, -0.5, 0.7), (0.4, 0.6, -0.3), (0.9, 0.1, 0.2), (-0.3, 0.5, 0.4)]) * 1e-5


def remainder_slopes(contact_law):
    """Slopes of |s(e + t v) - s(e) - t C v| with t, each point; the law is smooth around these increments."""
    points = Points(contact_law, STRESS)
    stress, _, tangent, report = points.update(INCREMENT)
    assert report.failed == 0
    sizes = 0.3 * 0.5 ** np.arange(9)
    change = np.einsum("pij,pj->pi", tangent, DIRECTION)
    remainders = [np.abs(points.update(INCREMENT + t * DIRECTION)[0] - stress - t * change).max(axis=1) for t in sizes]
    return np.array(remainders), sizes


def assert_second_order(contact_law):
    remainders, sizes = remainder_slopes(contact_law)
    for column in remainders.T:
        # a remainder at rounding (1e-16 of 1e5 Pa, few operations) means: linear, tangent exact
        if column.max() < 1e-8:
            continue
        # the slope is that of the limit: the smallest sizes whose remainder is well above rounding
        fit = np.flatnonzero(column > 1e-9)[-4:]
        slope = np.polyfit(np.log(sizes[fit]), np.log(column[fit]), 1)[0]
        assert slope > 1.9


@pytest.mark.parametrize("substeps", [1, 4])
@pytest.mark.parametrize("closure", [Closure(), SHIFTED[0]], ids=closure_name)
@pytest.mark.parametrize("effects", EFFECT_SETS, ids=effects_name)
def test_every_effect_set(effects, closure, substeps):
    assert_second_order(law(effects=effects, closure=closure, substeps=substeps))


@pytest.mark.parametrize("substeps", [1, 4])
@pytest.mark.parametrize("closure", ALL_CLOSURES, ids=closure_name)
def test_every_closure(closure, substeps):
    packing = material(
        gap_density_at_zero=100.0, force_anisotropy_ratio=1.1, initial_fabric_xx=0.2, initial_fabric_xy=-0.1
    )
    assert_second_order(law(closure=closure, substeps=substeps, materials=[packing]))


@pytest.mark.parametrize("integrator", TABLEAUS)
def test_every_integrator(integrator):
    assert_second_order(law(integrator=integrator, substeps=3))


def test_adaptive_substeps():
    """With error control the tangent leaves out how the step sizes change, which is of the order of the tolerance.

    The error of the tangent, as a stress over the increment, falls in proportion to the tolerance.
    """
    errors = []
    for tolerance in (1e-4, 1e-6, 1e-8):
        points = Points(law(tolerance=tolerance), STRESS)
        tangent = points.update(INCREMENT)[2]
        exact = Points(law(integrator="dormand_prince", substeps=40), STRESS).update(INCREMENT)[2]
        errors.append(np.abs(tangent - exact).max() / exact.max())
        assert errors[-1] < 100 * tolerance
    assert errors[0] > errors[1] > errors[2]


def test_wrong_tangent_would_be_noticed():
    """The elastic tangent is not the derivative of the update: slope one."""
    points = Points(law(substeps=1), STRESS)
    stress = points.update(INCREMENT)[0]
    elastic = points.update(INCREMENT, "elastic")[2]
    change = np.einsum("pij,pj->pi", elastic, DIRECTION)
    sizes = 0.3 * 0.5 ** np.arange(5)
    remainders = [np.abs(points.update(INCREMENT + t * DIRECTION)[0] - stress - t * change).max() for t in sizes]
    assert np.polyfit(np.log(sizes), np.log(remainders), 1)[0] < 1.2
