"""Expected negative and positive part of a normally distributed force change.

For a mean x and a spread s >= 0, with u = x/s and the normal density phi and distribution Phi [model, section 5.2],

    E[max(-g, 0)] = s phi(u) - x Phi(-u),      E[max(g, 0)] = s phi(u) + x Phi(u) = E[max(-g, 0)] + x

The derivative by x is -Phi(-u) and Phi(u), the derivative by s is phi(u) for both. With s = 0 these are max(-x, 0) and
max(x, 0). What counts is the error of the share that is lost, hence the absolute one: 2e-16 of the spread.
"""

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import choose
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
