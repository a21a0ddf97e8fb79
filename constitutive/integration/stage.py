"""One Runge-Kutta stage in every lane: rates of stress, micro-state and strain, and their derivatives.

The increment is followed in a pseudo-time from 0 to 1 with constant rates of the controlled components.
"""

import math

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.contract import Status
from granfabric.constitutive.lanes.layout import (
    BULK,
    C_N,
    COLUMN_SLOPE,
    COLUMN_TY,
    COLUMNS,
    COUPLING,
    DENSITY,
    DS1,
    DS2,
    FEEDBACK,
    FLOOR,
    FLUCTUATING,
    FORCE,
    FORCE_CHANGE,
    FORCE_SCALE,
    GAIN,
    GAINED,
    GIVEN,
    IN_A1,
    IN_A2,
    IN_D,
    IN_F,
    IN_N1,
    IN_N2,
    IN_S1,
    IN_S2,
    IN_Z,
    INPUTS,
    INVERSE_P,
    JACOBIAN,
    KERNEL_OPTIONS,
    LANES,
    LIMIT,
    LOSS,
    LOST,
    MAXIMUM_ENTROPY,
    N1,
    N2,
    OUTCOME,
    RATE,
    REFERENCE_A1,
    REFERENCE_A2,
    REFERENCE_Z,
    ROTATION,
    S1,
    S2,
    SHEAR,
    SHEAR_OFFSET,
    SHIFTED_DISTRIBUTION,
    SLIDING,
    SLOPE,
    SOLVED,
    START_N1,
    START_N2,
    START_S1,
    START_S2,
    STIFF_A1,
    STIFF_A2,
    STIFF_B,
    STIFF_G,
    STIFF_K,
    STRAIN,
    TRIAL,
    TRIAL_A1,
    TRIAL_A2,
    TRIAL_TY,
    TRIAL_Z,
    UNKNOWNS,
    D,
    L,
)
from granfabric.constitutive.lanes.mixed_control import solve_mixed
from granfabric.constitutive.lanes.rows import copy_rows
from granfabric.constitutive.lanes.runge_kutta import SMALLEST_COORDINATION
from granfabric.constitutive.network.contact_change import LARGEST_FORCE_ANISOTROPY
from granfabric.constitutive.network.fluctuating_change import scatter_slopes
from granfabric.constitutive.network.rates import network_rates
from granfabric.constitutive.network.weak_force_stage import resolve_network, weak_force_rates, weak_force_slopes
from granfabric.constitutive.sliding.stage import sliding_column, sliding_rates
from granfabric.constitutive.stiffness import stress_rate

OK = float(Status.OK)
LIMITED = float(Status.LIMITED)
NO_PRESSURE = float(Status.NO_PRESSURE)
NOT_ADMISSIBLE = float(Status.NOT_ADMISSIBLE)
STIFFNESS_LOST = float(Status.STIFFNESS_LOST)
NOT_CONVERGED = float(Status.NOT_CONVERGED)


@compiled(inline="always", **KERNEL_OPTIONS)
def stage(w, control, mixed, options, numbers, derivatives, rule, solver):
    """Rates at the stage whose unknowns are in rows TRIAL (and TRIAL_TY); writes RATE ... STRAIN and OUTCOME.

    Parameters
    ----------
    w : ndarray
        Workspace, see `lanes`.
    control : ndarray of uint8, shape (LANES, 3)
        1 where the stress component is given, 0 where the strain component is; read only if `mixed`.
    mixed : bool
    options : ndarray of int64
    derivatives : bool
        Derivatives by the strain increment; pure strain control only.
    numbers : ndarray
        Closure numbers, see `lanes.CHI`.
    rule : tuple
        Gauss-Legendre nodes and weights, cosines and sines of directions equally spaced over the circle.
    solver : ndarray, shape (3, 4)
        Workspace of `mixed_control.solve_mixed`.
    """
    network = options[LOSS] != 0 or options[GAIN] != 0
    shifted = network and options[FORCE_CHANGE] == SHIFTED_DISTRIBUTION
    sliding = options[SLIDING] != 0
    if shifted:
        resolve_network(w, options, numbers, derivatives, rule[2], rule[3])
    _check(w, options)
    if mixed:
        for lane in range(LANES):
            solve_mixed(w, lane, control[lane], solver)
    else:
        _strain_driven(w)
    if sliding:
        sliding_rates(w, control, mixed, solver)
    if network:
        _force_change(w, options)
        if shifted:
            weak_force_rates(w, numbers, derivatives)
        else:
            network_rates(w, options, numbers, derivatives, rule[0], rule[1])
        _refuse_unsolved(w)
    else:
        _network_at_rest(w)
    if derivatives:
        _differentiate(w, options, network)
        if shifted:
            weak_force_slopes(w, numbers)
        elif network and options[FORCE_CHANGE] == FLUCTUATING:
            scatter_slopes(w, numbers)


