"""Closure by the distribution of weak-contact forces itself [model, section 5.3].

Forces of the contacts of a direction start with a flat density P0 above zero. Loading shifts them by
X(theta) = X_0 + X_1.e, in units of the mean force, and spreads them by S; what has moved below zero is lost:

    Lambda = P0 E[max(-X, 0)],      N(theta) = (1 + a_c(0).e) exp(-Lambda - Lambda^2/2 + g E[max(X, 0)])
    z = z(0) <N>,    a_c = 2 <N e>/<N>,    g = beta P_xi0 f/(2 kn r) at z(0),    expectations over a spread S
    S^2 = S_i^2 + (c_e |X_1|)^2 + (c_p X_0)^2,    S_i = c_i max |s|^2
    dX_0 = (chi_p - X_0) dlnp,    dX_1 = chi (a_n dlnp + dA) - X_1 dlnp,    A = a_n + a_c  (`force_fabric`)

A flat density loses exactly the share Lambda; ``exp(-Lambda - Lambda^2/2)`` is that up to the third order and stays
positive. Two exact integrals simplify the rates. X_0 is a function of the pressure, ``(X_0 - chi_p) p`` being constant.
And ``Y = X_1 - chi A`` obeys ``dY = (chi a_n - X_1) dlnp``; X_1 follows from Y by two equations, because A depends on
a_c. So the unknown is Y in place of a_c, and N > 0 makes z > 0, |a_c| < 2.
"""

import math

import numpy as np

from granfabric.constitutive.compilation import compiled

from .force_fabric import (
    A1,
    A2,
    BY_A11,
    BY_A12,
    BY_A21,
    BY_A22,
    BY_S11,
    BY_S12,
    BY_S21,
    BY_S22,
    BY_X1,
    BY_X2,
    force_fabric,
)
from .force_fabric import LENGTH as FABRIC_LENGTH
from .weak_forces import negative_part, positive_part

_ITERATIONS = 50
_TOLERANCE = 1e-13

# entries of a result: z, a_c (2), X_1 (2), A (2), then the derivatives of these seven by the INPUTS below, row by row
Z, AC1, AC2, SHIFT1, SHIFT2, CARRIED1, CARRIED2, DERIVATIVES = 0, 1, 2, 3, 4, 5, 6, 7
ROWS = 7
INPUTS = 7
BY_X0, BY_GAIN, BY_SPREAD, BY_Y1, BY_Y2, BY_S1, BY_S2 = range(INPUTS)
LENGTH = DERIVATIVES + ROWS * INPUTS


@compiled()
def logarithm(p0, gain, x, s):
    """ln N of one direction without the initial density, with its derivatives by X, S and g."""
    below, below_x, below_s = negative_part(x, s)
    lost = p0 * below
    factor = -p0 * (1.0 + lost)
    value, by_x, by_s, by_gain = -lost - 0.5 * lost * lost, factor * below_x, factor * below_s, 0.0
    if gain > 0.0:
        above, above_x, above_s = positive_part(x, s)
        value += gain * above
        by_x += gain * above_x
        by_s += gain * above_s
        by_gain = above
    return value, by_x, by_s, by_gain


@compiled()
def spread_of(x0, x1, x2, irreversible, c_e, c_p):
    """S."""
    return math.sqrt(irreversible * irreversible + c_e * c_e * (x1 * x1 + x2 * x2) + c_p * c_p * x0 * x0)


