"""Closure by the distribution of weak-contact forces itself [model, section 5.3].

Forces of the contacts of a direction start with a flat density P0 above zero. Loading shifts them by
X(theta) = X_0 + X_1.e, in units of the mean force, and spreads them by S; what has moved below zero is lost:

    Lambda = P0 E[max(-X, 0)],      N(theta) = (1 + a_c(0).e) exp(-Lambda - Lambda^2/2 + g E[max(X, 0)])
    z = z(0) <N>,    a_c = 2 <N e>/<N>,    g = beta P_xi0 f/(2 kn r) at z(0),    expectations over a spread S
    S^2 = S_i^2 + (c_e |X_1|)^2 + (c_p X_0)^2,    S_i = c_i max |s|^2
    dX_0 = (chi_p - X_0) dlnp,    dX_1 = chi (a_n dlnp + dA) - X_1 dlnp,    A = a_n + a_c  (`force_fabric`)

A flat density loses exactly the share Lambda; ``exp(-Lambda - Lambda^2/2)`` is that up to the third order and stays
positive. Two exact integrals simplify the rates. X_0 is a function of the pressure, ``(X_0 - chi_p) p`` being constant.
And ``Y = X_1 - chi A`` obeys ``dY = -(Y + chi a_c) dlnp``, so that

    V = p Y,        dV = -chi a_c dp

is all that has to be integrated: it is the unknown in place of a_c, and X_1 follows from it and the stress by two
equations, because A depends on a_c (`network_at`). N > 0 makes z > 0, |a_c| < 2.

The averages < > are taken in the frame of X_1, in which X depends on the cosine alone: half of the directions do.
"""

import math

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import choose, somewhere
from granfabric.constitutive.lanes.elementary import exponential

from .force_fabric import LEAST_MARGIN, carried_force, carried_force_by_stress, tangential_force
from .weak_forces import negative_part

MOST_ITERATIONS = 50
STEP_TOLERANCE = 1e-8
"""Newton step of X_1 that is the last one: what it leaves is of its square, and it is carried on to z and a_c."""


@formula
def logarithm(p0, gain, x, s):
    """ln N of one direction without the initial density, with its derivatives by X, S and g."""
    below, below_x, below_s = negative_part(x, s)
    lost = p0 * below
    above = below + x
    factor = -p0 * (1.0 + lost)
    return (
        gain * above - lost - 0.5 * lost * lost,
        factor * below_x + gain * (1.0 + below_x),
        (factor + gain) * below_s,
        above,
    )


@formula
def spread_of(x0, size, irreversible, c_e, c_p):
    """S for |X_1| = size."""
    return math.sqrt(irreversible * irreversible + c_e * c_e * size * size + c_p * c_p * x0 * x0)


@formula
def moments_along(x0, size, s, p0, gain, cosines):
    """Averages over directions of M = N/(1 + a_c(0).e) and of its derivatives, times powers of the cosine c to X_1.

    Parameters
    ----------
    x0, size, s, p0, gain : float
        X_0, |X_1|, S, P0 and g.
    cosines : ndarray, shape (directions/2,)
        Of directions equally spaced over half of the circle.

    Returns
    -------
    number : tuple of 3 floats
        <M>, <M c>, <M c^2>.
    by_x : tuple of 4
        The same for M d(ln M)/dX, up to c^3.
    by_s, by_gain : tuples of 3
        The same for the derivatives by S and g, up to c^2.
    """
    share = 1.0 / cosines.shape[0]
    zero = 0.0 * x0
    m0, m1, m2, x_0, x_1, x_2, x_3 = zero, zero, zero, zero, zero, zero, zero
    s_0, s_1, s_2, g_0, g_1, g_2 = zero, zero, zero, zero, zero, zero
    for i in range(cosines.shape[0]):
        c = cosines[i]
        exponent, by_x, by_s, by_g = logarithm(p0, gain, x0 + size * c, s)
        m = exponential(exponent) * share
        m0 += m
        m1 += m * c
        m2 += m * (c * c)
        by_x, by_s, by_g = by_x * m, by_s * m, by_g * m
        x_0 += by_x
        x_1 += by_x * c
        x_2 += by_x * (c * c)
        x_3 += by_x * (c * c * c)
        s_0 += by_s
        s_1 += by_s * c
        s_2 += by_s * (c * c)
        g_0 += by_g
        g_1 += by_g * c
        g_2 += by_g * (c * c)
    return (m0, m1, m2), (x_0, x_1, x_2, x_3), (s_0, s_1, s_2), (g_0, g_1, g_2)


