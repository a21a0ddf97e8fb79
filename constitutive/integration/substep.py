"""One substep in every lane: stages, error estimate, acceptance."""

import math

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.contract import Status
from granfabric.constitutive.lanes.layout import (
    ACCEPT,
    ADVANCED,
    ERROR,
    EVALUATIONS,
    EXTRAS,
    FLOOR,
    GAINED,
    GAMMA_R,
    KAPPA,
    KERNEL_OPTIONS,
    LANES,
    MEASURE,
    OUTCOME,
    RATE,
    RATES,
    SLIDES,
    SLIDING,
    SLOT_SCALE,
    STAGE,
    STEP,
    STIFF_A1,
    STIFF_A2,
    STIFF_B,
    STIFF_G,
    STIFF_K,
    SUMS,
    TRIAL,
    UNKNOWNS,
    WORST,
    L,
    Y,
)
from granfabric.constitutive.lanes.rows import add_scaled, copy_rows
from granfabric.constitutive.lanes.runge_kutta import (
    LARGEST_CHANGE,
    MAX_FACTOR,
    MIN_FACTOR,
    SAFETY,
    SMALLEST_COORDINATION,
)
from granfabric.constitutive.sliding.cone_return import return_to_cone
from granfabric.constitutive.sliding.plastic_advance import (
    advance_length,
    advance_plastic,
    begin_plastic_stage,
    begin_sliding,
    keep_plastic,
)
from granfabric.constitutive.stiffness import stress_rate

from .implicit_stage import begin_stage, improve_stage
from .stage import stage

LIMITED = int(Status.LIMITED)
NO_PRESSURE = int(Status.NO_PRESSURE)
NOT_ADMISSIBLE = int(Status.NOT_ADMISSIBLE)


@compiled(inline="always", **KERNEL_OPTIONS)
def attempt_substep(w, control, mixed, options, numbers, derivatives, tableau, stage_tolerance, rule, solver):
    """All stages of one substep from rows Y, TY over rows STEP; leaves the end in TRIAL, the worst status in WORST."""
    a, b = tableau[0], tableau[1]
    stages = b.shape[0]
    for lane in range(LANES):
        w[WORST + lane] = 0.0
        w[EVALUATIONS + lane] = 0.0
    for row in range(1, ADVANCED):
        for lane in range(LANES):
            w[STEP + row * L + lane] = w[STEP + lane]
    sliding = options[SLIDING] != 0
    if sliding:
        begin_sliding(w)
    i, passes = 0, 0
    while i < stages:
        # a stage that only estimates the error needs no derivatives
        with_derivatives = derivatives and (b[i] != 0.0 or i < stages - 1)
        implicit = a[i, i] != 0.0
        if implicit and passes == 0:
            begin_stage(w, i)
            if sliding:
                begin_plastic_stage(w, i)
        _advance(w, ADVANCED if with_derivatives else UNKNOWNS, i + 1, a[i])
        if sliding:
            advance_plastic(w, i + 1, a[i], with_derivatives)
            if with_derivatives:
                advance_length(w, i + 1, a[i])
        stage(w, control, mixed, options, numbers, with_derivatives, rule, solver)
        if implicit:
            passes += 1
            if not improve_stage(w, i, a[i, i], stage_tolerance, passes, with_derivatives, sliding):
                continue
        else:
            copy_rows(w, STAGE + i * RATES * L, RATE, RATES * L)
            for lane in range(LANES):
                worst, outcome = w[WORST + lane], w[OUTCOME + lane]
                w[WORST + lane] = worst if worst > outcome else outcome
                w[EVALUATIONS + lane] += 1.0
            if sliding:
                keep_plastic(w, i)
        i, passes = i + 1, 0
    _advance(w, ADVANCED if derivatives else UNKNOWNS, stages, b)
    if sliding:
        advance_plastic(w, stages, b, derivatives)
        if derivatives:
            advance_length(w, stages, b)
        return_to_cone(w, control, mixed, solver, derivatives)


