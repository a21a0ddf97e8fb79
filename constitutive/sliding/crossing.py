"""Where within an increment a point reaches the cone of sliding.

The rates jump there, so a substep must end there: error control alone would only creep up to it. A substep that does
not slide and ends outside the cone is taken back, and its length found by a bracketed secant (the first guess from the
straight line between the ends of the stress).

A change of the strain increment moves the pseudo-time t* of the crossing. Let Y(h) be the end of the substep as a
function of its length and f = q - M (p + c). The derivatives T of the end, at fixed length, become

    T + Y' dt*,      dt* = -(grad f . T)/(grad f . Y'),

and the substep that follows, which ends where it would have ended anyway, is shorter by dt* (a fraction of it, if it is
taken back and shortened, by that fraction). This differentiates the discrete update itself, for any scheme; as substeps
shrink the two parts together tend to the jump (F- - F+) dt* of the rate equations. Y' comes from the substep done a
second time with a change of its length in the first column of the derivatives; they are linear in it.
"""

import math

from granfabric.constitutive.compilation import formula

from .cone import CONE_TOLERANCE, strength

ACCEPTED, TAKEN_BACK = 0, 1
_MOST_TRIES = 80
_CROSSING_TOLERANCE = 1e-14
"""Distance at which a crossing is found. One more secant step than `CONE_TOLERANCE` takes; where the cone is so narrow
that its width counts in that unit, the derivatives would notice."""
_REVERSAL_STEP = 1e-6
"""A substep in which sliding ends is halved down to this fraction of the increment; the rates are continuous there."""
_UNKNOWNS = 6


@formula
def _strength(slide, lane):
    """M and its derivatives at the start of the substep."""
    return strength(
        slide["kappa"][0, lane], slide["first"][0, lane], slide["peak"][0, lane], slide["reference"][0, lane]
    )


@formula
def _distance(state, slide, lane):
    """q - M (p + c) and p + c of the stress in the first rows of `state`, with the M of the substep's start."""
    p, t1, t2 = state[0, lane], state[1, lane], state[2, lane]
    m = _strength(slide, lane)[0]
    pc = p + slide["cohesion"][0, lane]
    return math.sqrt(t1 * t1 + t2 * t2) - m * pc, pc


@formula
def _along_the_chord(y, trial, slide, lane):
    """Fraction of the straight line from the substep's start to its end at which it leaves the cone."""
    p0, a1, a2 = y[0, lane], y[1, lane], y[2, lane]
    m = _strength(slide, lane)[0]
    pc, dp, d1, d2 = p0 + slide["cohesion"][0, lane], trial[0, lane] - p0, trial[1, lane] - a1, trial[2, lane] - a2
    square = d1 * d1 + d2 * d2 - m * m * dp * dp
    half = a1 * d1 + a2 * d2 - m * m * pc * dp
    inside = m * m * pc * pc - a1 * a1 - a2 * a2
    root = half * half + square * inside
    denominator = half + math.sqrt(root) if root > 0.0 else 0.0
    share = inside / denominator if denominator > 0.0 else 0.5
    return share if 1e-9 < share < 1.0 - 1e-9 else 0.5


@formula
def _pass_on_time(slide, lane):
    """How the end of the substep moves in pseudo-time with the strain increment; not at all if it ends as planned."""
    for column in range(3):
        slide["time_change"][column, lane] += slide["step_change"][column, lane]


@formula
def forget_crossing(slide, lane):
    """No search for a crossing is under way."""
    slide["high"][0, lane], slide["tries"][0, lane], slide["crossed"][0, lane] = 0.0, 0.0, 0.0


