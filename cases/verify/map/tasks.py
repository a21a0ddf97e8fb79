"""What a worker does for the map: a packing, its measured inputs, a path of the DEM, the point law along it.

Everything of the DEM is kept on disk and read again; what was begun is finished.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.engine.jobs import Job, Report, Stop
from granfabric.cases.records import files
from granfabric.cases.records.dem_series import history_text
from granfabric.cases.scene.measured import as_data, from_data, measure_inputs
from granfabric.cases.terminal.compile_watch import watching
from granfabric.cases.verify.dem_side import LOADINGS, DemStore, Stopped
from granfabric.cases.verify.model_side import closures
from granfabric.cases.verify.paths import PATHS as TURNING_PATHS
from granfabric.cases.verify.paths import model_columns
from granfabric.constitutive.parameters import ParameterError
from granfabric.dem_ref.compilation import sources_mark
from granfabric.dem_ref.dynamics.motion import UnstableMotionError
from granfabric.dem_ref.dynamics.packing import PackingError, PackingOptions
from granfabric.dem_ref.inputs.probes import ProbeError, is_at_rest
from granfabric.dem_ref.loading.run import DemRun
from granfabric.dem_ref.preparation.compaction import make_packing
from granfabric.dem_ref.sample.disks import Sample, SampleError, load_sample, save_sample
from granfabric.dem_ref.sample.neighbours import CellTooSmallError

from .materials import MapMaterial
from .paths import MAP_PATHS
from .sampling import is_flowing

Array = NDArray[np.float64]

LAW_KERNELS = ("mean_field", "shifted_distribution")
PACKING, INPUTS, LAW, KERNELS = "packing", "inputs", "law", "kernels"
DEM_ERRORS = (PackingError, ProbeError, SampleError, CellTooSmallError, UnstableMotionError)
"""What ends a part of the DEM with a sentence; the others go on."""


@dataclass(frozen=True)
class Task:
    """A piece of work.

    Attributes
    ----------
    folder : Path
        Where the DEM's files are.
    particles : int
    material : MapMaterial
    seed : int
    what : str
        ``packing``, ``inputs``, ``law``, ``kernels``, or the name of a path of the DEM.
    path : str
        law: the path.
    given : dict
        law: the inputs and the history.
    closures : tuple of str
        law, kernels: names of the closures.
    """

    folder: Path
    particles: int
    material: MapMaterial
    seed: int
    what: str
    path: str = ""
    given: dict[str, Any] = field(default_factory=dict)
    closures: tuple[str, ...] = ()

    @property
    def key(self) -> tuple[str, int, str, str]:
        """What tells tasks apart."""
        return self.material.name, self.seed, self.what, self.path

    @property
    def text(self) -> str:
        """For the progress."""
        if self.what == KERNELS:
            return "kernels of the point law"
        what = {PACKING: "packing", INPUTS: "measuring the inputs", LAW: f"point law, {self.path}"}
        return f"{self.material.name}, seed {self.seed}: {what.get(self.what, self.what)}"

    @property
    def job(self) -> Job:
        """As an engine takes it."""
        key = "-".join([slug(self.material.name), str(self.seed), self.what, *([self.path] if self.path else [])])
        kernels = LAW_KERNELS if self.what in (LAW, KERNELS) else ("dem",)
        return Job(key, self.text, f"{__name__}:{carry_out.__name__}", (self,), kernels)


@dataclass
class Done:
    """What came of a task.

    Attributes
    ----------
    values : dict
        packing: ``void_ratio``, ``coordination``; inputs: as `measured.as_data`; a path: ``history`` and ``reason``;
        law: by closure ``columns`` and ``message``.
    failure : str
        Why nothing came of it, in words.
    stopped : bool
        On request; what was reached is on disk.
    computed : bool
        Rather than read.
    seconds, compilation : float
    """

    values: dict[str, Any] = field(default_factory=dict)
    failure: str = ""
    stopped: bool = False
    computed: bool = True
    seconds: float = 0.0
    compilation: float = 0.0


def carry_out(task: Task, report: Report, stop: Stop) -> Done:
    """Do a task.

    Parameters
    ----------
    task : Task
    report : callable
        Told the fraction that is done.
    stop : callable
        Asked whether to stop.

    Raises
    ------
    OSError
        If results cannot be written.
    """
    with watching(lambda: None) as watch:
        since = watch.clock()
        try:
            done = _work(task, report, stop)
        except Stopped:
            done = Done(stopped=True)
        except (*DEM_ERRORS, ParameterError) as error:
            done = Done(failure=str(error))
        done.seconds, done.compilation = watch.clock() - since, watch.seconds
    return done


def _work(task: Task, report: Report, stop: Stop) -> Done:
    if task.what == KERNELS:
        return _compile_law(task)
    if task.what == LAW:
        return _law(task)
    store = MapStore(task.folder, task.particles, task.material, task.seed)
    if task.what == PACKING:
        return store.packing(report, stop)
    if task.what == INPUTS:
        return store.inputs()
    return store.run(task.what, report, stop)


class MapStore:
    """Files of one packing; their names carry a hash of its options and of the sources of the DEM that decide them.

    Packings and paths stay good where only the measuring of inputs has changed; the inputs are then measured again.

    Files of the comparison without a map, on the source's material, are read too.
    """

    def __init__(self, folder: Path, particles: int, material: MapMaterial, seed: int) -> None:
        self.folder, self.particles, self.material, self.seed = folder, particles, material, seed
        folder.mkdir(parents=True, exist_ok=True)
        options = json.dumps(asdict(material.options), sort_keys=True, default=str)
        self._mark = hashlib.sha256((options + sources_mark(motion_only=True)).encode()).hexdigest()[:10]
        self._inputs = f"{sources_mark()[:10]}_inputs.json"
        self._plain = DemStore(folder, particles) if material.options == PackingOptions() else None

    def path(self, name: str) -> Path:
        """File of this packing."""
        return self.folder / f"{slug(self.material.name)}_{self.particles}_disks_seed_{self.seed}_{self._mark}_{name}"

    def _places(self, name: str) -> list[Path]:
        """Where something may be kept."""
        return [self.path(name)] + ([self._plain.path(self.seed, name)] if self._plain else [])

    def kept_packing(self) -> Sample | None:
        """The packing if it is there and at rest."""
        for place in self._places("packing.npz"):
            with suppress(SampleError):
                kept = load_sample(place)
                if is_at_rest(kept):
                    return kept
        return None

    def _given_packing(self) -> Sample:
        kept = self.kept_packing()
        if kept is None:
            raise SampleError("its packing is not there any more")
        return kept

    def packing(self, report: Report, stop: Stop) -> Done:
        """Make the packing, unless it is there."""

        def watched(text: str, fraction: float) -> None:
            report(fraction)
            if stop():
                raise Stopped

        sample = self.kept_packing()
        computed = sample is None
        if sample is None:
            sample = make_packing(self.particles, self.seed, self.material.options, progress=watched)
            save_sample(self.path("packing.npz"), sample)
        return Done({"void_ratio": sample.void_ratio}, computed=computed)

    def inputs(self) -> Done:
        """Measure the inputs of the point law, unless that was done."""
        table: dict[str, Any] = {}
        with suppress(OSError, ValueError):
            table = files.read_json(self.path(self._inputs))
        if not table and self._plain is not None:
            table = self._plain.notes(self.seed).get("measured", {})
        if from_data(table).values:
            return Done(table, computed=False)
        table = as_data(measure_inputs(self._given_packing()))
        files.write_json(self.path(self._inputs), table)
        return Done(table)

    def run(self, name: str, report: Report, stop: Stop) -> Done:
        """Load the packing along a path, unless that was done; go on with what was begun."""
        options = MAP_PATHS[name].options
        run = None
        shared = name in (*LOADINGS, *TURNING_PATHS)
        for place in self._places(f"{name}.npz") if shared else [self.path(f"{name}.npz")]:
            with suppress(SampleError):  # none yet, or cut off
                run = DemRun.resume(place, options)
                break
        if run is None:
            run = DemRun(self._given_packing(), options)
        segments = MAP_PATHS[name].segments
        flowing = [is_flowing(run.history(), segments)]
        computed = not run.finished and not flowing[0]
        if computed:

            def recorded(state: DemRun) -> None:
                flowing[0] = is_flowing(state.history(), segments)

            run.execute(
                lambda state: report(state.completed_fraction()),
                lambda: flowing[0] or stop(),
                recorded,
                checkpoint=self.path(f"{name}.npz"),
            )
            files.write_text(self.path(f"{name}.csv"), history_text(run))
        if not run.finished and not flowing[0]:
            raise Stopped
        return Done({"history": run.history(), "reason": run.message}, computed=computed)


def slug(name: str) -> str:
    """A name as part of a file name."""
    return re.sub(r"[^A-Za-z0-9.=_-]+", "_", name)


def chosen_closures(inputs: Mapping[str, float], names: tuple[str, ...]) -> dict[str, Any]:
    """Those of the closures that are asked for."""
    return {name: closure for name, closure in closures(inputs).items() if name in names}


def _law(task: Task) -> Done:
    """The point law along the recorded stresses, each closure."""
    inputs = from_data(task.given["inputs"]).values
    history = task.given["history"]
    found: dict[str, Any] = {}
    for name in task.closures:
        try:
            closure = chosen_closures(inputs, (name,))[name]
            columns, message = model_columns(closure, inputs, history, MAP_PATHS[task.path].turning)
            message = re.sub(r"^leg \d+, increment [^:]*: ", "", message)  # of records: nothing that a reader knows
        except ParameterError as error:  # of these inputs, before the first step
            columns, message = {}, str(error)
        found[name] = {"columns": columns, "message": message}
    return Done(found)


SOME_INPUTS = {
    "coordination": 4.0, "solid_fraction": 0.84, "normal_stiffness": 1e9, "stiffness_ratio": 1.0,
    "force_density_at_zero": 0.7, "gap_density_at_zero": 300.0, "neighbours": 6.0, "force_anisotropy_ratio": 1.0,
    "bulk_reduction": 0.9, "shear_reduction": 0.5, "isostatic_coordination": 3.0, "weak_contact_ratio": 0.8,
    "weak_contact_ratio_isotropic": 0.7, "elastic_scatter": 0.5, "elastic_scatter_isotropic": 0.4,
    "irreversible_scatter": 2.0, "tangential_force_ratio": 0.8, "slip": 1.0, "slip_delay": 0.7, "fluctuation": 0.5,
}  # fmt: skip
"""Inputs of about the usual size, with which the kernels are called for the first time."""


def _compile_law(task: Task) -> Done:
    """Call the kernels once, so that they are in the disk cache when the law is asked."""
    p = 1e5
    history = {"stress_xx": [-p, -0.99 * p], "stress_yy": [-p, -1.01 * p], "stress_xy": [0.0, 0.0], "p": [p, p]}
    for closure in chosen_closures(SOME_INPUTS, task.closures).values():
        model_columns(closure, SOME_INPUTS, {name: np.array(values) for name, values in history.items()}, False)
    return Done()
