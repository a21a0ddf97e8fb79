"""Many runs of a scene from Python: the same folders, tables and sentences as `granfabric sweep`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from granfabric.cases.errors import InputError
from granfabric.cases.records import files
from granfabric.cases.scene.toml_text import value_text

from .results import Results, read_results
from .scenes import _Silent

__all__ = ["SweepResults", "sweep"]


@dataclass(frozen=True)
class SweepResults:
    """What came of a sweep.

    Attributes
    ----------
    folder : Path
        With a folder in it for each run.
    outcome : str
        ``finished``, ``stopped``, or ``failed`` if a run is; the others are there.
    table : DataFrame
        One row a run, indexed by its name: what varies, ``outcome``, ``seconds``, ``message``, and the results.
    """

    folder: Path
    outcome: str
    table: pd.DataFrame

    def read(self, run: str) -> Results:
        """The whole results of a run.

        Raises
        ------
        InputError
            If there is no such run, or nothing of it yet.
        """
        if run not in self.table.index:
            raise InputError(f"{run!r} is no run of the sweep in {str(self.folder)!r}")
        return read_results(self.folder / run)


def sweep(
    scene: str | Path,
    values: Mapping[str, Iterable[Any]] | None = None,
    *,
    table: str | Path | None = None,
    latin: Mapping[str, tuple[float, float]] | None = None,
    samples: int | None = None,
    seed: int | None = None,
    changes: Mapping[str, Any] | None = None,
    results: Sequence[str] = (),
    output: str | Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    threads: int | None = None,
    resume: bool = False,
    overwrite: bool = False,
    progress: Callable[[float, str], None] | None = None,
) -> SweepResults:
    """Run a scene many times with other values, each in a folder of its own.

    Parameters
    ----------
    scene : str or Path
        Shipped name, scene file or folder with one.
    values : mapping of str to iterable, optional
        Values of each key: all combinations.
    table : str or Path, optional
        CSV file with one run a line; its heads are keys.
    latin : mapping of str to (float, float), optional
        Range of each key of a Latin hypercube of `samples` runs.
    samples, seed : int, optional
    changes : mapping of str to value, optional
        Keys that have the same value in all runs.
    results : sequence of str, optional
        Numbers for the table, as `--result` takes them: ``"coordination:at:q/p=0.2"``.
    output : str or Path, optional
        Result folder; ``results/NAME_sweep`` in the working folder if not given.
    workers : int, optional
        Processes side by side; one a core if not given. Results do not depend on them.
    scheduler : str, optional
        Address of a scheduler of Dask, whose workers are taken instead.
    threads : int, optional
        Of each worker; 1 if not given.
    resume : bool
        Take what has finished in the folder, go on with what was begun.
    overwrite : bool
        Replace an earlier sweep in the folder.
    progress : callable, optional
        ``progress(fraction, text)``, called as the runs go on.

    Raises
    ------
    InputError
        If anything about any run is not legal; then nothing was written.
    RunError
        If nobody is left to work.

    Examples
    --------
    >>> import granfabric as gf
    >>> swept = gf.sweep("p_constant", {"material.coordination": [3.9, 4.1]}, output=tmp / "sweep", workers=1)
    >>> swept.table["coordination"].round(3).tolist()
    [3.523, 3.704]
    """
    from granfabric.cases.commands.sweep import Sweep, run_sweep
    from granfabric.cases.engine.choice import Choice
    from granfabric.cases.sweep.plan import Request

    fixed = [f"{key}={value_text(value)}" for key, value in (changes or {}).items()]
    varied = [f"{key}={','.join(map(value_text, each))}" for key, each in (values or {}).items()]
    ranges = [f"{key}={float(low)!r}:{float(high)!r}" for key, (low, high) in (latin or {}).items()]
    request = Request([*fixed, *varied], None if table is None else Path(table), ranges, samples, seed)
    folder = Path("results", f"{Path(scene).stem}_sweep") if output is None else Path(output)
    asked = Sweep(str(scene), request, results, False, Choice(workers, scheduler, threads))
    record = run_sweep(asked, folder, _Silent(progress), resume, overwrite)
    return SweepResults(folder, record.outcome, _table(folder))


def _table(folder: Path) -> pd.DataFrame:
    tables = (files.read_csv(folder / name) for name in ("index.csv", "results.csv"))
    index, found = (pd.DataFrame(table).set_index("run") for table in tables)
    more = found[[name for name in found.columns if name not in index.columns]]
    return index.join(more).replace("", float("nan"))
