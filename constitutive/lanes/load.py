"""A point's arrays into a lane of the workspace, and what a point's micro-state consists of."""

import math

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.contract import Status
from granfabric.constitutive.stiffness import fill_stiffness, isostatic_shear, moduli_per_contact, stress_invariants

from .layout import (
    BULK,
    C_N,
    CHI,
    COUPLING,
    EXTRAS,
    FEEDBACK,
    FLOOR,
    FORCE_CHANGE,
    FORCE_SCALE,
    GAIN,
    GIVEN,
    HALF_GAP,
    ISOSTATIC,
    LARGEST_S,
    LOSS,
    NEIGHBOURS,
    ORIGIN_A1,
    ORIGIN_A2,
    ORIGIN_Z,
    P_ZERO,
    REFERENCE_A1,
    REFERENCE_A2,
    REFERENCE_Z,
    SHEAR,
    SHEAR_OFFSET,
    SHIFTED_DISTRIBUTION,
    SLOPES,
    SLOT_SCALE,
    START_N1,
    START_N2,
    START_P,
    START_S1,
    START_S2,
    START_SHIFT,
    STEP,
    SUMS,
    TY,
    X1,
    X2,
    L,
    Y,
)
from .runge_kutta import SMALLEST_COORDINATION

# columns of the parameter table, in the order of `parameters.Material.variables`
(
    PAR_Z,
    PAR_PHI,
    PAR_KN,
    PAR_RATIO,
    PAR_P_ZERO,
    PAR_P_GAP,
    PAR_NEIGHBOURS,
    PAR_C_N,
    PAR_BULK,
    PAR_SHEAR,
    PAR_Z_ISO,
    PAR_FABRIC_XX,
    PAR_FABRIC_XY,
    PAR_M_PEAK,
    PAR_M_FIRST,
    PAR_GAMMA_R,
    PAR_EXPONENT,
    PAR_DILATANCY,
    PAR_M_CV,
    PAR_COHESION,
) = range(20)

# the micro-state: z, a_c (2), f/(kn r), a_n (2), a_t (2), gained z and a_c (3), lost z and a_c (3), z and a_c (3) of
# the initial packing, X_0 and X_1 (3), S_i, the largest |s|, the hardening strain, gamma_p, plastic volumetric
# strain and dissipation. A law carries as columns what its effects need.
M_Z, M_A1, M_A2, M_F, M_N1, M_N2, M_T1, M_T2, M_GAINED = range(9)
M_LOST, M_Z_REF, M_A1_REF, M_A2_REF, M_SHIFT, M_SPREAD, M_LARGEST_S = 11, 14, 15, 16, 17, 20, 21
M_KAPPA, M_GAMMA, MICRO = 22, 23, 26

PRESSURE_FLOOR = 1e-18
"""Smallest p/kn at which grains are taken to carry stress."""

_OK = int(Status.OK)
_NO_PRESSURE = int(Status.NO_PRESSURE)
_NOT_FINITE = int(Status.NOT_FINITE)
_NOT_ADMISSIBLE = int(Status.NOT_ADMISSIBLE)


@compiled()
def load_idle(w, lane):
    """Fill a lane that holds no point with a state at rest, from which nothing can fail or overflow."""
    w[X1 + lane], w[X2 + lane] = 0.0, 0.0
    for row in range(EXTRAS):
        w[SUMS + row * L + lane] = 0.0
    for row in range(SLOPES):
        w[TY + row * L + lane] = 0.0
    for row in range(3):
        w[GIVEN + row * L + lane] = 0.0
    w[Y + lane], w[Y + L + lane], w[Y + 2 * L + lane] = -1.0, -1.0, 0.0
    w[Y + 3 * L + lane], w[Y + 4 * L + lane], w[Y + 5 * L + lane] = 1.0, 0.0, 0.0
    w[START_P + lane] = 1.0
    w[START_S1 + lane], w[START_S2 + lane], w[START_N1 + lane], w[START_N2 + lane] = 0.0, 0.0, 0.0, 0.0
    w[REFERENCE_Z + lane], w[REFERENCE_A1 + lane], w[REFERENCE_A2 + lane] = 1.0, 0.0, 0.0
    w[P_ZERO + lane], w[HALF_GAP + lane], w[NEIGHBOURS + lane], w[C_N + lane] = 0.0, 0.0, 0.0, 0.0
    w[FORCE_SCALE + lane], w[FLOOR + lane], w[STEP + lane] = 1.0, 0.0, 1.0
    w[BULK + lane], w[SHEAR + lane], w[SHEAR_OFFSET + lane], w[COUPLING + lane] = 1.0, 1.0, 0.0, 0.0
    w[ORIGIN_Z + lane], w[ORIGIN_A1 + lane], w[ORIGIN_A2 + lane], w[START_SHIFT + lane] = 1.0, 0.0, 0.0, 0.0
    w[LARGEST_S + lane], w[SLOT_SCALE + lane] = 0.0, 1.0


