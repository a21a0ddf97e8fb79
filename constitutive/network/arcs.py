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

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.lanes.elementary import angle, artanh
from granfabric.constitutive.lanes.layout import (
    ARC_C1,
    ARC_C2,
    ARC_S1,
    ARC_S2,
    F_N,
    F_V1,
    F_V2,
    KERNEL_OPTIONS,
    LANES,
    P1,
    P2,
    S1M,
    S2M,
    SERIES_BEFORE,
    SERIES_FACTOR,
    SERIES_NOW,
    SERIES_POWER1,
    SERIES_POWER2,
    SERIES_SUM,
    C,
    D,
    K,
    L,
)

SMALL_ANISOTROPY = 0.1
"""Below this a, recursions in 1/a would lose 1/a^4 in accuracy; a downward recursion from a power series does not."""

SERIES_TERMS = 18
"""0.1^18 is negligible beside rounding."""


@compiled(**KERNEL_OPTIONS)
def arc_of_loss(d, w1, w2):
    """Arc on which d + w.e < 0, without branches.

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
    inverse = 1.0 / (magnitude if positive else 1.0)
    # (|w| - d)(|w| + d) keeps all digits of the sine when |d| comes close to |w|
    product = (magnitude - d) * (magnitude + d)
    sine = math.sqrt(product if product > 0.0 else 0.0) * inverse
    kappa = d * inverse
    kappa = -1.0 if d <= -magnitude else kappa
    kappa = 1.0 if d >= magnitude else kappa
    return kappa, sine, (-w1 * inverse if positive else 1.0), -w2 * inverse


@compiled(inline="always", **KERNEL_OPTIONS)
def loss_moments(w, derivatives):
    """Moments over the arc of loss, in every lane.

    Reads rows D, F_V1, F_V2 (relative force change in the frame of a_n) and F_N (= |a_n| < 1); writes C, K, P1, S1M
    and, if `derivatives`, P2, S2M.
    """
    small = _first_moments(w)
    if derivatives:
        _second_moments(w)
    if small:
        _from_series(w, derivatives)


@compiled(**KERNEL_OPTIONS)
def _first_moments(w):
    """C, K and, by closed form, P1, S1; returns whether a lane needs the series."""
    for lane in range(LANES):
        a = w[F_N + lane]
        kappa, sine, cf, sf = arc_of_loss(w[D + lane], w[F_V1 + lane], w[F_V2 + lane])
        half = angle(sine, kappa)
        # ends of the arc by addition of angles
        c2, s2 = cf * kappa - sf * sine, sf * kappa + cf * sine
        c1, s1 = cf * kappa + sf * sine, sf * kappa - cf * sine
        moment0 = 2.0 * half
        moment1 = 2.0 * cf * sine
        moment2 = half + 0.5 * (c2 * s2 - c1 * s1)
        moment3 = (c2 * c2 * s2 - c1 * c1 * s1 + 2.0 * moment1) * (1.0 / 3.0)
        sine0 = 2.0 * sf * sine
        # factored, so that an arc symmetric about a_n gives exact zeros whatever the compiler fuses
        drop = c1 - c2
        sine1 = 0.5 * drop * (c1 + c2)
        w[C + lane] = moment0
        w[C + L + lane] = moment1
        w[C + 2 * L + lane] = moment2
        w[C + 3 * L + lane] = moment3
        w[K + lane] = sine0
        w[K + L + lane] = sine1
        w[K + 2 * L + lane] = drop * (c1 * c1 + c1 * c2 + c2 * c2) * (1.0 / 3.0)
        w[ARC_C1 + lane] = c1
        w[ARC_S1 + lane] = s1
        w[ARC_C2 + lane] = c2
        w[ARC_S2 + lane] = s2
        # closed form; where a is small it is replaced below, until then only kept finite
        safe = a if a > SMALL_ANISOTROPY else 1.0
        safe_root = a if a > SMALL_ANISOTROPY else 0.5
        inverse = 1.0 / safe
        root = math.sqrt((1.0 - safe_root) * (1.0 + safe_root))
        h1, h2 = 1.0 + safe_root * c1, 1.0 + safe_root * c2
        p0 = 2.0 / root * angle(sine * root, kappa + safe_root * cf)
        q0 = -2.0 * inverse * artanh(safe_root * (c2 - c1) / (h1 + h2))
        p1 = (moment0 - p0) * inverse
        p2 = (moment1 - p1) * inverse
        p3 = (moment2 - p2) * inverse
        q1 = (sine0 - q0) * inverse
        q2 = (sine1 - q1) * inverse
        w[P1 + lane] = p0
        w[P1 + L + lane] = p1
        w[P1 + 2 * L + lane] = p2
        w[P1 + 3 * L + lane] = p3
        w[S1M + lane] = q0
        w[S1M + L + lane] = q1
        w[S1M + 2 * L + lane] = q2
    small = False
    for lane in range(LANES):
        small = small or w[F_N + lane] <= SMALL_ANISOTROPY
    return small


@compiled(**KERNEL_OPTIONS)
def _second_moments(w):
    """Moments with H^2 from those with H."""
    for lane in range(LANES):
        a = w[F_N + lane]
        a = a if a > SMALL_ANISOTROPY else 0.5
        inverse = 1.0 / a
        c1, s1, c2, s2 = w[ARC_C1 + lane], w[ARC_S1 + lane], w[ARC_C2 + lane], w[ARC_S2 + lane]
        h1, h2 = 1.0 / (1.0 + a * c1), 1.0 / (1.0 + a * c2)
        r0 = (w[P1 + lane] - a * (s2 * h2 - s1 * h1)) / ((1.0 - a) * (1.0 + a))
        r1 = (w[P1 + lane] - r0) * inverse
        r2 = (w[P1 + L + lane] - r1) * inverse
        r3 = (w[P1 + 2 * L + lane] - r2) * inverse
        r4 = (w[P1 + 3 * L + lane] - r3) * inverse
        t0 = (c1 - c2) * (h1 * h2)
        t1 = (w[S1M + lane] - t0) * inverse
        t2 = (w[S1M + L + lane] - t1) * inverse
        t3 = (w[S1M + 2 * L + lane] - t2) * inverse
        w[P2 + lane] = r0
        w[P2 + L + lane] = r1
        w[P2 + 2 * L + lane] = r2
        w[P2 + 3 * L + lane] = r3
        w[P2 + 4 * L + lane] = r4
        w[S2M + lane] = t0
        w[S2M + L + lane] = t1
        w[S2M + 2 * L + lane] = t2
        w[S2M + 3 * L + lane] = t3


@compiled(**KERNEL_OPTIONS)
def _from_series(w, derivatives):
    """Replace the moments of lanes with small a: highest order by 1/H = sum (-a cos y)^j, lower ones downward.

    The downward recursions P1_{k-1} = C_{k-1} - a P1_k (and likewise for S1, P2, S2) multiply errors by a < 1.
    """
    for lane in range(LANES):
        c1, c2 = w[ARC_C1 + lane], w[ARC_C2 + lane]
        w[SERIES_BEFORE + lane] = w[C + 2 * L + lane]
        w[SERIES_NOW + lane] = w[C + 3 * L + lane]
        w[SERIES_POWER1 + lane] = c1 * c1 * c1
        w[SERIES_POWER2 + lane] = c2 * c2 * c2
        w[SERIES_FACTOR + lane] = 1.0
        w[SERIES_SUM + lane] = 0.0
        w[SERIES_SUM + L + lane] = 0.0
        w[SERIES_SUM + 2 * L + lane] = 0.0
        w[SERIES_SUM + 3 * L + lane] = 0.0
    for j in range(SERIES_TERMS):
        # C_{k+1}, and K_{k-1} = (c1^k - c2^k)/k, K_k, for k = 3 + j
        k, order = 3.0 + j, 1.0 + j
        by_k, by_next = 1.0 / k, 1.0 / (k + 1.0)
        for lane in range(LANES):
            power1, power2 = w[SERIES_POWER1 + lane], w[SERIES_POWER2 + lane]
            factor, now = w[SERIES_FACTOR + lane], w[SERIES_NOW + lane]
            ends = power2 * w[ARC_S2 + lane] - power1 * w[ARC_S1 + lane]
            after = (ends + k * w[SERIES_BEFORE + lane]) * by_next
            low = (power1 - power2) * by_k
            power1, power2 = power1 * w[ARC_C1 + lane], power2 * w[ARC_C2 + lane]
            high = (power1 - power2) * by_next
            w[SERIES_SUM + lane] += factor * now
            w[SERIES_SUM + L + lane] += factor * low
            w[SERIES_SUM + 2 * L + lane] += factor * order * after
            w[SERIES_SUM + 3 * L + lane] += factor * order * high
            w[SERIES_BEFORE + lane] = now
            w[SERIES_NOW + lane] = after
            w[SERIES_POWER1 + lane] = power1
            w[SERIES_POWER2 + lane] = power2
            w[SERIES_FACTOR + lane] = -factor * w[F_N + lane]
    for lane in range(LANES):
        a = w[F_N + lane]
        apply = a <= SMALL_ANISOTROPY
        p, q, r, t = (
            w[SERIES_SUM + lane],
            w[SERIES_SUM + L + lane],
            w[SERIES_SUM + 2 * L + lane],
            w[SERIES_SUM + 3 * L + lane],
        )
        p3 = p
        p2 = w[C + 2 * L + lane] - a * p3
        p1 = w[C + L + lane] - a * p2
        p0 = w[C + lane] - a * p1
        q2 = q
        q1 = w[K + L + lane] - a * q2
        q0 = w[K + lane] - a * q1
        w[P1 + lane] = p0 if apply else w[P1 + lane]
        w[P1 + L + lane] = p1 if apply else w[P1 + L + lane]
        w[P1 + 2 * L + lane] = p2 if apply else w[P1 + 2 * L + lane]
        w[P1 + 3 * L + lane] = p3 if apply else w[P1 + 3 * L + lane]
        w[S1M + lane] = q0 if apply else w[S1M + lane]
        w[S1M + L + lane] = q1 if apply else w[S1M + L + lane]
        w[S1M + 2 * L + lane] = q2 if apply else w[S1M + 2 * L + lane]
        if derivatives:
            r4 = r
            r3 = p3 - a * r4
            r2 = p2 - a * r3
            r1 = p1 - a * r2
            r0 = p0 - a * r1
            t3 = t
            t2 = q2 - a * t3
            t1 = q1 - a * t2
            t0 = q0 - a * t1
            w[P2 + lane] = r0 if apply else w[P2 + lane]
            w[P2 + L + lane] = r1 if apply else w[P2 + L + lane]
            w[P2 + 2 * L + lane] = r2 if apply else w[P2 + 2 * L + lane]
            w[P2 + 3 * L + lane] = r3 if apply else w[P2 + 3 * L + lane]
            w[P2 + 4 * L + lane] = r4 if apply else w[P2 + 4 * L + lane]
            w[S2M + lane] = t0 if apply else w[S2M + lane]
            w[S2M + L + lane] = t1 if apply else w[S2M + L + lane]
            w[S2M + 2 * L + lane] = t2 if apply else w[S2M + 2 * L + lane]
            w[S2M + 3 * L + lane] = t3 if apply else w[S2M + 3 * L + lane]
