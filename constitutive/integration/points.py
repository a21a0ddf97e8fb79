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
from typing import NamedTuple

import numpy as np

from granfabric.constitutive.compilation import compiled, formula
from granfabric.constitutive.contract import Status
from granfabric.constitutive.lanes.eight import choose, read, write
from granfabric.constitutive.material_table import M_A1, M_A2, M_GAMMA, M_KAPPA, M_Z, MICRO
from granfabric.constitutive.network.closures import network_at, remember, split, unknowns
from granfabric.constitutive.network.point import (
    IN_CONTROL,
    IN_GIVEN,
    IN_STRESS,
    fill_at_rest,
    load,
    put_stiffness_of,
    reference_of,
    take_material,
    take_point,
)
from granfabric.constitutive.sliding.cone import plastic_shear_strain
from granfabric.constitutive.sliding.cone_return import plastic_tangent
from granfabric.constitutive.sliding.crossing import TAKEN_BACK, forget_crossing, judge_substep
from granfabric.constitutive.sliding.slide import SLIDE
from granfabric.constitutive.sliding.start import load_sliding
from granfabric.constitutive.sliding.substep import accept_sliding
from granfabric.constitutive.stiffness import components, strain_invariants

from .attempt import Flow, attempt_substep
from .block import BLOCK
from .end_values import end_values
from .implicit_stage import ROUNDING, SHARE_OF_TOLERANCE
from .runge_kutta import APEX_FRACTION, FAILED_STAGE_FACTOR, SMALLEST_SUBSTEP
from .stage import ADVANCED, COLUMNS, GAINED, RATES, UNKNOWNS
from .substep import estimate_error, step_factor, summed

OK = int(Status.OK)
LIMITED = int(Status.LIMITED)
NO_PRESSURE = int(Status.NO_PRESSURE)
TOO_MANY_SUBSTEPS = int(Status.TOO_MANY_SUBSTEPS)
NOT_CONVERGED = int(Status.NOT_CONVERGED)

TANGENT_NONE, TANGENT_PROPAGATED, TANGENT_CONTINUUM, TANGENT_ELASTIC = range(4)


class Call(NamedTuple):
    """Arrays of one call; see `law.ContactLaw`."""

    given: np.ndarray
    """Increments of strain, or of stress where `control` says so; (npt, 3)."""
    stress_start: np.ndarray
    state_start: np.ndarray
    stress_end: np.ndarray
    state_end: np.ndarray
    control: np.ndarray
    """1 where the increment is one of stress; (npt, 3), read only where stress may be given."""
    strain_increment: np.ndarray
    """Written where stress may be given; else (0, 3)."""
    tangent: np.ndarray
    """(npt, 3, 3), or (0, 3, 3) if none is wanted."""
    material_index: np.ndarray
    table: np.ndarray
    micro_of_column: np.ndarray
    status: np.ndarray
    counts: np.ndarray
    """Accepted and rejected substeps, evaluations of the rates; (npt, 3)."""


class Numerics(NamedTuple):
    """How a point is integrated."""

    tolerance: float
    substeps: int
    """Fixed number of substeps; 0 for error control."""
    most: int
    """Most substeps."""
    error_order: int
    tangent_kind: int


@formula
def fill_idle(block):
    """Numbers for lanes that have not held a point yet."""
    fill_at_rest(block["inputs"])
    for lane in range(block["inputs"].shape[1]):
        block["step"][0, lane] = 1.0
        block["point_of"][lane], block["material"][lane] = -1, -1


@formula
def keep_start(call, point):
    """End values of a point at rest or refused: its start values."""
    for i in range(3):
        call.stress_end[point, i] = call.stress_start[point, i]
        if call.strain_increment.shape[0] > 0:
            call.strain_increment[point, i] = 0.0
    for i in range(call.state_start.shape[1]):
        call.state_end[point, i] = call.state_start[point, i]


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
def take_next(call, block, lane, point, options, tangent_kind, slide):
    """Take a point into a lane; its status, and whether there is anything to advance."""
    inputs, par = block["inputs"], call.table[call.material_index[point]]
    if block["material"][lane] != call.material_index[point]:
        take_material(inputs, lane, par)
        block["material"][lane] = call.material_index[point]
    outcome = take_point(
        inputs, lane, point, call.given, call.stress_start, call.state_start, par, call.micro_of_column
    )
    if options.mixed:
        for i in range(3):
            inputs[IN_CONTROL + i, lane] = float(call.control[point, i])
    if options.sliding:
        if outcome <= LIMITED:
            stress = (inputs[IN_STRESS, lane], inputs[IN_STRESS + 1, lane], inputs[IN_STRESS + 2, lane])
            given = (inputs[IN_GIVEN, lane], inputs[IN_GIVEN + 1, lane], inputs[IN_GIVEN + 2, lane])
            control = (
                inputs[IN_CONTROL, lane] > 0.5,
                inputs[IN_CONTROL + 1, lane] > 0.5,
                inputs[IN_CONTROL + 2, lane] > 0.5,
            )
            outcome = load_sliding(slide, lane, inputs[M_KAPPA, lane], stress, par, given, control)
    if tangent_kind != TANGENT_NONE:
        if outcome == OK or outcome == NO_PRESSURE:
            z, a1, a2 = reference_of(inputs, lane, options.feedback)
            put_stiffness_of(par, z, a1, a2, options.isostatic, call.tangent[point])
        else:
            for i in range(3):
                for j in range(3):
                    call.tangent[point, i, j] = 0.0
    call.status[point] = outcome
    at_rest = call.given[point, 0] == 0.0 and call.given[point, 1] == 0.0 and call.given[point, 2] == 0.0
    if at_rest or outcome > LIMITED:
        keep_start(call, point)
        return False
    return True


