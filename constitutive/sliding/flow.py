"""Sliding inside a Runge-Kutta stage: what plastic strain does to the rates of stress and strain (see `cone`).

The stage has computed the rates without plastic strain. A substep slides if it starts on the cone and its first stage
finds the multiplier positive; later stages keep to that, with the multiplier cut at zero.

A cone that has not opened yet (M = 0 at gamma_p = 0) has no interior, and its axis no direction of flow. There the
flow turns to where stress goes, t parallel to dt: with u = dkappa times the direction and S, r the relief of the
deviator by plastic shear and by plastic volume change, ``(M' (p + c) + W S) u + W r |u| = dt_e``, which has one root.
"""

import math

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.contract import Status
from granfabric.constitutive.mixed_control import relief
from granfabric.constitutive.stiffness import stress_rate, stress_rate_change

from .cone import AXIS_TOLERANCE, dissipated, plastic_share, strength

_LIMITED = float(Status.LIMITED)
_STIFFNESS_LOST = float(Status.STIFFNESS_LOST)


@formula
def relieved(stiffness, v, e1, e2, stressed):
    """What a plastic strain takes off p, t_1, t_2 (compression positive), and the strain it causes (see `relief`)."""
    if stressed[0] or stressed[1] or stressed[2]:
        return relief(stiffness, v, e1, e2, stressed)
    return stress_rate(stiffness, v, e1, e2), (0.0, 0.0, 0.0)


@formula
def _from_the_axis(stiffness, stressed, expansion, share, hardening, t1, t2):
    """dkappa and direction of the flow that starts from q = 0; a negative dkappa where there is no solution."""
    (_, s11, s21), _ = relieved(stiffness, 0.0, 1.0, 0.0, stressed)
    (_, s12, s22), _ = relieved(stiffness, 0.0, 0.0, 1.0, stressed)
    (_, r1, r2), _ = relieved(stiffness, expansion, 0.0, 0.0, stressed)
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


@formula
def sliding_rates(number, stress, elastic, stiffness, stressed, outcome, slide, k, strain_row):
    """Rates of p, t_1, t_2 with plastic strain, and the stage's status; those of kappa go into `slide`.

    Parameters
    ----------
    number : int
        Of the stage.
    stress, elastic : tuples of 3
        p, t_1, t_2, and their rates without plastic strain.
    stiffness, stressed :
        As in `mixed_control.solve_with_given`.
    outcome : float
    slide : record
        See `slide.SLIDE`.
    k : ndarray
        What plastic strain adds to the strain of components of given stress is added from `strain_row` on.
    """
    slide["kappa_rate"][number], slide["volume_rate"][number], slide["work_rate"][number] = 0.0, 0.0, 0.0
    for column in range(3):
        slide["kappa_slope"][number, column] = 0.0
    if slide["decides"]:
        slide["slides"] = slide["on_cone"]
    if not slide["slides"] or outcome > _LIMITED:
        return elastic, outcome
    p, t1, t2 = stress
    q, pc = math.sqrt(t1 * t1 + t2 * t2), p + slide["cohesion"]
    m, by_kappa, _ = strength(slide["trial_kappa"], slide["first"], slide["peak"], slide["reference"])
    share, _ = plastic_share(slide["trial_kappa"], slide["reference"], slide["exponent"])
    expansion, hardening = slide["dilatancy"] * (slide["constant"] - m), by_kappa * pc
    at_rest = m <= AXIS_TOLERANCE and q <= AXIS_TOLERANCE * pc
    if at_rest:
        multiplier, n1, n2 = _from_the_axis(stiffness, stressed, expansion, share, hardening, elastic[1], elastic[2])
        solvable = multiplier >= 0.0
    else:
        n1, n2 = (t1 / q, t2 / q) if q > 0.0 else (0.0, 0.0)
        (p_r, t1_r, t2_r), _ = relieved(stiffness, expansion, n1, n2, stressed)
        resistance = share * (n1 * t1_r + n2 * t2_r - m * p_r) + hardening
        solvable = resistance > 0.0
        multiplier = (n1 * elastic[1] + n2 * elastic[2] - m * elastic[0]) / resistance if solvable else 0.0
    if not solvable:
        return elastic, _STIFFNESS_LOST
    if slide["decides"] and not (multiplier > 0.0 or at_rest):
        slide["slides"] = False
        return elastic, outcome
    if multiplier < 0.0:
        slide["turned_back"] = True
        multiplier = 0.0
    slide["elastic"][0], slide["elastic"][1], slide["elastic"][2] = elastic
    slide["flow"][0], slide["flow"][1], slide["at_rest"] = n1, n2, at_rest
    (p_r, t1_r, t2_r), more = relieved(stiffness, expansion, n1, n2, stressed)
    slide["kappa_rate"][number] = multiplier
    multiplier *= share
    for i in range(3):
        k[strain_row + i, 0] += multiplier * more[i]
    slide["volume_rate"][number] = -multiplier * expansion
    slide["work_rate"][number] = dissipated(multiplier, m, slide["cohesion"], p, expansion)
    return (elastic[0] - multiplier * p_r, elastic[1] - multiplier * t1_r, elastic[2] - multiplier * t2_r), outcome


