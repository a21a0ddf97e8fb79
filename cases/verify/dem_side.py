"""The DEM side of the comparison: packings, their measured inputs and both loadings, kept on disk and used again."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from granfabric.cases.records import files
from granfabric.cases.records.dem_series import history_text
from granfabric.cases.scene.measured import Inputs, as_data, from_data, measure_inputs
from granfabric.cases.terminal.compile_watch import watching
from granfabric.dem_ref.compilation import sources_mark
from granfabric.dem_ref.dynamics.motion import UnstableMotionError
from granfabric.dem_ref.dynamics.packing import PackingError, make_packing
from granfabric.dem_ref.inputs.probes import ProbeError, is_at_rest
from granfabric.dem_ref.loading.path import biaxial_test
from granfabric.dem_ref.loading.run import DemRun, RunOptions
from granfabric.dem_ref.sample.disks import Sample, SampleError, load_sample, save_sample
from granfabric.dem_ref.sample.neighbours import CellTooSmallError

from .paths import PATHS
from .probes import dem_probes

STORE = "dem"
"""Folder, inside the result folder, of what the DEM computed."""

LOADINGS = {"constant_pressure": "mean pressure constant", "constant_lateral_stress": "lateral stress constant"}
STRESS_RATIO = 0.302
"""Just beyond the last ratio that is compared, so that every run passes it."""

LARGEST_STRAIN = 0.02

Report = Callable[[str, float], None]


def title_of(loading: str) -> str:
    """What a loading or a path is."""
    return LOADINGS[loading] if loading in LOADINGS else PATHS[loading][0]


def loading_options(loading: str) -> RunOptions:
    """Options of the DEM run of a loading or a path."""
    if loading in PATHS:
        return RunOptions(PATHS[loading][1])
    return RunOptions(tuple(biaxial_test(loading, STRESS_RATIO, LARGEST_STRAIN)))


@dataclass
class SeedResult:
    """What the DEM says about one packing.

    Attributes
    ----------
    seed : int
    packing : Sample
        At the start.
    measured : Inputs
        Measured inputs of the point law with their standard errors.
    runs : dict of str to DemRun
        One for each of `LOADINGS` and `PATHS`.
    probes : dict of str to list of float
        Changes of z and a_c in finite stress probes.
    seconds : dict of str to float
        Time of ``packing``, ``measuring`` and each loading, when they were computed.
    computed : bool
        Whether anything was computed now, rather than read.
    """

    seed: int
    packing: Sample
    measured: Inputs = field(default_factory=Inputs)
    runs: dict[str, DemRun] = field(default_factory=dict)
    probes: dict[str, list[float]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    computed: bool = False

    @property
    def inputs(self) -> dict[str, float]:
        """Measured inputs of the point law, by scene key."""
        return self.measured.values


class RunGivenUpError(RuntimeError):
    """A DEM run ended before the end of its path; the text says of which packing, and why."""


DEM_ERRORS = (PackingError, ProbeError, SampleError, CellTooSmallError, UnstableMotionError, RunGivenUpError)
"""What ends the DEM's part with a sentence."""


class Stopped(Exception):
    """The user asked to stop; what was computed is on disk and is used when the comparison is asked for again."""


