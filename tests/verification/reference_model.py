"""The model written a second time, straight from the integrals over directions and as slowly as it likes.

Shares no code with `constitutive`: scipy's quadrature over theta on the whole circle, scipy's DOP853, scipy's Bessel
functions. Only for tests.
"""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import i0e, i1e
from scipy.stats import norm

_X, _W = np.polynomial.legendre.leggauss(40)


def _circle(d, w, q):
    """Double angles and weights of a composite Gauss rule whose panels end where dF or the contact density vanishes."""
    ends = list(np.linspace(-np.pi, np.pi, 9))
    for mean, vector in ((d, w), (1.0, q)):
        size = np.hypot(*vector)
        if abs(mean) < size:
            centre, half = np.arctan2(vector[1], vector[0]), np.arccos(-mean / size)
            ends += [(centre + sign * half + np.pi) % (2 * np.pi) - np.pi for sign in (1, -1)]
    ends = np.unique(ends)
    middle, scale = 0.5 * (ends[1:] + ends[:-1]), 0.5 * (ends[1:] - ends[:-1])
    return (middle[:, None] + scale[:, None] * _X).ravel(), (scale[:, None] * _W).ravel() / (2 * np.pi)


def density(y, q, distribution):
    """2 pi E as a function of the double angle."""
    if distribution == "harmonic":
        return np.maximum(1 + q[0] * np.cos(y) + q[1] * np.sin(y), 0.0)
    size = np.hypot(*q)
    if size < 1e-14:
        return np.ones_like(y)
    k = brentq(lambda k: 2 * i1e(k) / i0e(k) - size, 0, 1e6, xtol=1e-15, rtol=1e-15)
    along = (q[0] * np.cos(y) + q[1] * np.sin(y)) / size
    return np.exp(k * (along - 1)) / i0e(k)


def expected_part(mean, deviation):
    """Expected positive part of a normal variable."""
    if deviation == 0:
        return np.maximum(mean, 0)
    return deviation * norm.pdf(mean / deviation) + mean * norm.cdf(mean / deviation)


def rates(
    material, d, ds, z, q, n, f, tangential="neglected", distribution="harmonic", loss=True, gain=True, chi=1, sigma=0
):
    """Gained and lost rates of (z, a_c1, a_c2): arrays of 3; weak contacts feel chi dF with a scatter sigma."""
    n = n * min(1.0, 0.98 / max(np.hypot(*n), 1e-300))
    change = np.zeros(2)
    for _ in range(200 if tangential == "self_consistent" else 1):
        b = 2 * ds if tangential == "neglected" else material.force_anisotropy_ratio * ds + change
        w = n * d + b
        y, weight = _circle(d, w, q)
        e = np.array([np.cos(y), np.sin(y)])
        dF = d + w @ e
        contacts = density(y, q, distribution)
        beta = max(material.neighbours - z, 0) / z
        g = gain * beta * material.gap_density_at_zero * f / 2 * contacts * expected_part(chi * dF, sigma)
        lost = loss * material.force_density_at_zero * contacts * expected_part(-chi * dF / (1 + n @ e), sigma)
        totals = []
        for rate in (g, lost):
            mean = rate @ weight
            totals.append(np.array([z * mean, *(2 * (e * rate) @ weight - q * mean)]))
        update = (totals[0] - totals[1])[1:]
        if tangential == "neglected" or np.abs(update - change).max() < 1e-15 * (abs(d) + np.abs(w).sum()):
            break
        change = update
    return totals


def stiffness(material, z, q):
    """Stiffness by averaging over contact directions, with the isotropic parts reduced; engineering shear."""
    x, w = np.polynomial.legendre.leggauss(60)
    theta, weight = np.pi * x, np.pi * w
    contacts = (1 + q[0] * np.cos(2 * theta) + q[1] * np.sin(2 * theta)) / (2 * np.pi)
    normal = np.array([np.cos(theta) ** 2, np.sin(theta) ** 2, np.sin(theta) * np.cos(theta)])
    shear = np.array([-np.sin(2 * theta) / 2, np.sin(2 * theta) / 2, np.cos(2 * theta) / 2])
    factor = 2 * z * material.solid_fraction / np.pi * material.normal_stiffness
    full = factor * np.einsum("ik,jk,k->ij", normal, normal, contacts * weight)
    full += factor * material.stiffness_ratio * np.einsum("ik,jk,k->ij", shear, shear, contacts * weight)
    phi, kn = material.solid_fraction, material.normal_stiffness
    bulk = z * phi * kn / (2 * np.pi)
    modulus = z * phi * kn * (1 + material.stiffness_ratio) / (4 * np.pi)
    full[:2, :2] += (material.bulk_reduction - 1) * bulk
    full += (material.shear_reduction - 1) * modulus * np.array([[1, -1, 0], [-1, 1, 0], [0, 0, 1]])
    return full


def derivative_of(material, stress, increment, control="stress", c_w=0, **choices):
    """Rates of y = (stress, z, a_c, gained, lost, strain), 15 in all, over a pseudo-time from 0 to 1."""
    c_n, phi, kn = material.force_anisotropy_ratio, material.solid_fraction, material.normal_stiffness
    stress, increment = np.asarray(stress, float), np.asarray(increment, float)

    def invariants(sigma):
        p = -(sigma[0] + sigma[1]) / 2
        return p, np.array([-(sigma[0] - sigma[1]) / 2, -sigma[2]]) / p

    s_start = invariants(stress)[1]

    def derivative(y):
        sigma, z_now, q_now = y[:3], y[3], y[4:6]
        c = stiffness(material, z_now, q_now)
        stress_rate = increment if control == "stress" else c @ increment
        strain_rate = np.linalg.solve(c, increment) if control == "stress" else increment
        p, s = invariants(sigma)
        d = -(stress_rate[0] + stress_rate[1]) / 2 / p
        ds = np.array([-(stress_rate[0] - stress_rate[1]) / 2, -stress_rate[2]]) / p - s * d
        f = 2 * np.pi * p / (z_now * phi * kn)
        n = c_n * s_start + c_n * (s - s_start)
        sigma_w = c_w * np.hypot(strain_rate[0] - strain_rate[1], strain_rate[2]) / f
        gained, lost = rates(material, d, ds, z_now, q_now, n, f, sigma=sigma_w, **choices)
        return np.concatenate([stress_rate, gained - lost, gained, lost, strain_rate])

    return derivative


def integrate(material, stress, increment, control="stress", z=None, q=(0.0, 0.0), rtol=1e-10, **choices):
    """End stress, z, a_c, gained (3), lost (3) and strain after an increment of stress, or of strain."""
    derivative = derivative_of(material, stress, increment, control, **choices)
    stress = np.asarray(stress, float)
    start = np.concatenate([stress, [material.coordination if z is None else z], q, np.zeros(9)])
    scale = np.concatenate([np.full(3, 1e-3 * abs(stress).max()), np.ones(9), np.full(3, 1e-5)])
    solution = solve_ivp(lambda _, y: derivative(y), (0, 1), start, method="DOP853", rtol=rtol, atol=rtol * scale)
    end = solution.y[:, -1]
    return end[:3], end[3], end[4:6], end[6:9], end[9:12], end[12:15]
