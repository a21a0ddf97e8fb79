"""Ensembles: stored packings, threads, mean and scatter."""

from __future__ import annotations

import numpy as np
import pytest

from granfabric.dem_ref.dynamics.packing import PackingOptions
from granfabric.dem_ref.ensemble import for_seeds, scatter_at_stress_ratios, stored_packing
from granfabric.dem_ref.loading.path import biaxial_test
from granfabric.dem_ref.loading.run import DemRun, RunOptions
from granfabric.dem_ref.sample.disks import SampleError


def test_packing_is_stored_once_per_options(tmp_path):
    calls = []
    a = stored_packing(tmp_path, 100, 3, progress=lambda text, fraction: calls.append(text))
    assert calls and len(list(tmp_path.iterdir())) == 1
    calls.clear()
    b = stored_packing(tmp_path, 100, 3, progress=lambda text, fraction: calls.append(text))
    assert not calls and np.array_equal(a.position, b.position)
    stored_packing(tmp_path, 100, 3, PackingOptions(friction=0.3))
    assert len(list(tmp_path.iterdir())) == 2
    next(tmp_path.iterdir()).write_bytes(b"damaged")
    c = stored_packing(tmp_path, 100, 3)
    assert np.array_equal(a.position, c.position)


def test_threads_do_not_change_the_results(tmp_path):
    def curve(seed: int):
        run = DemRun(stored_packing(tmp_path, 200, seed), RunOptions(tuple(biaxial_test(stress_ratio=0.1))))
        run.execute()
        return np.array(run.rows)

    one, two = for_seeds(curve, [1, 2, 3]), for_seeds(curve, [1, 2, 3], threads=2)
    assert all(np.array_equal(a, b) for a, b in zip(one, two))
    assert not np.array_equal(one[0], one[1])
    with pytest.raises(SampleError, match="threads is 0"):
        for_seeds(curve, [1], threads=0)


def test_scatter_counts_the_samples_that_reached_a_level():
    ratio = np.array([0.0, 0.1, 0.2])
    histories = [
        {"p": np.ones(3), "q": ratio, "z": 4.0 - ratio},
        {"p": np.ones(3), "q": ratio, "z": 4.2 - ratio},
        {"p": np.ones(2), "q": ratio[:2], "z": 4.4 - ratio[:2]},
    ]
    z = scatter_at_stress_ratios(histories, [0.05, 0.15, 0.3])["z"]
    assert z.mean[:2] == pytest.approx([4.15, 3.95])
    assert z.deviation[:2] == pytest.approx([0.2, 0.1 * np.sqrt(2)])
    assert z.samples.tolist() == [3, 2, 0] and np.isnan(z.mean[2])
    with pytest.raises(SampleError, match="no histories"):
        scatter_at_stress_ratios([], [0.1])
