"""Rates of the micro-state for given rates of stress, with exact derivatives [Pouragha & Wan 2017, eqs 3-13].

Written in the rates ``d = dp/p`` and ``ds`` of the stress-ratio vector s, so that nothing divides by dp:

    dF(theta) = d + w.e,    w = a_n d + b,    b = 2 ds (tangential neglected)  or  c_n ds + da_c (self-consistent)
    X_i  = beta P_xi0 f/(2 kn r) gain_i - P0 loss_i          (loss_i, gain_i of `contact_change`)
    dz   = z X_0,      da_c = 2 (X_1, X_2) - a_c X_0
"""

import math

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.lanes.layout import (
    BY_A,
    BY_N,
    BY_V,
    C_N,
    CLOSED_FORM,
    DENSITY,
    DS1,
    DS2,
    FLUCTUATING,
    FORCE,
    FORCE_CHANGE,
    GAIN,
    GAIN_FACTOR,
    GAINED,
    HALF_GAP,
    HARMONIC,
    I11,
    I12,
    I21,
    I22,
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
    JACOBIAN,
    KERNEL_OPTIONS,
    LANES,
    LOSS,
    LOST,
    N1,
    N2,
    NEIGHBOURS,
    P_ZERO,
    RATE,
    ROW_BY_A,
    ROW_BY_N,
    ROW_BY_V,
    ROW_JACOBIAN,
    ROW_VALUE,
    SELF_CONSISTENT,
    SHARE,
    SIGMA,
    SOLVED,
    TANGENTIAL,
    TRIAL_A1,
    TRIAL_A2,
    TRIAL_Z,
    V1,
    V2,
    VALUE,
    X1,
    X2,
    D,
    L,
)
from granfabric.constitutive.lanes.rows import copy_rows

from .contact_change import closed_form_change
from .fluctuating_change import differentiate_scatter, fluctuating_change, prepare_scatter
from .quadrature_change import quadrature_change

_FIXED_POINT_TOLERANCE = 1e-13
_FIXED_POINT_ITERATIONS = 60
_UNSOLVED, _CONVERGED, _NO_SOLUTION = 0.0, 1.0, 2.0


@compiled(inline="always", **KERNEL_OPTIONS)
def network_rates(w, options, numbers, derivatives, nodes, weights):
    """Rates of coordination number and fabric, split into gained and lost, in every lane.

    Reads rows D, DS1, DS2, TRIAL_Z, TRIAL_A1, TRIAL_A2, N1, N2 (limited to |a_n| < 1), FORCE; writes RATE 3..5,
    GAINED, LOST, SOLVED and, if `derivatives`, JACOBIAN (z, a_c by the nine inputs).

    Parameters
    ----------
    w : ndarray
        Workspace, see `lanes`.
    options : ndarray of int64
        Effects and choices, see `lanes`.
    numbers : ndarray
        Closure numbers, see `lanes.CHI`.
    derivatives : bool
    nodes, weights : ndarray, shape (directions,)
        Gauss-Legendre rule for arcs without a closed form.
    """
    self_consistent = options[TANGENTIAL] == SELF_CONSISTENT
    fluctuating = options[FORCE_CHANGE] == FLUCTUATING
    _prepare(w, self_consistent)
    if fluctuating:
        prepare_scatter(w, numbers)
    for _ in range(_FIXED_POINT_ITERATIONS):
        _force_change_vector(w)
        if fluctuating:
            fluctuating_change(w, options, numbers, derivatives or self_consistent, nodes, weights)
        else:
            _change(w, options, derivatives or self_consistent, nodes, weights)
        if not self_consistent or _improve(w, options):
            break
    _split(w, options)
    if derivatives:
        _differentiate(w, options)
        if self_consistent:
            _close(w, options)
        if fluctuating:
            differentiate_scatter(w, options)


