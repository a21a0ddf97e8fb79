"""Compiled steps of the motion; what they do and why is told in `motion`.

Inside compiled code stresses and strains are tension positive, order xx, yy, xy (tensor shear strain).
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import prange

from granfabric.dem_ref.compilation import compiled

# indices of the tally (energies since the start of the motion) and of the measures of the last step
WORK, FRICTION_HEAT, DRAG_HEAT = range(3)
STRESS_XX, STRESS_YY, STRESS_XY, UNBALANCED, NORMAL_FORCE, CONTACTS, TRAVEL, FASTEST = range(8)

CARRYING = 3
"""Contacts from which on a disk is dragged, see `motion`."""

_FAST = {"contract", "nsz", "nnan", "arcp"}  # no reassociation: the order of summation stays as written


@compiled(fastmath=_FAST)
def refresh_contacts(
    position, radius, cell, rate, velocity, first, second, image, tangential, margin, active_first, active_second,
    branch, source,
):  # fmt: skip
    """Exact geometry of all pairs with a gap below `margin`; returns their number.

    `branch` rows: unit normal (2), length, overlap, tangential elongation. Overlaps are those *before* the displacement
    of the last step, because the next step begins by adding it.
    """
    m = 0
    lxx, lyy, lxy = rate[0], rate[1], rate[2]
    for k in range(first.shape[0]):
        i = first[k]
        j = second[k]
        qa = float(image[k, 0])
        qb = float(image[k, 1])
        dx = position[j, 0] - position[i, 0] + qa * cell[0, 0] + qb * cell[1, 0]
        dy = position[j, 1] - position[i, 1] + qa * cell[0, 1] + qb * cell[1, 1]
        reach = radius[i] + radius[j]
        limit = reach + margin
        d2 = dx * dx + dy * dy
        if d2 < limit * limit:
            d = sqrt(d2)
            nx = dx / d
            ny = dy / d
            ux = velocity[j, 0] - velocity[i, 0] + d * (lxx * nx + lxy * ny)
            uy = velocity[j, 1] - velocity[i, 1] + d * (lxy * nx + lyy * ny)
            active_first[m] = i
            active_second[m] = j
            branch[m, 0] = nx
            branch[m, 1] = ny
            branch[m, 2] = d
            branch[m, 3] = reach - d + (nx * ux + ny * uy)
            branch[m, 4] = tangential[k]
            source[m] = k
            m += 1
    return m


@compiled()
def write_back(tangential, source, branch, count):
    """Put the tangential elongation of active pairs back into the list of near pairs."""
    for k in range(tangential.shape[0]):
        tangential[k] = 0.0
    for m in range(count):
        tangential[source[m]] = branch[m, 4]


@compiled(fastmath=_FAST)
def _contact_forces(first, second, branch, velocity, rate, force, kn, kt, friction, sums):
    """Forces of the given contacts added to `force`; their part of stress x area and of slip goes to `sums`.

    The last column of `force` counts the contacts of each particle.

    Loops run from zero over slices: only then the compiler knows that no index is negative (a sixth of the time).
    """
    lxx, lyy, lxy = rate[0], rate[1], rate[2]
    limit = friction * kn / kt
    sxx = 0.0
    syy = 0.0
    sxy = 0.0
    slip = 0.0
    for k in range(first.shape[0]):
        i = first[k]
        j = second[k]
        nx = branch[k, 0]
        ny = branch[k, 1]
        d = branch[k, 2]
        ux = velocity[j, 0] - velocity[i, 0] + d * (lxx * nx + lxy * ny)
        uy = velocity[j, 1] - velocity[i, 1] + d * (lxy * nx + lyy * ny)
        overlap = branch[k, 3] - (nx * ux + ny * uy)
        branch[k, 3] = overlap
        touching = 1.0 if overlap > 0.0 else 0.0
        overlap = overlap if overlap > 0.0 else 0.0
        trial = branch[k, 4] + (nx * uy - ny * ux) - (velocity[i, 2] + velocity[j, 2])
        # Coulomb's limit also empties the spring of a pair that does not touch
        cap = limit * overlap
        elongation = trial if trial < cap else cap
        elongation = elongation if elongation > -cap else -cap
        branch[k, 4] = elongation
        slip += elongation * (trial - elongation)
        normal = kn * overlap
        shear = kt * elongation
        fx = -normal * nx - shear * ny
        fy = -normal * ny + shear * nx
        force[i, 0] += fx
        force[i, 1] += fy
        force[i, 2] += shear
        force[i, 3] += touching
        force[j, 0] -= fx
        force[j, 1] -= fy
        force[j, 2] += shear
        force[j, 3] += touching
        fx *= d
        fy *= d
        sxx += fx * nx
        syy += fy * ny
        sxy += 0.5 * (fx * ny + fy * nx)
    sums[0] = sxx
    sums[1] = syy
    sums[2] = sxy
    sums[3] = slip


@compiled(fastmath=_FAST)
def _move(velocity, force, other_force, position, rate, damping, impulse, sums):
    """Move the given particles by one step and clear their forces; squares for the measures go to `sums`.

    Velocities change by force times `impulse` where nothing is dragged.
    """
    exx, eyy, exy = rate[0], rate[1], rate[2]
    dragged_keep = (1.0 - damping) / (1.0 + damping)
    dragged_push = impulse / (1.0 + damping)
    unbalanced = 0.0
    speed = 0.0
    drag = 0.0
    for i in range(velocity.shape[0]):
        fx = force[i, 0] + other_force[i, 0]
        fy = force[i, 1] + other_force[i, 1]
        u0 = velocity[i, 0]
        v0 = velocity[i, 1]
        w0 = velocity[i, 2]
        dragged = force[i, 3] + other_force[i, 3] >= CARRYING
        keep = dragged_keep if dragged else 1.0
        push = dragged_push if dragged else impulse
        u1 = keep * u0 + push * fx
        v1 = keep * v0 + push * fy
        w1 = keep * w0 + push * (force[i, 2] + other_force[i, 2])
        velocity[i, 0] = u1
        velocity[i, 1] = v1
        velocity[i, 2] = w1
        for c in range(4):
            force[i, c] = 0.0
            other_force[i, c] = 0.0
        unbalanced += fx * fx + fy * fy
        square = u1 * u1 + v1 * v1
        speed = square if square > speed else speed
        braked = (u0 + u1) * (u0 + u1) + (v0 + v1) * (v0 + v1) + (w0 + w1) * (w0 + w1)
        drag += braked if dragged else 0.0
        x = position[i, 0]
        y = position[i, 1]
        position[i, 0] = x + u1 + exx * x + exy * y
        position[i, 1] = y + v1 + exy * x + eyy * y
    sums[0] = unbalanced
    sums[1] = speed
    sums[2] = drag


def _steps(
    steps, room, longest, count, first, second, branch, velocity, force, position, cell, rate, strain, stress, target,
    target_rate, drive, gain, fastest_rate, kn, kt, friction, step, damping, tally, out, taken,
):  # fmt: skip
    """Step until `steps` are done or a pair may have moved by `room`; `taken` receives the steps done.

    Every step: contact forces, Love-Weber stress, strain rate ``drive + gain (target - stress)``, motion. Contacts and
    particles are worked on in two halves whatever the number of threads, each half with its own array of forces, so
    that one and two threads add in the same order.
    """
    n = position.shape[0]
    impulse = step * step / kn
    heat = 0.5 * damping * kn / (step * step)
    sums = np.zeros((2, 16))  # a row is two cache lines, so that threads do not share one
    squares = np.zeros((2, 16))
    travel = 0.0
    fastest = 0.0
    done = 0
    while done < steps and travel < room:
        for part in prange(2):
            begin, end = part * count // 2, (part + 1) * count // 2
            _contact_forces(
                first[begin:end], second[begin:end], branch[begin:end], velocity, rate, force[part], kn, kt, friction,
                sums[part],
            )  # fmt: skip
        lxx, lyy, lxy = rate[0], rate[1], rate[2]
        area = cell[0, 0] * cell[1, 1] - cell[0, 1] * cell[1, 0]
        sxx = (sums[0, 0] + sums[1, 0]) / area
        syy = (sums[0, 1] + sums[1, 1]) / area
        sxy = (sums[0, 2] + sums[1, 2]) / area
        tally[WORK] += 0.5 * area * ((sxx + stress[0]) * lxx + (syy + stress[1]) * lyy + 2.0 * (sxy + stress[2]) * lxy)
        tally[FRICTION_HEAT] += kt * (sums[0, 3] + sums[1, 3])
        stress[0] = sxx
        stress[1] = syy
        stress[2] = sxy
        for c in range(3):
            target[c] += target_rate[c]
        lxx = target[0] - sxx
        lyy = target[1] - syy
        lxy = target[2] - sxy
        exx = drive[0] + gain[0, 0] * lxx + gain[0, 1] * lyy + gain[0, 2] * lxy
        eyy = drive[1] + gain[1, 0] * lxx + gain[1, 1] * lyy + gain[1, 2] * lxy
        exy = drive[2] + gain[2, 0] * lxx + gain[2, 1] * lyy + gain[2, 2] * lxy
        size = sqrt(exx * exx + eyy * eyy + 2.0 * exy * exy)
        if size > fastest_rate:
            scale = fastest_rate / size
            exx *= scale
            eyy *= scale
            exy *= scale
            size = fastest_rate
        rate[0] = exx
        rate[1] = eyy
        rate[2] = exy
        strain[0] += exx
        strain[1] += eyy
        strain[2] += exy
        for part in prange(2):
            begin, end = part * n // 2, (part + 1) * n // 2
            _move(
                velocity[begin:end], force[0, begin:end], force[1, begin:end], position[begin:end], rate, damping,
                impulse, squares[part],
            )  # fmt: skip
        for s in range(2):
            x = cell[s, 0]
            y = cell[s, 1]
            cell[s, 0] = x + exx * x + exy * y
            cell[s, 1] = y + exy * x + eyy * y
        tally[DRAG_HEAT] += heat * (squares[0, 2] + squares[1, 2])
        fastest = sqrt(max(squares[0, 1], squares[1, 1]))
        travel += 2.0 * fastest + size * longest
        done += 1
        out[UNBALANCED] = sqrt((squares[0, 0] + squares[1, 0]) / n)
    contacts = 0
    total = 0.0
    for k in range(count):
        if branch[k, 3] > 0.0:
            contacts += 1
            total += branch[k, 3]
    out[STRESS_XX] = stress[0]
    out[STRESS_YY] = stress[1]
    out[STRESS_XY] = stress[2]
    out[NORMAL_FORCE] = kn * total / max(contacts, 1)
    out[CONTACTS] = contacts
    out[TRAVEL] = travel
    out[FASTEST] = fastest
    # not returned: Ctrl-C comes after the call and before what it returns is kept
    taken[0] = done


advance = compiled(fastmath=_FAST)(_steps)
advance_two_threads = compiled(fastmath=_FAST, parallel=True)(_steps)
