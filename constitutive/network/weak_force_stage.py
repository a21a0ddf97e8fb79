"""The closure by shifted weak forces inside a Runge-Kutta stage.

Its unknowns S_i, Y take the places of z, a_c. `resolve_network` puts what follows from them and the stress, z and a_c
with their derivatives, where the rest of the stage looks for it; `weak_force_rates` and `weak_force_slopes` give the
rates of Y, and their derivatives, in the form that the rest of the stage takes. S_i has no rate: it is a function of
the largest |s| so far, and `raise_spread` moves it when a substep has been accepted.
"""

import math

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.lanes.layout import (
    C_I,
    C_N,
    CARRIED_N,
    CHI,
    CHI_P,
    CLOSURE_FRICTIONAL,
    COLUMNS,
    FLOOR,
    FORCE_SCALE,
    GAINED,
    HALF_GAP,
    IN_D,
    INPUTS,
    JACOBIAN,
    LANES,
    LARGEST_S,
    LOST,
    NEIGHBOURS,
    NORMAL_TY,
    ORIGIN_A1,
    ORIGIN_A2,
    ORIGIN_Z,
    P_ZERO,
    RATE,
    ROTATION,
    SHIFT_TY,
    SLOPE,
    SOLVED,
    START_N1,
    START_N2,
    START_P,
    START_S1,
    START_S2,
    START_SHIFT,
    TANGENTIAL,
    TRIAL,
    TRIAL_A1,
    TRIAL_A2,
    TRIAL_TY,
    TRIAL_Z,
    TY,
    UNKNOWNS,
    X1,
    X2,
    D,
    L,
    Y,
)
from granfabric.constitutive.stiffness import stress_invariants

from .force_fabric import FRICTIONAL, PROPORTIONAL
from .shifted_distribution import (
    AC1,
    AC2,
    BY_GAIN,
    BY_S1,
    BY_S2,
    BY_SPREAD,
    BY_X0,
    BY_Y1,
    BY_Y2,
    CARRIED1,
    CARRIED2,
    DERIVATIVES,
    SHIFT1,
    SHIFT2,
    Z,
    network_of,
    workspace,
)
from .shifted_distribution import INPUTS as STATE_INPUTS


@compiled()
def shift_and_gain(w, lane, p, chi_p):
    """X_0 at pressure p, and the factor g of gain (f and beta at the initial coordination number)."""
    x0 = chi_p + (w[START_SHIFT + lane] - chi_p) * w[START_P + lane] / p
    room = w[NEIGHBOURS + lane] - w[ORIGIN_Z + lane]
    force = w[FORCE_SCALE + lane] * p / w[ORIGIN_Z + lane]
    return x0, (room if room > 0.0 else 0.0) / w[ORIGIN_Z + lane] * w[HALF_GAP + lane] * force


@compiled()
def network_at(w, lane, p, s1, s2, irreversible, y1, y2, options, numbers, cosines, sines, fabric, out):
    """`network_of` for the stress and the unknowns of a lane; also X_0 and g.

    Returns
    -------
    found : bool
    x0, gain : float
    """
    x0, gain = shift_and_gain(w, lane, p, numbers[CHI_P])
    c_n = w[C_N + lane]
    rotation = options[ROTATION] != 0
    if not rotation:
        s2 = 0.0
    normal1 = w[START_N1 + lane] + c_n * (s1 - w[START_S1 + lane])
    normal2 = w[START_N2 + lane] + c_n * (s2 - w[START_S2 + lane]) if rotation else 0.0
    found = network_of(
        (x0, gain, irreversible, y1, y2, s1, s2),
        (w[X1 + lane], w[X2 + lane]),
        (w[ORIGIN_Z + lane], w[ORIGIN_A1 + lane], w[ORIGIN_A2 + lane]),
        w[P_ZERO + lane],
        (normal1, normal2),
        FRICTIONAL if options[TANGENTIAL] == CLOSURE_FRICTIONAL else PROPORTIONAL,
        c_n,
        numbers,
        cosines,
        sines,
        fabric,
        out,
    )
    return found, x0, gain


