"""Where within an increment a point reaches the cone of sliding.

The rates jump there, so a substep must end there: error control alone would only creep up to it. A substep that does
not slide and ends outside the cone is taken back, and its length found by a bracketed secant (the first guess from the
straight line between the ends of the stress).

The derivatives jump as well: a change of the strain increment moves the pseudo-time t* of the crossing. With
f = q - M (p + c) and the rates F- and F+ before and after, the derivative T of the unknowns becomes

    T+ = T- + (F- - F+) dt*,      dt* = -(grad f . T-)/(grad f . F-)
"""

import math

from .compilation import compiled
from .cone_return import forget_crossing
from .lanes import (
    COHESION,
    COLUMNS,
    CROSSED,
    DECIDES,
    FORCE_CHANGE,
    GAIN,
    GAMMA_R,
    HIGH,
    HIGH_F,
    KAPPA,
    KAPPA_RATE,
    KEPT_X,
    LANES,
    LOSS,
    LOW,
    LOW_F,
    M_FIRST,
    M_PEAK,
    ON_CONE,
    RATE,
    RATE_BEFORE,
    REVERSED,
    SHIFTED_DISTRIBUTION,
    SIDE,
    SLIDES,
    STEP,
    TRIAL,
    TRIAL_KAPPA,
    TRIES,
    TY,
    UNKNOWNS,
    WHOLE_STEP,
    X1,
    X2,
    L,
    Y,
)
from .sliding import CONE_TOLERANCE, deviator_of, strength
from .stage import stage
from .weak_force_stage import turn_spread

ACCEPTED, TAKEN_BACK = 0, 1
_MOST_TRIES = 80
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
def judge_substep(w, lane):
    """ACCEPTED, or TAKEN_BACK with another length of the substep in STEP; whose error is tolerable."""
    step = w[STEP + lane]
    if w[SLIDES + lane] > 0.0:
        if w[REVERSED + lane] > 0.0 and step > _REVERSAL_STEP:
            w[STEP + lane] = 0.5 * step
            return TAKEN_BACK
        w[ON_CONE + lane] = 1.0
        return ACCEPTED
    distance, pc = _distance(w, lane, TRIAL)
    tolerance = CONE_TOLERANCE * pc
    searching = w[HIGH + lane] > 0.0
    if distance <= tolerance and not searching:
        w[ON_CONE + lane] = 1.0 if distance >= -tolerance else 0.0
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
    if abs(distance) <= tolerance or w[TRIES + lane] > _MOST_TRIES or width <= 1e-15 * w[HIGH + lane]:
        w[ON_CONE + lane], w[CROSSED + lane] = 1.0, 1.0
        return ACCEPTED
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
def any_crossed(w):
    """Whether a lane has just reached the cone."""
    crossed = 0.0
    for lane in range(LANES):
        crossed = max(crossed, w[CROSSED + lane])
    return crossed > 0.0


@compiled()
def carry_across(w, control, options, numbers, rule, solver, derivatives):
    """Add the jump to the derivatives, if there are any, of lanes that have just reached the cone; strain control.

    Other lanes are left as they are.
    """
    if not derivatives:
        for lane in range(LANES):
            # the search of another lane goes on
            if w[CROSSED + lane] > 0.0:
                forget_crossing(w, lane)
        return
    network = options[LOSS] != 0 or options[GAIN] != 0
    shifted = network and options[FORCE_CHANGE] == SHIFTED_DISTRIBUTION
    for lane in range(LANES):
        w[KEPT_X + lane], w[KEPT_X + L + lane] = w[X1 + lane], w[X2 + lane]
    for after in range(2):
        for index in range(UNKNOWNS * L):
            w[TRIAL + index] = w[Y + index]
        for lane in range(LANES):
            w[TRIAL_KAPPA + lane] = w[KAPPA + lane]
            w[DECIDES + lane] = 0.0
            w[SLIDES + lane] = 1.0 if after == 1 and w[CROSSED + lane] > 0.0 else 0.0
        stage(w, control, False, options, numbers, False, rule, solver)
        if after == 0:
            for index in range(UNKNOWNS * L):
                w[RATE_BEFORE + index] = w[RATE + index]
    for lane in range(LANES):
        w[X1 + lane], w[X2 + lane] = w[KEPT_X + lane], w[KEPT_X + L + lane]
        if w[CROSSED + lane] == 0.0:
            continue
        forget_crossing(w, lane)
        _, t1, t2 = deviator_of(w[Y + lane], w[Y + L + lane], w[Y + 2 * L + lane])
        q = math.sqrt(t1 * t1 + t2 * t2)
        m = strength(w[KAPPA + lane], w[M_FIRST + lane], w[M_PEAK + lane], w[GAMMA_R + lane])[0]
        dp, d1, d2 = deviator_of(
            w[RATE_BEFORE + lane], w[RATE_BEFORE + L + lane], w[RATE_BEFORE + 2 * L + lane]
        )
        speed = (t1 * d1 + t2 * d2) / q - m * dp if q > 0.0 else 0.0
        if speed > 0.0:
            for column in range(COLUMNS):
                row = TY + column * UNKNOWNS * L + lane
                dp, d1, d2 = deviator_of(w[row], w[row + L], w[row + 2 * L])
                delay = -((t1 * d1 + t2 * d2) / q - m * dp) / speed
                for i in range(UNKNOWNS):
                    w[row + i * L] += (w[RATE_BEFORE + i * L + lane] - w[RATE + i * L + lane]) * delay
                w[KAPPA + (1 + column) * L + lane] -= w[KAPPA_RATE + lane] * delay
            if shifted:
                turn_spread(w, lane, options, numbers)
