"""A specimen of disks between two platens and two membranes: cut from a packing, consolidated, compressed.

Platens are rigid planes across y, rough (a friction of their own, or none); membranes press on the sides (`membrane`).
Gravity acts on the disks if it is asked for. A platen is moved, or carries a force. Stress is tension positive in
results only where it is called stress; forces of platens are compression positive, N per metre of thickness.

While a specimen comes together all disks are dragged, not only those with three contacts as in a periodic packing: one
that has lost its neighbours would else be thrown to and fro by the membrane that presses it back, and one that hangs
between two others would swing, both for ever. Later those on the membranes are, and under gravity still all, since what
has fallen would bounce on the platen. (Loose disks that are always dragged come to lie at their neighbours: they add
contacts without force, a quarter as many as loading takes away.) Disks with fewer than two contacts, with those on
platens, do not count in the unbalanced force. What does not come to rest within its steps is told, with the reason,
instead of being waited for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import SampleError, number, whole
from granfabric.dem_ref.dynamics.motion import DAMPING, REFRESH, SKIN, STEP, UnstableMotionError
from granfabric.dem_ref.dynamics.stepping import refresh_contacts, write_back
from granfabric.dem_ref.loading.legs import stress_invariants
from granfabric.dem_ref.measures.contacts import love_weber_stress
from granfabric.dem_ref.sample.disks import Sample
from granfabric.dem_ref.sample.neighbours import find_near_pairs, most_neighbours

from . import history
from .bounded_steps import CONTACTS, NORMAL_FORCE, TRAVEL, UNBALANCED, bounded_steps
from .cut import SpecimenOptions as SpecimenOptions
from .cut import disks_of
from .history import COLUMNS as COLUMNS
from .membrane import BALL, HOLD, both_sides, enclosed_area, outer_chain

CHUNK = 50
"""Steps between two looks at the membranes."""
LEARNING = 0.1
RESPONSE = 200.0
"""Steps in which a platen that carries a force corrects an error of it."""
LOOSE_REST = 5e-4
"""Unbalanced force that counts as rest while friction is not yet that of the disks."""
COMING_TOGETHER = 150_000
"""Steps of the consolidation without friction, at most: some specimens creep then."""
ON_TARGET = 2e-3
"""Error of the force of a platen, over the force."""
CALM = 5
"""Looks at which everything has to be at rest."""
PATIENCE = 400
"""Looks at a specimen without contacts before it is given up: after the cut it comes together first."""
SLACK = 0.5
"""Where membranes would press inwards further than this, over the width at first, nothing is left between them."""


@dataclass(frozen=True)
class Consolidated:
    """A specimen when it was consolidated, from which strains and energies count."""

    height: float
    width: float
    elastic_energy: float
    position: NDArray[np.float64]


@dataclass(frozen=True)
class PlatenContacts:
    """Disks near the platens, with the forces that they exert on them.

    Attributes
    ----------
    disk, side : (k,) int64
        Side 0 is the lower platen.
    normal_force : (k,)
        Outwards, zero where the disk does not touch.
    shear_force : (k,)
        Along x.
    """

    disk: NDArray[np.int64]
    side: NDArray[np.int64]
    normal_force: NDArray[np.float64]
    shear_force: NDArray[np.float64]


class Specimen:
    """Disks between platens and membranes.

    Parameters
    ----------
    packing : Sample
        At rest under pressure, its cell a rectangle along the axes; it is cut along the sides of the cell and not
        changed.
    options : SpecimenOptions, optional

    Attributes
    ----------
    sample : Sample
        The disks, in a periodic cell so wide that its images do not meet.
    platens : (2,) float64
        Heights of the lower and the upper platen.
    reactions : (2, 2) float64
        Force of the disks on the lower and the upper platen, mean of the last steps: outwards, and along x.
    left, right : ndarray of int64
        Disks on the membranes, from below upwards.
    watch : callable, optional
        Called after every `CHUNK` steps; what it raises is let through.
    """

    def __init__(self, packing: Sample, options: SpecimenOptions | None = None) -> None:
        self.options = options or SpecimenOptions()
        self.options.check()
        if not isinstance(packing, Sample):
            raise SampleError(f"a specimen is cut from a sample, not from {packing!r}")
        pressure = stress_invariants(love_weber_stress(packing))[0]
        if not pressure > 0.0:
            raise SampleError(f"the mean pressure is {pressure:.4g} Pa, a specimen needs a compressed packing")
        self.pressure = pressure if self.options.lateral_pressure is None else float(self.options.lateral_pressure)
        sample, top = disks_of(packing, self.options.height_to_width, SKIN * packing.mean_diameter)
        self._begin(sample, np.array([0.0, top]))
        self._follow()

    def _begin(self, sample: Sample, platens: NDArray[np.float64]) -> None:
        """Everything but the membranes, at rest."""
        n = sample.count
        self.sample, self.platens = sample, platens
        self.watch: Callable[[], None] | None = None
        self.step = STEP * sqrt(6.0 / most_neighbours(sample.radius))
        self._diameter = sample.mean_diameter
        self._skin = SKIN * self._diameter
        self._refresh = REFRESH * self._diameter
        self._longest = 2.0 * float(sample.radius.max()) + self._skin
        self._friction = sample.friction, float(self.options.platen_friction)
        self.velocity, self._force, self._none = np.zeros((n, 4)), np.zeros((n, 4)), np.zeros((n, 4))
        self._weight = np.zeros((n, 2))
        self._weight[:, 1] = -self.options.unit_weight * np.pi * sample.radius**2
        self._given, self._held = self._weight.copy(), np.zeros(n)
        self._widening = 0.0
        self._platen_velocity, self._target, self._gain = np.zeros(2), np.zeros(2), np.zeros(2)
        self._fastest = 0.0
        self._wall = np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)
        self._arrays: tuple[NDArray, NDArray, NDArray, NDArray] | None = None
        self._room = -1.0
        self._taken = np.zeros(1, np.int64)
        self.reactions, self.tally, self.measures = np.zeros((2, 2)), np.zeros(5), np.zeros(4)
        self.steps_done = 0
        self.ending, self._apart = "", 0
        self.left = self.right = np.zeros(0, np.int64)
        self.start: Consolidated | None = None
        self.rows: list[list[float]] = []

    @property
    def height(self) -> float:
        """Distance of the platens."""
        return float(self.platens[1] - self.platens[0])

    @property
    def area(self) -> float:
        """Between membranes (through the centres of their disks) and platens."""
        return enclosed_area(self.sample.position, self.sample.radius, self.left, self.right, *self.platens)

    @property
    def unbalanced_force(self) -> float:
        """Root mean square of the resultant force on a disk with two contacts or more, over the mean contact force."""
        return float(self.measures[UNBALANCED] / max(self.measures[NORMAL_FORCE], 1e-300))

    @property
    def axial_strain(self) -> float:
        """Compression since the consolidation, over the height then."""
        return 0.0 if self.start is None else 1.0 - self.height / self.start.height

    def platen_contacts(self) -> PlatenContacts:
        """Forces on the platens, disk by disk, as after the last step."""
        sample = self.sample
        disk, side, elongation = self._wall
        y, r = sample.position[disk, 1], sample.radius[disk]
        overlap = np.where(side == 0, r - (y - self.platens[0]), r - (self.platens[1] - y))
        kn = sample.normal_stiffness
        shear = kn * sample.stiffness_ratio * elongation * np.where(side == 0, -1.0, 1.0)
        return PlatenContacts(disk, side, kn * np.maximum(overlap, 0.0), shear)

    def _follow(self) -> None:
        """Find the chains anew and press on them."""
        position, radius = self.sample.position, self.sample.radius
        lower, upper = (float(v) for v in self.platens)
        ball = BALL * self._diameter
        left, right = radius.copy(), radius.copy()
        left[self.left] += HOLD * self._diameter
        right[self.right] += HOLD * self._diameter
        self.left = outer_chain(position, left, lower, upper, ball)
        self.right = outer_chain(position * [-1.0, 1.0], right, lower, upper, ball)
        self._given = self._weight.copy()
        both_sides(position, radius, self.left, self.right, lower, upper, self.pressure, self._given)
        # while it comes together, and where disks fall, all of them
        self._held[:] = 1.0 if self.start is None or self.options.unit_weight > 0.0 else 0.0
        self._held[self.left] = self._held[self.right] = 1.0

    def _find_neighbours(self) -> None:
        sample = self.sample
        if not np.isfinite(sample.position).all():
            raise UnstableMotionError(f"the specimen lost its stability after {self.steps_done} steps")
        sample.pairs = find_near_pairs(sample.position, sample.radius, sample.cell, self._skin, sample.pairs)
        self._make_room()
        y, r = sample.position[:, 1], sample.radius
        springs = dict(zip(zip(*(a.tolist() for a in self._wall[:2])), self._wall[2].tolist()))
        disks, sides = [], []
        for side, gap in ((0, y - r - self.platens[0]), (1, self.platens[1] - y - r)):
            near = np.flatnonzero(gap < self._skin)
            disks.append(near)
            sides.append(np.full(len(near), side))
        disk, side_of = np.concatenate(disks), np.concatenate(sides)
        kept = [springs.get(key, 0.0) for key in zip(disk.tolist(), side_of.tolist())]
        self._wall = disk, side_of, np.array(kept, dtype=np.float64)
        self._room = self._skin - 2.0 * self._refresh

    def _make_room(self) -> None:
        size = len(self.sample.pairs.first)
        self._arrays = (
            np.empty(size, np.uint32), np.empty(size, np.uint32), np.empty((size, 5)), np.empty(size, np.uint32)
        )  # fmt: skip

    def run(self, steps: int) -> None:
        """Advance by this many steps, the membranes following every `CHUNK` of them."""
        steps = whole("steps", steps, 0)
        while steps > 0:
            part = min(steps, CHUNK)
            self._follow()
            x = self.sample.position[:, 0]
            left, right = x[self.left], x[self.right]
            self._take(part)
            if self._gain[1] == 0.0:  # the homogeneous part of the widening is learnt from what has happened
                x = self.sample.position[:, 0]
                # of most disks on the membranes: single ones are loose, or are left by the membrane
                moved = float(np.median(x[self.right] - right) - np.median(x[self.left] - left))
                width = float(np.median(right) - np.median(left))
                self._widening += LEARNING * (moved / width / part - self._widening)
            steps -= part
            if self.watch is not None:
                self.watch()

    def _take(self, steps: int) -> None:
        sample = self.sample
        kn = sample.normal_stiffness
        mean, done = np.zeros((2, 2)), 0
        while done < steps:
            if self._room <= 0.0 or self._arrays is None:
                self._find_neighbours()
            assert self._arrays is not None
            first, second, branch, source = self._arrays
            pairs = sample.pairs
            speed = self._platen_velocity
            rate = np.array([self._widening, (speed[1] - speed[0]) / self.height, 0.0])
            count = refresh_contacts(
                sample.position, sample.radius, sample.cell, rate, self.velocity, pairs.first, pairs.second,
                pairs.image, pairs.tangential, 2.0 * self._refresh, first, second, branch, source,
            )  # fmt: skip
            bounded_steps(
                steps - done, self._refresh, self._longest, count, first, second, branch, self.velocity,
                self._force, self._none, sample.position, sample.radius, self._given, self._held, *self._wall,
                self.platens, self._platen_velocity, self._target, self._gain, self._fastest, self._widening,
                self.reactions, kn, kn * sample.stiffness_ratio, *self._friction, self.step, DAMPING,
                self.tally, self.measures, self._taken,
            )  # fmt: skip
            write_back(pairs.tangential, source, branch, count)
            taken = int(self._taken[0])
            mean += taken * self.reactions
            done += taken
            self._room -= self.measures[TRAVEL]
        self.reactions = mean / max(done, 1)
        self.steps_done += done
        sample.velocity = self.velocity[:, :2].copy()
        sample.spin = self.velocity[:, 2].copy()

    def _reason(self) -> str:
        """What a specimen that cannot go on has come to; empty if it can."""
        self._apart = self._apart + 1 if self.measures[CONTACTS] < 0.5 * self.sample.count else 0
        if self._apart > PATIENCE:
            return "the specimen has fallen apart: it has lost most of its contacts"
        if self.start is not None and self.area / self.height < (1.0 - SLACK) * self.start.width:
            return "the membranes have pressed the specimen together"
        return ""

    def hold(self, force: float | None, steps: int | None = None, rest: float | None = None) -> bool:
        """Let the upper platen carry a force until everything is at rest.

        Parameters
        ----------
        force : float or None
            N per metre of thickness, compression positive. None for the pressure of the membranes on the platen from
            the end of one to that of the other, wherever these move: what a fluid would exert.
        steps : int, optional
            After which it is given up; as the options say if not given.
        rest : float, optional
            Unbalanced force, over the mean contact force, that counts as rest; likewise.

        Returns
        -------
        bool
            Whether it came to rest; `ending` tells why not.
        """
        given = self._from_end_to_end() if force is None else number("force", force, 0.0, 1e300)
        width = self.area / self.height
        stiffness = self.sample.normal_stiffness * width / self.height
        self._stop()
        self._target[1] = given
        self._gain[:] = 0.0, 1.0 / (stiffness * RESPONSE)
        self._fastest = 1e-3 * self.step * sqrt(self.pressure / self.sample.normal_stiffness) * self.height
        scale = ON_TARGET * max(given, 1e-3 * self.pressure * width)

        def reached(loose: float) -> bool:
            off = abs(self.reactions[1, 0] - self._target[1])
            if force is None:
                self._target[1] = self._from_end_to_end()
            return bool(off < scale * loose)

        come = self._settle(steps, rest, reached)
        self._stop()
        return come

    def _from_end_to_end(self) -> float:
        """Pressure on the upper platen between the membranes."""
        x, r, left, right = self.sample.position[:, 0], self.sample.radius, self.left[-1], self.right[-1]
        return self.pressure * max(float(x[right] + r[right] - x[left] + r[left]), 0.0)

    def rest(self, steps: int | None = None, rest: float | None = None) -> bool:
        """Wait between platens that stand still until everything is at rest; as `hold`."""
        self._stop()
        return self._settle(steps, rest, lambda loose: True)

    def _stop(self) -> None:
        self._gain[:] = 0.0
        self._platen_velocity[:] = 0.0
        self._widening = 0.0

    def _settle(self, steps: int | None, rest: float | None, reached: Callable[[float], bool]) -> bool:
        steps = self.options.longest_rest if steps is None else whole("steps", steps, 1)
        rest = self.options.at_rest if rest is None else number("rest", rest, 1e-12, 1.0)
        end = self.steps_done + steps
        loose = max(1.0, 0.1 * rest / self.options.at_rest)
        calm, self.ending = 0, ""
        while self.steps_done < end and calm < CALM and not self.ending:
            self.run(CHUNK)
            calm = calm + 1 if reached(loose) and self.unbalanced_force < rest else 0
            self.ending = self._reason()
        if calm < CALM and not self.ending:
            fastest = int(np.argmax(np.abs(self.velocity[:, :2]).max(axis=1)))
            x, y = self.sample.position[fastest]
            self.ending = (
                f"the specimen does not come to rest within {steps} steps: unbalanced force "
                f"{self.unbalanced_force:.2g}, the fastest disk is number {fastest} at ({x:.4g}, {y:.4g})"
            )
        return calm >= CALM

    def consolidate(self) -> bool:
        """Come to rest under the pressure of the membranes on all sides; strains count from here.

        At first with the friction of `SpecimenOptions.consolidation_friction`, so that the cut, whose disks fall into
        the gaps beside the platens, does not leave a loose specimen; then with that of the disks and platens.
        """
        options = self.options
        self._friction = options.consolidation_friction, min(options.consolidation_friction, options.platen_friction)
        end = self.steps_done + min(COMING_TOGETHER, options.longest_rest)
        # one that does not come to rest without friction does so with it; what has fallen apart does not
        if not self.hold(None, end - self.steps_done, max(LOOSE_REST, options.at_rest)) and self.steps_done < end:
            return False
        self._friction = self.sample.friction, float(options.platen_friction)
        if not self.hold(None):
            return False
        self.tally[:] = 0.0
        energy = sum(history.energies(self)[:2])
        self.start = Consolidated(self.height, self.area / self.height, energy, self.sample.position.copy())
        self.rows = []
        self.record()
        return True

    def compress(self, axial_strain: float, records: int = 20) -> bool:
        """Move the upper platen down by this part of the height, at the inertial number of the options.

        Parameters
        ----------
        axial_strain : float
            Further compression, over the height after consolidation; negative extends.
        records : int
            Rows of the history.

        Returns
        -------
        bool
            Whether the end was reached; `ending` tells why not.
        """
        if self.start is None:
            raise SampleError("a specimen is consolidated before it is compressed")
        axial_strain = number("axial_strain", axial_strain, -0.5, 0.5)
        records = whole("records", records, 1, 1_000_000)
        rate = self.options.inertial_number * self.step * sqrt(self.pressure / self.sample.normal_stiffness)
        steps = max(records, round(abs(axial_strain) / rate))
        self._gain[:] = 0.0
        self._platen_velocity[:] = 0.0, -axial_strain * self.start.height / steps
        self.ending = ""
        for part in range(records):
            self.run((part + 1) * steps // records - part * steps // records)
            self.record()
            self.ending = self._reason()
            if self.ending:
                break
        self._platen_velocity[:] = 0.0
        return not self.ending

    def energies(self) -> tuple[float, float, float]:
        """Elastic energy of contacts, that of the platens' contacts, and kinetic energy; J per metre."""
        return history.energies(self)

    def record(self) -> None:
        """Add a row to the history."""
        if self.start is None:
            raise SampleError("a specimen is consolidated before anything is recorded")
        self.rows.append(history.row(self))

    def history(self) -> dict[str, NDArray[np.float64]]:
        """Columns of the records; see `COLUMNS`.

        Strains are compression positive and count from the consolidated specimen; the lateral part of the volumetric
        one is that of the line that fits the displacements of disks with three contacts or more best. `width` is area
        over height, forces N per metre of thickness, compression positive, shear along x; `axial_stress` is the mean
        force of both platens over the width [Pa, compression positive], `stress_ratio` (axial - lateral)/(axial +
        lateral); `fabric_anisotropy` is positive where contacts point along y. Energies in J per metre since the
        consolidation: `given_work` of membranes and weight, `following_work` what resultant forces on disks gain on
        the homogeneous part of the motion, which has no inertia; `energy_error` is the work that was neither stored
        nor turned into heat.
        """
        table = np.array(self.rows)
        return {name: table[:, k].copy() for k, name in enumerate(COLUMNS)}
