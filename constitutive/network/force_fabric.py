"""Anisotropy A = a_n + a_c of the force that all contacts of a direction carry, as a function of the state.

Second harmonics of density and forces give, without further approximation, the stress [7]

    2 s (1 + a_c.a_n/2) = a_c + a_n + a_t,        p = z phi f (1 + a_c.a_n/2)/(2 pi r)

The product ``a_c.a_n/2``, which the source drops, is 2 % at q/p = 0.3. For the closure "frictional" a_t is known
(`tangential_force`), and the relation is linear in ``mu = 1 + a_c.a_n/2``:

    mu = (1 - a_c.(a_c + a_t)/2)/(1 - s.a_c),      A = 2 s mu - a_t

It has a solution of forces that push where ``s.a_c`` is below one and ``mu`` above zero.

For "self_consistent" a_n is proportional to s and ``A = a_n + a_c``. The mean change of force in a direction is
``dF = dlnp + (a_n dlnp + dA).e`` in both.
"""

import math

from granfabric.constitutive.compilation import compiled, formula
from granfabric.constitutive.lanes.eight import choose

from .tangential_force import tangential_magnitude

LEAST_MARGIN = 0.05
"""Smallest 1 - s.a_c for which the relation is solved; beyond, forces would have to pull in some directions."""


@formula
def tangential_force(s1, s2, numbers, by_pressure):
    """a_t of a stress ratio and the numbers of slip at a pressure.

    Parameters
    ----------
    s1, s2 : float
    numbers, by_pressure : tuples of 3
        c_t, k and L and their derivatives by ln p, see `tangential_force.slip_numbers`.

    Returns
    -------
    a_t : tuple of 2
    by_s : tuple of 3
        Derivatives 11, 12 = 21, 22.
    by_p : tuple of 2
        By ln p.
    """
    m = math.sqrt(s1 * s1 + s2 * s2)
    value, by_m, by_delay, by_c_t, by_k = tangential_magnitude(m, numbers[0], numbers[1], numbers[2])
    sheared = m > 0.0
    inverse = 1.0 / choose(sheared, m, 1.0)
    u1, u2 = choose(sheared, s1 * inverse, 1.0), s2 * inverse
    h = choose(sheared, value * inverse, numbers[0])
    # d a_t/d s = h 1 + (d|a_t|/dm - h) u u
    along = by_m - h
    by_p = by_c_t * by_pressure[0] + by_k * by_pressure[1] + by_delay * by_pressure[2]
    by_p = choose(sheared, by_p, 0.0)
    return (h * s1, h * s2), (h + along * u1 * u1, along * u1 * u2, h + along * u2 * u2), (by_p * u1, by_p * u2)


@formula
def carried_force(s1, s2, a1, a2, t1, t2):
    """A and mu of given s, a_c and a_t, with the derivatives of A by a_c.

    Returns
    -------
    A : tuple of 2
    mu : float
    by_fabric : tuple of 4
        Derivatives 11, 12, 21, 22 of A by a_c.
    margin : float
        1 - s.a_c, which has to be above `LEAST_MARGIN`.
    """
    margin = 1.0 - s1 * a1 - s2 * a2
    inverse = 1.0 / choose(margin > LEAST_MARGIN, margin, 1.0)
    mu = (1.0 - 0.5 * (a1 * (a1 + t1) + a2 * (a2 + t2))) * inverse
    mu_a1 = (mu * s1 - a1 - 0.5 * t1) * inverse
    mu_a2 = (mu * s2 - a2 - 0.5 * t2) * inverse
    by_fabric = (2.0 * s1 * mu_a1, 2.0 * s1 * mu_a2, 2.0 * s2 * mu_a1, 2.0 * s2 * mu_a2)
    return (2.0 * s1 * mu - t1, 2.0 * s2 * mu - t2), mu, by_fabric, margin


@formula
def carried_force_by_stress(s1, s2, a1, a2, mu, margin, t_by_s, skew, t_by_p):
    """Derivatives of A by s (11, 12, 21, 22) and by ln p (2) at fixed a_c, from those of a_t.

    Those of a_t by s are ``t_by_s`` (11, 12, 22), with `skew` more in 12 and less in 21.
    """
    d11, d12, d22 = t_by_s
    d21, d12 = d12 - skew, d12 + skew
    x1, x2 = t_by_p
    inverse = 1.0 / choose(margin > LEAST_MARGIN, margin, 1.0)
    mu_s1 = (mu * a1 - 0.5 * (a1 * d11 + a2 * d21)) * inverse
    mu_s2 = (mu * a2 - 0.5 * (a1 * d12 + a2 * d22)) * inverse
    mu_x = -0.5 * (a1 * x1 + a2 * x2) * inverse
    by_s = (
        2.0 * mu + 2.0 * s1 * mu_s1 - d11,
        2.0 * s1 * mu_s2 - d12,
        2.0 * s2 * mu_s1 - d21,
        2.0 * mu + 2.0 * s2 * mu_s2 - d22,
    )
    return by_s, (2.0 * s1 * mu_x - x1, 2.0 * s2 * mu_x - x2)


@compiled()
def initial_force_fabric(stress_ratio, fabric, c_t, k, normal, tangential, mu):
    """a_n, a_t and mu of points of the closure "frictional" before any loading.

    Parameters
    ----------
    stress_ratio, fabric : ndarray, shape (npt, 2)
        s and a_c.
    c_t, k : float
    normal, tangential : ndarray, shape (npt, 2)
        Written.
    mu : ndarray, shape (npt,)
        Written; NaN where the relation has no admissible solution.
    """
    for i in range(stress_ratio.shape[0]):
        s1, s2, a1, a2 = stress_ratio[i, 0], stress_ratio[i, 1], fabric[i, 0], fabric[i, 1]
        (t1, t2), _, _ = tangential_force(s1, s2, (c_t, k, 0.0), (0.0, 0.0, 0.0))
        (carried1, carried2), mean, _, margin = carried_force(s1, s2, a1, a2, t1, t2)
        if not (margin > LEAST_MARGIN and mean > 0.0):
            mu[i] = math.nan
            continue
        normal[i, 0], normal[i, 1] = carried1 - a1, carried2 - a2
        tangential[i, 0], tangential[i, 1] = t1, t2
        mu[i] = mean
