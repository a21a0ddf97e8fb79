"""Settling of frictionless disks under a pressure: motion with a small drag until it is at rest.

A packing near the onset of rigidity comes to rest through a long sequence of rearrangements, each a slow fall along a
valley that is soft in one direction and stiff in all others. Methods that stop the motion whenever it goes uphill
(`relaxation`) lose the momentum along the valley at every collision elsewhere. Here inertia is kept, and a drag so
small that hardly any mode is overdamped takes the energy out: from a loose start the same packings in a half to a
quarter of the steps, the more so the larger they are (`docs/guide/packings.md`).

Units: mean diameter, normal stiffness and particle mass are 1. The cell's three strain rates are velocities of their
own, with the mass of half of all disks.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import SampleError, changed_in_place, disks, finite, number, whole
from granfabric.dem_ref.compilation import compiled
from granfabric.dem_ref.sample.neighbours import find_near_pairs, most_neighbours

from .relaxation import CONTACT_FORCE, CONTACTS, LARGEST_STEP, TRAVEL, UNBALANCED, Relaxed

DRAG = 0.002
"""A step multiplies free velocities by ``(1 - drag)/(1 + drag)``. A fourth of it leaves the disks in motion for ever,
since integration heats the fastest modes; twice or four times as much takes two to four times the steps."""
CELL_MASS = 0.5
"""Of the cell, over that of all disks."""
FIRST_SKIN, LEAST_SKIN, LARGEST_SKIN = 0.1, 0.02, 0.4
HOT, HEATED, LARGEST_DRAG = 1.0, 2000, 0.1
"""Unbalanced force above which, every so many steps, the drag is doubled: impacts of disks with six contacts each feed
the fastest modes, so that equal disks in rows would never come to rest. Packings without order stay below."""
STEPS = 200
"""Between two looks at whether the disks are at rest."""

_FAST = {"contract", "nsz", "nnan", "arcp", "reassoc"}  # one thread only: the order of summation is the compiler's


@compiled(fastmath=_FAST)
def _speed_up(velocity, force, keep, push):
    """Change velocities by forces and clear these; the sum of squared forces."""
    square = 0.0
    for m in range(velocity.shape[0]):
        f = force[m]
        velocity[m] = keep * velocity[m] + push * f
        square += f * f
        force[m] = 0.0
    return square


@compiled(fastmath=_FAST)
def _move(position, velocity, dt, exx, eyy, exy):
    """Move disks with the cell and on their own; the largest squared velocity."""
    fastest = 0.0
    for i in range(position.shape[0]):
        ux = velocity[2 * i]
        uy = velocity[2 * i + 1]
        square = ux * ux + uy * uy
        fastest = max(fastest, square)
        x = position[i, 0]
        y = position[i, 1]
        position[i, 0] = x + dt * ux + exx * x + exy * y
        position[i, 1] = y + dt * uy + exy * x + eyy * y
    return fastest


@compiled(fastmath={"contract", "nsz", "nnan", "arcp"})
def _settle(
    steps, position, velocity, radius, cell, cell_velocity, first, second, code, force, pressure, room, dt, drag, out
):
    """Steps until `steps` are done or two disks may have come closer than the skin; returns the steps done."""
    n = position.shape[0]
    shift = np.empty((9, 2))
    cell_mass = CELL_MASS * n
    keep = (1.0 - drag) / (1.0 + drag)
    push = dt / (1.0 + drag)
    travel = 0.0
    done = 0
    while done < steps and travel < room:
        for s in range(9):
            ia = s // 3 - 1
            ib = s % 3 - 1
            shift[s, 0] = ia * cell[0, 0] + ib * cell[1, 0]
            shift[s, 1] = ia * cell[0, 1] + ib * cell[1, 1]
        sxx = 0.0
        syy = 0.0
        sxy = 0.0
        total = 0.0
        contacts = 0
        for k in range(first.shape[0]):
            i = first[k]
            j = second[k]
            s = code[k]
            dx = position[j, 0] - position[i, 0] + shift[s, 0]
            dy = position[j, 1] - position[i, 1] + shift[s, 1]
            reach = radius[i] + radius[j]
            d2 = dx * dx + dy * dy
            if d2 < reach * reach:
                d = sqrt(d2)
                overlap = reach - d
                ratio = overlap / d
                fx = ratio * dx
                fy = ratio * dy
                force[2 * i] -= fx
                force[2 * i + 1] -= fy
                force[2 * j] += fx
                force[2 * j + 1] += fy
                sxx += fx * dx
                syy += fy * dy
                sxy += fx * dy
                total += overlap
                contacts += 1
        area = cell[0, 0] * cell[1, 1] - cell[0, 1] * cell[1, 0]
        cell_velocity[0] = keep * cell_velocity[0] + push * (sxx - pressure * area) / cell_mass
        cell_velocity[1] = keep * cell_velocity[1] + push * (syy - pressure * area) / cell_mass
        cell_velocity[2] = keep * cell_velocity[2] + push * sxy / cell_mass
        exx = cell_velocity[0] * dt
        eyy = cell_velocity[1] * dt
        exy = cell_velocity[2] * dt
        unbalanced = _speed_up(velocity, force, keep, push)
        fastest = _move(position, velocity, dt, exx, eyy, exy)
        for s in range(2):
            x = cell[s, 0]
            y = cell[s, 1]
            cell[s, 0] = x + exx * x + exy * y
            cell[s, 1] = y + exy * x + eyy * y
        travel += 2.0 * dt * sqrt(fastest) + 1.5 * (abs(exx) + abs(eyy) + 2.0 * abs(exy))
        done += 1
        out[0] = sxx / area
        out[1] = syy / area
        out[2] = sxy / area
        out[UNBALANCED] = sqrt(unbalanced / n)
        out[CONTACT_FORCE] = total / max(contacts, 1)
        out[CONTACTS] = contacts
    out[TRAVEL] = travel
    return done


def settle(
    position: NDArray[np.float64],
    radius: NDArray[np.float64],
    cell: NDArray[np.float64],
    pressure: float,
    tolerance: float = 2e-5,
    steps: int = 400_000,
    drag: float = DRAG,
) -> Relaxed:
    """Move disks and cell in place, from rest, until they are at rest under an isotropic pressure.

    Parameters
    ----------
    position, radius, cell
        Shapes (n, 2), (n,), (2, 2); changed in place (cell included), positions are wrapped into the cell.
    pressure : float
        Target pressure over normal stiffness, compression positive.
    tolerance : float
        Root mean square of the resultant force on a particle over the mean contact force, and relative error of each
        stress component.
    steps : int
        After which it gives up.
    drag : float
        See `DRAG`.

    Raises
    ------
    SampleError
        If an array has another shape or kind, cannot be written, or a number is out of bounds.
    CellTooSmallError
    """
    n = len(disks(position, radius)[1])
    radius = finite("radius", radius, (n,))
    position = changed_in_place("position", position, (n, 2))
    cell = changed_in_place("cell", cell, (2, 2))
    if any(np.may_share_memory(*both) for both in ((position, cell), (position, radius), (cell, radius))):
        raise SampleError("position, cell and radius must be arrays of their own, but two of them share memory")
    if not n or not radius.min() > 0.0:
        raise SampleError("disks that settle need positive radii")
    pressure = number("pressure", pressure, 1e-300, 1e3)
    tolerance = number("tolerance", tolerance, 0.0, 1e3)
    drag = number("drag", drag, 0.0, 0.5)
    steps = whole("steps", steps, 1)
    velocity, force, cell_velocity = np.zeros(2 * n), np.zeros(2 * n), np.zeros(3)
    step = LARGEST_STEP * sqrt(6.0 / most_neighbours(radius))
    wanted = np.array([pressure, pressure, 0.0])
    out = np.zeros(7)
    done, width, settled = 0, FIRST_SKIN, False
    look = HEATED
    while done < steps and not settled:
        position -= np.floor(position @ np.linalg.inv(cell)) @ cell
        pairs = find_near_pairs(position, radius, cell, width)
        code = ((pairs.image[:, 0] + 1) * 3 + pairs.image[:, 1] + 1).astype(np.uint8)
        started, room = done, width
        while room > 0.0 and done < steps and not settled:
            done += _settle(
                min(STEPS, steps - done), position, velocity, radius, cell, cell_velocity, pairs.first, pairs.second,
                code, force, pressure, room, step, drag, out,
            )  # fmt: skip
            room -= out[TRAVEL]
            calm = out[CONTACT_FORCE] > 0.0 and out[UNBALANCED] <= tolerance * out[CONTACT_FORCE]
            settled = calm and bool(np.abs(out[:3] - wanted).max() <= tolerance * pressure)
        if done >= look:
            look = done + HEATED
            if out[UNBALANCED] > HOT * out[CONTACT_FORCE]:
                drag = min(max(2.0 * drag, DRAG), max(drag, LARGEST_DRAG))
        lasted = done - started
        if lasted < 20:
            width = min(LARGEST_SKIN, 1.5 * width)
        elif lasted > 200:
            width = max(LEAST_SKIN, width / 1.5)
    unbalanced = float(out[UNBALANCED] / max(out[CONTACT_FORCE], 1e-300))
    return Relaxed(done, settled, out[:3].copy(), unbalanced, int(out[CONTACTS]))
