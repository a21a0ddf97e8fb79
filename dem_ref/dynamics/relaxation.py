"""Relaxation of frictionless disks in a periodic cell to the minimum of their enthalpy, by the FIRE method.

The cell's three strain components are unknowns beside the positions, so that the relaxed packing carries an isotropic
stress in every component, not only on average. Units inside: mean diameter, normal stiffness and particle mass are 1.

FIRE: Bitzek, Koskinen, Gaehler, Moseler & Gumbsch, Phys. Rev. Lett. 97, 170201 (2006).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import SampleError, changed_in_place, disks, finite, number, whole
from granfabric.dem_ref.compilation import compiled
from granfabric.dem_ref.sample.neighbours import NearPairs, find_near_pairs, most_neighbours

LARGEST_STEP = 0.7  # in sqrt(m/kn); the stiffest frictionless mode (six contacts each) allows 2/sqrt(6) = 0.82;
# times sqrt(6/Z) where a disk can have Z > 6 contacts
SMALLEST_STEP = 0.02
FIRST_STEP = 0.2
STEP_GROWTH = 1.1
STEP_CUT = 0.5
MIXING = 0.1
MIXING_DECAY = 0.99
STEPS_BEFORE_GROWTH = 20  # 5, the usual choice, resets so often that it takes twice the steps here

# indices of the control array
STEP, MIX, DOWNHILL, LARGEST = 0, 1, 2, 3
# indices of the result array
STRESS_XX, STRESS_YY, STRESS_XY, UNBALANCED, CONTACT_FORCE, CONTACTS, TRAVEL = range(7)


@compiled(fastmath={"contract", "nsz", "nnan", "arcp"})
def _relax(
    steps,
    position,
    velocity,
    radius,
    cell,
    cell_velocity,
    first,
    second,
    code,
    force,
    pressure,
    room,
    fixed,
    control,
    out,
):
    """FIRE steps until `steps` are done or two disks may have come closer than the skin; returns the steps done."""
    n = position.shape[0]
    npairs = first.shape[0]
    shift = np.empty((9, 2))
    cell_mass = 0.5 * n
    travel = 0.0
    done = 0
    dt = control[STEP]
    mix = control[MIX]
    downhill = control[DOWNHILL]
    while done < steps and travel < room:
        for s in range(9):
            ia = s // 3 - 1
            ib = s % 3 - 1
            shift[s, 0] = ia * cell[0, 0] + ib * cell[1, 0]
            shift[s, 1] = ia * cell[0, 1] + ib * cell[1, 1]
        for i in range(n):
            force[i, 0] = 0.0
            force[i, 1] = 0.0
        sxx = 0.0
        syy = 0.0
        sxy = 0.0
        total = 0.0
        contacts = 0
        for k in range(npairs):
            i = first[k]
            j = second[k]
            s = code[k]
            dx = position[j, 0] - position[i, 0] + shift[s, 0]
            dy = position[j, 1] - position[i, 1] + shift[s, 1]
            reach = radius[i] + radius[j]
            d2 = dx * dx + dy * dy
            if d2 < reach * reach:
                d = sqrt(d2)
                normal = reach - d
                ratio = normal / d
                fx = ratio * dx
                fy = ratio * dy
                force[i, 0] -= fx
                force[i, 1] -= fy
                force[j, 0] += fx
                force[j, 1] += fy
                sxx += fx * dx
                syy += fy * dy
                sxy += fx * dy
                total += normal
                contacts += 1
        area = cell[0, 0] * cell[1, 1] - cell[0, 1] * cell[1, 0]
        gxx = 0.0
        gyy = 0.0
        gxy = 0.0
        if not fixed:
            gxx = sxx - pressure * area
            gyy = syy - pressure * area
            gxy = sxy
        # the cell's strain rate enters with its own mass; the shear component counts twice in every scalar product
        f2 = 0.0
        v2 = 0.0
        power = 0.0
        for i in range(n):
            f2 += force[i, 0] * force[i, 0] + force[i, 1] * force[i, 1]
            v2 += velocity[i, 0] * velocity[i, 0] + velocity[i, 1] * velocity[i, 1]
            power += force[i, 0] * velocity[i, 0] + force[i, 1] * velocity[i, 1]
        unbalanced = f2
        exx, eyy, exy = cell_velocity[0], cell_velocity[1], cell_velocity[2]
        f2 += (gxx * gxx + gyy * gyy + 2.0 * gxy * gxy) / cell_mass
        v2 += (exx * exx + eyy * eyy + 2.0 * exy * exy) * cell_mass
        power += gxx * exx + gyy * eyy + 2.0 * gxy * exy
        if power > 0.0:
            keep = 1.0 - mix
            turn = mix * sqrt(v2 / f2) if f2 > 0.0 else 0.0
            downhill += 1.0
            if downhill > STEPS_BEFORE_GROWTH:
                dt = min(dt * STEP_GROWTH, control[LARGEST])
                mix *= MIXING_DECAY
        else:
            keep = 0.0
            turn = 0.0
            if downhill > 0.0:
                dt = max(dt * STEP_CUT, SMALLEST_STEP)
            downhill = 0.0
            mix = MIXING
        push = turn + dt
        exx = keep * exx + push * gxx / cell_mass
        eyy = keep * eyy + push * gyy / cell_mass
        exy = keep * exy + push * gxy / cell_mass
        cell_velocity[0] = exx
        cell_velocity[1] = eyy
        cell_velocity[2] = exy
        exx *= dt
        eyy *= dt
        exy *= dt
        fastest = 0.0
        for i in range(n):
            ux = keep * velocity[i, 0] + push * force[i, 0]
            uy = keep * velocity[i, 1] + push * force[i, 1]
            velocity[i, 0] = ux
            velocity[i, 1] = uy
            u2 = ux * ux + uy * uy
            fastest = u2 if u2 > fastest else fastest
            x = position[i, 0]
            y = position[i, 1]
            position[i, 0] = x + dt * ux + exx * x + exy * y
            position[i, 1] = y + dt * uy + exy * x + eyy * y
        for s in range(2):
            x = cell[s, 0]
            y = cell[s, 1]
            cell[s, 0] = x + exx * x + exy * y
            cell[s, 1] = y + exy * x + eyy * y
        travel += 2.0 * dt * sqrt(fastest) + 1.5 * (abs(exx) + abs(eyy) + 2.0 * abs(exy))
        done += 1
        out[STRESS_XX] = sxx / area
        out[STRESS_YY] = syy / area
        out[STRESS_XY] = sxy / area
        out[UNBALANCED] = sqrt(unbalanced / n)
        out[CONTACT_FORCE] = total / max(contacts, 1)
        out[CONTACTS] = contacts
    control[STEP] = dt
    control[MIX] = mix
    control[DOWNHILL] = downhill
    out[TRAVEL] = travel
    return done


def into_cell(position: NDArray[np.float64], cell: NDArray[np.float64]) -> None:
    """Move disks in place by whole cell vectors to where both their coordinates in the cell are between 0 and 1.

    Column by column: products with matrices start the threads of linear algebra, which then spin beside the kernels.
    """
    (ax, ay), (bx, by) = cell
    area = ax * by - ay * bx
    if area == 0.0:
        return  # refused where neighbours are looked for
    x, y = position[:, 0], position[:, 1]
    a, b = np.floor((x * by - y * bx) / area), np.floor((y * ax - x * ay) / area)
    x -= a * ax + b * bx
    y -= a * ay + b * by


@dataclass
class Relaxed:
    """Outcome of a relaxation: steps used, whether the tolerance was met, and the last forces' measures."""

    steps: int
    converged: bool
    stress: NDArray[np.float64]
    unbalanced: float
    contacts: int


