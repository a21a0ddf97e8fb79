"""Compiled steps of a specimen between two platens, under given forces on its disks; `specimen` tells what moves them.

The contacts are those of `dynamics.stepping`. Disks follow a homogeneous deformation without inertia and drag, as they
do in a periodic cell: along y that of the platens, along x the one given; else drag would carry a part of the load.
It is fixed at x = 0 and at y = 0, where the lower platen is. Platens are planes across y, numbered
0 (lower) and 1 (upper); a disk touches them with the same normal and tangential springs as another disk, with a
friction of their own.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from granfabric.dem_ref.compilation import compiled
from granfabric.dem_ref.dynamics.stepping import _FAST, CARRYING, _contact_forces, _move

# indices of the tally: energies since the start
FRICTION_HEAT, DRAG_HEAT, PLATEN_WORK, GIVEN_WORK, FOLLOWING_WORK = range(5)
# indices of the measures of the last step
UNBALANCED, NORMAL_FORCE, CONTACTS, TRAVEL = range(4)


@compiled(fastmath=_FAST)
def bounded_steps(
    steps, room, longest, count, first, second, branch, velocity, force, none, position, radius, given, held,
    wall_disk, wall_side, elongation, wall, wall_velocity, wall_target, wall_gain, fastest_wall, widening, wall_force,
    kn, kt, friction, wall_friction, step, damping, tally, out, taken,
):  # fmt: skip
    """Step until `steps` are done or a pair may have moved by `room`; `taken` receives the steps done.

    `given` forces act on the disks, those that are `held` (0 or 1) are dragged whatever they touch. A platen with a
    positive `wall_gain` moves by its gain times the excess of its force over `wall_target`, outwards, the others with
    their `wall_velocity`; `widening` is the homogeneous strain along x per step. `wall_force` rows: mean over the steps
    of the force of the disks on a platen, outwards and along x.
    """
    n = position.shape[0]
    rate = np.zeros(3)
    rate[0] = widening
    rate[1] = (wall_velocity[1] - wall_velocity[0]) / (wall[1] - wall[0])
    sums = np.zeros(4)
    squares = np.zeros(3)
    now = np.zeros((2, 2))
    mean = np.zeros((2, 2))
    impulse = step * step / kn
    heat = 0.5 * damping * kn / (step * step)
    limit = wall_friction * kn / kt
    travel = 0.0
    done = 0
    while done < steps and travel < room:
        _contact_forces(first[:count], second[:count], branch[:count], velocity, rate, force, kn, kt, friction, sums)
        slip = sums[3]
        now[:] = 0.0
        for k in range(wall_disk.shape[0]):
            i = wall_disk[k]
            side = wall_side[k]
            outwards = 1.0 if side == 1 else -1.0
            overlap = radius[i] - outwards * (wall[side] - position[i, 1])
            touching = overlap > 0.0
            overlap = max(overlap, 0.0)
            trial = elongation[k] + outwards * (velocity[i, 0] + rate[0] * position[i, 0]) - velocity[i, 2]
            cap = limit * overlap
            kept = min(max(trial, -cap), cap)
            elongation[k] = kept
            slip += kept * (trial - kept)
            normal = kn * overlap
            shear = kt * kept
            force[i, 0] -= outwards * shear
            force[i, 1] -= outwards * normal
            force[i, 2] += shear
            force[i, 3] += 1.0 if touching else 0.0
            now[side, 0] += normal
            now[side, 1] += outwards * shear
        tally[FRICTION_HEAT] += kt * slip
        fastest_platen = 0.0
        for side in range(2):
            outwards = 1.0 if side == 1 else -1.0
            if wall_gain[side] > 0.0:
                pace = wall_gain[side] * (now[side, 0] - wall_target[side])
                wall_velocity[side] = outwards * min(max(pace, -fastest_wall), fastest_wall)
            # the platen presses inwards with what presses it outwards
            tally[PLATEN_WORK] -= outwards * now[side, 0] * wall_velocity[side]
            wall[side] += wall_velocity[side]
            fastest_platen = max(fastest_platen, abs(wall_velocity[side]))
            mean[side, 0] += now[side, 0]
            mean[side, 1] += now[side, 1]
        rate[1] = (wall_velocity[1] - wall_velocity[0]) / (wall[1] - wall[0])
        work = 0.0
        following = 0.0
        for i in range(n):
            work += given[i, 0] * rate[0] * position[i, 0] + given[i, 1] * rate[1] * position[i, 1]
            force[i, 0] += given[i, 0]
            force[i, 1] += given[i, 1]
            force[i, 3] += CARRYING * held[i]
            following -= force[i, 0] * rate[0] * position[i, 0] + force[i, 1] * rate[1] * position[i, 1]
        _move(velocity, force, none, position, rate, damping, impulse, squares)
        for i in range(n):
            work += given[i, 0] * velocity[i, 0] + given[i, 1] * velocity[i, 1]
        tally[GIVEN_WORK] += work
        # resultants do no work on what a disk follows without inertia: that is lost, or won, by the method
        tally[FOLLOWING_WORK] += following
        tally[DRAG_HEAT] += heat * squares[2]
        travel += 2.0 * sqrt(squares[1]) + fastest_platen + longest * (abs(rate[0]) + abs(rate[1]))
        done += 1
    contacts = 0
    total = 0.0
    for k in range(count):
        if branch[k, 3] > 0.0:
            contacts += 1
            total += branch[k, 3]
    for side in range(2):
        wall_force[side, 0] = mean[side, 0] / max(done, 1)
        wall_force[side, 1] = mean[side, 1] / max(done, 1)
    out[UNBALANCED] = sqrt(squares[0] / n)
    out[NORMAL_FORCE] = kn * total / max(contacts, 1)
    out[CONTACTS] = contacts
    out[TRAVEL] = travel
    taken[0] = done
