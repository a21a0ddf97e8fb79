"""A point's part of sliding into its lane, and what is refused before anything is computed."""

import math

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.contract import Status
from granfabric.constitutive.lanes.layout import (
    COHESION,
    COLUMNS,
    CROSSED,
    DILATANCY,
    EXPONENT,
    GAMMA_R,
    GIVEN,
    HIGH,
    KAPPA,
    M_CV,
    M_FIRST,
    M_PEAK,
    ON_CONE,
    PLANNED_STEP,
    PLASTIC_SUMS,
    TIME_CHANGE,
    TRIES,
    L,
    Y,
)
from granfabric.constitutive.lanes.load import (
    M_KAPPA,
    PAR_COHESION,
    PAR_DILATANCY,
    PAR_EXPONENT,
    PAR_GAMMA_R,
    PAR_M_CV,
    PAR_M_FIRST,
    PAR_M_PEAK,
)

from .cone import AXIS_TOLERANCE, CONE_TOLERANCE, LOAD_TOLERANCE, deviator_of, strength

_BEYOND_PEAK = int(Status.BEYOND_PEAK)


@compiled()
def load_sliding(w, lane, point, state_start, par, micro_of_column, control, mixed):
    """Sliding's part of a point into its lane; OK, or BEYOND_PEAK if the stress is or shall go outside the cone."""
    kappa = 0.0
    for i in range(state_start.shape[1]):
        if micro_of_column[i] == M_KAPPA:
            kappa = state_start[point, i]
    first, peak, reference, cohesion = par[PAR_M_FIRST], par[PAR_M_PEAK], par[PAR_GAMMA_R], par[PAR_COHESION]
    w[M_FIRST + lane], w[M_PEAK + lane], w[GAMMA_R + lane], w[COHESION + lane] = first, peak, reference, cohesion
    w[DILATANCY + lane], w[M_CV + lane] = par[PAR_DILATANCY], par[PAR_M_CV]
    w[EXPONENT + lane] = par[PAR_EXPONENT]
    w[KAPPA + lane] = kappa
    for column in range(COLUMNS):
        w[KAPPA + (1 + column) * L + lane] = 0.0
    for row in range(2):
        w[PLASTIC_SUMS + row * L + lane] = 0.0
    w[PLANNED_STEP + lane] = 0.0
    for column in range(COLUMNS):
        w[TIME_CHANGE + column * L + lane] = 0.0
    forget_crossing(w, lane)
    p, t1, t2 = deviator_of(w[Y + lane], w[Y + L + lane], w[Y + 2 * L + lane])
    distance = math.sqrt(t1 * t1 + t2 * t2) / (p + cohesion) - strength(kappa, first, peak, reference)[0]
    w[ON_CONE + lane] = 1.0 if distance >= -CONE_TOLERANCE else 0.0
    if not distance <= LOAD_TOLERANCE:
        return _BEYOND_PEAK
    if mixed and _no_stress_within_the_peak(w, lane, control, peak, cohesion):
        return _BEYOND_PEAK
    return 0


@compiled()
def _no_stress_within_the_peak(w, lane, control, peak, cohesion):
    """Whether the given components of the end stress are outside the cone at its peak, whatever the others are.

    With x, y the normal stresses plus cohesion, compression positive, and s the shear stress, the cone at its peak is
    ((x - y)/2)^2 + s^2 < M^2 ((x + y)/2)^2, x + y > 0. If y is free, the best one is x (1 + M^2)/(1 - M^2) and leaves
    s^2 (1 - M^2) < M^2 x^2; if s is free, the best one is zero. Towards such an end strain grows without bound.
    """
    x = -w[Y + lane] - w[GIVEN + lane] + cohesion
    y = -w[Y + L + lane] - w[GIVEN + L + lane] + cohesion
    s = w[Y + 2 * L + lane] + w[GIVEN + 2 * L + lane]
    has_x, has_y, has_s = control[0] == 1, control[1] == 1, control[2] == 1
    if has_x and has_y:
        end, half = 0.5 * (x + y), 0.5 * (x - y)
        if end <= 0.0:
            # on the straight way there the cone is left first, unless the way leads through its apex
            start = end + 0.5 * (w[GIVEN + lane] + w[GIVEN + L + lane])
            back = -end / (start - end)
            half += back * 0.5 * (w[GIVEN + lane] - w[GIVEN + L + lane])
            s -= back * w[GIVEN + 2 * L + lane]
            return math.hypot(half, s if has_s else 0.0) > AXIS_TOLERANCE * start
        return math.hypot(half, s if has_s else 0.0) >= peak * end
    if not (has_x or has_y):
        return False
    known = x if has_x else y
    return known <= 0.0 or (has_s and s * s * (1.0 - peak * peak) >= peak * peak * known * known)


@compiled()
def forget_crossing(w, lane):
    """No search for a crossing is under way."""
    w[HIGH + lane], w[TRIES + lane], w[CROSSED + lane] = 0.0, 0.0, 0.0
