"""A test on a specimen as a run: legs of its path, a history, checkpoints that resume to the same bits."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from math import ceil
from pathlib import Path
from time import monotonic

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import SampleError, number
from granfabric.dem_ref.sample.disks import Sample, read_arrays, write_atomically

from .cut import SpecimenOptions
from .history import COLUMNS
from .specimen import Specimen
from .stored import specimen_arrays, specimen_from_arrays

COMPRESSION, FORCE, REST = "compression", "force", "rest"
LARGEST = 0.3
"""Axial strain either way."""


class StoppedError(Exception):
    """Asked to stop; the last record is what is gone on with."""


@dataclass(frozen=True)
class SpecimenLeg:
    """One leg of the path of a specimen.

    Attributes
    ----------
    loading : str
        ``"compression"``: the upper platen moves; ``"force"``: it carries one until everything is at rest;
        ``"rest"``: it stands still until then.
    axial_strain : float
        Of compression: at the end, since the consolidation, compression positive.
    stress_ratio : float, optional
        Of compression: (axial - lateral)/(axial + lateral) stress at which it ends before.
    axial_stress : float
        Of force: over the width after consolidation [Pa, compression positive].
    """

    loading: str
    axial_strain: float = 0.0
    stress_ratio: float | None = None
    axial_stress: float = 0.0

    def __post_init__(self) -> None:
        if self.loading not in (COMPRESSION, FORCE, REST):
            raise SampleError(f"loading is {self.loading!r}, legal are {COMPRESSION}, {FORCE}, {REST}")
        number("axial_strain", self.axial_strain, -LARGEST, LARGEST)
        number("axial_stress", self.axial_stress, 0.0, 1e300)
        if self.stress_ratio is not None:
            number("stress_ratio", self.stress_ratio, -1.0, 1.0)


class SpecimenRun:
    """Carries a specimen along its path: consolidated first, then leg by leg.

    Parameters
    ----------
    packing : Sample or Specimen
        What the specimen is cut from; or one that is consolidated.
    options : SpecimenOptions
    legs : tuple of SpecimenLeg
    strain_step : float
        Axial strain between two records of a compression.

    Attributes
    ----------
    leg : int
        That is under way, from 0.
    reason : str
        Why the last one was given up.
    """

    def __init__(
        self, packing: Sample | Specimen, options: SpecimenOptions, legs: tuple[SpecimenLeg, ...], strain_step: float
    ) -> None:
        self.legs, self.strain_step = tuple(legs), number("strain_step", strain_step, 1e-12, 1.0)
        self.specimen = packing if isinstance(packing, Specimen) else Specimen(packing, options)
        self.leg, self.part, self.leg_start = 0, 0, 0.0
        self.leg_of_row: list[int] = [0] if self.specimen.start is not None else []
        self.not_reached: list[str] = []
        self.reason = ""
        self._kept: dict[str, NDArray] = {}

    @property
    def start_position(self) -> NDArray[np.float64]:
        """Positions from which strains count."""
        start = self.specimen.start
        return self.specimen.sample.position if start is None else start.position

    @property
    def finished(self) -> bool:
        """Nothing is left to do."""
        return bool(self.reason) or self.leg >= len(self.legs)

    def fingerprint(self) -> str:
        """JSON text that two runs share which continue each other."""
        return json.dumps([[asdict(leg) for leg in self.legs], self.strain_step], sort_keys=True)

    def history(self) -> dict[str, NDArray[np.float64]]:
        """Columns of `history.COLUMNS`, and ``leg``: the one that a record belongs to, from 1; 0 is consolidation."""
        table = np.array(self.specimen.rows).reshape(-1, len(COLUMNS))
        columns = {name: table[:, k].copy() for k, name in enumerate(COLUMNS)}
        return {**columns, "leg": np.array(self.leg_of_row, dtype=np.float64)}

    def completed_fraction(self) -> float:
        """Rough fraction of the legs that is done; what a leg that waits for rest takes is not known beforehand."""
        within = 0.0
        if self.leg < len(self.legs) and self.legs[self.leg].loading == COMPRESSION:
            within = self.part / self._parts()
        return min(1.0, (self.leg + within) / len(self.legs))

    def execute(
        self,
        progress: Callable[[SpecimenRun], None] | None = None,
        stop: Callable[[], bool] | None = None,
        on_record: Callable[[SpecimenRun], None] | None = None,
        checkpoint: str | Path | None = None,
        checkpoint_seconds: float = 30.0,
    ) -> bool:
        """Go on to the end, or until `stop()` is true; True when the end of the last leg was reached.

        `progress` is called about twice a second, `on_record` at every new record. With `checkpoint` the last record
        is written there every `checkpoint_seconds`, at the end, and when stopped.
        """
        last = monotonic()

        def watch() -> None:
            nonlocal last
            if progress is not None and monotonic() - last > 0.5:
                last = monotonic()
                progress(self)
            if stop is not None and stop():
                raise StoppedError

        self.specimen.watch = watch
        written = monotonic()
        try:
            while not self.finished:
                self.advance()
                if on_record is not None:
                    on_record(self)
                if checkpoint is not None and self.specimen.start is not None:
                    self._kept = self.arrays()
                    if monotonic() - written > checkpoint_seconds:
                        written = monotonic()
                        write_atomically(Path(checkpoint), self._kept)
        except StoppedError:
            pass
        finally:
            self.specimen.watch = None
        if checkpoint is not None and self._kept:
            write_atomically(Path(checkpoint), self._kept)
        return self.finished and not self.reason

    def advance(self) -> None:
        """Go on to the next record: that of the consolidation, of a part of a compression, or of the rest of a leg."""
        specimen = self.specimen
        if specimen.start is None:
            if not specimen.consolidate():
                self.reason = f"consolidation: {specimen.ending}"
                return
            self._recorded(0)
            return
        leg = self.legs[self.leg]
        if leg.loading != COMPRESSION:
            come = (
                specimen.rest() if leg.loading == REST else specimen.hold(leg.axial_stress * specimen.start.width)
            )  # fmt: skip
            specimen.record()
            self._recorded(self.leg + 1)
            self.reason = "" if come else specimen.ending
            self._next()
            return
        if self.part == 0:
            self.leg_start = specimen.axial_strain
        parts = self._parts()
        self.part += 1
        wanted = self.leg_start + self.part / parts * (leg.axial_strain - self.leg_start)
        if not specimen.compress(wanted - specimen.axial_strain, 1):
            self.reason = specimen.ending
        self._recorded(self.leg + 1)
        if self.reason:
            return
        ratio = dict(zip(COLUMNS, specimen.rows[-1]))["stress_ratio"]
        sense = 1.0 if leg.axial_strain > self.leg_start else -1.0
        reached = leg.stress_ratio is not None and sense * (ratio - leg.stress_ratio) >= 0.0
        if reached or self.part >= parts:
            if leg.stress_ratio is not None and not reached:
                self.not_reached.append(
                    f"leg {self.leg + 1} ended at its axial strain of {leg.axial_strain:g}, at q/p = {ratio:.3f} "
                    f"instead of {leg.stress_ratio:g}"
                )
            self._next()

    def _parts(self) -> int:
        start = self.leg_start if self.part else self.specimen.axial_strain
        return max(1, ceil(abs(self.legs[self.leg].axial_strain - start) / self.strain_step - 1e-6))

    def _next(self) -> None:
        self.leg, self.part = self.leg + 1, 0

    def _recorded(self, leg: int) -> None:
        self.leg_of_row.append(leg)

    def arrays(self) -> dict[str, NDArray]:
        """The run at its last record."""
        return {
            **specimen_arrays(self.specimen),
            "run_options": np.frombuffer(self.fingerprint().encode(), np.uint8),
            "run_numbers": np.array([float(self.leg), float(self.part), self.leg_start]),
            "leg_of_row": np.array(self.leg_of_row, np.int64),
            "texts": np.frombuffer(json.dumps([self.reason, self.not_reached]).encode(), np.uint8),
        }

    @staticmethod
    def resume(
        path: str | Path, options: SpecimenOptions, legs: tuple[SpecimenLeg, ...], strain_step: float
    ) -> SpecimenRun:
        """Continue from a checkpoint.

        Raises
        ------
        SampleError
            If the file is missing, damaged, or was written by a run with other options or legs.
        """
        arrays = read_arrays(path)
        run = SpecimenRun(specimen_from_arrays(arrays, options, str(path)), options, legs, strain_step)
        sizes = {"run_options": None, "run_numbers": 3, "leg_of_row": len(run.specimen.rows), "texts": None}
        for name, size in sizes.items():
            if name not in arrays or arrays[name].ndim != 1 or size not in (None, len(arrays[name])):
                raise SampleError(f"{path}: array '{name}' is missing or damaged")
        if bytes(arrays["run_options"].astype(np.uint8)).decode(errors="replace") != run.fingerprint():
            raise SampleError(f"{path}: written by a run with another path, start anew or use the same scene")
        numbers = arrays["run_numbers"].tolist()
        if not (0 <= numbers[0] <= len(run.legs) and 0.0 <= numbers[1] < 2**53 and abs(numbers[2]) <= 1.0):
            raise SampleError(f"{path}: array 'run_numbers' is damaged")
        try:
            reason, not_reached = json.loads(bytes(arrays["texts"].astype(np.uint8)).decode())
            run.reason, run.not_reached = str(reason), [str(text) for text in not_reached]
        except (ValueError, TypeError) as error:
            raise SampleError(f"{path}: array 'texts' is damaged") from error
        run.leg, run.part, run.leg_start = int(numbers[0]), int(numbers[1]), float(numbers[2])
        run.leg_of_row = arrays["leg_of_row"].tolist()
        run._kept = run.arrays()
        return run
