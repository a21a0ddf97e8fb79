"""What happens to one lane of a block: taking a point, planning and judging its substep, giving it back."""

import math
from typing import NamedTuple

import numpy as np

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.contract import Status
from granfabric.constitutive.material_table import M_A1, M_A2, M_KAPPA, M_Z, MICRO
from granfabric.constitutive.network.point import (
    IN_CONTROL,
    IN_GIVEN,
    IN_STRESS,
    fill_at_rest,
    put_stiffness_of,
    reference_of,
    take_material,
    take_point,
)
from granfabric.constitutive.sliding.cone_return import plastic_tangent
from granfabric.constitutive.sliding.crossing import TAKEN_BACK, forget_crossing, judge_substep
from granfabric.constitutive.sliding.start import load_sliding

from .runge_kutta import APEX_FRACTION, FAILED_STAGE_FACTOR, SMALLEST_SUBSTEP
from .stage import COLUMNS, UNKNOWNS
from .substep import step_factor

OK = int(Status.OK)
LIMITED = int(Status.LIMITED)
NO_PRESSURE = int(Status.NO_PRESSURE)
TOO_MANY_SUBSTEPS = int(Status.TOO_MANY_SUBSTEPS)
NOT_FINITE = int(Status.NOT_FINITE)

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
    if options.sliding and outcome <= LIMITED:
        stress = (inputs[IN_STRESS, lane], inputs[IN_STRESS + 1, lane], inputs[IN_STRESS + 2, lane])
        given = (inputs[IN_GIVEN, lane], inputs[IN_GIVEN + 1, lane], inputs[IN_GIVEN + 2, lane])
        control = (
            inputs[IN_CONTROL, lane] > 0.5,
            inputs[IN_CONTROL + 1, lane] > 0.5,
            inputs[IN_CONTROL + 2, lane] > 0.5,
        )
        outcome = load_sliding(slide, lane, inputs[M_KAPPA, lane], stress, par, given, control)
    if tangent_kind != TANGENT_NONE:
        if outcome in (OK, NO_PRESSURE):
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
    if options.sliding and slide["planned_step"][0, lane] == 0.0:
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
def put_ends(call, block, lane, point, options):
    """Write the end values of a lane; False, and its start values, if one of them is not finite."""
    total = 0.0
    for i in range(3):
        call.stress_end[point, i] = block["ends"][MICRO + i, lane]
        total += call.stress_end[point, i]
        if options.mixed:
            given = block["inputs"][IN_CONTROL + i, lane] < 0.5
            call.strain_increment[point, i] = call.given[point, i] if given else block["sums"][6 + i, lane]
            total += call.strain_increment[point, i]
    for i in range(call.micro_of_column.shape[0]):
        call.state_end[point, i] = block["ends"][call.micro_of_column[i], lane]
        total += call.state_end[point, i]
    if not abs(total) < math.inf:
        # numbers of a size that no grains have: something overflowed on the way
        call.status[point] = NOT_FINITE
        keep_start(call, point)
        return False
    return True


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
def put_continuum_tangent(call, block, lane, point, options, slide):
    """The tangent of the rate equations at the end of an increment."""
    z, a1, a2 = reference_of(block["inputs"], lane, False)
    if options.feedback:
        z, a1, a2 = block["ends"][M_Z, lane], block["ends"][M_A1, lane], block["ends"][M_A2, lane]
    put_stiffness_of(call.table[call.material_index[point]], z, a1, a2, options.isostatic, call.tangent[point])
    if options.sliding:
        plastic_tangent(block["y"], slide, lane, call.tangent[point])
