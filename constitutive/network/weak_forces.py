"""Expected negative and positive part of a normally distributed force change, without cancellation in the tails.

For a mean x and a spread s >= 0, with u = x/s and the normal density phi and distribution Phi [model, section 5.2],

    E[max(-g, 0)] = s phi(u) - x Phi(-u),      E[max(g, 0)] = s phi(u) + x Phi(u)

The derivative by x is -Phi(-u) and Phi(u), the derivative by s is phi(u) for both. With s = 0 these are max(-x, 0) and
max(x, 0).
"""

import math

from granfabric.constitutive.compilation import compiled

_ROOT_2 = math.sqrt(2.0)
_INVERSE_ROOT_2_PI = 1.0 / math.sqrt(2.0 * math.pi)
_TAIL = 4.0
"""Beyond this u the difference s phi - x Phi(-u) is taken from the continued fraction of Mills' ratio instead."""
_DEPTH = 640.0
_LEAST_DEPTH = 10
"""Levels of the fraction: 640/u^2 + 10 give rounding from u = 4 on."""
_PLAIN = 6.0
"""Up to this |u| the rounding of u^2, amplified by u^2/2 in exp, stays below 1e-14."""
_NOTHING = 39.0
"""Beyond this u phi(u) underflows."""


@compiled()
def normal_density(u):
    """phi(u), relative error at rounding also in the tails."""
    if abs(u) < _PLAIN:
        return _INVERSE_ROOT_2_PI * math.exp(-0.5 * u * u)
    # u^2 = h^2 + (u - h)(u + h) with h^2 exact in double precision: the rounding of u^2 would be amplified by u^2
    h = math.floor(u * 64.0) / 64.0 if abs(u) < 1e4 else 0.0
    return _INVERSE_ROOT_2_PI * math.exp(-0.5 * h * h) * math.exp(-0.5 * (u - h) * (u + h))


@compiled()
def upper_tail(u):
    """Phi(-u) = 1 - Phi(u), relative error at rounding for all u until it underflows."""
    return 0.5 * math.erfc(u / _ROOT_2)


@compiled()
def mills_remainder(u):
    """c with Phi(-u) = phi(u)/(u + c), for u > 4."""
    c = 0.0
    for n in range(int(_DEPTH / (u * u)) + _LEAST_DEPTH, 0, -1):
        c = n / (u + c)
    return c


@compiled()
def excess_and_tail(u):
    """phi(u) - u Phi(-u) >= 0 (expected excess of a standard normal variable over u), Phi(-u) and phi(u), for u >= 0.

    Relative error of phi and Phi at rounding, of the excess below 5e-14 (below 1e-14 from u = 4.5 on and up to 2).
    """
    if u > _NOTHING:
        return 0.0, 0.0, 0.0
    density = normal_density(u)
    if u <= _TAIL:
        tail = upper_tail(u)
        return density - u * tail, tail, density
    # Phi(-u) = phi/(u + c) with c = 1/(u + 2/(u + 3/(u + ...))): no difference of nearly equal numbers
    c = mills_remainder(u)
    tail = density / (u + c)
    return tail * c, tail, density


@compiled()
def negative_part(x, s):
    """E[max(-g, 0)] and its derivatives by x and s.

    Parameters
    ----------
    x : float
        Mean of g.
    s : float
        Standard deviation of g, >= 0.

    Returns
    -------
    value, by_x, by_s : float
    """
    if not s > 0.0 or abs(x) > 1e150 * s:
        return (-x, -1.0, 0.0) if x < 0.0 else (0.0, 0.0, 0.0)
    excess, tail, density = excess_and_tail(abs(x) / s)
    if x >= 0.0:
        return s * excess, -tail, density
    # E[max(-g, 0)] = E[max(g, 0)] - E[g]: no cancellation for a negative mean
    return s * excess - x, tail - 1.0, density


@compiled()
def positive_part(x, s):
    """E[max(g, 0)] and its derivatives by x and s; see `negative_part`."""
    value, by_x, by_s = negative_part(-x, s)
    return value, -by_x, by_s
