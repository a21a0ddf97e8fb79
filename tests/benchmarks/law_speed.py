"""Time of an update of the contact law, of this build beside another one: two processes, taking turns.

    NUMBA_NUM_THREADS=1 python tests/benchmarks/law_speed.py OTHER_CHECKOUT [--points N] [--rounds N] [ROW ...]

Microseconds of the processor a point and update with tangent, medians over the rounds: strain increments of size 1e-6
and 1e-5 from the initial state, and of 1e-5 after four of 5e-6; random points up to q/p = 0.4 at kn/p = 1e4, tolerance
1e-6, one thread.
The other checkout may be one in which the rooms lie directly on the path. In each round every row is timed in one
process right after the other, so that whatever else the machine does falls on both alike. Without a checkout, this
build alone.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parents[2]
COLUMNS = ("1e-6", "1e-5", "1e-5 later")
HISTORY = 4


def room(name: str):
    """A module of the law, by the name it has in this build."""
    if "LAW_SPEED_ROOMS" in os.environ:
        return importlib.import_module(f"constitutive.{name.removeprefix('plain_laws.')}")
    return importlib.import_module(f"granfabric.constitutive.{name}")


def laws() -> dict:
    """The rows of the table."""
    closure, material = room("parameters").Closure, room("parameters").Material
    law, effects = room("law").ContactLaw, room("effects").Effects
    text = (HERE / "cases" / "scenes" / "materials" / "dense_disks.toml").read_text(encoding="utf-8")
    measured = tomllib.loads(text)
    disks, numbers = material(**measured["material"]), measured["closure"]
    source = material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)
    mises = room("plain_laws.von_mises")
    # builds without that memory have no such effect
    has_memory = "tangential_memory" in effects.names()
    forgets = {"tangential_memory": False} if has_memory else {}
    rows = {"dense_disks, memory of slip": law([disks], closure(**numbers))} if has_memory else {}
    return rows | {
        "dense_disks": law([disks], closure(**numbers), effects(**forgets)),
        "dense_disks, self-consistent": law([disks], closure(**{**numbers, "tangential": "self_consistent"})),
        "dense_disks, sliding": law([disks], closure(**numbers), effects(sliding=True, **forgets)),
        "mean field": law([source]),
        "mean field, self-consistent": law([source], closure(tangential="self_consistent")),
        "mean field, maximum entropy": law([source], closure(distribution="maximum_entropy")),
        "mean field, sliding": law([source], None, effects(sliding=True)),
        "fluctuating": law([source], closure(force_change="fluctuating")),
        "fluctuating, self-consistent": law(
            [source], closure(force_change="fluctuating", tangential="self_consistent")
        ),
        "network at rest": law([source], None, effects(contact_loss=False, contact_gain=False)),
        "von Mises": mises.VonMisesLaw(mises.VonMisesMaterial(2e8, 0.2, 1e2, 1e6)),
    }


class Row:
    """One law with its points, at the start and after a history."""

    def __init__(self, law, number: int) -> None:
        rng = np.random.default_rng(0)
        p, angle = 1e5 * rng.uniform(0.5, 2.0, number), rng.uniform(0, 2 * np.pi, number)
        q = p * rng.uniform(0, 0.4, number)
        stress = np.stack([-p - q * np.cos(angle), -p + q * np.cos(angle), -q * np.sin(angle)], axis=1)
        self.law, self.starts = law, []
        state = law.initial_state(stress)
        self.end, self.after, self.tangent = np.zeros_like(stress), np.zeros_like(state), np.zeros((number, 3, 3))
        direction = rng.uniform(-1.0, 1.0, (number, 3))
        self.starts += [(1e-6 * direction, stress, state), (1e-5 * direction, stress, state)]
        for _ in range(HISTORY):
            increment = 5e-6 * (direction + 0.3 * rng.uniform(-1.0, 1.0, (number, 3)))
            end, after = np.zeros_like(stress), np.zeros_like(state)
            law.update(increment, stress, state, end, after)
            stress, state = end, after
        self.starts.append((1e-5 * direction, stress, state))

    def seconds(self) -> list[float]:
        """Processor time of an update from each of the starts, a point."""
        out = []
        for increment, stress, state in self.starts:
            # the other build has had the caches meanwhile
            few = slice(200)
            outputs = self.end[few], self.after[few], self.tangent[few]
            self.law.update(increment[few], stress[few], state[few], *outputs)
            begin = time.thread_time()
            self.law.update(increment, stress, state, self.end, self.after, self.tangent)
            out.append((time.thread_time() - begin) / len(stress))
        return out


def serve(number: int, names: list[str]) -> None:
    """Answer each line, the name of a row, by its times."""
    rows = {name: Row(law, number) for name, law in laws().items() if name in names}
    for row in rows.values():
        row.seconds()
    print("ready", flush=True)
    for line in sys.stdin:
        print(json.dumps(rows[line.strip()].seconds()), flush=True)


class Build:
    """A process with one build."""

    def __init__(self, checkout: Path | None, number: int, names: list[str]) -> None:
        environment = dict(os.environ)
        if checkout is not None and (checkout / "api").is_dir():
            # ahead of an installed package of that name
            self.links = tempfile.TemporaryDirectory()
            package = Path(self.links.name, "granfabric")
            package.mkdir()
            for name in ("constitutive", "fem", "dem_ref", "cases"):
                (package / name).symlink_to(checkout / name)
            (package / "__init__.py").touch()
            environment["PYTHONPATH"] = self.links.name
        elif checkout is not None:
            environment["PYTHONPATH"], environment["LAW_SPEED_ROOMS"] = str(checkout), "1"
        command = [sys.executable, __file__, "--serve", "--points", str(number), *names]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment, cwd=checkout or HERE
        )
        self.times: dict[str, list[list[float]]] = {name: [] for name in names}

    def wait(self) -> None:
        """Until it has compiled what it needs."""
        if self.process.stdout.readline().strip() != "ready":
            raise SystemExit("the process of a build has ended")

    def time(self, name: str) -> None:
        """One round of a row."""
        self.process.stdin.write(name + "\n")
        self.process.stdin.flush()
        self.times[name].append(json.loads(self.process.stdout.readline()))

    def median(self, name: str) -> list[float]:
        """Microseconds of each column."""
        return [1e6 * statistics.median(column) for column in zip(*self.times[name])]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", help="checkout of the other build, then rows")
    parser.add_argument("--points", type=int, default=4000)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--serve", action="store_true")
    given = parser.parse_intermixed_args()
    words = list(given.words)
    if given.serve:
        serve(given.points, words)
        return
    other = Path(words.pop(0)).resolve() if words and Path(words[0]).is_dir() else None
    names = words or list(laws())
    builds = [Build(None, given.points, names)] + ([Build(other, given.points, names)] if other else [])
    for build in builds:
        build.wait()
    for _ in range(given.rounds):
        for name in names:
            for build in builds:
                build.time(name)
    print("us an update with tangent: this build" + ("; the other; how many times faster" if other else ""))
    print(f"{'':32s}" + "".join(f"{column:>{26 if other else 12}s}" for column in COLUMNS))
    for name in names:
        cells = []
        for values in zip(*(build.median(name) for build in builds)):
            text = "".join(f"{value:9.3f}" for value in values)
            cells.append(text + (f"{values[1] / values[0]:8.1f}" if other else "   "))
        print(f"{name:32s}" + "".join(cells))


if __name__ == "__main__":
    main()
