"""Contact density of one direction for a given a_c, with derivatives: for quadratures over directions.

The harmonic density 1 + a_c.e is clipped at zero, which it reaches once |a_c| > 1; the maximum-entropy density is
``exp(k e.q)/I_0(k)`` with q the direction of a_c (see `fabric`).
"""

import math

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.fabric import concentration, scaled_bessel_zero
from granfabric.constitutive.lanes.layout import MAXIMUM_ENTROPY

NEGLIGIBLE = 42.0
"""Contact densities below exp(-42) = 6e-19 of their peak are not sampled."""


@compiled()
def shape_of(density, q1, q2):
    """What `density_at` needs, once for an a_c: kind, |a_c|, its direction (2), k, dk/d|a_c|, k/|a_c|, norm, reach.

    `reach` is the half-width of the arc around a_c that holds contacts.
    """
    magnitude = math.hypot(q1, q2)
    cq, sq = 1.0, 0.0
    if magnitude > 0.0:
        cq, sq = q1 / magnitude, q2 / magnitude
    k, slope, norm = 0.0, 1.0, 1.0
    reach = math.pi
    if density == MAXIMUM_ENTROPY:
        k, slope = concentration(magnitude)
        norm = scaled_bessel_zero(k)
        if k > 0.5 * NEGLIGIBLE:
            reach = math.acos(1.0 - NEGLIGIBLE / k)
    elif magnitude > 1.0:
        reach = math.acos(-1.0 / magnitude)
    # d k/d a_c: `slope` along a_c, k/|a_c| across
    across = k / magnitude if magnitude > 1e-8 else 1.0
    return density == MAXIMUM_ENTROPY, magnitude, cq, sq, k, slope, across, norm, reach


@compiled(inline="always")
def density_at(shape, c, s):
    """Density over its mean in the direction (c, s) = e, and its derivatives by a_c."""
    entropy, magnitude, cq, sq, k, slope, across, norm, _ = shape
    along = c * cq + s * sq
    if entropy:
        here = math.exp(k * (along - 1.0)) / norm
        # d W/d k = W (e - a_c/2), turned to d a_c
        radial = here * (along - 0.5 * magnitude) * slope
        lateral = here * (s * cq - c * sq) * across
        return here, radial * cq - lateral * sq, radial * sq + lateral * cq
    return max(1.0 + magnitude * along, 0.0), c, s
