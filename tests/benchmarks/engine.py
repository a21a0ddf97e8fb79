"""What the engines cost: time and bytes a task, and how well two workers share the work of `granfabric verify`.

    python tests/benchmarks/engine.py tasks [N]         # N empty tasks, by processes and by workers of Dask
    python tests/benchmarks/engine.py map [PARTICLES]   # the map of all materials, by one worker and by two

Made for a machine that others use too: times are processor time of each process, not of the clock. The time that two
workers would take alone on two cores is that of the busier worker plus that of the process that hands out the work,
as if nothing of it overlapped. The scheduler's rate is what one core gives: tasks over its own processor time.
"""

from __future__ import annotations

import os
import pickle
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "cases"))
sys.path.insert(0, str(Path(__file__).resolve().parent))

from granfabric.cases.engine.choice import Choice
from granfabric.cases.engine.jobs import Ended, Job, call
from granfabric.cases.engine.local import Processes
from granfabric.cases.terminal.screen import Screen

TICK = os.sysconf("SC_CLK_TCK")


def timed(job: Job, report: Callable, stop: Callable) -> tuple[Any, int, float, int]:
    """A job with the process that did it, the processor time of that process so far, and the bytes that go back."""
    value = call(job, report, stop)
    return value, os.getpid(), time.process_time(), len(pickle.dumps(Ended(value)))


class Timed:
    """An engine whose jobs are timed."""

    def __init__(self, engine: Any) -> None:
        self.engine, self.workers, self.text = engine, engine.workers, engine.text
        self.processors: dict[int, float] = {}
        self.jobs = self.sent = self.returned = 0

    def carry_out(self, first: Any, follow: Any, advance: Any, stop: Any) -> None:
        def wrapped(job: Job) -> Job:
            self.jobs += 1
            self.sent += len(pickle.dumps(job))
            return replace(job, function="engine:timed", arguments=(job,))

        def unwrapped(job: Job, ended: Ended) -> Iterator[Job]:
            (inner,) = job.arguments
            if ended.error is None:
                value, process, seconds, size = ended.value
                self.processors[process] = seconds
                self.returned += size
                ended = Ended(value)
            return map(wrapped, follow(inner, ended))

        self.engine.carry_out(map(wrapped, first), unwrapped, advance, stop)


def one_map(workers: int, particles: int, folder: Path) -> tuple[Timed, float, float]:
    """A map by so many workers: engine, processor time of this process for handing out, time of the clock."""
    from granfabric.cases.commands import verify_map

    made: list[Timed] = []

    class Mine(Choice):
        @contextmanager
        def engine(self, *arguments: Any) -> Iterator[Any]:
            made.append(Timed(Processes(workers)))
            yield made[0]

    request = verify_map.MapRequest(None, "all", (), False, particles, 2, Mine())
    plan = request.plan()
    folder.mkdir()
    own, clock = time.process_time(), time.perf_counter()
    verify_map._compute(plan, folder, Mine(), Screen(quiet=True), lambda: False)
    return made[0], time.process_time() - own, time.perf_counter() - clock


def map_(particles: int = 400) -> None:
    with tempfile.TemporaryDirectory() as place:
        one_map(2, 200, Path(place) / "warm")
        took = {}
        for workers in (1, 2):
            engine, own, clock = one_map(workers, particles, Path(place) / str(workers))
            each = sorted(engine.processors.values())
            took[workers] = each[-1] + own
            print(
                f"{workers} worker(s): {engine.jobs} tasks, {clock:.1f} s of the clock, workers "
                f"{', '.join(f'{value:.1f}' for value in each)} s, handing out {own:.1f} s; longest way "
                f"{took[workers]:.1f} s; {engine.sent / engine.jobs / 1e3:.1f} kB sent and "
                f"{engine.returned / engine.jobs / 1e3:.1f} kB returned a task"
            )
        print(f"two workers are {took[1] / took[2]:.2f} times as fast as one")


def processor_time(process: int) -> float:
    """Of a process so far [s]."""
    words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / TICK


def tasks(number: int = 2000) -> None:
    jobs = [Job(f"run_{n:06d}", f"run_{n:06d}", "engine_jobs:squared", (n,)) for n in range(number)]
    print(f"{len(pickle.dumps(jobs[0]))} bytes sent and {len(pickle.dumps(Ended(1)))} returned a task, as pickled")
    for workers in (1, 2):
        own, clock = time.process_time(), time.perf_counter()
        engine = Timed(Processes(workers))
        engine.carry_out(jobs, lambda job, ended: [], lambda work: None, lambda: False)
        own, clock = time.process_time() - own, time.perf_counter() - clock
        each, here = 1e3 * clock / number, 1e3 * own / number
        print(f"{workers} process(es): {each:.2f} ms of the clock a task, {here:.2f} ms here")
    from dask_cluster import cluster

    with tempfile.TemporaryDirectory() as place, cluster(Path(place), 2) as dask:
        scheduler = dask.processes[0].pid
        with Choice(scheduler=dask.address).engine(Path(place), Screen(quiet=True), lambda: False) as engine:
            engine.carry_out(jobs[:50], lambda job, ended: [], lambda work: None, lambda: False)
        with Choice(scheduler=dask.address).engine(Path(place), Screen(quiet=True), lambda: False) as engine:
            own, clock, busy = time.process_time(), time.perf_counter(), processor_time(scheduler)
            before = loopback()
            engine.carry_out(jobs, lambda job, ended: [], lambda work: None, lambda: False)
            moved = loopback() - before
            own, clock = time.process_time() - own, time.perf_counter() - clock
            busy = processor_time(scheduler) - busy
        print(
            f"Dask, 2 workers: {1e3 * clock / number:.2f} ms of the clock a task, {1e3 * own / number:.2f} ms here, "
            f"{1e3 * busy / number:.2f} ms of the scheduler: it saturates at {number / busy:.0f} tasks a second; "
            f"{moved / number / 1e3:.1f} kB over the network a task, all ways together"
        )


def loopback() -> int:
    """Bytes over the network of this machine with itself, of everybody."""
    line = next(line for line in Path("/proc/net/dev").read_text().splitlines() if line.strip().startswith("lo:"))
    return int(line.split(":")[1].split()[0])


if __name__ == "__main__":
    what = {"tasks": tasks, "map": map_}[sys.argv[1]]
    what(*map(int, sys.argv[2:3]))
