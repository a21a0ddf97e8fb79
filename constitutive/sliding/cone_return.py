"""The end of a substep that slides: back onto the cone, and the tangent of the rate equations.

A Runge-Kutta step leaves the cone by its truncation error, which would add up over many increments. Under strain
control the deviator is scaled to the cone at the p and kappa reached; where stresses are given, a consistent change
of kappa brings the others back (all three given: kappa is that of the stress ratio). Either way the correction is
as small as the error that the step has anyway, and the derivatives are carried through.
"""

import math

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.contract import Status
from granfabric.constitutive.lanes.eight import choose, read, somewhere, write
from granfabric.constitutive.lanes.elementary import larger

from .cone import hardening_strain_at, plastic_share, strength
from .flow import relieved
from .slide import cone_of

_LIMITED = float(Status.LIMITED)
_BEYOND_PEAK = float(Status.BEYOND_PEAK)
_CORRECTIONS = 25
_ROUNDING = 1e-15
_UNKNOWNS = 6


@formula
def return_to_cone(trial, stiffness, stressed, outcome, slide, options, lanes):
    """Bring the ends of sliding substeps onto the cone: stress rows of `trial` and kappa, with derivatives.

    Returns the status of the substep.
    """
    slides = (read(slide["slides"], 0, lanes) > 0.5) & (outcome <= _LIMITED)
    if not somewhere(slides):
        return outcome
    start, kappa = read(slide["kappa"], 0, lanes), read(slide["trial_kappa"], 0, lanes)
    # a pair with negative weights and a step too large for it: kappa never falls
    fell = slides & (kappa < start)
    kappa = choose(fell, start, kappa)
    write(slide["trial_kappa"], 0, kappa, lanes)
    for column in range(3):
        changed = read(slide["trial_kappa_by"], column, lanes)
        changed = choose(fell, read(slide["kappa_by"], column, lanes), changed)
        write(slide["trial_kappa_by"], column, changed, lanes)
    first, peak, reference, _, _, _, cohesion = cone_of(slide, lanes)
    p, t1, t2 = read(trial, 0, lanes), read(trial, 1, lanes), read(trial, 2, lanes)
    q, pc = math.sqrt(t1 * t1 + t2 * t2), p + cohesion
    slides = slides & (q > 0.0) & (pc > 0.0)
    if options.mixed:
        given = stressed[0] | stressed[1] | stressed[2]
        outcome = _correct_kappa(trial, stiffness, stressed, outcome, slide, slides & given, lanes)
        slides = slides ^ (slides & given)
    m, by_kappa, _ = strength(kappa, first, peak, reference)
    inverse = 1.0 / choose(slides, q, 1.0)
    n1, n2, target = t1 * inverse, t2 * inverse, m * pc
    write(trial, 1, choose(slides, target * n1, read(trial, 1, lanes)), lanes)
    write(trial, 2, choose(slides, target * n2, read(trial, 2, lanes)), lanes)
    if options.derivatives:
        for column in range(3):
            row = _UNKNOWNS * (1 + column)
            dp, d1, d2 = read(trial, row, lanes), read(trial, row + 1, lanes), read(trial, row + 2, lanes)
            along = n1 * d1 + n2 * d2
            growth = by_kappa * read(slide["trial_kappa_by"], column, lanes) * pc + m * dp
            scale = target * inverse
            write(trial, row + 1, choose(slides, scale * (d1 - n1 * along) + n1 * growth, d1), lanes)
            write(trial, row + 2, choose(slides, scale * (d2 - n2 * along) + n2 * growth, d2), lanes)
    return outcome


