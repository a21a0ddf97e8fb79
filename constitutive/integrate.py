"""Update of many points over an increment: an embedded Runge-Kutta pair over stress and micro-state together.

Every lane of a workspace holds one point at its own pseudo-time with its own substep; a lane whose point has arrived
takes the next one at once, so that points that need many substeps do not hold up the others. What is gained and lost,
and the strain, are integrated with the same weights as the unknowns; z(end) = z(start) + gained - lost therefore
holds to rounding. a_n, a_t and f follow from the end values: their closure [Pouragha & Wan 2017, eq. 7 and section
3.3] is an exact differential.
"""

import math

import numpy as np

from .compilation import compiled
from .contract import Status
from .lanes import (
    ACCEPT,
    ADVANCED,
    C_E,
    C_N,
    CHI,
    CHI_P,
    ERROR,
    EXTRAS,
    FEEDBACK,
    FLOOR,
    FORCE_CHANGE,
    GAIN,
    GIVEN,
    KERNEL_OPTIONS,
    LANES,
    LARGEST_S,
    LOSS,
    MEASURE,
    ORIGIN_A1,
    ORIGIN_A2,
    ORIGIN_Z,
    OUTCOME,
    P_ZERO,
    RATE,
    RATES,
    REFERENCE_A1,
    REFERENCE_A2,
    REFERENCE_Z,
    ROTATION,
    SHIFTED_DISTRIBUTION,
    SIZE,
    SLOT,
    SLOT_SCALE,
    STAGE,
    START_P,
    START_S1,
    START_S2,
    STEP,
    SUMS,
    TRIAL,
    TY,
    UNKNOWNS,
    WORST,
    X1,
    X2,
    L,
    Y,
)
from .load_lane import (
    M_A1,
    M_A2,
    M_F,
    M_GAINED,
    M_LARGEST_S,
    M_LOST,
    M_N1,
    M_N2,
    M_SHIFT,
    M_SPREAD,
    M_T1,
    M_T2,
    M_Z,
    MICRO,
    load_idle,
    load_point,
    stiffness_of,
)
from .runge_kutta import (
    APEX_FRACTION,
    FAILED_STAGE_FACTOR,
    LARGEST_CHANGE,
    MAX_FACTOR,
    MIN_FACTOR,
    SAFETY,
    SMALLEST_SUBSTEP,
)
from .shifted_distribution import network_of, split_change
from .stage import stage
from .stiffness import stress_invariants
from .weak_force_stage import shift_and_gain

OK = int(Status.OK)
LIMITED = int(Status.LIMITED)
NO_PRESSURE = int(Status.NO_PRESSURE)
NOT_ADMISSIBLE = int(Status.NOT_ADMISSIBLE)
TOO_MANY_SUBSTEPS = int(Status.TOO_MANY_SUBSTEPS)
NOT_FINITE = int(Status.NOT_FINITE)
NOT_CONVERGED = int(Status.NOT_CONVERGED)

_NOT_NEGATIVE = 0x7FFFFFFF

TANGENT_NONE, TANGENT_PROPAGATED, TANGENT_CONTINUUM, TANGENT_ELASTIC = range(4)


@compiled(inline="always", **KERNEL_OPTIONS)
def _attempt(w, control, mixed, options, numbers, derivatives, tableau, rule, solver):
    """All stages of one substep from rows Y, TY over rows STEP; leaves the end in TRIAL, the worst status in WORST."""
    a, b = tableau[0], tableau[1]
    stages = b.shape[0]
    for lane in range(LANES):
        w[WORST + lane] = 0.0
    for row in range(1, ADVANCED):
        for lane in range(LANES):
            w[STEP + row * L + lane] = w[STEP + lane]
    for i in range(stages):
        # a stage that only estimates the error needs no derivatives
        with_derivatives = derivatives and (b[i] != 0.0 or i < stages - 1)
        _advance(w, ADVANCED if with_derivatives else UNKNOWNS, i, a[i])
        stage(w, control, mixed, options, numbers, with_derivatives, rule, solver)
        keep = STAGE + i * RATES * L
        for index in range(RATES * L):
            w[keep + index] = w[RATE + index]
        for lane in range(LANES):
            worst, outcome = w[WORST + lane], w[OUTCOME + lane]
            w[WORST + lane] = worst if worst > outcome else outcome
    _advance(w, ADVANCED if derivatives else UNKNOWNS, stages, b)


