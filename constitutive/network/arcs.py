"""Moments of directions over the arc on which contacts are lost, in closed form.

All angles here are double angles, y = 2 theta measured from the direction of the normal-force anisotropy a_n, so that
the mean normal force in direction y is proportional to ``H(y) = 1 + a cos y`` with ``a = |a_n| < 1``. The mean normal
force falls where ``dF(y) = d + w1 cos y + w2 sin y < 0`` [Pouragha & Wan 2017, eq. 9]: on an arc centred opposite to
w, of half-width U = arccos(d/|w|). The complement is the arc of gain.

Needed are, over the arc of loss,

    C_k  = int cos^k dy            K_k  = int sin cos^k dy
    P1_k = int cos^k / H dy        S1_k = int sin cos^k / H dy
    P2_k = int cos^k / H^2 dy      S2_k = int sin cos^k / H^2 dy

from which every higher power of the sine follows by sin^2 = 1 - cos^2.
"""

import math

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import choose, somewhere
from granfabric.constitutive.lanes.elementary import angle_at_distance, larger, log_of_ratio

SMALL_ANISOTROPY = 0.08
"""Below this a, recursions in 1/a would lose 1/a^4 in accuracy; a downward recursion from a power series does not."""

SERIES_TERMS = 14
"""0.08^14 is rounding."""


@formula
def arc_of_loss(d, w1, w2):
    """Arc on which d + w.e < 0.

    Parameters
    ----------
    d, w1, w2 : float
        Mean and second harmonic of the relative change of the mean normal force.

    Returns
    -------
    kappa, sine, cosine_centre, sine_centre : float
        Cosine and sine of the half-width U in [0, pi], and direction of the arc's centre, opposite to w. No loss
        (d >= |w|) gives U = 0, loss everywhere (d <= -|w|) U = pi. If both d and w vanish there is no loss.
    """
    magnitude = math.sqrt(w1 * w1 + w2 * w2)
    positive = magnitude > 0.0
    inverse = 1.0 / choose(positive, magnitude, 1.0)
    # (|w| - d)(|w| + d) keeps all digits of the sine when |d| comes close to |w|
    sine = math.sqrt(larger((magnitude - d) * (magnitude + d), 0.0)) * inverse
    kappa = choose(d <= -magnitude, -1.0, d * inverse)
    kappa = choose(d >= magnitude, 1.0, kappa)
    return kappa, sine, choose(positive, -w1 * inverse, 1.0), -w2 * inverse