@compiled()
def load_point(w, lane, point, given, stress_start, state_start, par, micro_of_column, options, numbers):
    """Load a point into a lane.

    Returns
    -------
    int
        OK, NOT_FINITE, NOT_ADMISSIBLE or NO_PRESSURE: with the last three the point cannot be advanced.
    """
    finite = True
    for i in range(3):
        finite = finite and math.isfinite(given[point, i]) and math.isfinite(stress_start[point, i])
        w[GIVEN + i * L + lane] = given[point, i]
        w[Y + i * L + lane] = stress_start[point, i]
    w[Y + 5 * L + lane] = 0.0
    n1, n2, spread = 0.0, 0.0, 0.0
    z, a1, a2 = 0.0, 0.0, 0.0
    w[ORIGIN_A1 + lane], w[ORIGIN_A2 + lane] = 0.0, 0.0
    w[X1 + lane], w[X2 + lane], w[LARGEST_S + lane] = 0.0, 0.0, 0.0
    for i in range(state_start.shape[1]):
        value = state_start[point, i]
        finite = finite and math.isfinite(value)
        entry = micro_of_column[i]
        if entry <= M_A2:
            w[Y + (3 + entry) * L + lane] = value
            if entry == M_Z:
                z = value
            elif entry == M_A1:
                a1 = value
            else:
                a2 = value
        elif entry == M_N1:
            n1 = value
        elif entry == M_N2:
            n2 = value
        elif entry == M_Z_REF:
            w[ORIGIN_Z + lane] = value
        elif entry == M_A1_REF:
            w[ORIGIN_A1 + lane] = value
        elif entry == M_A2_REF:
            w[ORIGIN_A2 + lane] = value
        elif entry == M_SHIFT:
            w[START_SHIFT + lane] = value
        elif entry == M_SHIFT + 1:
            w[X1 + lane] = value
        elif entry == M_SHIFT + 2:
            w[X2 + lane] = value
        elif entry == M_SPREAD:
            spread = value
        elif entry == M_LARGEST_S:
            w[LARGEST_S + lane] = value
    k, g, b = moduli_per_contact(par[PAR_PHI], par[PAR_KN], par[PAR_RATIO], par[PAR_BULK], par[PAR_SHEAR])
    offset = 0.0
    if options[ISOSTATIC] != 0:
        g, offset = isostatic_shear(g, par[PAR_Z], par[PAR_Z_ISO]), par[PAR_Z_ISO]
    w[BULK + lane], w[SHEAR + lane], w[SHEAR_OFFSET + lane], w[COUPLING + lane] = k, g, offset, b
    follow = options[FEEDBACK] != 0
    w[REFERENCE_Z + lane] = w[Y + 3 * L + lane] if follow else w[ORIGIN_Z + lane]
    w[REFERENCE_A1 + lane] = w[Y + 4 * L + lane] if follow else w[ORIGIN_A1 + lane]
    w[REFERENCE_A2 + lane] = w[Y + 5 * L + lane] if follow else w[ORIGIN_A2 + lane]
    w[SLOT_SCALE + lane] = w[Y + 3 * L + lane]
    if options[FORCE_CHANGE] == SHIFTED_DISTRIBUTION:
        # the unknowns are S_i and Y = X_1 - chi (a_n + a_c)
        w[SLOT_SCALE + lane] = 1.0
        w[Y + 3 * L + lane] = spread
        w[Y + 4 * L + lane] = w[X1 + lane] - numbers[CHI] * (n1 + w[Y + 4 * L + lane])
        w[Y + 5 * L + lane] = w[X2 + lane] - numbers[CHI] * (n2 + w[Y + 5 * L + lane])
    if not finite:
        return _NOT_FINITE
    if not (z > SMALLEST_COORDINATION and a1 * a1 + a2 * a2 < 4.0):
        return _NOT_ADMISSIBLE
    floor = PRESSURE_FLOOR * par[PAR_KN]
    p, s1, s2 = stress_invariants(stress_start[point, 0], stress_start[point, 1], stress_start[point, 2])
    if not p > floor:
        return _NO_PRESSURE
    w[FLOOR + lane] = floor
    for row in range(EXTRAS):
        w[SUMS + row * L + lane] = 0.0
    for row in range(SLOPES):
        w[TY + row * L + lane] = 0.0
    w[START_P + lane] = p
    w[START_S1 + lane], w[START_S2 + lane], w[START_N1 + lane], w[START_N2 + lane] = s1, s2, n1, n2
    w[P_ZERO + lane] = par[PAR_P_ZERO] if options[LOSS] != 0 else 0.0
    w[HALF_GAP + lane] = 0.5 * par[PAR_P_GAP] if options[GAIN] != 0 else 0.0
    w[NEIGHBOURS + lane] = par[PAR_NEIGHBOURS] if options[GAIN] != 0 else 0.0
    w[C_N + lane] = par[PAR_C_N]
    # f/(kn r) = 2 pi p/(z phi kn), section 3 of the model
    w[FORCE_SCALE + lane] = 2.0 * math.pi / (par[PAR_PHI] * par[PAR_KN])
    return _OK


@compiled()
def stiffness_of(w, lane, valid, out):
    """Elastic stiffness of the lane's reference state into `out`, shape (3, 3); zeros if it is not valid."""
    if valid:
        z = w[REFERENCE_Z + lane]
        k, b = w[BULK + lane] * z, w[COUPLING + lane] * z
        g = w[SHEAR + lane] * (z - w[SHEAR_OFFSET + lane])
        fill_stiffness(k, g, b, w[REFERENCE_A1 + lane], w[REFERENCE_A2 + lane], out)
    else:
        for i in range(3):
            for j in range(3):
                out[i, j] = 0.0
