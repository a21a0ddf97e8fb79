"""Around a substep that slides: advance kappa, bring its end back onto the cone, measure its error, accept it.

A Runge-Kutta step leaves the cone by its truncation error, which would add up over many increments. Under strain
control the deviator is scaled to the cone at the p and kappa reached; where stresses are given, a consistent change
of kappa brings the others back (all three given: kappa is that of the stress ratio). Either way the correction is
as small as the error that the step has anyway, and the derivatives are carried through.
"""

import math

from .compilation import compiled
from .contract import Status
from .lanes import (
    ACCEPT,
    COHESION,
    COLUMNS,
    CROSSED,
    DECIDES,
    DILATANCY,
    EXPONENT,
    GAMMA_R,
    GIVEN,
    HIGH,
    KAPPA,
    KAPPA_RATE,
    LANES,
    M_CV,
    M_FIRST,
    M_PEAK,
    MEASURE,
    ON_CONE,
    PLANNED_STEP,
    PLASTIC_ADVANCED,
    PLASTIC_RATES,
    PLASTIC_STAGE,
    PLASTIC_SUMS,
    RATES,
    REVERSED,
    SEED,
    SETTLED,
    SLIDES,
    SOLVING,
    STAGE,
    STEP,
    STEP_CHANGE,
    STRAIN_CORRECTION,
    SUMS,
    TIME_CHANGE,
    TRIAL,
    TRIAL_KAPPA,
    TRIAL_TY,
    TRIES,
    UNKNOWNS,
    WORST,
    L,
    Y,
)
from .load_lane import (
    M_GAMMA,
    M_KAPPA,
    PAR_COHESION,
    PAR_DILATANCY,
    PAR_EXPONENT,
    PAR_GAMMA_R,
    PAR_M_CV,
    PAR_M_FIRST,
    PAR_M_PEAK,
)
from .sliding import (
    AXIS_TOLERANCE,
    CONE_TOLERANCE,
    LOAD_TOLERANCE,
    deviator_of,
    hardening_strain_at,
    plastic_share,
    plastic_shear_strain,
    strength,
)
from .sliding_stage import relief

_LIMITED = float(Status.LIMITED)
_BEYOND_PEAK = float(Status.BEYOND_PEAK)
_CORRECTIONS = 25
_ROUNDING = 1e-15


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
        return int(_BEYOND_PEAK)
    if mixed and _no_stress_within_the_peak(w, lane, control, peak, cohesion):
        return int(_BEYOND_PEAK)
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
def begin_sliding(w):
    """Before the first stage of a substep."""
    for lane in range(LANES):
        w[DECIDES + lane] = 1.0
        w[REVERSED + lane] = 0.0
        for row in range(3):
            w[STRAIN_CORRECTION + row * L + lane] = 0.0
        # a substep that begins later ends when planned; one that was shortened is a share of the planned one
        planned = w[PLANNED_STEP + lane]
        share = w[STEP + lane] / planned if planned > 0.0 else 0.0
        for column in range(COLUMNS):
            w[STEP_CHANGE + column * L + lane] = -share * w[TIME_CHANGE + column * L + lane]
        if w[CROSSED + lane] > 0.0:
            w[STEP_CHANGE + lane] += w[SEED + lane]


@compiled()
def advance_plastic(w, stages, coefficients, derivatives):
    """TRIAL_KAPPA = KAPPA + h sum c_m rates, over the first `stages` stages; with derivatives, of them too."""
    rows = PLASTIC_ADVANCED if derivatives else 1
    for row in range(rows):
        for lane in range(LANES):
            total = 0.0
            for m in range(stages):
                if coefficients[m] != 0.0:
                    total += coefficients[m] * w[PLASTIC_STAGE + (m * PLASTIC_RATES + row) * L + lane]
            w[TRIAL_KAPPA + row * L + lane] = w[KAPPA + row * L + lane] + w[STEP + lane] * total


@compiled()
def advance_length(w, stages, coefficients):
    """Add what a change of the substep's length does to the derivatives: rows TRIAL_TY and those after TRIAL_KAPPA."""
    for column in range(COLUMNS):
        for lane in range(LANES):
            change = w[STEP_CHANGE + column * L + lane]
            if change == 0.0:
                continue
            for m in range(stages):
                weight = change * coefficients[m]
                if weight != 0.0:
                    for i in range(UNKNOWNS):
                        rate = w[STAGE + (m * RATES + i) * L + lane]
                        w[TRIAL_TY + (column * UNKNOWNS + i) * L + lane] += weight * rate
                    rate = w[PLASTIC_STAGE + m * PLASTIC_RATES * L + lane]
                    w[TRIAL_KAPPA + (1 + column) * L + lane] += weight * rate


