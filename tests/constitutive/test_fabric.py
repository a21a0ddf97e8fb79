"""Maximum-entropy density: Bessel functions and the concentration against SciPy."""

import numpy as np
import pytest
from scipy.special import i0e, i1e

from granfabric.constitutive.fabric import bessel_ratio, concentration, scaled_bessel_zero

ARGUMENTS = [1e-12, 1e-6, 1e-2, 0.5, 3.0, 17.99, 18.01, 60.0, 399.0, 401.0, 1e4, 1e7]


@pytest.mark.parametrize("k", ARGUMENTS)
def test_bessel_functions(k):
    """Both series are cut at rounding."""
    assert scaled_bessel_zero(k) == pytest.approx(i0e(k), rel=3e-15)
    assert bessel_ratio(k) == pytest.approx(i1e(k) / i0e(k), rel=2e-15)


@pytest.mark.parametrize("anisotropy", [0.0, 1e-12, 1e-4, 0.3, 1.0, 1.7, 1.99, 1.9999])
def test_concentration_inverts_the_ratio(anisotropy):
    """2 I1(k)/I0(k) = |a_c| to rounding; the slope against a difference quotient of relative step 1e-6."""
    k, slope = concentration(anisotropy)
    assert 2 * bessel_ratio(k) == pytest.approx(anisotropy, abs=4e-15)
    h = 1e-6 * min(max(anisotropy, 1e-6), 2 - anisotropy)
    if anisotropy > 0:
        difference = (concentration(anisotropy + h)[0] - concentration(anisotropy - h)[0]) / (2 * h)
        assert slope == pytest.approx(difference, rel=1e-6)


def test_density_has_the_fabric_it_was_made_for():
    """<W> = 1 and 2 <W e> = a_c; the trapezoidal rule converges geometrically on a circle."""
    y = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    for size in (0.1, 0.9, 1.6):
        k, _ = concentration(size)
        w = np.exp(k * (np.cos(y) - 1)) / scaled_bessel_zero(k)
        assert w.mean() == pytest.approx(1, abs=1e-14)
        assert 2 * (w * np.cos(y)).mean() == pytest.approx(size, abs=1e-14)
