"""Packings and DEM runs for the studies, kept on disk: what is there is read, what was begun is finished."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.records import files
from granfabric.dem_ref.compilation import kernel_cache_directory
from granfabric.dem_ref.dynamics.motion import UnstableMotionError
from granfabric.dem_ref.dynamics.packing import PackingError, make_packing
from granfabric.dem_ref.inputs.probes import is_at_rest
from granfabric.dem_ref.loading.path import biaxial_test
from granfabric.dem_ref.loading.run import DemRun, RunOptions
from granfabric.dem_ref.sample.disks import Sample, SampleError, load_sample, save_sample
from granfabric.dem_ref.sample.neighbours import CellTooSmallError

from .study import StudyError, StudyStopped

Array = NDArray[np.float64]
Watch = Callable[[str], None]
"""Told what is going on; raises `StudyStopped` if the user asks to stop."""

WARM_UP_PARTICLES = 200


@dataclass(frozen=True)
class Grains:
    """A finished DEM run.

    Parameters
    ----------
    history : dict of str to ndarray
        As `DemRun.history`.
    seconds : float
        Processor time of the loading.
    packing_seconds : float
        Processor time of the packing, the same for all its runs.
    particle_steps : float
        Steps of the loading times particles.
    """

    history: dict[str, Array]
    seconds: float
    packing_seconds: float
    particle_steps: float


class GrainStore:
    """DEM runs in a folder; file names carry a hash of what decides the numbers: options and sources of the DEM.

    Parameters
    ----------
    folder : Path
        Made when something is written.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._warm = False

    def path(self, particles: int, seed: int, name: str, content: str = "") -> Path:
        """Where something about a packing is kept, without suffix; `content` is what else decides the numbers."""
        text = f"{content}\n{kernel_cache_directory().name}"
        mark = hashlib.sha256(text.encode()).hexdigest()[:10]
        return self.folder / f"{particles}_disks_seed_{seed}_{name.replace(' ', '_')}_{mark}"

    def packing(self, particles: int, seed: int, watch: Watch) -> tuple[Sample, float]:
        """A packing and the processor time it took [s].

        Raises
        ------
        StudyError, StudyStopped
        """
        path = self.path(particles, seed, "packing")
        with suppress(SampleError, OSError, ValueError, KeyError):
            kept = load_sample(path.with_suffix(".npz"))
            if is_at_rest(kept):
                return kept, _seconds(path)
        self._compile()
        since = time.process_time()
        try:
            packing = make_packing(
                particles, seed, progress=lambda text, fraction: watch(f"{particles} disks, seed {seed}: {text}")
            )
        except (PackingError, SampleError, CellTooSmallError) as error:
            raise StudyError(f"{particles} disks with seed {seed} cannot be packed: {error}") from error
        seconds = time.process_time() - since
        self.folder.mkdir(parents=True, exist_ok=True)
        save_sample(path.with_suffix(".npz"), packing)
        files.write_json(path.with_suffix(".json"), {"seconds": seconds})
        return packing, seconds

    def run(self, particles: int, seed: int, name: str, options: RunOptions, watch: Watch) -> Grains:
        """A run on a packing.

        Raises
        ------
        StudyError, StudyStopped
            What was reached is on disk and is gone on with.
        """
        packing, packing_seconds = self.packing(particles, seed, watch)
        path = self.path(particles, seed, name, options.fingerprint())
        checkpoint = path.with_suffix(".npz")
        seconds = 0.0
        try:
            run = DemRun.resume(checkpoint, options)
            seconds = _seconds(path)
        except (SampleError, OSError, ValueError, KeyError):
            run = DemRun(packing, options)
        if not run.finished:
            self._compile()
            stopped: list[StudyStopped] = []

            def stop() -> bool:
                try:
                    watch(f"{particles} disks, seed {seed}: {name} ({100 * run.completed_fraction():.0f} %)")
                except StudyStopped as stopped_by:
                    stopped.append(stopped_by)
                return bool(stopped)

            since = time.process_time()
            try:
                run.execute(stop=stop, checkpoint=checkpoint)
            except (SampleError, CellTooSmallError, UnstableMotionError) as error:
                raise StudyError(f"{particles} disks, seed {seed}, {name}: {error}") from error
            seconds += time.process_time() - since
            files.write_json(path.with_suffix(".json"), {"seconds": seconds})
            if stopped:
                raise stopped[0]
        if run.reason:
            raise StudyError(f"{particles} disks, seed {seed}, {name}: {run.reason}")
        steps = float(run.history()["dem_steps"][-1])
        return Grains(run.history(), seconds, packing_seconds, steps * particles)

    def _compile(self) -> None:
        """Compile before the clock runs."""
        if not self._warm:
            options = RunOptions(tuple(biaxial_test("constant_pressure", 0.01, 1e-4)))
            DemRun(make_packing(WARM_UP_PARTICLES, 1), options).execute()
            self._warm = True


def _seconds(path: Path) -> float:
    """Time noted beside a file."""
    return float(json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))["seconds"])
