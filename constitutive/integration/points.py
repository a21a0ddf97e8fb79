"""Update of many points over an increment: an embedded Runge-Kutta pair over stress and micro-state together.

A block of lanes advances as many points at once, each at its own pseudo-time with its own substep; lanes whose points
have arrived take the next ones, so that points that need many substeps do not hold up the others for long. The last
stage of a substep is at its end, and its rates are the first ones of the next; those of the first substep come from the
state as it is given. What is gained and lost, and the strain, are integrated with the same weights as the unknowns;
z(end) = z(start) + gained - lost therefore holds to rounding.

Kernels are compiled for the closure that they are called with. Everything else is a number, also whether points may
slide: a decision once a stage costs nothing, a second kernel seconds.
"""

import math

import numpy as np

from granfabric.constitutive.compilation import compiled, formula
from granfabric.constitutive.contract import Status
from granfabric.constitutive.lanes.eight import choose, read, write
from granfabric.constitutive.material_table import M_GAMMA, M_KAPPA, MICRO
from granfabric.constitutive.network.closures import network_at, remember, split, unknowns
from granfabric.constitutive.network.point import (
    IN_CONTROL,
    IN_GIVEN,
    IN_STRESS,
    load,
    take_material,
    take_point,
)
from granfabric.constitutive.sliding.cone import plastic_shear_strain
from granfabric.constitutive.sliding.slide import SLIDE
from granfabric.constitutive.sliding.substep import accept_sliding
from granfabric.constitutive.stiffness import components, strain_invariants

from .attempt import Flow, attempt_substep
from .block import BLOCK
from .end_values import end_values
from .implicit_stage import ROUNDING, SHARE_OF_TOLERANCE
from .lane import (
    TANGENT_CONTINUUM,
    TANGENT_PROPAGATED,
    fill_idle,
    go_on,
    judge,
    keep_start,
    plan,
    put_continuum_tangent,
    put_ends,
    put_propagated_tangent,
    take_next,
)
from .stage import ADVANCED, GAINED, RATES, UNKNOWNS
from .substep import estimate_error, summed

LIMITED = int(Status.LIMITED)
NOT_CONVERGED = int(Status.NOT_CONVERGED)
NOT_FINITE = int(Status.NOT_FINITE)


@formula
def stressed_components(inputs, lanes):
    """Which components of the increment are stresses, in every lane."""
    return (
        read(inputs, IN_CONTROL, lanes) > 0.5,
        read(inputs, IN_CONTROL + 1, lanes) > 0.5,
        read(inputs, IN_CONTROL + 2, lanes) > 0.5,
    )


@formula
def increment_of(inputs, options, lanes):
    """The increment as the stage takes it: strain v, e_1, e_2, or, if stress may be given, as it is."""
    given = read(inputs, IN_GIVEN, lanes), read(inputs, IN_GIVEN + 1, lanes), read(inputs, IN_GIVEN + 2, lanes)
    if options.mixed:
        return given
    return strain_invariants(given[0], given[1], given[2])


@formula
def split_changes(first, end, call, block, closure, options, rule, lanes):
    """What was gained and what was lost, where the closure's rates do not tell."""
    width = len(lanes)
    for start in range(first, end, width):
        for lane in range(width):
            point = min(start + lane, end - 1)
            par = call.table[call.material_index[point]]
            take_material(block["inputs"], lane, par)
            take_point(
                block["inputs"], lane, point, call.given, call.stress_start, call.state_start, par,
                call.micro_of_column,
            )
            # rows without a column are zero, whatever the lane held before
            for row in range(MICRO):
                block["ends"][row, lane] = 0.0
            for i in range(call.micro_of_column.shape[0]):
                block["ends"][call.micro_of_column[i], lane] = call.state_end[point, i]
            for i in range(3):
                block["ends"][MICRO + i, lane] = call.stress_end[point, i]
        if not split(closure, block["inputs"], block["ends"], options, rule, lanes):
            return
        for lane in range(min(width, end - start)):
            point = start + lane
            if call.status[point] <= LIMITED and call.counts[point, 0] > 0:
                total = 0.0
                for i in range(call.micro_of_column.shape[0]):
                    call.state_end[point, i] = block["ends"][call.micro_of_column[i], lane]
                    total += call.state_end[point, i]
                if not abs(total) < math.inf:
                    call.status[point] = NOT_FINITE
                    keep_start(call, point)


@formula
def begin(block, stress, unknown, fresh, lanes):
    """Start values of the lanes that have just taken a point."""
    for row in range(3):
        write(block["y"], row, choose(fresh, stress[row], read(block["y"], row, lanes)), lanes)
        write(block["y"], 3 + row, choose(fresh, unknown[row], read(block["y"], 3 + row, lanes)), lanes)
    for row in range(UNKNOWNS, ADVANCED):
        write(block["y"], row, choose(fresh, 0.0, read(block["y"], row, lanes)), lanes)
    for row in range(9):
        write(block["sums"], row, choose(fresh, 0.0, read(block["sums"], row, lanes)), lanes)


