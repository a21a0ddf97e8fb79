"""Sliding inside a Runge-Kutta stage: what plastic strain does to the rates of stress and strain (see `sliding`).

The stage has computed the rates without plastic strain. A substep slides if it starts on the cone and its first stage
finds the multiplier positive; later stages keep to that, with the multiplier cut at zero.

A cone that has not opened yet (M = 0 at gamma_p = 0) has no interior, and its axis no direction of flow. There the
flow turns to where stress goes, t parallel to dt: with u = dkappa times the direction and S, r the relief of the
deviator by plastic shear and by plastic volume change, ``(M' (p + c) + W S) u + W r |u| = dt_e``, which has one root.
"""

import math

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.contract import Status
from granfabric.constitutive.lanes.layout import (
    AT_REST,
    BULK,
    COHESION,
    COLUMN_SLOPE,
    COLUMN_TY,
    COUPLING,
    DECIDES,
    DILATANCY,
    DISSIPATION_RATE,
    ELASTIC_P,
    ELASTIC_T1,
    ELASTIC_T2,
    EXPONENT,
    FLOW_1,
    FLOW_2,
    GAMMA_R,
    KAPPA_RATE,
    LANES,
    M_CV,
    M_FIRST,
    M_PEAK,
    ON_CONE,
    OUTCOME,
    PLASTIC_RATES,
    RATE,
    REVERSED,
    SHEAR,
    SLIDES,
    STIFF_A1,
    STIFF_A2,
    STIFF_B,
    STIFF_G,
    STIFF_K,
    STRAIN,
    TRIAL,
    TRIAL_KAPPA,
    VOLUME_RATE,
    L,
)
from granfabric.constitutive.lanes.mixed_control import plastic_relief

from .cone import AXIS_TOLERANCE, deviator_of, dissipated, plastic_share, strength

_LIMITED = float(Status.LIMITED)
_STIFFNESS_LOST = float(Status.STIFFNESS_LOST)


@compiled()
def relief(w, lane, control, mixed, solver, v, e1, e2):
    """What a plastic strain (v, e1, e2) takes off p, t_1, t_2 (compression positive), and the strain it causes.

    Under mixed control the controlled stresses stay and their strains follow: xx, yy, xy, tension positive.
    """
    if mixed:
        return plastic_relief(w, lane, control, solver, v, e1, e2)
    k, g, b = w[STIFF_K + lane], w[STIFF_G + lane], w[STIFF_B + lane]
    a1, a2 = w[STIFF_A1 + lane], w[STIFF_A2 + lane]
    return k * v + b * (a1 * e1 + a2 * e2), g * e1 + b * a1 * v, g * e2 + b * a2 * v, 0.0, 0.0, 0.0


@compiled()
def _from_the_axis(w, lane, control, mixed, solver, expansion, share, hardening, t1, t2):
    """dkappa and direction of the flow that starts from q = 0; a negative dkappa where there is no solution."""
    _, s11, s21, _, _, _ = relief(w, lane, control, mixed, solver, 0.0, 1.0, 0.0)
    _, s12, s22, _, _, _ = relief(w, lane, control, mixed, solver, 0.0, 0.0, 1.0)
    _, r1, r2, _, _, _ = relief(w, lane, control, mixed, solver, expansion, 0.0, 0.0)
    s11, s12, s21, s22 = share * s11 + hardening, share * s12, share * s21, share * s22 + hardening
    r1, r2 = share * r1, share * r2
    determinant = s11 * s22 - s12 * s21
    if not (determinant > 0.0 and s11 > 0.0):
        return -1.0, 0.0, 0.0
    x1, x2 = (s22 * t1 - s12 * t2) / determinant, (s11 * t2 - s21 * t1) / determinant
    y1, y2 = (s22 * r1 - s12 * r2) / determinant, (s11 * r2 - s21 * r1) / determinant
    # |x - y m| = m
    a, half, c = 1.0 - y1 * y1 - y2 * y2, x1 * y1 + x2 * y2, x1 * x1 + x2 * x2
    if not a > 0.0:
        return -1.0, 0.0, 0.0
    multiplier = (math.sqrt(half * half + a * c) - half) / a
    if not multiplier > 0.0:
        return 0.0, 0.0, 0.0
    return multiplier, (x1 - y1 * multiplier) / multiplier, (x2 - y2 * multiplier) / multiplier


