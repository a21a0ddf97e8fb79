"""The end of a substep that slides: back onto the cone, end values, tangent of the rate equations.

A Runge-Kutta step leaves the cone by its truncation error, which would add up over many increments. Under strain
control the deviator is scaled to the cone at the p and kappa reached; where stresses are given, a consistent change
of kappa brings the others back (all three given: kappa is that of the stress ratio). Either way the correction is
as small as the error that the step has anyway, and the derivatives are carried through.
"""

import math

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.contract import Status
from granfabric.constitutive.lanes.layout import (
    COHESION,
    COLUMNS,
    DILATANCY,
    EXPONENT,
    GAMMA_R,
    KAPPA,
    LANES,
    M_CV,
    M_FIRST,
    M_PEAK,
    PLASTIC_ADVANCED,
    PLASTIC_SUMS,
    SLIDES,
    STRAIN_CORRECTION,
    TRIAL,
    TRIAL_KAPPA,
    TRIAL_TY,
    UNKNOWNS,
    WORST,
    L,
    Y,
)
from granfabric.constitutive.lanes.load import M_GAMMA, M_KAPPA

from .cone import deviator_of, hardening_strain_at, plastic_share, plastic_shear_strain, strength
from .stage import relief

_LIMITED = float(Status.LIMITED)
_BEYOND_PEAK = float(Status.BEYOND_PEAK)
_CORRECTIONS = 25
_ROUNDING = 1e-15


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
