"""Tangential-force anisotropy as contacts slip [model, section 5.3, closure "frictional"].

A packing of frictionless contacts that friction is switched on for carries no tangential forces. While it is sheared
every contact follows ``f_t = c_t s f`` until its own Coulomb limit stops it. Normal forces are spread evenly near zero,
so that the number of contacts at their limit grows with |s| and what they fail to carry with its square:

    a_t = s (c_t - k m^2/(m + L)),    m = |s|,    L = lambda max(X_0, 0)

L delays slip where a growing pressure has moved weak contacts away from zero force. Where the pressure falls, P = p/p_0
below one, contacts that it has opened carry no tangential force and those that are left turn more freely, and the weak
ones are fewer by P^(1-a) in units of their mean:

    c_t exp(-kappa (Lambda_0 + Lambda_0^2/2)) for c_t,    k P^(1-a) for k,    Lambda_0 = P0 chi_p (1 - P)

Past its maximum over m the magnitude stays: a_t is bounded by the friction of the contacts, ``c_t^2/(4 k)`` at constant
pressure.
"""

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import choose, somewhere
from granfabric.constitutive.lanes.elementary import exponential, larger

_ITERATIONS = 60


@formula
def _largest(c_t, k, delay, wanted):
    """The m at which ``c_t m - k m^3/(m + L)`` is largest: the root of ``k m^2 (2 m + 3 L) = c_t (m + L)^2``.

    Found where `wanted`; c_t and k are positive.
    """
    # the slip term's derivative lies between 2 k m and 3 k m, so the root between c_t/(3 k) and c_t/(2 k), where the
    # function is convex and rising: Newton from the upper end does not overshoot
    m = choose(wanted, 0.5 * c_t / k, 0.0 * delay)
    for _ in range(_ITERATIONS):
        value = k * m * m * (2.0 * m + 3.0 * delay) - c_t * (m + delay) * (m + delay)
        slope = 6.0 * k * m * (m + delay) - 2.0 * c_t * (m + delay)
        step = value / choose(slope > 0.0, slope, 1.0)
        going = wanted & (slope > 0.0) & (abs(step) > 1e-15 * m)
        if not somewhere(going):
            break
        m = choose(going, m - step, m)
    return m


@formula
def tangential_magnitude(m, c_t, k, delay):
    """|a_t| at the stress ratio m, with derivatives.

    Parameters
    ----------
    m : float
        q/p, >= 0.
    c_t : float
        |a_t|/m without slip.
    k : float
        Slip coefficient.
    delay : float
        L, >= 0.

    Returns
    -------
    value, by_m, by_delay, by_c_t, by_k : float
        The value is monotone in m.
    """
    total = larger(m + delay, 1e-300)
    by_m = c_t - k * (m / total) * (m / total) * (2.0 * m + 3.0 * delay)
    past = by_m < 0.0
    if somewhere(past & (c_t > 0.0)):
        # at the maximum the derivative by m vanishes, so that the one by L is the direct one
        m = choose(past & (c_t > 0.0), _largest(c_t, k, delay, past & (c_t > 0.0)), m)
    m = choose(past & (c_t <= 0.0), 0.0, m)
    total = larger(m + delay, 1e-300)
    free = m / total
    by_m = choose(past, 0.0, by_m)
    slipped = m * m * free
    return c_t * m - k * slipped, by_m, k * m * free * free, m, -slipped


@formula
def slip_numbers(closure, weak, p_zero):
    """c_t, k and L at a pressure, and their derivatives by ln p.

    Parameters
    ----------
    closure : closures.ShiftedDistribution
    weak : WeakState
    p_zero : float
        P0; 0 if nothing is lost.
    """
    ratio = weak.ratio
    rising = ratio > 1.0
    lost = choose(rising, 0.0, p_zero * closure.chi_p * (1.0 - ratio))
    c_t = closure.c_t * exponential(-closure.kappa * (lost + 0.5 * lost * lost))
    c_t_by_p = choose(rising, 0.0, closure.kappa * (1.0 + lost) * p_zero * closure.chi_p * ratio * c_t)
    k = closure.slip * choose(rising, 1.0, weak.stretch)
    k_by_p = choose(rising, 0.0, weak.growth * k)
    return (c_t, k, weak.delay), (c_t_by_p, k_by_p, weak.delay_by_p)
