"""Closures in the form of rates: how z and a_c change with the stress [Pouragha & Wan 2017, eqs 3-13].

Written in the rates ``d = dp/p`` and ``ds`` of the stress-ratio vector s, so that nothing divides by dp:

    dF(theta) = d + w.e,    w = a_n d + b,    b = 2 ds (tangential neglected)  or  c_n ds + da_c (self-consistent)
    X_i  = g gain_i - P0 loss_i,    g = beta P_xi0 f/(2 kn r)          (loss_i, gain_i of `contact_change`)
    dz   = z X_0,      da_c = 2 (X_1, X_2) - a_c X_0

`MeanField` is the source: every contact of a direction feels the mean change of force. With a scatter of that change
it is the closure "fluctuating" (`quadrature_change`). The unknowns are z and a_c themselves, so that what a
closure is asked about them is answered in `at_rest`.
"""

import math
from typing import NamedTuple

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import choose, somewhere
from granfabric.constitutive.lanes.elementary import larger

from .contact_change import LARGEST_FORCE_ANISOTROPY, closed_form_change
from .quadrature_change import quadrature_change

MOST_ITERATIONS = 60
STEP_TOLERANCE = 1e-10
"""Newton step of da_c that is the last one: what it leaves is of its square."""


@formula
def rates(closure, point, stress, rate, network, guess, strain, with_derivatives, rule):
    """Rates of z and a_c, and what `rate_changes` needs.

    Parameters
    ----------
    closure : MeanField
    point : Point
    stress : tuple of 4
        p, 1/p and s (2).
    rate : tuple of 4
        dp, d = dp/p, and ds (2).
    network : Network
    guess : tuple of 2
        da_c, about.
    strain : tuple of 2
        Rate of the deviatoric strain (e_xx - e_yy, gamma_xy).
    with_derivatives : bool
    rule : tuple
        Gauss-Legendre nodes and weights, then cosines and sines of other closures.

    Returns
    -------
    solved : bool
        False where the self-consistent equations have no solution.
    limited : bool
        Whether a_n was limited.
    rates : tuple of 3
    gained, lost : tuples of 3
        What the rates consist of.
    guess : tuple of 2
        da_c.
    partials : tuple
    """
    _, _, s1, s2 = stress
    _, d, ds1, ds2 = rate
    z, a1, a2 = network.z, network.a1, network.a2
    n1 = point.start_n1 + point.c_n * (s1 - point.start_s1)
    n2 = point.start_n2 + point.c_n * (s2 - point.start_s2)
    square = n1 * n1 + n2 * n2
    # without loss and gain there is nothing that a_n could clip
    largest = LARGEST_FORCE_ANISOTROPY if closure.loss or closure.gain else 1e150
    over = square > largest * largest
    limit = choose(over, largest / math.sqrt(choose(over, square, 1.0)), 1.0)
    n1, n2 = n1 * limit, n2 * limit
    force = point.force_scale * stress[0] / z
    room = larger(point.neighbours - z, 0.0)
    g = room / z * point.half_gap * force
    p0 = point.p_zero
    deviator = math.sqrt(strain[0] * strain[0] + strain[1] * strain[1])
    sigma = closure.c_w * deviator / force if closure.scattered else 0.0 * z
    share = point.c_n if closure.self_consistent else 2.0 + 0.0 * z
    w1, w2 = n1 * d + share * ds1, n2 * d + share * ds2
    zero = 0.0 * z
    x1, x2 = guess if closure.self_consistent else (zero, zero)
    x1, x2 = choose(abs(x1) < 1e150, x1, 0.0), choose(abs(x2) < 1e150, x2, 0.0)
    solved = zero == 0.0
    i11, i12, i21, i22 = 1.0 + zero, zero, zero, 1.0 + zero
    more0, more1, more2 = zero, zero, zero
    iteration = 0
    while True:
        v1, v2 = w1 + x1, w2 + x2
        loss, gain, by_v, by_a, by_n, by_sigma = _change(
            closure, d, v1, v2, a1, a2, n1, n2, g, p0, sigma, with_derivatives, rule
        )
        net0, net1, net2 = g * gain[0] - p0 * loss[0], g * gain[1] - p0 * loss[1], g * gain[2] - p0 * loss[2]
        if not closure.self_consistent:
            break
        # one Newton step on x = da_c(b = c_n ds + x) where it has not converged
        r11, r12 = 2.0 * by_v[3] - a1 * by_v[1], 2.0 * by_v[4] - a1 * by_v[2]
        r21, r22 = 2.0 * by_v[4] - a2 * by_v[1], 2.0 * by_v[5] - a2 * by_v[2]
        determinant = (1.0 - r11) * (1.0 - r22) - r12 * r21
        solvable = (determinant > 1e-9) & (r11 < 1.0) & (r22 < 1.0)
        inverse = 1.0 / choose(solvable, determinant, 1.0)
        i11, i12, i21, i22 = (1.0 - r22) * inverse, r12 * inverse, r21 * inverse, (1.0 - r11) * inverse
        e1, e2 = 2.0 * net1 - a1 * net0 - x1, 2.0 * net2 - a2 * net0 - x2
        step1, step2 = i11 * e1 + i12 * e2, i21 * e1 + i22 * e2
        size = STEP_TOLERANCE * (abs(d) + abs(v1) + abs(v2) + sigma)
        solved = solved & solvable
        going = solved & (abs(step1) + abs(step2) > size)
        iteration += 1
        if iteration >= MOST_ITERATIONS:
            solved = solved & (abs(step1) + abs(step2) <= size)
            going = solved & (abs(step1) + abs(step2) > size)
        if not somewhere(going):
            # the last step, to first order; how long other lanes take does not matter
            x1, x2 = x1 + step1, x2 + step2
            more0 = by_v[1] * step1 + by_v[2] * step2
            more1, more2 = by_v[3] * step1 + by_v[4] * step2, by_v[4] * step1 + by_v[5] * step2
            break
        x1, x2 = choose(going, x1 + step1, x1), choose(going, x2 + step2, x2)
    won0, less0 = g * gain[0], p0 * loss[0]
    won0, less0 = won0 + choose(more0 > 0.0, more0, 0.0), less0 - choose(more0 < 0.0, more0, 0.0)
    net0, net1, net2 = net0 + more0, net1 + more1, net2 + more2
    gained = (z * won0, 2.0 * (g * gain[1] + more1) - a1 * won0, 2.0 * (g * gain[2] + more2) - a2 * won0)
    lost = (z * less0, 2.0 * p0 * loss[1] - a1 * less0, 2.0 * p0 * loss[2] - a2 * less0)
    net = (gained[0] - lost[0], gained[1] - lost[1], gained[2] - lost[2])
    partials = (
        net0,
        gain,
        by_v,
        by_a,
        by_n,
        by_sigma,
        (i11, i12, i21, i22),
        (n1, n2, limit, force, room, share, sigma, deviator),
    )
    return solved, over, net, gained, lost, (x1, x2), partials


