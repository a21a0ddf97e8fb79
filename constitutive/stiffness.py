"""Elastic stiffness of a contact network: the uniform-strain estimate with measured reductions [model of section 7].

With M = 2 z phi/pi, contact stiffnesses kn and kt, and contacts distributed as 1 + a_c.e, the work of a uniform strain
on all contacts gives, in the mean ``eps_v = e_xx + e_yy`` and deviator ``e = (e_xx - e_yy, gamma_xy)``,

    (s_xx + s_yy)/2            = K eps_v + B a_c.e
    ((s_xx - s_yy)/2, s_xy)    = G e + B a_c eps_v

    K = z phi kn/(2 pi) bulk_reduction,   G = z phi (kn + kt)/(4 pi) shear_reduction,   B = z phi kn/(4 pi)

It is positive definite exactly when ``B^2 |a_c|^2 < K G``. Real packings lose shear stiffness faster than contacts: the
choice "isostatic" lets G fall in proportion to ``z - z_iso`` from its value at the initial coordination number.
"""

import math

from .compilation import compiled


@compiled()
def moduli_per_contact(solid_fraction, kn, stiffness_ratio, bulk_reduction, shear_reduction):
    """K/z, G/z and B/z [Pa] of the uniform-strain estimate."""
    unit = solid_fraction * kn / (4.0 * math.pi)
    return 2.0 * unit * bulk_reduction, unit * (1.0 + stiffness_ratio) * shear_reduction, unit


@compiled()
def isostatic_shear(shear, initial_coordination, isostatic_coordination):
    """Slope of ``G = slope (z - z_iso)`` [Pa] that meets ``G = shear z`` at the initial coordination number."""
    return shear * initial_coordination / (initial_coordination - isostatic_coordination)


@compiled()
def stress_rate(k, g, b, a1, a2, exx, eyy, gxy):
    """Stress rate (xx, yy, xy) [Pa] of a strain rate (xx, yy, engineering xy); either sign convention."""
    volumetric, deviator = exx + eyy, exx - eyy
    mean = k * volumetric + b * (a1 * deviator + a2 * gxy)
    half = g * deviator + b * a1 * volumetric
    return mean + half, mean - half, g * gxy + b * a2 * volumetric


@compiled()
def fill_stiffness(k, g, b, a1, a2, out):
    """Write the stiffness [Pa] of moduli K, G, B in the order xx, yy, engineering xy into `out`, shape (3, 3)."""
    out[0, 0] = k + g + 2.0 * b * a1
    out[1, 1] = k + g - 2.0 * b * a1
    out[2, 2] = g
    out[0, 1] = k - g
    out[1, 0] = k - g
    out[0, 2] = b * a2
    out[2, 0] = b * a2
    out[1, 2] = b * a2
    out[2, 1] = b * a2


@compiled()
def stress_invariants(sxx, syy, sxy):
    """Mean pressure p [Pa] and stress-ratio vector s, compression positive, of a tension-positive stress."""
    p = -0.5 * (sxx + syy)
    return p, -0.5 * (sxx - syy) / p, -sxy / p