@compiled()
def keep_plastic(w, stage):
    """Keep the rates of a stage; what comes after the first does not decide any more."""
    for row in range(PLASTIC_RATES):
        for lane in range(LANES):
            w[PLASTIC_STAGE + (stage * PLASTIC_RATES + row) * L + lane] = w[KAPPA_RATE + row * L + lane]
    for lane in range(LANES):
        w[DECIDES + lane] = 0.0


@compiled()
def begin_plastic_stage(w, stage):
    """Start the iteration of an implicit stage from the rates of the one before."""
    for row in range(PLASTIC_RATES):
        for lane in range(LANES):
            at = PLASTIC_STAGE + (stage * PLASTIC_RATES + row) * L + lane
            w[at] = w[at - PLASTIC_RATES * L]


@compiled()
def improve_plastic_stage(w, stage, diagonal, tolerance, rounding, derivatives):
    """One pass over the rates of kappa of an implicit stage; takes SETTLED back in lanes where they still change.

    As for the other unknowns: kappa is measured by kappa + gamma_r, its derivatives by themselves, `rounding` at least.
    """
    for lane in range(LANES):
        if w[SOLVING + lane] == 0.0:
            continue
        kept = PLASTIC_STAGE + stage * PLASTIC_RATES * L + lane
        size = abs(w[KAPPA_RATE + lane])
        limit = tolerance * ((w[GAMMA_R + lane] + w[KAPPA + lane]) / (diagonal * w[STEP + lane]) + size)
        settled = abs(w[KAPPA_RATE + lane] - w[kept]) <= limit
        if derivatives:
            square, change = 0.0, 0.0
            for column in range(1, PLASTIC_ADVANCED):
                new = w[KAPPA_RATE + column * L + lane]
                square += new * new
                change += (new - w[kept + column * L]) ** 2
            settled = settled and change <= max(tolerance, rounding) ** 2 * square
        for row in range(PLASTIC_RATES):
            w[kept + row * L] = w[KAPPA_RATE + row * L + lane]
        if not settled:
            w[SETTLED + lane] = 0.0


@compiled()
def return_to_cone(w, control, mixed, solver, derivatives):
    """Bring the ends of sliding substeps onto the cone: rows TRIAL and TRIAL_KAPPA, with derivatives."""
    for lane in range(LANES):
        if w[SLIDES + lane] == 0.0 or w[WORST + lane] > _LIMITED:
            continue
        if w[TRIAL_KAPPA + lane] < w[KAPPA + lane]:
            # a pair with negative weights and a step too large for it: kappa never falls
            for row in range(PLASTIC_ADVANCED if derivatives else 1):
                w[TRIAL_KAPPA + row * L + lane] = w[KAPPA + row * L + lane]
        p, t1, t2 = deviator_of(w[TRIAL + lane], w[TRIAL + L + lane], w[TRIAL + 2 * L + lane])
        q, pc = math.sqrt(t1 * t1 + t2 * t2), p + w[COHESION + lane]
        if not (q > 0.0 and pc > 0.0):
            continue
        if mixed:
            _correct_kappa(w, lane, control[lane], solver)
            continue
        m, by_kappa, _ = strength(w[TRIAL_KAPPA + lane], w[M_FIRST + lane], w[M_PEAK + lane], w[GAMMA_R + lane])
        n1, n2, target = t1 / q, t2 / q, m * pc
        w[TRIAL + lane], w[TRIAL + L + lane] = -(p + target * n1), -(p - target * n1)
        w[TRIAL + 2 * L + lane] = -target * n2
        if derivatives:
            for column in range(COLUMNS):
                row = TRIAL_TY + column * UNKNOWNS * L + lane
                dp, d1, d2 = deviator_of(w[row], w[row + L], w[row + 2 * L])
                along = n1 * d1 + n2 * d2
                growth = by_kappa * w[TRIAL_KAPPA + (1 + column) * L + lane] * pc + m * dp
                d1 = target / q * (d1 - n1 * along) + n1 * growth
                d2 = target / q * (d2 - n2 * along) + n2 * growth
                w[row], w[row + L], w[row + 2 * L] = -(dp + d1), -(dp - d1), -d2