@compiled()
def network_of(state, guess, origin, p0, normal, kind, c_n, numbers, cosines, sines, fabric, out):
    """Coordination number and fabric of a state, with derivatives.

    Parameters
    ----------
    state : tuple of 7 floats
        X_0, g, S_i, Y (2), s (2), in the order of the derivatives.
    guess : tuple of 2 floats
        Start of the iteration for X_1.
    origin : tuple of 3 floats
        z, a_c1, a_c2 of the initial packing.
    p0 : float
        P0; 0 if nothing is lost.
    normal : tuple of 2 floats
        a_n, if it follows from s alone.
    kind, c_n : int, float
        See `force_fabric`.
    numbers : ndarray
        chi, chi_p, c_e, c_p, c_i, c_t, k, lambda: `lanes.CHI` ... .
    cosines, sines : ndarray, shape (directions,)
        e at directions equally spaced over the circle.
    fabric : ndarray, shape (force_fabric.LENGTH,)
        Workspace; afterwards the force fabric at the solution.
    out : ndarray, shape (LENGTH,)
        Written.

    Returns
    -------
    bool
        False if no X_1 was found.
    """
    x0, gain, irreversible, y1, y2, stress1, stress2 = state
    z0, q1, q2 = origin
    chi, c_e, c_p = numbers[0], numbers[2], numbers[3]
    number = cosines.shape[0]
    share = 1.0 / number
    x1, x2 = guess
    if not (math.isfinite(x1) and math.isfinite(x2)):
        x1, x2 = y1, y2
    found = False
    for _ in range(_ITERATIONS):
        s = spread_of(x0, x1, x2, irreversible, c_e, c_p)
        n0, n1, n2 = 0.0, 0.0, 0.0
        # sums of N h over directions times 1, e and e e: h the logarithmic derivative of N by X, S, g
        x_0, x_1, x_2, x_11, x_12, x_22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        s_0, s_1, s_2 = 0.0, 0.0, 0.0
        g_0, g_1, g_2 = 0.0, 0.0, 0.0
        for i in range(number):
            c, t = cosines[i], sines[i]
            exponent, by_x, by_s, by_g = logarithm(p0, gain, x0 + x1 * c + x2 * t, s)
            n = (1.0 + q1 * c + q2 * t) * math.exp(exponent)
            n0 += n
            n1 += n * c
            n2 += n * t
            h = n * by_x
            x_0 += h
            x_1 += h * c
            x_2 += h * t
            x_11 += h * c * c
            x_12 += h * c * t
            x_22 += h * t * t
            h = n * by_s
            s_0 += h
            s_1 += h * c
            s_2 += h * t
            h = n * by_g
            g_0 += h
            g_1 += h * c
            g_2 += h * t
        if not n0 > 0.0:
            return False
        a1, a2 = 2.0 * n1 / n0, 2.0 * n2 / n0
        twice = 2.0 / n0
        # derivatives of a_c by X_0, S, g and the direct ones by X_1
        by_x1, by_x2 = twice * x_1 - a1 * x_0 / n0, twice * x_2 - a2 * x_0 / n0
        by_s1, by_s2 = twice * s_1 - a1 * s_0 / n0, twice * s_2 - a2 * s_0 / n0
        by_g1, by_g2 = twice * g_1 - a1 * g_0 / n0, twice * g_2 - a2 * g_0 / n0
        inverse = 1.0 / s if s > 0.0 else 0.0
        w1, w2 = c_e * c_e * x1 * inverse, c_e * c_e * x2 * inverse
        m11 = twice * x_11 - a1 * x_1 / n0 + by_s1 * w1
        m12 = twice * x_12 - a1 * x_2 / n0 + by_s1 * w2
        m21 = twice * x_12 - a2 * x_1 / n0 + by_s2 * w1
        m22 = twice * x_22 - a2 * x_2 / n0 + by_s2 * w2
        if not force_fabric(
            kind, stress1, stress2, a1, a2, x0, normal[0], normal[1], c_n, numbers[5], numbers[6], numbers[7], fabric
        ):
            return False
        t11, t12, t21, t22 = fabric[BY_A11], fabric[BY_A12], fabric[BY_A21], fabric[BY_A22]
        f1, f2 = x1 - y1 - chi * fabric[A1], x2 - y2 - chi * fabric[A2]
        j11, j12 = 1.0 - chi * (t11 * m11 + t12 * m21), -chi * (t11 * m12 + t12 * m22)
        j21, j22 = -chi * (t21 * m11 + t22 * m21), 1.0 - chi * (t21 * m12 + t22 * m22)
        determinant = j11 * j22 - j12 * j21
        if not determinant > 1e-9:
            return False
        step1, step2 = (j22 * f1 - j12 * f2) / determinant, (j11 * f2 - j21 * f1) / determinant
        # so small a step would not be seen in what was evaluated
        found = abs(step1) + abs(step2) <= _TOLERANCE * (1.0 + abs(x1) + abs(x2))
        if found:
            break
        x1 -= step1
        x2 -= step2
    if not found:
        return False
    out[Z], out[AC1], out[AC2], out[SHIFT1], out[SHIFT2] = z0 * n0 * share, a1, a2, x1, x2
    out[CARRIED1], out[CARRIED2] = fabric[A1], fabric[A2]
    i11, i12, i21, i22 = j22 / determinant, -j12 / determinant, -j21 / determinant, j11 / determinant
    by_spread = irreversible * inverse
    by_isotropic = c_p * c_p * x0 * inverse
    z_scale = z0 * share
    z_x1, z_x2 = x_1 + s_0 * w1, x_2 + s_0 * w2
    for k in range(INPUTS):
        # direct derivatives of a_c and n0 at fixed X_1, then those of A at fixed a_c
        d0, d1, d2, e1, e2 = 0.0, 0.0, 0.0, 0.0, 0.0
        if k == BY_X0:
            d0 = x_0 + s_0 * by_isotropic
            d1, d2 = by_x1 + by_s1 * by_isotropic, by_x2 + by_s2 * by_isotropic
            e1, e2 = fabric[BY_X1], fabric[BY_X2]
        elif k == BY_GAIN:
            d0, d1, d2 = g_0, by_g1, by_g2
        elif k == BY_SPREAD:
            d0, d1, d2 = s_0 * by_spread, by_s1 * by_spread, by_s2 * by_spread
        elif k == BY_S1:
            e1, e2 = fabric[BY_S11], fabric[BY_S21]
        elif k == BY_S2:
            e1, e2 = fabric[BY_S12], fabric[BY_S22]
        r1 = chi * (e1 + t11 * d1 + t12 * d2) + (1.0 if k == BY_Y1 else 0.0)
        r2 = chi * (e2 + t21 * d1 + t22 * d2) + (1.0 if k == BY_Y2 else 0.0)
        v1, v2 = i11 * r1 + i12 * r2, i21 * r1 + i22 * r2
        b1, b2 = d1 + m11 * v1 + m12 * v2, d2 + m21 * v1 + m22 * v2
        row = DERIVATIVES + k
        out[row] = z_scale * (d0 + z_x1 * v1 + z_x2 * v2)
        out[row + INPUTS] = b1
        out[row + 2 * INPUTS] = b2
        out[row + 3 * INPUTS] = v1
        out[row + 4 * INPUTS] = v2
        out[row + 5 * INPUTS] = e1 + t11 * b1 + t12 * b2
        out[row + 6 * INPUTS] = e2 + t21 * b1 + t22 * b2
    return True


