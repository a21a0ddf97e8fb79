"""A scheduler of Dask with workers, as somebody else would run it: processes of their own, ended with the test."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from distributed import Client

HERE = Path(__file__).resolve().parent
SECONDS = 60.0


class Cluster:
    """Its address; workers can be added."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.processes: list[subprocess.Popen] = []
        log = self._begin("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        self.address = self._found(log, r"Scheduler at:\s+(tcp://[\d.:]+)")

    def _begin(self, *words: str) -> Path:
        log = self.folder / f"dask_{len(self.processes)}.log"
        paths = os.pathsep.join([str(HERE), *filter(None, [os.environ.get("PYTHONPATH")])])
        settings = {**os.environ, "PYTHONPATH": paths, "DASK_DISTRIBUTED__WORKER__DAEMON": "True"}
        with log.open("w") as file:
            command = [sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:]]
            self.processes.append(
                subprocess.Popen(
                    command, cwd=self.folder, env=settings, stdout=file, stderr=file, start_new_session=True
                )
            )
        return log

    def _found(self, log: Path, pattern: str, times: int = 1) -> str:
        since = time.monotonic()
        while time.monotonic() - since < SECONDS:
            found = re.findall(pattern, log.read_text())
            if len(found) >= times:
                return found[0]
            time.sleep(0.1)
        raise AssertionError(log.read_text())

    def add_workers(self, number: int, threads: int = 1, *more: str) -> subprocess.Popen:
        """Workers, in processes that are begun anew if they end."""
        words = (self.address, "--nworkers", str(number), "--nthreads", str(threads), "--no-dashboard", *more)
        log = self._begin("worker", *words)
        self._found(log, r"Registered to:", number)
        return self.processes[-1]

    def threads(self) -> list[int]:
        """Of each worker."""
        with Client(self.address, set_as_default=False) as client:
            return list(client.nthreads().values())

    def kill(self, process: subprocess.Popen) -> None:
        """End a process and those that it began, at once."""
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    def end(self) -> None:
        """End all of it."""
        for process in self.processes:
            self.kill(process)


@contextmanager
def cluster(folder: Path, workers: int = 2) -> Iterator[Cluster]:
    """A cluster that ends with the block."""
    made = Cluster(folder)
    try:
        if workers:
            made.add_workers(workers)
        yield made
    finally:
        made.end()
