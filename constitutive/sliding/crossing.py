"""Where within an increment a point reaches the cone of sliding.

The rates jump there, so a substep must end there: error control alone would only creep up to it. A substep that does
not slide and ends outside the cone is taken back, and its length found by a bracketed secant (the first guess from the
straight line between the ends of the stress).

A change of the strain increment moves the pseudo-time t* of the crossing. Let Y(h) be the end of the substep as a
function of its length and f = q - M (p + c). The derivatives T of the end, at fixed length, become

    T + Y' dt*,      dt* = -(grad f . T)/(grad f . Y'),

and the substep that follows, which ends where it would have ended anyway, is shorter by dt* (a share of it, if it is
taken back and shortened, by that share). This differentiates the discrete update itself, for any scheme; as substeps
shrink the two parts together tend to the jump (F- - F+) dt* of the rate equations. Y' comes from the substep done a
second time with a change of its length in the first column of the derivatives; they are linear in it.
"""

import math

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.lanes.layout import (
    COHESION,
    COLUMNS,
    CROSSED,
    GAMMA_R,
    GIVEN,
    HIGH,
    HIGH_F,
    KAPPA,
    KEPT_COLUMN,
    LOW,
    LOW_F,
    M_FIRST,
    M_PEAK,
    ON_CONE,
    REVERSED,
    SEED,
    SIDE,
    SLIDES,
    STEP,
    STEP_CHANGE,
    TIME_CHANGE,
    TRIAL,
    TRIAL_TY,
    TRIES,
    UNKNOWNS,
    WHOLE_STEP,
    L,
    Y,
)

from .cone import CONE_TOLERANCE, deviator_of, strength

ACCEPTED, TAKEN_BACK = 0, 1
_MOST_TRIES = 80
_CROSSING_TOLERANCE = 1e-14
"""Distance at which a crossing is found. One more secant step than `CONE_TOLERANCE` takes; where the cone is so narrow
that its width counts in that unit, the derivatives would notice."""
_REVERSAL_STEP = 1e-6
"""A substep in which sliding ends is halved down to this share of the increment; the rates are continuous there."""


@compiled()
def _distance(w, lane, rows):
    """q - M (p + c) and p + c of the stress in `rows`, with the M of the substep's start."""
    p, t1, t2 = deviator_of(w[rows + lane], w[rows + L + lane], w[rows + 2 * L + lane])
    m = strength(w[KAPPA + lane], w[M_FIRST + lane], w[M_PEAK + lane], w[GAMMA_R + lane])[0]
    pc = p + w[COHESION + lane]
    return math.sqrt(t1 * t1 + t2 * t2) - m * pc, pc


@compiled()
def _along_the_chord(w, lane):
    """Share of the straight line from the substep's start to its end at which it leaves the cone."""
    p0, a1, a2 = deviator_of(w[Y + lane], w[Y + L + lane], w[Y + 2 * L + lane])
    p1, b1, b2 = deviator_of(w[TRIAL + lane], w[TRIAL + L + lane], w[TRIAL + 2 * L + lane])
    m = strength(w[KAPPA + lane], w[M_FIRST + lane], w[M_PEAK + lane], w[GAMMA_R + lane])[0]
    pc, dp, d1, d2 = p0 + w[COHESION + lane], p1 - p0, b1 - a1, b2 - a2
    square = d1 * d1 + d2 * d2 - m * m * dp * dp
    half = a1 * d1 + a2 * d2 - m * m * pc * dp
    inside = m * m * pc * pc - a1 * a1 - a2 * a2
    root = half * half + square * inside
    denominator = half + math.sqrt(root) if root > 0.0 else 0.0
    share = inside / denominator if denominator > 0.0 else 0.5
    return share if 1e-9 < share < 1.0 - 1e-9 else 0.5


@compiled()
def _pass_on_time(w, lane):
    """How the end of the substep moves in pseudo-time with the strain increment; not at all if it ends as planned."""
    for column in range(COLUMNS):
        w[TIME_CHANGE + column * L + lane] += w[STEP_CHANGE + column * L + lane]