@compiled(**KERNEL_OPTIONS)
def _strain_driven(w):
    """Stress rate of the given strain rate."""
    for lane in range(LANES):
        x, y, s = stress_rate(
            w[STIFF_K + lane],
            w[STIFF_G + lane],
            w[STIFF_B + lane],
            w[STIFF_A1 + lane],
            w[STIFF_A2 + lane],
            w[GIVEN + lane],
            w[GIVEN + L + lane],
            w[GIVEN + 2 * L + lane],
        )
        w[RATE + lane] = x
        w[RATE + L + lane] = y
        w[RATE + 2 * L + lane] = s
        w[STRAIN + lane] = w[GIVEN + lane]
        w[STRAIN + L + lane] = w[GIVEN + L + lane]
        w[STRAIN + 2 * L + lane] = w[GIVEN + 2 * L + lane]


@compiled(**KERNEL_OPTIONS)
def _refuse_unsolved(w):
    """Fail the lanes whose self-consistent equations have no solution."""
    for lane in range(LANES):
        outcome = w[OUTCOME + lane]
        w[OUTCOME + lane] = NOT_CONVERGED if outcome <= LIMITED and w[SOLVED + lane] != 1.0 else outcome


@compiled(**KERNEL_OPTIONS)
def _network_at_rest(w):
    """No loss and no gain."""
    for row in range(3):
        for lane in range(LANES):
            w[RATE + (3 + row) * L + lane] = 0.0
            w[GAINED + row * L + lane] = 0.0
            w[LOST + row * L + lane] = 0.0


@compiled(**KERNEL_OPTIONS)
def _differentiate(w, options, network):
    """Derivatives of all rates by the strain increment."""
    feedback, rotation = 1.0 if options[FEEDBACK] != 0 else 0.0, 1.0 if options[ROTATION] != 0 else 0.0
    for column in range(COLUMNS):
        # own strain component as mean, deviator and shear
        o_v = 1.0 if column < 2 else 0.0
        o_d = 1.0 if column == 0 else (-1.0 if column == 1 else 0.0)
        o_g = 1.0 if column == 2 else 0.0
        offset = column * UNKNOWNS * L
        copy_rows(w, COLUMN_TY, TRIAL_TY + offset, UNKNOWNS * L)
        _stress_column(w, feedback, o_v, o_d, o_g)
        if options[SLIDING] != 0:
            sliding_column(w, column, feedback)
        _network_column(w, rotation, network)
        copy_rows(w, SLOPE + offset, COLUMN_SLOPE, UNKNOWNS * L)