@compiled()
def _correct_kappa(w, lane, control, solver):
    """Change kappa, and the stresses that are not controlled with it, until the stress is on the cone."""
    first, peak, reference = w[M_FIRST + lane], w[M_PEAK + lane], w[GAMMA_R + lane]
    if control[0] == 1 and control[1] == 1 and control[2] == 1:
        p, t1, t2 = deviator_of(w[TRIAL + lane], w[TRIAL + L + lane], w[TRIAL + 2 * L + lane])
        kappa = hardening_strain_at(math.sqrt(t1 * t1 + t2 * t2) / (p + w[COHESION + lane]), first, peak, reference)
        if not kappa < math.inf:
            w[WORST + lane] = _BEYOND_PEAK
            return
        change = max(kappa, w[KAPPA + lane]) - w[TRIAL_KAPPA + lane]
        n1, n2, m = _direction(w, lane)
        expansion = w[DILATANCY + lane] * (w[M_CV + lane] - m)
        _, _, _, xx, yy, xy = relief(w, lane, control, True, solver, expansion, n1, n2)
        w[TRIAL_KAPPA + lane] += change
        change *= plastic_share(w[TRIAL_KAPPA + lane], reference, w[EXPONENT + lane])[0]
        w[STRAIN_CORRECTION + lane] = change * xx
        w[STRAIN_CORRECTION + L + lane] = change * yy
        w[STRAIN_CORRECTION + 2 * L + lane] = change * xy
        return
    for _ in range(_CORRECTIONS):
        p, t1, t2 = deviator_of(w[TRIAL + lane], w[TRIAL + L + lane], w[TRIAL + 2 * L + lane])
        q, pc = math.sqrt(t1 * t1 + t2 * t2), p + w[COHESION + lane]
        m, by_kappa, _ = strength(w[TRIAL_KAPPA + lane], first, peak, reference)
        distance = q - m * pc
        if abs(distance) <= _ROUNDING * pc or not q > 0.0:
            return
        n1, n2 = t1 / q, t2 / q
        expansion = w[DILATANCY + lane] * (w[M_CV + lane] - m)
        p_r, t1_r, t2_r, xx, yy, xy = relief(w, lane, control, True, solver, expansion, n1, n2)
        share, _ = plastic_share(w[TRIAL_KAPPA + lane], reference, w[EXPONENT + lane])
        resistance = share * (n1 * t1_r + n2 * t2_r - m * p_r) + by_kappa * pc
        if not resistance > 0.0:
            return
        change = distance / resistance
        w[TRIAL_KAPPA + lane] += change
        change *= share
        w[TRIAL + lane] += change * (p_r + t1_r)
        w[TRIAL + L + lane] += change * (p_r - t1_r)
        w[TRIAL + 2 * L + lane] += change * t2_r
        w[STRAIN_CORRECTION + lane] += change * xx
        w[STRAIN_CORRECTION + L + lane] += change * yy
        w[STRAIN_CORRECTION + 2 * L + lane] += change * xy


@compiled()
def _direction(w, lane):
    """Direction of the deviator at the end of the substep, and M there."""
    _, t1, t2 = deviator_of(w[TRIAL + lane], w[TRIAL + L + lane], w[TRIAL + 2 * L + lane])
    q = math.sqrt(t1 * t1 + t2 * t2)
    m = strength(w[TRIAL_KAPPA + lane], w[M_FIRST + lane], w[M_PEAK + lane], w[GAMMA_R + lane])[0]
    return t1 / q, t2 / q, m


@compiled()
def estimate_plastic_error(w, error, tolerance):
    """Raise MEASURE to the error of kappa relative to kappa + gamma_r, in units of the tolerance."""
    for lane in range(LANES):
        total = 0.0
        for m in range(error.shape[0]):
            total += error[m] * w[PLASTIC_STAGE + m * PLASTIC_RATES * L + lane]
        scale = tolerance * (w[GAMMA_R + lane] + w[KAPPA + lane])
        # lanes that have not held a point yet have no scale
        measure = abs(w[STEP + lane] * total) / scale if scale > 0.0 else 0.0
        w[MEASURE + lane] = w[MEASURE + lane] if measure <= w[MEASURE + lane] else measure


