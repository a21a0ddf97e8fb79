"""The closure by shifted weak forces inside a Runge-Kutta stage.

Its unknowns S_i, Y take the places of z, a_c. `resolve_network` puts what follows from them, z and a_c with their
derivatives, where the rest of the stage looks for it; `weak_force_rates` and `weak_force_slopes` give the rates of
S_i and Y, and their derivatives, in the form that the rest of the stage takes.
"""

import math

import numpy as np

from .compilation import compiled
from .lanes import (
    C_E,
    C_N,
    C_W,
    CHI,
    CHI_P,
    COLUMNS,
    DS1,
    DS2,
    FLOOR,
    FORCE,
    FORCE_SCALE,
    GAINED,
    GIVEN,
    HALF_GAP,
    IN_A1,
    IN_A2,
    IN_D,
    IN_F,
    IN_N1,
    IN_N2,
    IN_S1,
    IN_S2,
    INPUTS,
    JACOBIAN,
    LANES,
    LARGEST_S,
    LOST,
    N1,
    N2,
    NEIGHBOURS,
    ORIGIN_A1,
    ORIGIN_A2,
    ORIGIN_Z,
    P_ZERO,
    RATE,
    S1,
    S2,
    SLOPE,
    SLOT,
    SLOT_TY,
    SOLVED,
    START_P,
    START_SHIFT,
    STRAIN,
    TRIAL,
    TRIAL_A1,
    TRIAL_A2,
    TRIAL_TY,
    TRIAL_Z,
    UNKNOWNS,
    VIRGIN,
    X1,
    X2,
    D,
    L,
)
from .shifted_distribution import network_of

VIRGIN_TOLERANCE = 1e-9
"""|s| within this of its largest value so far counts as being there."""


@compiled()
def shift_and_gain(w, lane, p, chi_p):
    """X_0 at pressure p, and the factor g of gain (f and beta at the initial coordination number)."""
    x0 = chi_p + (w[START_SHIFT + lane] - chi_p) * w[START_P + lane] / p
    room = w[NEIGHBOURS + lane] - w[ORIGIN_Z + lane]
    force = w[FORCE_SCALE + lane] * p / w[ORIGIN_Z + lane]
    return x0, (room if room > 0.0 else 0.0) / w[ORIGIN_Z + lane] * w[HALF_GAP + lane] * force


@compiled()
def resolve_network(w, numbers, derivatives, cosines, sines):
    """Put z and a_c of the stage into rows TRIAL_Z ..., and their derivatives into TRIAL_TY; keep S_i, Y in SLOT.

    SOLVED becomes 2 in lanes where no X_1 is found, else 1.
    """
    out = np.empty(20)
    for lane in range(LANES):
        w[SOLVED + lane] = 1.0
        spread, y1, y2 = w[TRIAL_Z + lane], w[TRIAL_A1 + lane], w[TRIAL_A2 + lane]
        w[SLOT + lane], w[SLOT + L + lane], w[SLOT + 2 * L + lane] = spread, y1, y2
        for column in range(COLUMNS):
            row = TRIAL_TY + (column * UNKNOWNS + 3) * L + lane
            for i in range(3):
                w[SLOT_TY + (3 * column + i) * L + lane] = w[row + i * L]
        p = -0.5 * (w[TRIAL + lane] + w[TRIAL + L + lane])
        if not p > w[FLOOR + lane] or not math.isfinite(spread + y1 + y2):
            # the check that follows refuses the pressure; numbers that are not finite are refused here
            w[TRIAL_Z + lane] = 1.0 if not p > w[FLOOR + lane] else -1.0
            w[TRIAL_A1 + lane], w[TRIAL_A2 + lane] = 0.0, 0.0
            continue
        x0, gain = shift_and_gain(w, lane, p, numbers[CHI_P])
        origin = (w[ORIGIN_Z + lane], w[ORIGIN_A1 + lane], w[ORIGIN_A2 + lane])
        found = network_of(
            x0,
            y1,
            y2,
            spread,
            w[X1 + lane],
            w[X2 + lane],
            origin,
            w[P_ZERO + lane],
            gain,
            numbers[CHI],
            numbers[C_E],
            cosines,
            sines,
            out,
        )
        if not found:
            w[SOLVED + lane] = 2.0
            w[TRIAL_Z + lane], w[TRIAL_A1 + lane], w[TRIAL_A2 + lane] = origin
            w[X1 + lane], w[X2 + lane] = 0.0, 0.0
            continue
        w[TRIAL_Z + lane], w[TRIAL_A1 + lane], w[TRIAL_A2 + lane] = out[0], out[1], out[2]
        w[X1 + lane], w[X2 + lane] = out[3], out[4]
        if derivatives:
            for column in range(COLUMNS):
                row = TRIAL_TY + column * UNKNOWNS * L + lane
                relative = -0.5 * (w[row] + w[row + L]) / p
                by_shift, by_gain = -(x0 - numbers[CHI_P]) * relative, gain * relative
                t_s = w[SLOT_TY + 3 * column * L + lane]
                t_1 = w[SLOT_TY + (3 * column + 1) * L + lane]
                t_2 = w[SLOT_TY + (3 * column + 2) * L + lane]
                for i in range(3):
                    k = 5 + 5 * i
                    by_p = out[k] * by_shift + out[k + 1] * by_gain
                    w[row + (3 + i) * L] = by_p + out[k + 2] * t_s + out[k + 3] * t_1 + out[k + 4] * t_2