@formula
def judge_substep(step, y, trial, largest, slide, lane, differentiate):
    """ACCEPTED or TAKEN_BACK, and the length of the substep to try next; the substep's error is tolerable.

    Parameters
    ----------
    step : float
        Length of the substep.
    y, trial : ndarray
        Its start and its end.
    largest : float
        Largest component of the strain increment.
    slide : record
    lane : int
    differentiate : bool
        Whether derivatives are wanted and the increment does not end here.
    """
    if slide["slides"][0, lane] > 0.5:
        if slide["turned_back"][0, lane] > 0.5 and step > _REVERSAL_STEP:
            return TAKEN_BACK, 0.5 * step
        slide["on_cone"][0, lane] = 1.0
        _pass_on_time(slide, lane)
        return ACCEPTED, step
    if slide["crossed"][0, lane] > 0.5:
        return _found(trial, largest, slide, lane, differentiate), step
    distance, pc = _distance(trial, slide, lane)
    tolerance = CONE_TOLERANCE * pc
    searching = slide["high"][0, lane] > 0.0
    if distance <= tolerance and not searching:
        slide["on_cone"][0, lane] = 1.0 * (distance >= -tolerance)
        _pass_on_time(slide, lane)
        return ACCEPTED, step
    if distance > tolerance and not searching:
        slide["whole_step"][0, lane], slide["low"][0, lane] = step, 0.0
        slide["low_f"][0, lane], _ = _distance(y, slide, lane)
        slide["high"][0, lane], slide["high_f"][0, lane] = step, distance
        slide["tries"][0, lane], slide["side"][0, lane] = 0.0, 0.0
        if slide["low_f"][0, lane] < -tolerance:
            return TAKEN_BACK, step * _along_the_chord(y, trial, slide, lane)
        # it starts on the cone, goes inside and comes out: any point inside will do for the bracket
        return TAKEN_BACK, 0.5 * step
    slide["tries"][0, lane] += 1.0
    width = slide["high"][0, lane] - slide["low"][0, lane]
    found = abs(distance) <= _CROSSING_TOLERANCE * pc
    if found or slide["tries"][0, lane] > _MOST_TRIES or width <= 1e-15 * slide["high"][0, lane]:
        return _found(trial, largest, slide, lane, differentiate), step
    # the end of the bracket that stays counts half from the second time on, so that it moves as well
    if distance > 0.0:
        slide["low_f"][0, lane] *= 0.5 if slide["side"][0, lane] > 0.0 else 1.0
        slide["high"][0, lane], slide["high_f"][0, lane], slide["side"][0, lane] = step, distance, 1.0
    else:
        slide["high_f"][0, lane] *= 0.5 if slide["side"][0, lane] < 0.0 else 1.0
        slide["low"][0, lane], slide["low_f"][0, lane], slide["side"][0, lane] = step, distance, -1.0
    width = slide["high"][0, lane] - slide["low"][0, lane]
    weight = slide["low_f"][0, lane] / (slide["low_f"][0, lane] - slide["high_f"][0, lane])
    if not (slide["low_f"][0, lane] < -tolerance and 0.0 < weight < 1.0):
        weight = 0.5
    return TAKEN_BACK, slide["low"][0, lane] + weight * width


@formula
def _found(trial, largest, slide, lane, differentiate):
    """The substep ends on the cone: accepted, or to be done once more for the derivative by its length."""
    if not differentiate:
        slide["on_cone"][0, lane], slide["crossed"][0, lane] = 1.0, 1.0
        return ACCEPTED
    if slide["crossed"][0, lane] < 0.5:
        for i in range(_UNKNOWNS):
            slide["kept"][i, lane] = trial[_UNKNOWNS + i, lane]
        # so that both summands of the column are of one size
        slide["crossed"][0, lane], slide["seed"][0, lane] = 1.0, 1.0 / largest
        return TAKEN_BACK
    slide["on_cone"][0, lane] = 1.0
    _move_with_the_crossing(trial, slide, lane)
    return ACCEPTED


@formula
def _move_with_the_crossing(trial, slide, lane):
    """Take the change of the crossing's pseudo-time into the derivatives of the end and into `time_change`."""
    p, t1, t2 = trial[0, lane], trial[1, lane], trial[2, lane]
    q = math.sqrt(t1 * t1 + t2 * t2)
    m, by_kappa, _ = _strength(slide, lane)
    pc = p + slide["cohesion"][0, lane]
    n1, n2 = (t1 / q, t2 / q) if q > 0.0 else (0.0, 0.0)
    slide["step_change"][0, lane] -= slide["seed"][0, lane]
    # the first column leaves by the seed, and what it leaves with is Y' times the seed
    for i in range(_UNKNOWNS):
        moved, kept = trial[_UNKNOWNS + i, lane], slide["kept"][i, lane]
        trial[_UNKNOWNS + i, lane], slide["kept"][i, lane] = kept, (moved - kept) / slide["seed"][0, lane]
    speed = n1 * slide["kept"][1, lane] + n2 * slide["kept"][2, lane] - m * slide["kept"][0, lane]
    for column in range(3):
        row = _UNKNOWNS * (1 + column)
        outwards = n1 * trial[row + 1, lane] + n2 * trial[row + 2, lane] - m * trial[row, lane]
        outwards -= by_kappa * pc * slide["kappa_by"][column, lane]
        delay = -outwards / speed if speed > 0.0 else 0.0
        for i in range(_UNKNOWNS):
            trial[row + i, lane] += slide["kept"][i, lane] * delay
        slide["time_change"][column, lane] += slide["step_change"][column, lane] + delay
