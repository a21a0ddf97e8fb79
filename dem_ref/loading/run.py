"""A DEM test as a run: segments of loading, a history, checkpoints that resume bit for bit.

Not only biaxial tests: a run is a list of `Segment`s, among them isotropic changes, loops and turning principal axes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.dynamics.motion import DAMPING, REFRESH, STEP, Motion
from granfabric.dem_ref.measures.contacts import (
    Contacts,
    component_along,
    contacts_of,
    coordination_number,
    fabric_anisotropy,
    force_harmonics,
    love_weber_stress,
    sliding_fraction,
)
from granfabric.dem_ref.measures.events import network_change
from granfabric.dem_ref.sample.disks import (
    Sample,
    SampleError,
    read_arrays,
    sample_arrays,
    sample_from_arrays,
    write_atomically,
)

from .endings import Ending, ending_text
from .leg_state import LegState
from .legs import stress_invariants
from .path import Segment
from .run_checks import damage
from .servo import Loading, RateLimits

HISTORY_COLUMNS = (
    "step", "strain_xx", "strain_yy", "strain_xy", "stress_xx", "stress_yy", "stress_xy", "p", "q", "coordination",
    "coordination_without_rattlers", "fabric_anisotropy", "normal_force_anisotropy", "tangential_force_anisotropy",
    "mean_normal_force", "sliding_fraction", "coordination_gained", "coordination_lost", "fabric_gained", "fabric_lost",
    "fabric_persisting", "fabric_xx", "fabric_xy", "normal_force_xx", "normal_force_xy", "tangential_force_xx",
    "tangential_force_xy", "void_ratio", "inertial_number", "unbalanced_force", "elastic_energy", "work",
    "friction_heat", "drag_heat", "dem_steps", "segment",
)  # fmt: skip


@dataclass(frozen=True)
class RunOptions:
    """How a run is carried out.

    Attributes
    ----------
    segments : tuple of Segment
    limits : RateLimits
    record_stress_ratio : float
        A record is written when the stress (its deviator or its mean) has moved by this much, over the initial p.
    record_strain : float
        Or when the strain has moved by this much.
    step, damping : float
        See `motion`.
    """

    segments: tuple[Segment, ...]
    limits: RateLimits = field(default_factory=RateLimits)
    record_stress_ratio: float = 0.01
    record_strain: float = 1.0e-4
    step: float = STEP
    damping: float = DAMPING

    def __post_init__(self) -> None:
        given = [self.segments] if isinstance(self.segments, Segment) else list(self.segments)
        for segment in given:
            if not isinstance(segment, Segment):
                raise SampleError(f"a run consists of segments, of the class Segment, not of {segment!r}")
        object.__setattr__(self, "segments", tuple(given))

    def fingerprint(self) -> str:
        """JSON text that two equal sets of options share."""
        return json.dumps(asdict(self), sort_keys=True)


def refresh_for(limits: RateLimits) -> float:
    """Travel before directions are computed anew: a fifteenth of the unbalanced force allowed, 2e-5 to 2e-4.

    A direction that is off turns a contact force by that angle; a fifteenth of the imbalance that the loading itself is
    allowed does not show, and fast loadings are spared a refresh every few steps.
    """
    return min(2.0e-4, max(REFRESH, limits.unbalanced_force / 15.0))


class DemRun:
    """Carries a sample along its segments.

    Parameters
    ----------
    sample : Sample
        At rest; copied.
    options : RunOptions
    threads : int, optional
        1 or 2; does not change the result. Whichever is faster if not given.
    initial_pressure : float
        Pa; that of the sample if not given. A run that is gone on with may have lost it.

    Attributes
    ----------
    finished : bool
        Nothing is left to do.
    ending : Ending
        Why the last segment begun was given up.
    """

    def __init__(
        self, sample: Sample, options: RunOptions, threads: int | None = None, initial_pressure: float = 0.0
    ) -> None:
        if not options.segments:
            raise SampleError("a run needs at least one segment")
        if not (options.record_stress_ratio > 0.0 and options.record_strain > 0.0):
            raise SampleError("record_stress_ratio and record_strain must be > 0")
        self.options = options
        self.motion = Motion(
            sample.copy(),
            step=options.step,
            damping=options.damping,
            refresh=refresh_for(options.limits),
            threads=threads,
        )
        self.motion.stress[:] = love_weber_stress(self.motion.sample)
        self.initial_pressure = initial_pressure or stress_invariants(self.motion.stress)[0]
        if self.initial_pressure <= 0.0:
            raise SampleError(f"the mean pressure is {self.initial_pressure:.4g} Pa, a run needs a compressed sample")
        self.segment = 0
        self.rows: list[list[float]] = []
        self.finished = False
        self.ending = Ending.ON_ITS_WAY
        self._gained, self._lost = 0.0, 0.0
        self._fabric = np.zeros((3, 2))  # gained, lost, persisting
        self._initial_force = max(force_harmonics(contacts_of(sample)).mean, 1e-300)
        self._reference: Contacts = contacts_of(sample)
        self._recorded_stress = self.motion.stress.copy()
        self._recorded_strain = sample.strain.copy()
        self._largest = np.zeros(2)  # inertial number, unbalanced force since the last record
        self._loading: Loading | None = None
        self._leg_state: LegState | None = None
        self._record()

    @property
    def sample(self) -> Sample:
        """The sample as it is now."""
        return self.motion.sample

    @property
    def reason(self) -> str:
        """Why the run ended before the end of its path, in words; empty if it did not."""
        last = dict(zip(HISTORY_COLUMNS, self.rows[-1]))
        return ending_text(self.ending, last["p"], self.initial_pressure, last["unbalanced_force"])

    @property
    def message(self) -> str:
        """The reason with the segment that was given up."""
        return f"segment {self.segment}: {self.reason}" if self.reason else ""

    @property
    def contacts(self) -> Contacts:
        """Contacts at the last record."""
        return self._reference

    @property
    def axis(self) -> float:
        """Direction along which signed anisotropies are reported: that of the first segment."""
        return self.options.segments[0].angle

    def history(self) -> dict[str, NDArray[np.float64]]:
        """Columns of the history so far; see `HISTORY_COLUMNS`.

        Stress and strain tension positive, `strain_xy` the engineering shear strain; anisotropies as components along
        the axis of the first segment, and as double-angle vectors (``_xx``: cos 2 theta, ``_xy``: sin 2 theta);
        `coordination` over all particles; `mean_normal_force` over its initial value; gained, lost and persisting parts
        added up over the records; inertial number and unbalanced force are the largest since the record before;
        energies in J per metre.
        """
        table = np.array(self.rows)
        return {name: table[:, k].copy() for k, name in enumerate(HISTORY_COLUMNS)}

    def execute(
        self,
        progress: Callable[[DemRun], None] | None = None,
        stop: Callable[[], bool] | None = None,
        on_record: Callable[[DemRun], None] | None = None,
        checkpoint: str | Path | None = None,
        checkpoint_seconds: float = 30.0,
    ) -> bool:
        """Go on to the end, or until `stop()` is true; True when the end of the last segment was reached.

        `progress` is called about twice a second, `on_record` at every new record. With `checkpoint` the state is
        written there every `checkpoint_seconds`, at the end, and when stopped.
        """
        last_progress = last_checkpoint = monotonic()
        while not self.finished:
            recorded = self.advance()
            if recorded and on_record is not None:
                on_record(self)
            now = monotonic()
            if progress is not None and (now - last_progress > 0.5 or self.finished):
                last_progress = now
                progress(self)
            if stop is not None and stop():
                break
            if checkpoint is not None and now - last_checkpoint > checkpoint_seconds:
                last_checkpoint = now
                self.save(checkpoint)
        if checkpoint is not None:
            self.save(checkpoint)
        return self.finished and self.ending == Ending.ON_ITS_WAY

    def advance(self) -> bool:
        """One chunk of steps; True when a record was written."""
        if self.finished:
            return False
        if self._loading is None:
            leg = self.options.segments[self.segment].leg(self.initial_pressure)
            self._loading = Loading(self.motion, leg, self.options.limits, self._leg_state, self.initial_pressure)
            self._leg_state = None
        loading = self._loading
        more = loading.advance()
        state = loading.state
        self._largest = np.maximum(self._largest, [state.inertial_number, state.unbalanced_force])
        if not more:
            self._loading = None
            self.segment += 1
            self.ending = loading.ending
            self.finished = loading.given_up or self.segment >= len(self.options.segments)
        ds = self.motion.stress - self._recorded_stress
        de = self.sample.strain - self._recorded_strain
        moved_stress = max(abs(ds[0] - ds[1]) / 2, abs(ds[0] + ds[1]) / 2, abs(ds[2])) / self.initial_pressure
        moved_strain = max(abs(de[0] - de[1]), abs(de[0] + de[1]), 2 * abs(de[2]))
        if more and moved_stress < self.options.record_stress_ratio and moved_strain < self.options.record_strain:
            return False
        self._record()
        return True

    def _record(self) -> None:
        sample = self.sample
        contacts = contacts_of(sample)
        change = network_change(self._reference, contacts, sample.count)
        self._gained += change.coordination_gained
        self._lost += change.coordination_lost
        self._fabric += np.array([change.fabric_gained, change.fabric_lost, change.fabric_persisting])
        self._reference = contacts
        stress = love_weber_stress(sample, contacts)
        p, q, _ = stress_invariants(stress)
        z = coordination_number(sample, contacts)
        fabric = fabric_anisotropy(contacts)
        forces = force_harmonics(contacts)
        energy = self.motion.energies()
        along = self.axis
        self.rows.append(
            [
                float(len(self.rows)), sample.strain[0], sample.strain[1], 2.0 * sample.strain[2], *stress, p, q,
                z.all_particles, z.without_rattlers,
                component_along(fabric, along), component_along(forces.normal, along),
                component_along(forces.tangential, along), forces.mean / self._initial_force,
                sliding_fraction(sample, contacts), self._gained, self._lost,
                *(component_along(part, along) for part in self._fabric), *fabric, *forces.normal, *forces.tangential,
                sample.void_ratio, *self._largest, energy["normal"] + energy["tangential"], energy["work"],
                energy["friction"], energy["drag"], float(self.motion.steps_done), float(self.segment),
            ]
        )  # fmt: skip
        self._recorded_stress = self.motion.stress.copy()
        self._recorded_strain = sample.strain.copy()
        self._largest = np.zeros(2)

    def completed_fraction(self) -> float:
        """Rough fraction of the path that is done."""
        within = 0.0
        if self._loading is not None:
            within = self._loading.state.progress
            segment = self.options.segments[self.segment]
            if segment.kind == "biaxial" and segment.stress_ratio:
                p, q, _ = stress_invariants(self.motion.stress)
                within = max(within, min(1.0, q / max(p, 1e-300) / abs(segment.stress_ratio)))
        return min(1.0, (self.segment + within) / len(self.options.segments))

    def save(self, path: str | Path) -> None:
        """Write a checkpoint, atomically and without pickles; resuming from it continues bit for bit."""
        state = self._loading.state if self._loading is not None else self._leg_state
        reference = self._reference
        arrays: dict[str, Any] = {f"sample_{name}": a for name, a in sample_arrays(self.sample).items()}
        arrays |= {
            "options": np.frombuffer(self.options.fingerprint().encode(), np.uint8),
            "rows": np.array(self.rows),
            "run_numbers": np.concatenate(
                [
                    [float(self.segment), float(self.finished), self._gained, self._lost, self._initial_force],
                    [self.initial_pressure, float(self.motion.steps_done)], self._fabric.ravel(),
                    self._recorded_stress, self._recorded_strain, self._largest, [float(self.ending)],
                ]
            ),
            "leg_state": np.zeros(0) if state is None else state.to_array(),
            "motion_stress": self.motion.stress,
            "motion_measures": self.motion.measures,
            "motion_tally": self.motion.tally,
            "contact_first": reference.first, "contact_second": reference.second, "contact_image": reference.image,
            "contact_normal": reference.normal, "contact_length": reference.length,
            "contact_normal_force": reference.normal_force, "contact_tangential_force": reference.tangential_force,
        }  # fmt: skip
        write_atomically(Path(path), arrays)

    @staticmethod
    def resume(path: str | Path, options: RunOptions, threads: int | None = None) -> DemRun:
        """Continue from a checkpoint.

        Raises
        ------
        SampleError
            If the file is missing, damaged, or was written by a run with other options.
        """
        arrays = read_arrays(path)
        if "options" not in arrays or "rows" not in arrays:
            raise SampleError(f"{path}: not a checkpoint of a run")
        if bytes(arrays["options"].astype(np.uint8)).decode(errors="replace") != options.fingerprint():
            raise SampleError(f"{path}: written by a run with other options, start anew or use the same scene")
        prefix = "sample_"
        stored = {name[len(prefix) :]: a for name, a in arrays.items() if name.startswith(prefix)}
        sample = sample_from_arrays(stored, str(path))
        reason = damage(arrays, sample.count, len(options.segments), len(HISTORY_COLUMNS))
        if reason:
            raise SampleError(f"{path}: {reason}")
        numbers, rows = arrays["run_numbers"], arrays["rows"]
        run = DemRun(sample, options, threads, initial_pressure=float(numbers[5]))
        run.motion.stress[:] = arrays["motion_stress"]
        run.motion.measures[:] = arrays["motion_measures"]
        run.motion.tally[:] = arrays["motion_tally"]
        run.rows = rows.tolist()
        run.segment, run.finished = int(numbers[0]), bool(numbers[1])
        run._gained, run._lost, run._initial_force, run.initial_pressure = (float(v) for v in numbers[2:6])
        run.motion.steps_done = int(numbers[6])
        run._fabric = numbers[7:13].reshape(3, 2).copy()
        run._recorded_stress, run._recorded_strain = numbers[13:16].copy(), numbers[16:19].copy()
        run._largest = numbers[19:21].copy()
        run.ending = Ending(int(numbers[21]))
        names = ("first", "second", "image", "normal", "length", "normal_force", "tangential_force")
        parts = {name: arrays[f"contact_{name}"] for name in names}
        run._reference = Contacts(**parts, key=parts["first"] * sample.count + parts["second"])
        state = arrays["leg_state"]
        run._leg_state = LegState.from_array(state) if len(state) else None
        return run


def at_stress_ratios(
    history: dict[str, NDArray[np.float64]], levels: Sequence[float]
) -> dict[str, NDArray[np.float64]]:
    """Linear interpolation of every column where q/p first passes each level; NaN where it never does."""
    with np.errstate(divide="ignore", invalid="ignore"):  # a sample may end without pressure
        ratio = history["q"] / history["p"]
    out = {name: np.full(len(levels), np.nan) for name in history}
    for k, level in enumerate(levels):
        above = np.flatnonzero(ratio >= level)
        if len(above) == 0:
            continue
        b = int(above[0])
        a = max(b - 1, 0)
        weight = 1.0 if a == b else (level - ratio[a]) / (ratio[b] - ratio[a])
        for name, column in history.items():
            out[name][k] = (1 - weight) * column[a] + weight * column[b]
    return out
