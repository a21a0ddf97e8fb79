"""A point's arrays into numbers: what is refused, what stays during an increment, and where it starts."""

import math
from typing import NamedTuple

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.contract import Status
from granfabric.constitutive.lanes.eight import read
from granfabric.constitutive.material_table import (
    M_A1,
    M_A1_REF,
    M_A2,
    M_A2_REF,
    M_LARGEST_S,
    M_N1,
    M_N2,
    M_SHIFT,
    M_SPREAD,
    M_Z,
    M_Z_REF,
    MICRO,
    PAR_BULK,
    PAR_C_N,
    PAR_COHESION,
    PAR_KN,
    PAR_NEIGHBOURS,
    PAR_P_GAP,
    PAR_P_SLOPE,
    PAR_P_ZERO,
    PAR_PHI,
    PAR_RATIO,
    PAR_SHEAR,
    PAR_Z,
    PAR_Z_ISO,
    PRESSURE_FLOOR,
)
from granfabric.constitutive.stiffness import invariants, isostatic_shear, moduli_per_contact, stiffness_entries

PARAMETERS = PAR_COHESION + 1
IN_PARAMETERS = MICRO
IN_STRESS = IN_PARAMETERS + PARAMETERS
IN_GIVEN = IN_STRESS + 3
IN_CONTROL = IN_GIVEN + 3
INPUTS = IN_CONTROL + 3
"""Rows of what a lane was given: micro-state, material, start stress increment
(xx, yy, xy, tension positive), and 1 where that is one of stress."""

_OK = int(Status.OK)
_NO_PRESSURE = int(Status.NO_PRESSURE)
_NOT_FINITE = int(Status.NOT_FINITE)
_NOT_ADMISSIBLE = int(Status.NOT_ADMISSIBLE)


SMALLEST_COORDINATION = 1e-6
"""A network of fewer contacts a particle is none: the point is refused instead of strained without bound."""
LARGEST_COORDINATION = 1e3
"""Coordination number above which a state is none of grains; neither could its stiffness be computed at some size."""


class Point(NamedTuple):
    """Numbers of one point, or of eight; p and s compression positive, forces over kn r."""

    bulk: float
    """K per contact [Pa]; with the next three: K = bulk z, G = z (shear + stiffening z), B = coupling z."""
    shear: float
    stiffening: float
    coupling: float
    reference_z: float
    """z and a_c of the stiffness where it does not follow the network."""
    reference_a1: float
    reference_a2: float
    p_zero: float
    """P0, or 0 if nothing is lost; likewise its slope P0'."""
    p_slope: float
    half_gap: float
    """P_xi0/2, or 0 if nothing is gained; likewise the number of neighbours."""
    neighbours: float
    c_n: float
    force_scale: float
    """f/(kn r) times z/p."""
    floor: float
    """Pressure below which grains carry no stress [Pa]."""
    start_p: float
    start_s1: float
    start_s2: float
    start_n1: float
    start_n2: float
    origin_z: float
    """z and a_c of the initial packing."""
    origin_a1: float
    origin_a2: float
    start_shift: float
    """X_0 at the start."""


class Network(NamedTuple):
    """The network of a state: what stiffness and rates need, then what shifted weak forces leave behind."""

    z: float
    a1: float
    a2: float
    shift1: float
    """X_1."""
    shift2: float
    carried1: float
    """A = a_n + a_c."""
    carried2: float
    mu: float
    tangential1: float
    """a_t."""
    tangential2: float


class Options(NamedTuple):
    """Effects and choices that cost a kernel no more than a number."""

    loss: bool
    gain: bool
    rotation: bool
    feedback: bool
    isostatic: bool
    limited: bool
    """Beyond |a_c| = 1 the density is clipped: the harmonic one."""
    sliding: bool
    mixed: bool
    """Stress may be given."""
    derivatives: bool
    """By the strain increment."""


class Micro(NamedTuple):
    """Of the micro-state what a closure may start from."""

    z: float
    a1: float
    a2: float
    n1: float
    n2: float
    shift1: float
    shift2: float
    spread: float


@formula
def fill_at_rest(inputs):
    """Numbers for lanes that have not held a point yet: a state at rest, from which nothing can fail or overflow."""
    for row in range(inputs.shape[0]):
        for lane in range(inputs.shape[1]):
            inputs[row, lane] = 0.0
    for lane in range(inputs.shape[1]):
        inputs[M_Z, lane], inputs[M_Z_REF, lane] = 4.0, 4.0
        for entry in (PAR_PHI, PAR_KN, PAR_BULK, PAR_SHEAR):
            inputs[IN_PARAMETERS + entry, lane] = 1.0
        inputs[IN_PARAMETERS + PAR_Z, lane] = 4.0
        inputs[IN_STRESS, lane], inputs[IN_STRESS + 1, lane] = -1.0, -1.0


@formula
def take_material(inputs, lane, par):
    """Copy a row of the table of materials into a lane."""
    for entry in range(PARAMETERS):
        inputs[IN_PARAMETERS + entry, lane] = par[entry]