@compiled()
def irreversible_spread(w, lane, spread, s1, s2, c_i):
    """S_i at the stress ratio s, given its value at the largest |s| so far, and whether s is beyond that."""
    size, largest = s1 * s1 + s2 * s2, w[LARGEST_S + lane]
    if size > largest * largest:
        return spread + c_i * (size - largest * largest), True
    return spread, False


@compiled()
def resolve_network(w, options, numbers, derivatives, cosines, sines):
    """Put z and a_c of the stage into rows TRIAL_Z ..., and their derivatives into TRIAL_TY.

    SOLVED becomes 2 in lanes where no X_1 is found, else 1.
    """
    fabric, out = workspace()
    for lane in range(LANES):
        w[SOLVED + lane] = 1.0
        spread, y1, y2 = w[TRIAL_Z + lane], w[TRIAL_A1 + lane], w[TRIAL_A2 + lane]
        p, s1, s2 = stress_invariants(w[TRIAL + lane], w[TRIAL + L + lane], w[TRIAL + 2 * L + lane])
        if not p > w[FLOOR + lane] or not math.isfinite(spread + y1 + y2):
            # the check that follows refuses the pressure; numbers that are not finite are refused here
            w[TRIAL_Z + lane] = 1.0 if not p > w[FLOOR + lane] else -1.0
            w[TRIAL_A1 + lane], w[TRIAL_A2 + lane] = 0.0, 0.0
            continue
        if options[ROTATION] == 0:
            s2 = 0.0
        irreversible, virgin = irreversible_spread(w, lane, spread, s1, s2, numbers[C_I])
        found, x0, gain = network_at(
            w, lane, p, s1, s2, irreversible, y1, y2, options, numbers, cosines, sines, fabric, out
        )
        if not found:
            w[SOLVED + lane] = 2.0
            w[TRIAL_Z + lane], w[TRIAL_A1 + lane] = w[ORIGIN_Z + lane], w[ORIGIN_A1 + lane]
            w[TRIAL_A2 + lane] = w[ORIGIN_A2 + lane]
            w[X1 + lane], w[X2 + lane] = 0.0, 0.0
            continue
        w[TRIAL_Z + lane], w[TRIAL_A1 + lane], w[TRIAL_A2 + lane] = out[Z], out[AC1], out[AC2]
        w[X1 + lane], w[X2 + lane] = out[SHIFT1], out[SHIFT2]
        w[CARRIED_N + lane], w[CARRIED_N + L + lane] = out[CARRIED1] - out[AC1], out[CARRIED2] - out[AC2]
        if derivatives:
            for column in range(COLUMNS):
                row = TRIAL_TY + column * UNKNOWNS * L + lane
                t_xx, t_yy, t_xy = w[row], w[row + L], w[row + 2 * L]
                relative = -0.5 * (t_xx + t_yy) / p
                v1 = -0.5 * (t_xx - t_yy) / p - s1 * relative
                v2 = -t_xy / p - s2 * relative if options[ROTATION] != 0 else 0.0
                t_s = 2.0 * numbers[C_I] * (s1 * v1 + s2 * v2) if virgin else w[row + 3 * L]
                by = (-(x0 - numbers[CHI_P]) * relative, gain * relative, t_s, w[row + 4 * L], w[row + 5 * L], v1, v2)
                w[row + 3 * L] = _change(out, Z, by)
                change1, change2 = _change(out, AC1, by), _change(out, AC2, by)
                w[row + 4 * L], w[row + 5 * L] = change1, change2
                w[SHIFT_TY + 2 * column * L + lane] = _change(out, SHIFT1, by)
                w[SHIFT_TY + (2 * column + 1) * L + lane] = _change(out, SHIFT2, by)
                w[NORMAL_TY + 2 * column * L + lane] = _change(out, CARRIED1, by) - change1
                w[NORMAL_TY + (2 * column + 1) * L + lane] = _change(out, CARRIED2, by) - change2


