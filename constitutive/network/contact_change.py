"""Contacts lost and gained in the mean field, in closed form, with derivatives [Pouragha & Wan 2017, eqs 9-13].

With phi = (1, cos 2 theta, sin 2 theta), v = (d, w1, w2) so that the relative change of the mean normal force is
``dF = v.phi``, contact density W and force shape H = 1 + a_n.e, the averages over all directions

    loss_i = < W max(-dF, 0)/H phi_i >        gain_i = < W max(dF, 0) phi_i >          i = 0, 1, 2

are all that the bookkeeping needs: it takes X_i = g gain_i - P0 loss_i with g = beta P_xi0 f/(2 kn r). Boundary terms
vanish in the derivatives, because the integrands do so at the ends of the arcs.

A *change* is what this file, `quadrature_change` and `fluctuating_change` return:

    loss, gain : tuples of 3 floats
    by_v : tuple of 6      derivatives of X by v, symmetric: 00, 01, 02, 11, 12, 22
    by_a : tuple of 6      of X_0, X_1 and X_2 by the components of a_c
    by_n : tuple of 6      likewise by a_n at fixed v
    by_sigma : tuple of 3  of X by the scatter of the change of force
"""

import math

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import choose

from .arcs import loss_moments

LARGEST_FORCE_ANISOTROPY = 0.98
"""|a_n| beyond which H is evaluated at this magnitude: the mean force may not vanish in any direction."""

_AVERAGE = 1.0 / (2.0 * math.pi)


@formula
def closed_form_change(d, w1, w2, a1, a2, n1, n2, g, p0, loss, gain, derivatives):
    """Change for the harmonic density W = 1 + a_c.e (|a_c| <= 1) over the exact arcs.

    Parameters
    ----------
    d, w1, w2 : float
        v.
    a1, a2, n1, n2 : float
        a_c and a_n, |a_n| < 1.
    g, p0 : float
        Factors of gain and loss.
    loss, gain : bool
        Which of them there is.
    derivatives : bool
        Whether those by a_c and a_n are wanted; they are zeros if not.
    """
    a = math.sqrt(n1 * n1 + n2 * n2)
    inverse = 1.0 / choose(a > 0.0, a, 1.0)
    axis = (choose(a > 0.0, n1 * inverse, 1.0), n2 * inverse)
    # dF and a_c in the frame of a_n
    v = (d, axis[0] * w1 + axis[1] * w2, axis[0] * w2 - axis[1] * w1)
    f = (axis[0] * a1 + axis[1] * a2, axis[0] * a2 - axis[1] * a1)
    c, k, p, s, p2, s2 = loss_moments(a, v[0], v[1], v[2], loss and derivatives)
    zero = 0.0 * a
    nothing, nowhere = (zero, zero, zero), (zero, zero, zero, zero, zero, zero)
    lost, won, by_n, t = nothing, nothing, nowhere, (zero, zero, zero, zero, zero, zero, zero)
    if loss:
        lost, t = loss_of(p, s, v, f, axis, p0)
        if derivatives:
            by_n = loss_by_force_anisotropy(p2, s2, v, f, axis, p0)
    if gain:
        won, t = gain_of(c, k, v, f, axis, g, t)
    by_v, by_a = _turned(_with_density(t, f), axis), nowhere
    if derivatives:
        # int (v.phi) phi_i e_j
        t00, t10, t20, t30, t01, t11, t21 = t
        t02, t12, t03 = t00 - t20, t10 - t30, t01 - t21
        products = (
            zero,
            d * t10 + v[1] * t20 + v[2] * t11,
            d * t01 + v[1] * t11 + v[2] * t02,
            d * t20 + v[1] * t30 + v[2] * t21,
            d * t11 + v[1] * t21 + v[2] * t12,
            d * t02 + v[1] * t12 + v[2] * t03,
        )
        _, x, y, xx, xy, yy = _turned(products, axis)
        by_a = (x, y, xx, xy, xy, yy)
    return lost, won, by_v, by_a, by_n, nothing


@formula
def loss_of(p, s, v, f, axis, p0):
    """loss_i, and what it adds to the moments of cos^i sin^j, ij = 00, 10, 20, 30, 01, 11, 21, of X."""
    h = -_AVERAGE
    t = (h * p[0], h * p[1], h * p[2], h * p[3], h * s[0], h * s[1], h * s[2])
    value = _times_v(_with_density(t, f), v, axis)
    h = -p0
    return value, (h * t[0], h * t[1], h * t[2], h * t[3], h * t[4], h * t[5], h * t[6])


