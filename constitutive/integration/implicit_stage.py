"""Stages of an implicit scheme: K = f(y + h (sum of earlier stages + a_ii K)), by accelerated iteration.

The rates are Lipschitz and homogeneous of degree one, so that K -> f(... + h a_ii K) contracts as long as a substep
changes the state by less than the state itself, which error control demands anyway. Each pass evaluates the rates once;
Anderson's mixing of depth one speeds it up. The derivatives by the strain increment obey the linearised equations and
are iterated with them, every column by its own mixing: at the end they belong to the discrete update exactly.

A lane that is solved stays as it is while others go on, so that a point's result does not depend on its neighbours. A
lane that is not solved in `MOST_PASSES` fails, and its substep is shortened. References: Anderson, J. ACM 12 (1965)
547; Walker & Ni, SIAM J. Numer. Anal. 49 (2011) 1715.
"""

import math

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import choose, read, somewhere, write

from .stage import ADVANCED, COLUMNS, RATES, UNKNOWNS

MOST_PASSES = 30
"""An iteration that halves its error in each pass has gained nine digits by then; a slower one is not worth it."""
SHARE_OF_TOLERANCE = 0.01
"""What the stage equations may be wrong by, in units of the tolerance of a substep."""
ROUNDING = 1e-14
"""The same with fixed substeps, which have no tolerance; nothing below is worth another pass."""
ROUNDING_OF_DERIVATIVES = 1e-12
"""Their sums cancel more: an iteration may hover above `ROUNDING` without end."""


@formula
def improve_stage(
    k, number, new, before, step, diagonal, tolerance, scales, solving, settled, first, derivatives, lanes
):
    """Compare the rates just evaluated with those they were evaluated for; take the next iterate where they differ.

    Parameters
    ----------
    k : ndarray
        Stages. K of this one is in its place, f(K) in stage `new`.
    number, new : int
        Stages.
    before : ndarray, shape (2 ADVANCED, lanes)
        Iterate and residual of the last pass; overwritten.
    step, diagonal : float
        h, and a_ii of the scheme.
    tolerance : float
        Largest error of the stage's state (stress over p, z relative, a_c), and relative one of the derivatives.
    scales : tuple of 3
        By what stress and the closure's unknowns (the first, the other two) are measured.
    solving : bool
        Lanes whose iteration is under way.
    settled : bool
        Whether the rates of the hardening strain have settled.
    first : bool
        This is the first pass.
    derivatives : bool

    Returns
    -------
    bool
        Lanes that are not settled.
    """
    p, slot, other = scales
    blocks = 1 + COLUMNS if derivatives else 1
    for block in range(blocks):
        offset = block * UNKNOWNS
        residual, change, cross, size = 0.0 * step, 0.0 * step, 0.0 * step, 0.0 * step
        for row in range(UNKNOWNS):
            scale = 1.0 / choose(row < 3, p, choose(row == 3, slot, other))
            value = read(k, new * RATES + offset + row, lanes) * scale
            r = value - read(k, number * RATES + offset + row, lanes) * scale
            d = r - read(before, ADVANCED + offset + row, lanes) * scale
            residual += r * r
            change += d * d
            cross += r * d
            size += value * value
        size = math.sqrt(size)
        # derivatives are wanted relative to themselves, unknowns relative to what a substep may err by
        if block > 0:
            limit = max(tolerance, ROUNDING_OF_DERIVATIVES) * size
        else:
            limit = tolerance * (1.0 / (diagonal * step) + size)
        settled = settled & (math.sqrt(residual) <= limit)
        # the best combination of the last two residuals; without a last one, or without change, plain iteration
        least = math.inf if first else 0.0
        mixing = change > least
        theta = choose(mixing, cross / choose(mixing, change, 1.0), 0.0)
        for row in range(UNKNOWNS):
            at = offset + row
            value, iterate = read(k, new * RATES + at, lanes), read(k, number * RATES + at, lanes)
            last = read(before, at, lanes) + read(before, ADVANCED + at, lanes)
            mixed = choose(theta != 0.0, value - theta * (value - last), value)
            write(before, at, iterate, lanes)
            write(before, ADVANCED + at, value - iterate, lanes)
            write(k, number * RATES + at, choose(solving, mixed, iterate), lanes)
    return solving & (choose(settled, 0.0 * step, 1.0 + 0.0 * step) > 0.5)


@formula
def keep_solved(k, number, new, solved, lanes):
    """Put the rates just evaluated in the place of the stage where it is solved."""
    if somewhere(solved):
        for row in range(RATES):
            old = read(k, number * RATES + row, lanes)
            write(k, number * RATES + row, choose(solved, read(k, new * RATES + row, lanes), old), lanes)