@compiled(inline="always", **KERNEL_OPTIONS)
def _add_scaled(w, target, source, factor, number):
    """w[target ...] += factor w[source ...]; the mask tells the compiler that no index is negative."""
    target, source = target & _NOT_NEGATIVE, source & _NOT_NEGATIVE
    for index in range(number):
        w[target + index] += factor * w[source + index]


@compiled(**KERNEL_OPTIONS)
def _advance(w, rows, stages, coefficients):
    """TRIAL = Y + h sum c_m K_m in the first `rows` rows, over the first `stages` stages."""
    for index in range(rows * L):
        w[TRIAL + index] = 0.0
    for m in range(stages):
        # stages without weight may hold no derivatives
        if coefficients[m] != 0.0:
            _add_scaled(w, TRIAL, STAGE + m * RATES * L, coefficients[m], rows * L)
    for index in range(rows * L):
        w[TRIAL + index] = w[Y + index] + w[STEP + index] * w[TRIAL + index]


@compiled(inline="always", **KERNEL_OPTIONS)
def _larger_change(change, new, limit):
    """Larger of the two relative to what a substep may change; NaN wins."""
    new = abs(new) / limit
    return change if new <= change else new


@compiled(inline="always", **KERNEL_OPTIONS)
def _larger(measure, error, step, scale):
    """Larger of the two in units of `scale`; NaN wins."""
    new = abs(step * error) / scale
    return measure if new <= measure else new


@compiled(**KERNEL_OPTIONS)
def _estimate(w, error, tolerance, shifted):
    """Error of the substep in units of the tolerance (stress relative to p, z relative, a_c absolute); end state."""
    for index in range(UNKNOWNS * L):
        w[ERROR + index] = 0.0
    for m in range(error.shape[0]):
        _add_scaled(w, ERROR, STAGE + m * RATES * L, error[m], UNKNOWNS * L)
    for lane in range(LANES):
        h = w[STEP + lane]
        p = -0.5 * tolerance * (w[Y + lane] + w[Y + L + lane])
        measure = _larger(0.0, w[ERROR + lane], h, p)
        measure = _larger(measure, w[ERROR + L + lane], h, p)
        measure = _larger(measure, w[ERROR + 2 * L + lane], h, p)
        measure = _larger(measure, w[ERROR + 3 * L + lane], h, tolerance * w[SLOT_SCALE + lane])
        measure = _larger(measure, w[ERROR + 4 * L + lane], h, tolerance)
        measure = _larger(measure, w[ERROR + 5 * L + lane], h, tolerance)
        start, end = -0.5 * (w[Y + lane] + w[Y + L + lane]), -0.5 * (w[TRIAL + lane] + w[TRIAL + L + lane])
        change = _larger_change(0.0, end - start, LARGEST_CHANGE * start)
        growth = w[TRIAL + 3 * L + lane] - w[Y + 3 * L + lane]
        change = _larger_change(change, growth, LARGEST_CHANGE * w[SLOT_SCALE + lane])
        change = _larger_change(change, w[TRIAL + 4 * L + lane] - w[Y + 4 * L + lane], LARGEST_CHANGE)
        change = _larger_change(change, w[TRIAL + 5 * L + lane] - w[Y + 5 * L + lane], LARGEST_CHANGE)
        # so that the next substep is shorter by this factor, for an estimate of order two
        change = change * change * change
        w[MEASURE + lane] = measure if measure > change or change <= 1.0 else change
        z, a1, a2 = w[TRIAL + 3 * L + lane], w[TRIAL + 4 * L + lane], w[TRIAL + 5 * L + lane]
        outcome = w[WORST + lane]
        inside = z > 0.0 and a1 * a1 + a2 * a2 < 4.0
        admissible = (inside or shifted) and measure < math.inf
        pressure = end > w[FLOOR + lane]
        fine = outcome <= LIMITED
        outcome = outcome if admissible or not fine else float(NOT_ADMISSIBLE)
        w[WORST + lane] = outcome if pressure or not fine else float(NO_PRESSURE)


@compiled()
def _step_factor(measure, error_order):
    """Factor to the next substep from the error of the last in units of the tolerance."""
    if measure <= 0.0:
        return MAX_FACTOR
    return min(MAX_FACTOR, max(MIN_FACTOR, SAFETY * measure ** (-1.0 / (error_order + 1.0))))