@compiled(inline="always")
def _change(out, entry, by):
    """Change of an entry of the result with changes of its inputs."""
    row = DERIVATIVES + entry * STATE_INPUTS
    return (
        out[row + BY_X0] * by[0]
        + out[row + BY_GAIN] * by[1]
        + out[row + BY_SPREAD] * by[2]
        + out[row + BY_Y1] * by[3]
        + out[row + BY_Y2] * by[4]
        + out[row + BY_S1] * by[5]
        + out[row + BY_S2] * by[6]
    )


@compiled()
def weak_force_rates(w, numbers, derivatives):
    """Rates of S_i (none) and Y into RATE 3 ... 5, with their derivatives by d into JACOBIAN."""
    chi = numbers[CHI]
    for lane in range(LANES):
        d = w[D + lane]
        factor1 = chi * w[CARRIED_N + lane] - w[X1 + lane]
        factor2 = chi * w[CARRIED_N + L + lane] - w[X2 + lane]
        w[RATE + 3 * L + lane] = 0.0
        w[RATE + 4 * L + lane] = factor1 * d
        w[RATE + 5 * L + lane] = factor2 * d
        for i in range(3):
            w[GAINED + i * L + lane] = 0.0
            w[LOST + i * L + lane] = 0.0
        if derivatives:
            for entry in range(3 * INPUTS):
                w[JACOBIAN + entry * L + lane] = 0.0
            w[JACOBIAN + (INPUTS + IN_D) * L + lane] = factor1
            w[JACOBIAN + (2 * INPUTS + IN_D) * L + lane] = factor2


@compiled()
def weak_force_slopes(w, numbers):
    """Add what d alone leaves out: the changes of a_n and X_1."""
    chi = numbers[CHI]
    for column in range(COLUMNS):
        row = SLOPE + column * UNKNOWNS * L
        for lane in range(LANES):
            d = w[D + lane]
            for i in range(2):
                entry = (2 * column + i) * L + lane
                w[row + (4 + i) * L + lane] += d * (chi * w[NORMAL_TY + entry] - w[SHIFT_TY + entry])


@compiled()
def raise_spread(w, lane, options, numbers, derivatives):
    """S_i and the largest |s| at the end of an accepted substep, with the derivatives of S_i."""
    _, s1, s2 = stress_invariants(w[Y + lane], w[Y + L + lane], w[Y + 2 * L + lane])
    if options[ROTATION] == 0:
        s2 = 0.0
    spread, virgin = irreversible_spread(w, lane, w[Y + 3 * L + lane], s1, s2, numbers[C_I])
    if not virgin:
        return
    w[Y + 3 * L + lane] = spread
    w[LARGEST_S + lane] = math.sqrt(s1 * s1 + s2 * s2)
    if derivatives:
        turn_spread(w, lane, options, numbers)


@compiled()
def turn_spread(w, lane, options, numbers):
    """Derivatives of S_i from those of the stress, where |s| is at its largest so far."""
    p, s1, s2 = stress_invariants(w[Y + lane], w[Y + L + lane], w[Y + 2 * L + lane])
    rotation = options[ROTATION] != 0
    if not rotation:
        s2 = 0.0
    if math.sqrt(s1 * s1 + s2 * s2) < w[LARGEST_S + lane]:
        return
    for column in range(COLUMNS):
        row = TY + column * UNKNOWNS * L + lane
        relative = -0.5 * (w[row] + w[row + L]) / p
        v1 = -0.5 * (w[row] - w[row + L]) / p - s1 * relative
        v2 = -w[row + 2 * L] / p - s2 * relative if rotation else 0.0
        w[row + 3 * L] = 2.0 * numbers[C_I] * (s1 * v1 + s2 * v2)
