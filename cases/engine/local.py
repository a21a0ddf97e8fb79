"""Jobs side by side in processes of this machine, with progress, and an end at any time without loss."""

from __future__ import annotations

import signal
import sys
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from types import ModuleType
from typing import Any

from . import kernels, machine
from .jobs import ATTEMPTS, Advance, Ended, Follow, Job, Stop, WorkerLost, call, portable

POLL_SECONDS = 0.1
"""Least time between two looks at whether to stop, and between two reports."""


class Here:
    """This process alone, one job after the other.

    Parameters
    ----------
    threads : int
        For the compiled kernels of a job.
    """

    workers = 1

    def __init__(self, threads: int = 1) -> None:
        self.threads = threads
        self.text = "one process"

    def carry_out(self, first: Iterable[Job], follow: Follow, advance: Advance, stop: Stop) -> None:
        """See `Engine`."""
        ready = deque(first)
        with machine.threads(self.threads):
            while ready and not stop():
                job = ready.popleft()
                advance({job.text: 0.0})

                def report(fraction: float, text: str = job.text) -> None:
                    advance({text: fraction})

                try:
                    ended = Ended(call(job, report, stop))
                except Exception as error:
                    ended = Ended(error=error)
                ready.extendleft(reversed(list(follow(job, ended))))


class Processes:
    """A pool of processes on this machine.

    Parameters
    ----------
    workers : int
    threads : int
        Of each, for compiled kernels.
    """

    def __init__(self, workers: int, threads: int = 1) -> None:
        self.workers, self.threads = workers, threads
        self.text = f"{workers} process{'es' if workers > 1 else ''} side by side"

    def carry_out(self, first: Iterable[Job], follow: Follow, advance: Advance, stop: Stop) -> None:
        """See `Engine`. A job whose process ends by itself is begun once more, in a new process."""
        ready, lost = deque(first), dict[str, int]()
        crew = [Worker(self.threads) for _ in range(min(self.workers, max(2, len(ready))))]
        try:
            while any(worker.job for worker in crew) or (ready and not stop()):
                for place, worker in enumerate(crew):
                    if worker.job is None and ready and not stop():
                        if worker.gone:  # between two jobs
                            worker.end()
                            worker = crew[place] = Worker(self.threads)
                        worker.begin(ready.popleft())
                if stop():
                    for worker in crew:
                        worker.ask_to_stop()
                for connection in wait([worker.connection for worker in crew if worker.job], POLL_SECONDS):
                    place = next(place for place, one in enumerate(crew) if one.connection is connection)
                    job = crew[place].job
                    ended = crew[place].hear()
                    if ended is None or job is None:
                        continue
                    if isinstance(ended.error, WorkerLost):
                        crew[place].end()
                        crew[place] = Worker(self.threads)
                        lost[job.key] = lost.get(job.key, 0) + 1
                        if stop():  # it was told to end as well
                            continue
                        if lost[job.key] < ATTEMPTS:
                            ready.appendleft(job)
                            continue
                    ready.extendleft(reversed(list(follow(job, ended))))
                advance({worker.job.text: worker.fraction for worker in crew if worker.job})
        finally:
            for worker in crew:
                worker.end()


class Worker:
    """A process that does one job after the other; what one of them leaves behind, the next ones find.

    Processes are started anew instead of forked: the compiler's threads do not survive a fork. Ctrl-C is for the
    process that began them; what is at work is asked through its connection.
    """

    def __init__(self, threads: int) -> None:
        context = get_context("spawn")
        self.connection, other = context.Pipe()
        self.process = context.Process(target=_serve, args=(other, threads), daemon=True)
        with _deaf(), machine.environment(threads), _without_main():
            self.process.start()
        other.close()
        self.job: Job | None = None
        self.fraction = 0.0
        self._asked = False

    @property
    def gone(self) -> bool:
        """Whether the process has ended."""
        return not self.process.is_alive()

    def begin(self, job: Job) -> None:
        """Hand over a job; whether it has arrived is heard of later."""
        self.job, self.fraction = job, 0.0
        with suppress(OSError):
            self.connection.send(job)

    def hear(self) -> Ended | None:
        """What the process has to say: progress, or what came of its job, which is then returned."""
        job = self.job
        assert job is not None
        try:
            said: Any = self.connection.recv()
        except (EOFError, OSError):
            self.job = None
            return Ended(error=self._lost(job))
        if isinstance(said, float):
            self.fraction = said
            return None
        self.job = None
        return said

    def ask_to_stop(self) -> None:
        """Ask once; the process answers with what came of its job."""
        if self.job is not None and not self._asked:
            self._asked = True
            with suppress(OSError):
                self.connection.send(None)

    def end(self) -> None:
        """End the process, at once if it is at work."""
        self.connection.close()
        if self.job is not None:
            self.process.terminate()
        self.process.join(5.0)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()

    def _lost(self, job: Job) -> WorkerLost:
        self.process.join(1.0)
        code = self.process.exitcode
        how = f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"
        return WorkerLost(f"{job.text}: the process at work on it ended by itself ({how}; was there memory enough?)")


@contextmanager
def _deaf() -> Iterator[None]:
    """Hold Ctrl-C back while a process is started: the process inherits that, this one hears it afterwards."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _without_main() -> Iterator[None]:
    """Keep a started process from running the user's script again, which would begin everything once more."""
    before = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = before


def _serve(connection: Connection, threads: int) -> None:
    """What a process does: jobs, until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    machine.limit_threads(threads)
    with suppress(EOFError, OSError, KeyboardInterrupt):
        for job in _received(connection):
            connection.send(_answer(job, connection))


def _received(connection: Connection) -> Iterator[Job]:
    while True:
        job = connection.recv()
        if isinstance(job, Job):
            yield job


def _answer(job: Job, connection: Connection) -> Ended:
    last = [0.0, 0.0]
    asked = [False]

    def report(fraction: float) -> None:
        now = time.monotonic()
        if now - last[0] > POLL_SECONDS:
            last[0] = now
            with suppress(OSError):
                connection.send(float(fraction))

    def stop() -> bool:
        now = time.monotonic()
        if not asked[0] and now - last[1] > POLL_SECONDS:
            last[1] = now
            try:
                asked[0] = connection.poll()  # nothing else is said meanwhile; or the other end is gone
            except OSError:
                asked[0] = True
        return asked[0]

    try:
        kernels.make_ready(job.kernels)
        return Ended(call(job, report, stop))
    except Exception as error:  # handed to whoever asked for the job
        return Ended(error=portable(error, job.text))


