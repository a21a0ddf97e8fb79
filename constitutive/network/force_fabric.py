"""Anisotropy A = a_n + a_c of the force that all contacts of a direction carry, as a function of the state.

Second harmonics of density and forces give, without further approximation, the stress [7]

    2 s (1 + a_c.a_n/2) = a_c + a_n + a_t,        p = z phi f (1 + a_c.a_n/2)/(2 pi r)

The product ``a_c.a_n/2``, which the source drops, is 2 % at q/p = 0.3. For the closure "frictional" a_t is known
(`tangential_force`), and the relation is linear in ``mu = 1 + a_c.a_n/2``:

    mu = (1 - a_c.(a_c + a_t)/2)/(1 - s.a_c),      A = 2 s mu - a_t

For "self_consistent" a_n is proportional to s and ``A = a_n + a_c``. The mean change of force in a direction is
``dF = dlnp + (a_n dlnp + dA).e`` in both.
"""

import math

import numpy as np

from granfabric.constitutive.compilation import compiled

from .tangential_force import tangential_magnitude

FRICTIONAL, PROPORTIONAL = 1, 0

LEAST_MARGIN = 0.05
"""Smallest 1 - s.a_c for which the relation is solved; beyond, forces would have to pull in some directions."""

# entries of the result: A, then its derivatives by a_c (2, 2), by s (2, 2) and by X_0 (2); mu, a_t
A1, A2, BY_A11, BY_A12, BY_A21, BY_A22, BY_S11, BY_S12, BY_S21, BY_S22, BY_X1, BY_X2, MU, T1, T2, LENGTH = range(16)


@compiled()
def force_fabric(kind, s1, s2, a1, a2, x0, normal1, normal2, c_n, c_t, k, delay_ratio, out):
    """Anisotropy of the carried force, with derivatives.

    Parameters
    ----------
    kind : int
        `FRICTIONAL` or `PROPORTIONAL`.
    s1, s2, a1, a2 : float
        Stress-ratio vector and a_c.
    x0 : float
        X_0; read by "frictional".
    normal1, normal2, c_n : float
        a_n at this s and its derivative by s; read by "proportional".
    c_t, k, delay_ratio : float
        Of `tangential_force`; read by "frictional".
    out : ndarray, shape (LENGTH,)
        Written.

    Returns
    -------
    bool
        False if the relation has no admissible solution.
    """
    if kind == PROPORTIONAL:
        out[A1], out[A2] = normal1 + a1, normal2 + a2
        out[BY_A11], out[BY_A12], out[BY_A21], out[BY_A22] = 1.0, 0.0, 0.0, 1.0
        out[BY_S11], out[BY_S12], out[BY_S21], out[BY_S22] = c_n, 0.0, 0.0, c_n
        out[BY_X1], out[BY_X2] = 0.0, 0.0
        out[MU] = 1.0
        out[T1], out[T2] = 2.0 * s1 - a1 - normal1, 2.0 * s2 - a2 - normal2
        return True
    m = math.sqrt(s1 * s1 + s2 * s2)
    delay = delay_ratio * x0 if x0 > 0.0 else 0.0
    value, by_m, by_delay = tangential_magnitude(m, c_t, k, delay)
    u1, u2, h = 1.0, 0.0, c_t
    if m > 0.0:
        u1, u2, h = s1 / m, s2 / m, value / m
    t1, t2 = h * s1, h * s2
    # d a_t/d s = h 1 + (d|a_t|/dm - h) u u
    along = by_m - h
    d11, d12, d22 = h + along * u1 * u1, along * u1 * u2, h + along * u2 * u2
    by_x = by_delay * delay_ratio if x0 > 0.0 else 0.0
    margin = 1.0 - s1 * a1 - s2 * a2
    if not margin > LEAST_MARGIN:
        return False
    mu = (1.0 - 0.5 * (a1 * (a1 + t1) + a2 * (a2 + t2))) / margin
    inverse = 1.0 / margin
    mu_a1 = (mu * s1 - a1 - 0.5 * t1) * inverse
    mu_a2 = (mu * s2 - a2 - 0.5 * t2) * inverse
    mu_s1 = (mu * a1 - 0.5 * (a1 * d11 + a2 * d12)) * inverse
    mu_s2 = (mu * a2 - 0.5 * (a1 * d12 + a2 * d22)) * inverse
    mu_x = -0.5 * (a1 * u1 + a2 * u2) * by_x * inverse
    out[A1], out[A2] = 2.0 * s1 * mu - t1, 2.0 * s2 * mu - t2
    out[BY_A11], out[BY_A12] = 2.0 * s1 * mu_a1, 2.0 * s1 * mu_a2
    out[BY_A21], out[BY_A22] = 2.0 * s2 * mu_a1, 2.0 * s2 * mu_a2
    out[BY_S11], out[BY_S12] = 2.0 * mu + 2.0 * s1 * mu_s1 - d11, 2.0 * s1 * mu_s2 - d12
    out[BY_S21], out[BY_S22] = 2.0 * s2 * mu_s1 - d12, 2.0 * mu + 2.0 * s2 * mu_s2 - d22
    out[BY_X1] = 2.0 * s1 * mu_x - by_x * u1
    out[BY_X2] = 2.0 * s2 * mu_x - by_x * u2
    out[MU], out[T1], out[T2] = mu, t1, t2
    return True


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
    out = np.empty(LENGTH)
    for i in range(stress_ratio.shape[0]):
        s1, s2, a1, a2 = stress_ratio[i, 0], stress_ratio[i, 1], fabric[i, 0], fabric[i, 1]
        if not force_fabric(FRICTIONAL, s1, s2, a1, a2, 0.0, 0.0, 0.0, 0.0, c_t, k, 0.0, out):
            mu[i] = math.nan
            continue
        normal[i, 0], normal[i, 1] = out[A1] - a1, out[A2] - a2
        tangential[i, 0], tangential[i, 1] = out[T1], out[T2]
        mu[i] = out[MU]
