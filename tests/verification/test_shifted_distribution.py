"""The closure by shifted weak forces against a second implementation, and its limits.

The second implementation integrates ``d(p X_1 - chi p a_c) = chi (a_n dp + p c_n ds - a_c dp)`` by SciPy and finds X_1
by SciPy's root finder, with SciPy's normal distribution on 256 directions; it shares no code with the kernels.
"""

import numpy as np
import pytest
import reference_model
from contact_law_cases import PRESSURE, Points, law, material
from scipy.integrate import solve_ivp
from scipy.optimize import root
from scipy.stats import norm

from constitutive.parameters import Closure
from constitutive.path import Leg, drive
from constitutive.weak_forces import expected_excess, negative_part, normal_density, positive_part, upper_tail

ANGLES = 2 * np.pi * np.arange(256) / 256
E = np.array([np.cos(ANGLES), np.sin(ANGLES)])


def network(packing, closure, x0, x1, spread, p, origin):
    """z and a_c of a state [section 5.3]."""
    z0, q = origin
    x = x0 + x1 @ E
    s = max(np.hypot(spread, closure.elastic_scatter * np.hypot(*x1)), 1e-300)
    u = x / s
    lost = packing.force_density_at_zero * (s * norm.pdf(u) - x * norm.cdf(-u))
    f = 2 * np.pi * p / (z0 * packing.solid_fraction * packing.normal_stiffness)
    g = (packing.neighbours - z0) / z0 * packing.gap_density_at_zero * f / 2
    n = (1 + q @ E) * np.exp(-lost + g * (s * norm.pdf(u) + x * norm.cdf(u)))
    return z0 * n.mean(), 2 * (E @ n) / n.sum()


def integrate(packing, closure, stress, increment, control):
    """End z, a_c, S_i, X_1 of one increment from the initial packing, on a virgin path."""
    c_n, chi, chi_p = packing.force_anisotropy_ratio, closure.weak_contact_ratio, closure.weak_contact_ratio_isotropic
    origin = (packing.coordination, np.array([packing.initial_fabric_xx, packing.initial_fabric_xy]))
    stress, increment = np.array(stress), np.array(increment)

    def invariants(sigma):
        p = -(sigma[0] + sigma[1]) / 2
        return p, np.array([-(sigma[0] - sigma[1]) / 2, -sigma[2]]) / p

    p_start, _ = invariants(stress)

    def resolve(sigma, w, spread):
        p, _ = invariants(sigma)
        x0 = chi_p * (1 - p_start / p)
        x1 = root(
            lambda x: x - w / p - chi * network(packing, closure, x0, x, spread, p, origin)[1], w / p, tol=1e-14
        ).x
        return x1, *network(packing, closure, x0, x1, spread, p, origin)

    def derivative(_, y):
        sigma, w, spread = y[:3], y[3:5], y[5]
        p, s = invariants(sigma)
        _, z, a_c = resolve(sigma, w, spread)
        c = reference_model.stiffness(packing, z, a_c)
        stress_rate = increment if control == "stress" else c @ increment
        strain_rate = np.linalg.solve(c, increment) if control == "stress" else increment
        dp = -(stress_rate[0] + stress_rate[1]) / 2
        ds = np.array([-(stress_rate[0] - stress_rate[1]) / 2, -stress_rate[2]]) / p - s * dp / p
        f = 2 * np.pi * p / (z * packing.solid_fraction * packing.normal_stiffness)
        spreading = closure.fluctuation * np.hypot(strain_rate[0] - strain_rate[1], strain_rate[2]) / f
        dw = chi * (c_n * s * dp + p * c_n * ds - a_c * dp)
        return np.concatenate([stress_rate, dw, [spreading]])

    start = np.concatenate([stress, -chi * p_start * origin[1], [0.0]])
    y = solve_ivp(derivative, (0, 1), start, method="DOP853", rtol=1e-9, atol=1e-9 * np.array([1e5] * 5 + [1])).y[:, -1]
    x1, z, a_c = resolve(y[:3], y[3:5], y[5])
    return y[:3], z, a_c, y[5], x1


