"""Packings that points begin as: made once, loaded to their stress, at rest, and kept on disk for the next run.

File names carry a hash of everything that decides the numbers: the options, the stress and the sources of the DEM. A
file that is gone, damaged or of another state of the sources is made anew, with the same bits.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.compilation import kernel_cache_directory
from granfabric.dem_ref.dynamics.packing import PackingOptions
from granfabric.dem_ref.inputs.probes import ProbeError, settled, stress_probe
from granfabric.dem_ref.loading.legs import stress_invariants
from granfabric.dem_ref.measures.contacts import love_weber_stress
from granfabric.dem_ref.preparation.compaction import make_packing
from granfabric.dem_ref.sample.disks import Sample, SampleError, load_sample, save_sample

Array = NDArray[np.float64]

CLOSE = 2e-4
"""Of the pressure: a stress that is this near counts as reached."""


LONGEST = 500_000
"""Steps in which a packing has to reach its stress; those that do take a tenth."""


class NotCarriedError(ValueError):
    """A packing cannot be loaded to a stress; the text says which and why."""


def default_folder() -> Path:
    """Folder of packings beside the compiled kernels of the DEM."""
    return kernel_cache_directory().parent.parent / "packings"


class PackingStore:
    """Packings of one recipe, by seed and stress.

    Parameters
    ----------
    particles : int
    options : PackingOptions
        Their pressure is that of the packings before they are loaded.
    folder : Path, optional
        `default_folder` if not given; one that cannot be written keeps nothing.
    """

    def __init__(self, particles: int, options: PackingOptions, folder: Path | None = None) -> None:
        self.particles = particles
        self.options = options
        self.folder = default_folder() if folder is None else folder
        self.made = 0

    def at_rest(self, seed: int, report: Callable[[str, float], None] | None = None) -> Sample:
        """The packing of a seed under its isotropic pressure, at rest.

        Raises
        ------
        PackingError, ProbeError
            If it does not come to rest.
        """
        return self._kept(seed, None, lambda: settled(make_packing(self.particles, seed, self.options, report)))

    def under(self, seed: int, stress: Array) -> Sample:
        """The packing of a seed loaded to a stress, shape (3,) [Pa], along a straight path, at rest.

        Raises
        ------
        NotCarriedError
            If it flows under that stress.
        """
        base = self.at_rest(seed)
        if self.carries(base, stress):
            return base
        return self._kept(seed, stress, lambda: loaded(base, stress))

    @staticmethod
    def carries(sample: Sample, stress: Array) -> bool:
        """Whether a packing is under a stress."""
        return bool(np.abs(love_weber_stress(sample) - stress).max() <= -CLOSE * 0.5 * (stress[0] + stress[1]))

    def file(self, seed: int, stress: Array | None) -> Path:
        """Where a packing is kept."""
        content = repr((self.particles, sorted(asdict(self.options).items()), kernel_cache_directory().name))
        content += "" if stress is None else repr([float(value).hex() for value in stress])
        mark = hashlib.sha256(content.encode()).hexdigest()[:20]
        return self.folder / f"{self.particles}_disks_seed_{seed}_{mark}.npz"

    def _kept(self, seed: int, stress: Array | None, make: Callable[[], Sample]) -> Sample:
        path = self.file(seed, stress)
        with suppress(SampleError):
            return load_sample(path)
        sample = make()
        self.made += 1
        with suppress(OSError):
            self.folder.mkdir(parents=True, exist_ok=True)
            save_sample(path, sample)
        return sample


class OnePacking:
    """A packing from elsewhere in the place of a store: every seed is this one, and nothing is kept.

    Parameters
    ----------
    sample : Sample
        At rest.
    """

    made = 0

    def __init__(self, sample: Sample) -> None:
        self._sample = sample

    def at_rest(self, seed: int, report: Callable[[str, float], None] | None = None) -> Sample:
        """The packing; see `PackingStore.at_rest`."""
        return self._sample

    def under(self, seed: int, stress: Array) -> Sample:
        """The packing under a stress; see `PackingStore.under`."""
        return self._sample if PackingStore.carries(self._sample, stress) else loaded(self._sample, stress)


def loaded(sample: Sample, stress: Array) -> Sample:
    """A copy of a packing brought to another stress and to rest.

    Raises
    ------
    NotCarriedError
    """
    change = np.asarray(stress, dtype=np.float64) - love_weber_stress(sample)
    # an increment, so that its "pressure" may be of any sign
    dp = -0.5 * float(change[0] + change[1])
    _, dq, angle = stress_invariants(change)
    try:
        after = settled(stress_probe(sample, dp, dq, angle, steps=LONGEST).sample)
    except (ProbeError, SampleError) as error:
        raise NotCarriedError(f"a packing of {sample.count} disks does not carry it: {error}") from error
    if not np.abs(love_weber_stress(after) - stress).max() <= -5.0 * CLOSE * 0.5 * (stress[0] + stress[1]):
        raise NotCarriedError(
            f"a packing of {sample.count} disks comes to rest at {np.round(love_weber_stress(after), 1).tolist()} Pa"
        )
    return replace(after, strain=np.zeros(3))
