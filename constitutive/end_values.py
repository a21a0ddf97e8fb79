"""End values of a point: a_n, a_t, f from their exact differentials; what shifted weak forces leave behind."""

import numpy as np

from .compilation import compiled
from .lanes import (
    C_E,
    C_N,
    CHI,
    CHI_P,
    FLOOR,
    GIVEN,
    KERNEL_OPTIONS,
    LARGEST_S,
    ORIGIN_A1,
    ORIGIN_A2,
    ORIGIN_Z,
    P_ZERO,
    ROTATION,
    SLOT,
    START_P,
    START_S1,
    START_S2,
    SUMS,
    X1,
    X2,
    L,
    Y,
)
from .load_lane import (
    M_A1,
    M_A2,
    M_F,
    M_GAINED,
    M_LARGEST_S,
    M_LOST,
    M_N1,
    M_N2,
    M_SHIFT,
    M_SPREAD,
    M_T1,
    M_T2,
    M_Z,
    MICRO,
)
from .shifted_distribution import network_of, split_change
from .stiffness import stress_invariants
from .weak_force_stage import shift_and_gain


@compiled(**KERNEL_OPTIONS)
def finish_point(w, lane, point, mixed, control, options, stress_start, state_start, micro_of_column, micro):
    """End values of a lane: the micro-state into `micro`, prescribed stresses without accumulated rounding."""
    for i in range(state_start.shape[1]):
        micro[micro_of_column[i]] = state_start[point, i]
    if mixed:
        for i in range(3):
            if control[i] == 1:
                w[Y + i * L + lane] = stress_start[point, i] + w[GIVEN + i * L + lane]
    p0 = -0.5 * (stress_start[point, 0] + stress_start[point, 1])
    p, s1, s2 = stress_invariants(w[Y + lane], w[Y + L + lane], w[Y + 2 * L + lane])
    # z, a_c; with shifted weak forces put there by `network_at_end`
    z, a1, a2 = w[Y + 3 * L + lane], w[Y + 4 * L + lane], w[Y + 5 * L + lane]
    ds1, ds2 = s1 - w[START_S1 + lane], s2 - w[START_S2 + lane]
    if options[ROTATION] == 0:
        ds2 = 0.0
    c_n = w[C_N + lane]
    micro[M_F] *= (p / p0) * (micro[M_Z] / z)
    micro[M_N1] += c_n * ds1
    micro[M_N2] += c_n * ds2
    micro[M_T1] += (2.0 - c_n) * ds1 - (a1 - micro[M_A1])
    micro[M_T2] += (2.0 - c_n) * ds2 - (a2 - micro[M_A2])
    for i in range(3):
        micro[M_GAINED + i] += w[SUMS + i * L + lane]
        micro[M_LOST + i] += w[SUMS + (3 + i) * L + lane]
    micro[M_Z], micro[M_A1], micro[M_A2] = z, a1, a2


@compiled()
def network_at_end(w, lane, mixed, control, stress_start, point, numbers, rule, resolved):
    """With shifted weak forces: z, a_c of the end state into Y; S_i stays in SLOT. False if there is none."""
    if mixed:
        for i in range(3):
            if control[i] == 1:
                w[Y + i * L + lane] = stress_start[point, i] + w[GIVEN + i * L + lane]
    p = -0.5 * (w[Y + lane] + w[Y + L + lane])
    if not p > w[FLOOR + lane]:
        return False
    x0, gain = shift_and_gain(w, lane, p, numbers[CHI_P])
    origin = (w[ORIGIN_Z + lane], w[ORIGIN_A1 + lane], w[ORIGIN_A2 + lane])
    spread = w[Y + 3 * L + lane]
    found = network_of(
        x0,
        w[Y + 4 * L + lane],
        w[Y + 5 * L + lane],
        spread,
        w[X1 + lane],
        w[X2 + lane],
        origin,
        w[P_ZERO + lane],
        gain,
        numbers[CHI],
        numbers[C_E],
        rule[2],
        rule[3],
        resolved,
    )
    w[SLOT + lane] = spread
    w[Y + 3 * L + lane], w[Y + 4 * L + lane], w[Y + 5 * L + lane] = resolved[0], resolved[1], resolved[2]
    return found


@compiled()
def finish_weak_forces(w, lane, numbers, rule, resolved, state_start, point, micro_of_column, micro):
    """State columns of the shifted weak forces; gained and lost from the change of N, direction by direction."""
    start = np.zeros(MICRO)
    for i in range(state_start.shape[1]):
        start[micro_of_column[i]] = state_start[point, i]
    p = -0.5 * (w[Y + lane] + w[Y + L + lane])
    x0, gain = shift_and_gain(w, lane, p, numbers[CHI_P])
    _, gain_start = shift_and_gain(w, lane, w[START_P + lane], numbers[CHI_P])
    micro[M_SHIFT], micro[M_SHIFT + 1], micro[M_SHIFT + 2] = x0, resolved[3], resolved[4]
    micro[M_SPREAD], micro[M_LARGEST_S] = w[SLOT + lane], w[LARGEST_S + lane]
    split_change(
        (w[ORIGIN_Z + lane], w[ORIGIN_A1 + lane], w[ORIGIN_A2 + lane]),
        w[P_ZERO + lane],
        numbers[C_E],
        (start[M_SHIFT], start[M_SHIFT + 1], start[M_SHIFT + 2], start[M_SPREAD], gain_start),
        (x0, resolved[3], resolved[4], w[SLOT + lane], gain),
        rule[2],
        rule[3],
        micro[M_GAINED : M_GAINED + 3],
        micro[M_LOST : M_LOST + 3],
    )
