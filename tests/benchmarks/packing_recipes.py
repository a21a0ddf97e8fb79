"""Two recipes for the same packings: relaxed alone, at pressures lowered little by little, or settled in the end.

Run with ``NUMBA_NUM_THREADS=1 python tests/benchmarks/packing_recipes.py [--count 2500] [--seeds 24] [--first 1001]``:
a quarter of an hour. Every packing is made twice from the same seed, measured, and loaded to q/p = 0.3 at constant
pressure. Printed are means over the seeds of both recipes with standard errors, and the mean of the differences with
its own. ``--times`` makes packings only, turn by turn, and prints processor times.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from granfabric.dem_ref.dynamics import packing as made
from granfabric.dem_ref.dynamics.packing import PackingOptions, make_packing
from granfabric.dem_ref.dynamics.relaxation import relax
from granfabric.dem_ref.inputs.material import measure_fabric, measure_material
from granfabric.dem_ref.loading.path import Segment
from granfabric.dem_ref.loading.run import DemRun, RunOptions
from granfabric.dem_ref.measures.contacts import contacts_of, coordination_number
from granfabric.dem_ref.sample.disks import Sample
from granfabric.dem_ref.sample.neighbours import find_near_pairs

OVERPRESSURE, PRESSURE_FACTOR = 10.0, 0.7
IDLE = 1e-4
"""Force over the mean force of a contact below which it carries nothing: a disk without load that leans on another."""
LEVELS = (0.1, 0.2, 0.3)
CURVES = {"z": "coordination", "a_c": "fabric_anisotropy", "a_n": "normal_force_anisotropy"}


def relaxed_packing(count: int, seed: int, options: PackingOptions | None = None) -> Sample:
    """From ten times the pressure downwards, the last pressure relaxed to the tolerance of `make_packing`."""
    options = options or PackingOptions()
    random = np.random.default_rng(seed)
    radius = 0.5 * made.random_diameters(count, options, random)
    width = np.sqrt(np.pi * np.sum(radius**2) / made.INITIAL_SOLID_FRACTION)
    cell = width * np.eye(2)
    position, radius = made.in_spatial_order(random.random((count, 2)) * width, radius, cell)
    relax(position, radius, cell, 0.0, tolerance=made.LOOSE_TOLERANCE, steps=2000, fixed_cell=True)
    final = 1.0 / options.stiffness_to_pressure
    pressure = OVERPRESSURE * final
    while True:
        last = pressure <= final
        position, radius = made.in_spatial_order(position, radius, cell)
        found = relax(
            position, radius, cell, final if last else pressure,
            made.TIGHT_TOLERANCE if last else made.LOOSE_TOLERANCE, 400_000 if last else 20_000,
        )  # fmt: skip
        if last:
            break
        pressure *= PRESSURE_FACTOR
    if not found.converged:
        raise RuntimeError(f"{count} disks, seed {seed}: not at rest")
    position, radius = made.in_spatial_order(position, radius, cell)
    return Sample(
        position, radius, cell, options.normal_stiffness, options.stiffness_ratio, options.friction,
        np.zeros((count, 2)), np.zeros(count), find_near_pairs(position, radius, cell, 0.03), seed=seed,
    )  # fmt: skip


RECIPES: dict[str, Callable[[int, int], Sample]] = {"relaxed": relaxed_packing, "settled": make_packing}


def measured(sample: Sample) -> dict[str, float]:
    """Everything by which two packings are compared."""
    z = coordination_number(sample)
    force = contacts_of(sample).normal_force
    idle = 2.0 * np.count_nonzero(force < IDLE * force.mean()) / sample.count
    found = {
        "z, all disks": z.all_particles, "z, without rattlers": z.without_rattlers, "rattlers": z.rattler_fraction,
        "z of idle contacts": idle, "solid fraction": sample.solid_fraction,
    }  # fmt: skip
    material = measure_material(sample)
    del material["coordination"]  # z over all disks
    found |= {name.replace("_", " "): value for name, value in material.items()}
    found["initial a_c"] = float(np.hypot(*(entry.value for entry in measure_fabric(sample))))
    run = DemRun(sample, RunOptions((Segment(stress_ratio=LEVELS[-1]),)))
    run.execute()
    history = run.history()
    ratio = history["q"] / history["p"]
    for level in LEVELS:
        for title, column in CURVES.items():
            found[f"{title} at q/p = {level}"] = float(np.interp(level, ratio, history[column]))
    found["shear strain at q/p = 0.3"] = float((history["strain_xx"] - history["strain_yy"])[-1])
    return found


def table(results: dict[str, dict[str, dict[str, float]]]) -> str:
    """Means with standard errors, and of the differences of packings from the same seed."""
    old, new = (results[name] for name in RECIPES)
    both = [seed for seed in old if seed in new]
    lines = [f"| {len(both)} packings | relaxed | settled | difference |", "|---|---|---|---|"]
    for name in old[both[0]]:
        a, b = (np.array([each[seed].get(name, np.nan) for seed in both]) for each in (old, new))
        here = np.isfinite(a) & np.isfinite(b)
        a, b = a[here], b[here]
        if len(a) < 2 or (a == b).all():
            continue
        few = "" if here.all() else f" ({len(a)} packings)"
        d = b - a
        cells = (f"{np.mean(v):.5g} ± {np.std(v, ddof=1) / np.sqrt(len(v)):.1g}" for v in (a, b))
        mean, error = np.mean(d), np.std(d, ddof=1) / np.sqrt(len(d))
        lines.append(f"| {name}{few} | {' | '.join(cells)} | {mean:+.2g} ± {error:.1g} ({mean / error:+.1f}) |")
    return "\n".join(lines)


def times(count: int, seeds: range) -> None:
    """Processor time of both recipes, turn by turn."""
    taken = []
    for seed in seeds:
        row = []
        for make in RECIPES.values():
            start = time.process_time()
            make(count, seed)
            row.append(time.process_time() - start)
        taken.append(row)
        print(f"{count} disks, seed {seed}: relaxed {row[0]:.2f} s, settled {row[1]:.2f} s", flush=True)
    old, new = np.mean(taken, axis=0)
    print(f"{count} disks: relaxed {old:.2f} s, settled {new:.2f} s, ratio of the sums {old / new:.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2500)
    parser.add_argument("--seeds", type=int, default=24)
    parser.add_argument("--first", type=int, default=1001)
    parser.add_argument("--times", action="store_true")
    parser.add_argument("--keep", type=Path, help="JSON file of results; what is there is not computed again")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    for make in RECIPES.values():
        make(100, 1)  # compile first
    if arguments.times:
        times(arguments.count, seeds)
        return
    results: dict[str, dict[str, dict[str, float]]] = {name: {} for name in RECIPES}
    if arguments.keep and arguments.keep.exists():
        results = json.loads(arguments.keep.read_text())
    for seed in seeds:
        for name, make in RECIPES.items():
            if str(seed) not in results[name]:
                results[name][str(seed)] = measured(make(arguments.count, seed))
        if arguments.keep:
            arguments.keep.write_text(json.dumps(results))
    print(table(results))


if __name__ == "__main__":
    main()
