"""A point's part of sliding, and what is refused before anything is computed."""

import math

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.contract import Status
from granfabric.constitutive.material_table import (
    PAR_COHESION,
    PAR_DILATANCY,
    PAR_EXPONENT,
    PAR_GAMMA_R,
    PAR_M_CV,
    PAR_M_FIRST,
    PAR_M_PEAK,
)
from granfabric.constitutive.stiffness import invariants

from .cone import AXIS_TOLERANCE, CONE_TOLERANCE, LOAD_TOLERANCE, strength
from .crossing import forget_crossing

_BEYOND_PEAK = int(Status.BEYOND_PEAK)


@formula
def load_sliding(slide, lane, kappa, stress, par, given, stressed):
    """Fill `slide` for a point; OK, or BEYOND_PEAK if the stress is or shall go outside the cone.

    Parameters
    ----------
    slide : record
    lane : int
    kappa : float
        Hardening strain at the start.
    stress, given : tuples of 3
        Start stress and increment, xx, yy, xy, tension positive.
    par : ndarray
        Row of the table of materials.
    stressed : tuple of 3
        Which components of the increment are of stress.
    """
    first, peak, reference, cohesion = par[PAR_M_FIRST], par[PAR_M_PEAK], par[PAR_GAMMA_R], par[PAR_COHESION]
    slide["first"][0, lane], slide["peak"][0, lane] = first, peak
    slide["reference"][0, lane], slide["cohesion"][0, lane] = reference, cohesion
    slide["dilatancy"][0, lane], slide["constant"][0, lane] = par[PAR_DILATANCY], par[PAR_M_CV]
    slide["exponent"][0, lane], slide["kappa"][0, lane] = par[PAR_EXPONENT], kappa
    slide["volume"][0, lane], slide["work"][0, lane], slide["planned_step"][0, lane] = 0.0, 0.0, 0.0
    for column in range(3):
        slide["kappa_by"][column, lane], slide["time_change"][column, lane] = 0.0, 0.0
    forget_crossing(slide, lane)
    p, t1, t2 = invariants(stress[0], stress[1], stress[2])
    distance = math.sqrt(t1 * t1 + t2 * t2) / (p + cohesion) - strength(kappa, first, peak, reference)[0]
    slide["on_cone"][0, lane] = 1.0 * (distance >= -CONE_TOLERANCE)
    slide["slides"][0, lane] = 0.0
    if not distance <= LOAD_TOLERANCE:
        return _BEYOND_PEAK
    if _no_stress_within_the_peak(stress, given, stressed, peak, cohesion):
        return _BEYOND_PEAK
    return 0


@formula
def _no_stress_within_the_peak(stress, given, stressed, peak, cohesion):
    """Whether the given components of the end stress are outside the cone at its peak, whatever the others are.

    With x, y the normal stresses plus cohesion, compression positive, and s the shear stress, the cone at its peak is
    ((x - y)/2)^2 + s^2 < M^2 ((x + y)/2)^2, x + y > 0. If y is free, the best one is x (1 + M^2)/(1 - M^2) and leaves
    s^2 (1 - M^2) < M^2 x^2; if s is free, the best one is zero. Towards such an end strain grows without bound.
    """
    x = -stress[0] - given[0] + cohesion
    y = -stress[1] - given[1] + cohesion
    s = stress[2] + given[2]
    has_x, has_y, has_s = stressed
    if has_x and has_y:
        end, half = 0.5 * (x + y), 0.5 * (x - y)
        if end <= 0.0:
            # on the straight way there the cone is left first, unless the way leads through its apex
            start = end + 0.5 * (given[0] + given[1])
            back = -end / (start - end)
            half += back * 0.5 * (given[0] - given[1])
            s -= back * given[2]
            return math.hypot(half, s if has_s else 0.0) > AXIS_TOLERANCE * start
        return math.hypot(half, s if has_s else 0.0) >= peak * end
    if not (has_x or has_y):
        return False
    known = x if has_x else y
    return known <= 0.0 or (has_s and s * s * (1.0 - peak * peak) >= peak * peak * known * known)