@formula
def _change(closure, d, v1, v2, a1, a2, n1, n2, g, p0, sigma, with_derivatives, rule):
    """Loss and gain, by closed form where there is one."""
    everywhere = closure.scattered or closure.entropy or not closure.closed_form
    loss, gain = closure.loss, closure.gain
    if not (loss or gain):
        zero = 0.0 * d
        none, nowhere = (zero, zero, zero), (zero, zero, zero, zero, zero, zero)
        return none, none, nowhere, nowhere, nowhere, none
    if everywhere:
        return quadrature_change(
            d, v1, v2, a1, a2, n1, n2, g, p0, loss, gain,
            sigma, closure.chi, closure.scattered, closure.entropy, rule[0], rule[1],
        )  # fmt: skip
    change = closed_form_change(d, v1, v2, a1, a2, n1, n2, g, p0, loss, gain, with_derivatives)
    clipped = a1 * a1 + a2 * a2 > 1.0
    if somewhere(clipped):
        other = quadrature_change(
            d, v1, v2, a1, a2, n1, n2, g, p0, loss, gain, sigma, closure.chi, False, False, rule[0], rule[1]
        )
        change = choose(clipped, other, change)
    return change


@formula
def rate_changes(closure, point, stress, rate, network, strain, partials, change, stress_change, rate_change, own):
    """Changes of the rates of z and a_c.

    Parameters
    ----------
    change : tuple of 3
        Of z and a_c.
    stress_change : tuple of 3
        Of ln p and s.
    rate_change : tuple of 4
        Of dp, d and ds.
    own : tuple of 2
        Of the deviatoric strain rate itself.
    """
    if not (closure.loss or closure.gain):
        zero = 0.0 * rate[0]
        return zero, zero, zero
    net0, gain, by_v, by_a, by_n, by_sigma, inverse, more = partials
    n1, n2, limit, force, room, share, sigma, deviator = more
    tz, t1, t2 = change
    relative, u1, u2 = stress_change
    d = rate[1]
    _, dd, dds1, dds2 = rate_change
    z, a1, a2 = network.z, network.a1, network.a2
    # a limited vector only turns: the part along itself is removed
    m1, m2 = point.c_n * u1, point.c_n * u2
    square = n1 * n1 + n2 * n2
    part = choose(limit < 1.0, (m1 * n1 + m2 * n2) / choose(square > 0.0, square, 1.0), 0.0)
    m1, m2 = limit * (m1 - part * n1), limit * (m2 - part * n2)
    df = force * (relative - tz / z)
    # g = (z_nb - z)/z times half_gap times f
    dg = point.half_gap * (room * df - choose(room > 0.0, point.neighbours, 0.0) * force * tz / z) / z
    w1, w2 = n1 * dd + d * m1 + share * dds1, n2 * dd + d * m2 + share * dds2
    x0 = by_v[0] * dd + by_v[1] * w1 + by_v[2] * w2 + by_a[0] * t1 + by_a[1] * t2 + by_n[0] * m1 + by_n[1] * m2
    x1 = by_v[1] * dd + by_v[3] * w1 + by_v[4] * w2 + by_a[2] * t1 + by_a[3] * t2 + by_n[2] * m1 + by_n[3] * m2
    x2 = by_v[2] * dd + by_v[4] * w1 + by_v[5] * w2 + by_a[4] * t1 + by_a[5] * t2 + by_n[4] * m1 + by_n[5] * m2
    x0, x1, x2 = x0 + gain[0] * dg, x1 + gain[1] * dg, x2 + gain[2] * dg
    if closure.scattered:
        turn = (strain[0] * own[0] + strain[1] * own[1]) / choose(deviator > 0.0, deviator, 1.0)
        ds = (closure.c_w * turn - sigma * df) / force
        x0, x1, x2 = x0 + by_sigma[0] * ds, x1 + by_sigma[1] * ds, x2 + by_sigma[2] * ds
    b1, b2 = 2.0 * x1 - a1 * x0 - t1 * net0, 2.0 * x2 - a2 * x0 - t2 * net0
    if closure.self_consistent:
        # da_c stands on both sides: times (1 - d da_c/d b)^-1; then carried into dz
        i11, i12, i21, i22 = inverse
        b1, b2 = i11 * b1 + i12 * b2, i21 * b1 + i22 * b2
        x0 += by_v[1] * b1 + by_v[2] * b2
    return z * x0 + tz * net0, b1, b2


class MeanField(NamedTuple):
    """Numbers and choices of the closures "mean_field" and "fluctuating"; see `closures` for what it answers."""

    loss: bool
    gain: bool
    self_consistent: bool
    entropy: bool
    closed_form: bool
    scattered: bool
    chi: float
    c_w: float