@formula
def loss_moments(a, d, w1, w2, second):
    """Moments over the arc of loss.

    Parameters
    ----------
    a : float
        |a_n| < 1.
    d, w1, w2 : float
        Relative force change in the frame of a_n.
    second : bool
        Whether moments with H^2 are wanted.

    Returns
    -------
    C, K, P1, S1, P2, S2 : tuples of 4, 3, 4, 3, 5 and 4 floats
        The last two are zeros if not wanted.
    """
    kappa, sine, cf, sf = arc_of_loss(d, w1, w2)
    half = angle_at_distance(sine, kappa, 1.0)
    # ends of the arc by addition of angles
    c2, s2 = cf * kappa - sf * sine, sf * kappa + cf * sine
    c1, s1 = cf * kappa + sf * sine, sf * kappa - cf * sine
    m0 = 2.0 * half
    m1 = 2.0 * cf * sine
    m2 = half + 0.5 * (c2 * s2 - c1 * s1)
    m3 = (c2 * c2 * s2 - c1 * c1 * s1 + 2.0 * m1) * (1.0 / 3.0)
    # factored, so that an arc symmetric about a_n gives exact zeros however products are rounded
    drop = c1 - c2
    k0 = 2.0 * sf * sine
    k1 = 0.5 * drop * (c1 + c2)
    k2 = drop * (c1 * c1 + c1 * c2 + c2 * c2) * (1.0 / 3.0)
    moments, sines = (m0, m1, m2, m3), (k0, k1, k2)
    # closed form, upwards; where a is small it is replaced below, until then only kept finite
    large = a > SMALL_ANISOTROPY
    safe = choose(large, a, 0.5)
    inverse = 1.0 / safe
    square = (1.0 - safe) * (1.0 + safe)
    root = math.sqrt(square)
    h1, h2 = 1.0 + safe * c1, 1.0 + safe * c2
    steep = 1.0 / root
    p0 = 2.0 * steep * angle_at_distance(sine * root, kappa + safe * cf, math.sqrt(h1 * h2))
    p1 = (m0 - p0) * inverse
    p2 = (m1 - p1) * inverse
    p3 = (m2 - p2) * inverse
    q0 = inverse * log_of_ratio(h1, h2)
    q1 = (k0 - q0) * inverse
    q2 = (k1 - q1) * inverse
    zero = 0.0 * a
    r0, r1, r2, r3, r4, t0, t1, t2, t3 = zero, zero, zero, zero, zero, zero, zero, zero, zero
    if second:
        both = 1.0 / (h1 * h2)
        i1, i2 = h2 * both, h1 * both
        r0 = (p0 - safe * (s2 * i2 - s1 * i1)) * (steep * steep)
        r1 = (p0 - r0) * inverse
        r2 = (p1 - r1) * inverse
        r3 = (p2 - r2) * inverse
        r4 = (p3 - r3) * inverse
        t0 = drop * both
        t1 = (q0 - t0) * inverse
        t2 = (q1 - t1) * inverse
        t3 = (q2 - t2) * inverse
    if somewhere(a <= SMALL_ANISOTROPY):
        # downwards from the highest order: P1_{k-1} = C_{k-1} - a P1_k, and likewise the others, multiply errors by a
        p, q, r, t = _highest_moments(choose(large, 0.0, a), c1, s1, c2, s2, m2, m3)
        p3, q2 = choose(large, p3, p), choose(large, q2, q)
        p2 = choose(large, p2, m2 - a * p3)
        p1 = choose(large, p1, m1 - a * p2)
        p0 = choose(large, p0, m0 - a * p1)
        q1 = choose(large, q1, k1 - a * q2)
        q0 = choose(large, q0, k0 - a * q1)
        if second:
            r4, t3 = choose(large, r4, r), choose(large, t3, t)
            r3 = choose(large, r3, p3 - a * r4)
            r2 = choose(large, r2, p2 - a * r3)
            r1 = choose(large, r1, p1 - a * r2)
            r0 = choose(large, r0, p0 - a * r1)
            t2 = choose(large, t2, q2 - a * t3)
            t1 = choose(large, t1, q1 - a * t2)
            t0 = choose(large, t0, q0 - a * t1)
    return moments, sines, (p0, p1, p2, p3), (q0, q1, q2), (r0, r1, r2, r3, r4), (t0, t1, t2, t3)


@formula
def _highest_moments(a, c1, s1, c2, s2, before, now):
    """P1_3, S1_2, P2_4, S2_3 for a small a, by 1/H = sum (-a cos y)^j; `before` and `now` are C_2 and C_3."""
    power1, power2 = c1 * c1 * c1, c2 * c2 * c2
    zero = 0.0 * a
    factor, p, q, r, t = 1.0 + zero, zero, zero, zero, zero
    for j in range(SERIES_TERMS):
        # C_{k+1}, and K_{k-1} = (c1^k - c2^k)/k, K_k, for k = 3 + j
        k, order = 3.0 + j, 1.0 + j
        by_next = 1.0 / (k + 1.0)
        after = (power2 * s2 - power1 * s1 + k * before) * by_next
        low = (power1 - power2) * (1.0 / k)
        power1, power2 = power1 * c1, power2 * c2
        p += factor * now
        q += factor * low
        r += factor * order * after
        t += factor * order * ((power1 - power2) * by_next)
        before, now = now, after
        factor = -factor * a
    return p, q, r, t