@formula
def with_initial_fabric(m, q1, q2):
    """<N>, <N c>, <N sine> from the averages of M, for a_c(0) = (q1, q2) in the frame of X_1."""
    return m[0] + q1 * m[1], m[1] + q1 * m[2], q2 * (m[0] - m[2])


@formula
def fabric_change(change, n0, a1, a2):
    """Derivative of a_c = 2 <N e>/<N> from those of <N>, <N e>."""
    inverse = 1.0 / n0
    return (2.0 * change[1] - a1 * change[0]) * inverse, (2.0 * change[2] - a2 * change[0]) * inverse


@formula
def network_of(state, stress_ratio, y, guess, origin, p0, normal, c_n, closure, cosines):
    """Coordination number and fabric of a state, with derivatives.

    Parameters
    ----------
    state : tuple of 4 floats
        X_0, dX_0/dlnp, g and S_i.
    stress_ratio, y : tuples of 2 floats
        s and Y.
    guess : tuple of 2 floats
        a_c, about.
    origin : tuple of 3 floats
        z, a_c of the initial packing.
    p0 : float
        P0; 0 if nothing is lost.
    normal : tuple of 2 floats
        a_n, if it follows from s alone, and c_n its derivative by s.
    closure : closures.ShiftedDistribution
    cosines : ndarray
        See `moments_along`.

    Returns
    -------
    found : bool
        False if there is no X_1, or the mean force would pull.
    network : tuple of 5 floats
        z, a_c (2), X_1 (2).
    changes : tuple of 3 tuples of 6 floats
        Derivatives of z, a_c1, a_c2 by ln p, s (2), Y (2), S_i.
    force : tuple of 5 floats
        A (2), mu, a_t (2).
    """
    x0, x0_by_p, gain, irreversible = state
    s1, s2 = stress_ratio
    chi, c_e, c_p = closure.chi, closure.c_e, closure.c_p
    t, t_by_s, t_by_x0 = tangential_force(s1, s2, x0, closure.c_t, closure.slip, closure.delay)
    if not closure.frictional:
        t = (2.0 * s1 - guess[0] - normal[0], 2.0 * s2 - guess[1] - normal[1])
    carried, _, _, margin = carried_force(s1, s2, guess[0], guess[1], t[0], t[1])
    if not closure.frictional:
        carried = (normal[0] + guess[0], normal[1] + guess[1])
    x1, x2 = y[0] + chi * carried[0], y[1] + chi * carried[1]
    usable = (abs(x1) < 1e6) & (abs(x2) < 1e6)
    x1, x2 = choose(usable, x1, y[0]), choose(usable, x2, y[1])
    found = abs(x1) + abs(x2) < 1e6
    iteration = 0
    while True:
        size = math.sqrt(x1 * x1 + x2 * x2)
        inverse = 1.0 / choose(size > 0.0, size, 1.0)
        # the frame of X_1: (e1, e2) along it
        e1, e2 = choose(size > 0.0, x1 * inverse, 1.0), x2 * inverse
        q1, q2 = origin[1] * e1 + origin[2] * e2, origin[2] * e1 - origin[1] * e2
        spread = spread_of(x0, size, irreversible, c_e, c_p)
        number, m_x, m_s, m_g = moments_along(x0, size, spread, p0, gain, cosines)
        n0, n1, n2 = with_initial_fabric(number, q1, q2)
        a1, a2 = 2.0 * n1 / n0, 2.0 * n2 / n0
        by_spread = with_initial_fabric(m_s, q1, q2)
        inverse_s = 1.0 / choose(spread > 0.0, spread, 1e300)
        radial = c_e * c_e * size * inverse_s
        along = (
            m_x[1] + q1 * m_x[2] + by_spread[0] * radial,
            m_x[2] + q1 * m_x[3] + by_spread[1] * radial,
            q2 * (m_x[1] - m_x[3]) + by_spread[2] * radial,
        )
        across = (q2 * (m_x[0] - m_x[2]), q2 * (m_x[1] - m_x[3]), m_x[0] - m_x[2] + q1 * (m_x[1] - m_x[3]))
        m11, m21 = fabric_change(along, n0, a1, a2)
        m12, m22 = fabric_change(across, n0, a1, a2)
        # everything that the force fabric needs in this frame
        f1, f2 = s1 * e1 + s2 * e2, s2 * e1 - s1 * e2
        y1, y2 = y[0] * e1 + y[1] * e2, y[1] * e1 - y[0] * e2
        t1, t2 = t[0] * e1 + t[1] * e2, t[1] * e1 - t[0] * e2
        carried, mu, by_fabric, margin = carried_force(f1, f2, a1, a2, t1, t2)
        if not closure.frictional:
            carried = (normal[0] * e1 + normal[1] * e2 + a1, normal[1] * e1 - normal[0] * e2 + a2)
            by_fabric = (1.0 + 0.0 * a1, 0.0 * a1, 0.0 * a1, 1.0 + 0.0 * a1)
            margin = 1.0 + 0.0 * a1
        t11, t12, t21, t22 = by_fabric
        r1, r2 = size - y1 - chi * carried[0], -y2 - chi * carried[1]
        j11, j12 = 1.0 - chi * (t11 * m11 + t12 * m21), -chi * (t11 * m12 + t12 * m22)
        j21, j22 = -chi * (t21 * m11 + t22 * m21), 1.0 - chi * (t21 * m12 + t22 * m22)
        determinant = j11 * j22 - j12 * j21
        found = found & (n0 > 0.0) & (margin > LEAST_MARGIN) & (determinant > 1e-9)
        inverse_d = 1.0 / choose(found, determinant, 1.0)
        i11, i12, i21, i22 = j22 * inverse_d, -j12 * inverse_d, -j21 * inverse_d, j11 * inverse_d
        step1, step2 = i11 * r1 + i12 * r2, i21 * r1 + i22 * r2
        # a lane that has arrived stays where it is, so that it does not matter how long others take
        going = found & (abs(step1) + abs(step2) > STEP_TOLERANCE * (1.0 + size))
        iteration += 1
        if not somewhere(going):
            break
        if iteration >= MOST_ITERATIONS:
            found = found & (abs(step1) + abs(step2) <= STEP_TOLERANCE * (1.0 + size))
            break
        x1 = choose(going, x1 - (step1 * e1 - step2 * e2), x1)
        x2 = choose(going, x2 - (step1 * e2 + step2 * e1), x2)
    # derivatives by ln p, s (2), Y (2), S_i: direct ones of <N>, <N e>, of A at fixed a_c, then those through X_1
    by_gain = with_initial_fabric(m_g, q1, q2)
    by_x0 = with_initial_fabric((m_x[0], m_x[1], m_x[2]), q1, q2)
    a_by_s, a_by_x0 = carried_force_by_stress(f1, f2, a1, a2, mu, margin, turned(t_by_s, e1, e2), turn(t_by_x0, e1, e2))
    if not closure.frictional:
        a_by_s, a_by_x0 = (c_n, 0.0 * c_n, 0.0 * c_n, c_n), (0.0 * a1, 0.0 * a1)
    spread_by_x0, spread_by_i = c_p * c_p * x0 * inverse_s, irreversible * inverse_s
    solution = (i11, i12, i21, i22)
    fabric = (n0, a1, a2, m11, m12, m21, m22)
    through = (t11, t12, t21, t22)
    none = 0.0 * n0
    nothing = (none, none, none)
    pressure = (
        gain * by_gain[0] + x0_by_p * (by_x0[0] + by_spread[0] * spread_by_x0),
        gain * by_gain[1] + x0_by_p * (by_x0[1] + by_spread[1] * spread_by_x0),
        gain * by_gain[2] + x0_by_p * (by_x0[2] + by_spread[2] * spread_by_x0),
    )
    forces = (a_by_x0[0] * x0_by_p, a_by_x0[1] * x0_by_p)
    z_p, a1_p, a2_p = _change(pressure, forces, solution, fabric, through, chi, along, across)
    forces = (a_by_s[0], a_by_s[2])
    z_s1, a1_s1, a2_s1 = _change(nothing, forces, solution, fabric, through, chi, along, across)
    forces = (a_by_s[1], a_by_s[3])
    z_s2, a1_s2, a2_s2 = _change(nothing, forces, solution, fabric, through, chi, along, across)
    spreading = (by_spread[0] * spread_by_i, by_spread[1] * spread_by_i, by_spread[2] * spread_by_i)
    z_i, a1_i, a2_i = _change(spreading, (none, none), solution, fabric, through, chi, along, across)
    z_y1, z_y2 = along[0] * i11 + across[0] * i21, along[0] * i12 + across[0] * i22
    a1_y1, a1_y2 = m11 * i11 + m12 * i21, m11 * i12 + m12 * i22
    a2_y1, a2_y2 = m21 * i11 + m22 * i21, m21 * i12 + m22 * i22
    # the last step, to first order
    size -= step1
    n0 -= along[0] * step1 + across[0] * step2
    a1 -= m11 * step1 + m12 * step2
    a2 -= m21 * step1 + m22 * step2
    (b1, b2), mu, _, _ = carried_force(f1, f2, a1, a2, t1, t2)
    if not closure.frictional:
        b1, b2 = normal[0] * e1 + normal[1] * e2 + a1, normal[1] * e1 - normal[0] * e2 + a2
        mu = 1.0 + 0.0 * a1
    # the mean force is p/(z mu): it pushes
    found = found & (mu > 0.0)
    # back to the fixed axes
    z0 = origin[0]
    back = (e1, -e2)
    c1, c2 = turn((a1, a2), *back)
    network = (z0 * n0, c1, c2, size * e1 + step2 * e2, size * e2 - step2 * e1)
    z_s, z_y = turn((z_s1, z_s2), *back), turn((z_y1, z_y2), *back)
    c_p1, c_p2 = turn((a1_p, a2_p), *back)
    c_i1, c_i2 = turn((a1_i, a2_i), *back)
    s11, s12, s21, s22 = turned_pair((a1_s1, a1_s2, a2_s1, a2_s2), e1, e2)
    y11, y12, y21, y22 = turned_pair((a1_y1, a1_y2, a2_y1, a2_y2), e1, e2)
    changes = (
        (z0 * z_p, z0 * z_s[0], z0 * z_s[1], z0 * z_y[0], z0 * z_y[1], z0 * z_i),
        (c_p1, s11, s12, y11, y12, c_i1),
        (c_p2, s21, s22, y21, y22, c_i2),
    )
    b1, b2 = turn((b1, b2), *back)
    return found, network, changes, (b1, b2, mu, t[0], t[1])


