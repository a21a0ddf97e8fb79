"""Motion of frictional disks in a deforming periodic cell: the compiled core of the DEM.

Per contact a linear normal spring (no tension), a linear tangential spring with history, and Coulomb's limit
``|ft| <= mu fn``. Particles follow the homogeneous deformation of the cell without inertia; what they move beyond it
has inertia and, where a disk is part of the network, is damped by a drag proportional to that extra velocity. In the
quasi-static limit neither mass nor drag matters, so both are chosen for speed:

- every particle has the same mass m and the rotational inertia m r^2, the rotation being carried as the displacement of
  the surface. Then the stiffest possible mode (six contacts a particle, kt = kn) has ``omega^2 = 12 kn/m``. The step is
  given as the number ``step = dt sqrt(kn/m)``, critical at ``2/sqrt(12) = 0.577``; the default is 0.7 of that. Gradings
  so wide that a disk can have Z > 6 contacts take ``sqrt(6/Z)`` of the step;
- the drag is the number ``damping``, so that ``v(+1/2) = ((1 - damping) v(-1/2) + F dt/m)/(1 + damping)``. It acts on
  disks that have at least three contacts at the moment. One with fewer flies freely: dragged along with the cell, a
  disk that carries nothing would be pressed onto neighbours which move otherwise, with a force that shrinks with the
  rate while the contact stays. The corner into which a force pushes a disk has two sides, so that drag alone never
  makes the third contact. From a tenth to ten times the default, contacts and forces are the same (measured:
  `docs/guide/verification.md`); the default is where a loading needs the fewest steps.

Displacements in a dense packing are far smaller than disks. Directions and lengths of branch vectors are therefore kept
from one *refresh* to the next and only the overlap and the tangential elongation are integrated in between; a refresh
computes them anew from the positions as soon as any pair may have moved by more than `refresh` mean diameters relative
to each other (default 2e-5, a fifth of the mean overlap at kn/p = 1e4): a direction is never off by more than 2e-5 rad
and an overlap by more than the square of that. (Likewise the lever arms of tangential forces are the radii, not the
radii less half the overlap.) Pairs that cannot touch before the next refresh are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import sqrt
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import changed_in_place, finite, is_within, whole
from granfabric.dem_ref.sample.disks import Sample, SampleError
from granfabric.dem_ref.sample.neighbours import NearPairs, find_near_pairs, most_neighbours
from granfabric.dem_ref.threads import Faster, two_threads

from .stepping import (
    DRAG_HEAT,
    FRICTION_HEAT,
    NORMAL_FORCE,
    TRAVEL,
    UNBALANCED,
    WORK,
    advance,
    advance_two_threads,
    refresh_contacts,
    write_back,
)

STEP = 0.4
DAMPING = 0.02
SKIN = 0.03
LARGEST_SKIN = 0.1
REFRESH = 2.0e-5


class UnstableMotionError(RuntimeError):
    """Stresses are no longer finite."""


@dataclass
class Control:
    """What drives the cell: strain rate per step = drive + gain (target - stress), target moving by `target_rate`."""

    drive: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    gain: NDArray[np.float64] = field(default_factory=lambda: np.zeros((3, 3)))
    target: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    target_rate: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    fastest_rate: float = 1.0e-4

    def bring_into_form(self) -> None:
        """Check every array; one of another kind is replaced by a copy.

        Raises
        ------
        SampleError
        """
        for name, shape in (("drive", (3,)), ("gain", (3, 3)), ("target", (3,)), ("target_rate", (3,))):
            setattr(self, name, finite(name, getattr(self, name), shape))
        if not is_within(self.fastest_rate, 0.0, np.inf):
            raise SampleError(f"fastest_rate is {self.fastest_rate}, legal are values >= 0")
        self.fastest_rate = float(self.fastest_rate)


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
    threads : int, optional
        1 or 2; the result is the same to the last bit. Whichever is faster if not given (`Faster`); several samples at
        once are better run in one Python thread each (compiled code holds no lock).
    """

    def __init__(
        self,
        sample: Sample,
        *,
        step: float = STEP,
        damping: float = DAMPING,
        skin: float = SKIN,
        refresh: float = REFRESH,
        threads: int | None = None,
    ) -> None:
        if threads is not None and (not is_within(threads, 1, 2) or threads not in (1, 2)):
            raise SampleError(f"threads is {threads}, legal are 1 and 2")
        if not isinstance(sample, Sample):
            raise SampleError(f"sample is {sample!r}, not a sample")
        sample.bring_into_form()
        if not is_within(step, 1e-12, 0.5):
            raise SampleError(f"step is {step}, legal are 0 < dt sqrt(kn/m) <= 0.5")
        if not is_within(damping, 0.0, 1.0) or damping == 1.0:
            raise SampleError(f"damping is {damping}, legal are 0 <= damping < 1")
        if not (is_within(refresh, 0.0, 1.0) and is_within(skin, 0.0, 1.0)) or not (
            0.0 < 4.0 * refresh <= skin <= LARGEST_SKIN
        ):
            raise SampleError(
                f"refresh is {refresh} with skin {skin}, legal are 0 < refresh <= skin/4 and skin <= {LARGEST_SKIN}"
            )
        self.sample = sample
        self.step = step * sqrt(6.0 / most_neighbours(sample.radius))
        self.damping = float(damping)
        self.threads = threads
        self._faster = Faster(sample.count)
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
        self._force = np.zeros((2, sample.count, 4))
        self._taken = np.zeros(1, np.int64)
        self._room = -1.0  # travel left before the list of neighbours is stale
        self._pairs: NearPairs | None = None
        self._arrays: tuple[NDArray, NDArray, NDArray, NDArray] | None = None
        self.rebuilds = 0
        self.refreshes = 0

    def _find_neighbours(self) -> None:
        sample = self.sample
        if not (np.isfinite(sample.position).all() and np.isfinite(sample.cell).all()):
            raise UnstableMotionError(f"the motion lost its stability after {self.steps_done} steps: reduce the step")
        sample.pairs = find_near_pairs(sample.position, sample.radius, sample.cell, self._skin, sample.pairs)
        size = len(sample.pairs.first)
        self._arrays = (
            np.empty(size, np.uint32), np.empty(size, np.uint32), np.empty((size, 5)), np.empty(size, np.uint32)
        )  # fmt: skip
        self._pairs = sample.pairs
        self._room = self._skin - 2.0 * self._refresh
        self.rebuilds += 1

    def _bring_into_form(self) -> None:
        """Everything that the kernels are handed, since all of it can be reached from outside."""
        sample = self.sample
        sample.bring_into_form()
        if sample.count != len(self._velocity):
            raise SampleError(f"the sample has {sample.count} disks now, the motion began with {len(self._velocity)}")
        self.stress = changed_in_place("stress", self.stress, (3,))
        self.tally = changed_in_place("tally", self.tally, (3,))
        self.measures = changed_in_place("measures", self.measures, (8,))
        if sample.pairs is not self._pairs:
            self._room = -1.0  # somebody else's list

    def run(self, steps: int, control: Control | None = None) -> int:
        """Advance by `steps` steps; afterwards `stress`, `measures`, `tally` and the sample are up to date.

        Also when it is interrupted: then fewer steps were taken.

        Raises
        ------
        SampleError
            If an array of the sample, the motion or the control has another shape or kind.
        UnstableMotionError
        """
        steps = whole("steps", steps, 0)
        control = control or Control()
        control.bring_into_form()
        self._bring_into_form()
        with two_threads((self.threads or self._faster.choose()) == 2) as both:
            start = perf_counter()
            done = self._take(steps, control, advance_two_threads if both else advance)
            self._faster.tell(2 if both else 1, done, perf_counter() - start)
        if not np.isfinite(self.stress).all():
            raise UnstableMotionError(f"the motion lost its stability after {self.steps_done} steps: reduce the step")
        return done

    def _take(self, steps: int, control: Control, take_steps: Callable[..., None]) -> int:
        sample = self.sample
        kn = sample.normal_stiffness
        done, count = 0, -1
        self._taken[0] = 0
        try:
            while done < steps:
                if self._room <= 0.0:
                    self._find_neighbours()
                assert self._arrays is not None
                first, second, branch, source = self._arrays
                pairs = sample.pairs
                count = refresh_contacts(
                    sample.position, sample.radius, sample.cell, sample.strain_rate, self._velocity, pairs.first,
                    pairs.second, pairs.image, pairs.tangential, 2.0 * self._refresh, first, second, branch, source,
                )  # fmt: skip
                # a single step may overshoot the allowed travel; the margin of two leaves room for one such step
                self._taken[0] = 0
                take_steps(
                    steps - done, self._refresh, self._longest, count, first, second, branch, self._velocity,
                    self._force, sample.position, sample.cell, sample.strain_rate, sample.strain, self.stress,
                    control.target, control.target_rate, control.drive, control.gain, control.fastest_rate, kn,
                    kn * sample.stiffness_ratio, sample.friction, self.step, self.damping, self.tally, self.measures,
                    self._taken,
                )  # fmt: skip
                write_back(pairs.tangential, source, branch, count)
                done, count = done + int(self._taken[0]), -1
                self._room -= self.measures[TRAVEL]
                self.refreshes += 1
        finally:
            if count >= 0:  # interrupted between the steps and what belongs to them
                write_back(pairs.tangential, source, branch, count)
                done += int(self._taken[0])
                self._room = -1.0
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
        # without the zeros of near pairs: their number, and with it the last digit of a sum, depends on the list
        overlap, elongation = (values[values != 0.0] for values in contact_elongations(sample))
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
    # `take` gathers rows in a tenth of the time of an index. No matrix products: BLAS would start threads that spin on
    # after them, on the cores that the motion's own threads need
    position = np.ascontiguousarray(sample.position)
    vectors = position.take(pairs.second, axis=0)
    vectors -= position.take(pairs.first, axis=0)
    for side in (0, 1):
        image = pairs.image[:, side].astype(np.float64)
        for axis in (0, 1):
            vectors[:, axis] += image * sample.cell[side, axis]
    return vectors


def lengths(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths of vectors, shape (m, 2), none so large or small that its square is not a number; shape (m,)."""
    x, y = vectors[:, 0], vectors[:, 1]
    return np.sqrt(x * x + y * y)


def contact_elongations(sample: Sample) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Overlaps (zero if apart) and tangential elongations of the near pairs."""
    vectors = branch_vectors(sample)
    pairs = sample.pairs
    reach = sample.radius[pairs.first] + sample.radius[pairs.second]
    overlap = np.maximum(reach - lengths(vectors), 0.0)
    return overlap, pairs.tangential