@formula
def put_ends(call, block, lane, point, options):
    """Write the end values of a lane."""
    for i in range(3):
        call.stress_end[point, i] = block["ends"][MICRO + i, lane]
        if options.mixed:
            given = block["inputs"][IN_CONTROL + i, lane] < 0.5
            call.strain_increment[point, i] = call.given[point, i] if given else block["sums"][6 + i, lane]
    for i in range(call.state_start.shape[1]):
        call.state_end[point, i] = block["ends"][call.micro_of_column[i], lane]


@formula
def put_propagated_tangent(y, lane, out):
    """The derivatives of p, t by v, e_1, e_2 as those of stress by strain, xx, yy, engineering xy."""
    for column in range(COLUMNS):
        row = UNKNOWNS * (1 + column)
        p, t1, t2 = y[row, lane], y[row + 1, lane], y[row + 2, lane]
        # both signs turn over; v = -(e_xx + e_yy), e_1 = e_yy - e_xx
        xx, yy, xy = p + t1, p - t1, t2
        if column == 0:
            out[0, 0], out[1, 0], out[2, 0] = xx, yy, xy
            out[0, 1], out[1, 1], out[2, 1] = xx, yy, xy
        elif column == 1:
            out[0, 0], out[1, 0], out[2, 0] = out[0, 0] + xx, out[1, 0] + yy, out[2, 0] + xy
            out[0, 1], out[1, 1], out[2, 1] = out[0, 1] - xx, out[1, 1] - yy, out[2, 1] - xy
        else:
            out[0, 2], out[1, 2], out[2, 2] = xx, yy, xy


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
            for i in range(call.state_end.shape[1]):
                block["ends"][call.micro_of_column[i], lane] = call.state_end[point, i]
            for i in range(3):
                block["ends"][MICRO + i, lane] = call.stress_end[point, i]
        if not split(closure, block["inputs"], block["ends"], options, rule, lanes):
            return
        for lane in range(min(width, end - start)):
            point = start + lane
            if call.status[point] <= LIMITED and call.counts[point, 0] > 0:
                for i in range(call.state_end.shape[1]):
                    call.state_end[point, i] = block["ends"][call.micro_of_column[i], lane]


@formula
def put_continuum_tangent(call, block, lane, point, options, slide):
    """The tangent of the rate equations at the end of an increment."""
    z, a1, a2 = reference_of(block["inputs"], lane, False)
    if options.feedback:
        z, a1, a2 = block["ends"][M_Z, lane], block["ends"][M_A1, lane], block["ends"][M_A2, lane]
    put_stiffness_of(call.table[call.material_index[point]], z, a1, a2, options.isostatic, call.tangent[point])
    if options.sliding:
        plastic_tangent(block["y"], slide, lane, call.tangent[point])


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
def plan(block, lane, point, call, options, numerics, slide):
    """Cut a lane's substep to what is left of the increment; whether it is the last one."""
    remaining = 1.0 - block["time"][0, lane]
    fixed = numerics.substeps > 0
    # with sliding, crossings of the cone split the fixed substeps
    if fixed and not options.sliding:
        last = call.counts[point, 0] == numerics.substeps - 1
    else:
        last = block["step"][0, lane] >= remaining * (1.0 - 1e-12)
    if last and not fixed:
        block["step"][0, lane] = remaining
    if options.sliding:
        if slide["planned_step"][0, lane] == 0.0:
            slide["planned_step"][0, lane] = block["step"][0, lane]
    return last


