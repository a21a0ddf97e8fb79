"""Two threads against one: the bare motion of packings of several sizes, and a whole loading of a large one.

Run with ``python tests/benchmarks/dem_threads.py [count ...]`` on a quiet machine with two cores. One and two threads
take turns; printed are the medians of their times and the ratio. Process time near the wall time says that one thread
is one: libraries with threads of their own (BLAS) would show there.
"""

from __future__ import annotations

import argparse
import time
from statistics import median

import numpy as np

from granfabric.dem_ref.dynamics.motion import Control, Motion
from granfabric.dem_ref.dynamics.packing import make_packing
from granfabric.dem_ref.loading.path import Segment
from granfabric.dem_ref.loading.run import DemRun, RunOptions
from granfabric.dem_ref.sample.disks import Sample

TURNS = 5
DISK_STEPS = 8_000_000
CHUNK = 40
LEVEL = 0.2


def steps(sample: Sample, threads: int) -> tuple[float, float]:
    """Wall and process time of a slow shear, s."""
    motion = Motion(sample.copy(), threads=threads)
    control = Control(drive=np.array([-5e-9, 5e-9, 0.0]))
    motion.run(CHUNK, control)
    wall, process = time.perf_counter(), time.process_time()
    for _ in range(max(1, DISK_STEPS // sample.count // CHUNK)):
        motion.run(CHUNK, control)
    return time.perf_counter() - wall, time.process_time() - process


def loading(sample: Sample, threads: int) -> tuple[float, float]:
    """Wall and process time of a loading to q/p = `LEVEL`, records included, s."""
    run = DemRun(sample, RunOptions((Segment("invariants", stress_ratio=LEVEL),)), threads)
    wall, process = time.perf_counter(), time.process_time()
    run.execute()
    return time.perf_counter() - wall, time.process_time() - process


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", nargs="*", type=int, default=[1000, 5000, 20000])
    for count in parser.parse_args().count:
        sample = make_packing(count, 1)
        for name, measure in (("motion", steps), ("loading to q/p = 0.2", loading)):
            measure(sample, 1), measure(sample, 2)  # compile first
            turns = [(measure(sample, 1), measure(sample, 2)) for _ in range(TURNS)]
            one, two = (median(turn[k][0] for turn in turns) for k in (0, 1))
            spun = median(turn[0][1] / turn[0][0] for turn in turns)
            print(
                f"{count} disks, {name}: {one:.3f} s, {two:.3f} s, ratio {one / two:.2f}; "
                f"process/wall of one {spun:.2f}"
            )


if __name__ == "__main__":
    main()
