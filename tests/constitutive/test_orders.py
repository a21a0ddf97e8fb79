"""Orders of the integrators as measured slopes, and what their tolerance is worth."""

import numpy as np
import pytest
import reference_model
from contact_law_cases import PRESSURE, Points, law, material

from granfabric.constitutive.integration.runge_kutta import TABLEAUS, ending_at_the_end

STRESS = (-1.2e5, -0.85e5, 1e4)
INCREMENT = (-8e-5, 6e-5, 3e-5)


@pytest.fixture(scope="module")
def exact():
    """End stress, z, a_c by DOP853 at 1e-12 on the independently written model."""
    return reference_model.integrate(material(), STRESS, INCREMENT, "strain", rtol=1e-12)


def error(exact, **integration):
    points = Points(law(**integration), STRESS)
    stress, state, _, report = points.update(INCREMENT)
    assert report.failed == 0
    errors = [
        np.abs(stress[0] - exact[0]).max() / PRESSURE,
        abs(points.get(state, "coordination")[0, 0] - exact[1]) / 4,
        np.abs(points.get(state, "fabric_anisotropy")[0] - exact[2]).max(),
    ]
    return max(errors), report


@pytest.mark.parametrize(("name", "tableau"), TABLEAUS.items())
def test_coefficients(name, tableau):
    """Weights sum to one, error weights to zero; order conditions up to three."""
    c = tableau.a.sum(axis=1)
    assert tableau.b.sum() == pytest.approx(1, abs=1e-15)
    assert tableau.error.sum() == pytest.approx(0, abs=1e-15)
    if tableau.order >= 2:
        assert tableau.b @ c == pytest.approx(1 / 2, abs=1e-15)
    if tableau.order >= 3:
        assert tableau.b @ c**2 == pytest.approx(1 / 3, abs=1e-15)
        assert tableau.b @ tableau.a @ c == pytest.approx(1 / 6, abs=1e-15)
    if tableau.order >= 5:
        assert tableau.b @ c**4 == pytest.approx(1 / 5, abs=1e-15)


@pytest.mark.parametrize("tableau", TABLEAUS.values(), ids=TABLEAUS)
def test_the_last_stage_is_the_end(tableau):
    """As kernels take the pairs: a stage without weight is added where none is at the end; nothing else changes."""
    closed = ending_at_the_end(tableau)
    assert np.array_equal(closed.a[-1], closed.b)
    n = len(tableau.b)
    assert np.array_equal(closed.b[:n], tableau.b) and np.array_equal(closed.a[:n, :n], tableau.a)
    assert np.array_equal(closed.error[:n], tableau.error) and not closed.b[n:].any() and not closed.error[n:].any()


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("forward_euler", (64, 128, 256, 512)),
        ("modified_euler", (16, 32, 64, 128)),
        ("bogacki_shampine", (8, 16, 32, 64)),
        ("dormand_prince", (2, 4, 8, 16)),
        ("kennedy_carpenter", (8, 16, 32, 64)),
    ],
)
def test_order(name, counts, exact):
    """Slope of the error with the substep: not below the order, and above it only as far as higher terms still show."""
    errors = [error(exact, integrator=name, substeps=n)[0] for n in counts]
    slope = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert -0.2 < slope - TABLEAUS[name].order < 0.45


@pytest.mark.parametrize("name", ["modified_euler", "bogacki_shampine", "dormand_prince", "kennedy_carpenter"])
def test_true_error_below_tolerance(name, exact):
    """The order used is one above the estimated one, so that all substeps together stay near one tolerance."""
    taken = []
    for tolerance in (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8):
        true_error, report = error(exact, integrator=name, tolerance=tolerance)
        assert true_error < 3 * tolerance
        taken.append(report.substeps[0])
    assert taken[-1] > taken[0]


def test_tolerance_is_not_wasted(exact):
    """Ten thousand times the tolerance saves substeps by about 1e4^(1/3): error control works in both directions."""
    few, many = (error(exact, integrator="bogacki_shampine", tolerance=t)[1].substeps[0] for t in (1e-5, 1e-9))
    assert 8 < many / few < 50


def test_huge_unloading_is_not_taken_in_one_blind_step():
    """z ~ p^P0 under isotropic unloading (a_n = 0, no gain): closed form down to a millionth of the pressure."""
    for p0 in (0.25, 0.5, 0.9):
        points = Points(law(materials=[material(force_density_at_zero=p0)]), (-PRESSURE, -PRESSURE, 0.0))
        for fraction in (0.5, 1e-3, 1e-6):
            up = (1 - fraction) * PRESSURE
            _, state, _, report = points.mixed((1, 1, 1), (up, up, 0.0))
            assert report.failed == 0
            z = points.get(state, "coordination")[0, 0]
            # error of relative 1e-6 a substep, up to twenty halvings
            assert z == pytest.approx(4.06 * fraction**p0, rel=5e-5)