@compiled()
def sliding_rates(w, control, mixed, solver):
    """Take plastic strain into account in the rates of stress and strain; writes KAPPA_RATE and those after it."""
    for lane in range(LANES):
        for row in range(PLASTIC_RATES):
            w[KAPPA_RATE + row * L + lane] = 0.0
        deciding = w[DECIDES + lane] > 0.0
        if deciding:
            w[SLIDES + lane] = w[ON_CONE + lane]
        if w[SLIDES + lane] == 0.0 or w[OUTCOME + lane] > _LIMITED:
            continue
        p, t1, t2 = deviator_of(w[TRIAL + lane], w[TRIAL + L + lane], w[TRIAL + 2 * L + lane])
        elastic_p, elastic_1, elastic_2 = deviator_of(w[RATE + lane], w[RATE + L + lane], w[RATE + 2 * L + lane])
        q, pc = math.sqrt(t1 * t1 + t2 * t2), p + w[COHESION + lane]
        m, by_kappa, _ = strength(w[TRIAL_KAPPA + lane], w[M_FIRST + lane], w[M_PEAK + lane], w[GAMMA_R + lane])
        share, _ = plastic_share(w[TRIAL_KAPPA + lane], w[GAMMA_R + lane], w[EXPONENT + lane])
        expansion, hardening = w[DILATANCY + lane] * (w[M_CV + lane] - m), by_kappa * pc
        at_rest = m <= AXIS_TOLERANCE and q <= AXIS_TOLERANCE * pc
        if at_rest:
            multiplier, n1, n2 = _from_the_axis(
                w, lane, control[lane], mixed, solver, expansion, share, hardening, elastic_1, elastic_2
            )
            solvable = multiplier >= 0.0
        else:
            n1, n2 = (t1 / q, t2 / q) if q > 0.0 else (0.0, 0.0)
            p_r, t1_r, t2_r, _, _, _ = relief(w, lane, control[lane], mixed, solver, expansion, n1, n2)
            resistance = share * (n1 * t1_r + n2 * t2_r - m * p_r) + hardening
            solvable = resistance > 0.0
            multiplier = (n1 * elastic_1 + n2 * elastic_2 - m * elastic_p) / resistance if solvable else 0.0
        if not solvable:
            w[OUTCOME + lane] = _STIFFNESS_LOST
            continue
        if deciding and not (multiplier > 0.0 or at_rest):
            w[SLIDES + lane] = 0.0
            continue
        if multiplier < 0.0:
            w[REVERSED + lane] = 1.0
            multiplier = 0.0
        w[ELASTIC_P + lane], w[ELASTIC_T1 + lane], w[ELASTIC_T2 + lane] = elastic_p, elastic_1, elastic_2
        w[FLOW_1 + lane], w[FLOW_2 + lane], w[AT_REST + lane] = n1, n2, 1.0 if at_rest else 0.0
        p_r, t1_r, t2_r, xx, yy, xy = relief(w, lane, control[lane], mixed, solver, expansion, n1, n2)
        w[KAPPA_RATE + lane] = multiplier
        multiplier *= share
        p_r, t1_r, t2_r = multiplier * p_r, multiplier * t1_r, multiplier * t2_r
        w[RATE + lane] += p_r + t1_r
        w[RATE + L + lane] += p_r - t1_r
        w[RATE + 2 * L + lane] += t2_r
        w[STRAIN + lane] += multiplier * xx
        w[STRAIN + L + lane] += multiplier * yy
        w[STRAIN + 2 * L + lane] += multiplier * xy
        w[VOLUME_RATE + lane] = -multiplier * expansion
        w[DISSIPATION_RATE + lane] = dissipated(multiplier, m, w[COHESION + lane], p, expansion)


