"""Closure by the distribution of weak-contact forces itself [model, sections 5.3 and 11].

Forces of the contacts of a direction start with a density that is a straight line above zero, P0 + P0' F, in units of
the mean force f_0 of the packing at its reference pressure p_0. Loading shifts and stretches them; what has moved below
zero is lost. With P = p/p_0, in units of f_0 throughout:

    D_0 = chi_p (P - 1) / max(P, 1)^a,    D_1 = P X_1 / P^a,    X_1 = chi A + V/p,    A = a_n + a_c  (`force_fabric`)
    lambda(D) = P0 E[max(-D, 0)] + P0'/2 E[max(-D, 0)^2]      (a falling line ends where it is zero)
    Lambda(theta) = phi lambda(D_0 + D_1.e/phi) + (1 - phi) lambda(D_0),      phi = chi, within [0.1, 1]
    N(theta) = (1 + a_c(0).e) exp(-Lambda - Lambda^2/2) [1 + beta (1 - exp(-g G))],    G = E[max(D, 0)] + R
    z = z(0) <N>,    a_c = 2 <N e>/<N>,    g = P_xi0 f_0/(2 kn r),    beta = (z_nb - z(0))/z(0)
    R = chi_p (P - 1) (1 - P^-a) where P > 1, else 0
    S^2 = (c_e |D_1|)^2 + (c_p D_0)^2 + (P^(1-a) S_i m/(m + L))^2,   expectations over S
    S_i = c_i m^2,    m = max |s|,    L as in `tangential_force`

Forces are counted in units of the initial mean force because that is what the density P0 is known for: when the
pressure has fallen to half, forces have come closer to zero by half of that mean, not by all of the present one. What a
shift reaches by then has been pushed together by the pressure, or spread by a higher one: stronger contacts feel more
of its change, so that weak forces are stretched by P^a, with a measured as their response grows with the force. Where
the pressure rises everything that shifts them is reached through that stretch. Where it falls, contacts that come
close to opening feel less and less of the change, and the isotropic loss stays in proportion to it. What slip leaves
behind is delayed by a grown pressure as slip itself is, by L. The fraction phi of weak contacts follows the mean change
of their direction; the others, on particles with three contacts mostly, do not feel the direction at all. V = p Y is
what the packing carried before anything was loaded, ``-chi p_0 A_0``, and stays: the force that all initial contacts of
a direction carry is p (1 + A.e), by the stress. So z and a_c are functions of stress and of the largest |s|, whatever
the path.

A density loses exactly the fraction Lambda; ``exp(-Lambda - Lambda^2/2)`` is that up to the third order and stays
positive. Of the pairs of neighbours that are still open, (z_nb - z)/z a contact, the same fraction closes at every step
[eq. 13], so that those left open decay and z never exceeds the number of neighbours. X_1 follows from the stress by two
equations, because A depends on a_c. N > 0 makes z > 0, |a_c| < 2. Gaps close by displacements, which nothing
stretches: R is what the stretch has taken off D_0.

The averages < > are taken in the frame of X_1, in which D depends on the cosine alone: half of the directions do.
"""

import math

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import choose, somewhere
from granfabric.constitutive.lanes.elementary import exponential

from .force_fabric import LEAST_MARGIN, carried_force, carried_force_by_stress, tangential_force
from .slip_memory import with_memory
from .tangential_force import slip_numbers
from .weak_forces import lost_and_gained

MOST_ITERATIONS = 50
STEP_TOLERANCE = 1e-8
"""Newton step of X_1 that is the last one: what it leaves is of its square, and it is carried on to z and a_c."""


@formula
def kept(lost):
    """What is left of the contacts of a direction."""
    return exponential(-lost - 0.5 * lost * lost)


