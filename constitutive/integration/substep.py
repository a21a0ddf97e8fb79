"""Parts of one substep: the state at a stage, the error estimate, the next length."""

import math

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.contract import Status
from granfabric.constitutive.lanes.eight import choose, read, write
from granfabric.constitutive.network.closures import measures
from granfabric.constitutive.network.point import LARGEST_COORDINATION, SMALLEST_COORDINATION
from granfabric.constitutive.sliding.substep import kappa_error
from granfabric.constitutive.stiffness import components, strain_invariants, stress_rate

from .runge_kutta import LARGEST_CHANGE, MAX_FACTOR, MIN_FACTOR, SAFETY
from .stage import RATES, STRAIN, UNKNOWNS

_LIMITED = float(Status.LIMITED)
_NO_PRESSURE = float(Status.NO_PRESSURE)
_NOT_ADMISSIBLE = float(Status.NOT_ADMISSIBLE)


@formula
def advance(trial, y, k, step, stages, coefficients, rows, lanes):
    """trial = y + h sum c_m K_m in the first `rows` rows, over the first `stages` stages."""
    # six rows at a time: the unknowns, or a column of their derivatives
    for first in range(0, rows, UNKNOWNS):
        t0, t1, t2 = 0.0 * step, 0.0 * step, 0.0 * step
        t3, t4, t5 = t0, t1, t2
        for m in range(stages):
            c, row = coefficients[m], m * RATES + first
            # stages without weight may hold no derivatives
            if c != 0.0:
                t0 += c * read(k, row, lanes)
                t1 += c * read(k, row + 1, lanes)
                t2 += c * read(k, row + 2, lanes)
                t3 += c * read(k, row + 3, lanes)
                t4 += c * read(k, row + 4, lanes)
                t5 += c * read(k, row + 5, lanes)
        write(trial, first, read(y, first, lanes) + step * t0, lanes)
        write(trial, first + 1, read(y, first + 1, lanes) + step * t1, lanes)
        write(trial, first + 2, read(y, first + 2, lanes) + step * t2, lanes)
        write(trial, first + 3, read(y, first + 3, lanes) + step * t3, lanes)
        write(trial, first + 4, read(y, first + 4, lanes) + step * t4, lanes)
        write(trial, first + 5, read(y, first + 5, lanes) + step * t5, lanes)


@formula
def summed(k, first, step, coefficients, lanes):
    """h sum c_m of three rows of the stages, beginning with `first`."""
    x, y, z = 0.0 * step, 0.0 * step, 0.0 * step
    for m in range(coefficients.shape[0]):
        row = m * RATES + first
        x += coefficients[m] * read(k, row, lanes)
        y += coefficients[m] * read(k, row + 1, lanes)
        z += coefficients[m] * read(k, row + 2, lanes)
    return step * x, step * y, step * z


@formula
def _raised(measure, new):
    """The larger of the two; what is not a number wins."""
    return choose(new <= measure, measure, new)


@formula
def estimate_error(block, closure, error, tolerance, z, stiffness, options, floor, slide, lanes):
    """Error of the substep in units of the tolerance (stress relative to p, z relative, a_c absolute), and its status.

    Where stress is given, the strain is what is asked for: its error counts as the stress that belongs to it. In a
    substep that slides it may be as large as what the error of the hardening strain is allowed to cause.

    Parameters
    ----------
    block : record
        With start, end and stages of the substep; its rows `measure` and `worst` are written.
    closure : named tuple
    error : ndarray
        Weights.
    tolerance : float
    z : float
        Coordination number at the start.
    stiffness : tuple of 5
    options : Options
    floor : float
        Least pressure.
    slide : record
    """
    y, trial, k = block["y"], block["trial"], block["k"]
    step, worst = read(block["step"], 0, lanes), read(block["worst"], 0, lanes)
    p, end = read(y, 0, lanes), read(trial, 0, lanes)
    e_p, e_1, e_2 = summed(k, 0, step, error, lanes)
    e_x, e_y, e_z = summed(k, 3, step, error, lanes)
    scale, other, direct = measures(closure, p, z)
    _, other_end, _ = measures(closure, end, z)
    unit = 1.0 / (tolerance * p)
    measure = _raised(0.0 * p, (abs(e_p) + abs(e_1)) * unit)
    measure = _raised(measure, abs(e_2) * unit)
    measure = _raised(measure, abs(e_x) / (tolerance * scale))
    unit = 1.0 / (tolerance * other)
    measure = _raised(measure, abs(e_y) * unit)
    measure = _raised(measure, abs(e_z) * unit)
    if options.mixed:
        xx, yy, xy = summed(k, STRAIN, step, error, lanes)
        v, e1, e2 = strain_invariants(xx, yy, xy)
        e_p, e_1, e_2 = stress_rate(stiffness, v, e1, e2)
        xx, yy, xy = components(e_p, e_1, e_2)
        pressure = p
        if options.sliding:
            more = 2.0 * stiffness[0] * (read(slide["reference"], 0, lanes) + read(slide["kappa"], 0, lanes))
            pressure = choose(read(slide["slides"], 0, lanes) > 0.5, p + more, p)
        unit = 1.0 / (tolerance * pressure)
        measure = _raised(measure, abs(xx) * unit)
        measure = _raised(measure, abs(yy) * unit)
        measure = _raised(measure, abs(xy) * unit)
    # an estimate of the error means nothing beyond a change of this size
    u0, u1, u2 = read(trial, 3, lanes), read(trial, 4, lanes), read(trial, 5, lanes)
    change = _raised(0.0 * p, abs(end - p) / (LARGEST_CHANGE * p))
    change = _raised(change, abs(u0 - read(y, 3, lanes)) / (LARGEST_CHANGE * scale))
    change = _raised(change, abs(u1 / other_end - read(y, 4, lanes) / other) * (1.0 / LARGEST_CHANGE))
    change = _raised(change, abs(u2 / other_end - read(y, 5, lanes) / other) * (1.0 / LARGEST_CHANGE))
    # so that the next substep is shorter by this factor, for an estimate of order two
    change = change * change * change
    measure = choose((measure > change) | (change <= 1.0), measure, change)
    if options.sliding:
        measure = _raised(measure, kappa_error(slide, step, error, lanes) / tolerance)
    fine = worst <= _LIMITED
    if direct:
        inside = (u0 > SMALLEST_COORDINATION) & (u0 < LARGEST_COORDINATION) & (u1 * u1 + u2 * u2 < 4.0)
        worst = choose(fine, choose(inside, worst, _NOT_ADMISSIBLE), worst)
    worst = choose(fine, choose(measure < math.inf, worst, _NOT_ADMISSIBLE), worst)
    write(block["measure"], 0, measure, lanes)
    write(block["worst"], 0, choose(fine, choose(end > floor, worst, _NO_PRESSURE), worst), lanes)


@formula
def step_factor(measure, error_order):
    """Factor to the next substep from the error of the last in units of the tolerance."""
    if measure <= 0.0:
        return MAX_FACTOR
    return min(MAX_FACTOR, max(MIN_FACTOR, SAFETY * measure ** (-1.0 / (error_order + 1.0))))