@compiled()
def accept_plastic(w, b):
    """Move the accepted lanes to the end of their substep. What is dissipated in one is never negative."""
    for lane in range(LANES):
        if w[ACCEPT + lane] > 0.0 and w[SLIDES + lane] > 0.0:
            for row in range(PLASTIC_ADVANCED):
                w[KAPPA + row * L + lane] = w[TRIAL_KAPPA + row * L + lane]
            volume, work = 0.0, 0.0
            for m in range(b.shape[0]):
                rates = PLASTIC_STAGE + (m * PLASTIC_RATES + PLASTIC_ADVANCED) * L + lane
                volume += b[m] * w[rates]
                work += b[m] * w[rates + L]
            w[PLASTIC_SUMS + lane] += w[STEP + lane] * volume
            w[PLASTIC_SUMS + L + lane] += w[STEP + lane] * max(work, 0.0)
            for row in range(3):
                w[SUMS + (6 + row) * L + lane] += w[STRAIN_CORRECTION + row * L + lane]


@compiled()
def finish_sliding(w, lane, micro):
    """State columns of sliding; `micro` holds their start values."""
    micro[M_KAPPA] = w[KAPPA + lane]
    micro[M_GAMMA] = plastic_shear_strain(w[KAPPA + lane], w[GAMMA_R + lane], w[EXPONENT + lane])
    micro[M_GAMMA + 1] += w[PLASTIC_SUMS + lane]
    micro[M_GAMMA + 2] += w[PLASTIC_SUMS + L + lane]


@compiled()
def plastic_tangent(w, lane, out):
    """Turn the elastic stiffness `out`, shape (3, 3), of a lane that slides into the tangent of its rate equations."""
    p, t1, t2 = deviator_of(w[Y + lane], w[Y + L + lane], w[Y + 2 * L + lane])
    q, pc = math.sqrt(t1 * t1 + t2 * t2), p + w[COHESION + lane]
    if w[SLIDES + lane] == 0.0 or not q > 0.0:
        return
    m, by_kappa, _ = strength(w[KAPPA + lane], w[M_FIRST + lane], w[M_PEAK + lane], w[GAMMA_R + lane])
    expansion = w[DILATANCY + lane] * (w[M_CV + lane] - m)
    n1, n2 = t1 / q, t2 / q
    normal = (0.5 * (m - n1), 0.5 * (m + n1), -n2)
    flow = (-0.5 * (expansion + n1), -0.5 * (expansion - n1), -n2)
    c0 = out[0, 0] * flow[0] + out[0, 1] * flow[1] + out[0, 2] * flow[2]
    c1 = out[1, 0] * flow[0] + out[1, 1] * flow[1] + out[1, 2] * flow[2]
    c2 = out[2, 0] * flow[0] + out[2, 1] * flow[1] + out[2, 2] * flow[2]
    share, _ = plastic_share(w[KAPPA + lane], w[GAMMA_R + lane], w[EXPONENT + lane])
    c0, c1, c2 = share * c0, share * c1, share * c2
    resistance = normal[0] * c0 + normal[1] * c1 + normal[2] * c2 + by_kappa * pc
    d0 = normal[0] * out[0, 0] + normal[1] * out[1, 0] + normal[2] * out[2, 0]
    d1 = normal[0] * out[0, 1] + normal[1] * out[1, 1] + normal[2] * out[2, 1]
    d2 = normal[0] * out[0, 2] + normal[1] * out[1, 2] + normal[2] * out[2, 2]
    if not resistance > 0.0:
        return
    out[0, 0], out[0, 1], out[0, 2] = (
        out[0, 0] - c0 * d0 / resistance,
        out[0, 1] - c0 * d1 / resistance,
        out[0, 2] - c0 * d2 / resistance,
    )
    out[1, 0], out[1, 1], out[1, 2] = (
        out[1, 0] - c1 * d0 / resistance,
        out[1, 1] - c1 * d1 / resistance,
        out[1, 2] - c1 * d2 / resistance,
    )
    out[2, 0], out[2, 1], out[2, 2] = (
        out[2, 0] - c2 * d0 / resistance,
        out[2, 1] - c2 * d1 / resistance,
        out[2, 2] - c2 * d2 / resistance,
    )


@compiled()
def forget_crossing(w, lane):
    """No search for a crossing is under way."""
    w[HIGH + lane], w[TRIES + lane], w[CROSSED + lane] = 0.0, 0.0, 0.0