@formula
def _correct_kappa(trial, stiffness, stressed, outcome, slide, slides, lanes):
    """Change kappa, and the stresses that are not given with it, until the stress is on the cone."""
    first, peak, reference, exponent, dilatancy, constant, cohesion = cone_of(slide, lanes)
    everything = slides & stressed[0] & stressed[1] & stressed[2]
    if somewhere(everything):
        p, t1, t2 = read(trial, 0, lanes), read(trial, 1, lanes), read(trial, 2, lanes)
        q, before = math.sqrt(t1 * t1 + t2 * t2), read(slide["trial_kappa"], 0, lanes)
        kappa = hardening_strain_at(q / choose(everything, p + cohesion, 1.0), first, peak, reference)
        reached = everything & (kappa < math.inf)
        outcome = choose(everything ^ reached, _BEYOND_PEAK, outcome)
        kappa = choose(reached, larger(kappa, read(slide["kappa"], 0, lanes)), before)
        expansion = dilatancy * (constant - strength(before, first, peak, reference)[0])
        inverse = 1.0 / choose(everything, q, 1.0)
        _, strain = relieved(stiffness, expansion, t1 * inverse, t2 * inverse, stressed, True)
        write(slide["trial_kappa"], 0, kappa, lanes)
        change = (kappa - before) * plastic_share(kappa, reference, exponent)[0]
        for i in range(3):
            write(slide["correction"], i, choose(reached, change * strain[i], 0.0), lanes)
    going = slides ^ everything
    for _ in range(_CORRECTIONS):
        p, t1, t2 = read(trial, 0, lanes), read(trial, 1, lanes), read(trial, 2, lanes)
        q, pc = math.sqrt(t1 * t1 + t2 * t2), p + cohesion
        kappa = read(slide["trial_kappa"], 0, lanes)
        m, by_kappa, _ = strength(kappa, first, peak, reference)
        distance = q - m * pc
        going = going & (abs(distance) > _ROUNDING * pc) & (q > 0.0)
        if not somewhere(going):
            break
        inverse = 1.0 / choose(q > 0.0, q, 1.0)
        n1, n2 = t1 * inverse, t2 * inverse
        expansion = dilatancy * (constant - m)
        (p_r, t1_r, t2_r), strain = relieved(stiffness, expansion, n1, n2, stressed, True)
        share, _ = plastic_share(kappa, reference, exponent)
        resistance = share * (n1 * t1_r + n2 * t2_r - m * p_r) + by_kappa * pc
        going = going & (resistance > 0.0)
        change = choose(going, distance / choose(going, resistance, 1.0), 0.0)
        write(slide["trial_kappa"], 0, kappa + change, lanes)
        change = change * share
        write(trial, 0, choose(going, p - change * p_r, p), lanes)
        write(trial, 1, choose(going, t1 - change * t1_r, t1), lanes)
        write(trial, 2, choose(going, t2 - change * t2_r, t2), lanes)
        for i in range(3):
            more = choose(going, change * strain[i], 0.0)
            write(slide["correction"], i, read(slide["correction"], i, lanes) + more, lanes)
    return outcome


@formula
def plastic_tangent(y, slide, lane, out):
    """Turn the elastic stiffness `out`, shape (3, 3), of a point that slides into the tangent of its rate equations.

    `out` is in the order xx, yy, engineering xy; p, t_1, t_2 stand in the first rows of `y`.
    """
    p, t1, t2, kappa = y[0, lane], y[1, lane], y[2, lane], slide["kappa"][0, lane]
    reference, exponent = slide["reference"][0, lane], slide["exponent"][0, lane]
    q, pc = math.sqrt(t1 * t1 + t2 * t2), p + slide["cohesion"][0, lane]
    if slide["slides"][0, lane] < 0.5 or not q > 0.0:
        return
    m, by_kappa, _ = strength(kappa, slide["first"][0, lane], slide["peak"][0, lane], reference)
    expansion = slide["dilatancy"][0, lane] * (slide["constant"][0, lane] - m)
    n1, n2 = t1 / q, t2 / q
    normal = (0.5 * (m - n1), 0.5 * (m + n1), -n2)
    flow = (-0.5 * (expansion + n1), -0.5 * (expansion - n1), -n2)
    share, _ = plastic_share(kappa, reference, exponent)
    c0 = share * (out[0, 0] * flow[0] + out[0, 1] * flow[1] + out[0, 2] * flow[2])
    c1 = share * (out[1, 0] * flow[0] + out[1, 1] * flow[1] + out[1, 2] * flow[2])
    c2 = share * (out[2, 0] * flow[0] + out[2, 1] * flow[1] + out[2, 2] * flow[2])
    resistance = normal[0] * c0 + normal[1] * c1 + normal[2] * c2 + by_kappa * pc
    if not resistance > 0.0:
        return
    d0 = (normal[0] * out[0, 0] + normal[1] * out[1, 0] + normal[2] * out[2, 0]) / resistance
    d1 = (normal[0] * out[0, 1] + normal[1] * out[1, 1] + normal[2] * out[2, 1]) / resistance
    d2 = (normal[0] * out[0, 2] + normal[1] * out[1, 2] + normal[2] * out[2, 2]) / resistance
    out[0, 0], out[0, 1], out[0, 2] = out[0, 0] - c0 * d0, out[0, 1] - c0 * d1, out[0, 2] - c0 * d2
    out[1, 0], out[1, 1], out[1, 2] = out[1, 0] - c1 * d0, out[1, 1] - c1 * d1, out[1, 2] - c1 * d2
    out[2, 0], out[2, 1], out[2, 2] = out[2, 0] - c2 * d0, out[2, 1] - c2 * d1, out[2, 2] - c2 * d2
