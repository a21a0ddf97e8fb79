"""Elastic stiffness of a contact network: the uniform-strain estimate with measured reductions [model of section 7].

With M = 2 z phi/pi, contact stiffnesses kn and kt, and contacts distributed as 1 + a_c.e, the work of a uniform strain
on all contacts gives, in the mean ``v = e_xx + e_yy`` and deviator ``e = (e_xx - e_yy, gamma_xy)``, and with
``t = ((s_xx - s_yy)/2, s_xy)``,

    (s_xx + s_yy)/2   = K v + B a_c.e
    t                 = G e + B a_c v

    K = z phi kn/(2 pi) bulk_reduction,   G = z phi (kn + kt)/(4 pi) shear_reduction,   B = z phi kn/(4 pi)

in either sign convention. It is positive definite exactly when ``B^2 |a_c|^2 < K G``. Real packings lose shear
stiffness faster than contacts: their particles move the less with the mean strain the closer the packing comes to
isostaticity. The choice "isostatic" lets the reduction itself fall in proportion to the distance from there,

    G = z phi (kn + kt)/(4 pi) shear_reduction (z - z_iso)/(z(0) - z_iso)

which disks follow from their initial pressure to a tenth of it, with z_iso = 3 where z is counted without rattlers.
"""

import math

from .compilation import formula


@formula
def moduli_per_contact(solid_fraction, kn, stiffness_ratio, bulk_reduction, shear_reduction):
    """K/z, G/z and B/z [Pa] of the uniform-strain estimate."""
    unit = solid_fraction * kn / (4.0 * math.pi)
    return 2.0 * unit * bulk_reduction, unit * (1.0 + stiffness_ratio) * shear_reduction, unit


@formula
def isostatic_shear(shear, initial_coordination, isostatic_coordination):
    """The two numbers [Pa] of ``G = z (constant + slope z)`` that vanishes at z_iso and is ``shear z`` at z(0)."""
    slope = shear / (initial_coordination - isostatic_coordination)
    return -slope * isostatic_coordination, slope


@formula
def stress_rate(stiffness, v, e1, e2):
    """Rates of the mean stress and of the deviator t [Pa] for rates of strain; `stiffness` is K, G, B, a_c (2)."""
    k, g, b, a1, a2 = stiffness
    return k * v + b * (a1 * e1 + a2 * e2), g * e1 + b * a1 * v, g * e2 + b * a2 * v


@formula
def stress_rate_change(change, v, e1, e2):
    """Change of the stress rate with a change of z and a_c.

    Parameters
    ----------
    change : tuple of 5 floats
        Changes of K, G, B and of B a_c (2).
    v, e1, e2 : float
        Strain rate.
    """
    dk, dg, _, db1, db2 = change
    return dk * v + db1 * e1 + db2 * e2, dg * e1 + db1 * v, dg * e2 + db2 * v


@formula
def stiffness_entries(stiffness):
    """Entries 11, 22, 33, 12, 13 = 23 of the stiffness [Pa] in the order xx, yy, engineering xy."""
    k, g, b, a1, a2 = stiffness
    return k + g + 2.0 * b * a1, k + g - 2.0 * b * a1, g, k - g, b * a2


@formula
def invariants(sxx, syy, sxy):
    """Mean pressure p and deviator t [Pa], compression positive, of a tension-positive stress or stress rate."""
    return -0.5 * (sxx + syy), -0.5 * (sxx - syy), -sxy


@formula
def components(p, t1, t2):
    """Tension-positive stress (xx, yy, xy) [Pa] of p and t."""
    return -(p + t1), t1 - p, -t2


@formula
def strain_invariants(exx, eyy, gxy):
    """Strain v and (e_1, e_2), compression positive, conjugate to p and t, of a tension-positive strain."""
    return -(exx + eyy), eyy - exx, -gxy