@pytest.mark.parametrize("control", ["stress", "strain"])
@pytest.mark.parametrize(
    ("fabric", "change"),
    [((0.0, 0.0), (-0.3, 0.3, 0.0)), ((0.1, -0.05), (-0.4, -0.1, 0.2)), ((0.0, 0.1), (0.2, 0.1, 0.15))],
)
def test_end_values(control, fabric, change):
    """Tolerances 1e-9 on both sides; the fixed directions (32 against 256) agree to rounding."""
    packing = material(
        force_density_at_zero=0.6,
        gap_density_at_zero=60.0,
        force_anisotropy_ratio=1.1,
        initial_fabric_xx=fabric[0],
        initial_fabric_xy=fabric[1],
    )
    closure = Closure(force_change="shifted_distribution")
    stress = (-PRESSURE, -PRESSURE, 0.0)
    increment = np.array(change) * (PRESSURE if control == "stress" else 2e-4)
    points = Points(law(closure=closure, materials=[packing], tolerance=1e-9), stress)
    code = (1, 1, 1) if control == "stress" else (0, 0, 0)
    end, state, _, report = points.mixed(code, increment)
    assert report.failed == 0
    sigma, z, a_c, spread, x1 = integrate(packing, closure, stress, increment, control)
    assert end[0] == pytest.approx(sigma, abs=1e-6 * PRESSURE)
    assert points.get(state, "coordination")[0, 0] == pytest.approx(z, abs=1e-6)
    assert points.get(state, "fabric_anisotropy")[0] == pytest.approx(a_c, abs=1e-6)
    assert points.get(state, "force_spread")[0, 0] == pytest.approx(spread, abs=1e-6)
    assert points.get(state, "force_shift_anisotropy")[0] == pytest.approx(x1, abs=1e-6)


def test_unloading_returns_contacts():
    """Without irreversible spread z and a_c are functions of the stress; with it, what a loop leaves is isotropic."""
    stress = (-PRESSURE, -PRESSURE, 0.0)
    loop = [Leg(target=(-1.2e5, -0.8e5, 0.0), increments=6), Leg(target=stress, increments=6)]
    for fluctuation, reversible in ((0.0, True), (0.25, False)):
        closure = Closure(force_change="shifted_distribution", fluctuation=fluctuation)
        columns = drive(law(closure=closure), stress, loop).columns
        z = columns["coordination"]
        assert z[6] < z[0] - 0.05
        if reversible:
            assert z[-1] == pytest.approx(z[0], abs=1e-9)
        else:
            assert z[6] < z[-1] < z[0] - 0.01
        assert columns["fabric_anisotropy"][-1] == pytest.approx(0.0, abs=1e-9)
        assert columns["coordination_gained"][-1] > 0.01


def test_second_cycle_retraces_the_first():
    """S_i grows on virgin loading only."""
    stress = (-PRESSURE, -PRESSURE, 0.0)
    legs = [Leg(target=(-1.2e5, -0.8e5, 0.0), increments=5), Leg(target=stress, increments=5)] * 3
    z = drive(law(closure=Closure(force_change="shifted_distribution")), stress, legs).columns["coordination"]
    # at the top of a later cycle the last bit of reloading may count as virgin: 1e-6 of the error control
    assert z[10:21] == pytest.approx(z[20:31], abs=1e-5)


def test_isostatic_shear_stiffness():
    """G/G(0) = (z - z_iso)/(z(0) - z_iso), from the elastic tangent of a loaded point."""
    packing = material(isostatic_coordination=3.0)
    contact_law = law(closure=Closure(shear_stiffness="isostatic"), materials=[packing])
    history = drive(contact_law, (-PRESSURE, -PRESSURE, 0.0), [Leg(target=(-1.25e5, -0.75e5, 0.0), increments=5)])
    z = history.columns["coordination"][-1]
    points = Points(contact_law, history.stress, history.state)
    tangent = points.update((0.0, 0.0, 0.0))[2][0]
    uniform = reference_model.stiffness(packing, 4.06, (0.0, 0.0))[2, 2]
    assert tangent[2, 2] / uniform == pytest.approx((z - 3.0) / (4.06 - 3.0), rel=1e-12)


def test_normal_functions_in_the_tails():
    """Against SciPy's logarithmic tail and 30-digit values of phi(u) - u Phi(-u)."""
    for u in np.linspace(-8.0, 37.0, 181):
        assert upper_tail(u) == pytest.approx(np.exp(norm.logsf(u)), rel=3e-13 if u > 8 else 1e-14)
        assert normal_density(u) == pytest.approx(norm.pdf(u), rel=3e-13)
    known = {
        0.0: 0.398942280401432677939946,
        3.0: 3.821543170477236e-4,
        4.0: 7.1452584324056668e-6,
        10.0: 7.474560254589328e-25,
    }
    for u, value in known.items():
        assert expected_excess(u) == pytest.approx(value, rel=1e-13)


@pytest.mark.parametrize("x", [-2.0, -1e-3, 0.0, 1e-3, 2.0])
def test_spread_to_zero_meets_the_sharp_limit(x):
    """E[max(-g, 0)] -> max(-x, 0) with an error below the spread; value, and the identity with the positive part."""
    for s in (0.5, 1e-2, 1e-6, 1e-200, 0.0):
        below, by_x, by_s = negative_part(x, s)
        above, _, _ = positive_part(x, s)
        assert max(-x, 0.0) <= below <= max(-x, 0.0) + 0.4 * s
        assert above - below == pytest.approx(x, abs=1e-15)
        assert -1.0 <= by_x <= 0.0 <= by_s <= 0.4
