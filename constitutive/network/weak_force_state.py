"""The closure by shifted weak forces as part of the rate equations (see `shifted_distribution` for its own ones).

Its unknowns are S_i and V = p Y = p (X_1 - chi A); z and a_c follow from them and the stress. Neither has a rate: V is
what the packing carried before anything was loaded, and S_i a function of the largest |s| so far, which `remember`
moves when a substep has been accepted.
"""

import math
from typing import NamedTuple

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import choose, read, write
from granfabric.constitutive.lanes.elementary import larger, power
from granfabric.constitutive.material_table import (
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

from .point import Network, load
from .shifted_distribution import network_of, split_change
from .slip_memory import keep_held
from .tangential_force import slip_numbers


class WeakState(NamedTuple):
    """What the pressure does to weak forces; see `shifted_distribution`."""

    ratio: float
    """P = p/p_0."""
    stretch: float
    """P^(1-a), by which D_1 is more than X_1."""
    growth: float
    """1 - a, its logarithmic derivative."""
    shift: float
    """D_0."""
    shift_by_p: float
    """Its derivative by ln p."""
    closing: float
    """R: what gaps close by besides."""
    closing_by_p: float
    relative_shift: float
    """X_0 = chi_p (1 - 1/P): the shift without any stretch, in units of the present mean force."""
    delay: float
    """L = lambda max(X_0, 0): the stress ratio by which a grown pressure delays slip."""
    delay_by_p: float
    gain: float
    """g."""
    room: float
    """beta at the initial coordination number: pairs that may close, over contacts; 0 without gain."""


@formula
def weak_state(closure, point, p):
    """What the pressure p does to weak forces."""
    # X_0 = chi_p (1 - p_0/p) at the start
    reference = point.start_p * larger(1.0 - point.start_shift / closure.chi_p, 1e-9)
    ratio = p / reference
    room = point.neighbours - point.origin_z
    room = choose(room > 0.0, room, 0.0) / point.origin_z
    growth = 1.0 - closure.gradient
    stretch = power(ratio, growth)
    plain = closure.chi_p * (ratio - 1.0)
    rising = ratio > 1.0
    # P^-a
    narrowing = choose(rising, stretch / ratio, 1.0)
    shift = plain * narrowing
    shift_by_p = closure.chi_p * ratio * narrowing - choose(rising, closure.gradient, 0.0) * shift
    return WeakState(
        ratio,
        stretch,
        growth,
        shift,
        shift_by_p,
        plain - shift,
        closure.chi_p * ratio - shift_by_p,
        plain / ratio,
        choose(rising, closure.delay * (plain / ratio), 0.0),
        choose(rising, closure.delay * (closure.chi_p / ratio), 0.0),
        choose(room > 0.0, point.half_gap * (point.force_scale * reference / point.origin_z), 0.0),
        room,
    )


@formula
def unknowns(closure, point, stress, micro):
    """S_i and V."""
    v1 = stress[0] * (micro.shift1 - closure.chi * (micro.n1 + micro.a1))
    return micro.spread, v1, stress[0] * (micro.shift2 - closure.chi * (micro.n2 + micro.a2))


@formula
def irreversible_spread(closure, spread, largest, s1, s2):
    """S_i at the stress ratio s, given its value at the largest |s| so far, and whether s is beyond that."""
    size = s1 * s1 + s2 * s2
    virgin = size > largest * largest
    return choose(virgin, spread + closure.c_i * (size - largest * largest), spread), virgin


@formula
def slipped(closure, spread, largest, weak):
    """What slip has left of S_i at a pressure, with its derivatives by S_i and by ln p; `largest` is |s| of S_i.

    A contact that a grown pressure holds does not slip, and leaves nothing: ``S_i m/(m + L)``, as `tangential_force`
    has it for a_t. S_i grows with m, so that the derivative by S_i has both.
    """
    total = largest + weak.delay
    held = (weak.delay > 0.0) & (total > 0.0)
    inverse = 1.0 / choose(held, total, 1.0)
    free = choose(held, largest * inverse, 1.0)
    c_i = closure.c_i
    # dm = dS_i/(2 c_i m)
    growing = spread * weak.delay * inverse * inverse / choose(c_i * largest > 0.0, 2.0 * c_i * largest, 1.0)
    by_spread = free + choose(held & (c_i * largest > 0.0), growing, 0.0)
    return spread * free, by_spread, choose(held, -spread * free * inverse * weak.delay_by_p, 0.0)


@formula
def network_at(closure, point, stress, y, guess, known, here, rule, inputs, lanes):
    """z and a_c of the stress and the unknowns, with derivatives.

    Parameters
    ----------
    closure : ShiftedDistribution
    point : Point
    stress : tuple of 5
        p, 1/p, s (2) and the largest |s| so far.
    y : tuple of 3
        S_i, V.
    guess : tuple of 2
        a_c, about.
    known : bool
        The network is `here`, and its derivatives are not wanted.
    here : Network
    rule, inputs, lanes :
        See `shifted_distribution.network_of`.

    Returns
    -------
    solved : bool
    network : Network
    partials : tuple
    """
    p, inverse, s1, s2, largest = stress
    zero = 0.0 * p
    none = (zero, zero, zero, zero, zero, zero)
    solved, network, partials = zero == 0.0, here, (none, none, none, zero, zero, zero)
    if not known:
        spread, virgin = irreversible_spread(closure, y[0], largest, s1, s2)
        weak = weak_state(closure, point, p)
        size = math.sqrt(s1 * s1 + s2 * s2)
        left, left_by_spread, left_by_p = slipped(closure, spread, choose(virgin, size, largest), weak)
        y1, y2 = y[1] * inverse, y[2] * inverse
        normal1 = point.start_n1 + point.c_n * (s1 - point.start_s1)
        normal2 = point.start_n2 + point.c_n * (s2 - point.start_s2)
        solved, (z, a1, a2, x1, x2), changes, (c1, c2, mu, t1, t2) = network_of(
            weak,
            left,
            (s1, s2),
            (y1, y2),
            guess,
            (point.origin_z, point.origin_a1, point.origin_a2),
            (point.p_zero, point.p_slope),
            (normal1, normal2),
            point.c_n,
            closure,
            (point.start_s1, point.start_s2, point.start_p * weak.ratio * inverse),
            rule,
            inputs,
            lanes,
        )
        network = Network(z, a1, a2, x1, x2, c1, c2, mu, t1, t2)
        by_z = _by_spread(changes[0], left_by_spread, left_by_p)
        by_1 = _by_spread(changes[1], left_by_spread, left_by_p)
        by_2 = _by_spread(changes[2], left_by_spread, left_by_p)
        partials = (by_z, by_1, by_2, y1, y2, choose(virgin, 2.0 * closure.c_i, zero))
    return solved, network, partials


@formula
def _by_spread(change, left_by_spread, left_by_p):
    """Derivatives by ln p, s (2), V/p (2), S_i from those at a given rest of S_i and by that rest."""
    at_p, at_1, at_2, at_y1, at_y2, at_left = change
    return at_p + at_left * left_by_p, at_1, at_2, at_y1, at_y2, at_left * left_by_spread


@formula
def network_change(closure, partials, stress, change, stress_change):
    """Changes of z and a_c with those of the unknowns and of ln p and s (`stress` as in `network_at`)."""
    by_z, by_1, by_2, y1, y2, growth = partials
    inverse, s1, s2 = stress[1], stress[2], stress[3]
    relative, u1, u2 = stress_change
    w1, w2 = change[1] * inverse - y1 * relative, change[2] * inverse - y2 * relative
    # S_i follows |s| where that is at its largest, and is what it was elsewhere
    ti = choose(growth > 0.0, growth * (s1 * u1 + s2 * u2), change[0])
    return (
        by_z[0] * relative + by_z[1] * u1 + by_z[2] * u2 + by_z[3] * w1 + by_z[4] * w2 + by_z[5] * ti,
        by_1[0] * relative + by_1[1] * u1 + by_1[2] * u2 + by_1[3] * w1 + by_1[4] * w2 + by_1[5] * ti,
        by_2[0] * relative + by_2[1] * u1 + by_2[2] * u2 + by_2[3] * w1 + by_2[4] * w2 + by_2[5] * ti,
    )


@formula
def rates(closure, point, stress, rate, network, guess, strain, with_derivatives, rule):
    """None of S_i and V; see `rates.rates` for arguments and results."""
    zero = 0.0 * rate[0]
    none = (zero, zero, zero)
    # V starts each stage from the fabric of the one before
    return zero == 0.0, zero != 0.0, none, none, none, (network.a1, network.a2), zero


@formula
def rate_changes(closure, point, stress, rate, network, strain, partials, change, stress_change, rate_change, own):
    """Changes of the rates of S_i and V: none."""
    zero = 0.0 * rate[0]
    return zero, zero, zero


@formula
def measures(closure, p, z):
    """S_i absolutely, V by the pressure."""
    return 1.0 + 0.0 * p, p, False


@formula
def remember(closure, y, accepted, largest, derivatives, rotation, lanes):
    """S_i and the largest |s| at the end of an accepted substep; derivatives of S_i where |s| is at its largest."""
    inverse = 1.0 / read(y, 0, lanes)
    turns = 1.0 if rotation else 0.0
    s1, s2 = read(y, 1, lanes) * inverse, turns * read(y, 2, lanes) * inverse
    old = read(y, 3, lanes)
    spread, virgin = irreversible_spread(closure, old, largest, s1, s2)
    virgin = virgin & accepted
    write(y, 3, choose(virgin, spread, old), lanes)
    if derivatives:
        for column in range(3):
            row = 6 + 6 * column
            relative = read(y, row, lanes) * inverse
            u1 = read(y, row + 1, lanes) * inverse - s1 * relative
            u2 = turns * read(y, row + 2, lanes) * inverse - s2 * relative
            change = 2.0 * closure.c_i * (s1 * u1 + s2 * u2)
            write(y, row + 3, choose(virgin, change, read(y, row + 3, lanes)), lanes)
    return choose(virgin, math.sqrt(s1 * s1 + s2 * s2), largest)


@formula
def leave(closure, inputs, ends, point, p, network, y, largest, rule, lanes):
    """Shift and spread of the weak forces; with "frictional" a_n, a_t and f as functions of the state."""
    weak = weak_state(closure, point, p)
    write(ends, M_SHIFT, weak.relative_shift, lanes)
    write(ends, M_SHIFT + 1, network.shift1, lanes)
    write(ends, M_SHIFT + 2, network.shift2, lanes)
    write(ends, M_SPREAD, read(y, 3, lanes), lanes)
    write(ends, M_LARGEST_S, largest, lanes)
    if closure.frictional:
        # p = z f (1 + a_c.a_n/2) up to a constant
        before = read(inputs, M_A1, lanes) * read(inputs, M_N1, lanes)
        before += read(inputs, M_A2, lanes) * read(inputs, M_N2, lanes)
        write(ends, M_F, read(ends, M_F, lanes) * (1.0 + 0.5 * before) / network.mu, lanes)
        write(ends, M_N1, network.carried1 - network.a1, lanes)
        write(ends, M_N2, network.carried2 - network.a2, lanes)
        write(ends, M_T1, network.tangential1, lanes)
        write(ends, M_T2, network.tangential2, lanes)
    if closure.remembers:
        start = (point.start_s1, point.start_s2, point.start_p * weak.ratio / p)
        numbers, _ = slip_numbers(closure, weak, point.p_zero)
        turns = 1.0 if closure.turns else 0.0
        keep_held(weak, start, numbers[2], turns, rule[5], inputs, ends, lanes)


@formula
def split(closure, inputs, ends, options, rule, lanes):
    """Gained and lost from the change of N, direction by direction; added to the rows of `ends`.

    Fixed directions add up to a slightly different change than those in the frame of X_1. The difference counts as
    gained or as lost by its sign, so that neither ever falls and start + gained - lost = end to rounding.
    """
    point = load(inputs, options, lanes)[0]
    weak = weak_state(closure, point, point.start_p)
    left, _, _ = slipped(closure, read(inputs, M_SPREAD, lanes), read(inputs, M_LARGEST_S, lanes), weak)
    start = (
        weak.shift,
        weak.stretch * read(inputs, M_SHIFT + 1, lanes),
        weak.stretch * read(inputs, M_SHIFT + 2, lanes),
        weak.stretch * left,
        (weak.gain, weak.room, weak.closing),
    )
    p = -0.5 * (read(ends, MICRO, lanes) + read(ends, MICRO + 1, lanes))
    weak = weak_state(closure, point, p)
    left, _, _ = slipped(closure, read(ends, M_SPREAD, lanes), read(ends, M_LARGEST_S, lanes), weak)
    end = (
        weak.shift,
        weak.stretch * read(ends, M_SHIFT + 1, lanes),
        weak.stretch * read(ends, M_SHIFT + 2, lanes),
        weak.stretch * left,
        (weak.gain, weak.room, weak.closing),
    )
    origin = (point.origin_z, point.origin_a1, point.origin_a2)
    density = (point.p_zero, point.p_slope)
    gained, lost = split_change(origin, density, closure, start, end, rule[2], rule[3])
    for i in range(3):
        rest = read(ends, M_Z + i, lanes) - read(inputs, M_Z + i, lanes) - (gained[i] - lost[i])
        more, less = choose(rest > 0.0, rest, 0.0), choose(rest < 0.0, -rest, 0.0)
        write(ends, M_GAINED + i, read(inputs, M_GAINED + i, lanes) + (gained[i] + more), lanes)
        write(ends, M_LOST + i, read(inputs, M_LOST + i, lanes) + (lost[i] + less), lanes)
    return True


class ShiftedDistribution(NamedTuple):
    """Numbers and choices of the closure "shifted_distribution"; see `closures` for what it answers."""

    frictional: bool
    remembers: bool
    """Tangential forces depend on the way to the present stress."""
    turns: bool
    """The stress ratio has two components."""
    chi: float
    following: float
    """phi: fraction of weak contacts that follow the mean change of their direction."""
    chi_p: float
    gradient: float
    c_e: float
    c_p: float
    c_i: float
    c_t: float
    kappa: float
    slip: float
    delay: float