@formula
def take_point(inputs, lane, point, given, stress_start, state_start, par, micro_of_column):
    """Copy a point into a lane; rows of the micro-state that the law has no column for stay zero.

    Returns
    -------
    int
        OK, NOT_FINITE, NOT_ADMISSIBLE or NO_PRESSURE: with the last three the point cannot be advanced.
    """
    finite = True
    for i in range(micro_of_column.shape[0]):
        value = state_start[point, i]
        finite = finite & (abs(value) < math.inf)
        inputs[micro_of_column[i], lane] = value
    for i in range(3):
        finite = finite & (abs(given[point, i]) < math.inf) & (abs(stress_start[point, i]) < math.inf)
        inputs[IN_STRESS + i, lane] = stress_start[point, i]
        inputs[IN_GIVEN + i, lane] = given[point, i]
    if not finite:
        return _NOT_FINITE
    z, a1, a2 = inputs[M_Z, lane], inputs[M_A1, lane], inputs[M_A2, lane]
    if not (z > SMALLEST_COORDINATION and z < LARGEST_COORDINATION and a1 * a1 + a2 * a2 < 4.0):
        return _NOT_ADMISSIBLE
    # those of the stiffness, if it is that of the initial packing, and of the shifted weak forces
    z, a1, a2 = inputs[M_Z_REF, lane], inputs[M_A1_REF, lane], inputs[M_A2_REF, lane]
    if not (abs(z) < LARGEST_COORDINATION and a1 * a1 + a2 * a2 <= 4.0):
        return _NOT_ADMISSIBLE
    p = -0.5 * (stress_start[point, 0] + stress_start[point, 1])
    if not abs(p) < math.inf:
        return _NOT_FINITE
    return _OK if p > PRESSURE_FLOOR * par[PAR_KN] else _NO_PRESSURE


@formula
def load(inputs, options, lanes):
    """What a lane was given, as numbers.

    Returns
    -------
    point : Point
    micro : Micro
    here : Network
        At the start.
    stress : tuple of 3
        p, t_1, t_2.
    largest : float
        The largest |s| so far.
    """
    z, a1, a2 = read(inputs, M_Z, lanes), read(inputs, M_A1, lanes), read(inputs, M_A2, lanes)
    n1, n2 = read(inputs, M_N1, lanes), read(inputs, M_N2, lanes)
    z_ref, a1_ref, a2_ref = read(inputs, M_Z_REF, lanes), read(inputs, M_A1_REF, lanes), read(inputs, M_A2_REF, lanes)
    shift1, shift2 = read(inputs, M_SHIFT + 1, lanes), read(inputs, M_SHIFT + 2, lanes)
    first = IN_PARAMETERS
    phi, kn = read(inputs, first + PAR_PHI, lanes), read(inputs, first + PAR_KN, lanes)
    k, g, b = moduli_per_contact(
        phi, kn, read(inputs, first + PAR_RATIO, lanes),
        read(inputs, first + PAR_BULK, lanes), read(inputs, first + PAR_SHEAR, lanes),
    )
    zero = 0.0 * z
    stiffening = zero
    if options.isostatic:
        g, stiffening = isostatic_shear(
            g, read(inputs, first + PAR_Z, lanes), read(inputs, first + PAR_Z_ISO, lanes)
        )
    p_zero, p_slope, half_gap, neighbours = zero, zero, zero, zero
    if options.loss:
        p_zero = read(inputs, first + PAR_P_ZERO, lanes)
        p_slope = read(inputs, first + PAR_P_SLOPE, lanes)
    if options.gain:
        half_gap = 0.5 * read(inputs, first + PAR_P_GAP, lanes)
        neighbours = read(inputs, first + PAR_NEIGHBOURS, lanes)
    stress = invariants(
        read(inputs, IN_STRESS, lanes), read(inputs, IN_STRESS + 1, lanes), read(inputs, IN_STRESS + 2, lanes)
    )
    turns = 1.0 if options.rotation else 0.0
    point = Point(
        k, g, stiffening, b, z_ref, a1_ref, a2_ref, p_zero, p_slope, half_gap, neighbours,
        read(inputs, first + PAR_C_N, lanes),
        # f/(kn r) = 2 pi p/(z phi kn), section 3 of the model
        2.0 * math.pi / (phi * kn),
        PRESSURE_FLOOR * kn,
        stress[0], stress[1] / stress[0], turns * stress[2] / stress[0], n1, n2,
        z_ref, a1_ref, a2_ref, read(inputs, M_SHIFT, lanes),
    )
    micro = Micro(z, a1, a2, n1, n2, shift1, shift2, read(inputs, M_SPREAD, lanes))
    here = Network(z, a1, a2, shift1, shift2, zero, zero, 1.0 + zero, zero, zero)
    return point, micro, here, stress, read(inputs, M_LARGEST_S, lanes)


@formula
def put_stiffness(stiffness, out):
    """Write a stiffness (K, G, B, a_c) into `out`, shape (3, 3), in the order xx, yy, engineering xy."""
    c11, c22, c33, c12, c13 = stiffness_entries(stiffness)
    out[0, 0], out[1, 1], out[2, 2] = c11, c22, c33
    out[0, 1], out[1, 0] = c12, c12
    out[0, 2], out[2, 0] = c13, c13
    out[1, 2], out[2, 1] = c13, c13


@formula
def put_stiffness_of(par, z, a1, a2, isostatic, out):
    """Write the elastic stiffness of a state [Pa] into `out`, shape (3, 3)."""
    k, g, b = moduli_per_contact(par[PAR_PHI], par[PAR_KN], par[PAR_RATIO], par[PAR_BULK], par[PAR_SHEAR])
    stiffening = 0.0
    if isostatic:
        g, stiffening = isostatic_shear(g, par[PAR_Z], par[PAR_Z_ISO])
    put_stiffness((k * z, z * (g + stiffening * z), b * z, a1, a2), out)


@formula
def reference_of(inputs, lane, feedback):
    """z and a_c that the stiffness of a lane's start state has."""
    if feedback:
        return inputs[M_Z, lane], inputs[M_A1, lane], inputs[M_A2, lane]
    return inputs[M_Z_REF, lane], inputs[M_A1_REF, lane], inputs[M_A2_REF, lane]