@formula
def _change(direct, force, solution, fabric, through, chi, along, across):
    """Derivatives of <N>, a_c by an input: from the direct ones of <N>, <N e> and those of A at fixed a_c."""
    n0, a1, a2, m11, m12, m21, m22 = fabric
    t11, t12, t21, t22 = through
    d1, d2 = fabric_change(direct, n0, a1, a2)
    r1, r2 = chi * (force[0] + t11 * d1 + t12 * d2), chi * (force[1] + t21 * d1 + t22 * d2)
    v1, v2 = solution[0] * r1 + solution[1] * r2, solution[2] * r1 + solution[3] * r2
    return direct[0] + along[0] * v1 + across[0] * v2, d1 + m11 * v1 + m12 * v2, d2 + m21 * v1 + m22 * v2


@formula
def turn(v, e1, e2):
    """Components of a vector in the frame whose first axis is (e1, e2)."""
    return v[0] * e1 + v[1] * e2, v[1] * e1 - v[0] * e2


@formula
def turned(m, e1, e2):
    """A symmetric matrix (11, 12, 22) in the frame whose first axis is (e1, e2)."""
    m11, m12, m22 = m
    x1, x2 = m11 * e1 + m12 * e2, m12 * e1 + m22 * e2
    y1, y2 = m12 * e1 - m11 * e2, m22 * e1 - m12 * e2
    return x1 * e1 + x2 * e2, x2 * e1 - x1 * e2, y2 * e1 - y1 * e2


