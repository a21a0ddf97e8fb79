"""Loss and gain integrals: closed form against quadrature, derivatives against differences."""

import numpy as np
import pytest

from granfabric.constitutive.lanes.layout import (
    BY_A,
    BY_N,
    BY_V,
    HARMONIC,
    LANES,
    MAXIMUM_ENTROPY,
    N1,
    N2,
    SIZE,
    TRIAL_A1,
    TRIAL_A2,
    V1,
    V2,
    VALUE,
    D,
)
from granfabric.constitutive.network.contact_change import closed_form_change
from granfabric.constitutive.network.quadrature_change import quadrature_change

NODES, WEIGHTS = np.polynomial.legendre.leggauss(160)
INPUTS = (D, V1, V2, TRIAL_A1, TRIAL_A2, N1, N2)


def workspace(inputs):
    w = np.zeros(SIZE)
    for row, value in zip(INPUTS, inputs, strict=True):
        w[row : row + LANES] = value
    return w


def block(w, row, *shape):
    return w[row : row + int(np.prod(shape)) * LANES].reshape(*shape, LANES)[..., 5].copy()


def by_quadrature(inputs, density, derivatives=True, nodes=NODES, weights=WEIGHTS):
    w = workspace(inputs)
    quadrature_change(w, 5, density, True, True, derivatives, nodes, weights)
    return w


def random_inputs(rng, fabric):
    v = rng.normal(size=3)
    q = rng.uniform(-1, 1, 2)
    q *= fabric * rng.uniform() / np.hypot(*q)
    return np.concatenate([v, q, rng.uniform(-0.6, 0.6, 2) * rng.choice([0.0, 0.02, 1.0])])


@pytest.mark.parametrize("seed", range(20))
def test_closed_form_equals_quadrature(seed):
    """Values, and derivatives by all inputs; 1e-12 is the accuracy of the recursions for values, 1e-11 beyond."""
    inputs = random_inputs(np.random.default_rng(seed), 1.0)
    closed = workspace(inputs)
    closed_form_change(closed, True, True, True)
    expected = by_quadrature(inputs, HARMONIC)
    rows = ((VALUE, (2, 3), 2e-12), (BY_V, (18,), 2e-12), (BY_A, (12,), 2e-12), (BY_N, (6,), 1e-10))
    for row, shape, tolerance in rows:
        assert block(closed, row, *shape) == pytest.approx(block(expected, row, *shape), abs=tolerance)


@pytest.mark.parametrize(("density", "fabric"), [(HARMONIC, 1.0), (HARMONIC, 1.6), (MAXIMUM_ENTROPY, 1.8)])
@pytest.mark.parametrize("seed", range(8))
def test_derivatives_against_differences(density, fabric, seed):
    """Central differences of step 1e-6: error below 1e-12 of the third derivative plus 1e-10 of rounding, times ten."""
    inputs = random_inputs(np.random.default_rng(seed), fabric)
    w = by_quadrature(inputs, density)
    value, by_v, by_a, by_n = (
        block(w, VALUE, 2, 3),
        block(w, BY_V, 2, 3, 3),
        block(w, BY_A, 2, 3, 2),
        block(w, BY_N, 3, 2),
    )
    assert np.all(value[:, 0] >= 0)
    h = 1e-6
    for index in range(7):
        shift = np.zeros(7)
        shift[index] = h
        high, low = (block(by_quadrature(inputs + sign * shift, density, False), VALUE, 2, 3) for sign in (1, -1))
        slope = (high - low) / (2 * h)
        if index < 3:
            assert slope == pytest.approx(by_v[:, :, index], abs=1e-7)
        elif index < 5:
            assert slope == pytest.approx(by_a[:, :, index - 3], abs=1e-7)
        else:
            assert slope[0] == pytest.approx(by_n[:, index - 5], abs=1e-7)


def test_clipped_density_is_never_negative():
    """Harmonic beyond |a_c| = 1: loss and gain stay non-negative and continuous at |a_c| = 1."""
    rng = np.random.default_rng(3)
    inputs = random_inputs(rng, 1.0)
    direction = inputs[3:5] / np.hypot(*inputs[3:5])
    inputs[3:5] = direction
    at_limit = block(by_quadrature(inputs, HARMONIC), VALUE, 2, 3)
    inputs[3:5] = direction * (1 + 1e-9)
    assert block(by_quadrature(inputs, HARMONIC), VALUE, 2, 3) == pytest.approx(at_limit, abs=1e-8)


def test_lanes_do_not_see_each_other():
    """The same inputs give the same bits in every lane, whatever the neighbours hold."""
    rng = np.random.default_rng(1)
    alone = workspace(random_inputs(rng, 0.8))
    mixed = alone.copy()
    for row in INPUTS:
        mixed[row + 6 : row + LANES] = rng.normal(size=LANES - 6) * 0.3
    closed_form_change(alone, True, True, True)
    closed_form_change(mixed, True, True, True)
    for row, number in ((VALUE, 6), (BY_V, 18), (BY_A, 12), (BY_N, 6)):
        assert np.array_equal(block(alone, row, number), block(mixed, row, number))
