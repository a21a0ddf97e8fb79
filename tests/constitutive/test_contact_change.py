"""Loss and gain integrals: closed form against quadrature, derivatives against differences, eight lanes against one."""

import numba
import numpy as np
import pytest

from granfabric.constitutive.lanes.eight import LANES, read, write
from granfabric.constitutive.network.contact_change import closed_form_change
from granfabric.constitutive.network.quadrature_change import quadrature_change

NODES, WEIGHTS = np.polynomial.legendre.leggauss(160)
G, P0 = 0.7, 0.6
LOSS, GAIN, BY_V, BY_A, BY_N, BY_SIGMA = range(6)


def by_quadrature(inputs, entropy=False, sigma=0.0, chi=1.0):
    scattered = sigma > 0.0
    return quadrature_change(*inputs, G, P0, True, True, sigma, chi, scattered, entropy, NODES, WEIGHTS)


def net(change):
    """X_i = g gain_i - P0 loss_i."""
    return G * np.array(change[GAIN]) - P0 * np.array(change[LOSS])


def jacobian(change):
    """Derivatives of X by v, a_c, a_n and sigma, shape (3, 8)."""
    v = change[BY_V]
    by_v = np.array([[v[0], v[1], v[2]], [v[1], v[3], v[4]], [v[2], v[4], v[5]]])
    by_a, by_n = (np.array(change[which]).reshape(3, 2) for which in (BY_A, BY_N))
    return np.hstack([by_v, by_a, by_n, np.array(change[BY_SIGMA])[:, None]])


def random_inputs(rng, fabric):
    v = rng.normal(size=3)
    q = rng.uniform(-1, 1, 2)
    q *= fabric * rng.uniform() / np.hypot(*q)
    return np.concatenate([v, q, rng.uniform(-0.6, 0.6, 2) * rng.choice([0.0, 0.02, 1.0])])


@pytest.mark.parametrize("seed", range(20))
def test_closed_form_equals_quadrature(seed):
    """Values, and derivatives by all inputs; 1e-12 is the accuracy of the recursions for values, 1e-11 beyond."""
    inputs = random_inputs(np.random.default_rng(seed), 1.0)
    closed, expected = closed_form_change(*inputs, G, P0, True, True, True), by_quadrature(inputs)
    for which, tolerance in ((LOSS, 2e-12), (GAIN, 2e-12), (BY_V, 2e-12), (BY_A, 2e-12), (BY_N, 1e-10)):
        assert closed[which] == pytest.approx(expected[which], abs=tolerance)


@pytest.mark.parametrize("effect", ["loss", "gain"])
def test_what_is_off_adds_nothing(effect):
    """Each alone is its part of both; parameters of the other are not read."""
    inputs = random_inputs(np.random.default_rng(3), 0.9)
    loss, gain = effect == "loss", effect == "gain"
    factors = (np.nan, P0) if loss else (G, np.nan)
    alone = closed_form_change(*inputs, *(0.0 if np.isnan(f) else f for f in factors), loss, gain, True)
    both = closed_form_change(*inputs, G, P0, True, True, True)
    assert alone[LOSS if loss else GAIN] == pytest.approx(both[LOSS if loss else GAIN], rel=1e-14)
    assert alone[GAIN if loss else LOSS] == (0.0, 0.0, 0.0)
    other = closed_form_change(*inputs, *((G, 0.0) if loss else (0.0, P0)), not loss, not gain, True)
    for which in (BY_V, BY_A, BY_N):
        assert np.array(alone[which]) + np.array(other[which]) == pytest.approx(both[which], abs=1e-13)


@pytest.mark.parametrize(
    ("entropy", "fabric", "sigma"),
    [(False, 1.0, 0.0), (False, 1.6, 0.0), (True, 1.8, 0.0), (False, 0.9, 0.3), (True, 1.2, 0.3)],
)
@pytest.mark.parametrize("seed", range(8))
def test_derivatives_against_differences(entropy, fabric, sigma, seed):
    """Central differences of step 1e-6: error below 1e-12 of the third derivative plus 1e-10 of rounding, times ten."""
    inputs = np.append(random_inputs(np.random.default_rng(seed), fabric), sigma)
    chi = 0.8 if sigma else 1.0
    change = by_quadrature(inputs[:7], entropy, sigma, chi)
    assert change[LOSS][0] >= 0 and change[GAIN][0] >= 0
    h = 1e-6
    for index in range(8 if sigma else 7):
        shift = np.zeros(8)
        shift[index] = h
        high, low = (
            net(by_quadrature((inputs + sign * shift)[:7], entropy, (inputs + sign * shift)[7], chi))
            for sign in (1, -1)
        )
        assert (high - low) / (2 * h) == pytest.approx(jacobian(change)[:, index], abs=1e-7)


def test_clipped_density_is_never_negative():
    """Harmonic beyond |a_c| = 1: loss and gain stay non-negative and continuous at |a_c| = 1."""
    inputs = random_inputs(np.random.default_rng(3), 1.0)
    direction = inputs[3:5] / np.hypot(*inputs[3:5])
    inputs[3:5] = direction
    at_limit = by_quadrature(inputs)
    inputs[3:5] = direction * (1 + 1e-9)
    beyond = by_quadrature(inputs)
    for which in (LOSS, GAIN):
        assert beyond[which] == pytest.approx(at_limit[which], abs=1e-8)


def test_no_scatter_is_the_sharp_limit():
    """The random change of force with a vanishing spread."""
    inputs = random_inputs(np.random.default_rng(5), 0.8)
    for which, expected in enumerate(by_quadrature(inputs)[:5]):
        assert by_quadrature(inputs, sigma=1e-12)[which] == pytest.approx(expected, abs=1e-11)


@numba.njit(error_model="numpy", fastmath={"contract"})
def _losses(inputs, results, lanes):
    v, w1, w2 = read(inputs, 0, lanes), read(inputs, 1, lanes), read(inputs, 2, lanes)
    a1, a2, n1, n2 = read(inputs, 3, lanes), read(inputs, 4, lanes), read(inputs, 5, lanes), read(inputs, 6, lanes)
    lost, won, by_v, by_a, by_n, _ = closed_form_change(v, w1, w2, a1, a2, n1, n2, 0.7, 0.6, True, True, True)
    for i in range(3):
        write(results, i, lost[i], lanes)
        write(results, 3 + i, won[i], lanes)
    for i in range(6):
        write(results, 6 + i, by_v[i], lanes)
        write(results, 12 + i, by_a[i], lanes)
        write(results, 18 + i, by_n[i], lanes)


def test_lanes_do_not_see_each_other():
    """The same inputs give the same bits in every lane, whatever the neighbours hold; and what one point gives."""
    rng = np.random.default_rng(1)
    inputs = np.stack([random_inputs(rng, 0.8) for _ in LANES], axis=1)
    together, alone = np.zeros((24, 8)), np.zeros((24, 8))
    _losses(inputs, together, LANES)
    for lane in LANES:
        _losses(np.repeat(inputs[:, lane : lane + 1], 8, axis=1).copy(), alone, LANES)
        assert np.array_equal(alone, np.repeat(together[:, lane : lane + 1], 8, axis=1))
        plain = closed_form_change(*inputs[:, lane], 0.7, 0.6, True, True, True)
        assert np.concatenate(plain[:5]) == pytest.approx(together[:, lane], abs=1e-11)