@formula
def accept(block, flow, here, network, next_flow, final, closure, options, b, slide, lanes):
    """Move the accepted lanes to the end of their substep."""
    accepted = read(block["accepted"], 0, lanes) > 0.5
    step = choose(accepted, read(block["step"], 0, lanes), 0.0)
    rows = ADVANCED if options.derivatives else UNKNOWNS
    for row in range(rows):
        write(block["y"], row, choose(accepted, read(block["trial"], row, lanes), read(block["y"], row, lanes)), lanes)
    parts = 3 if options.mixed else 2
    for part in range(parts):
        more = summed(block["k"], GAINED + 3 * part, step, b, lanes)
        for i in range(3):
            row = 3 * part + i
            total = read(block["sums"], row, lanes)
            write(block["sums"], row, choose(accepted, total + more[i], total), lanes)
    if not options.sliding:
        if not final:
            # the rates of the last stage are the first ones of the next substep
            last = (b.shape[0] - 1) * RATES
            for row in range(RATES):
                rate = choose(accepted, read(block["k"], last + row, lanes), read(block["k"], row, lanes))
                write(block["k"], row, rate, lanes)
    else:
        accept_sliding(slide, accepted, step, b, block["sums"], 6, lanes)
    largest = remember(closure, block["y"], accepted, flow.largest, options.derivatives, options.rotation, lanes)
    kept = choose(accepted, next_flow, flow)
    here = choose(accepted, network, here)
    return Flow(largest, kept.guess1, kept.guess2, kept.drift1, kept.drift2), here


@formula
def finish(block, point, flow, here, moved, closure, options, slide, rule, lanes):
    """End values of all lanes into `block.ends`; what has been given as stress is met exactly.

    `moved` says that the unknowns have changed since the network `here` was found: by the return to the cone, or by the
    last pass over an implicit stage.
    """
    p, t1, t2 = read(block["y"], 0, lanes), read(block["y"], 1, lanes), read(block["y"], 2, lanes)
    xx, yy, xy = components(p, t1, t2)
    if options.mixed:
        stressed, given = stressed_components(block["inputs"], lanes), increment_of(block["inputs"], options, lanes)
        xx = choose(stressed[0], read(block["inputs"], IN_STRESS, lanes) + given[0], xx)
        yy = choose(stressed[1], read(block["inputs"], IN_STRESS + 1, lanes) + given[1], yy)
        xy = choose(stressed[2], read(block["inputs"], IN_STRESS + 2, lanes) + given[2], xy)
    solved = p == p
    if moved:
        p, t1, t2 = -0.5 * (xx + yy), -0.5 * (xx - yy), -xy
        inverse, turns = 1.0 / p, 1.0 if options.rotation else 0.0
        stress = (p, inverse, t1 * inverse, turns * t2 * inverse, flow.largest)
        unknown = (read(block["y"], 3, lanes), read(block["y"], 4, lanes), read(block["y"], 5, lanes))
        guess = (flow.guess1, flow.guess2)
        solved, here, _ = network_at(
            closure, point, stress, unknown, guess, False, here, rule, block["inputs"], lanes
        )
    end_values(
        closure, block["inputs"], block["ends"], point, (xx, yy, xy), here, block["y"], block["sums"], flow.largest,
        options.rotation, rule, lanes,
    )
    if options.sliding:
        for lane in range(len(lanes)):
            kappa = slide["kappa"][0, lane]
            gamma = plastic_shear_strain(kappa, slide["reference"][0, lane], slide["exponent"][0, lane])
            block["ends"][M_KAPPA, lane], block["ends"][M_GAMMA, lane] = kappa, gamma
            block["ends"][M_GAMMA + 1, lane] += slide["volume"][0, lane]
            block["ends"][M_GAMMA + 2, lane] += slide["work"][0, lane]
    write(block["solved"], 0, choose(solved, 1.0 + 0.0 * p, 0.0 * p), lanes)


