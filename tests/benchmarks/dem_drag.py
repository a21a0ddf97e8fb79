"""What the DEM's curves depend on that they must not: drag, loading rate, step.

Run with ``NUMBA_NUM_THREADS=1 python tests/benchmarks/dem_drag.py [--count 5000] [--seeds 3] [--path NAME]``: four
minutes. Every line is the mean over the packings at the end of the path, with the largest difference of any packing's
z and a_c from the usual choice, the steps and the seconds of a loading, what the drag took of the work, and what is
left of the energy balance.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np

from granfabric.dem_ref.dynamics.motion import DAMPING, STEP
from granfabric.dem_ref.dynamics.packing import make_packing
from granfabric.dem_ref.loading.path import Segment
from granfabric.dem_ref.loading.run import DemRun, RunOptions
from granfabric.dem_ref.loading.servo import RateLimits
from granfabric.dem_ref.sample.disks import Sample

PATHS = {
    "constant_pressure": Segment(stress_ratio=0.3),
    "constant_lateral_stress": Segment(path="constant_lateral_stress", stress_ratio=0.3),
    "half_pressure": Segment("invariants", pressure=0.5, stress_ratio=0.3),
    "isotropic_unloading": Segment("invariants", pressure=0.1, stress_ratio=0.0),
}
COLUMNS = (
    ("z", "coordination", "8.3f"), ("z'", "coordination_without_rattlers", "8.3f"),
    ("a_c", "fabric_anisotropy", "8.4f"), ("a_n", "normal_force_anisotropy", "8.4f"),
    ("a_t", "tangential_force_anisotropy", "8.4f"), ("sliding", "sliding_fraction", "8.4f"),
)  # fmt: skip


@dataclass(frozen=True)
class Choice:
    """Factors on the usual drag, limits of the rate, and step."""

    drag: float = 1.0
    rate: float = 1.0
    step: float = 1.0

    def options(self, path: str) -> RunOptions:
        """Of a run along one of `PATHS`."""
        usual = RateLimits()
        limits = RateLimits(self.rate * usual.inertial_number, self.rate * usual.unbalanced_force)
        return RunOptions((PATHS[path],), limits, step=self.step * STEP, damping=self.drag * DAMPING)


CHOICES = (
    Choice(), Choice(drag=10.0), Choice(drag=0.1), Choice(rate=10.0), Choice(rate=0.1), Choice(drag=0.1, rate=0.1),
    Choice(step=0.5), Choice(step=0.25),
)  # fmt: skip


def loaded(sample: Sample, choice: Choice, path: str) -> dict[str, float]:
    """The last record, with strain (eps_1 - eps_2), seconds, and energies over the work."""
    run = DemRun(sample, choice.options(path))
    start = time.perf_counter()
    run.execute()
    history = run.history()
    last = {name: float(column[-1]) for name, column in history.items()}
    last["seconds"] = time.perf_counter() - start
    last["shear"] = last["strain_xx"] - last["strain_yy"]
    stored = last["elastic_energy"] - float(history["elastic_energy"][0])
    kinetic = run.motion.energies()["kinetic"]
    scale = abs(last["work"])
    last["drag"] = last["drag_heat"] / scale
    last["balance"] = (last["work"] - stored - last["friction_heat"] - last["drag_heat"] - kinetic) / scale
    return last


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=5000)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--path", choices=list(PATHS), default="constant_pressure")
    arguments = parser.parse_args()
    packings = [make_packing(arguments.count, seed) for seed in range(1, arguments.seeds + 1)]
    loaded(make_packing(100, 1), Choice(), arguments.path)  # compile first
    head = "".join(f"{title:>8}" for title, *_ in COLUMNS)
    print(f"{arguments.path}, {arguments.seeds} packings of {arguments.count} disks")
    print(f"{'drag':>6}{'rate':>6}{'step':>6}{head}{'1e4 strain':>11}{'dz %':>6}{'da_c':>8}{'steps':>9}{'s':>7}"
          f"{'drag/W':>9}{'left/W':>10}")  # fmt: skip
    usual: list[dict[str, float]] = []
    for choice in CHOICES:
        found = [loaded(sample, choice, arguments.path) for sample in packings]
        usual = usual or found
        mean = {name: float(np.mean([last[name] for last in found])) for name in found[0]}
        off_z = max(abs(a["coordination"] / b["coordination"] - 1.0) for a, b in zip(found, usual))
        off_a = max(abs(a["fabric_anisotropy"] - b["fabric_anisotropy"]) for a, b in zip(found, usual))
        values = "".join(f"{mean[name]:{form}}" for _, name, form in COLUMNS)
        print(f"{choice.drag:6g}{choice.rate:6g}{choice.step:6g}{values}{1e4 * mean['shear']:11.3f}{100 * off_z:6.2f}"
              f"{off_a:8.4f}{mean['dem_steps']:9.0f}{mean['seconds']:7.1f}{mean['drag']:9.1e}{mean['balance']:10.1e}",
              flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
