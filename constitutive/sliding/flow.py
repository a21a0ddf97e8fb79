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
from granfabric.constitutive.lanes.eight import choose, read, somewhere, write
from granfabric.constitutive.lanes.elementary import larger
from granfabric.constitutive.mixed_control import relief
from granfabric.constitutive.stiffness import stress_rate, stress_rate_change

from .cone import AXIS_TOLERANCE, dissipated, plastic_share, strength
from .slide import cone_of

_LIMITED = float(Status.LIMITED)
_STIFFNESS_LOST = float(Status.STIFFNESS_LOST)


@formula
def relieved(stiffness, v, e1, e2, stressed, mixed):
    """What a plastic strain takes off p, t_1, t_2 (compression positive), and the strain it causes (see `relief`)."""
    zero = 0.0 * v
    left, strain = stress_rate(stiffness, v, e1, e2), (zero, zero, zero)
    if mixed:
        left, strain = relief(stiffness, v, e1, e2, stressed)
    return left, strain


@formula
def _from_the_axis(stiffness, stressed, mixed, expansion, share, hardening, t1, t2):
    """dkappa and direction of the flow that starts from q = 0; a negative dkappa where there is no solution."""
    zero = 0.0 * expansion
    (_, s11, s21), _ = relieved(stiffness, zero, 1.0 + zero, zero, stressed, mixed)
    (_, s12, s22), _ = relieved(stiffness, zero, zero, 1.0 + zero, stressed, mixed)
    (_, r1, r2), _ = relieved(stiffness, expansion, zero, zero, stressed, mixed)
    s11, s12, s21, s22 = share * s11 + hardening, share * s12, share * s21, share * s22 + hardening
    r1, r2 = share * r1, share * r2
    determinant = s11 * s22 - s12 * s21
    solvable = (determinant > 0.0) & (s11 > 0.0)
    inverse = 1.0 / choose(solvable, determinant, 1.0)
    x1, x2 = (s22 * t1 - s12 * t2) * inverse, (s11 * t2 - s21 * t1) * inverse
    y1, y2 = (s22 * r1 - s12 * r2) * inverse, (s11 * r2 - s21 * r1) * inverse
    # |x - y m| = m
    a, half, c = 1.0 - y1 * y1 - y2 * y2, x1 * y1 + x2 * y2, x1 * x1 + x2 * x2
    solvable = solvable & (a > 0.0)
    a = choose(solvable, a, 1.0)
    multiplier = (math.sqrt(larger(half * half + a * c, 0.0)) - half) / a
    moves = solvable & (multiplier > 0.0)
    inverse = 1.0 / choose(moves, multiplier, 1.0)
    n1, n2 = (x1 - y1 * multiplier) * inverse, (x2 - y2 * multiplier) * inverse
    multiplier = choose(moves, multiplier, choose(solvable, 0.0, -1.0))
    return multiplier, choose(moves, n1, 0.0), choose(moves, n2, 0.0)