@compiled()
def sliding_column(w, column, feedback):
    """Derivative of the rates by one strain component: corrects COLUMN_SLOPE, writes that of kappa.

    Parameters
    ----------
    column : int
    feedback : float
        1 if the stiffness follows the state, else 0.
    """
    for lane in range(LANES):
        slope = KAPPA_RATE + (1 + column) * L + lane
        w[slope] = 0.0
        multiplier = w[KAPPA_RATE + lane]
        # where the multiplier was cut at zero the rates are elastic; where stress starts from q = 0, zero is no cut
        if w[SLIDES + lane] == 0.0 or w[OUTCOME + lane] > _LIMITED or not (multiplier > 0.0 or w[AT_REST + lane] > 0.0):
            continue
        p, t1, t2 = deviator_of(w[TRIAL + lane], w[TRIAL + L + lane], w[TRIAL + 2 * L + lane])
        q, pc = math.sqrt(t1 * t1 + t2 * t2), p + w[COHESION + lane]
        m, by_kappa, twice = strength(w[TRIAL_KAPPA + lane], w[M_FIRST + lane], w[M_PEAK + lane], w[GAMMA_R + lane])
        share, share_by_kappa = plastic_share(w[TRIAL_KAPPA + lane], w[GAMMA_R + lane], w[EXPONENT + lane])
        dilatancy = w[DILATANCY + lane]
        expansion, hardening = dilatancy * (w[M_CV + lane] - m), by_kappa * pc
        k, g, b = w[STIFF_K + lane], w[STIFF_G + lane], w[STIFF_B + lane]
        a1, a2 = w[STIFF_A1 + lane], w[STIFF_A2 + lane]
        n1, n2 = w[FLOW_1 + lane], w[FLOW_2 + lane]
        # changes of the state
        dp, dt1, dt2 = deviator_of(w[COLUMN_TY + lane], w[COLUMN_TY + L + lane], w[COLUMN_TY + 2 * L + lane])
        tz = feedback * w[COLUMN_TY + 3 * L + lane]
        da1, da2 = feedback * w[COLUMN_TY + 4 * L + lane], feedback * w[COLUMN_TY + 5 * L + lane]
        dk, dg, db = w[BULK + lane] * tz, w[SHEAR + lane] * tz, w[COUPLING + lane] * tz
        d_kappa = w[TRIAL_KAPPA + (1 + column) * L + lane]
        dm, d_expansion = by_kappa * d_kappa, -dilatancy * by_kappa * d_kappa
        d_share, d_hardening = share_by_kappa * d_kappa, twice * d_kappa * pc + by_kappa * dp
        # changes of the rates without plastic strain
        de_p, de_1, de_2 = deviator_of(
            w[COLUMN_SLOPE + lane], w[COLUMN_SLOPE + L + lane], w[COLUMN_SLOPE + 2 * L + lane]
        )
        if w[AT_REST + lane] > 0.0:
            # (hardening + W G) u + W B expansion a |u| = elastic deviator
            total, d_total = hardening + share * g, d_hardening + d_share * g + share * dg
            shift = share * b * expansion
            d_shift = d_share * b * expansion + share * (db * expansion + b * d_expansion)
            r1 = de_1 - d_total * multiplier * n1 - multiplier * (d_shift * a1 + shift * da1)
            r2 = de_2 - d_total * multiplier * n2 - multiplier * (d_shift * a2 + shift * da2)
            j11, j12 = total + shift * a1 * n1, shift * a1 * n2
            j21, j22 = shift * a2 * n1, total + shift * a2 * n2
            determinant = j11 * j22 - j12 * j21
            u1, u2 = (j22 * r1 - j12 * r2) / determinant, (j11 * r2 - j21 * r1) / determinant
            d_multiplier = n1 * u1 + n2 * u2
            # dgamma_p times the change of direction
            turn1, turn2 = share * (u1 - n1 * d_multiplier), share * (u2 - n2 * d_multiplier)
        else:
            along = n1 * dt1 + n2 * dt2
            dn1, dn2 = (dt1 - n1 * along) / q, (dt2 - n2 * along) / q
            p_r = k * expansion + b * (a1 * n1 + a2 * n2)
            t1_r, t2_r = g * n1 + b * a1 * expansion, g * n2 + b * a2 * expansion
            dp_r = dk * expansion + k * d_expansion + db * (a1 * n1 + a2 * n2)
            dp_r += b * (da1 * n1 + da2 * n2 + a1 * dn1 + a2 * dn2)
            dt1_r = dg * n1 + g * dn1 + (db * a1 + b * da1) * expansion + b * a1 * d_expansion
            dt2_r = dg * n2 + g * dn2 + (db * a2 + b * da2) * expansion + b * a2 * d_expansion
            plastic = n1 * t1_r + n2 * t2_r - m * p_r
            resistance = share * plastic + hardening
            d_drive = dn1 * w[ELASTIC_T1 + lane] + dn2 * w[ELASTIC_T2 + lane] - dm * w[ELASTIC_P + lane]
            d_drive += n1 * de_1 + n2 * de_2 - m * de_p
            d_plastic = dn1 * t1_r + dn2 * t2_r + n1 * dt1_r + n2 * dt2_r - dm * p_r - m * dp_r
            d_resistance = d_share * plastic + share * d_plastic + d_hardening
            d_multiplier = (d_drive - multiplier * d_resistance) / resistance
            turn1, turn2 = share * multiplier * dn1, share * multiplier * dn2
        # relief of the change of plastic strain, then the change of stiffness on the plastic strain
        gamma, d_gamma = share * multiplier, d_share * multiplier + share * d_multiplier
        v, e1, e2 = gamma * expansion, gamma * n1, gamma * n2
        dv = d_gamma * expansion + gamma * d_expansion
        de1, de2 = d_gamma * n1 + turn1, d_gamma * n2 + turn2
        less_p = k * dv + b * (a1 * de1 + a2 * de2) + dk * v + db * (a1 * e1 + a2 * e2) + b * (da1 * e1 + da2 * e2)
        less_1 = g * de1 + b * a1 * dv + dg * e1 + (db * a1 + b * da1) * v
        less_2 = g * de2 + b * a2 * dv + dg * e2 + (db * a2 + b * da2) * v
        w[COLUMN_SLOPE + lane] += less_p + less_1
        w[COLUMN_SLOPE + L + lane] += less_p - less_1
        w[COLUMN_SLOPE + 2 * L + lane] += less_2
        w[slope] = d_multiplier