@compiled(**KERNEL_OPTIONS)
def _accept(w, b, derivatives):
    """Move the accepted lanes to the end of their substep."""
    rows = ADVANCED if derivatives else UNKNOWNS
    accepted = 0
    for lane in range(LANES):
        accepted += 1 if w[ACCEPT + lane] > 0.0 else 0
    if accepted == LANES:
        for index in range(rows * L):
            w[Y + index] = w[TRIAL + index]
        for m in range(b.shape[0]):
            kept = (STAGE + (m * RATES + ADVANCED) * L) & _NOT_NEGATIVE
            for index in range(EXTRAS * L):
                w[SUMS + index] += w[STEP + index] * b[m] * w[kept + index]
        return
    for lane in range(LANES):
        if w[ACCEPT + lane] > 0.0:
            for row in range(rows):
                w[Y + row * L + lane] = w[TRIAL + row * L + lane]
            for m in range(b.shape[0]):
                for row in range(EXTRAS):
                    kept = STAGE + (m * RATES + ADVANCED + row) * L
                    w[SUMS + row * L + lane] += w[STEP + lane] * b[m] * w[kept + lane]


@compiled(nogil=True, **KERNEL_OPTIONS)
def update_points(
    first,
    end,
    given,
    control,
    mixed,
    stress_start,
    state_start,
    stress_end,
    state_end,
    strain_increment,
    tangent,
    tangent_kind,
    material_index,
    table,
    micro_of_column,
    options,
    numbers,
    tableau,
    numerics,
    rule,
    status,
    counts,
):
    """Advance the points from `first` up to, not including, `end`; see `law.ContactLaw` for the arrays.

    `control` is (npt, 3) if `mixed`, else (1, 3); `strain_increment` is written if `mixed`; `tangent` according to
    `tangent_kind`; `status` (npt,) and `counts` (npt, 2: accepted and rejected substeps) are written. `tableau` holds
    a, b, error, error order; `numerics` the tolerance, the number of fixed substeps, the largest number of substeps.
    Runs without the interpreter's lock, so that threads can share a batch; a point's result does not depend on how.
    """
    b, error, error_order = tableau[1], tableau[2], tableau[3]
    derivatives = tangent_kind == TANGENT_PROPAGATED
    tolerance, planned, most = numerics[0], int(numerics[1]), int(numerics[2])
    fixed = planned > 0
    network = options[LOSS] != 0 or options[GAIN] != 0
    shifted = network and options[FORCE_CHANGE] == SHIFTED_DISTRIBUTION
    resolved = np.empty(20)
    w = np.zeros(SIZE)
    micro = np.zeros(MICRO)
    solver = np.zeros((3, 4))
    lane_control = np.zeros((LANES, 3), dtype=np.uint8)
    point_of = np.full(LANES, -1, dtype=np.int64)
    time = np.zeros(LANES)
    last = np.zeros(LANES, dtype=np.bool_)
    following = first
    for lane in range(LANES):
        load_idle(w, lane)
    while True:
        active = 0
        for lane in range(LANES):
            while point_of[lane] < 0 and following < end:
                point = following
                following += 1
                par = table[material_index[point]]
                outcome = load_point(
                    w, lane, point, given, stress_start, state_start, par, micro_of_column, options, numbers
                )
                if tangent_kind != TANGENT_NONE:
                    stiffness_of(w, lane, outcome != NOT_FINITE, tangent[point])
                at_rest = given[point, 0] == 0.0 and given[point, 1] == 0.0 and given[point, 2] == 0.0
                if at_rest or outcome > LIMITED:
                    status[point] = outcome
                    for i in range(3):
                        stress_end[point, i] = stress_start[point, i]
                    for i in range(state_start.shape[1]):
                        state_end[point, i] = state_start[point, i]
                    if mixed:
                        for i in range(3):
                            strain_increment[point, i] = 0.0
                    if following >= end:
                        load_idle(w, lane)
                    continue
                point_of[lane] = point
                time[lane] = 0.0
                w[STEP + lane] = 1.0 / planned if fixed else 1.0
                status[point] = OK
                if mixed:
                    for i in range(3):
                        lane_control[lane, i] = control[point, i]
            if point_of[lane] >= 0:
                active += 1
                remaining = 1.0 - time[lane]
                if fixed:
                    last[lane] = counts[point_of[lane], 0] == planned - 1
                else:
                    last[lane] = w[STEP + lane] >= remaining * (1.0 - 1e-12)
                    if last[lane]:
                        w[STEP + lane] = remaining
        if active == 0:
            break
        _attempt(w, lane_control, mixed, options, numbers, derivatives, tableau, rule, solver)
        _estimate(w, error, tolerance, shifted)
        for lane in range(LANES):
            point = point_of[lane]
            w[ACCEPT + lane] = 0.0
            if point < 0:
                continue
            failed = w[WORST + lane] > LIMITED
            if not failed and (fixed or w[MEASURE + lane] <= 1.0):
                w[ACCEPT + lane] = 1.0
                status[point] = max(status[point], int(w[WORST + lane]))
                counts[point, 0] += 1
                continue
            counts[point, 1] += 1
            w[STEP + lane] *= FAILED_STAGE_FACTOR if failed else _step_factor(w[MEASURE + lane], error_order)
            if fixed or w[STEP + lane] < SMALLEST_SUBSTEP or counts[point, 0] + counts[point, 1] >= most:
                status[point] = int(w[WORST + lane]) if failed else TOO_MANY_SUBSTEPS
                p = -0.5 * (w[Y + lane] + w[Y + L + lane])
                if not fixed and w[STEP + lane] < SMALLEST_SUBSTEP and p < APEX_FRACTION * w[START_P + lane]:
                    status[point] = NO_PRESSURE
        _accept(w, b, derivatives)
        for lane in range(LANES):
            point = point_of[lane]
            if point < 0:
                continue
            if w[ACCEPT + lane] > 0.0:
                time[lane] += w[STEP + lane]
                w[SLOT_SCALE + lane] = 1.0 if shifted else w[Y + 3 * L + lane]
                if shifted:
                    _, s1, s2 = stress_invariants(w[Y + lane], w[Y + L + lane], w[Y + 2 * L + lane])
                    w[LARGEST_S + lane] = max(w[LARGEST_S + lane], math.sqrt(s1 * s1 + s2 * s2))
                if not last[lane]:
                    if counts[point, 0] + counts[point, 1] >= most:
                        status[point] = TOO_MANY_SUBSTEPS
                    elif not fixed:
                        w[STEP + lane] *= _step_factor(w[MEASURE + lane], error_order)
            elif status[point] <= LIMITED:
                continue
            if status[point] > LIMITED:
                for i in range(3):
                    stress_end[point, i] = stress_start[point, i]
                    if mixed:
                        strain_increment[point, i] = 0.0
                for i in range(state_start.shape[1]):
                    state_end[point, i] = state_start[point, i]
            elif last[lane]:
                if shifted and not _network_at_end(
                    w, lane, mixed, lane_control[lane], stress_start, point, numbers, rule, resolved
                ):
                    status[point] = NOT_CONVERGED
                    for i in range(3):
                        stress_end[point, i] = stress_start[point, i]
                        if mixed:
                            strain_increment[point, i] = 0.0
                    for i in range(state_start.shape[1]):
                        state_end[point, i] = state_start[point, i]
                    point_of[lane] = -1
                    if following >= end:
                        load_idle(w, lane)
                    continue
                _finish(
                    w,
                    lane,
                    point,
                    mixed,
                    lane_control[lane],
                    options,
                    stress_start,
                    state_start,
                    micro_of_column,
                    micro,
                )
                if shifted:
                    _finish_weak_forces(w, lane, numbers, rule, resolved, state_start, point, micro_of_column, micro)
                for i in range(3):
                    stress_end[point, i] = w[Y + i * L + lane]
                    if mixed:
                        strain_increment[point, i] = (
                            given[point, i] if lane_control[lane, i] == 0 else w[SUMS + (6 + i) * L + lane]
                        )
                for i in range(state_start.shape[1]):
                    state_end[point, i] = micro[micro_of_column[i]]
                if derivatives:
                    for j in range(3):
                        for i in range(3):
                            tangent[point, i, j] = w[TY + (j * UNKNOWNS + i) * L + lane]
                elif tangent_kind == TANGENT_CONTINUUM:
                    if options[FEEDBACK] != 0:
                        w[REFERENCE_Z + lane], w[REFERENCE_A1 + lane] = micro[M_Z], micro[M_A1]
                        w[REFERENCE_A2 + lane] = micro[M_A2]
                    stiffness_of(w, lane, True, tangent[point])
            else:
                continue
            point_of[lane] = -1
            if following >= end:
                load_idle(w, lane)