@compiled(**KERNEL_OPTIONS)
def _advance(w, rows, stages, coefficients):
    """TRIAL = Y + h sum c_m K_m in the first `rows` rows, over the first `stages` stages."""
    for index in range(rows * L):
        w[TRIAL + index] = 0.0
    for m in range(stages):
        # stages without weight may hold no derivatives
        if coefficients[m] != 0.0:
            add_scaled(w, TRIAL, STAGE + m * RATES * L, coefficients[m], rows * L)
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
def estimate_error(w, error, tolerance, shifted, mixed, sliding):
    """Error of the substep in units of the tolerance (stress relative to p, z relative, a_c absolute); end state.

    Where stress is given (`mixed`), the strain is what is asked for: its error counts as the stress that belongs to it.
    In a substep that slides it may be as large as what the error of the hardening strain is allowed to cause.
    """
    for index in range(UNKNOWNS * L):
        w[ERROR + index] = 0.0
    for m in range(error.shape[0]):
        add_scaled(w, ERROR, STAGE + m * RATES * L, error[m], UNKNOWNS * L)
    for lane in range(LANES):
        h = w[STEP + lane]
        p = -0.5 * tolerance * (w[Y + lane] + w[Y + L + lane])
        measure = _larger(0.0, w[ERROR + lane], h, p)
        measure = _larger(measure, w[ERROR + L + lane], h, p)
        measure = _larger(measure, w[ERROR + 2 * L + lane], h, p)
        measure = _larger(measure, w[ERROR + 3 * L + lane], h, tolerance * w[SLOT_SCALE + lane])
        measure = _larger(measure, w[ERROR + 4 * L + lane], h, tolerance)
        measure = _larger(measure, w[ERROR + 5 * L + lane], h, tolerance)
        if mixed:
            xx, yy, xy = 0.0, 0.0, 0.0
            for m in range(error.shape[0]):
                row = STAGE + (m * RATES + ADVANCED + 6) * L + lane
                xx, yy, xy = xx + error[m] * w[row], yy + error[m] * w[row + L], xy + error[m] * w[row + 2 * L]
            k, g, b = w[STIFF_K + lane], w[STIFF_G + lane], w[STIFF_B + lane]
            xx, yy, xy = stress_rate(k, g, b, w[STIFF_A1 + lane], w[STIFF_A2 + lane], xx, yy, xy)
            if sliding and w[SLIDES + lane] > 0.0:
                p += 2.0 * tolerance * k * (w[GAMMA_R + lane] + w[KAPPA + lane])
            measure = _larger(measure, xx, h, p)
            measure = _larger(measure, yy, h, p)
            measure = _larger(measure, xy, h, p)
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
        inside = z > SMALLEST_COORDINATION and a1 * a1 + a2 * a2 < 4.0
        admissible = (inside or shifted) and measure < math.inf
        pressure = end > w[FLOOR + lane]
        fine = outcome <= LIMITED
        outcome = outcome if admissible or not fine else float(NOT_ADMISSIBLE)
        w[WORST + lane] = outcome if pressure or not fine else float(NO_PRESSURE)


@compiled()
def step_factor(measure, error_order):
    """Factor to the next substep from the error of the last in units of the tolerance."""
    if measure <= 0.0:
        return MAX_FACTOR
    return min(MAX_FACTOR, max(MIN_FACTOR, SAFETY * measure ** (-1.0 / (error_order + 1.0))))


@compiled(inline="always", **KERNEL_OPTIONS)
def _add_stepped(w, source, weight):
    """SUMS += weight h rates of the extras."""
    copy_rows(w, GAINED, source, EXTRAS * L)
    for index in range(EXTRAS * L):
        w[SUMS + index] += w[STEP + index] * weight * w[GAINED + index]


@compiled(**KERNEL_OPTIONS)
def accept_substep(w, b, derivatives):
    """Move the accepted lanes to the end of their substep."""
    rows = ADVANCED if derivatives else UNKNOWNS
    accepted = 0
    for lane in range(LANES):
        accepted += 1 if w[ACCEPT + lane] > 0.0 else 0
    if accepted == LANES:
        for index in range(rows * L):
            w[Y + index] = w[TRIAL + index]
        for m in range(b.shape[0]):
            _add_stepped(w, STAGE + (m * RATES + ADVANCED) * L, b[m])
        return
    for lane in range(LANES):
        if w[ACCEPT + lane] > 0.0:
            for row in range(rows):
                w[Y + row * L + lane] = w[TRIAL + row * L + lane]
            for m in range(b.shape[0]):
                for row in range(EXTRAS):
                    kept = STAGE + (m * RATES + ADVANCED + row) * L
                    w[SUMS + row * L + lane] += w[STEP + lane] * b[m] * w[kept + lane]
