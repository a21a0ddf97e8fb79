"""Closed-form moments over the arc of loss against Gauss quadrature, and the borders between its branches."""

import numpy as np
import pytest

from granfabric.constitutive.lanes.elementary import angle, cosine_sine, exponential, log_of_ratio
from granfabric.constitutive.network import arcs
from granfabric.constitutive.network.arcs import arc_of_loss, loss_moments

NODES, WEIGHTS = np.polynomial.legendre.leggauss(200)


def moments(a, d, w1, w2):
    """All moments of one arc."""
    return np.concatenate(loss_moments(a, d, w1, w2, True))


def reference(a, d, w1, w2):
    kappa, sine, cf, sf = arc_of_loss(d, w1, w2)
    half, centre = np.arctan2(sine, kappa), np.arctan2(sf, cf)
    y, weight = centre + half * NODES, half * WEIGHTS
    c, s, h = np.cos(y), np.sin(y), 1 + a * np.cos(y)
    integrands = [c**k for k in range(4)] + [s * c**k for k in range(3)]
    integrands += [c**k / h for k in range(4)] + [s * c**k / h for k in range(3)]
    integrands += [c**k / h**2 for k in range(5)] + [s * c**k / h**2 for k in range(4)]
    return np.array([weight @ integrand for integrand in integrands])


@pytest.mark.parametrize("a", [0.0, 1e-12, 1e-3, 0.0999999, 0.1000001, 0.3, 0.6, 0.9])
@pytest.mark.parametrize("level", [-1.5, -1.0, -0.999999, -0.5, 0.0, 0.7, 0.999999, 1.0, 2.0])
def test_moments_against_quadrature(a, level):
    """Recursions in 1/a lose at most 1/a^4 = 1e4 of rounding, relative to the largest moment."""
    for direction in np.linspace(0.1, 6.2, 7):
        w = 0.7 * np.array([np.cos(direction), np.sin(direction)])
        expected = reference(a, 0.7 * level, *w)
        assert moments(a, 0.7 * level, *w) == pytest.approx(expected, abs=3e-11 * max(1.0, abs(expected).max()))


def test_series_meets_closed_form():
    """On both sides of the switch the two ways agree to the accuracy claimed for the worse one."""
    a = arcs.SMALL_ANISOTROPY
    below, above = moments(a * (1 - 1e-12), 0.1, 0.3, 0.2), moments(a * (1 + 1e-12), 0.1, 0.3, 0.2)
    assert below == pytest.approx(above, abs=3e-11)


@pytest.mark.parametrize(("sign", "half_width"), [(1.0, 0.0), (-1.0, np.pi)])
def test_arc_opens_and_closes_continuously(sign, half_width):
    """Half-width ~ sqrt(2 |1 - d/|w||) next to the borders; equal to 0 and pi on them and beyond."""
    for offset in (1e-4, 1e-8, 1e-12, 1e-15):
        kappa, sine, _, _ = arc_of_loss(sign * (1 - offset), 1.0, 0.0)
        assert abs(np.arctan2(sine, kappa) - half_width) == pytest.approx(np.sqrt(2 * offset), rel=0.2)
    for beyond in (0.0, 1e-300, 1.0):
        kappa, sine, _, _ = arc_of_loss(sign * (1 + beyond), 1.0, 0.0)
        assert np.arctan2(sine, kappa) == half_width


def test_nothing_happens_without_change():
    kappa, sine, cosine, _ = arc_of_loss(0.0, 0.0, 0.0)
    assert (kappa, sine, cosine) == (1.0, 0.0, 1.0)


def test_elementary_functions():
    """Absolute 1e-15 for angles up to pi, rounding for the others."""
    for theta in np.linspace(0.0, np.pi, 4001):
        assert angle(np.sin(theta), np.cos(theta)) == pytest.approx(
            np.arctan2(np.sin(theta), np.cos(theta)), abs=1.0e-15
        )
    assert angle(0.0, 0.0) == 0.0
    for x in np.concatenate([np.linspace(0.01, 1.99, 4001), [1.0]]):
        assert log_of_ratio(x, 2.0 - x) == pytest.approx(np.log(x / (2.0 - x)), rel=1e-15, abs=1e-15)
    for x in np.concatenate([np.linspace(-700, 700, 2001), [0.0, -1e-300]]):
        assert exponential(x) == pytest.approx(np.exp(x), rel=5e-16)
    for x in np.linspace(-np.pi, np.pi, 2001):
        assert cosine_sine(x) == pytest.approx((np.cos(x), np.sin(x)), abs=8e-16)
