"""Speed of the DEM: particle-steps a second in shear, and the time from nothing to a measured loading.

Run with ``NUMBA_NUM_THREADS=1 python tests/benchmarks/dem_speed.py [count ...]``. For scale, one core, packings of this
kind, million particle-steps a second: LAMMPS (2D, Hooke with history) 8.8 at 20,000 disks and 12.4 at 5,000, LAMMPS
`granular` 5, YADE 0.8-2.5.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from granfabric.dem_ref.dynamics.motion import Control, Motion
from granfabric.dem_ref.dynamics.packing import make_packing
from granfabric.dem_ref.loading.path import biaxial_test
from granfabric.dem_ref.loading.run import DemRun, RunOptions
from granfabric.dem_ref.measures.contacts import coordination_number


def million_particle_steps(motion: Motion, seconds: float = 2.0) -> float:
    """Million particle-steps a second of a packing sheared slowly, best of three."""
    control = Control(drive=np.array([1.0e-9, -1.0e-9, 0.0]))
    count = motion.sample.count
    best = 0.0
    for _ in range(3):
        done = 0
        start = time.perf_counter()
        while time.perf_counter() - start < seconds / 3:
            done += motion.run(200, control)
        best = max(best, 1e-6 * done * count / (time.perf_counter() - start))
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", nargs="*", type=int, default=[5000, 20000])
    arguments = parser.parse_args()
    DemRun(make_packing(100, 1), RunOptions(tuple(biaxial_test(stress_ratio=0.05)))).execute()  # compile first
    for count in arguments.count:
        start = time.perf_counter()
        sample = make_packing(count, 1)
        packed = time.perf_counter() - start
        z = coordination_number(sample)
        print(
            f"{count} disks: packed in {packed:.1f} s, void ratio {sample.void_ratio:.4f}, "
            f"z {z.without_rattlers:.3f} without rattlers, {z.all_particles:.3f} with"
        )
        print(f"  {million_particle_steps(Motion(sample.copy())):.1f} million particle-steps a second")
        for path in ("constant_pressure", "constant_lateral_stress"):
            run = DemRun(sample, RunOptions(tuple(biaxial_test(path))))
            start = time.perf_counter()
            run.execute()
            seconds = time.perf_counter() - start
            h = run.history()
            print(
                f"  {path} to q/p = 0.3: {seconds:.1f} s, {run.motion.steps_done} steps, largest inertial number "
                f"{h['inertial_number'].max():.1e}, largest unbalanced force {h['unbalanced_force'].max():.1e}"
            )


if __name__ == "__main__":
    main()
