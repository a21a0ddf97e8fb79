"""Rates of contact loss and gain of the mean-field closure, with their derivatives [Pouragha & Wan 2017, eqs 9-13].

With phi = (1, cos 2 theta, sin 2 theta), v = (d, w1, w2) so that the relative change of the mean normal force is
``dF = v.phi``, contact density W and force shape H = 1 + a_n.e, the averages over all directions

    loss_i = < W max(-dF, 0)/H phi_i >        gain_i = < W max(dF, 0) phi_i >          i = 0, 1, 2

are all that the bookkeeping needs; the factors P0 and beta P_xi0 f/(2 kn r) multiply them later. Boundary terms vanish
in the derivatives, because the integrands do so at the ends of the arcs.
"""

import math

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.lanes.layout import (
    BY_A,
    BY_N,
    BY_V,
    COS,
    F_A1,
    F_A2,
    F_N,
    F_V1,
    F_V2,
    KERNEL_OPTIONS,
    LANES,
    N1,
    N2,
    P1,
    P2,
    S1M,
    S2M,
    SIN,
    TRIAL_A1,
    TRIAL_A2,
    V1,
    V2,
    VALUE,
    C,
    D,
    K,
    L,
)

from .arcs import loss_moments

LARGEST_FORCE_ANISOTROPY = 0.98
"""|a_n| beyond which H is evaluated at this magnitude: the mean force may not vanish in any direction."""

_AVERAGE = 1.0 / (2.0 * math.pi)


@compiled(inline="always", **KERNEL_OPTIONS)
def closed_form_change(w, loss, gain, derivatives):
    """Loss and gain for the harmonic density W = 1 + a_c.e (|a_c| <= 1) over the exact arcs, in every lane.

    Reads rows D, V1, V2 (dF), TRIAL_A1, TRIAL_A2 (a_c), N1, N2 (a_n); writes VALUE (loss_i, gain_i) and, if
    `derivatives`, BY_V (by d, w1, w2), BY_A (by a_c), BY_N (loss only, by a_n at fixed dF).
    """
    _turn_to_force_anisotropy(w)
    loss_moments(w, loss and derivatives)
    if loss:
        _loss(w, derivatives)
        if derivatives:
            _loss_by_force_anisotropy(w)
    if gain:
        _gain(w, derivatives)


@compiled(**KERNEL_OPTIONS)
def _turn_to_force_anisotropy(w):
    """dF and a_c in the frame of a_n."""
    for lane in range(LANES):
        n1, n2 = w[N1 + lane], w[N2 + lane]
        a = math.sqrt(n1 * n1 + n2 * n2)
        any_direction = a == 0.0
        inverse = 1.0 / (1.0 if any_direction else a)
        ct, st = (1.0 if any_direction else n1 * inverse), n2 * inverse
        v1, v2 = w[V1 + lane], w[V2 + lane]
        q1, q2 = w[TRIAL_A1 + lane], w[TRIAL_A2 + lane]
        w[COS + lane] = ct
        w[SIN + lane] = st
        w[F_N + lane] = a
        w[F_V1 + lane] = ct * v1 + st * v2
        w[F_V2 + lane] = ct * v2 - st * v1
        w[F_A1 + lane] = ct * q1 + st * q2
        w[F_A2 + lane] = ct * q2 - st * q1


@compiled(**KERNEL_OPTIONS)
def _loss(w, derivatives):
    for lane in range(LANES):
        t00, t10, t20, t30 = w[P1 + lane], w[P1 + L + lane], w[P1 + 2 * L + lane], w[P1 + 3 * L + lane]
        t01, t11, t21 = w[S1M + lane], w[S1M + L + lane], w[S1M + 2 * L + lane]
        _project(w, lane, 0, -_AVERAGE, derivatives, t00, t10, t20, t30, t01, t11, t21)


@compiled(**KERNEL_OPTIONS)
def _gain(w, derivatives):
    for lane in range(LANES):
        # the arc of gain is the complement of the arc of loss
        t00, t10 = 2.0 * math.pi - w[C + lane], -w[C + L + lane]
        t20, t30 = math.pi - w[C + 2 * L + lane], -w[C + 3 * L + lane]
        t01, t11, t21 = -w[K + lane], -w[K + L + lane], -w[K + 2 * L + lane]
        _project(w, lane, 1, _AVERAGE, derivatives, t00, t10, t20, t30, t01, t11, t21)


