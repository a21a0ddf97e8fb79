"""The closure by shifted weak forces against a second implementation, and its limits.

The second implementation finds X_1 by SciPy's root finder and what a line of forces loses by quadrature over the
forces, on 256 directions; a_n comes from the stress-force-fabric relation as a linear system, the maximum of a_t from
SciPy's minimiser. It shares no code with the kernels.
"""

import numpy as np
import pytest
import reference_model
from contact_law_cases import PRESSURE, Points, law, material
from scipy.integrate import quad, solve_ivp
from scipy.optimize import minimize_scalar, root
from scipy.special import ndtr
from scipy.stats import norm

from granfabric.constitutive.effects import Effects
from granfabric.constitutive.lanes.elementary import FARTHEST, normal_tail
from granfabric.constitutive.network.force_fabric import carried_force, tangential_force
from granfabric.constitutive.network.tangential_force import tangential_magnitude
from granfabric.constitutive.network.weak_forces import lost_and_gained, negative_part, positive_part
from granfabric.constitutive.parameters import Closure, ParameterError
from granfabric.constitutive.path import Leg, drive

ANGLES = 2 * np.pi * np.arange(256) / 256
E = np.array([np.cos(ANGLES), np.sin(ANGLES)])
NODE, WEIGHT = np.polynomial.legendre.leggauss(200)
SHIFTED = Closure(force_change="shifted_distribution", tangential="frictional")


def line_below(p0, slope, x, s):
    """What a line of forces loses: numbers of forces F whose F + x + s g is below zero, by Gauss-Legendre."""
    end = -p0 / slope if slope < 0 else np.inf
    top = min(end, max(0.0, -np.min(x)) + 9.0 * s + 1e-12)
    force = 0.5 * top * (NODE + 1.0)
    below = ndtr(-(force[:, None] + np.atleast_1d(x)) / s)
    return 0.5 * top * (WEIGHT * (p0 + slope * force)) @ below


def network(packing, closure, ratio, x1, spread, p, origin):
    """z and a_c of a state [section 5.3]; p over its reference value is `ratio`, X_1 in units of the mean force."""
    z0, q = origin
    stretch = ratio ** (1.0 - closure.weak_contact_gradient)
    pressed = closure.weak_contact_ratio_isotropic * (ratio - 1.0)
    d0, d1 = pressed / max(1.0, ratio) ** closure.weak_contact_gradient, stretch * x1
    scatter = closure.elastic_scatter * np.hypot(*d1), closure.elastic_scatter_isotropic * d0
    s = max(np.linalg.norm([stretch * spread, *scatter]), 1e-9)
    phi = min(1.0, closure.weak_contact_ratio)
    f = 2 * np.pi * p / ratio / (z0 * packing.solid_fraction * packing.normal_stiffness)
    room, g = (packing.neighbours - z0) / z0, packing.gap_density_at_zero * f / 2
    lost, above = 0.0, 0.0
    for part, x in ((phi, d0 + d1 @ E / phi), (1.0 - phi, np.array([d0]))):
        lost = lost + part * line_below(packing.force_density_at_zero, packing.force_density_slope, x, s)
        above = above + part * (s * norm.pdf(x / s) + x * norm.cdf(x / s))
    # gaps close by displacements, whatever is stretched
    above = above + (pressed - d0)
    n = (1 + q @ E) * np.exp(-lost - lost**2 / 2) * (1.0 + room * (1.0 - np.exp(-g * above)))
    return z0 * n.mean(), 2 * (E @ n) / n.sum()


def tangential(closure, m, ratio, p0):
    """|a_t| at q/p = m: what does not slip, up to its largest value."""
    chi_p = closure.weak_contact_ratio_isotropic
    delay = closure.slip_delay * chi_p * max(0.0, 1.0 - 1.0 / ratio)
    left = p0 * chi_p * max(0.0, 1.0 - ratio)
    c_t = closure.tangential_force_ratio * np.exp(-closure.tangential_force_loss * (left + left**2 / 2))
    k = closure.slip * min(1.0, ratio) ** (1.0 - closure.weak_contact_gradient)

    def carried(m):
        return c_t * m - k * m**3 / (m + delay) if m > 0 else 0.0

    top = minimize_scalar(lambda m: -carried(m), bounds=(0, 3), method="bounded", options={"xatol": 1e-12}).x
    return carried(min(m, top))


