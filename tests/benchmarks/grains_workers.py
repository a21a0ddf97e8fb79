"""Grains at the points of a scene: threads of one process, worker processes, workers of Dask; time and bytes.

    python tests/benchmarks/grains_workers.py run [--rounds 3] [--set KEY=VALUE ...] -o times.csv
    python tests/benchmarks/grains_workers.py bytes [--points 48] [--disks 400]
    python tests/benchmarks/grains_workers.py host [--points 100000] [--workers 1000]

Variants follow each other within a round, so that what else is at work on the machine meets all of them. Wall time of
the whole command and of the law alone, processor time of the command with its processes (not of Dask's workers).
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import pickle
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "cases"))

VARIANTS = {
    "1 process": (("--threads", "1"), {}),
    "2 threads": (("--threads", "2"), {}),
    "2 threads, BLAS with 2": (("--threads", "2"), {"OPENBLAS_NUM_THREADS": "2"}),
    "2 processes": (("--workers", "2", "--threads", "1"), {}),
    "2 Dask workers": (("--scheduler", "ADDRESS"), {}),
}


def run(rounds: int, assignments: list[str], output: Path) -> None:
    """Time `granfabric run grains_biaxial` in all variants."""
    from dask_cluster import cluster

    given = [word for text in [*assignments, "output.pictures=false"] for word in ("--set", text)]
    settings = {key: value for key, value in os.environ.items() if key not in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS")}
    with tempfile.TemporaryDirectory() as name, cluster(Path(name), 2) as dask, output.open("a", newline="") as file:
        out = Path(name) / "out"
        writer = csv.writer(file)
        for number in range(rounds):
            for variant, (options, more) in VARIANTS.items():
                options = [dask.address if word == "ADDRESS" else word for word in options]
                command = [sys.executable, "-m", "granfabric", "run", "grains_biaxial", *given, "-q", "--overwrite"]
                before, since = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
                subprocess.run([*command, "-o", str(out), *options], env={**settings, **more}, check=True)
                wall = time.perf_counter() - since
                after = resource.getrusage(resource.RUSAGE_CHILDREN)
                used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
                record = json.loads((out / "run.json").read_text())
                law = record["timing"]["law"]
                calls = record["counters"]["law_calls"]
                row = [" ".join(assignments), number, variant, f"{wall:.2f}", f"{law:.2f}", f"{used:.2f}", calls]
                print(*row, sep=", ", flush=True)
                writer.writerow(row)


def count(points: int, disks: int) -> None:
    """Bytes of what a call says and hears, as they are sent through a pipe."""
    from granfabric.cases.engine.local_crew import LocalCrew
    from granfabric.cases.engine.parts import Part
    from granfabric.cases.grains.law import GrainsLaw
    from granfabric.cases.grains.spread_law import BLOCK, SpreadGrainsLaw
    from granfabric.cases.grains.store import PackingStore
    from granfabric.dem_ref.dynamics.packing import PackingOptions
    from granfabric.dem_ref.measures.contacts import love_weber_stress

    law = GrainsLaw([PackingStore(disks, PackingOptions()).at_rest(seed) for seed in range(1, 9)])
    with LocalCrew(2, Part(BLOCK, law.recipe, ("dem",))) as crew:
        heard = crew.ask

        def ask(questions: dict, advance: object, stop: object) -> dict:
            since = time.perf_counter()
            answers = heard(questions, advance, stop)
            spent = time.perf_counter() - since
            out, back = (sum(len(pickle.dumps(value, 5)) for value in side.values()) for side in (questions, answers))
            method = next(iter(questions.values()))[0]
            print(f"{method}: {out / points:.0f} bytes a point out, {back / points:.0f} back, {spent * 1e3:.1f} ms")
            return answers

        crew.ask = ask  # type: ignore[method-assign,assignment]
        shared = SpreadGrainsLaw(law, crew)
        stress = np.array([love_weber_stress(law.recipe[0][point % 8]) for point in range(points)])
        state = shared.initial_state(stress)
        end, ends, tangent = np.empty_like(stress), np.empty_like(state), np.empty((points, 3, 3))
        for increment in ((0.0, 0.0, 0.0), (3e-6, -1e-5, 4e-6)):
            shared.update(np.tile(increment, (points, 1)), stress, state, end, ends, tangent)
        shared.expanded(ends)


class Echo:
    """Workers that take no time: what is left of a call is what the process of the host does."""

    def __init__(self, workers: int, width: int) -> None:
        self.workers, self.width, self.bytes = workers, width, 0

    def ask(self, questions: dict, advance: object, stop: object) -> dict:
        from granfabric.cases.grains.block import Answer
        from granfabric.cases.grains.law import MEASURES

        answers = {}
        for place, (method, arguments) in questions.items():
            sent = pickle.dumps((method, arguments), 5)
            number = len(arguments[0])
            answer = Answer(
                np.ones((number, 3)), np.ones((number, MEASURES)), np.ones((number, 3, 3)),
                np.zeros(number, dtype=np.int8), np.ones(number, dtype=np.int64),
            )  # fmt: skip
            found = {"advance": answer, "hold": None, "rows": np.ones((number if method == "rows" else 0, self.width))}
            back = pickle.dumps(found[method], 5)
            self.bytes += len(sent) + len(back)
            answers[place] = pickle.loads(back)
        return answers


def host(points: int, workers: int) -> None:
    """Time that the host needs for a call, beside the work at the points."""
    from granfabric.cases.grains.law import MEASURES, GrainsLaw
    from granfabric.cases.grains.spread_law import SpreadGrainsLaw
    from granfabric.cases.grains.store import PackingStore
    from granfabric.dem_ref.dynamics.packing import PackingOptions

    law = GrainsLaw([PackingStore(50, PackingOptions()).at_rest(1)])
    row = law.initial_state(np.array([[-1e5, -1e5, 0.0]]))[0]
    crew = Echo(workers, len(row))
    shared = SpreadGrainsLaw(law, crew)
    state = shared.begin(np.broadcast_to(row, (points, len(row))))
    stress, tangent = np.tile([-1e5, -1e5, 0.0], (points, 1)), np.empty((points, 3, 3))
    end, ends = np.empty_like(stress), np.empty((points, MEASURES + 2))
    increment = np.random.default_rng(1).normal(size=(points, 3)) * 1e-6

    def timed(what: str, call: Callable[[], object]) -> None:
        before, since = crew.bytes, time.perf_counter()
        call()
        print(f"{what}: {time.perf_counter() - since:.2f} s, {(crew.bytes - before) / 1e6:.0f} MB")

    for number in range(6):
        timed(f"call {number + 1}", partial(shared.update, increment, stress, state, end, ends, tangent))
        if number % 2:
            timed("packings of 50 disks", partial(shared.expanded, ends))
            state, ends = ends, state


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("run", "bytes", "host"))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--set", action="append", default=[], dest="assignments")
    parser.add_argument("--points", type=int, default=48)
    parser.add_argument("--disks", type=int, default=400)
    parser.add_argument("--workers", type=int, default=1000)
    parser.add_argument("-o", "--output", type=Path, default=Path("times.csv"))
    asked = parser.parse_args()
    if asked.what == "run":
        run(asked.rounds, asked.assignments, asked.output)
    elif asked.what == "host":
        host(asked.points, asked.workers)
    else:
        count(asked.points, asked.disks)