@compiled(**KERNEL_OPTIONS)
def _prepare(w, self_consistent):
    """Start of the self-consistent iteration, and the factor of gain."""
    for lane in range(LANES):
        # the stage before is a good start: rates change little between stages
        w[X1 + lane] = w[X1 + lane] if self_consistent and math.isfinite(w[X1 + lane]) else 0.0
        w[X2 + lane] = w[X2 + lane] if self_consistent and math.isfinite(w[X2 + lane]) else 0.0
        w[SOLVED + lane] = _UNSOLVED if self_consistent else _CONVERGED
        w[SIGMA + lane] = 0.0
        z = w[TRIAL_Z + lane]
        room = w[NEIGHBOURS + lane] - z
        w[SHARE + lane] = w[C_N + lane] if self_consistent else 2.0
        w[GAIN_FACTOR + lane] = (room if room > 0.0 else 0.0) / z * w[HALF_GAP + lane] * w[FORCE + lane]


@compiled(**KERNEL_OPTIONS)
def _force_change_vector(w):
    """w = a_n d + b."""
    for lane in range(LANES):
        share, d = w[SHARE + lane], w[D + lane]
        w[V1 + lane] = w[N1 + lane] * d + share * w[DS1 + lane] + w[X1 + lane]
        w[V2 + lane] = w[N2 + lane] * d + share * w[DS2 + lane] + w[X2 + lane]


@compiled(inline="always", **KERNEL_OPTIONS)
def _change(w, options, derivatives, nodes, weights):
    """Loss and gain of every lane, by closed form where there is one."""
    loss, gain = options[LOSS] != 0, options[GAIN] != 0
    closed = options[CLOSED_FORM] != 0 and options[DENSITY] == HARMONIC
    if closed:
        closed_form_change(w, loss, gain, derivatives)
    _change_by_quadrature(w, not closed, options, derivatives, nodes, weights)


@compiled(**KERNEL_OPTIONS)
def _change_by_quadrature(w, everywhere, options, derivatives, nodes, weights):
    """Loss and gain by quadrature, everywhere or where the harmonic density has to be clipped."""
    loss, gain = options[LOSS] != 0, options[GAIN] != 0
    for lane in range(LANES):
        a1, a2 = w[TRIAL_A1 + lane], w[TRIAL_A2 + lane]
        if everywhere or a1 * a1 + a2 * a2 > 1.0:
            quadrature_change(w, lane, options[DENSITY], loss, gain, derivatives, nodes, weights)


@compiled(inline="always", **KERNEL_OPTIONS)
def _net(w, lane, row, offset, loss, gain):
    """beta P_xi0 f/(2 kn r) gain - P0 loss, of a block of rows that holds loss first and gain `offset` rows later."""
    total = 0.0
    if gain:
        total += w[GAIN_FACTOR + lane] * w[row + offset * L + lane]
    if loss:
        total -= w[P_ZERO + lane] * w[row + lane]
    return total


@compiled(**KERNEL_OPTIONS)
def _improve(w, options):
    """One Newton step on x = da_c(b = c_n ds + x) in the lanes that have not converged; True when none is left."""
    loss, gain = options[LOSS] != 0, options[GAIN] != 0
    done = True
    for lane in range(LANES):
        if w[SOLVED + lane] != _UNSOLVED:
            continue
        a1, a2 = w[TRIAL_A1 + lane], w[TRIAL_A2 + lane]
        y0 = _net(w, lane, VALUE, 3, loss, gain)
        y1 = _net(w, lane, VALUE + L, 3, loss, gain)
        y2 = _net(w, lane, VALUE + 2 * L, 3, loss, gain)
        m01 = _net(w, lane, BY_V + L, 9, loss, gain)
        m02 = _net(w, lane, BY_V + 2 * L, 9, loss, gain)
        m12 = _net(w, lane, BY_V + 5 * L, 9, loss, gain)
        r11 = 2.0 * _net(w, lane, BY_V + 4 * L, 9, loss, gain) - a1 * m01
        r12 = 2.0 * m12 - a1 * m02
        r21 = 2.0 * m12 - a2 * m01
        r22 = 2.0 * _net(w, lane, BY_V + 8 * L, 9, loss, gain) - a2 * m02
        determinant = (1.0 - r11) * (1.0 - r22) - r12 * r21
        if not (determinant > 1e-9 and r11 < 1.0 and r22 < 1.0):
            w[SOLVED + lane] = _NO_SOLUTION
            w[X1 + lane], w[X2 + lane] = 0.0, 0.0
            continue
        inverse = 1.0 / determinant
        w[I11 + lane] = (1.0 - r22) * inverse
        w[I12 + lane] = r12 * inverse
        w[I21 + lane] = r21 * inverse
        w[I22 + lane] = (1.0 - r11) * inverse
        e1, e2 = 2.0 * y1 - a1 * y0 - w[X1 + lane], 2.0 * y2 - a2 * y0 - w[X2 + lane]
        size = abs(w[D + lane]) + abs(w[V1 + lane]) + abs(w[V2 + lane]) + w[SIGMA + lane]
        if abs(e1) + abs(e2) <= _FIXED_POINT_TOLERANCE * size:
            w[SOLVED + lane] = _CONVERGED
            continue
        w[X1 + lane] += w[I11 + lane] * e1 + w[I12 + lane] * e2
        w[X2 + lane] += w[I21 + lane] * e1 + w[I22 + lane] * e2
        done = False
    return done


