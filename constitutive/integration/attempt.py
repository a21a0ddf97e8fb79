"""One substep in every lane: its stages, the state at its end, and what they found."""

from typing import NamedTuple

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.contract import Status
from granfabric.constitutive.lanes.eight import choose, read, somewhere, write
from granfabric.constitutive.lanes.elementary import larger
from granfabric.constitutive.network.closures import measures
from granfabric.constitutive.sliding.cone_return import return_to_cone
from granfabric.constitutive.sliding.substep import (
    advance_kappa,
    advance_length,
    begin_implicit,
    begin_sliding,
    keep_settled,
)

from .block import SPARE
from .implicit_stage import MOST_PASSES, ROUNDING_OF_DERIVATIVES, improve_stage, keep_solved
from .stage import ADVANCED, RATES, UNKNOWNS, stage
from .substep import advance

_LIMITED = float(Status.LIMITED)
_NOT_CONVERGED = float(Status.NOT_CONVERGED)


class Flow(NamedTuple):
    """What goes from one substep to the next beside the unknowns."""

    largest: float
    """Largest |s| so far."""
    guess1: float
    """Last value of what the closure wants guessed, and its rate in pseudo-time."""
    guess2: float
    drift1: float
    drift2: float


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
    y, trial, k = block["y"], block["trial"], block["k"]
    step, fresh = read(block["step"], 0, lanes), read(block["fresh"], 0, lanes) > 0.5
    rows = ADVANCED if options.derivatives else UNKNOWNS
    worst, count = 0.0 * step, 0.0 * step
    everywhere = step == step
    network, stiffness = here, (step, step, step, step, step)
    last, drift, node = (flow.guess1, flow.guess2), (flow.drift1, flow.drift2), 0.0
    if options.sliding:
        begin_sliding(slide, step, lanes)
    i, passes, solving = 0, 0, everywhere
    if not options.sliding and not somewhere(fresh):
        i = 1
    while i < stages:
        implicit = a[i, i] != 0.0
        # a stage that only estimates the error needs no derivatives, unless another substep starts from it
        needed = b[i] != 0.0 or i < stages - 1 or (not options.sliding and not final)
        differentiate = options.derivatives and needed
        if implicit and passes == 0:
            solving = everywhere
            for row in range(rows):
                write(k, i * RATES + row, read(k, (i - 1) * RATES + row, lanes), lanes)
            if options.sliding:
                begin_implicit(slide, i, lanes)
        number = i + 1 if implicit else i
        advance(trial, y, k, step, number, a[i], rows, lanes)
        if options.sliding:
            advance_kappa(slide, step, number, a[i], lanes)
            if differentiate:
                advance_length(trial, k, slide, number, a[i], RATES, lanes)
        now = a[i].sum()
        ahead = (now - node) * step
        guess = (last[0] + drift[0] * ahead, last[1] + drift[1] * ahead)
        target = SPARE if implicit or (not options.sliding and i == 0) else i
        known = not options.sliding and i == 0
        outcome, found, moduli, guess = stage(
            target, trial, k, block["inputs"], point, given, stressed, flow.largest, guess, known, here,
            closure, options, differentiate, i == 0, slide, rule, lanes,
        )
        if not options.sliding and i == 0:
            # the others know their first rates
            keep_solved(k, 0, SPARE, fresh, lanes)
            solving = fresh
        if implicit:
            passes += 1
            settled = everywhere
            if options.sliding:
                settled = keep_settled(
                    slide, i, SPARE, solving, a[i, i], step, tolerance, ROUNDING_OF_DERIVATIVES, differentiate, lanes
                )
            slot, other, _ = measures(closure, read(y, 0, lanes), here.z)
            unsettled = improve_stage(
                k, i, SPARE, block["before"], step, a[i, i], tolerance,
                (read(y, 0, lanes), slot, other),
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
    if options.sliding or a[stages - 1, stages - 1] != 0.0:
        advance(trial, y, k, step, stages, b, rows, lanes)
    if options.sliding:
        advance_kappa(slide, step, stages, b, lanes)
        if options.derivatives:
            advance_length(trial, k, slide, stages, b, RATES, lanes)
        worst = return_to_cone(trial, stiffness, stressed, worst, slide, options, lanes)
    write(block["worst"], 0, worst, lanes)
    write(block["evaluations"], 0, count, lanes)
    return network, stiffness, Flow(flow.largest, last[0], last[1], drift[0], drift[1])
