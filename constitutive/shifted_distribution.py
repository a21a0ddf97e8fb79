"""Closure by the distribution of weak-contact forces itself [model, section 5.3].

Forces of the contacts of a direction start with a flat density P0 above zero. Loading shifts them by
X(theta) = X_0 + X_1.e, in units of the mean force, and spreads them by S; what has moved below zero is lost:

    N(theta) = (1 + a_c(0).e) exp(-P0 E[max(-X, 0)] + g E[max(X, 0)]),     expectations over a spread S
    z = z(0) <N>,    a_c = 2 <N e>/<N>,    S^2 = S_i^2 + (c_e |X_1|)^2,    g = beta P_xi0 f/(2 kn r) at z(0)
    dX_0 = (chi_p - X_0) dlnp,    dX_1 = chi (a_n dlnp + c_n ds + da_c) - X_1 dlnp
    dS_i = c_w |dgamma| kn r/f on virgin loading, else 0

Two exact integrals simplify this. X_0 is a function of the pressure, ``(X_0 - chi_p) p`` being constant. And
``Y = X_1 - chi a_c`` obeys ``dY = chi (a_n dlnp + c_n ds) - X_1 dlnp``, in which da_c no longer appears; X_1 then
follows from Y by two equations. So the unknowns are S_i and Y in place of z and a_c, and N > 0 makes z > 0, |a_c| < 2.
"""

import math

from .compilation import compiled
from .weak_forces import negative_part, positive_part

_ITERATIONS = 50
_TOLERANCE = 1e-14


@compiled()
def network_of(x0, y1, y2, spread, guess1, guess2, origin, p0, gain, chi, c_e, cosines, sines, out):
    """Coordination number and fabric of a state, with derivatives.

    Parameters
    ----------
    x0, y1, y2, spread : float
        X_0, Y, S_i.
    guess1, guess2 : float
        Start of the iteration for X_1.
    origin : tuple of 3 floats
        z, a_c1, a_c2 of the initial packing.
    p0, gain : float
        P0 and g; 0 for an effect that is off.
    chi, c_e : float
        Closure numbers.
    cosines, sines : ndarray, shape (directions,)
        e at directions equally spaced over the circle.
    out : ndarray, shape (20,)
        Written: z, a_c1, a_c2, X_1 (2), then the derivatives of (z, a_c1, a_c2) by X_0, g, S_i, Y_1, Y_2, five each.

    Returns
    -------
    bool
        False if no X_1 was found.
    """
    z0, q1, q2 = origin
    number = cosines.shape[0]
    share = 1.0 / number
    x1, x2 = guess1, guess2
    if not (math.isfinite(x1) and math.isfinite(x2)):
        x1, x2 = y1, y2
    found = False
    for _ in range(_ITERATIONS):
        shift = x1 * x1 + x2 * x2
        s = math.sqrt(spread * spread + c_e * c_e * shift)
        n0, n1, n2 = 0.0, 0.0, 0.0
        # sums of N h over directions times 1, e and e e: h the logarithmic derivative of N by X, S, g
        x_0, x_1, x_2, x_11, x_12, x_22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        s_0, s_1, s_2 = 0.0, 0.0, 0.0
        g_0, g_1, g_2 = 0.0, 0.0, 0.0
        for i in range(number):
            c, t = cosines[i], sines[i]
            x = x0 + x1 * c + x2 * t
            below, below_x, below_s = negative_part(x, s)
            exponent, by_x, by_s, by_g = -p0 * below, -p0 * below_x, -p0 * below_s, 0.0
            if gain > 0.0:
                above, above_x, above_s = positive_part(x, s)
                exponent += gain * above
                by_x += gain * above_x
                by_s += gain * above_s
                by_g = above
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
        f1, f2 = x1 - y1 - chi * a1, x2 - y2 - chi * a2
        j11, j12, j21, j22 = 1.0 - chi * m11, -chi * m12, -chi * m21, 1.0 - chi * m22
        determinant = j11 * j22 - j12 * j21
        if not determinant > 1e-9:
            return False
        if found:
            break
        step1, step2 = (j22 * f1 - j12 * f2) / determinant, (j11 * f2 - j21 * f1) / determinant
        # one more evaluation at the solution gives derivatives that belong to it
        found = abs(step1) + abs(step2) <= _TOLERANCE * (1.0 + abs(x1) + abs(x2))
        x1 -= step1
        x2 -= step2
    if not found:
        return False
    out[0], out[1], out[2], out[3], out[4] = z0 * n0 * share, a1, a2, x1, x2
    i11, i12, i21, i22 = j22 / determinant, -j12 / determinant, -j21 / determinant, j11 / determinant
    by_spread = spread * inverse
    z_scale = z0 * share
    z_x1, z_x2 = x_1 + s_0 * w1, x_2 + s_0 * w2
    for k in range(5):
        # direct derivatives of a_c and n0 by X_0, g, S_i; Y enters through X_1 only
        if k == 0:
            d1, d2, d0 = by_x1, by_x2, x_0
        elif k == 1:
            d1, d2, d0 = by_g1, by_g2, g_0
        elif k == 2:
            d1, d2, d0 = by_s1 * by_spread, by_s2 * by_spread, s_0 * by_spread
        else:
            d1, d2, d0 = 0.0, 0.0, 0.0
        r1, r2 = chi * d1, chi * d2
        if k == 3:
            r1 = 1.0
        elif k == 4:
            r2 = 1.0
        # d X_1 = (1 - chi d a_c/d X_1)^-1 (d Y + chi d a_c)
        e1, e2 = i11 * r1 + i12 * r2, i21 * r1 + i22 * r2
        out[5 + k] = z_scale * (d0 + z_x1 * e1 + z_x2 * e2)
        out[10 + k] = d1 + m11 * e1 + m12 * e2
        out[15 + k] = d2 + m21 * e1 + m22 * e2
    return True


@compiled()
def _contacts(origin, p0, c_e, state, c, t):
    """N in one direction; `state` is X_0, X_1 (2), S_i, g."""
    x0, x1, x2, spread, gain = state
    x = x0 + x1 * c + x2 * t
    s = math.sqrt(spread * spread + c_e * c_e * (x1 * x1 + x2 * x2))
    exponent = -p0 * negative_part(x, s)[0]
    if gain > 0.0:
        exponent += gain * positive_part(x, s)[0]
    return (1.0 + origin[1] * c + origin[2] * t) * math.exp(exponent)


@compiled()
def split_change(origin, p0, c_e, start, end, cosines, sines, gained, lost):
    """Add to `gained` and `lost` (z, a_c1, a_c2) what an increment changed, split by the sign of the change of N.

    With N the contacts and <N> their mean at the end, ``da_c = (2 <dN e> - a_c(start) <dN>)/<N>`` is exact and linear
    in dN, so that start + gained - lost = end to rounding.
    """
    number = cosines.shape[0]
    g0, g1, g2, l0, l1, l2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    before, before1, before2, after = 0.0, 0.0, 0.0, 0.0
    for i in range(number):
        c, t = cosines[i], sines[i]
        n_start = _contacts(origin, p0, c_e, start, c, t)
        n_end = _contacts(origin, p0, c_e, end, c, t)
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