@compiled()
def judge_substep(w, lane, differentiate):
    """ACCEPTED, or TAKEN_BACK with another length of the substep in STEP; whose error is tolerable.

    `differentiate` says whether derivatives are wanted and the increment does not end here.
    """
    step = w[STEP + lane]
    if w[SLIDES + lane] > 0.0:
        if w[REVERSED + lane] > 0.0 and step > _REVERSAL_STEP:
            w[STEP + lane] = 0.5 * step
            return TAKEN_BACK
        w[ON_CONE + lane] = 1.0
        _pass_on_time(w, lane)
        return ACCEPTED
    if w[CROSSED + lane] > 0.0:
        return _found(w, lane, differentiate)
    distance, pc = _distance(w, lane, TRIAL)
    tolerance = CONE_TOLERANCE * pc
    searching = w[HIGH + lane] > 0.0
    if distance <= tolerance and not searching:
        w[ON_CONE + lane] = 1.0 if distance >= -tolerance else 0.0
        _pass_on_time(w, lane)
        return ACCEPTED
    if distance > tolerance and not searching:
        w[WHOLE_STEP + lane], w[LOW + lane] = step, 0.0
        w[LOW_F + lane], _ = _distance(w, lane, Y)
        w[HIGH + lane], w[HIGH_F + lane] = step, distance
        w[TRIES + lane], w[SIDE + lane] = 0.0, 0.0
        if w[LOW_F + lane] < -tolerance:
            w[STEP + lane] = step * _along_the_chord(w, lane)
        else:
            # it starts on the cone, goes inside and comes out: any point inside will do for the bracket
            w[STEP + lane] = 0.5 * step
        return TAKEN_BACK
    w[TRIES + lane] += 1.0
    width = w[HIGH + lane] - w[LOW + lane]
    found = abs(distance) <= _CROSSING_TOLERANCE * pc
    if found or w[TRIES + lane] > _MOST_TRIES or width <= 1e-15 * w[HIGH + lane]:
        return _found(w, lane, differentiate)
    # the end of the bracket that stays counts half from the second time on, so that it moves as well
    if distance > 0.0:
        w[LOW_F + lane] *= 0.5 if w[SIDE + lane] > 0.0 else 1.0
        w[HIGH + lane], w[HIGH_F + lane], w[SIDE + lane] = step, distance, 1.0
    else:
        w[HIGH_F + lane] *= 0.5 if w[SIDE + lane] < 0.0 else 1.0
        w[LOW + lane], w[LOW_F + lane], w[SIDE + lane] = step, distance, -1.0
    width = w[HIGH + lane] - w[LOW + lane]
    weight = w[LOW_F + lane] / (w[LOW_F + lane] - w[HIGH_F + lane])
    if not (w[LOW_F + lane] < -tolerance and 0.0 < weight < 1.0):
        weight = 0.5
    w[STEP + lane] = w[LOW + lane] + weight * width
    return TAKEN_BACK


@compiled()
def _found(w, lane, differentiate):
    """The substep ends on the cone: accepted, or to be done once more for the derivative by its length."""
    if not differentiate:
        w[ON_CONE + lane], w[CROSSED + lane] = 1.0, 1.0
        return ACCEPTED
    if w[CROSSED + lane] == 0.0:
        for i in range(UNKNOWNS):
            w[KEPT_COLUMN + i * L + lane] = w[TRIAL_TY + i * L + lane]
        # so that both summands of the column are of one size
        most = max(abs(w[GIVEN + lane]), abs(w[GIVEN + L + lane]), abs(w[GIVEN + 2 * L + lane]))
        w[CROSSED + lane], w[SEED + lane] = 1.0, 1.0 / most
        return TAKEN_BACK
    w[ON_CONE + lane] = 1.0
    _move_with_the_crossing(w, lane)
    return ACCEPTED


@compiled()
def _move_with_the_crossing(w, lane):
    """Take the change of the crossing's pseudo-time into the derivatives of the end and into TIME_CHANGE."""
    _, t1, t2 = deviator_of(w[TRIAL + lane], w[TRIAL + L + lane], w[TRIAL + 2 * L + lane])
    q = math.sqrt(t1 * t1 + t2 * t2)
    m, by_kappa, _ = strength(w[KAPPA + lane], w[M_FIRST + lane], w[M_PEAK + lane], w[GAMMA_R + lane])
    pc = -0.5 * (w[TRIAL + lane] + w[TRIAL + L + lane]) + w[COHESION + lane]
    n1, n2 = (t1 / q, t2 / q) if q > 0.0 else (0.0, 0.0)
    w[STEP_CHANGE + lane] -= w[SEED + lane]
    # the first column leaves by the seed, and what it leaves with is Y' times the seed
    for i in range(UNKNOWNS):
        moved, kept = TRIAL_TY + i * L + lane, KEPT_COLUMN + i * L + lane
        w[moved], w[kept] = w[kept], (w[moved] - w[kept]) / w[SEED + lane]
    dp, d1, d2 = deviator_of(w[KEPT_COLUMN + lane], w[KEPT_COLUMN + L + lane], w[KEPT_COLUMN + 2 * L + lane])
    speed = n1 * d1 + n2 * d2 - m * dp
    for column in range(COLUMNS):
        row = TRIAL_TY + column * UNKNOWNS * L + lane
        dp, d1, d2 = deviator_of(w[row], w[row + L], w[row + 2 * L])
        outwards = n1 * d1 + n2 * d2 - m * dp - by_kappa * pc * w[KAPPA + (1 + column) * L + lane]
        delay = -outwards / speed if speed > 0.0 else 0.0
        for i in range(UNKNOWNS):
            w[row + i * L] += w[KEPT_COLUMN + i * L + lane] * delay
        w[TIME_CHANGE + column * L + lane] += w[STEP_CHANGE + column * L + lane] + delay
