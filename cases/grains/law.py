"""A packing of disks at every integration point, driven by the strain of the point: FEM x DEM."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.arrays import ArrayError, UpdateArrays, stress_and_index, update_arrays
from granfabric.constitutive.contract import Array, LawDescription, Status, TangentKind, UpdateReport, Variable
from granfabric.dem_ref.dynamics.motion import UnstableMotionError
from granfabric.dem_ref.measures.contacts import (
    contacts_of,
    coordination_number,
    fabric_anisotropy,
    force_harmonics,
    love_weber_stress,
    sliding_fraction,
)
from granfabric.dem_ref.sample.disks import Sample
from granfabric.dem_ref.sample.neighbours import CellTooSmallError

from . import packing_columns
from .drive import Pace, drive
from .failures import LARGEST_INCREMENT, GrainsReport
from .network_stiffness import network_stiffness

LOST_PRESSURE = 1e-2
"""Of the pressure that a packing began with: below, it carries nothing (its unbalanced force is zero then too)."""
CARRIED = 1e-3
"""Of the pressure: by how much the stress of a packing may be off the initial one."""
KEPT = 4096
"""Stiffnesses of start states that are remembered, if there are not more points than half of it."""

MEASURED = (
    Variable("coordination", "contacts per particle, all particles counted", lower=0.0, upper=6.0),
    Variable("fabric_anisotropy", "fabric anisotropy of the contact normals", components=2),
    Variable("normal_force_anisotropy", "anisotropy of the mean normal force", components=2),
    Variable("tangential_force_anisotropy", "anisotropy of the mean tangential force", components=2),
    Variable("mean_normal_force", "mean normal force over directions", "N/m", lower=0.0),
    Variable("sliding_fraction", "fraction of contacts at Coulomb's limit", lower=0.0, upper=1.0),
    Variable("motion_steps", "steps of the motion so far", lower=0.0),
)
MEASURES = sum(variable.components for variable in MEASURED)


@dataclass(frozen=True)
class Work:
    """What a law has cost since it was made: steps of the motion, over all points, and calls."""

    steps: int = 0
    calls: int = 0


class GrainsLaw:
    """Every point has a packing of its own; points begin as the given packings in turn.

    The answer depends on the arguments alone: from the packing of the start row, the strain increment is applied in
    steps of at most `Pace.strain_step` and held until the packing is at rest. Stresses are counted from those of the
    packings at rest under the initial stress, so that a packing's small imbalance does not enter.

    Parameters
    ----------
    packings : sequence of Sample
        At rest, all of the same number of disks.
    pace : Pace, optional
    secant : bool
        Correct the stiffness of the network by what the increment showed (Broyden 1965), instead of taking it as the
        tangent.
    threads : int, optional
        Points at work side by side, as many as numba may use if not given; the same bits for any number.
    lost_pressure : float, optional
        Mean pressure below which a packing carries nothing [Pa]; a hundredth of the one it began with if not given.
    under : callable, optional
        Gives packing number i loaded to a stress [Pa], for states under other stresses than those of the packings.

    Attributes
    ----------
    on_points : callable, optional
        Told within a call how many points are done, and of how many.
    stop : callable, optional
        Asked before each point within a call whether to leave it.
    work : Work
    steps_of_last : ndarray of int64, shape (npt,)
        Steps of the motion that the points took in the last call.

    Raises
    ------
    ArrayError
        Without packings, or if their numbers of disks differ.
    """

    def __init__(
        self,
        packings: Sequence[Sample],
        pace: Pace | None = None,
        secant: bool = True,
        threads: int | None = None,
        lost_pressure: float | None = None,
        under: Callable[[int, Array], Sample] | None = None,
    ) -> None:
        self._packings = [packing.copy() for packing in packings]
        counts = {packing.count for packing in self._packings}
        if len(counts) != 1:
            raise ArrayError(f"packings at points need the same number of disks, these have {sorted(counts)}")
        self.disks = counts.pop()
        if self.disks > packing_columns.MOST_DISKS:
            raise ArrayError(f"{self.disks} disks at a point are more than the {packing_columns.MOST_DISKS} that fit")
        self.pace = pace or Pace()
        self._secant = secant
        self._threads = threads
        self._lost = lost_pressure
        self.under = under
        self.on_points: Callable[[int, int], None] | None = None
        self.stop: Callable[[], bool] | None = None
        self._stiffness: dict[bytes, Array] = {}
        self._room = KEPT
        self._lock = threading.Lock()
        hidden = Variable("packing", "the packing itself", "m", packing_columns.width(self.disks), hidden=True)
        self._description = LawDescription("grains", (*MEASURED, hidden), ())
        self.work = Work()
        self.steps_of_last = np.zeros(0, dtype=np.int64)

    @property
    def recipe(self) -> tuple[list[Sample], Pace, bool, float | None]:
        """Packings, pace, whether the tangent is a secant, and lost pressure: what makes the same law elsewhere."""
        return self._packings, self.pace, self._secant, self._lost

    @property
    def description(self) -> LawDescription:
        """The law as data."""
        return self._description

    def initial_state(self, stress: Array, material_index: NDArray[np.int32] | None = None) -> Array:
        """Packings under a stress: those given, point i beginning as packing i modulo their number.

        Parameters
        ----------
        stress : ndarray, shape (npt, 3)
            That of the packings within a thousandth of the pressure, if nobody loads them (`under`).

        Raises
        ------
        ArrayError
            If it is another.
        """
        stress, _ = stress_and_index(stress, material_index, 1)
        numbers = np.arange(len(stress)) % len(self._packings)
        if self.under is None:
            return self.rows([self._packings[number] for number in numbers], stress)
        return self.rows([self.under(int(number), wanted) for number, wanted in zip(numbers, stress)], stress)

    def rows(self, samples: Sequence[Sample], stress: Array) -> Array:
        """State of points from packings at rest that were loaded to the stress of each point.

        Parameters
        ----------
        samples : sequence of Sample
            One a point; point i began as the law's packing i modulo their number, and has its disks.
        stress : ndarray, shape (npt, 3)
            [Pa], tension positive.

        Returns
        -------
        ndarray, shape (npt, nstate)

        Raises
        ------
        ArrayError
            If a packing carries another stress.
        """
        state = np.zeros((len(stress), self._description.nstate))
        for point, (sample, wanted) in enumerate(zip(samples, stress, strict=True)):
            found, pressure = love_weber_stress(sample), -0.5 * float(wanted[0] + wanted[1])
            if not np.abs(found - wanted).max() <= CARRIED * pressure:
                raise ArrayError(
                    f"point {point}: its packing carries {np.round(found, 1).tolist()} Pa, not the initial stress "
                    f"{np.round(wanted, 1).tolist()} Pa"
                )
            self._write(sample, point % len(self._packings), pressure, 0, state[point])
        return state

    def packing(self, row: Array) -> Sample:
        """The packing of a row of the state, shape (nstate,)."""
        return packing_columns.read(row[MEASURES:], self._packings)

    def lost_pressure(self, row: Array) -> float:
        """Pressure below which the packing of a row of the state has lost it [Pa]."""
        return LOST_PRESSURE * float(row[MEASURES + 1]) if self._lost is None else self._lost

    def _write(self, sample: Sample, number: int, pressure: float, steps: int, row: Array) -> None:
        contacts = contacts_of(sample)
        forces = force_harmonics(contacts)
        measured = [
            coordination_number(sample, contacts).all_particles,
            *fabric_anisotropy(contacts),
            *forces.normal,
            *forces.tangential,
            forces.mean,
            sliding_fraction(sample, contacts),
            float(steps),
        ]
        packing_columns.write(sample, number, pressure, row[MEASURES:])
        row[:MEASURES] = measured

    def update(
        self,
        strain_increment: Array,
        stress_start: Array,
        state_start: Array,
        stress_end: Array,
        state_end: Array,
        tangent: Array | None = None,
        tangent_kind: TangentKind = "propagated",
        material_index: NDArray[np.int32] | None = None,
    ) -> UpdateReport:
        """Advance all points; see `granfabric.constitutive.contract.Law.update`.

        The tangent is the stiffness of the network of the start state ("elastic"), corrected so that it gives the
        stress increment of this very strain increment (else).
        """
        arrays = update_arrays(
            (self._description.nstate, 1), strain_increment, stress_start, state_start, stress_end, state_end, tangent,
            tangent_kind, material_index,
        )  # fmt: skip
        npoints = len(arrays.increment)
        # those of this step and of the one before, to which a cut goes back
        self._room = max(KEPT, 2 * npoints)
        status = np.zeros(npoints, dtype=np.int8)
        steps = np.zeros(npoints, dtype=np.int64)

        left = self.stop or (lambda: False)

        def one(point: int) -> bool:
            if left():
                return False
            status[point], steps[point] = self._advance(point, arrays, tangent_kind)
            return True

        self._each(one, npoints)
        self.steps_of_last = steps
        self.work = Work(self.work.steps + int(steps.sum()), self.work.calls + 1)
        ones = np.ones(npoints, dtype=np.int32)
        failed = bool((status > Status.LIMITED).any())
        return GrainsReport(status, ones, np.zeros_like(ones), 0.5 if failed else 1.0)

    def _each(self, one: Callable[[int], bool], npoints: int) -> None:
        """All points, side by side if there are threads; told as they are done, and left when asked to stop."""
        threads = self._threads or numba.get_num_threads()
        pool = ThreadPoolExecutor(threads) if threads > 1 and npoints > 1 else None
        tell = self.on_points or (lambda done, total: None)
        try:
            for done, whole in enumerate((pool.map if pool else map)(one, range(npoints)), start=1):
                if not whole:
                    raise KeyboardInterrupt
                tell(done, npoints)
        finally:
            if pool:
                pool.shutdown(cancel_futures=True)

    def _advance(self, point: int, arrays: UpdateArrays, kind: TangentKind) -> tuple[int, int]:
        """One point: its status and the steps that it took."""
        increment, start = arrays.increment[point], arrays.state_start[point]
        stress_start, stress_end, state_end = (
            arrays.stress_start[point], arrays.stress_end[point], arrays.state_end[point]
        )  # fmt: skip
        stress_end[:], state_end[:] = stress_start, start
        wanted = len(arrays.tangent) > 0
        network = np.zeros((3, 3))
        if wanted:
            network = self._network(start)
            arrays.tangent[point] = network
        if not (np.isfinite(increment).all() and np.isfinite(start).all() and np.isfinite(stress_start).all()):
            return Status.NOT_FINITE, 0
        if not increment.any():
            return Status.OK, 0
        if not float(np.hypot(np.hypot(*increment[:2]), increment[2])) <= LARGEST_INCREMENT:
            return Status.TOO_MANY_SUBSTEPS, 0
        sample = self.packing(start)
        before = love_weber_stress(sample)
        try:
            driven = drive(sample, increment, self.pace)
        except (UnstableMotionError, CellTooSmallError):
            return Status.NOT_FINITE, 0
        if not driven.at_rest:
            return Status.NOT_CONVERGED, driven.steps
        if not -0.5 * float(driven.stress[:2].sum()) > self.lost_pressure(start):
            return Status.NO_PRESSURE, driven.steps
        change = driven.stress - before
        number, pressure, steps = (
            int(start[MEASURES]),
            float(start[MEASURES + 1]),
            int(start[MEASURES - 1]) + driven.steps,
        )
        try:
            self._write(sample, number, pressure, steps, state_end)
        except packing_columns.PackingError:
            return Status.NOT_ADMISSIBLE, driven.steps
        stress_end[:] = stress_start + change
        if wanted and self._secant and kind != "elastic":
            arrays.tangent[point] = network + np.outer(change - network @ increment, increment) / (
                increment @ increment
            )
        return Status.OK, driven.steps

    def _network(self, start: Array) -> Array:
        """Stiffness of a start state, remembered because it is asked for at every iterate of a load step."""
        key = hashlib.blake2b(start.tobytes(), digest_size=16).digest()
        with self._lock:
            known = self._stiffness.get(key)
        if known is None:
            known = network_stiffness(self.packing(start))
            with self._lock:
                if len(self._stiffness) >= self._room:
                    self._stiffness.clear()
                self._stiffness[key] = known
        return known