def force_anisotropies(packing, closure, s, a_c, ratio):
    """a_n and a_t."""
    if closure.tangential == "self_consistent":
        a_n = packing.force_anisotropy_ratio * s
        return a_n, 2 * s - a_c - a_n
    m = np.hypot(*s)
    a_t = s / m * tangential(closure, m, ratio, packing.force_density_at_zero) if m > 0 else 0 * s
    # 2 s (1 + a_c.a_n/2) = a_c + a_n + a_t
    return np.linalg.solve(np.eye(2) - np.outer(s, a_c), 2 * s - a_c - a_t), a_t


def integrate(packing, closure, stress, increment, control):
    """End stress, z, a_c, S_i, X_1, a_n, a_t of one increment from the initial packing, on a virgin path."""
    chi = closure.weak_contact_ratio
    origin = (packing.coordination, np.array([packing.initial_fabric_xx, packing.initial_fabric_xy]))
    stress, increment = np.array(stress), np.array(increment)

    def invariants(sigma):
        p = -(sigma[0] + sigma[1]) / 2
        return p, np.array([-(sigma[0] - sigma[1]) / 2, -sigma[2]]) / p

    p_start, s_start = invariants(stress)
    before = force_anisotropies(packing, closure, s_start, origin[1], 1.0)[0] + origin[1]

    def resolve(sigma):
        p, s = invariants(sigma)
        ratio = p / p_start
        spread = closure.irreversible_scatter * (s @ s - s_start @ s_start)
        # what a grown pressure holds has not slipped
        delay = closure.slip_delay * closure.weak_contact_ratio_isotropic * max(0.0, 1.0 - 1.0 / ratio)
        left = spread * np.hypot(*s) / (np.hypot(*s) + delay) if delay > 0 else spread

        def residual(x):
            a_c = network(packing, closure, ratio, x, left, p, origin)[1]
            carried = force_anisotropies(packing, closure, s, a_c, ratio)[0] + a_c
            return x - chi * (carried - before / ratio)

        # a start at exactly zero would leave SciPy's difference quotients without a scale
        solution = root(residual, chi * (s - s_start) + 1e-6, tol=1e-13)
        assert np.abs(residual(solution.x)).max() < 1e-11
        x1 = solution.x
        return x1, spread, ratio, *network(packing, closure, ratio, x1, left, p, origin)

    def derivative(_, sigma):
        if control == "stress":
            return increment
        _, _, _, z, a_c = resolve(sigma)
        return reference_model.stiffness(packing, z, a_c) @ increment

    sigma = solve_ivp(derivative, (0, 1), stress, method="DOP853", rtol=1e-9, atol=1e-4).y[:, -1]
    x1, spread, ratio, z, a_c = resolve(sigma)
    a_n, a_t = force_anisotropies(packing, closure, invariants(sigma)[1], a_c, ratio)
    return sigma, z, a_c, spread, x1, a_n, a_t


@pytest.mark.parametrize("control", ["stress", "strain"])
@pytest.mark.parametrize("tangential_choice", ["frictional", "self_consistent"])
@pytest.mark.parametrize(
    ("fabric", "start", "change", "slope"),
    [
        ((0.0, 0.0), (-1.0, -1.0, 0.0), (-0.3, 0.3, 0.0), 0.0),
        ((0.1, -0.05), (-1.1, -0.9, 0.0), (-0.5, -0.1, 0.2), -0.4),
        ((0.0, 0.1), (-1.0, -1.0, 0.0), (0.2, 0.1, 0.15), 0.3),
        ((0.0, 0.0), (-1.0, -1.0, 0.0), (0.35, 0.55, 0.1), -0.2),
    ],
)
def test_end_values(control, tangential_choice, fabric, start, change, slope):
    """Tolerances 1e-9 on both sides; the fixed directions (32 against 256) agree to rounding.

    From a sheared start to another direction tangential forces remember; the second implementation does not.
    """
    packing = material(
        force_density_at_zero=0.6,
        force_density_slope=slope,
        gap_density_at_zero=60.0,
        force_anisotropy_ratio=1.1,
        initial_fabric_xx=fabric[0],
        initial_fabric_xy=fabric[1],
    )
    closure = Closure(force_change="shifted_distribution", tangential=tangential_choice)
    stress = PRESSURE * np.array(start)
    increment = np.array(change) * (PRESSURE if control == "stress" else 2e-4)
    forgets = Effects(tangential_memory=False)
    points = Points(law(forgets, closure, materials=[packing], tolerance=1e-9), stress)
    code = (1, 1, 1) if control == "stress" else (0, 0, 0)
    end, state, _, report = points.mixed(code, increment)
    assert report.failed == 0
    sigma, z, a_c, spread, x1, a_n, a_t = integrate(packing, closure, stress, increment, control)
    assert end[0] == pytest.approx(sigma, abs=1e-6 * PRESSURE)
    assert points.get(state, "coordination")[0, 0] == pytest.approx(z, abs=1e-6)
    assert points.get(state, "fabric_anisotropy")[0] == pytest.approx(a_c, abs=1e-6)
    assert points.get(state, "force_spread")[0, 0] == pytest.approx(spread, rel=2e-6, abs=1e-6)
    assert points.get(state, "force_shift_anisotropy")[0] == pytest.approx(x1, abs=1e-6)
    # forces over their mean: what the stress is off counts over a pressure that may have fallen
    allowed = 1e-6 * max(1.0, -2.0 * PRESSURE / (sigma[0] + sigma[1]))
    assert points.get(state, "normal_force_anisotropy")[0] == pytest.approx(a_n, abs=allowed)
    assert points.get(state, "tangential_force_anisotropy")[0] == pytest.approx(a_t, abs=allowed)