@compiled(inline="always", **KERNEL_OPTIONS)
def _project(w, lane, row, factor, derivatives, t00, t10, t20, t30, t01, t11, t21):
    """Values and derivatives of ``factor int W (v.phi) phi_i`` from moments t_ij of cos^i sin^j, in fixed axes."""
    t02, t12, t03 = t00 - t20, t10 - t30, t01 - t21
    d, w1, w2 = w[D + lane], w[F_V1 + lane], w[F_V2 + lane]
    f1, f2 = w[F_A1 + lane], w[F_A2 + lane]
    ct, st = w[COS + lane], w[SIN + lane]
    # int W phi_i phi_j
    w00 = t00 + f1 * t10 + f2 * t01
    w10 = t10 + f1 * t20 + f2 * t11
    w01 = t01 + f1 * t11 + f2 * t02
    w20 = t20 + f1 * t30 + f2 * t21
    w11 = t11 + f1 * t21 + f2 * t12
    w02 = t02 + f1 * t12 + f2 * t03
    l0 = d * w00 + w1 * w10 + w2 * w01
    l1 = d * w10 + w1 * w20 + w2 * w11
    l2 = d * w01 + w1 * w11 + w2 * w02
    value = VALUE + row * 3 * L + lane
    w[value] = factor * l0
    w[value + L] = factor * (ct * l1 - st * l2)
    w[value + 2 * L] = factor * (st * l1 + ct * l2)
    if derivatives:
        cc, ss, cs = ct * ct, st * st, ct * st
        x, y = factor * (ct * w10 - st * w01), factor * (st * w10 + ct * w01)
        by = BY_V + row * 9 * L + lane
        off = factor * (cs * (w20 - w02) + (cc - ss) * w11)
        w[by] = factor * w00
        w[by + L] = x
        w[by + 2 * L] = y
        w[by + 3 * L] = x
        w[by + 4 * L] = factor * (cc * w20 + ss * w02 - 2.0 * cs * w11)
        w[by + 5 * L] = off
        w[by + 6 * L] = y
        w[by + 7 * L] = off
        w[by + 8 * L] = factor * (ss * w20 + cc * w02 + 2.0 * cs * w11)
        # int (v.phi) phi_i e_j
        b10 = d * t10 + w1 * t20 + w2 * t11
        b01 = d * t01 + w1 * t11 + w2 * t02
        b20 = d * t20 + w1 * t30 + w2 * t21
        b11 = d * t11 + w1 * t21 + w2 * t12
        b02 = d * t02 + w1 * t12 + w2 * t03
        off = factor * (cs * (b20 - b02) + (cc - ss) * b11)
        by = BY_A + row * 6 * L + lane
        w[by] = factor * (ct * b10 - st * b01)
        w[by + L] = factor * (st * b10 + ct * b01)
        w[by + 2 * L] = factor * (cc * b20 + ss * b02 - 2.0 * cs * b11)
        w[by + 3 * L] = off
        w[by + 4 * L] = off
        w[by + 5 * L] = factor * (ss * b20 + cc * b02 + 2.0 * cs * b11)


@compiled(**KERNEL_OPTIONS)
def _loss_by_force_anisotropy(w):
    """d loss_i/d a_n at fixed dF: int W dF/H^2 phi_i e_j over the arc of loss."""
    for lane in range(LANES):
        d, w1, w2 = w[D + lane], w[F_V1 + lane], w[F_V2 + lane]
        f1, f2 = w[F_A1 + lane], w[F_A2 + lane]
        ct, st = w[COS + lane], w[SIN + lane]
        # (1 + a_c.e)(d + w.e) = r00 + r10 c + r01 s + r20 c^2 + r11 c s + r02 s^2
        r00, r10, r01 = d, w1 + f1 * d, w2 + f2 * d
        r20, r11, r02 = f1 * w1, f1 * w2 + f2 * w1, f2 * w2
        u00, u10, u20 = w[P2 + lane], w[P2 + L + lane], w[P2 + 2 * L + lane]
        u30, u40 = w[P2 + 3 * L + lane], w[P2 + 4 * L + lane]
        u01, u11, u21, u31 = w[S2M + lane], w[S2M + L + lane], w[S2M + 2 * L + lane], w[S2M + 3 * L + lane]
        u02, u12, u22 = u00 - u20, u10 - u30, u20 - u40
        u03, u13 = u01 - u21, u11 - u31
        u04 = u02 - u22
        n10 = r00 * u10 + r10 * u20 + r01 * u11 + r20 * u30 + r11 * u21 + r02 * u12
        n01 = r00 * u01 + r10 * u11 + r01 * u02 + r20 * u21 + r11 * u12 + r02 * u03
        n20 = r00 * u20 + r10 * u30 + r01 * u21 + r20 * u40 + r11 * u31 + r02 * u22
        n11 = r00 * u11 + r10 * u21 + r01 * u12 + r20 * u31 + r11 * u22 + r02 * u13
        n02 = r00 * u02 + r10 * u12 + r01 * u03 + r20 * u22 + r11 * u13 + r02 * u04
        cc, ss, cs = ct * ct, st * st, ct * st
        off = _AVERAGE * (cs * (n20 - n02) + (cc - ss) * n11)
        w[BY_N + lane] = _AVERAGE * (ct * n10 - st * n01)
        w[BY_N + L + lane] = _AVERAGE * (st * n10 + ct * n01)
        w[BY_N + 2 * L + lane] = _AVERAGE * (cc * n20 + ss * n02 - 2.0 * cs * n11)
        w[BY_N + 3 * L + lane] = off
        w[BY_N + 4 * L + lane] = off
        w[BY_N + 5 * L + lane] = _AVERAGE * (ss * n20 + cc * n02 + 2.0 * cs * n11)