@formula
def advance_points(first, end, lanes, block, call, closure, options, numerics, scheme, rule, slide):
    """`update_points` with its arrays at hand: records `block` and `slide`."""
    a, b, error = scheme
    width, kind = len(lanes), numerics.tangent_kind
    moved = options.sliding or a[a.shape[0] - 1, a.shape[0] - 1] != 0.0
    point_of, last = block["point_of"], block["last"]
    fill_idle(block)
    tolerance = ROUNDING
    if numerics.substeps == 0:
        tolerance = max(ROUNDING, SHARE_OF_TOLERANCE * numerics.tolerance)
    point, micro, here, stress, largest = load(block["inputs"], options, lanes)
    zero = 0.0 * largest
    flow = Flow(largest, zero, zero, zero, zero)
    following, active = first, 0
    while following < end or active > 0:
        if following < end and active <= max(width - 2, 0):
            # lanes without a point take the next ones, two at a time or more: that costs as much as a stage
            for lane in range(width):
                while point_of[lane] < 0 and following < end:
                    if take_next(call, block, lane, following, options, kind, slide):
                        point_of[lane] = following
                        active += 1
                        block["fresh"][0, lane], block["time"][0, lane] = 1.0, 0.0
                        block["step"][0, lane] = 1.0 / max(numerics.substeps, 1)
                    following += 1
            point, micro, start, stress, largest = load(block["inputs"], options, lanes)
            fresh = read(block["fresh"], 0, lanes) > 0.5
            here = choose(fresh, start, here)
            flow = choose(fresh, Flow(largest, zero, zero, zero, zero), flow)
            begin(block, stress, unknowns(closure, point, stress, micro), fresh, lanes)
            if active == 0:
                break
        final = True
        for lane in range(width):
            if point_of[lane] >= 0:
                last[lane] = plan(block, lane, point_of[lane], call, options, numerics, slide)
                final = final and last[lane] > 0
        stressed, given = stressed_components(block["inputs"], lanes), increment_of(block["inputs"], options, lanes)
        network, stiffness, next_flow = attempt_substep(
            block, (a, b), tolerance, point, given, stressed, flow, here, final, closure, options, slide, rule, lanes
        )
        estimate_error(
            block, closure, error, numerics.tolerance, here.z, stiffness, options, point.floor, slide, lanes
        )
        arrived = False
        for lane in range(width):
            block["fresh"][0, lane], block["accepted"][0, lane] = 0.0, 0.0
            if point_of[lane] >= 0:
                judge(block, lane, point_of[lane], last[lane] > 0, call, options, numerics, slide)
                arrived = arrived or (last[lane] > 0 and block["accepted"][0, lane] > 0.5)
        flow, here = accept(block, flow, here, network, next_flow, final, closure, options, b, slide, lanes)
        if arrived:
            finish(block, point, flow, here, moved, closure, options, slide, rule, lanes)
        for lane in range(width):
            number = point_of[lane]
            if number < 0:
                continue
            accepted = block["accepted"][0, lane] > 0.5
            if accepted:
                block["time"][0, lane] += block["step"][0, lane]
                go_on(block, lane, number, last[lane] > 0, call, options, numerics, slide)
                if last[lane] > 0 and block["solved"][0, lane] < 0.5:
                    call.status[number] = NOT_CONVERGED
            if call.status[number] > LIMITED:
                keep_start(call, number)
            elif accepted and last[lane] > 0:
                sound = put_ends(call, block, lane, number, options)
                if sound and kind == TANGENT_PROPAGATED:
                    put_propagated_tangent(block["y"], lane, call.tangent[number])
                elif sound and kind == TANGENT_CONTINUUM:
                    put_continuum_tangent(call, block, lane, number, options, slide)
            else:
                continue
            point_of[lane] = -1
            active -= 1
    split_changes(first, end, call, block, closure, options, rule, lanes)


@compiled(nogil=True, fastmath={"contract"})
def update_points(first, end, lanes, call, closure, options, numerics, scheme, rule):
    """Advance the points from `first` up to, not including, `end`.

    Runs without the interpreter's lock, so that threads can share a batch; a point's result does not depend on how.

    Parameters
    ----------
    first, end : int
    lanes : tuple
        `eight.LANES`, or `eight.ONE_LANE`.
    call : Call
    closure : named tuple
        See `network.closures`.
    options : Options
    numerics : Numerics
    scheme : tuple of ndarray
        a, b and error weights of the Runge-Kutta pair.
    rule : tuple of ndarray
        Gauss-Legendre nodes and weights; cosines and sines of the circle, cosines of half of it; classes of
        `network.slip_memory`.
    """
    blocks, slides = np.zeros(1, BLOCK), np.zeros(1, SLIDE)
    advance_points(first, end, lanes, blocks[0], call, closure, options, numerics, scheme, rule, slides[0])
    # what has been allocated is not given back before here
    return len(blocks) + len(slides)


@compiled()
def smallest_step_factor(status, counts, comfortable):
    """Step factor to propose: a quarter after a failure, else from 2 down to 1 the more substeps a point took."""
    factor = 2.0
    for point in range(status.shape[0]):
        if status[point] > LIMITED:
            return 0.25
        if counts[point, 0] > comfortable:
            factor = min(factor, max(1.0, 2.0 * math.sqrt(comfortable / counts[point, 0])))
    return factor