@formula
def judge(block, lane, point, last, call, options, numerics, slide):
    """Accept a lane's substep, or shorten it, or give up."""
    counts, worst = call.counts[point], block["worst"][0, lane]
    fixed = numerics.substeps > 0
    counts[2] += int(block["evaluations"][0, lane])
    failed = worst > LIMITED
    if not failed and (fixed or block["measure"][0, lane] <= 1.0):
        if options.sliding:
            # so large is the increment in the invariants that derivatives are taken by
            xx, yy, xy = call.given[point, 0], call.given[point, 1], call.given[point, 2]
            largest = max(abs(xx + yy), abs(xx - yy), abs(xy))
            differentiate = options.derivatives and not last
            verdict, length = judge_substep(
                block["step"][0, lane], block["y"], block["trial"], largest, slide, lane, differentiate
            )
            if verdict == TAKEN_BACK:
                block["step"][0, lane] = length
                counts[1] += 1
                if counts[0] + counts[1] >= numerics.most:
                    call.status[point] = TOO_MANY_SUBSTEPS
                return
        block["accepted"][0, lane] = 1.0
        call.status[point] = max(call.status[point], int(worst))
        counts[0] += 1
        return
    counts[1] += 1
    if options.sliding:
        forget_crossing(slide, lane)
    factor = FAILED_STAGE_FACTOR
    if not failed:
        factor = step_factor(block["measure"][0, lane], numerics.error_order)
    block["step"][0, lane] *= factor
    shortest = block["step"][0, lane] < SMALLEST_SUBSTEP
    if fixed or shortest or counts[0] + counts[1] >= numerics.most:
        call.status[point] = TOO_MANY_SUBSTEPS
        if failed:
            call.status[point] = int(worst)
        lost = -0.5 * (block["inputs"][IN_STRESS, lane] + block["inputs"][IN_STRESS + 1, lane])
        if not fixed and shortest and block["y"][0, lane] < APEX_FRACTION * lost:
            call.status[point] = NO_PRESSURE


@formula
def go_on(block, lane, point, last, call, options, numerics, slide):
    """Length of the next substep after an accepted one, if that was not the last."""
    counts, length = call.counts[point], block["step"][0, lane]
    if not last:
        if counts[0] + counts[1] >= numerics.most:
            call.status[point] = TOO_MANY_SUBSTEPS
        elif numerics.substeps == 0:
            block["step"][0, lane] = length * step_factor(block["measure"][0, lane], numerics.error_order)
    if options.sliding:
        if not last and numerics.substeps > 0:
            planned, time = numerics.substeps, block["time"][0, lane]
            block["step"][0, lane] = (math.floor(time * planned + 1e-9) + 1.0) / planned - time
        elif not last and slide["crossed"][0, lane] > 0.5:
            block["step"][0, lane] = max(slide["whole_step"][0, lane] - length, SMALLEST_SUBSTEP)
        slide["planned_step"][0, lane] = 0.0
        if slide["crossed"][0, lane] > 0.5:
            forget_crossing(slide, lane)


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
def finish(block, point, flow, here, closure, options, slide, rule, lanes):
    """End values of all lanes into `block.ends`; what has been given as stress is met exactly."""
    p, t1, t2 = read(block["y"], 0, lanes), read(block["y"], 1, lanes), read(block["y"], 2, lanes)
    xx, yy, xy = components(p, t1, t2)
    if options.mixed:
        stressed, given = stressed_components(block["inputs"], lanes), increment_of(block["inputs"], options, lanes)
        xx = choose(stressed[0], read(block["inputs"], IN_STRESS, lanes) + given[0], xx)
        yy = choose(stressed[1], read(block["inputs"], IN_STRESS + 1, lanes) + given[1], yy)
        xy = choose(stressed[2], read(block["inputs"], IN_STRESS + 2, lanes) + given[2], xy)
    solved = p == p
    if options.sliding:
        # the return to the cone has moved the stress since the last stage
        p, t1, t2 = -0.5 * (xx + yy), -0.5 * (xx - yy), -xy
        inverse, turns = 1.0 / p, 1.0 if options.rotation else 0.0
        stress = (p, inverse, t1 * inverse, turns * t2 * inverse, flow.largest)
        unknown = (read(block["y"], 3, lanes), read(block["y"], 4, lanes), read(block["y"], 5, lanes))
        guess = (flow.guess1, flow.guess2)
        solved, here, _ = network_at(closure, point, stress, unknown, guess, False, here, rule)
    end_values(
        closure, block["inputs"], block["ends"], point, (xx, yy, xy), here, block["y"], block["sums"], flow.largest,
        options.rotation, lanes,
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
            finish(block, point, flow, here, closure, options, slide, rule, lanes)
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
                put_ends(call, block, lane, number, options)
                if kind == TANGENT_PROPAGATED:
                    put_propagated_tangent(block["y"], lane, call.tangent[number])
                elif kind == TANGENT_CONTINUUM:
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
        Gauss-Legendre nodes and weights; cosines and sines of the circle, cosines of half of it.
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