def movable(
    position: NDArray[np.float64], radius: NDArray[np.float64], cell: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Positions (n, 2), radii (n,) and cell (2, 2) as kernels need them that change the first and the last in place.

    Raises
    ------
    SampleError
        If an array has another shape or kind, cannot be written, shares memory with another, or a radius is not > 0.
    """
    n = len(disks(position, radius)[1])
    radius = finite("radius", radius, (n,))
    position = changed_in_place("position", position, (n, 2))
    cell = changed_in_place("cell", cell, (2, 2))
    if any(np.may_share_memory(*both) for both in ((position, cell), (position, radius), (cell, radius))):
        raise SampleError("position, cell and radius must be arrays of their own, but two of them share memory")
    if not n or not radius.min() > 0.0:
        raise SampleError("disks that come to rest need positive radii")
    return position, radius, cell


def relax(
    position: NDArray[np.float64],
    radius: NDArray[np.float64],
    cell: NDArray[np.float64],
    pressure: float,
    tolerance: float = 2e-5,
    steps: int = 200_000,
    fixed_cell: bool = False,
    skin: float = 0.3,
) -> Relaxed:
    """Relax positions and cell in place to a minimum of energy + pressure x area.

    Parameters
    ----------
    position, radius, cell
        Changed in place (cell included); positions are wrapped into the cell.
    pressure : float
        Target pressure over normal stiffness, compression positive.
    tolerance : float
        Root mean square of the resultant force on a particle over the mean contact force, and relative error of each
        stress component.
    fixed_cell : bool
        Keep the cell: ends as soon as no force is left or the tolerance is met.

    Raises
    ------
    SampleError
        If an array has another shape or kind, cannot be written, or a number is out of bounds.
    CellTooSmallError
    """
    position, radius, cell = movable(position, radius, cell)
    n = len(radius)
    pressure = number("pressure", pressure, 0.0, 1e3)
    tolerance = number("tolerance", tolerance, 0.0, 1e3)
    skin = number("skin", skin, 1e-6, 10.0)
    steps = whole("steps", steps, 0)
    fixed_cell = bool(fixed_cell)
    velocity = np.zeros((n, 2))
    force = np.zeros((n, 2))
    cell_velocity = np.zeros(3)
    control = np.array([FIRST_STEP, MIXING, 0.0, LARGEST_STEP * sqrt(6.0 / most_neighbours(radius))])
    out = np.zeros(7)
    done = 0
    pairs: NearPairs | None = None
    width = skin
    while done < steps:
        into_cell(position, cell)
        pairs = find_near_pairs(position, radius, cell, width)
        code = ((pairs.image[:, 0] + 1) * 3 + pairs.image[:, 1] + 1).astype(np.uint8)
        started = done
        room = width
        while room > 0.0 and done < steps:
            done += _relax(
                min(200, steps - done), position, velocity, radius, cell, cell_velocity, pairs.first, pairs.second,
                code, force, pressure, room, fixed_cell, control, out,
            )  # fmt: skip
            room -= out[TRAVEL]
            scale = out[CONTACT_FORCE]
            stress = out[:3].copy()
            balanced = out[UNBALANCED] <= tolerance * scale if scale > 0.0 else fixed_cell
            error = np.abs(stress - np.array([pressure, pressure, 0.0])).max()
            if balanced and (fixed_cell or error <= tolerance * pressure):
                return Relaxed(done, True, stress, float(out[UNBALANCED] / max(scale, 1e-300)), int(out[CONTACTS]))
        # a list that lasts for less than 20 steps is too thin, one that lasts for hundreds too thick
        lasted = done - started
        width = min(0.4, width * 1.5) if lasted < 20 else (max(0.02, width / 1.5) if lasted > 200 else width)
    return Relaxed(
        done, False, out[:3].copy(), float(out[UNBALANCED] / max(out[CONTACT_FORCE], 1e-300)), int(out[CONTACTS])
    )