@compiled(**KERNEL_OPTIONS)
def _check(w, options):
    """Invariants of the stage's stress, and whether the state is one from which rates can be computed."""
    feedback = options[FEEDBACK] != 0
    # shifted weak forces have a density of their own, which is positive
    harmonic = options[DENSITY] != MAXIMUM_ENTROPY and options[FORCE_CHANGE] != SHIFTED_DISTRIBUTION
    for lane in range(LANES):
        z, a1, a2 = w[TRIAL_Z + lane], w[TRIAL_A1 + lane], w[TRIAL_A2 + lane]
        xx, yy, xy = w[TRIAL + lane], w[TRIAL + L + lane], w[TRIAL + 2 * L + lane]
        fabric = a1 * a1 + a2 * a2
        p = -0.5 * (xx + yy)
        zc = z if feedback else w[REFERENCE_Z + lane]
        c1 = a1 if feedback else w[REFERENCE_A1 + lane]
        c2 = a2 if feedback else w[REFERENCE_A2 + lane]
        k, b = w[BULK + lane] * zc, w[COUPLING + lane] * zc
        g = w[SHEAR + lane] * (zc - w[SHEAR_OFFSET + lane])
        definite = g > 0.0 and b * b * (c1 * c1 + c2 * c2) < k * g
        outcome = LIMITED if harmonic and fabric > 1.0 else OK
        outcome = outcome if definite else STIFFNESS_LOST
        outcome = outcome if p > w[FLOOR + lane] else NO_PRESSURE
        admissible = z > SMALLEST_COORDINATION and fabric < 4.0
        outcome = outcome if admissible else NOT_ADMISSIBLE
        usable = outcome <= LIMITED
        # a lane that has failed computes on with harmless numbers
        inverse = 1.0 / (p if usable else 1.0)
        w[OUTCOME + lane] = outcome
        w[INVERSE_P + lane] = inverse
        w[S1 + lane] = -0.5 * (xx - yy) * inverse if usable else 0.0
        w[S2 + lane] = -xy * inverse if usable else 0.0
        w[STIFF_K + lane] = k if usable else 1.0
        w[STIFF_G + lane] = g if usable else 1.0
        w[STIFF_B + lane] = b if usable else 0.0
        w[STIFF_A1 + lane] = c1 if usable else 0.0
        w[STIFF_A2 + lane] = c2 if usable else 0.0
        w[TRIAL_Z + lane] = z if usable else 1.0
        w[TRIAL_A1 + lane] = a1 if usable else 0.0
        w[TRIAL_A2 + lane] = a2 if usable else 0.0
        w[FORCE + lane] = w[FORCE_SCALE + lane] * (p if usable else 1.0) / (z if usable else 1.0)


@compiled(**KERNEL_OPTIONS)
def _force_change(w, options):
    """d = dp/p and ds of the stress rate; a_n, with its magnitude limited so that the mean force stays positive."""
    rotation = options[ROTATION] != 0
    # shifted weak forces divide by no mean force: theirs is not limited
    most = 1e150 if options[FORCE_CHANGE] == SHIFTED_DISTRIBUTION else LARGEST_FORCE_ANISOTROPY
    for lane in range(LANES):
        inverse, s1, s2 = w[INVERSE_P + lane], w[S1 + lane], w[S2 + lane]
        xx, yy, xy = w[RATE + lane], w[RATE + L + lane], w[RATE + 2 * L + lane]
        d = -0.5 * (xx + yy) * inverse
        ds2 = -xy * inverse - s2 * d
        n1 = w[START_N1 + lane] + w[C_N + lane] * (s1 - w[START_S1 + lane])
        n2 = w[START_N2 + lane] + w[C_N + lane] * (s2 - w[START_S2 + lane])
        ds2 = ds2 if rotation else 0.0
        n2 = n2 if rotation else 0.0
        square = n1 * n1 + n2 * n2
        over = square > most * most
        limit = most / math.sqrt(square) if over else 1.0
        w[D + lane] = d
        w[DS1 + lane] = -0.5 * (xx - yy) * inverse - s1 * d
        w[DS2 + lane] = ds2
        w[N1 + lane] = n1 * limit
        w[N2 + lane] = n2 * limit
        w[LIMIT + lane] = limit
        outcome = w[OUTCOME + lane]
        w[OUTCOME + lane] = LIMITED if over and outcome < LIMITED else outcome


