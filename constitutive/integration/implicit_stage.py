"""Stages of an implicit scheme: K = f(y + h (sum of earlier stages + a_ii K)) in every lane, by accelerated iteration.

The rates are Lipschitz and homogeneous of degree one, so that K -> f(... + h a_ii K) contracts as long as a substep
changes the state by less than the state itself, which error control demands anyway. Each pass evaluates the rates once;
Anderson's mixing of depth one speeds it up. The derivatives by the strain increment obey the linearised equations and
are iterated with them, every column by its own mixing: at the end they belong to the discrete update exactly.

A lane that is solved stays as it is while others go on, so that a point's result does not depend on its neighbours. A
lane that is not solved in `MOST_PASSES` fails, and its substep is shortened. References: Anderson, J. ACM 12 (1965)
547; Walker & Ni, SIAM J. Numer. Anal. 49 (2011) 1715.
"""

import math

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.contract import Status
from granfabric.constitutive.lanes.layout import (
    ADVANCED,
    BLOCK_CHANGE,
    BLOCK_CROSS,
    BLOCK_RESIDUAL,
    BLOCK_SIZE,
    COLUMNS,
    EVALUATIONS,
    KEPT_STIFFNESS,
    KEPT_X1,
    KEPT_X2,
    KERNEL_OPTIONS,
    LANES,
    OLD_ITERATE,
    OLD_RESIDUAL,
    OUTCOME,
    RATE,
    RATES,
    SETTLED,
    SLOT_SCALE,
    SOLVING,
    STAGE,
    STEP,
    STIFF_K,
    UNKNOWNS,
    WEIGHT,
    WORST,
    X1,
    X2,
    L,
    Y,
)
from granfabric.constitutive.lanes.rows import NOT_NEGATIVE, copy_rows
from granfabric.constitutive.sliding.plastic_advance import improve_plastic_stage

MOST_PASSES = 30
"""An iteration that halves its error in each pass has gained nine digits by then; a slower one is not worth it."""
SHARE_OF_TOLERANCE = 0.01
"""What the stage equations may be wrong by, in units of the tolerance of a substep."""
ROUNDING = 1e-14
"""The same with fixed substeps, which have no tolerance; nothing below is worth another pass."""
ROUNDING_OF_DERIVATIVES = 1e-12
"""Their sums cancel more: an iteration may hover above `ROUNDING` without end."""

_LIMITED = float(Status.LIMITED)
_NOT_CONVERGED = float(Status.NOT_CONVERGED)


@compiled(**KERNEL_OPTIONS)
def begin_stage(w, number):
    """Start the iteration for the stage of that number from the rates of the one before."""
    copy_rows(w, STAGE + number * RATES * L, STAGE + (number - 1) * RATES * L, ADVANCED * L)
    for lane in range(LANES):
        w[SOLVING + lane] = 1.0
        # stress is measured by p, z by itself: as the error of a substep
        p = -0.5 * (w[Y + lane] + w[Y + L + lane])
        stress, slot = 1.0 / (p * p), 1.0 / (w[SLOT_SCALE + lane] * w[SLOT_SCALE + lane])
        w[WEIGHT + lane] = stress
        w[WEIGHT + L + lane] = stress
        w[WEIGHT + 2 * L + lane] = stress
        w[WEIGHT + 3 * L + lane] = slot
        w[WEIGHT + 4 * L + lane] = 1.0
        w[WEIGHT + 5 * L + lane] = 1.0


@compiled(**KERNEL_OPTIONS)
def _measure(w, iterate, offset):
    """Squares of f, of the residual r = f - K and of its change since the last pass, and the product of these two."""
    for lane in range(LANES):
        w[BLOCK_RESIDUAL + lane], w[BLOCK_CHANGE + lane] = 0.0, 0.0
        w[BLOCK_CROSS + lane], w[BLOCK_SIZE + lane] = 0.0, 0.0
    for row in range(UNKNOWNS):
        for lane in range(LANES):
            at = row * L + lane
            weight = w[WEIGHT + at]
            value = w[RATE + offset + at]
            residual = value - w[iterate + offset + at]
            change = residual - w[OLD_RESIDUAL + offset + at]
            w[BLOCK_RESIDUAL + lane] += weight * residual * residual
            w[BLOCK_CHANGE + lane] += weight * change * change
            w[BLOCK_CROSS + lane] += weight * residual * change
            w[BLOCK_SIZE + lane] += weight * value * value