@formula
def sliding_rates(number, deciding, stress, elastic, stiffness, stressed, mixed, outcome, slide, k, strain_row, lanes):
    """Rates of p, t_1, t_2 with plastic strain, and the stage's status; those of kappa go into `slide`.

    Parameters
    ----------
    number : int
        Of the stage.
    deciding : bool
        The stage is the first of its substep.
    stress, elastic : tuples of 3
        p, t_1, t_2, and their rates without plastic strain.
    stiffness, stressed :
        As in `mixed_control.solve_with_given`.
    mixed : bool
        Whether stress may be given.
    outcome : float
    slide : record
        See `slide.SLIDE`.
    k : ndarray
        What plastic strain adds to the strain of components of given stress is added from `strain_row` on.
    """
    zero = 0.0 * elastic[0]
    write(slide["kappa_rate"], number, zero, lanes)
    write(slide["volume_rate"], number, zero, lanes)
    write(slide["work_rate"], number, zero, lanes)
    for column in range(3):
        write(slide["kappa_slope"], 3 * number + column, zero, lanes)
    if deciding:
        write(slide["slides"], 0, read(slide["on_cone"], 0, lanes), lanes)
    slides = (read(slide["slides"], 0, lanes) > 0.5) & (outcome <= _LIMITED)
    if not somewhere(slides):
        return elastic, outcome
    first, peak, reference, exponent, dilatancy, constant, cohesion = cone_of(slide, lanes)
    kappa = read(slide["trial_kappa"], 0, lanes)
    p, t1, t2 = stress
    q, pc = math.sqrt(t1 * t1 + t2 * t2), p + cohesion
    m, by_kappa, _ = strength(kappa, first, peak, reference)
    share, _ = plastic_share(kappa, reference, exponent)
    expansion, hardening = dilatancy * (constant - m), by_kappa * pc
    at_rest = slides & (m <= AXIS_TOLERANCE) & (q <= AXIS_TOLERANCE * pc)
    inverse = 1.0 / choose(q > 0.0, q, 1.0)
    n1, n2 = t1 * inverse, t2 * inverse
    (p_r, t1_r, t2_r), _ = relieved(stiffness, expansion, n1, n2, stressed, mixed)
    resistance = share * (n1 * t1_r + n2 * t2_r - m * p_r) + hardening
    solvable = resistance > 0.0
    multiplier = (n1 * elastic[1] + n2 * elastic[2] - m * elastic[0]) / choose(solvable, resistance, 1.0)
    if somewhere(at_rest):
        start, u1, u2 = _from_the_axis(stiffness, stressed, mixed, expansion, share, hardening, elastic[1], elastic[2])
        solvable = choose(at_rest, choose(start >= 0.0, 1.0 + zero, zero), choose(solvable, 1.0 + zero, zero)) > 0.5
        multiplier, n1, n2 = choose(at_rest, start, multiplier), choose(at_rest, u1, n1), choose(at_rest, u2, n2)
    outcome = choose(slides, choose(solvable, outcome, _STIFFNESS_LOST), outcome)
    slides = slides & solvable
    if deciding:
        stays = (multiplier > 0.0) | at_rest
        write(slide["slides"], 0, choose(slides & stays, 1.0 + zero, zero), lanes)
        slides = slides & stays
    turned_back = choose(slides & (multiplier < 0.0), 1.0 + zero, read(slide["turned_back"], 0, lanes))
    write(slide["turned_back"], 0, turned_back, lanes)
    multiplier = choose(slides, larger(multiplier, 0.0), 0.0)
    for i in range(3):
        write(slide["elastic"], i, elastic[i], lanes)
    write(slide["flow"], 0, n1, lanes)
    write(slide["flow"], 1, n2, lanes)
    write(slide["at_rest"], 0, choose(at_rest, 1.0 + zero, zero), lanes)
    (p_r, t1_r, t2_r), more = relieved(stiffness, expansion, n1, n2, stressed, mixed)
    write(slide["kappa_rate"], number, multiplier, lanes)
    multiplier = multiplier * share
    if mixed:
        for i in range(3):
            row = strain_row + i
            write(k, row, read(k, row, lanes) + multiplier * more[i], lanes)
    write(slide["volume_rate"], number, -multiplier * expansion, lanes)
    write(slide["work_rate"], number, dissipated(multiplier, m, cohesion, p, expansion), lanes)
    sliding = (elastic[0] - multiplier * p_r, elastic[1] - multiplier * t1_r, elastic[2] - multiplier * t2_r)
    return choose(slides, sliding, elastic), outcome


