"""Settling of frictionless disks under a pressure: motion with a small drag until it is at rest.

A packing near the onset of rigidity comes to rest through a long sequence of rearrangements, each a slow fall along a
valley that is soft in one direction and stiff in all others. Methods that stop the motion whenever it goes uphill
(`relaxation`) lose the momentum along the valley at every collision elsewhere. Here inertia is kept, and a drag so
small that hardly any mode is overdamped takes the energy out: from a start near its pressure the same packings in a
half to a quarter of the steps, the more so the larger they are (`docs/guide/packings.md`).

Units: mean diameter, normal stiffness and particle mass are 1. The cell's three strain rates are velocities of their
own, with the mass of half of all disks.
"""

from __future__ import annotations

from collections.abc import Callable
from math import log, sqrt
from time import perf_counter

import numpy as np
from numba import prange
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import number, whole
from granfabric.dem_ref.compilation import compiled
from granfabric.dem_ref.sample.neighbours import find_near_pairs, most_neighbours
from granfabric.dem_ref.threads import Faster, two_threads

from .relaxation import CONTACT_FORCE, CONTACTS, LARGEST_STEP, TRAVEL, UNBALANCED, Relaxed, into_cell, movable

DRAG = 0.0015
"""A step multiplies free velocities by ``(1 - drag)/(1 + drag)``. A third of it leaves the disks in motion for ever,
since integration heats the fastest modes; twice or four times as much takes up to twice the steps, and leaves disks
that carry nothing in touch with their neighbours."""
CELL_MASS = 0.5
"""Of the cell, over that of all disks."""
FIRST_SKIN, LEAST_SKIN, LARGEST_SKIN = 0.1, 0.02, 0.4
HOT, HEATED, LARGEST_DRAG = 1.0, 2000, 0.1
"""Unbalanced force above which, every so many steps, the drag is doubled: impacts of disks with six contacts each feed
the fastest modes, so that equal disks in rows would never come to rest. Packings without order stay below."""
STEPS = 200
"""Between two looks at whether the disks are at rest."""
SQUARES = 10
"""Steps between two sums of squared forces; the other steps are spared it."""
REPORTED = 5_000_000
"""Disks times steps between two reports: about a twentieth of a second."""

_FAST = {"contract", "nsz", "nnan", "arcp"}  # no reassociation: the order of summation stays as written


@compiled(fastmath=_FAST)
def _pair_forces(position, radius, first, second, code, shift, force, sums):
    """Forces of the given pairs added to `force`; stress x area, sum of overlaps and contacts go to `sums`."""
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
    sums[0] = sxx
    sums[1] = syy
    sums[2] = sxy
    sums[3] = total
    sums[4] = contacts


@compiled(fastmath=_FAST)
def _add(force, other):
    """Move what `other` holds to `force`."""
    for m in range(force.shape[0]):
        force[m] += other[m]
        other[m] = 0.0


@compiled(fastmath=_FAST)
def _sum_of_squares(force):
    square = 0.0
    for m in range(force.shape[0]):
        square += force[m] * force[m]
    return square


@compiled(fastmath=_FAST)
def _speed_up(velocity, force, keep, push):
    """Change velocities by forces and clear these."""
    for m in range(velocity.shape[0]):
        velocity[m] = keep * velocity[m] + push * force[m]
        force[m] = 0.0


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


def _settling_steps(
    steps, position, velocity, radius, cell, cell_velocity, first, second, code, force, pressure, room, dt, drag, out
):
    """Steps until `steps` are done or two disks may have come closer than the skin; returns the steps done.

    Pairs and disks are worked on in two halves whatever the number of threads, so that one and two threads add in the
    same order. Pairs are sorted by their first disk, which is the one with the smaller number: those of the second half
    touch disks of that half only, whose forces therefore are in two arrays.
    """
    n = position.shape[0]
    half = n // 2
    cut = np.searchsorted(first, half)
    shift = np.empty((9, 2))
    cell_mass = CELL_MASS * n
    keep = (1.0 - drag) / (1.0 + drag)
    push = dt / (1.0 + drag)
    sums = np.zeros((2, 16))  # a row is two cache lines, so that threads do not share one
    squares = np.zeros((2, 16))
    travel = 0.0
    done = 0
    while done < steps and travel < room:
        for s in range(9):
            ia = s // 3 - 1
            ib = s % 3 - 1
            shift[s, 0] = ia * cell[0, 0] + ib * cell[1, 0]
            shift[s, 1] = ia * cell[0, 1] + ib * cell[1, 1]
        for part in prange(2):
            begin, end = (0, cut) if part == 0 else (cut, first.shape[0])
            _pair_forces(
                position, radius, first[begin:end], second[begin:end], code[begin:end], shift, force[part], sums[part]
            )
        area = cell[0, 0] * cell[1, 1] - cell[0, 1] * cell[1, 0]
        sxx = sums[0, 0] + sums[1, 0]
        syy = sums[0, 1] + sums[1, 1]
        sxy = sums[0, 2] + sums[1, 2]
        cell_velocity[0] = keep * cell_velocity[0] + push * (sxx - pressure * area) / cell_mass
        cell_velocity[1] = keep * cell_velocity[1] + push * (syy - pressure * area) / cell_mass
        cell_velocity[2] = keep * cell_velocity[2] + push * sxy / cell_mass
        exx = cell_velocity[0] * dt
        eyy = cell_velocity[1] * dt
        exy = cell_velocity[2] * dt
        for part in prange(2):
            begin, end = (0, half) if part == 0 else (half, n)
            own = force[0, 2 * begin : 2 * end]
            if part == 1:
                _add(own, force[1, 2 * begin : 2 * end])
            if done % SQUARES == 0:
                squares[part, 0] = _sum_of_squares(own)
            moving = velocity[2 * begin : 2 * end]
            _speed_up(moving, own, keep, push)
            squares[part, 1] = _move(position[begin:end], moving, dt, exx, eyy, exy)
        for s in range(2):
            x = cell[s, 0]
            y = cell[s, 1]
            cell[s, 0] = x + exx * x + exy * y
            cell[s, 1] = y + exy * x + eyy * y
        fastest = sqrt(max(squares[0, 1], squares[1, 1]))
        travel += 2.0 * dt * fastest + 1.5 * (abs(exx) + abs(eyy) + 2.0 * abs(exy))
        done += 1
        contacts = sums[0, 4] + sums[1, 4]
        out[0] = sxx / area
        out[1] = syy / area
        out[2] = sxy / area
        out[UNBALANCED] = sqrt((squares[0, 0] + squares[1, 0]) / n)
        out[CONTACT_FORCE] = (sums[0, 3] + sums[1, 3]) / max(contacts, 1.0)
        out[CONTACTS] = contacts
    out[TRAVEL] = travel
    return done