@formula
def grown(above, gain):
    """Factor by which gained contacts multiply N, and its relative derivative by G; `gain` is g, beta, R."""
    factor, relative = 1.0 + 0.0 * above, 0.0 * above
    rate, room, rest = gain
    if somewhere(room > 0.0):
        still = room * exponential(-rate * (above + rest))
        factor += room - still
        relative = rate * still / factor
    return factor, relative


@formula
def spread_of(shift, reach, irreversible, c_e, c_p):
    """S of D_0, |D_1| and the irreversible part."""
    return math.sqrt(irreversible * irreversible + c_e * c_e * reach * reach + c_p * c_p * shift * shift)


@formula
def resting_part(following, density, shift, s):
    """Lost and gained of the contacts that do not feel the direction, with derivatives by D_0 and S."""
    lost, lost_x, lost_s, above, above_x, above_s = lost_and_gained(density[0], density[1], shift, s)
    rest = 1.0 - following
    return rest * lost, rest * lost_x, rest * lost_s, rest * above, rest * above_x, rest * above_s


@formula
def moments_along(shift, reach, s, density, gain, following, cosines):
    """Averages over directions of M = N/(1 + a_c(0).e) and of its derivatives, times powers of the cosine c to X_1.

    Parameters
    ----------
    shift, reach, s : float
        D_0, |D_1| and S.
    density : tuple of 2 floats
        P0 and P0'.
    gain : tuple of 3 floats
        g, beta and R.
    following : float
        phi.
    cosines : ndarray, shape (directions/2,)
        Of directions equally spaced over half of the circle.

    Returns
    -------
    number : tuple of 3 floats
        <M>, <M c>, <M c^2>.
    by_reach : tuple of 4
        The same for M times the derivative of ln M by D_1.e, up to c^3.
    by_shift, by_s, by_rest : tuples of 3
        The same for the derivatives by D_0, S and R, up to c^2.
    """
    weight = 1.0 / cosines.shape[0]
    zero = 0.0 * shift
    m0, m1, m2, x_0, x_1, x_2, x_3 = zero, zero, zero, zero, zero, zero, zero
    s_0, s_1, s_2, d_0, d_1, d_2 = zero, zero, zero, zero, zero, zero
    r_0, r_1, r_2 = zero, zero, zero
    rest, rest_x, rest_s, rest_above, rest_above_x, rest_above_s = resting_part(following, density, shift, s)
    far = reach / following
    for i in range(cosines.shape[0]):
        c = cosines[i]
        lost, lost_x, lost_s, above, above_x, above_s = lost_and_gained(density[0], density[1], shift + far * c, s)
        lost = following * lost + rest
        more, gaining = grown(following * above + rest_above, gain)
        m = kept(lost) * more * weight
        factor = -(1.0 + lost)
        by_x = factor * lost_x + gaining * above_x
        by_d = following * by_x + factor * rest_x + gaining * rest_above_x
        by_s = factor * (following * lost_s + rest_s) + gaining * (following * above_s + rest_above_s)
        m0 += m
        m1 += m * c
        m2 += m * (c * c)
        by_x, by_d, by_s = by_x * m, by_d * m, by_s * m
        x_0 += by_x
        x_1 += by_x * c
        x_2 += by_x * (c * c)
        x_3 += by_x * (c * c * c)
        d_0 += by_d
        d_1 += by_d * c
        d_2 += by_d * (c * c)
        s_0 += by_s
        s_1 += by_s * c
        s_2 += by_s * (c * c)
        gaining = gaining * m
        r_0 += gaining
        r_1 += gaining * c
        r_2 += gaining * (c * c)
    return (m0, m1, m2), (x_0, x_1, x_2, x_3), (d_0, d_1, d_2), (s_0, s_1, s_2), (r_0, r_1, r_2)


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
def network_of(
    weak, irreversible, stress_ratio, y, guess, origin, density, normal, c_n, closure, start, rule, inputs, lanes
):
    """Coordination number and fabric of a state, with derivatives.

    Parameters
    ----------
    weak : WeakState
        What the pressure does.
    irreversible : float
        S_i m/(m + L).
    stress_ratio, y : tuples of 2 floats
        s and Y = V/p.
    guess : tuple of 2 floats
        a_c, about.
    origin : tuple of 3 floats
        z, a_c of the initial packing.
    density : tuple of 2 floats
        P0 and P0'; 0 if nothing is lost.
    normal : tuple of 2 floats
        a_n, if it follows from s alone, and c_n its derivative by s.
    closure : closures.ShiftedDistribution
    start, rule, inputs, lanes :
        Entries 4 and 5 of the rule are the cosines of `moments_along` and slip classes; the others see
        `slip_memory.with_memory`.

    Returns
    -------
    found : bool
        False if there is no X_1, or the mean force would pull.
    network : tuple of 5 floats
        z, a_c (2), X_1 (2).
    changes : tuple of 3 tuples of 6 floats
        Derivatives of z, a_c1, a_c2 by ln p, s (2), Y (2), `irreversible`.
    force : tuple of 5 floats
        A (2), mu, a_t (2).
    """
    shift, stretch, gain = weak.shift, weak.stretch, (weak.gain, weak.room, weak.closing)
    s1, s2 = stress_ratio
    chi, c_e, c_p, following = closure.chi, closure.c_e, closure.c_p, closure.following
    numbers, numbers_by_p = slip_numbers(closure, weak, density[0])
    t, t_by_s, t_by_p = tangential_force(s1, s2, numbers, numbers_by_p)
    if not closure.frictional:
        t = (2.0 * s1 - guess[0] - normal[0], 2.0 * s2 - guess[1] - normal[1])
    carried, _, _, margin = carried_force(s1, s2, guess[0], guess[1], t[0], t[1])
    if not closure.frictional:
        carried = (normal[0] + guess[0], normal[1] + guess[1])
    x1, x2 = y[0] + chi * carried[0], y[1] + chi * carried[1]
    usable = (abs(x1) < 1e6) & (abs(x2) < 1e6)
    x1, x2 = choose(usable, x1, y[0]), choose(usable, x2, y[1])
    found = abs(x1) + abs(x2) < 1e6
    skew = 0.0 * s1
    if closure.remembers:
        first = (t, t_by_s, t_by_p)
        t, t_by_s, skew, t_by_p = with_memory(
            weak, s1, s2, first, numbers, numbers_by_p, start, rule[5], inputs, lanes
        )
    iteration = 0
    while True:
        size = math.sqrt(x1 * x1 + x2 * x2)
        inverse = 1.0 / choose(size > 0.0, size, 1.0)
        # the frame of X_1: (e1, e2) along it
        e1, e2 = choose(size > 0.0, x1 * inverse, 1.0), x2 * inverse
        q1, q2 = origin[1] * e1 + origin[2] * e2, origin[2] * e1 - origin[1] * e2
        reach = stretch * size
        spread = spread_of(shift, reach, stretch * irreversible, c_e, c_p)
        number, m_x, m_d, m_s, m_r = moments_along(shift, reach, spread, density, gain, following, rule[4])
        n0, n1, n2 = with_initial_fabric(number, q1, q2)
        a1, a2 = 2.0 * n1 / n0, 2.0 * n2 / n0
        by_spread = with_initial_fabric(m_s, q1, q2)
        inverse_s = 1.0 / choose(spread > 0.0, spread, 1e300)
        radial = c_e * c_e * stretch * reach * inverse_s
        outward = (m_x[1] + q1 * m_x[2], m_x[2] + q1 * m_x[3], q2 * (m_x[1] - m_x[3]))
        along = (
            stretch * outward[0] + by_spread[0] * radial,
            stretch * outward[1] + by_spread[1] * radial,
            stretch * outward[2] + by_spread[2] * radial,
        )
        across = (
            stretch * (q2 * (m_x[0] - m_x[2])),
            stretch * (q2 * (m_x[1] - m_x[3])),
            stretch * (m_x[0] - m_x[2] + q1 * (m_x[1] - m_x[3])),
        )
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
    by_shift = with_initial_fabric(m_d, q1, q2)
    by_rest = with_initial_fabric(m_r, q1, q2)
    a_by_s, a_by_p = carried_force_by_stress(
        f1, f2, a1, a2, mu, margin, turned(t_by_s, e1, e2), skew, turn(t_by_p, e1, e2)
    )
    if not closure.frictional:
        a_by_s, a_by_p = (c_n, 0.0 * c_n, 0.0 * c_n, c_n), (0.0 * a1, 0.0 * a1)
    # with ln p everything that is not isotropic is stretched by P^(1-a)
    stretched = (c_e * reach) * (c_e * reach) + (stretch * irreversible) * (stretch * irreversible)
    spread_by_p = (weak.growth * stretched + c_p * c_p * shift * weak.shift_by_p) * inverse_s
    spread_by_i = stretch * stretch * irreversible * inverse_s
    solution = (i11, i12, i21, i22)
    fabric = (n0, a1, a2, m11, m12, m21, m22)
    through = (t11, t12, t21, t22)
    none = 0.0 * n0
    nothing = (none, none, none)
    stretching = weak.growth * reach
    direct = (
        weak.shift_by_p * by_shift[0] + weak.closing_by_p * by_rest[0],
        weak.shift_by_p * by_shift[1] + weak.closing_by_p * by_rest[1],
        weak.shift_by_p * by_shift[2] + weak.closing_by_p * by_rest[2],
    )
    pressure = (
        direct[0] + stretching * outward[0] + by_spread[0] * spread_by_p,
        direct[1] + stretching * outward[1] + by_spread[1] * spread_by_p,
        direct[2] + stretching * outward[2] + by_spread[2] * spread_by_p,
    )
    forces = (a_by_p[0], a_by_p[1])
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
def contacts_towards(origin, density, closure, state, c, t):
    """N in the direction (c, t); `state` is D_0, D_1 (2), the irreversible part of S, and g, beta, R."""
    shift, d1, d2, irreversible, gain = state
    following = closure.following
    s = spread_of(shift, math.sqrt(d1 * d1 + d2 * d2), irreversible, closure.c_e, closure.c_p)
    rest, _, _, rest_above, _, _ = resting_part(following, density, shift, s)
    towards = shift + (d1 * c + d2 * t) / following
    lost, _, _, above, _, _ = lost_and_gained(density[0], density[1], towards, s)
    more, _ = grown(following * above + rest_above, gain)
    return (1.0 + origin[1] * c + origin[2] * t) * kept(following * lost + rest) * more


@formula
def split_change(origin, density, closure, start, end, cosines, sines):
    """What an increment gained and lost (z, a_c1, a_c2 each), split by the sign of the change of N in each direction.

    With N the contacts and <N> their mean at the end, ``da_c = (2 <dN e> - a_c(start) <dN>)/<N>`` is exact and linear
    in dN, so that start + gained - lost = end. The sign makes a kink, which directions resolve slowly: the
    split, not the sum, is good to some 1e-5 of itself.
    """
    weight = 1.0 / cosines.shape[0]
    zero = 0.0 * origin[0]
    g0, g1, g2, d0, d1, d2 = zero, zero, zero, zero, zero, zero
    before, before1, before2 = zero, zero, zero
    for i in range(cosines.shape[0]):
        c, t = cosines[i], sines[i]
        n_start = contacts_towards(origin, density, closure, start, c, t)
        change = contacts_towards(origin, density, closure, end, c, t) - n_start
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
    z = origin[0] * weight
    gained = (z * g0, (2.0 * g1 - a1 * g0) * after, (2.0 * g2 - a2 * g0) * after)
    return gained, (z * l0, (2.0 * l1 - a1 * l0) * after, (2.0 * l2 - a2 * l0) * after)
