"""A specimen of disks between two platens and two membranes: cut from a packing, consolidated, compressed.

Platens are rigid planes across y, rough (a friction of their own, or none); membranes press on the sides (`membrane`).
Gravity acts on the disks if it is asked for. A platen is moved, or carries a force. Stress is tension positive in
results only where it is called stress; forces of platens are compression positive, N per metre of thickness.

A disk that the membrane touches is always dragged, as if it had three contacts: it cannot fly away from the sheet that
presses it, and one that has lost its neighbours is brought back by the pressure. What does not come to rest within its
steps is told, with the reason, instead of being waited for.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import SampleError, number, whole
from granfabric.dem_ref.dynamics.motion import DAMPING, REFRESH, SKIN, STEP, UnstableMotionError
from granfabric.dem_ref.dynamics.stepping import refresh_contacts, write_back
from granfabric.dem_ref.loading.legs import stress_invariants
from granfabric.dem_ref.measures.contacts import contacts_of, coordination_number, love_weber_stress
from granfabric.dem_ref.sample.disks import Sample
from granfabric.dem_ref.sample.neighbours import find_near_pairs, most_neighbours

from .bounded_steps import (
    CONTACTS,
    DRAG_HEAT,
    FOLLOWING_WORK,
    FRICTION_HEAT,
    GIVEN_WORK,
    NORMAL_FORCE,
    PLATEN_WORK,
    TRAVEL,
    UNBALANCED,
    bounded_steps,
)
from .cut import SpecimenOptions as SpecimenOptions
from .cut import cut
from .membrane import BALL, HOLD, enclosed_area, membrane_forces, outer_chain

MARGIN = 1.0
"""Empty space beside the specimen on each side, over its size."""
CHUNK = 50
"""Steps between two looks at the membranes."""
LEARNING = 0.1
RESPONSE = 200.0
"""Steps in which a platen that carries a force corrects an error of it."""
AT_REST = 1e-4
"""Unbalanced force over the mean contact force."""
LOOSE_REST = 1e-2
"""The same while friction is not yet that of the disks."""
ON_TARGET = 2e-3
"""Error of the force of a platen, over the force."""
PATIENCE = 400
"""Looks at a specimen without contacts before it is given up: after the cut it comes together first."""
LONGEST = 400_000
"""Steps in which a specimen has to come to rest."""
SLACK = 0.5
"""Where membranes would press inwards further than this, over the width at first, nothing is left between them."""

COLUMNS = (
    "axial_strain", "volumetric_strain", "height", "width", "upper_force", "lower_force", "upper_shear", "lower_shear",
    "axial_stress", "stress_ratio", "coordination", "unbalanced_force", "elastic_energy", "kinetic_energy",
    "platen_work", "given_work", "following_work", "friction_heat", "drag_heat", "energy_error", "steps",
)  # fmt: skip


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
    """

    def __init__(self, packing: Sample, options: SpecimenOptions | None = None) -> None:
        self.options = options or SpecimenOptions()
        self.options.check()
        if not isinstance(packing, Sample):
            raise SampleError(f"a specimen is cut from a sample, not from {packing!r}")
        if abs(packing.cell[0, 1]) + abs(packing.cell[1, 0]) > 0.2 * min(packing.cell[0, 0], packing.cell[1, 1]):
            raise SampleError("a specimen is cut from a packing whose cell is nearly a rectangle along the axes")
        pressure = stress_invariants(love_weber_stress(packing))[0]
        if not pressure > 0.0:
            raise SampleError(f"the mean pressure is {pressure:.4g} Pa, a specimen needs a compressed packing")
        self.pressure = pressure if self.options.lateral_pressure is None else float(self.options.lateral_pressure)
        size = np.array([packing.cell[0, 0], packing.cell[1, 1]])
        place, kept = cut(packing, size)
        if len(kept) < 20:
            raise SampleError(f"{len(kept)} disks are too few for a specimen")
        cell = np.diag((1.0 + 2.0 * MARGIN) * size)
        position = np.ascontiguousarray(place - [0.5 * size[0], 0.0])
        radius = np.ascontiguousarray(packing.radius[kept])
        zero = np.zeros((len(kept), 2))
        self._skin = SKIN * packing.mean_diameter
        pairs = find_near_pairs(position, radius, cell, self._skin)
        self.sample = Sample(
            position, radius, cell, packing.normal_stiffness, packing.stiffness_ratio, packing.friction, zero,
            np.zeros(len(kept)), pairs, seed=packing.seed,
        )  # fmt: skip
        self._carry_tangential(packing, kept)
        n = len(kept)
        self.step = STEP * sqrt(6.0 / most_neighbours(radius))
        self._diameter = self.sample.mean_diameter
        self._refresh = REFRESH * self._diameter
        self._longest = 2.0 * float(radius.max()) + self._skin
        self._friction = self.sample.friction, float(self.options.platen_friction)
        self._velocity, self._force, self._none = np.zeros((n, 4)), np.zeros((n, 4)), np.zeros((n, 4))
        self._weight = np.zeros((n, 2))
        self._weight[:, 1] = -self.options.unit_weight * np.pi * radius**2
        self._given, self._held = self._weight.copy(), np.zeros(n)
        # onto the disks, which the cut has left at some distance; the lower platen is y = 0, the middle x = 0
        position[:, 1] -= (position[:, 1] - radius).min()
        self.platens = np.array([0.0, float((position[:, 1] + radius).max())])
        self._widening, self._width = 0.0, 0.0
        self._platen_velocity, self._target, self._gain = np.zeros(2), np.zeros(2), np.zeros(2)
        self._fastest = 0.0
        self._spring: dict[tuple[int, int], float] = {}
        self._wall: tuple[NDArray, NDArray, NDArray] | None = None
        self._arrays: tuple[NDArray, NDArray, NDArray, NDArray] | None = None
        self._room = -1.0
        self._taken = np.zeros(1, np.int64)
        self.reactions, self.tally, self.measures = np.zeros((2, 2)), np.zeros(5), np.zeros(4)
        self.steps_done = 0
        self.ending, self._apart = "", 0
        self.left = self.right = np.zeros(0, np.int64)
        self._follow()
        self._start: tuple[float, float, float] | None = None
        self.rows: list[list[float]] = []

    def _carry_tangential(self, packing: Sample, kept: NDArray[np.int64]) -> None:
        """Elongations of those contacts of the packing that the cut has left."""
        number_of = np.full(packing.count, -1)
        number_of[kept] = np.arange(len(kept))
        known = packing.pairs.tangential != 0.0
        ends = number_of[packing.pairs.first[known]], number_of[packing.pairs.second[known]]
        held = {(i, j): e for i, j, e in zip(*(a.tolist() for a in ends), packing.pairs.tangential[known]) if i >= 0}
        pairs = self.sample.pairs
        for k, key in enumerate(zip(pairs.first.tolist(), pairs.second.tolist())):
            pairs.tangential[k] = held.get(key, 0.0)

    @property
    def height(self) -> float:
        """Distance of the platens."""
        return float(self.platens[1] - self.platens[0])

    @property
    def area(self) -> float:
        """Between membranes (through the centres of their disks) and platens."""
        return enclosed_area(self.sample.position, self.left, self.right, *self.platens)

    @property
    def unbalanced_force(self) -> float:
        """Root mean square of the resultant force on a disk over the mean contact force."""
        return float(self.measures[UNBALANCED] / max(self.measures[NORMAL_FORCE], 1e-300))

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
        membrane_forces(position, self.left, lower, upper, self.pressure, self._given)
        _mirrored(position, self.right, lower, upper, self.pressure, self._given)
        self._held[:] = 0.0
        self._held[self.left] = self._held[self.right] = 1.0

    def _find_neighbours(self) -> None:
        sample = self.sample
        if not np.isfinite(sample.position).all():
            raise UnstableMotionError(f"the specimen lost its stability after {self.steps_done} steps")
        sample.pairs = find_near_pairs(sample.position, sample.radius, sample.cell, self._skin, sample.pairs)
        size = len(sample.pairs.first)
        self._arrays = (
            np.empty(size, np.uint32), np.empty(size, np.uint32), np.empty((size, 5)), np.empty(size, np.uint32)
        )  # fmt: skip
        self._keep_springs()
        y, r = sample.position[:, 1], sample.radius
        disks, sides = [], []
        for side, gap in ((0, y - r - self.platens[0]), (1, self.platens[1] - y - r)):
            near = np.flatnonzero(gap < self._skin)
            disks.append(near)
            sides.append(np.full(len(near), side))
        disk, side_of = np.concatenate(disks), np.concatenate(sides)
        springs = [self._spring.get(key, 0.0) for key in zip(disk.tolist(), side_of.tolist())]
        self._wall = disk, side_of, np.array(springs, dtype=np.float64)
        self._room = self._skin - 2.0 * self._refresh

    def _keep_springs(self) -> None:
        if self._wall is not None:
            disk, side, elongation = self._wall
            self._spring = dict(zip(zip(disk.tolist(), side.tolist()), elongation.tolist()))

    def run(self, steps: int) -> None:
        """Advance by this many steps, the membranes following every `CHUNK` of them."""
        steps = whole("steps", steps, 0)
        while steps > 0:
            part = min(steps, CHUNK)
            self._follow()
            if self._gain[1] == 0.0:  # the homogeneous part of the widening is learnt from what has happened
                width = self.area / self.height
                if self._width > 0.0:
                    seen = (width / self._width - 1.0) / CHUNK
                    self._widening += LEARNING * (seen - self._widening)
                self._width = width
            self._take(part)
            steps -= part

    def _take(self, steps: int) -> None:
        sample = self.sample
        kn = sample.normal_stiffness
        mean, done = np.zeros((2, 2)), 0
        while done < steps:
            if self._room <= 0.0:
                self._find_neighbours()
            assert self._arrays is not None and self._wall is not None
            first, second, branch, source = self._arrays
            pairs = sample.pairs
            speed = self._platen_velocity
            rate = np.array([self._widening, (speed[1] - speed[0]) / self.height, 0.0])
            count = refresh_contacts(
                sample.position, sample.radius, sample.cell, rate, self._velocity, pairs.first, pairs.second,
                pairs.image, pairs.tangential, 2.0 * self._refresh, first, second, branch, source,
            )  # fmt: skip
            bounded_steps(
                steps - done, self._refresh, self._longest, count, first, second, branch, self._velocity,
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
        sample.velocity = self._velocity[:, :2].copy()
        sample.spin = self._velocity[:, 2].copy()

    def _reason(self) -> str:
        """What a specimen that cannot go on has come to; empty if it can."""
        self._apart = self._apart + 1 if self.measures[CONTACTS] < 0.5 * self.sample.count else 0
        if self._apart > PATIENCE:
            return "the specimen has fallen apart: it has lost most of its contacts"
        if self._start is not None and self.area < (1.0 - SLACK) * self._start[2]:
            return "the membranes have pressed the specimen together"
        return ""

    def hold(self, force: float, steps: int = LONGEST, rest: float = AT_REST) -> bool:
        """Let the upper platen carry a force until everything is at rest.

        Parameters
        ----------
        force : float
            N per metre of thickness, compression positive.
        steps : int
            After which it is given up.
        rest : float
            Unbalanced force, over the mean contact force, that counts as rest.

        Returns
        -------
        bool
            Whether it came to rest; `ending` tells why not.
        """
        force = number("force", force, 0.0, 1e300)
        width = self.area / self.height
        stiffness = self.sample.normal_stiffness * width / self.height
        self._target[1] = force
        self._gain[:] = 0.0, 1.0 / (stiffness * RESPONSE)
        self._platen_velocity[:] = 0.0
        self._widening = self._width = 0.0
        self._fastest = 1e-3 * self.step * sqrt(self.pressure / self.sample.normal_stiffness) * self.height
        end = self.steps_done + whole("steps", steps, 1)
        scale = max(force, 1e-3 * self.pressure * width)
        calm, self.ending = 0, ""
        while self.steps_done < end and calm < 5 and not self.ending:
            self.run(CHUNK)
            error = abs(self.reactions[1, 0] - force)
            reached = error < ON_TARGET * scale * max(1.0, 0.1 * rest / AT_REST)
            calm = calm + 1 if reached and self.unbalanced_force < rest else 0
            self.ending = self._reason()
        if calm < 5 and not self.ending:
            loose = int(np.argmax(np.abs(self._velocity[:, :2]).max(axis=1)))
            x, y = self.sample.position[loose]
            self.ending = (
                f"the specimen does not come to rest within {steps} steps: unbalanced force "
                f"{self.unbalanced_force:.2g}, the fastest disk is number {loose} at ({x:.4g}, {y:.4g})"
            )
        self._gain[:] = 0.0
        self._platen_velocity[:] = 0.0
        return calm >= 5

    def consolidate(self) -> bool:
        """Come to rest under the pressure of the membranes on all sides; strains count from here.

        At first with the friction of `SpecimenOptions.consolidation_friction`, so that the cut, whose disks fall into
        the gaps beside the platens, does not leave a loose specimen; then with that of the disks and platens.
        """
        options = self.options
        self._friction = options.consolidation_friction, min(options.consolidation_friction, options.platen_friction)
        for _ in range(2):
            if not self.hold(self.pressure * self.area / self.height, rest=LOOSE_REST):
                return False
        self._friction = self.sample.friction, float(options.platen_friction)
        for _ in range(3):  # the width, and the force with it, follows the membranes
            if not self.hold(self.pressure * self.area / self.height):
                return False
        self.tally[:] = 0.0
        self._start = self.height, self.area, self.area
        self._elastic_at_start = sum(self.energies()[:2])
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
        if self._start is None:
            raise SampleError("a specimen is consolidated before it is compressed")
        axial_strain = number("axial_strain", axial_strain, -0.5, 0.5)
        records = whole("records", records, 1, 1_000_000)
        rate = self.options.inertial_number * self.step * sqrt(self.pressure / self.sample.normal_stiffness)
        steps = max(records, round(abs(axial_strain) / rate))
        self._gain[:] = 0.0
        self._platen_velocity[:] = 0.0, -axial_strain * self._start[0] / steps
        self.ending = ""
        for row in range(records):
            self.run((row + 1) * steps // records - row * steps // records)
            self.record()
            self.ending = self._reason()
            if self.ending:
                break
        self._platen_velocity[:] = 0.0
        return not self.ending

    def energies(self) -> tuple[float, float, float]:
        """Elastic energy of contacts, that of the platens' contacts, and kinetic energy; J per metre."""
        sample = self.sample
        kn, kt = sample.normal_stiffness, sample.normal_stiffness * sample.stiffness_ratio
        contacts = contacts_of(sample)
        inner = 0.5 * float(np.sum(contacts.normal_force**2) / kn + np.sum(contacts.tangential_force**2) / kt)
        outer = 0.0
        if self._wall is not None:
            disk, side, elongation = self._wall
            y, r = sample.position[disk, 1], sample.radius[disk]
            overlap = np.where(side == 0, r - (y - self.platens[0]), r - (self.platens[1] - y))
            outer = 0.5 * float(kn * np.sum(np.maximum(overlap, 0.0) ** 2) + kt * np.sum(elongation**2))
        return inner, outer, 0.5 * kn / self.step**2 * float(np.sum(self._velocity[:, :3] ** 2))

    def record(self) -> None:
        """Add a row to the history."""
        if self._start is None:
            raise SampleError("a specimen is consolidated before anything is recorded")
        width = self.area / self.height
        inner, outer, kinetic = self.energies()
        elastic = inner + outer - self._elastic_at_start
        balance = (
            self.tally[PLATEN_WORK] + self.tally[GIVEN_WORK] - self.tally[FRICTION_HEAT] - self.tally[DRAG_HEAT]
            + self.tally[FOLLOWING_WORK] - elastic - kinetic
        )  # fmt: skip
        axial = float(0.5 * self.reactions[:, 0].sum() / width)
        self.rows.append(
            [
                1.0 - self.height / self._start[0], 1.0 - self.area / self._start[1], self.height, width,
                self.reactions[1, 0], self.reactions[0, 0], self.reactions[1, 1], self.reactions[0, 1], axial,
                (axial - self.pressure) / (axial + self.pressure), coordination_number(self.sample).all_particles,
                self.unbalanced_force, elastic, kinetic, self.tally[PLATEN_WORK], self.tally[GIVEN_WORK],
                self.tally[FOLLOWING_WORK], self.tally[FRICTION_HEAT], self.tally[DRAG_HEAT], balance,
                float(self.steps_done),
            ]
        )  # fmt: skip

    def history(self) -> dict[str, NDArray[np.float64]]:
        """Columns of the records; see `COLUMNS`.

        Strains are compression positive and count from the consolidated specimen; `width` is area over height, forces
        N per metre of thickness, compression positive, shear along x; `axial_stress` is the mean force of both
        platens over the width [Pa, compression positive], `stress_ratio` (axial - lateral)/(axial + lateral);
        energies in J per metre since the consolidation: `given_work` of membranes and weight, `following_work` what
        resultant forces on disks gain on the homogeneous part of the motion, which has no inertia; `energy_error` is
        the work that was neither stored nor turned into heat.
        """
        table = np.array(self.rows)
        return {name: table[:, k].copy() for k, name in enumerate(COLUMNS)}


def _mirrored(
    position: NDArray[np.float64], chain: NDArray[np.int64], lower: float, upper: float, pressure: float,
    force: NDArray[np.float64],
) -> None:  # fmt: skip
    """Forces of the membrane on the right side: those of the left one in a mirror."""
    there = np.zeros_like(force)
    membrane_forces(position * [-1.0, 1.0], chain, lower, upper, pressure, there)
    force += there * [-1.0, 1.0]