@compiled(**KERNEL_OPTIONS)
def _split(w, options):
    """Gained, lost and net rates of z and a_c."""
    loss, gain = options[LOSS] != 0, options[GAIN] != 0
    for lane in range(LANES):
        z, a1, a2 = w[TRIAL_Z + lane], w[TRIAL_A1 + lane], w[TRIAL_A2 + lane]
        g0, g1, g2, l0, l1, l2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if gain:
            factor = w[GAIN_FACTOR + lane]
            g0 = factor * w[VALUE + 3 * L + lane]
            g1 = 2.0 * factor * w[VALUE + 4 * L + lane] - a1 * g0
            g2 = 2.0 * factor * w[VALUE + 5 * L + lane] - a2 * g0
        if loss:
            factor = w[P_ZERO + lane]
            l0 = factor * w[VALUE + lane]
            l1 = 2.0 * factor * w[VALUE + L + lane] - a1 * l0
            l2 = 2.0 * factor * w[VALUE + 2 * L + lane] - a2 * l0
        w[GAINED + lane] = z * g0
        w[GAINED + L + lane] = g1
        w[GAINED + 2 * L + lane] = g2
        w[LOST + lane] = z * l0
        w[LOST + L + lane] = l1
        w[LOST + 2 * L + lane] = l2
        w[RATE + 3 * L + lane] = z * g0 - z * l0
        w[RATE + 4 * L + lane] = g1 - l1
        w[RATE + 5 * L + lane] = g2 - l2


@compiled(**KERNEL_OPTIONS)
def _differentiate(w, options):
    """Derivatives of the net rates at fixed da_c in b."""
    loss, gain = options[LOSS] != 0, options[GAIN] != 0
    for i in range(3):
        for row in range(2):
            copy_rows(w, ROW_VALUE + row * L, VALUE + (3 * row + i) * L, L)
            copy_rows(w, ROW_BY_V + 3 * row * L, BY_V + (9 * row + 3 * i) * L, 3 * L)
            copy_rows(w, ROW_BY_A + 2 * row * L, BY_A + (6 * row + 2 * i) * L, 2 * L)
        copy_rows(w, ROW_BY_N, BY_N + 2 * i * L, 2 * L)
        _differentiate_row(w)
        copy_rows(w, JACOBIAN + i * INPUTS * L, ROW_JACOBIAN, INPUTS * L)
    for lane in range(LANES):
        # written out: nine short loops would be unrolled before they could become vector code
        _relative_to_state(w, lane, IN_D)
        _relative_to_state(w, lane, IN_S1)
        _relative_to_state(w, lane, IN_S2)
        _relative_to_state(w, lane, IN_Z)
        _relative_to_state(w, lane, IN_A1)
        _relative_to_state(w, lane, IN_A2)
        _relative_to_state(w, lane, IN_N1)
        _relative_to_state(w, lane, IN_N2)
        _relative_to_state(w, lane, IN_F)
    for lane in range(LANES):
        x0 = _net(w, lane, VALUE, 3, loss, gain)
        w[JACOBIAN + IN_Z * L + lane] += x0
        w[JACOBIAN + (INPUTS + IN_A1) * L + lane] -= x0
        w[JACOBIAN + (2 * INPUTS + IN_A2) * L + lane] -= x0