@compiled(**KERNEL_OPTIONS)
def _finish(w, lane, point, mixed, control, options, stress_start, state_start, micro_of_column, micro):
    """End values of a lane: the micro-state into `micro`, prescribed stresses without accumulated rounding."""
    for i in range(state_start.shape[1]):
        micro[micro_of_column[i]] = state_start[point, i]
    if mixed:
        for i in range(3):
            if control[i] == 1:
                w[Y + i * L + lane] = stress_start[point, i] + w[GIVEN + i * L + lane]
    p0 = -0.5 * (stress_start[point, 0] + stress_start[point, 1])
    p, s1, s2 = stress_invariants(w[Y + lane], w[Y + L + lane], w[Y + 2 * L + lane])
    # z, a_c; with shifted weak forces put there by `_network_at_end`
    z, a1, a2 = w[Y + 3 * L + lane], w[Y + 4 * L + lane], w[Y + 5 * L + lane]
    ds1, ds2 = s1 - w[START_S1 + lane], s2 - w[START_S2 + lane]
    if options[ROTATION] == 0:
        ds2 = 0.0
    c_n = w[C_N + lane]
    micro[M_F] *= (p / p0) * (micro[M_Z] / z)
    micro[M_N1] += c_n * ds1
    micro[M_N2] += c_n * ds2
    micro[M_T1] += (2.0 - c_n) * ds1 - (a1 - micro[M_A1])
    micro[M_T2] += (2.0 - c_n) * ds2 - (a2 - micro[M_A2])
    for i in range(3):
        micro[M_GAINED + i] += w[SUMS + i * L + lane]
        micro[M_LOST + i] += w[SUMS + (3 + i) * L + lane]
    micro[M_Z], micro[M_A1], micro[M_A2] = z, a1, a2