_settle = compiled(fastmath=_FAST)(_settling_steps)
_settle_two_threads = compiled(fastmath=_FAST, parallel=True)(_settling_steps)


def settle(
    position: NDArray[np.float64],
    radius: NDArray[np.float64],
    cell: NDArray[np.float64],
    pressure: float,
    tolerance: float = 2e-5,
    steps: int = 400_000,
    drag: float = DRAG,
    threads: int | None = None,
    progress: Callable[[float, float], None] | None = None,
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
    threads : int, optional
        1 or 2; the result is the same to the last bit. Whichever is faster if not given (`Faster`).
    progress : callable, optional
        Called now and then with a fraction between 0 and 1 and the unbalanced force over the mean contact force.

    Raises
    ------
    SampleError
        If an array has another shape or kind, cannot be written, or a number is out of bounds.
    CellTooSmallError
    """
    position, radius, cell = movable(position, radius, cell)
    n = len(radius)
    pressure = number("pressure", pressure, 1e-300, 1e3)
    tolerance = number("tolerance", tolerance, 0.0, 1e3)
    drag = number("drag", drag, 0.0, 0.5)
    steps = whole("steps", steps, 1)
    threads = None if threads is None else whole("threads", threads, 1, 2)
    velocity, force, cell_velocity = np.zeros(2 * n), np.zeros((2, 2 * n)), np.zeros(3)
    step = LARGEST_STEP * sqrt(6.0 / most_neighbours(radius))
    wanted = np.array([pressure, pressure, 0.0])
    out = np.zeros(7)
    done, width, settled = 0, FIRST_SKIN, False
    look, told, reached = HEATED, 0, 0.0
    faster = Faster(n)
    while done < steps and not settled:
        into_cell(position, cell)
        pairs = find_near_pairs(position, radius, cell, width)
        code = ((pairs.image[:, 0] + 1) * 3 + pairs.image[:, 1] + 1).astype(np.uint8)
        started, room = done, width
        while room > 0.0 and done < steps and not settled:
            with two_threads((threads or faster.choose()) == 2) as both:
                start = perf_counter()
                taken = (_settle_two_threads if both else _settle)(
                    min(STEPS, steps - done), position, velocity, radius, cell, cell_velocity, pairs.first,
                    pairs.second, code, force, pressure, room, step, drag, out,
                )  # fmt: skip
                faster.tell(2 if both else 1, taken, perf_counter() - start)
            done += taken
            room -= out[TRAVEL]
            unbalanced = float(out[UNBALANCED] / max(out[CONTACT_FORCE], 1e-300))
            calm = out[CONTACT_FORCE] > 0.0 and unbalanced <= tolerance
            settled = calm and bool(np.abs(out[:3] - wanted).max() <= tolerance * pressure)
            if progress is not None and (done - told) * n >= REPORTED:
                told, reached = done, max(reached, _way_to(unbalanced, tolerance))
                progress(reached, unbalanced)
        if done >= look:
            look = done + HEATED
            if unbalanced > HOT:
                drag = min(max(2.0 * drag, DRAG), max(drag, LARGEST_DRAG))
        lasted = done - started
        if lasted < 20:
            width = min(LARGEST_SKIN, 1.5 * width)
        elif lasted > 200:
            width = max(LEAST_SKIN, width / 1.5)
    return Relaxed(done, settled, out[:3].copy(), unbalanced, int(out[CONTACTS]))


def _way_to(unbalanced: float, tolerance: float) -> float:
    """How far it has come from forces out of balance by themselves, by orders of magnitude."""
    if not 0.0 < tolerance < 1.0 or unbalanced <= tolerance:
        return 1.0
    return max(0.0, log(unbalanced) / log(tolerance)) if unbalanced < 1.0 else 0.0