def test_force_fabric_is_the_stress_of_two_harmonics():
    """p and s integrated from the densities and forces of all directions give the s put in, and mu = p/(z f)."""
    s, a_c = np.array([0.21, -0.13]), np.array([0.15, 0.08])
    a_t = np.array(tangential_force(*s, (0.78, 1.0, 0.03), (0.0, 0.0, 0.0))[0])
    carried, found, _, margin = carried_force(*s, *a_c, *a_t)
    assert margin == pytest.approx(1 - s @ a_c, rel=1e-15)
    a_n = carried - a_c

    def mean(weight):
        def integrand(theta):
            e = np.array([np.cos(2 * theta), np.sin(2 * theta)])
            normal = (1 + a_c @ e) * (1 + a_n @ e)
            shear = -(1 + a_c @ e) * (a_t[0] * e[1] - a_t[1] * e[0])
            return weight(normal, shear, e)

        return quad(integrand, 0, np.pi, epsabs=1e-13)[0] / np.pi

    # f_i n_j with t = (-sin, cos): mean half is f_n/2; deviators (f_n cos - f_t sin)/2 and (f_n sin + f_t cos)/2
    mu = mean(lambda n, t, e: n)
    assert found == pytest.approx(mu, rel=1e-12)
    assert mean(lambda n, t, e: n * e[0] - t * e[1]) / mu == pytest.approx(s[0], rel=1e-12)
    assert mean(lambda n, t, e: n * e[1] + t * e[0]) / mu == pytest.approx(s[1], rel=1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.03, 2.0])
def test_tangential_magnitude(delay):
    """Largest value by SciPy; monotone; derivatives against differences (central, error of order h^2)."""
    c_t, k, h = 0.78, 1.1, 1e-5
    top = minimize_scalar(lambda m: -c_t * m + k * m**3 / (m + delay), bounds=(1e-9, 3), method="bounded").fun
    assert tangential_magnitude(5.0, c_t, k, delay)[0] == pytest.approx(-top, rel=1e-10)
    if delay == 0.0:
        assert tangential_magnitude(5.0, c_t, k, delay)[0] == pytest.approx(c_t**2 / (4 * k), rel=1e-12)
    values = [tangential_magnitude(m, c_t, k, delay)[0] for m in np.linspace(0, 2, 200)]
    assert np.all(np.diff(values) >= 0)
    for m in (0.05, 0.2, 0.9):
        _, by_m, by_delay, by_c_t, by_k = tangential_magnitude(m, c_t, k, delay)
        central = (tangential_magnitude(m + h, c_t, k, delay)[0] - tangential_magnitude(m - h, c_t, k, delay)[0]) / 2
        assert by_m == pytest.approx(central / h, abs=1e-8)
        up, down = tangential_magnitude(m, c_t + h, k, delay)[0], tangential_magnitude(m, c_t - h, k, delay)[0]
        assert by_c_t == pytest.approx((up - down) / (2 * h), abs=1e-8)
        up, down = tangential_magnitude(m, c_t, k + h, delay)[0], tangential_magnitude(m, c_t, k - h, delay)[0]
        assert by_k == pytest.approx((up - down) / (2 * h), abs=1e-8)
        if delay:
            up, down = tangential_magnitude(m, c_t, k, delay + h)[0], tangential_magnitude(m, c_t, k, delay - h)[0]
            assert by_delay == pytest.approx((up - down) / (2 * h), abs=1e-8)