@compiled()
def _network_at_end(w, lane, mixed, control, stress_start, point, numbers, rule, resolved):
    """With shifted weak forces: z, a_c of the end state into Y; S_i stays in SLOT. False if there is none."""
    if mixed:
        for i in range(3):
            if control[i] == 1:
                w[Y + i * L + lane] = stress_start[point, i] + w[GIVEN + i * L + lane]
    p = -0.5 * (w[Y + lane] + w[Y + L + lane])
    if not p > w[FLOOR + lane]:
        return False
    x0, gain = shift_and_gain(w, lane, p, numbers[CHI_P])
    origin = (w[ORIGIN_Z + lane], w[ORIGIN_A1 + lane], w[ORIGIN_A2 + lane])
    spread = w[Y + 3 * L + lane]
    found = network_of(
        x0,
        w[Y + 4 * L + lane],
        w[Y + 5 * L + lane],
        spread,
        w[X1 + lane],
        w[X2 + lane],
        origin,
        w[P_ZERO + lane],
        gain,
        numbers[CHI],
        numbers[C_E],
        rule[2],
        rule[3],
        resolved,
    )
    w[SLOT + lane] = spread
    w[Y + 3 * L + lane], w[Y + 4 * L + lane], w[Y + 5 * L + lane] = resolved[0], resolved[1], resolved[2]
    return found


@compiled()
def _finish_weak_forces(w, lane, numbers, rule, resolved, state_start, point, micro_of_column, micro):
    """State columns of the shifted weak forces; gained and lost from the change of N, direction by direction."""
    start = np.zeros(MICRO)
    for i in range(state_start.shape[1]):
        start[micro_of_column[i]] = state_start[point, i]
    p = -0.5 * (w[Y + lane] + w[Y + L + lane])
    x0, gain = shift_and_gain(w, lane, p, numbers[CHI_P])
    _, gain_start = shift_and_gain(w, lane, w[START_P + lane], numbers[CHI_P])
    micro[M_SHIFT], micro[M_SHIFT + 1], micro[M_SHIFT + 2] = x0, resolved[3], resolved[4]
    micro[M_SPREAD], micro[M_LARGEST_S] = w[SLOT + lane], w[LARGEST_S + lane]
    split_change(
        (w[ORIGIN_Z + lane], w[ORIGIN_A1 + lane], w[ORIGIN_A2 + lane]),
        w[P_ZERO + lane],
        numbers[C_E],
        (start[M_SHIFT], start[M_SHIFT + 1], start[M_SHIFT + 2], start[M_SPREAD], gain_start),
        (x0, resolved[3], resolved[4], w[SLOT + lane], gain),
        rule[2],
        rule[3],
        micro[M_GAINED : M_GAINED + 3],
        micro[M_LOST : M_LOST + 3],
    )


@compiled()
def smallest_step_factor(status, counts, comfortable):
    """Step factor to propose: a quarter after a failure, else from 2 down to 1 the more substeps a point took."""
    factor = 2.0
    for point in range(status.shape[0]):
        if status[point] > LIMITED:
            return 0.25
        if counts[point, 0] > comfortable:
            factor = min(factor, max(1.0, 2.0 * math.sqrt(comfortable / counts[point, 0])))
    return factor
