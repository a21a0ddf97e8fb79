"""End values of a point: a_n, a_t, f from their exact differentials; what shifted weak forces leave behind."""

import numpy as np

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.lanes.layout import (
    C_E,
    C_N,
    C_P,
    CHI_P,
    CLOSURE_FRICTIONAL,
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
    TANGENTIAL,
    L,
    Y,
)
from granfabric.constitutive.lanes.load import (
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
from granfabric.constitutive.network.force_fabric import MU, T1, T2
from granfabric.constitutive.network.shifted_distribution import (
    AC1,
    AC2,
    CARRIED1,
    CARRIED2,
    SHIFT1,
    SHIFT2,
    Z,
    split_change,
)
from granfabric.constitutive.network.weak_force_stage import network_at, shift_and_gain
from granfabric.constitutive.stiffness import stress_invariants


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
def network_at_end(w, lane, mixed, control, options, stress_start, point, numbers, rule, fabric, resolved):
    """With shifted weak forces: z, a_c of the end state into Y; S_i stays in SLOT. False if there is none."""
    if mixed:
        for i in range(3):
            if control[i] == 1:
                w[Y + i * L + lane] = stress_start[point, i] + w[GIVEN + i * L + lane]
    p, s1, s2 = stress_invariants(w[Y + lane], w[Y + L + lane], w[Y + 2 * L + lane])
    if not p > w[FLOOR + lane]:
        return False
    spread = w[Y + 3 * L + lane]
    y1, y2 = w[Y + 4 * L + lane], w[Y + 5 * L + lane]
    found, _, _ = network_at(w, lane, p, s1, s2, spread, y1, y2, options, numbers, rule[2], rule[3], fabric, resolved)
    w[SLOT + lane] = spread
    w[Y + 3 * L + lane], w[Y + 4 * L + lane], w[Y + 5 * L + lane] = resolved[Z], resolved[AC1], resolved[AC2]
    return found


@compiled()
def finish_weak_forces(w, lane, options, numbers, rule, fabric, resolved, state_start, point, micro_of_column, micro):
    """State columns of the shifted weak forces; gained and lost from the change of N, direction by direction."""
    start = np.zeros(MICRO)
    for i in range(state_start.shape[1]):
        start[micro_of_column[i]] = state_start[point, i]
    p = -0.5 * (w[Y + lane] + w[Y + L + lane])
    x0, gain = shift_and_gain(w, lane, p, numbers[CHI_P])
    _, gain_start = shift_and_gain(w, lane, w[START_P + lane], numbers[CHI_P])
    micro[M_SHIFT], micro[M_SHIFT + 1], micro[M_SHIFT + 2] = x0, resolved[SHIFT1], resolved[SHIFT2]
    micro[M_SPREAD], micro[M_LARGEST_S] = w[SLOT + lane], w[LARGEST_S + lane]
    if options[TANGENTIAL] == CLOSURE_FRICTIONAL:
        # a_n, a_t are functions of the state; p = z f (1 + a_c.a_n/2) up to a constant
        before = 1.0 + 0.5 * (start[M_A1] * start[M_N1] + start[M_A2] * start[M_N2])
        micro[M_F] *= before / fabric[MU]
        micro[M_N1], micro[M_N2] = resolved[CARRIED1] - resolved[AC1], resolved[CARRIED2] - resolved[AC2]
        micro[M_T1], micro[M_T2] = fabric[T1], fabric[T2]
    split_change(
        (w[ORIGIN_Z + lane], w[ORIGIN_A1 + lane], w[ORIGIN_A2 + lane]),
        w[P_ZERO + lane],
        numbers[C_E],
        numbers[C_P],
        (start[M_SHIFT], start[M_SHIFT + 1], start[M_SHIFT + 2], start[M_SPREAD], gain_start),
        (x0, resolved[SHIFT1], resolved[SHIFT2], w[SLOT + lane], gain),
        rule[2],
        rule[3],
        micro[M_GAINED : M_GAINED + 3],
        micro[M_LOST : M_LOST + 3],
    )