def test_frictional_needs_its_closure():
    with pytest.raises(ParameterError, match="goes with force_change = 'shifted_distribution'"):
        Closure(tangential="frictional")


def test_first_order_of_the_shifted_forces():
    """From isotropy at constant p: X_1 = chi (2 - c_t) s to first order, and without spread dz/z = -P0 |X_1|/pi.

    The next order is relatively of the size of q/p = 1e-3 (a few times it).
    """
    eta = 1e-3
    closure = Closure(
        force_change="shifted_distribution", tangential="frictional", elastic_scatter=0.0, irreversible_scatter=0.0
    )
    contact_law = law(closure=closure, materials=[material(gap_density_at_zero=0.0)], directions=512)
    points = Points(contact_law, (-PRESSURE, -PRESSURE, 0.0))
    _, state, _, _ = points.mixed((1, 1, 1), (-eta * PRESSURE, eta * PRESSURE, 0.0))
    x1 = points.get(state, "force_shift_anisotropy")[0]
    expected = closure.weak_contact_ratio * (2 - closure.tangential_force_ratio) * eta
    assert x1 == pytest.approx([expected, 0.0], rel=5 * eta, abs=1e-12)
    z, a_c = points.get(state, "coordination")[0, 0], points.get(state, "fabric_anisotropy")[0, 0]
    assert 1 - z / 4.06 == pytest.approx(0.5 * expected / np.pi, rel=5 * eta)
    assert a_c == pytest.approx(2 * 0.5 * expected / 4, rel=5 * eta)


def test_unloading_returns_contacts():
    """Without irreversible spread z and a_c are functions of the stress; with it, what a loop leaves is isotropic.

    Both without memory of tangential forces, which leave a fabric behind.
    """
    stress = (-PRESSURE, -PRESSURE, 0.0)
    loop = [Leg(target=(-1.2e5, -0.8e5, 0.0), increments=6), Leg(target=stress, increments=6)]
    for irreversible, spread in ((0.0, True), (2.3, False), (2.3, True)):
        effects = Effects(irreversible_spread=spread, tangential_memory=False)
        closure = Closure(
            force_change="shifted_distribution", tangential="frictional", irreversible_scatter=irreversible
        )
        columns = drive(law(effects, closure), stress, loop).columns
        reversible = irreversible == 0.0 or not effects.irreversible_spread
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
    z = drive(law(closure=SHIFTED), stress, legs).columns["coordination"]
    # at the top of a later cycle the last bit of reloading may count as virgin: 1e-6 of the error control
    assert z[10:21] == pytest.approx(z[20:31], abs=1e-5)


def test_isostatic_shear_stiffness():
    """G/G(0) = z (z - z_iso)/(z(0) (z(0) - z_iso)), from the elastic tangent of a loaded point."""
    packing = material(isostatic_coordination=3.0)
    contact_law = law(closure=Closure(shear_stiffness="isostatic"), materials=[packing])
    history = drive(contact_law, (-PRESSURE, -PRESSURE, 0.0), [Leg(target=(-1.25e5, -0.75e5, 0.0), increments=5)])
    z = history.columns["coordination"][-1]
    points = Points(contact_law, history.stress, history.state)
    tangent = points.update((0.0, 0.0, 0.0))[2][0]
    uniform = reference_model.stiffness(packing, 4.06, (0.0, 0.0))[2, 2]
    assert tangent[2, 2] / uniform == pytest.approx(z / 4.06 * (z - 3.0) / (4.06 - 3.0), rel=1e-12)


def test_normal_functions():
    """Against SciPy, and 30-digit values of phi(u) - u Phi(-u). What counts is the absolute error of a share."""
    for u in np.linspace(0.0, FARTHEST, 341):
        tail, _, density = normal_tail(u)
        assert tail == pytest.approx(norm.sf(u), rel=2e-14, abs=0) and tail == pytest.approx(norm.sf(u), abs=2e-16)
        assert density == pytest.approx(norm.pdf(u), abs=2e-16)
    known = {
        0.0: 0.398942280401432677939946,
        2.0: 0.00849070261682963755,
        3.0: 3.821543170477236e-4,
        4.0: 7.1452584324056668e-6,
        5.0: 5.34616553383281495e-8,
        7.0: 1.76032601163748312e-13,
    }
    for u, value in known.items():
        assert normal_tail(u)[1] == pytest.approx(value, abs=2e-16)
    for u in (FARTHEST, 13.0, 1e300):
        assert all(0.0 <= part < 1e-15 for part in normal_tail(u))


