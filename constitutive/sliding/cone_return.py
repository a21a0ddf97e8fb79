"""The end of a substep that slides: back onto the cone, and the tangent of the rate equations.

A Runge-Kutta step leaves the cone by its truncation error, which would add up over many increments. Under strain
control the deviator is scaled to the cone at the p and kappa reached; where stresses are given, a consistent change
of kappa brings the others back (all three given: kappa is that of the stress ratio). Either way the correction is
as small as the error that the step has anyway, and the derivatives are carried through.
"""

import math

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.contract import Status

from .cone import hardening_strain_at, plastic_share, strength
from .flow import relieved

_LIMITED = float(Status.LIMITED)
_BEYOND_PEAK = float(Status.BEYOND_PEAK)
_CORRECTIONS = 25
_ROUNDING = 1e-15
_UNKNOWNS = 6


@formula
def return_to_cone(trial, stiffness, stressed, outcome, slide, derivatives):
    """Bring the end of a sliding substep onto the cone: stress rows of `trial` and kappa, with derivatives.

    Returns the status of the substep.
    """
    if not slide["slides"] or outcome > _LIMITED:
        return outcome
    if slide["trial_kappa"] < slide["kappa"]:
        # a pair with negative weights and a step too large for it: kappa never falls
        slide["trial_kappa"] = slide["kappa"]
        for column in range(3):
            slide["trial_kappa_by"][column] = slide["kappa_by"][column]
    p, t1, t2 = trial[0, 0], trial[1, 0], trial[2, 0]
    q, pc = math.sqrt(t1 * t1 + t2 * t2), p + slide["cohesion"]
    if not (q > 0.0 and pc > 0.0):
        return outcome
    if stressed[0] or stressed[1] or stressed[2]:
        return _correct_kappa(trial, stiffness, stressed, outcome, slide)
    m, by_kappa, _ = strength(slide["trial_kappa"], slide["first"], slide["peak"], slide["reference"])
    n1, n2, target = t1 / q, t2 / q, m * pc
    trial[1, 0], trial[2, 0] = target * n1, target * n2
    if derivatives:
        for column in range(3):
            row = _UNKNOWNS * (1 + column)
            dp, d1, d2 = trial[row, 0], trial[row + 1, 0], trial[row + 2, 0]
            along = n1 * d1 + n2 * d2
            growth = by_kappa * slide["trial_kappa_by"][column] * pc + m * dp
            trial[row + 1, 0] = target / q * (d1 - n1 * along) + n1 * growth
            trial[row + 2, 0] = target / q * (d2 - n2 * along) + n2 * growth
    return outcome


@formula
def _correct_kappa(trial, stiffness, stressed, outcome, slide):
    """Change kappa, and the stresses that are not given with it, until the stress is on the cone."""
    first, peak, reference = slide["first"], slide["peak"], slide["reference"]
    if stressed[0] and stressed[1] and stressed[2]:
        p, t1, t2 = trial[0, 0], trial[1, 0], trial[2, 0]
        q = math.sqrt(t1 * t1 + t2 * t2)
        kappa = hardening_strain_at(q / (p + slide["cohesion"]), first, peak, reference)
        if not kappa < math.inf:
            return _BEYOND_PEAK
        change = max(kappa, slide["kappa"]) - slide["trial_kappa"]
        m = strength(slide["trial_kappa"], first, peak, reference)[0]
        expansion = slide["dilatancy"] * (slide["constant"] - m)
        _, strain = relieved(stiffness, expansion, t1 / q, t2 / q, stressed)
        slide["trial_kappa"] += change
        change *= plastic_share(slide["trial_kappa"], reference, slide["exponent"])[0]
        for i in range(3):
            slide["correction"][i] = change * strain[i]
        return outcome
    for _ in range(_CORRECTIONS):
        p, t1, t2 = trial[0, 0], trial[1, 0], trial[2, 0]
        q, pc = math.sqrt(t1 * t1 + t2 * t2), p + slide["cohesion"]
        m, by_kappa, _ = strength(slide["trial_kappa"], first, peak, reference)
        distance = q - m * pc
        if abs(distance) <= _ROUNDING * pc or not q > 0.0:
            return outcome
        n1, n2 = t1 / q, t2 / q
        expansion = slide["dilatancy"] * (slide["constant"] - m)
        (p_r, t1_r, t2_r), strain = relieved(stiffness, expansion, n1, n2, stressed)
        share, _ = plastic_share(slide["trial_kappa"], reference, slide["exponent"])
        resistance = share * (n1 * t1_r + n2 * t2_r - m * p_r) + by_kappa * pc
        if not resistance > 0.0:
            return outcome
        change = distance / resistance
        slide["trial_kappa"] += change
        change *= share
        trial[0, 0] -= change * p_r
        trial[1, 0] -= change * t1_r
        trial[2, 0] -= change * t2_r
        for i in range(3):
            slide["correction"][i] += change * strain[i]
    return outcome


@formula
def plastic_tangent(stress, slide, out):
    """Turn the elastic stiffness `out`, shape (3, 3), of a point that slides into the tangent of its rate equations.

    `stress` is p, t_1, t_2; `out` is in the order xx, yy, engineering xy.
    """
    p, t1, t2 = stress
    q, pc = math.sqrt(t1 * t1 + t2 * t2), p + slide["cohesion"]
    if not slide["slides"] or not q > 0.0:
        return
    m, by_kappa, _ = strength(slide["kappa"], slide["first"], slide["peak"], slide["reference"])
    expansion = slide["dilatancy"] * (slide["constant"] - m)
    n1, n2 = t1 / q, t2 / q
    normal = (0.5 * (m - n1), 0.5 * (m + n1), -n2)
    flow = (-0.5 * (expansion + n1), -0.5 * (expansion - n1), -n2)
    share, _ = plastic_share(slide["kappa"], slide["reference"], slide["exponent"])
    c0 = share * (out[0, 0] * flow[0] + out[0, 1] * flow[1] + out[0, 2] * flow[2])
    c1 = share * (out[1, 0] * flow[0] + out[1, 1] * flow[1] + out[1, 2] * flow[2])
    c2 = share * (out[2, 0] * flow[0] + out[2, 1] * flow[1] + out[2, 2] * flow[2])
    resistance = normal[0] * c0 + normal[1] * c1 + normal[2] * c2 + by_kappa * pc
    if not resistance > 0.0:
        return
    for j in range(3):
        d = (normal[0] * out[0, j] + normal[1] * out[1, j] + normal[2] * out[2, j]) / resistance
        slide["correction"][j] = d
    for j in range(3):
        d = slide["correction"][j]
        out[0, j] -= c0 * d
        out[1, j] -= c1 * d
        out[2, j] -= c2 * d
