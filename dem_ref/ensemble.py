"""Several samples of the same kind: packings kept on disk, runs side by side, mean and scatter of their curves."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.dynamics.packing import PackingOptions
from granfabric.dem_ref.inputs.probes import is_at_rest
from granfabric.dem_ref.loading.run import at_stress_ratios
from granfabric.dem_ref.preparation.compaction import make_packing
from granfabric.dem_ref.sample.disks import Sample, SampleError, load_sample, save_sample

from .arrays import whole

Result = TypeVar("Result")
MOST_THREADS = 10_000


def stored_packing(
    folder: str | Path,
    count: int,
    seed: int,
    options: PackingOptions | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Sample:
    """The packing of `make_packing`, read from `folder` when it is there, else made and stored.

    The file's name carries a hash of the options; a damaged file, or one whose packing is not at
    rest, is made anew.
    """
    options = options or PackingOptions()
    options.check()
    given = {name: value for name, value in asdict(options).items() if value is not None}
    mark = hashlib.sha256(json.dumps(given, sort_keys=True).encode()).hexdigest()[:10]
    path = Path(folder) / f"packing_{count}_{seed}_{mark}.npz"
    if path.exists():
        try:
            stored = load_sample(path)
            if is_at_rest(stored):
                return stored
        except SampleError:
            pass
        path.unlink()
    sample = make_packing(count, seed, options, progress)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_sample(path, sample)
    return sample


def for_seeds(function: Callable[[int], Result], seeds: Sequence[int], threads: int = 1) -> list[Result]:
    """``[function(seed) for seed in seeds]`` with several Python threads; compiled code of the DEM holds no lock.

    Results are in the order of `seeds` and do not depend on `threads`. The first error is raised.
    """
    threads = whole("threads", threads, 1, MOST_THREADS)
    if threads == 1:
        return [function(seed) for seed in seeds]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, seeds))


@dataclass(frozen=True)
class Scatter:
    """Mean, standard deviation between samples and number of samples that reached each level."""

    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]
    samples: NDArray[np.int64]


def scatter_at_stress_ratios(
    histories: Sequence[dict[str, NDArray[np.float64]]], levels: Sequence[float]
) -> dict[str, Scatter]:
    """Every column of the histories at each q/p: mean and scatter over those samples that reached it."""
    if not histories:
        raise SampleError("no histories to compare")
    tables = [at_stress_ratios(history, levels) for history in histories]
    result = {}
    for name in tables[0]:
        values = np.array([table[name] for table in tables])
        reached = np.isfinite(values)
        number = reached.sum(axis=0)
        mean = np.where(reached, values, 0.0).sum(axis=0) / np.maximum(number, 1)
        square = (np.where(reached, values - mean, 0.0) ** 2).sum(axis=0) / np.maximum(number - 1, 1)
        result[name] = Scatter(
            np.where(number > 0, mean, np.nan), np.where(number > 1, np.sqrt(square), np.nan), number
        )
    return result