@formula
def sliding_changes(number, column, stress, change, elastic_change, stiffness, stiffening, outcome, slide):
    """Change of the stress rates by one component of the strain increment; that of kappa goes into `slide`.

    Parameters
    ----------
    number, column : int
        Of the stage and of the strain component.
    stress, change : tuples of 3
        p, t_1, t_2 and their changes.
    elastic_change : tuple of 3
        Change of the rates without plastic strain.
    stiffness, stiffening : tuples of 5
        K, G, B, a_c, and changes of K, G, B, B a_c.
    outcome : float
    slide : record
    """
    multiplier = slide["kappa_rate"][number]
    # where the multiplier was cut at zero the rates are elastic; where stress starts from q = 0, zero is no cut
    if not slide["slides"] or outcome > _LIMITED or not (multiplier > 0.0 or slide["at_rest"]):
        return elastic_change
    p, t1, t2 = stress
    dp, dt1, dt2 = change
    de_p, de_1, de_2 = elastic_change
    q, pc = math.sqrt(t1 * t1 + t2 * t2), p + slide["cohesion"]
    m, by_kappa, twice = strength(slide["trial_kappa"], slide["first"], slide["peak"], slide["reference"])
    share, share_by_kappa = plastic_share(slide["trial_kappa"], slide["reference"], slide["exponent"])
    dilatancy = slide["dilatancy"]
    expansion, hardening = dilatancy * (slide["constant"] - m), by_kappa * pc
    k, g, b, a1, a2 = stiffness
    dk, dg, db, db1, db2 = stiffening
    n1, n2 = slide["flow"][0], slide["flow"][1]
    d_kappa = slide["trial_kappa_by"][column]
    dm, d_expansion = by_kappa * d_kappa, -dilatancy * by_kappa * d_kappa
    d_share, d_hardening = share_by_kappa * d_kappa, twice * d_kappa * pc + by_kappa * dp
    if slide["at_rest"]:
        # (hardening + W G) u + W B expansion a |u| = elastic deviator
        total, d_total = hardening + share * g, d_hardening + d_share * g + share * dg
        shift1, shift2 = share * b * expansion * a1, share * b * expansion * a2
        d_shift1 = (d_share * expansion + share * d_expansion) * b * a1 + share * expansion * db1
        d_shift2 = (d_share * expansion + share * d_expansion) * b * a2 + share * expansion * db2
        r1 = de_1 - d_total * multiplier * n1 - multiplier * d_shift1
        r2 = de_2 - d_total * multiplier * n2 - multiplier * d_shift2
        j11, j12 = total + shift1 * n1, shift1 * n2
        j21, j22 = shift2 * n1, total + shift2 * n2
        determinant = j11 * j22 - j12 * j21
        u1, u2 = (j22 * r1 - j12 * r2) / determinant, (j11 * r2 - j21 * r1) / determinant
        d_multiplier = n1 * u1 + n2 * u2
        # dgamma_p times the change of direction
        turn1, turn2 = share * (u1 - n1 * d_multiplier), share * (u2 - n2 * d_multiplier)
    else:
        along = n1 * dt1 + n2 * dt2
        dn1, dn2 = (dt1 - n1 * along) / q, (dt2 - n2 * along) / q
        p_r, t1_r, t2_r = stress_rate(stiffness, expansion, n1, n2)
        x_p, x_1, x_2 = stress_rate_change(stiffening, expansion, n1, n2)
        y_p, y_1, y_2 = stress_rate(stiffness, d_expansion, dn1, dn2)
        dp_r, dt1_r, dt2_r = x_p + y_p, x_1 + y_1, x_2 + y_2
        plastic = n1 * t1_r + n2 * t2_r - m * p_r
        resistance = share * plastic + hardening
        d_drive = dn1 * slide["elastic"][1] + dn2 * slide["elastic"][2] - dm * slide["elastic"][0]
        d_drive += n1 * de_1 + n2 * de_2 - m * de_p
        d_plastic = dn1 * t1_r + dn2 * t2_r + n1 * dt1_r + n2 * dt2_r - dm * p_r - m * dp_r
        d_resistance = d_share * plastic + share * d_plastic + d_hardening
        d_multiplier = (d_drive - multiplier * d_resistance) / resistance
        turn1, turn2 = share * multiplier * dn1, share * multiplier * dn2
    slide["kappa_slope"][number, column] = d_multiplier
    # relief of the change of plastic strain, then the change of stiffness on the plastic strain
    gamma, d_gamma = share * multiplier, d_share * multiplier + share * d_multiplier
    x_p, x_1, x_2 = stress_rate(
        stiffness, d_gamma * expansion + gamma * d_expansion, d_gamma * n1 + turn1, d_gamma * n2 + turn2
    )
    y_p, y_1, y_2 = stress_rate_change(stiffening, gamma * expansion, gamma * n1, gamma * n2)
    return de_p - x_p - y_p, de_1 - x_1 - y_1, de_2 - x_2 - y_2