@formula
def gain_of(c, k, v, f, axis, g, t):
    """gain_i, and the moments `t` of X with what it adds; the arc of gain is the complement of the arc of loss."""
    h = _AVERAGE
    u = (
        h * (2.0 * math.pi - c[0]),
        -h * c[1],
        h * (math.pi - c[2]),
        -h * c[3],
        -h * k[0],
        -h * k[1],
        -h * k[2],
    )
    value = _times_v(_with_density(u, f), v, axis)
    return value, (
        t[0] + g * u[0],
        t[1] + g * u[1],
        t[2] + g * u[2],
        t[3] + g * u[3],
        t[4] + g * u[4],
        t[5] + g * u[5],
        t[6] + g * u[6],
    )


@formula
def _with_density(t, f):
    """int W phi_i phi_j, ij = 00, 01, 02, 11, 12, 22, from the moments of cos^i sin^j."""
    t00, t10, t20, t30, t01, t11, t21 = t
    t02, t12, t03 = t00 - t20, t10 - t30, t01 - t21
    f1, f2 = f
    return (
        t00 + f1 * t10 + f2 * t01,
        t10 + f1 * t20 + f2 * t11,
        t01 + f1 * t11 + f2 * t02,
        t20 + f1 * t30 + f2 * t21,
        t11 + f1 * t21 + f2 * t12,
        t02 + f1 * t12 + f2 * t03,
    )


@formula
def _times_v(m, v, axis):
    """int W (v.phi) phi_i in the fixed axes."""
    l1, l2 = v[0] * m[1] + v[1] * m[3] + v[2] * m[4], v[0] * m[2] + v[1] * m[4] + v[2] * m[5]
    ct, st = axis
    return v[0] * m[0] + v[1] * m[1] + v[2] * m[2], ct * l1 - st * l2, st * l1 + ct * l2


@formula
def _turned(m, axis):
    """Scalar, vector and symmetric matrix (00, 01, 02, 11, 12, 22) in the fixed axes."""
    ct, st = axis
    cc, ss, cs = ct * ct, st * st, ct * st
    return (
        m[0],
        ct * m[1] - st * m[2],
        st * m[1] + ct * m[2],
        cc * m[3] + ss * m[5] - 2.0 * cs * m[4],
        cs * (m[3] - m[5]) + (cc - ss) * m[4],
        ss * m[3] + cc * m[5] + 2.0 * cs * m[4],
    )


@formula
def loss_by_force_anisotropy(p, s, v, f, axis, p0):
    """Derivatives of X by a_n at fixed dF: -P0 < W dF/H^2 phi_i e_j > over the arc of loss."""
    d, v1, v2 = v
    f1, f2 = f
    # (1 + a_c.e)(d + w.e) = r00 + r10 c + r01 s + r20 c^2 + r11 c s + r02 s^2
    r00, r10, r01 = d, v1 + f1 * d, v2 + f2 * d
    r20, r11, r02 = f1 * v1, f1 * v2 + f2 * v1, f2 * v2
    u00, u10, u20, u30, u40 = p
    u01, u11, u21, u31 = s
    u02, u12, u22 = u00 - u20, u10 - u30, u20 - u40
    u03, u13 = u01 - u21, u11 - u31
    u04 = u02 - u22
    n10 = r00 * u10 + r10 * u20 + r01 * u11 + r20 * u30 + r11 * u21 + r02 * u12
    n01 = r00 * u01 + r10 * u11 + r01 * u02 + r20 * u21 + r11 * u12 + r02 * u03
    n20 = r00 * u20 + r10 * u30 + r01 * u21 + r20 * u40 + r11 * u31 + r02 * u22
    n11 = r00 * u11 + r10 * u21 + r01 * u12 + r20 * u31 + r11 * u22 + r02 * u13
    n02 = r00 * u02 + r10 * u12 + r01 * u03 + r20 * u22 + r11 * u13 + r02 * u04
    _, x, y, xx, xy, yy = _turned((0.0 * d, n10, n01, n20, n11, n02), axis)
    h = -_AVERAGE * p0
    return h * x, h * y, h * xx, h * xy, h * xy, h * yy