@formula
def turned_pair(m, e1, e2):
    """A matrix (11, 12, 21, 22) from the frame whose first axis is (e1, e2) back to the fixed one."""
    m11, m12, m21, m22 = m
    x11, x21 = m11 * e1 - m21 * e2, m11 * e2 + m21 * e1
    x12, x22 = m12 * e1 - m22 * e2, m12 * e2 + m22 * e1
    return x11 * e1 - x12 * e2, x11 * e2 + x12 * e1, x21 * e1 - x22 * e2, x21 * e2 + x22 * e1


@formula
def contacts_towards(origin, p0, c_e, c_p, state, c, t):
    """N in the direction (c, t); `state` is X_0, X_1 (2), S_i, g."""
    x0, x1, x2, irreversible, gain = state
    s = spread_of(x0, math.sqrt(x1 * x1 + x2 * x2), irreversible, c_e, c_p)
    value = logarithm(p0, gain, x0 + x1 * c + x2 * t, s)[0]
    return (1.0 + origin[1] * c + origin[2] * t) * exponential(value)


@formula
def split_change(origin, p0, c_e, c_p, start, end, cosines, sines):
    """What an increment gained and lost (z, a_c1, a_c2 each), split by the sign of the change of N in each direction.

    With N the contacts and <N> their mean at the end, ``da_c = (2 <dN e> - a_c(start) <dN>)/<N>`` is exact and linear
    in dN, so that start + gained - lost = end. The sign makes a kink, which directions resolve slowly: the
    split, not the sum, is good to some 1e-5 of itself.
    """
    share = 1.0 / cosines.shape[0]
    zero = 0.0 * origin[0]
    g0, g1, g2, d0, d1, d2 = zero, zero, zero, zero, zero, zero
    before, before1, before2 = zero, zero, zero
    for i in range(cosines.shape[0]):
        c, t = cosines[i], sines[i]
        n_start = contacts_towards(origin, p0, c_e, c_p, start, c, t)
        change = contacts_towards(origin, p0, c_e, c_p, end, c, t) - n_start
        before += n_start
        before1 += n_start * c
        before2 += n_start * t
        d0 += change
        d1 += change * c
        d2 += change * t
        change = choose(change > 0.0, change, 0.0)
        g0 += change
        g1 += change * c
        g2 += change * t
    inverse, after = 1.0 / before, 1.0 / (before + d0)
    a1, a2 = 2.0 * before1 * inverse, 2.0 * before2 * inverse
    l0, l1, l2 = g0 - d0, g1 - d1, g2 - d2
    z = origin[0] * share
    gained = (z * g0, (2.0 * g1 - a1 * g0) * after, (2.0 * g2 - a2 * g0) * after)
    return gained, (z * l0, (2.0 * l1 - a1 * l0) * after, (2.0 * l2 - a2 * l0) * after)