@formula
def sliding_changes(number, column, stress, change, elastic_change, stiffness, stiffening, outcome, slide, lanes):
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
    multiplier, at_rest = read(slide["kappa_rate"], number, lanes), read(slide["at_rest"], 0, lanes) > 0.5
    # where the multiplier was cut at zero the rates are elastic; where stress starts from q = 0, zero is no cut
    slides = (read(slide["slides"], 0, lanes) > 0.5) & (outcome <= _LIMITED) & ((multiplier > 0.0) | at_rest)
    if not somewhere(slides):
        return elastic_change
    first, peak, reference, exponent, dilatancy, constant, cohesion = cone_of(slide, lanes)
    kappa, d_kappa = read(slide["trial_kappa"], 0, lanes), read(slide["trial_kappa_by"], column, lanes)
    p, t1, t2 = stress
    dp, dt1, dt2 = change
    de_p, de_1, de_2 = elastic_change
    q, pc = math.sqrt(t1 * t1 + t2 * t2), p + cohesion
    m, by_kappa, twice = strength(kappa, first, peak, reference)
    share, share_by_kappa = plastic_share(kappa, reference, exponent)
    expansion, hardening = dilatancy * (constant - m), by_kappa * pc
    _, g, b, a1, a2 = stiffness
    _, dg, _, db1, db2 = stiffening
    n1, n2 = read(slide["flow"], 0, lanes), read(slide["flow"], 1, lanes)
    dm, d_expansion = by_kappa * d_kappa, -dilatancy * by_kappa * d_kappa
    d_share, d_hardening = share_by_kappa * d_kappa, twice * d_kappa * pc + by_kappa * dp
    along = n1 * dt1 + n2 * dt2
    inverse = 1.0 / choose(q > 0.0, q, 1.0)
    dn1, dn2 = (dt1 - n1 * along) * inverse, (dt2 - n2 * along) * inverse
    p_r, t1_r, t2_r = stress_rate(stiffness, expansion, n1, n2)
    x_p, x_1, x_2 = stress_rate_change(stiffening, expansion, n1, n2)
    y_p, y_1, y_2 = stress_rate(stiffness, d_expansion, dn1, dn2)
    dp_r, dt1_r, dt2_r = x_p + y_p, x_1 + y_1, x_2 + y_2
    plastic = n1 * t1_r + n2 * t2_r - m * p_r
    resistance = share * plastic + hardening
    d_drive = dn1 * read(slide["elastic"], 1, lanes) + dn2 * read(slide["elastic"], 2, lanes)
    d_drive += n1 * de_1 + n2 * de_2 - m * de_p - dm * read(slide["elastic"], 0, lanes)
    d_plastic = dn1 * t1_r + dn2 * t2_r + n1 * dt1_r + n2 * dt2_r - dm * p_r - m * dp_r
    d_resistance = d_share * plastic + share * d_plastic + d_hardening
    d_multiplier = (d_drive - multiplier * d_resistance) / choose(slides, resistance, 1.0)
    turn1, turn2 = share * multiplier * dn1, share * multiplier * dn2
    if somewhere(at_rest):
        # (hardening + W G) u + W B expansion a |u| = elastic deviator
        total, d_total = hardening + share * g, d_hardening + d_share * g + share * dg
        shift1, shift2 = share * b * expansion * a1, share * b * expansion * a2
        d_shift1 = (d_share * expansion + share * d_expansion) * b * a1 + share * expansion * db1
        d_shift2 = (d_share * expansion + share * d_expansion) * b * a2 + share * expansion * db2
        r1 = de_1 - d_total * multiplier * n1 - multiplier * d_shift1
        r2 = de_2 - d_total * multiplier * n2 - multiplier * d_shift2
        j11, j12 = total + shift1 * n1, shift1 * n2
        j21, j22 = shift2 * n1, total + shift2 * n2
        inverse = 1.0 / choose(at_rest, j11 * j22 - j12 * j21, 1.0)
        u1, u2 = (j22 * r1 - j12 * r2) * inverse, (j11 * r2 - j21 * r1) * inverse
        grows = n1 * u1 + n2 * u2
        d_multiplier = choose(at_rest, grows, d_multiplier)
        # dgamma_p times the change of direction
        turn1 = choose(at_rest, share * (u1 - n1 * grows), turn1)
        turn2 = choose(at_rest, share * (u2 - n2 * grows), turn2)
    write(slide["kappa_slope"], 3 * number + column, choose(slides, d_multiplier, 0.0), lanes)
    # relief of the change of plastic strain, then the change of stiffness on the plastic strain
    gamma, d_gamma = share * multiplier, d_share * multiplier + share * d_multiplier
    x_p, x_1, x_2 = stress_rate(
        stiffness, d_gamma * expansion + gamma * d_expansion, d_gamma * n1 + turn1, d_gamma * n2 + turn2
    )
    y_p, y_1, y_2 = stress_rate_change(stiffening, gamma * expansion, gamma * n1, gamma * n2)
    return choose(slides, (de_p - x_p - y_p, de_1 - x_1 - y_1, de_2 - x_2 - y_2), elastic_change)