@compiled(**KERNEL_OPTIONS)
def _differentiate_row(w):
    """Derivatives of X_i by the nine inputs, from rows ROW_VALUE ... to ROW_JACOBIAN."""
    for lane in range(LANES):
        z, d = w[TRIAL_Z + lane], w[D + lane]
        # factors of effects that are off are zero, and their rows stay as they were made: zero
        g, p0, share = w[GAIN_FACTOR + lane], w[P_ZERO + lane], w[SHARE + lane]
        by0 = g * w[ROW_BY_V + 3 * L + lane] - p0 * w[ROW_BY_V + lane]
        by1 = g * w[ROW_BY_V + 4 * L + lane] - p0 * w[ROW_BY_V + L + lane]
        by2 = g * w[ROW_BY_V + 5 * L + lane] - p0 * w[ROW_BY_V + 2 * L + lane]
        w[ROW_JACOBIAN + IN_D * L + lane] = by0 + w[N1 + lane] * by1 + w[N2 + lane] * by2
        w[ROW_JACOBIAN + IN_S1 * L + lane] = share * by1
        w[ROW_JACOBIAN + IN_S2 * L + lane] = share * by2
        w[ROW_JACOBIAN + IN_A1 * L + lane] = g * w[ROW_BY_A + 2 * L + lane] - p0 * w[ROW_BY_A + lane]
        w[ROW_JACOBIAN + IN_A2 * L + lane] = g * w[ROW_BY_A + 3 * L + lane] - p0 * w[ROW_BY_A + L + lane]
        w[ROW_JACOBIAN + IN_N1 * L + lane] = d * by1 - p0 * w[ROW_BY_N + lane]
        w[ROW_JACOBIAN + IN_N2 * L + lane] = d * by2 - p0 * w[ROW_BY_N + L + lane]
        room = w[NEIGHBOURS + lane] - z
        gained = w[ROW_VALUE + L + lane] * w[HALF_GAP + lane] / z
        gained = gained if room > 0.0 else 0.0
        w[ROW_JACOBIAN + IN_Z * L + lane] = -gained * w[NEIGHBOURS + lane] / z * w[FORCE + lane]
        w[ROW_JACOBIAN + IN_F * L + lane] = gained * room


@compiled(inline="always", **KERNEL_OPTIONS)
def _relative_to_state(w, lane, entry):
    """From derivatives of X_0, X_1, X_2 to those of dz = z X_0, da_c = 2 (X_1, X_2) - a_c X_0, at fixed z, a_c."""
    x0 = w[JACOBIAN + entry * L + lane]
    x1 = w[JACOBIAN + (INPUTS + entry) * L + lane]
    x2 = w[JACOBIAN + (2 * INPUTS + entry) * L + lane]
    w[JACOBIAN + entry * L + lane] = w[TRIAL_Z + lane] * x0
    w[JACOBIAN + (INPUTS + entry) * L + lane] = 2.0 * x1 - w[TRIAL_A1 + lane] * x0
    w[JACOBIAN + (2 * INPUTS + entry) * L + lane] = 2.0 * x2 - w[TRIAL_A2 + lane] * x0


@compiled(**KERNEL_OPTIONS)
def _close(w, options):
    """Implicit differentiation of the self-consistent da_c: times (1 - d da_c/d b)^-1; then carry da_c into dz."""
    loss, gain = options[LOSS] != 0, options[GAIN] != 0
    for j in range(INPUTS):
        row = JACOBIAN + j * L
        for lane in range(LANES):
            z1 = w[TRIAL_Z + lane] * _net(w, lane, BY_V + L, 9, loss, gain)
            z2 = w[TRIAL_Z + lane] * _net(w, lane, BY_V + 2 * L, 9, loss, gain)
            r1, r2 = w[row + INPUTS * L + lane], w[row + 2 * INPUTS * L + lane]
            t1 = w[I11 + lane] * r1 + w[I12 + lane] * r2
            t2 = w[I21 + lane] * r1 + w[I22 + lane] * r2
            w[row + INPUTS * L + lane] = t1
            w[row + 2 * INPUTS * L + lane] = t2
            w[row + lane] += z1 * t1 + z2 * t2