@compiled(**KERNEL_OPTIONS)
def _stress_column(w, feedback, o_v, o_d, o_g):
    """Derivative of the elastic stress rate by one component of the strain increment.

    o_v, o_d, o_g are the component's own mean, deviator and shear strain; `feedback` is 1 or 0, as a factor, because
    branches would keep the loops from becoming vector code.
    """
    for lane in range(LANES):
        k, g, b = w[BULK + lane], w[SHEAR + lane], w[COUPLING + lane]
        stiff_k, stiff_g, stiff_b = w[STIFF_K + lane], w[STIFF_G + lane], w[STIFF_B + lane]
        c1, c2 = w[STIFF_A1 + lane], w[STIFF_A2 + lane]
        tz, t1, t2 = w[COLUMN_TY + 3 * L + lane], w[COLUMN_TY + 4 * L + lane], w[COLUMN_TY + 5 * L + lane]
        mean = stiff_k * o_v + stiff_b * (c1 * o_d + c2 * o_g)
        half = stiff_g * o_d + stiff_b * c1 * o_v
        shear = stiff_g * o_g + stiff_b * c2 * o_v
        e_v = w[GIVEN + lane] + w[GIVEN + L + lane]
        e_d = w[GIVEN + lane] - w[GIVEN + L + lane]
        e_g = w[GIVEN + 2 * L + lane]
        tz, t1, t2 = feedback * tz, feedback * t1, feedback * t2
        mean += tz * (k * e_v + b * (c1 * e_d + c2 * e_g)) + stiff_b * (t1 * e_d + t2 * e_g)
        half += tz * (g * e_d + b * c1 * e_v) + stiff_b * t1 * e_v
        shear += tz * (g * e_g + b * c2 * e_v) + stiff_b * t2 * e_v
        w[COLUMN_SLOPE + lane] = mean + half
        w[COLUMN_SLOPE + L + lane] = mean - half
        w[COLUMN_SLOPE + 2 * L + lane] = shear


@compiled(**KERNEL_OPTIONS)
def _network_column(w, rotation, network):
    """Derivative of the rates of the network by one component: product rule from that of the stress rate onwards."""
    if not network:
        for lane in range(LANES):
            w[COLUMN_SLOPE + 3 * L + lane] = 0.0
            w[COLUMN_SLOPE + 4 * L + lane] = 0.0
            w[COLUMN_SLOPE + 5 * L + lane] = 0.0
        return
    for lane in range(LANES):
        inverse, s1, s2, d = w[INVERSE_P + lane], w[S1 + lane], w[S2 + lane], w[D + lane]
        xx, yy, xy = w[RATE + lane], w[RATE + L + lane], w[RATE + 2 * L + lane]
        first, second, shear = w[COLUMN_SLOPE + lane], w[COLUMN_SLOPE + L + lane], w[COLUMN_SLOPE + 2 * L + lane]
        mean, half = 0.5 * (first + second), 0.5 * (first - second)
        t_xx, t_yy, t_xy = w[COLUMN_TY + lane], w[COLUMN_TY + L + lane], w[COLUMN_TY + 2 * L + lane]
        tz, t1, t2 = w[COLUMN_TY + 3 * L + lane], w[COLUMN_TY + 4 * L + lane], w[COLUMN_TY + 5 * L + lane]
        # relative change of p, then of s, d, ds, a_n and f
        relative = -0.5 * (t_xx + t_yy) * inverse
        v1 = -0.5 * (t_xx - t_yy) * inverse - s1 * relative
        v2 = -t_xy * inverse - s2 * relative
        dd = -mean * inverse - d * relative
        w1 = -half * inverse + 0.5 * (xx - yy) * inverse * relative - v1 * d - s1 * dd
        w2 = -shear * inverse + xy * inverse * relative - v2 * d - s2 * dd
        m1, m2 = w[C_N + lane] * v1, w[C_N + lane] * v2
        w2, m2 = rotation * w2, rotation * m2
        # a limited vector only turns: remove the part along itself
        limit = w[LIMIT + lane]
        n1, n2 = w[N1 + lane], w[N2 + lane]
        square = n1 * n1 + n2 * n2
        part = (m1 * n1 + m2 * n2) / (square if square > 0.0 else 1.0)
        part = part if limit < 1.0 else 0.0
        m1, m2 = limit * (m1 - part * n1), limit * (m2 - part * n2)
        df = w[FORCE + lane] * (relative - tz / w[TRIAL_Z + lane])
        for i in range(3):
            row = JACOBIAN + i * INPUTS * L + lane
            w[COLUMN_SLOPE + (3 + i) * L + lane] = (
                w[row + IN_D * L] * dd
                + w[row + IN_S1 * L] * w1
                + w[row + IN_S2 * L] * w2
                + w[row + IN_Z * L] * tz
                + w[row + IN_A1 * L] * t1
                + w[row + IN_A2 * L] * t2
                + w[row + IN_N1 * L] * m1
                + w[row + IN_N2 * L] * m2
                + w[row + IN_F * L] * df
            )
