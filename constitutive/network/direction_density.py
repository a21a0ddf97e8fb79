"""Contact density of one direction for a given a_c, with derivatives: for quadratures over directions.

The harmonic density 1 + a_c.e is clipped at zero, which it reaches once |a_c| > 1; the maximum-entropy density is
``exp(k e.q)/I_0(k)`` with q the direction of a_c (see `fabric`).
"""

import math

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.fabric import concentration, scaled_bessel_zero
from granfabric.constitutive.lanes.eight import choose
from granfabric.constitutive.lanes.elementary import angle, exponential, larger

NEGLIGIBLE = 42.0
"""Contact densities below exp(-42) = 6e-19 of their peak are not sampled."""


@formula
def shape_of(entropy, q1, q2):
    """What `density_at` needs, once for an a_c: |a_c|, its direction (2), k, dk/d|a_c|, k/|a_c|, 1/norm, reach.

    `reach` is the half-width of the arc around a_c that holds contacts, pi if all of them do.
    """
    magnitude = math.sqrt(q1 * q1 + q2 * q2)
    inverse = 1.0 / choose(magnitude > 0.0, magnitude, 1.0)
    cq, sq = choose(magnitude > 0.0, q1 * inverse, 1.0), q2 * inverse
    if entropy:
        k, slope = concentration(magnitude)
        norm = 1.0 / scaled_bessel_zero(k)
        # d k/d a_c: `slope` along a_c, k/|a_c| across
        across = choose(magnitude > 1e-8, k * inverse, 1.0)
        edge = choose(k > 0.5 * NEGLIGIBLE, 1.0 - NEGLIGIBLE / larger(k, 1.0), -1.0)
    else:
        k, slope, across, norm = 0.0 * q1, 1.0 + 0.0 * q1, 1.0 + 0.0 * q1, 1.0 + 0.0 * q1
        edge = choose(magnitude > 1.0, -inverse, -1.0)
    reach = angle(math.sqrt(larger((1.0 - edge) * (1.0 + edge), 0.0)), edge)
    return magnitude, cq, sq, k, slope, across, norm, reach


@formula
def density_at(entropy, shape, c, s):
    """Density over its mean in the direction (c, s) = e, and its derivatives by a_c."""
    magnitude, cq, sq, k, slope, across, norm, _ = shape
    along = c * cq + s * sq
    if entropy:
        here = exponential(k * (along - 1.0)) * norm
        # d W/d k = W (e - a_c/2), turned to d a_c
        radial = here * (along - 0.5 * magnitude) * slope
        lateral = here * (s * cq - c * sq) * across
        return here, radial * cq - lateral * sq, radial * sq + lateral * cq
    here = 1.0 + magnitude * along
    inside = here > 0.0
    return choose(inside, here, 0.0), choose(inside, c, 0.0), choose(inside, s, 0.0)
