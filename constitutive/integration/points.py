"""Update of many points over an increment: an embedded Runge-Kutta pair over stress and micro-state together.

Every lane of a workspace holds one point at its own pseudo-time with its own substep; a lane whose point has arrived
takes the next one at once, so that points that need many substeps do not hold up the others. What is gained and lost,
and the strain, are integrated with the same weights as the unknowns; z(end) = z(start) + gained - lost therefore
holds to rounding. a_n, a_t and f follow from the end values: their closure [Pouragha & Wan 2017, eq. 7 and section
3.3] is an exact differential.
"""

import math

import numpy as np

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.contract import Status
from granfabric.constitutive.lanes.layout import (
    ACCEPT,
    CROSSED,
    EVALUATIONS,
    FEEDBACK,
    FORCE_CHANGE,
    GAIN,
    KERNEL_OPTIONS,
    LANES,
    LOSS,
    MEASURE,
    PLANNED_STEP,
    REFERENCE_A1,
    REFERENCE_A2,
    REFERENCE_Z,
    SHIFTED_DISTRIBUTION,
    SIZE,
    SLIDING,
    SLOT_SCALE,
    START_P,
    STEP,
    SUMS,
    TY,
    UNKNOWNS,
    WHOLE_STEP,
    WORST,
    X1,
    X2,
    L,
    Y,
)
from granfabric.constitutive.lanes.load import M_A1, M_A2, M_Z, MICRO, load_idle, load_point, stiffness_of
from granfabric.constitutive.lanes.runge_kutta import APEX_FRACTION, FAILED_STAGE_FACTOR, SMALLEST_SUBSTEP
from granfabric.constitutive.network.shifted_distribution import workspace
from granfabric.constitutive.network.weak_force_stage import raise_spread
from granfabric.constitutive.sliding.cone_return import finish_sliding, plastic_tangent
from granfabric.constitutive.sliding.crossing import TAKEN_BACK, judge_substep
from granfabric.constitutive.sliding.plastic_advance import accept_plastic, estimate_plastic_error
from granfabric.constitutive.sliding.start import forget_crossing, load_sliding

from .end_values import finish_point, finish_weak_forces, network_at_end
from .implicit_stage import ROUNDING, SHARE_OF_TOLERANCE
from .substep import accept_substep, attempt_substep, estimate_error, step_factor

OK = int(Status.OK)
LIMITED = int(Status.LIMITED)
NO_PRESSURE = int(Status.NO_PRESSURE)
TOO_MANY_SUBSTEPS = int(Status.TOO_MANY_SUBSTEPS)
NOT_FINITE = int(Status.NOT_FINITE)
NOT_CONVERGED = int(Status.NOT_CONVERGED)

TANGENT_NONE, TANGENT_PROPAGATED, TANGENT_CONTINUUM, TANGENT_ELASTIC = range(4)


