"""Expected negative and positive part of a normally distributed force change.

For a mean x and a spread s >= 0, with u = x/s and the normal density phi and distribution Phi [model, section 5.2],

    E[max(-g, 0)] = s phi(u) - x Phi(-u),      E[max(g, 0)] = s phi(u) + x Phi(u) = E[max(-g, 0)] + x

A density of forces that is the straight line P0 + P0' F above zero, and ends where it would be negative, loses

    P0 E[max(-g, 0)] + P0'/2 (E[max(-g, 0)^2] - E[max(-g - F', 0)^2]),     F' = P0/|P0'| if P0' < 0, else infinity
    E[max(-g, 0)^2] = s^2 Phi(-u) - x E[max(-g, 0)]

The derivative by x is -Phi(-u) and Phi(u), the derivative by s is phi(u) for both. With s = 0 these are max(-x, 0) and
max(x, 0). What counts is the error of the fraction that is lost, hence the absolute one: 2e-16 of the spread.
"""

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import choose, somewhere
from granfabric.constitutive.lanes.elementary import FARTHEST, larger, normal_tail


@formula
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
    spread = s > 0.0
    u = choose(spread, abs(x) / choose(spread, s, 1.0), FARTHEST)
    tail, excess, density = normal_tail(u)
    # E[max(-g, 0)] = E[max(g, 0)] - E[g] for a negative mean
    return s * excess + larger(-x, 0.0), choose(x < 0.0, tail - 1.0, -tail), density


@formula
def positive_part(x, s):
    """E[max(g, 0)] and its derivatives by x and s; see `negative_part`."""
    value, by_x, by_s = negative_part(-x, s)
    return value, -by_x, by_s


@formula
def lost_and_gained(p0, slope, x, s):
    """What a line of forces loses and what closes per density of gaps, with derivatives.

    Parameters
    ----------
    p0, slope : float
        P0 >= 0 and P0'.
    x, s : float
        Shift of the forces and its standard deviation.

    Returns
    -------
    lost, by_x, by_s : float
    above, above_by_x, above_by_s : float
        E[max(g, 0)].
    """
    below, below_x, below_s = negative_part(x, s)
    lost = p0 * below + 0.5 * slope * (-s * s * below_x - x * below)
    by_x = p0 * below_x - slope * below
    by_s = p0 * below_s - slope * s * below_x
    # a falling line ends; only a shift as far as that reaches its end
    end = x + p0 / larger(-slope, 1e-300)
    reached = (slope < 0.0) & (end < FARTHEST * s)
    if somewhere(reached):
        end = choose(reached, end, 1.0 + 0.0 * end)
        beyond, beyond_x, _ = negative_part(end, s)
        rest = choose(reached, slope, 0.0)
        lost -= 0.5 * rest * (-s * s * beyond_x - end * beyond)
        by_x += rest * beyond
        by_s += rest * s * beyond_x
    return lost, by_x, by_s, below + x, 1.0 + below_x, below_s