@compiled()
def _contacts(origin, p0, c_e, c_p, state, c, t):
    """N in one direction; `state` is X_0, X_1 (2), S_i, g."""
    x0, x1, x2, irreversible, gain = state
    value = logarithm(p0, gain, x0 + x1 * c + x2 * t, spread_of(x0, x1, x2, irreversible, c_e, c_p))[0]
    return (1.0 + origin[1] * c + origin[2] * t) * math.exp(value)


@compiled()
def split_change(origin, p0, c_e, c_p, start, end, cosines, sines, gained, lost):
    """Add to `gained` and `lost` (z, a_c1, a_c2) what an increment changed, split by the sign of the change of N.

    With N the contacts and <N> their mean at the end, ``da_c = (2 <dN e> - a_c(start) <dN>)/<N>`` is exact and linear
    in dN, so that start + gained - lost = end to rounding.
    """
    number = cosines.shape[0]
    g0, g1, g2, l0, l1, l2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    before, before1, before2, after = 0.0, 0.0, 0.0, 0.0
    for i in range(number):
        c, t = cosines[i], sines[i]
        n_start = _contacts(origin, p0, c_e, c_p, start, c, t)
        n_end = _contacts(origin, p0, c_e, c_p, end, c, t)
        before += n_start
        before1 += n_start * c
        before2 += n_start * t
        after += n_end
        change = n_end - n_start
        if change > 0.0:
            g0 += change
            g1 += change * c
            g2 += change * t
        else:
            l0 -= change
            l1 -= change * c
            l2 -= change * t
    a1, a2 = 2.0 * before1 / before, 2.0 * before2 / before
    gained[0] += origin[0] * g0 / number
    gained[1] += (2.0 * g1 - a1 * g0) / after
    gained[2] += (2.0 * g2 - a2 * g0) / after
    lost[0] += origin[0] * l0 / number
    lost[1] += (2.0 * l1 - a1 * l0) / after
    lost[2] += (2.0 * l2 - a2 * l0) / after


@compiled()
def workspace():
    """Arrays `fabric` and `out` of `network_of`."""
    return np.empty(FABRIC_LENGTH), np.empty(LENGTH)
