"""One substep in every lane: its stages, the state at its end, and what they found."""

from typing import NamedTuple

import numpy as np
from numba.extending import register_jitable

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.contract import Status
from granfabric.constitutive.lanes.eight import choose, read, somewhere, write
from granfabric.constitutive.lanes.elementary import larger
from granfabric.constitutive.network.closures import measures
from granfabric.constitutive.network.point import INPUTS, MICRO
from granfabric.constitutive.sliding.cone_return import return_to_cone
from granfabric.constitutive.sliding.substep import (
    advance_kappa,
    advance_length,
    begin_implicit,
    begin_sliding,
    keep_settled,
)

from .implicit_stage import MOST_PASSES, ROUNDING_OF_DERIVATIVES, improve_stage, keep_solved
from .stage import ADVANCED, RATES, UNKNOWNS, stage
from .substep import advance

MOST_STAGES = 8
SPARE = MOST_STAGES - 1
"""A stage that no scheme has: for rates that may not be kept."""

_LIMITED = float(Status.LIMITED)
_NOT_CONVERGED = float(Status.NOT_CONVERGED)


class Block(NamedTuple):
    """Arrays of a block of lanes; the last index is the lane."""

    inputs: np.ndarray
    """What the lanes were given (INPUTS)."""
    ends: np.ndarray
    """Micro-state and stress at the end (MICRO + 3)."""
    y: np.ndarray
    """Unknowns and their derivatives at the start of the substep (ADVANCED); likewise at a stage or the end."""
    trial: np.ndarray
    k: np.ndarray
    """Rates of all stages (MOST_STAGES RATES)."""
    before: np.ndarray
    """Of the last pass over an implicit stage."""
    sums: np.ndarray
    """z, a_c gained, lost, and strain, so far (9)."""
    step: np.ndarray
    """Length of the substep, in pseudo-time; one row, like those that follow."""
    time: np.ndarray
    fresh: np.ndarray
    """1 where the first stage of the substep has to be evaluated."""
    accepted: np.ndarray
    worst: np.ndarray
    measure: np.ndarray
    evaluations: np.ndarray
    solved: np.ndarray
    """1 where the state at the end of the increment has been found."""
    point_of: np.ndarray
    """Point in each lane (lanes,); -1 if none."""
    material: np.ndarray
    """Material whose numbers a lane holds (lanes,); -1 if none."""
    last: np.ndarray
    """Whether the substep is the last one of its increment (lanes,)."""


class Flow(NamedTuple):
    """What goes from one substep to the next beside the unknowns."""

    largest: float
    """Largest |s| so far."""
    guess1: float
    """Last value of what the closure wants guessed, and its rate in pseudo-time."""
    guess2: float
    drift1: float
    drift2: float


@register_jitable
def new_block(width):
    """Arrays for `width` lanes."""
    return Block(
        np.zeros((INPUTS, width)), np.zeros((MICRO + 3, width)),
        np.zeros((ADVANCED, width)), np.zeros((ADVANCED, width)), np.zeros((MOST_STAGES * RATES, width)),
        np.zeros((2 * ADVANCED, width)), np.zeros((9, width)), np.ones((1, width)), np.zeros((1, width)),
        np.zeros((1, width)), np.zeros((1, width)), np.zeros((1, width)), np.zeros((1, width)),
        np.zeros((1, width)),
        np.zeros((1, width)),
        np.full(width, -1),
        np.full(width, -1),
        np.zeros(width, dtype=np.bool_),
    )


