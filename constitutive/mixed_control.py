"""Stress and strain rates where some components of stress and the other components of strain are given."""

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import choose
from granfabric.constitutive.stiffness import components, invariants, stiffness_entries, strain_invariants, stress_rate


@formula
def solve_with_given(stiffness, given, stressed):
    """Strain rates for which the stress rates of some components are as given.

    Parameters
    ----------
    stiffness : tuple of 5
        See `stiffness.stress_rate`.
    given : tuple of 3
        Rates xx, yy, xy of stress or strain, tension positive.
    stressed : tuple of 3
        True where it is one of stress.

    Returns
    -------
    tuple of 3
        Strain rates xx, yy, xy, tension positive.
    """
    c11, c22, c33, c12, c13 = stiffness_entries(stiffness)
    h1, h2, h3 = stressed
    # elimination without pivoting is stable: any principal block of the stiffness is positive definite
    a11, a12, a13 = choose(h1, c11, 1.0), choose(h1, c12, 0.0), choose(h1, c13, 0.0)
    a21, a22, a23 = choose(h2, c12, 0.0), choose(h2, c22, 1.0), choose(h2, c13, 0.0)
    a31, a32, a33 = choose(h3, c13, 0.0), choose(h3, c13, 0.0), choose(h3, c33, 1.0)
    b1, b2, b3 = given
    factor2, factor3 = a21 / a11, a31 / a11
    a22, a23, b2 = a22 - factor2 * a12, a23 - factor2 * a13, b2 - factor2 * b1
    a32, a33, b3 = a32 - factor3 * a12, a33 - factor3 * a13, b3 - factor3 * b1
    factor3 = a32 / a22
    b3 = (b3 - factor3 * b2) / (a33 - factor3 * a23)
    b2 = (b2 - a23 * b3) / a22
    b1 = (b1 - a12 * b2 - a13 * b3) / a11
    return choose(h1, b1, given[0]), choose(h2, b2, given[1]), choose(h3, b3, given[2])


@formula
def rates_with_given(stiffness, given, stressed):
    """Rates of (p, t_1, t_2) and of the strain (xx, yy, xy, tension positive); see `solve_with_given`."""
    xx, yy, xy = solve_with_given(stiffness, given, stressed)
    mean, half, shear = stress_rate(stiffness, xx + yy, xx - yy, xy)
    s_xx = choose(stressed[0], given[0], mean + half)
    s_yy = choose(stressed[1], given[1], mean - half)
    s_xy = choose(stressed[2], given[2], shear)
    return invariants(s_xx, s_yy, s_xy), (xx, yy, xy)


@formula
def relief(stiffness, v, e1, e2, stressed):
    """What a plastic strain takes off the stress while the given components of stress stay.

    Parameters
    ----------
    v, e1, e2 : float
        Plastic strain, compression positive.
    stiffness, stressed :
        As in `solve_with_given`.

    Returns
    -------
    tuple of 3
        Decrease of p, t_1, t_2, compression positive.
    tuple of 3
        Strain xx, yy, xy that appears in components of given stress, tension positive.
    """
    p, t1, t2 = stress_rate(stiffness, v, e1, e2)
    xx, yy, xy = components(p, t1, t2)
    zero = 0.0 * v
    asked = (choose(stressed[0], xx, zero), choose(stressed[1], yy, zero), choose(stressed[2], xy, zero))
    f_xx, f_yy, f_xy = solve_with_given(stiffness, asked, stressed)
    g_v, g_1, g_2 = strain_invariants(f_xx, f_yy, f_xy)
    p, t1, t2 = stress_rate(stiffness, v - g_v, e1 - g_1, e2 - g_2)
    xx, yy, xy = components(p, t1, t2)
    left = invariants(
        choose(stressed[0], zero, xx), choose(stressed[1], zero, yy), choose(stressed[2], zero, xy)
    )
    return left, (f_xx, f_yy, f_xy)