@pytest.mark.parametrize("x", [-2.0, -1e-3, 0.0, 1e-3, 2.0])
def test_spread_to_zero_meets_the_sharp_limit(x):
    """E[max(-g, 0)] -> max(-x, 0) with an error below the spread; value, and the identity with the positive part."""
    for s in (0.5, 1e-2, 1e-6, 1e-200, 0.0):
        below, by_x, by_s = negative_part(x, s)
        above, _, _ = positive_part(x, s)
        assert max(-x, 0.0) <= below <= max(-x, 0.0) + 0.4 * s
        assert above - below == pytest.approx(x, abs=1e-15)
        assert -1.0 <= by_x <= 0.0 <= by_s <= 0.4


@pytest.mark.parametrize(("p0", "slope"), [(0.6, 0.0), (0.7, -0.4), (0.5, 0.3), (0.1, -3.0), (0.0, 1.0)])
def test_what_a_line_of_forces_loses(p0, slope):
    """Against quadrature over the forces; a line that falls to zero has lost its triangle and no more."""
    x, s = np.linspace(-3.0, 1.0, 17), 0.25
    wanted = line_below(p0, slope, x, s)
    found = np.array([lost_and_gained(p0, slope, value, s) for value in x])
    assert found[:, 0] == pytest.approx(wanted, abs=1e-9 * max(1.0, wanted.max()))
    if slope < 0.0:
        assert lost_and_gained(p0, slope, -50.0, s)[0] == pytest.approx(-0.5 * p0**2 / slope, rel=1e-9)
    h = 1e-5
    for value in x:
        for column, (dx, ds) in ((1, (h, 0.0)), (2, (0.0, h))):
            up, down = lost_and_gained(p0, slope, value + dx, s + ds), lost_and_gained(p0, slope, value - dx, s - ds)
            here = lost_and_gained(p0, slope, value, s)
            for of in (0, 3):
                assert (up[of] - down[of]) / (2 * h) == pytest.approx(here[of + column], abs=1e-8)


def test_z_and_fabric_are_functions_of_stress_and_the_largest_stress_ratio():
    """Whether the pressure falls before, while or after the deviator grows."""
    start = (-PRESSURE, -PRESSURE, 0.0)
    paths = ([(-0.5, -0.5), (-0.65, -0.35)], [(-0.65, -0.35)], [(-1.1, -0.9), (-1.3, -0.7), (-0.65, -0.35)])
    names = ("coordination", "fabric_anisotropy", "tangential_force_anisotropy")
    ends = []
    for path in paths:
        legs = [Leg(target=(PRESSURE * a, PRESSURE * b, 0.0), increments=10) for a, b in path]
        history = drive(law(closure=SHIFTED), start, legs).columns
        ends.append([history[name][-1] for name in names])
    assert np.ptp(np.array(ends), axis=0) == pytest.approx(0.0, abs=1e-8)
    assert ends[0][0] < 3.6


def test_isotropic_unloading_to_a_tenth():
    """lost = P0 chi_p (1 - p/p_0) in every direction, in units of the initial mean force; all of it comes back."""
    closure = Closure(
        force_change="shifted_distribution", weak_contact_ratio_isotropic=0.6, elastic_scatter_isotropic=0.0
    )
    packing = material(force_density_at_zero=0.65)
    legs = [Leg(target=(-PRESSURE * p, -PRESSURE * p, 0.0), increments=3) for p in (0.5, 0.1, 1.0)]
    history = drive(law(closure=closure, materials=[packing]), (-PRESSURE, -PRESSURE, 0.0), legs)
    z = history.columns["coordination"] / 4.06
    for step, p in ((3, 0.5), (6, 0.1)):
        left = 0.65 * 0.6 * (1.0 - p)
        assert z[step] == pytest.approx(np.exp(-left - left**2 / 2), rel=1e-9)
    assert z[9] == pytest.approx(1.0, abs=1e-12)