@compiled()
def _keep_start(point, mixed, stress_start, state_start, stress_end, state_end, strain_increment):
    """End values of a point at rest or refused: its start values."""
    for i in range(3):
        stress_end[point, i] = stress_start[point, i]
        if mixed:
            strain_increment[point, i] = 0.0
    for i in range(state_start.shape[1]):
        state_end[point, i] = state_start[point, i]


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
    `tangent_kind`; `status` (npt,) and `counts` (npt, 3: accepted and rejected substeps, evaluations) are written.
    `tableau` holds a, b, error, error order; `numerics` the tolerance, the number of fixed substeps, the most substeps.
    Runs without the interpreter's lock, so that threads can share a batch; a point's result does not depend on how.
    """
    b, error, error_order = tableau[1], tableau[2], tableau[3]
    derivatives = tangent_kind == TANGENT_PROPAGATED
    tolerance, planned, most = numerics[0], int(numerics[1]), int(numerics[2])
    fixed = planned > 0
    stage_tolerance = ROUNDING if fixed else max(ROUNDING, SHARE_OF_TOLERANCE * tolerance)
    network = options[LOSS] != 0 or options[GAIN] != 0
    shifted = network and options[FORCE_CHANGE] == SHIFTED_DISTRIBUTION
    sliding = options[SLIDING] != 0
    fabric, resolved = workspace()
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
                if sliding and outcome <= LIMITED:
                    outcome = load_sliding(
                        w, lane, point, state_start, par, micro_of_column, control[point if mixed else 0], mixed
                    )
                if tangent_kind != TANGENT_NONE:
                    stiffness_of(w, lane, outcome in (OK, NO_PRESSURE), tangent[point])
                at_rest = given[point, 0] == 0.0 and given[point, 1] == 0.0 and given[point, 2] == 0.0
                if at_rest or outcome > LIMITED:
                    status[point] = outcome
                    _keep_start(point, mixed, stress_start, state_start, stress_end, state_end, strain_increment)
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
                if fixed and sliding:
                    # crossings of the cone split the fixed substeps
                    last[lane] = w[STEP + lane] >= remaining * (1.0 - 1e-12)
                elif fixed:
                    last[lane] = counts[point_of[lane], 0] == planned - 1
                else:
                    last[lane] = w[STEP + lane] >= remaining * (1.0 - 1e-12)
                    if last[lane]:
                        w[STEP + lane] = remaining
                if sliding and w[PLANNED_STEP + lane] == 0.0:
                    w[PLANNED_STEP + lane] = w[STEP + lane]
        if active == 0:
            break
        attempt_substep(w, lane_control, mixed, options, numbers, derivatives, tableau, stage_tolerance, rule, solver)
        estimate_error(w, error, tolerance, shifted, mixed, sliding)
        if sliding:
            estimate_plastic_error(w, error, tolerance)
        for lane in range(LANES):
            point = point_of[lane]
            w[ACCEPT + lane] = 0.0
            if point < 0:
                continue
            counts[point, 2] += int(w[EVALUATIONS + lane])
            failed = w[WORST + lane] > LIMITED
            if not failed and (fixed or w[MEASURE + lane] <= 1.0):
                if sliding and judge_substep(w, lane, derivatives and not last[lane]) == TAKEN_BACK:
                    counts[point, 1] += 1
                    if counts[point, 0] + counts[point, 1] >= most:
                        status[point] = TOO_MANY_SUBSTEPS
                    continue
                w[ACCEPT + lane] = 1.0
                status[point] = max(status[point], int(w[WORST + lane]))
                counts[point, 0] += 1
                continue
            counts[point, 1] += 1
            if sliding:
                forget_crossing(w, lane)
            if failed and not shifted:
                # what an attempt without solution left is no start, and depends on how long other lanes took
                w[X1 + lane], w[X2 + lane] = 0.0, 0.0
            w[STEP + lane] *= FAILED_STAGE_FACTOR if failed else step_factor(w[MEASURE + lane], error_order)
            if fixed or w[STEP + lane] < SMALLEST_SUBSTEP or counts[point, 0] + counts[point, 1] >= most:
                status[point] = int(w[WORST + lane]) if failed else TOO_MANY_SUBSTEPS
                p = -0.5 * (w[Y + lane] + w[Y + L + lane])
                if not fixed and w[STEP + lane] < SMALLEST_SUBSTEP and p < APEX_FRACTION * w[START_P + lane]:
                    status[point] = NO_PRESSURE
        accept_substep(w, b, derivatives)
        if sliding:
            accept_plastic(w, b)
        for lane in range(LANES):
            point = point_of[lane]
            if point < 0:
                continue
            if w[ACCEPT + lane] > 0.0:
                time[lane] += w[STEP + lane]
                w[SLOT_SCALE + lane] = 1.0 if shifted else w[Y + 3 * L + lane]
                if shifted:
                    raise_spread(w, lane, options, numbers, derivatives)
                crossed = sliding and w[CROSSED + lane] > 0.0
                if sliding:
                    w[PLANNED_STEP + lane] = 0.0
                if crossed:
                    forget_crossing(w, lane)
                if not last[lane]:
                    if counts[point, 0] + counts[point, 1] >= most:
                        status[point] = TOO_MANY_SUBSTEPS
                    elif sliding and fixed:
                        w[STEP + lane] = (math.floor(time[lane] * planned + 1e-9) + 1.0) / planned - time[lane]
                    elif crossed:
                        w[STEP + lane] = max(w[WHOLE_STEP + lane] - w[STEP + lane], SMALLEST_SUBSTEP)
                    elif not fixed:
                        w[STEP + lane] *= step_factor(w[MEASURE + lane], error_order)
            elif status[point] <= LIMITED:
                continue
            if status[point] > LIMITED:
                _keep_start(point, mixed, stress_start, state_start, stress_end, state_end, strain_increment)
            elif last[lane]:
                if shifted and not network_at_end(
                    w, lane, mixed, lane_control[lane], options, stress_start, point, numbers, rule, fabric, resolved
                ):
                    status[point] = NOT_CONVERGED
                    _keep_start(point, mixed, stress_start, state_start, stress_end, state_end, strain_increment)
                    point_of[lane] = -1
                    if following >= end:
                        load_idle(w, lane)
                    continue
                finish_point(
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
                    finish_weak_forces(
                        w, lane, options, numbers, rule, fabric, resolved, state_start, point, micro_of_column, micro
                    )
                if sliding:
                    finish_sliding(w, lane, micro)
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
                    if sliding:
                        plastic_tangent(w, lane, tangent[point])
            else:
                continue
            point_of[lane] = -1
            if following >= end:
                load_idle(w, lane)


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