@compiled(**KERNEL_OPTIONS)
def _mix(w, iterate, offset, first):
    """Next iterate f - theta (f - f of the last pass) of one block in the lanes that are being solved."""
    for lane in range(LANES):
        change = w[BLOCK_CHANGE + lane]
        # the best combination of the last two residuals; without a last one, or without change, plain iteration
        w[BLOCK_CROSS + lane] = 0.0 if first or not change > 0.0 else w[BLOCK_CROSS + lane] / change
    for row in range(UNKNOWNS):
        for lane in range(LANES):
            at = row * L + lane
            value, before = w[RATE + offset + at], w[iterate + offset + at]
            residual, theta = value - before, w[BLOCK_CROSS + lane]
            last = w[OLD_ITERATE + offset + at] + w[OLD_RESIDUAL + offset + at]
            mixed = value - theta * (value - last) if theta != 0.0 else value
            w[OLD_ITERATE + offset + at] = before
            w[OLD_RESIDUAL + offset + at] = residual
            w[iterate + offset + at] = mixed if w[SOLVING + lane] > 0.0 else before


@compiled(**KERNEL_OPTIONS)
def improve_stage(w, number, diagonal, tolerance, passes, derivatives, sliding):
    """Compare the rates just evaluated with those they were evaluated for; take the next iterate where they differ.

    Parameters
    ----------
    w : ndarray
        Workspace; K of the stage is in its place among STAGE, f(K) in RATE and what follows.
    number : int
        Of the stage.
    diagonal : float
        a_ii of the scheme.
    tolerance : float
        Largest error of the stage's state (stress over p, z relative, a_c), and relative one of the derivatives.
    passes : int
        Evaluations so far, this one included.
    derivatives, sliding : bool

    Returns
    -------
    bool
        True when every lane is solved or has failed.
    """
    iterate = (STAGE + number * RATES * L) & NOT_NEGATIVE
    for lane in range(LANES):
        w[EVALUATIONS + lane] += w[SOLVING + lane]
        w[SETTLED + lane] = w[SOLVING + lane]
    if sliding:
        improve_plastic_stage(w, number, diagonal, tolerance, ROUNDING_OF_DERIVATIVES, derivatives)
    for block in range(1 + COLUMNS if derivatives else 1):
        offset = block * UNKNOWNS * L
        _measure(w, iterate, offset)
        for lane in range(LANES):
            size = math.sqrt(w[BLOCK_SIZE + lane])
            # derivatives are wanted relative to themselves, unknowns relative to what a substep may err by
            if block > 0:
                limit = max(tolerance, ROUNDING_OF_DERIVATIVES) * size
            else:
                limit = tolerance * (1.0 / (diagonal * w[STEP + lane]) + size)
            good = math.sqrt(w[BLOCK_RESIDUAL + lane]) <= limit
            w[SETTLED + lane] = w[SETTLED + lane] if good else 0.0
        _mix(w, iterate, offset, passes == 1)
    done = True
    for lane in range(LANES):
        if w[SOLVING + lane] == 0.0:
            continue
        outcome = w[OUTCOME + lane]
        if outcome <= _LIMITED and w[SETTLED + lane] == 0.0:
            if passes < MOST_PASSES:
                done = False
                continue
            outcome = _NOT_CONVERGED
        w[SOLVING + lane] = 0.0
        w[WORST + lane] = max(w[WORST + lane], outcome)
        for row in range(RATES):
            w[iterate + row * L + lane] = w[RATE + row * L + lane]
        w[KEPT_X1 + lane], w[KEPT_X2 + lane] = w[X1 + lane], w[X2 + lane]
        for row in range(5):
            w[KEPT_STIFFNESS + row * L + lane] = w[STIFF_K + row * L + lane]
    if done:
        # what lanes solved early left for the next stage and the error to start from, however long others took
        copy_rows(w, X1, KEPT_X1, L)
        copy_rows(w, X2, KEPT_X2, L)
        copy_rows(w, STIFF_K, KEPT_STIFFNESS, 5 * L)
    return done
