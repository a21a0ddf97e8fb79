"""Motion of frictional disks in a deforming periodic cell: the compiled core of the DEM.

Per contact a linear normal spring (no tension), a linear tangential spring with history, and Coulomb's limit
``|ft| <= mu fn``. Particles follow the homogeneous deformation of the cell without inertia; what they move beyond it
has inertia and is damped by a drag proportional to that extra velocity. In the quasi-static limit neither mass nor drag
matters, so both are chosen for speed:

- every particle has the same mass m and the rotational inertia m r^2, the rotation being carried as the displacement of
  the surface. Then the stiffest possible mode (six contacts a particle, kt = kn) has ``omega^2 = 12 kn/m``. The step is
  given as the number ``step = dt sqrt(kn/m)``, critical at ``2/sqrt(12) = 0.577``; the default is 0.7 of that;
- the drag is the number ``damping``, so that ``v(+1/2) = ((1 - damping) v(-1/2) + F dt/m)/(1 + damping)``.

Displacements in a dense packing are far smaller than disks. Directions and lengths of branch vectors are therefore kept
from one *refresh* to the next and only the overlap and the tangential elongation are integrated in between; a refresh
computes them anew from the positions as soon as any pair may have moved by more than `refresh` mean diameters relative
to each other (default 2e-5, a fifth of the mean overlap at kn/p = 1e4): a direction is never off by more than 2e-5 rad
and an overlap by more than the square of that. (Likewise the lever arms of tangential forces are the radii, not the
radii less half the overlap.) Pairs that cannot touch before the next refresh are left out.

Inside compiled code stresses and strains are tension positive, order xx, yy, xy (tensor shear strain).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from dem_ref.compilation import compiled
from dem_ref.neighbours import NearPairs, find_near_pairs
from dem_ref.sample import Sample, SampleError

STEP = 0.4
DAMPING = 0.06
SKIN = 0.03
LARGEST_SKIN = 0.1
REFRESH = 2.0e-5

# indices of the tally (energies since the start of the motion) and of the measures of the last step
WORK, FRICTION_HEAT, DRAG_HEAT = range(3)
STRESS_XX, STRESS_YY, STRESS_XY, UNBALANCED, NORMAL_FORCE, CONTACTS, TRAVEL, FASTEST = range(8)

_FAST = {"contract", "nsz", "nnan", "arcp"}  # no reassociation: the order of summation stays as written


@compiled(fastmath=_FAST)
def _refresh(
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
def _write_back(tangential, source, branch, count):
    """Put the tangential elongation of active pairs back into the list of near pairs."""
    for k in range(tangential.shape[0]):
        tangential[k] = 0.0
    for m in range(count):
        tangential[source[m]] = branch[m, 4]


@compiled(fastmath=_FAST)
def _advance(
    steps, room, longest, count, first, second, branch, velocity, force, position, cell, rate, strain, stress, target,
    target_rate, drive, gain, fastest_rate, kn, kt, friction, step, damping, tally, out,
):  # fmt: skip
    """Step until `steps` are done or a pair may have moved by `room`; returns the steps done.

    Every step: contact forces, Love-Weber stress, strain rate ``drive + gain (target - stress)``, motion.
    """
    n = position.shape[0]
    keep = (1.0 - damping) / (1.0 + damping)
    push = step * step / (kn * (1.0 + damping))
    heat = 0.5 * damping * kn / (step * step)
    limit = friction * kn / kt
    travel = 0.0
    fastest = 0.0
    done = 0
    while done < steps and travel < room:
        lxx, lyy, lxy = rate[0], rate[1], rate[2]
        sxx = 0.0
        syy = 0.0
        sxy = 0.0
        slip = 0.0
        for k in range(count):
            i = first[k]
            j = second[k]
            nx = branch[k, 0]
            ny = branch[k, 1]
            d = branch[k, 2]
            ux = velocity[j, 0] - velocity[i, 0] + d * (lxx * nx + lxy * ny)
            uy = velocity[j, 1] - velocity[i, 1] + d * (lxy * nx + lyy * ny)
            overlap = branch[k, 3] - (nx * ux + ny * uy)
            branch[k, 3] = overlap
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
            force[j, 0] -= fx
            force[j, 1] -= fy
            force[j, 2] += shear
            fx *= d
            fy *= d
            sxx += fx * nx
            syy += fy * ny
            sxy += 0.5 * (fx * ny + fy * nx)
        area = cell[0, 0] * cell[1, 1] - cell[0, 1] * cell[1, 0]
        sxx /= area
        syy /= area
        sxy /= area
        tally[WORK] += 0.5 * area * ((sxx + stress[0]) * lxx + (syy + stress[1]) * lyy + 2.0 * (sxy + stress[2]) * lxy)
        tally[FRICTION_HEAT] += kt * slip
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
        unbalanced = 0.0
        speed = 0.0
        drag = 0.0
        for i in range(n):
            fx = force[i, 0]
            fy = force[i, 1]
            u0 = velocity[i, 0]
            v0 = velocity[i, 1]
            w0 = velocity[i, 2]
            u1 = keep * u0 + push * fx
            v1 = keep * v0 + push * fy
            w1 = keep * w0 + push * force[i, 2]
            velocity[i, 0] = u1
            velocity[i, 1] = v1
            velocity[i, 2] = w1
            force[i, 0] = 0.0
            force[i, 1] = 0.0
            force[i, 2] = 0.0
            unbalanced += fx * fx + fy * fy
            square = u1 * u1 + v1 * v1
            speed = square if square > speed else speed
            drag += (u0 + u1) * (u0 + u1) + (v0 + v1) * (v0 + v1) + (w0 + w1) * (w0 + w1)
            x = position[i, 0]
            y = position[i, 1]
            position[i, 0] = x + u1 + exx * x + exy * y
            position[i, 1] = y + v1 + exy * x + eyy * y
        for s in range(2):
            x = cell[s, 0]
            y = cell[s, 1]
            cell[s, 0] = x + exx * x + exy * y
            cell[s, 1] = y + exy * x + eyy * y
        tally[DRAG_HEAT] += heat * drag
        fastest = sqrt(speed)
        travel += 2.0 * fastest + size * longest
        done += 1
        out[UNBALANCED] = sqrt(unbalanced / n)
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
    return done


@dataclass
class Control:
    """What drives the cell: strain rate per step = drive + gain (target - stress), target moving by `target_rate`."""

    drive: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    gain: NDArray[np.float64] = field(default_factory=lambda: np.zeros((3, 3)))
    target: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    target_rate: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    fastest_rate: float = 1.0e-4


class Motion:
    """Steps a sample in time; the sample is changed in place.

    Parameters
    ----------
    sample : Sample
        Belongs to the motion from now on; complete again after each `run`.
    step : float
        ``dt sqrt(kn/m)``, at most 0.5.
    damping : float
        Drag number, see the module's text.
    skin : float
        Gap, in mean diameters, below which pairs are in the list of neighbours.
    refresh : float
        Largest relative displacement of a pair, in mean diameters, before directions are computed anew.
    """

    def __init__(
        self,
        sample: Sample,
        *,
        step: float = STEP,
        damping: float = DAMPING,
        skin: float = SKIN,
        refresh: float = REFRESH,
    ) -> None:
        if not 0.0 < step <= 0.5:
            raise SampleError(f"step is {step}, legal are 0 < dt sqrt(kn/m) <= 0.5")
        if not 0.0 <= damping < 1.0:
            raise SampleError(f"damping is {damping}, legal are 0 <= damping < 1")
        if not 0.0 < 4.0 * refresh <= skin <= LARGEST_SKIN:
            raise SampleError(
                f"refresh is {refresh} with skin {skin}, legal are 0 < refresh <= skin/4 and skin <= {LARGEST_SKIN}"
            )
        self.sample = sample
        self.step = step
        self.damping = damping
        self.steps_done = 0
        self.tally = np.zeros(3)
        self.stress = np.zeros(3)
        self.measures = np.zeros(8)
        diameter = sample.mean_diameter
        self._skin = skin * diameter
        self._refresh = refresh * diameter
        # not the skin itself: when directions are computed anew must not depend on it
        self._longest = 2.0 * float(sample.radius.max()) + LARGEST_SKIN * diameter
        self._velocity = np.zeros((sample.count, 4))
        self._velocity[:, :2] = sample.velocity
        self._velocity[:, 2] = sample.spin
        self._force = np.zeros((sample.count, 4))
        self._room = -1.0  # travel left before the list of neighbours is stale
        self._arrays: tuple[NDArray, NDArray, NDArray, NDArray] | None = None
        self.rebuilds = 0
        self.refreshes = 0

    def _find_neighbours(self) -> None:
        sample = self.sample
        sample.pairs = find_near_pairs(sample.position, sample.radius, sample.cell, self._skin, sample.pairs)
        size = len(sample.pairs.first)
        self._arrays = (
            np.empty(size, np.uint32), np.empty(size, np.uint32), np.empty((size, 5)), np.empty(size, np.uint32)
        )  # fmt: skip
        self._room = self._skin - 2.0 * self._refresh
        self.rebuilds += 1

    def run(self, steps: int, control: Control | None = None) -> int:
        """Advance by `steps` steps; afterwards `stress`, `measures`, `tally` and the sample are up to date."""
        control = control or Control()
        sample = self.sample
        kn = sample.normal_stiffness
        done = 0
        while done < steps:
            if self._room <= 0.0:
                self._find_neighbours()
            assert self._arrays is not None
            first, second, branch, source = self._arrays
            pairs = sample.pairs
            count = _refresh(
                sample.position, sample.radius, sample.cell, sample.strain_rate, self._velocity, pairs.first,
                pairs.second, pairs.image, pairs.tangential, 2.0 * self._refresh, first, second, branch, source,
            )  # fmt: skip
            # a single step may overshoot the allowed travel; the margin of two leaves room for one such step
            done += _advance(
                steps - done, self._refresh, self._longest, count, first, second, branch, self._velocity, self._force,
                sample.position, sample.cell, sample.strain_rate, sample.strain, self.stress, control.target,
                control.target_rate, control.drive, control.gain, control.fastest_rate, kn, kn * sample.stiffness_ratio,
                sample.friction, self.step, self.damping, self.tally, self.measures,
            )  # fmt: skip
            _write_back(pairs.tangential, source, branch, count)
            self._room -= self.measures[TRAVEL]
            self.refreshes += 1
        self.steps_done += done
        sample.velocity = self._velocity[:, :2].copy()
        sample.spin = self._velocity[:, 2].copy()
        return done

    @property
    def unbalanced_force(self) -> float:
        """Root mean square of the resultant contact force on a particle over the mean normal contact force."""
        scale = self.measures[NORMAL_FORCE]
        return float(self.measures[UNBALANCED] / scale) if scale > 0.0 else 0.0

    def inertial_number(self, rate: NDArray[np.float64], pressure: float) -> float:
        """``I = rate sqrt(m/p)`` (plane, unit thickness) for a strain per step; rate measure ``sqrt(2 e:e)``."""
        size = sqrt(2.0 * (rate[0] ** 2 + rate[1] ** 2 + 2.0 * rate[2] ** 2))
        return size * sqrt(self.sample.normal_stiffness / max(pressure, 1e-300)) / self.step

    def energies(self) -> dict[str, float]:
        """Energies in J per metre: elastic (normal, tangential), kinetic, and since the start work and heats."""
        sample = self.sample
        kn, kt = sample.normal_stiffness, sample.normal_stiffness * sample.stiffness_ratio
        overlap, elongation = contact_elongations(sample)
        return {
            "normal": 0.5 * kn * float(np.sum(overlap**2)),
            "tangential": 0.5 * kt * float(np.sum(elongation**2)),
            "kinetic": 0.5 * kn / self.step**2 * float(np.sum(self._velocity[:, :3] ** 2)),
            "work": float(self.tally[WORK]),
            "friction": float(self.tally[FRICTION_HEAT]),
            "drag": float(self.tally[DRAG_HEAT]),
        }


def branch_vectors(sample: Sample, pairs: NearPairs | None = None) -> NDArray[np.float64]:
    """Vectors from the first to the second centre of each near pair, (npairs, 2)."""
    pairs = pairs or sample.pairs
    return sample.position[pairs.second] - sample.position[pairs.first] + pairs.image @ sample.cell


def contact_elongations(sample: Sample) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Overlaps (zero if apart) and tangential elongations of the near pairs."""
    vectors = branch_vectors(sample)
    pairs = sample.pairs
    reach = sample.radius[pairs.first] + sample.radius[pairs.second]
    overlap = np.maximum(reach - np.hypot(vectors[:, 0], vectors[:, 1]), 0.0)
    return overlap, pairs.tangential