@formula
def attempt_substep(
    block, scheme, tolerance, point, given, stressed, flow, here, final, closure, options, slide, rule, lanes
):
    """All stages of one substep from `block.y` over `block.step`; leaves its end in `block.trial`.

    Parameters
    ----------
    scheme : tuple
        a, b of the Runge-Kutta scheme.
    tolerance : float
        Of the equations of implicit stages.
    flow : Flow
    here : Network
        At the start.
    final : bool
        The increment ends with this substep in every lane, if it is accepted.
    point, given, stressed, closure, options, slide, rule, lanes :
        As in `stage.stage`.

    Returns
    -------
    network : Network
        At the last stage.
    stiffness : tuple of 5
        Likewise.
    flow : Flow
        If the substep is accepted.
    """
    a, b = scheme
    stages = b.shape[0]
    y, trial, k = block.y, block.trial, block.k
    step, fresh = read(block.step, 0, lanes), read(block.fresh, 0, lanes) > 0.5
    rows = ADVANCED if options.derivatives else UNKNOWNS
    worst, count = 0.0 * step, 0.0 * step
    everywhere = step == step
    network, stiffness = here, (step, step, step, step, step)
    last, drift, node = (flow.guess1, flow.guess2), (flow.drift1, flow.drift2), 0.0
    if slide is not None:
        begin_sliding(slide, step, lanes)
    i, passes, solving = 0, 0, everywhere
    if slide is None and not somewhere(fresh):
        i = 1
    while i < stages:
        implicit = a[i, i] != 0.0
        # a stage that only estimates the error needs no derivatives, unless another substep starts from it
        needed = b[i] != 0.0 or i < stages - 1 or (slide is None and not final)
        differentiate = options.derivatives and needed
        if implicit and passes == 0:
            solving = everywhere
            for row in range(rows):
                write(k, i * RATES + row, read(k, (i - 1) * RATES + row, lanes), lanes)
            if slide is not None:
                begin_implicit(slide, i, lanes)
        number = i + 1 if implicit else i
        advance(trial, y, k, step, number, a[i], rows, lanes)
        if slide is not None:
            advance_kappa(slide, step, number, a[i], lanes)
            if differentiate:
                advance_length(trial, k, slide, number, a[i], RATES, lanes)
        now = a[i].sum()
        ahead = (now - node) * step
        guess = (last[0] + drift[0] * ahead, last[1] + drift[1] * ahead)
        target = SPARE if implicit or (slide is None and i == 0) else i
        known = slide is None and i == 0
        outcome, found, moduli, guess = stage(
            target, trial, k, point, given, stressed, flow.largest, guess, known, here,
            closure, options, differentiate, i == 0, slide, rule, lanes,
        )
        if slide is None and i == 0:
            # the others know their first rates
            keep_solved(k, 0, SPARE, fresh, lanes)
            solving = fresh
        if implicit:
            passes += 1
            settled = everywhere
            if slide is not None:
                settled = keep_settled(
                    slide, i, SPARE, solving, a[i, i], step, tolerance, ROUNDING_OF_DERIVATIVES, differentiate, lanes
                )
            slot, other, _ = measures(closure, read(y, 0, lanes), here.z)
            unsettled = improve_stage(
                k, i, SPARE, block.before, step, a[i, i], tolerance, read(y, 0, lanes), slot, other,
                solving, settled, passes == 1, differentiate, lanes,
            )
            unsettled = unsettled & (outcome <= _LIMITED)
            if passes >= MOST_PASSES:
                outcome = choose(unsettled, _NOT_CONVERGED, outcome)
                unsettled = unsettled & (outcome <= _LIMITED)
            done = solving ^ unsettled
            keep_solved(k, i, SPARE, done, lanes)
        else:
            unsettled, done = solving ^ solving, solving
        count = choose(solving, count + 1.0, count)
        worst = choose(done, larger(outcome, worst), worst)
        network, stiffness = choose(done, found, network), choose(done, moduli, stiffness)
        before = last
        last = choose(done, guess, last)
        if now > node:
            per = 1.0 / ahead
            drift = choose(done, ((last[0] - before[0]) * per, (last[1] - before[1]) * per), drift)
        solving = unsettled
        if not somewhere(unsettled):
            i, passes, node, solving = i + 1, 0, now, everywhere
    if slide is not None or a[stages - 1, stages - 1] != 0.0:
        advance(trial, y, k, step, stages, b, rows, lanes)
    if slide is not None:
        advance_kappa(slide, step, stages, b, lanes)
        if options.derivatives:
            advance_length(trial, k, slide, stages, b, RATES, lanes)
        worst = return_to_cone(trial, stiffness, stressed, worst, slide, options, lanes)
    write(block.worst, 0, worst, lanes)
    write(block.evaluations, 0, count, lanes)
    return network, stiffness, Flow(flow.largest, last[0], last[1], drift[0], drift[1])