@compiled()
def weak_force_rates(w, numbers, derivatives):
    """Rates of S_i and Y into RATE 3 ... 5, with their derivatives by the nine inputs into JACOBIAN."""
    chi = numbers[CHI]
    for lane in range(LANES):
        d, ds1, ds2 = w[D + lane], w[DS1 + lane], w[DS2 + lane]
        s1, s2 = w[S1 + lane], w[S2 + lane]
        size = math.sqrt(s1 * s1 + s2 * s2)
        outward = s1 * ds1 + s2 * ds2
        largest = w[LARGEST_S + lane]
        virgin = size >= largest * (1.0 - VIRGIN_TOLERANCE) and (outward > 0.0 or largest == 0.0)
        deviator, shear = w[STRAIN + lane] - w[STRAIN + L + lane], w[STRAIN + 2 * L + lane]
        strain = math.sqrt(deviator * deviator + shear * shear)
        force = w[FORCE + lane]
        w[VIRGIN + lane] = numbers[C_W] / force if virgin else 0.0
        spreading = w[VIRGIN + lane] * strain
        x1, x2 = w[X1 + lane], w[X2 + lane]
        w[RATE + 3 * L + lane] = spreading
        w[RATE + 4 * L + lane] = chi * (w[N1 + lane] * d + w[C_N + lane] * ds1) - x1 * d
        w[RATE + 5 * L + lane] = chi * (w[N2 + lane] * d + w[C_N + lane] * ds2) - x2 * d
        for i in range(3):
            w[GAINED + i * L + lane] = 0.0
            w[LOST + i * L + lane] = 0.0
        if derivatives:
            for entry in range(3 * INPUTS):
                w[JACOBIAN + entry * L + lane] = 0.0
            w[JACOBIAN + IN_F * L + lane] = -spreading / force
            row = JACOBIAN + INPUTS * L + lane
            w[row + IN_D * L] = chi * w[N1 + lane] - x1
            w[row + IN_S1 * L] = chi * w[C_N + lane]
            w[row + IN_N1 * L] = chi * d
            # X_1 = Y + chi a_c
            w[row + IN_A1 * L] = -chi * d
            row = JACOBIAN + 2 * INPUTS * L + lane
            w[row + IN_D * L] = chi * w[N2 + lane] - x2
            w[row + IN_S2 * L] = chi * w[C_N + lane]
            w[row + IN_N2 * L] = chi * d
            w[row + IN_A2 * L] = -chi * d


@compiled()
def weak_force_slopes(w):
    """Add what the nine inputs leave out: Y itself, and the strain rate in the spread (strain control)."""
    for lane in range(LANES):
        deviator, shear = w[GIVEN + lane] - w[GIVEN + L + lane], w[GIVEN + 2 * L + lane]
        strain = math.sqrt(deviator * deviator + shear * shear)
        inverse = w[VIRGIN + lane] / strain if strain > 0.0 else 0.0
        for column in range(COLUMNS):
            own = deviator if column == 0 else (-deviator if column == 1 else shear)
            row = SLOPE + column * UNKNOWNS * L + lane
            w[row + 3 * L] += inverse * own
            w[row + 4 * L] -= w[D + lane] * w[SLOT_TY + (3 * column + 1) * L + lane]
            w[row + 5 * L] -= w[D + lane] * w[SLOT_TY + (3 * column + 2) * L + lane]