class DemStore:
    """DEM results in a folder, one set a seed.

    File names carry a hash of everything that decides the motion: the options and the sources of the DEM. Of what was
    measured the notes tell the sources themselves.

    Parameters
    ----------
    folder : Path
        Made if missing.
    particles : int
    clock : callable
        Seconds; one that stands still while compiling gives times that do not depend on the cache.
    """

    def __init__(self, folder: Path, particles: int, clock: Callable[[], float] = time.perf_counter) -> None:
        self.folder = folder
        self._clock = clock
        self.particles = particles
        folder.mkdir(parents=True, exist_ok=True)
        content = [loading_options(loading).fingerprint() for loading in (*LOADINGS, *PATHS)]
        content += [str(particles), sources_mark(motion_only=True)]
        self._mark = hashlib.sha256("\n".join(content).encode()).hexdigest()[:10]

    def path(self, seed: int, name: str) -> Path:
        """File of one seed."""
        return self.folder / f"{self.particles}_disks_seed_{seed}_{self._mark}_{name}"

    def complete(self, seed: int, report: Report, stop: Callable[[], bool]) -> SeedResult:
        """All results of a seed; what is missing is computed, what was begun is finished.

        Raises
        ------
        Stopped
        RunGivenUpError
            If a packing does not carry a loading to its end.
        """
        notes = self.notes(seed)
        result = SeedResult(seed, self._packing(seed, notes, report, stop))
        if "measured" not in notes:
            report("measuring the inputs of the point law", 0.5)
            result.computed = True
            with self._timed(notes, "measuring"):
                notes["measured"] = as_data(measure_inputs(result.packing))
            self._write_notes(seed, notes)
        result.measured = from_data(notes["measured"])
        if "probes" not in notes:
            report("finite stress probes", 0.55)
            result.computed = True
            with self._timed(notes, "probes"):
                notes["probes"] = dem_probes(result.packing)
            self._write_notes(seed, notes)
        result.probes = notes["probes"]
        for place, loading in enumerate((*LOADINGS, *PATHS)):
            result.runs[loading] = self._run(seed, loading, result, notes, report, stop, 0.6 + 0.1 * place)
        result.seconds = notes["seconds"]
        result.computed = result.computed or bool(notes.pop("computed", False))
        return result

    def _packing(self, seed: int, notes: dict[str, Any], report: Report, stop: Callable[[], bool]) -> Sample:
        path = self.path(seed, "packing.npz")
        with suppress(SampleError):
            kept = load_sample(path)
            if is_at_rest(kept):
                return kept

        def watched(text: str, fraction: float) -> None:
            report(text, 0.5 * fraction)
            if stop():
                raise Stopped

        notes["computed"] = True
        notes["seconds"] = {}
        with self._timed(notes, "packing"):
            packing = make_packing(self.particles, seed, progress=watched)
        save_sample(path, packing)
        return packing

    def _run(
        self,
        seed: int,
        loading: str,
        result: SeedResult,
        notes: dict[str, Any],
        report: Report,
        stop: Callable[[], bool],
        begin: float,
    ) -> DemRun:
        options, path = loading_options(loading), self.path(seed, f"{loading}.npz")
        try:
            run = DemRun.resume(path, options)
        except SampleError:  # none yet, or cut off
            run = DemRun(result.packing, options)
            notes["seconds"].pop(loading, None)
        if run.finished:
            return self._whole(seed, loading, run)
        notes["computed"] = True
        with self._timed(notes, loading):
            run.execute(
                lambda state: report(title_of(loading), begin + 0.1 * state.completed_fraction()),
                stop,
                checkpoint=path,
            )
        files.write_text(self.path(seed, f"{loading}.csv"), history_text(run))
        self._write_notes(seed, notes)
        if not run.finished:
            raise Stopped
        return self._whole(seed, loading, run)

    def _whole(self, seed: int, loading: str, run: DemRun) -> DemRun:
        if run.reason:
            raise RunGivenUpError(
                f"packing of {self.particles} disks, seed {seed}, {title_of(loading)}: {run.reason} (what it reached "
                f"is in {self.path(seed, f'{loading}.csv')})"
            )
        return run

    def notes(self, seed: int) -> dict[str, Any]:
        """What is known about a packing besides its files; nothing that was measured by other sources."""
        with suppress(OSError, ValueError):
            notes = files.read_json(self.path(seed, "notes.json"))
            if isinstance(notes, dict) and isinstance(notes.get("seconds"), dict):
                if notes.get("sources") != sources_mark():
                    for name in ("measured", "probes"):
                        notes.pop(name, None)
                        notes["seconds"].pop({"measured": "measuring"}.get(name, name), None)
                return notes
        return {"seconds": {}}

    def _write_notes(self, seed: int, notes: dict[str, Any]) -> None:
        kept = {name: value for name, value in notes.items() if name != "computed"}
        files.write_json(self.path(seed, "notes.json"), {**kept, "sources": sources_mark()})

    @contextmanager
    def _timed(self, notes: dict[str, Any], name: str) -> Iterator[None]:
        since = self._clock()
        yield
        notes["seconds"][name] = notes["seconds"].get(name, 0.0) + self._clock() - since


def complete_seed(
    folder: Path, particles: int, seed: int, report: Callable[[float], None], stop: Callable[[], bool]
) -> tuple[str, bool]:
    """All results of a seed in the folder, as a piece of work of its own.

    Parameters
    ----------
    folder : Path
    particles, seed : int
    report, stop : callable

    Returns
    -------
    failure : str
        Why they are not there, if so.
    computed : bool
        Rather than read.
    """
    with watching(lambda: None) as watch:
        store = DemStore(folder, particles, watch.clock)
        try:
            result = store.complete(seed, lambda text, fraction: report(fraction), stop)
        except Stopped:
            return "", True
        except DEM_ERRORS as error:
            return str(error), True
    return "", result.computed
