"""Tasks side by side in processes of one thread each, with progress, and an end at any time without loss."""

from __future__ import annotations

import os
import signal
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import Any

from granfabric.cases.errors import RunError

from .tasks import Done, Task, carry_out

POLL_SECONDS = 0.1
"""Least time between two looks at whether to stop, and between two reports."""

Advance = Callable[[dict[str, float]], None]
"""Told the tasks at work, with the fraction of each that is done."""


def cores() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def carry_out_all(
    first: Iterable[Task],
    follow: Callable[[Task, Done], Iterable[Task]],
    processes: int,
    advance: Advance,
    stop: Callable[[], bool],
) -> None:
    """Do all tasks, and those that follow from them.

    Parameters
    ----------
    first : iterable of Task
    follow : callable
        Told each task that is done and what came of it; gives the tasks that can be done now, which come next.
    processes : int
        1 for this process alone.
    advance : callable
    stop : callable
        Asked all the time; when true, tasks under way are asked to stop, which keeps what they have reached.

    Raises
    ------
    RunError
        If a process ended by itself, for want of memory perhaps.
    OSError
        If results cannot be written.
    """
    ready = deque(first)
    if processes == 1:
        _alone(ready, follow, advance, stop)
        return
    crew = [_Worker() for _ in range(min(processes, max(2, len(ready))))]
    try:
        while any(worker.task for worker in crew) or (ready and not stop()):
            for worker in crew:
                if worker.task is None and ready and not stop():
                    worker.begin(ready.popleft())
            if stop():
                for worker in crew:
                    worker.ask_to_stop()
            for connection in wait([worker.connection for worker in crew if worker.task], POLL_SECONDS):
                worker = next(one for one in crew if one.connection is connection)
                task = worker.task
                try:
                    done = worker.hear()
                except RunError:
                    if not stop():  # else it was told to end as well
                        raise
                    worker.task = done = None
                if done is not None and task is not None:
                    ready.extendleft(reversed(list(follow(task, done))))
            advance({worker.task.text: worker.fraction for worker in crew if worker.task})
    finally:
        for worker in crew:
            worker.end()


def _alone(
    ready: deque[Task], follow: Callable[[Task, Done], Iterable[Task]], advance: Advance, stop: Callable[[], bool]
) -> None:
    while ready and not stop():
        task = ready.popleft()
        advance({task.text: 0.0})

        def report(fraction: float, text: str = task.text) -> None:
            advance({text: fraction})

        ready.extendleft(reversed(list(follow(task, carry_out(task, report, stop)))))


class _Worker:
    """A process that does one task after the other.

    Processes are started anew instead of forked: the compiler's threads do not survive a fork. Ctrl-C is for the
    process that began them; what is at work is asked through its connection.
    """

    def __init__(self) -> None:
        context = get_context("spawn")
        self.connection, other = context.Pipe()
        self.process = context.Process(target=_serve, args=(other,), daemon=True)
        with _deaf():
            self.process.start()
        other.close()
        self.task: Task | None = None
        self.fraction = 0.0
        self._asked = False

    def begin(self, task: Task) -> None:
        """Hand over a task."""
        self.task, self.fraction = task, 0.0
        try:
            self.connection.send(task)
        except OSError as error:
            raise self._gone(task) from error

    def hear(self) -> Done | None:
        """What the process has to say: progress, or that it has done its task, which is then returned."""
        task = self.task
        try:
            said: Any = self.connection.recv()
        except (EOFError, OSError) as error:
            raise self._gone(task) from error
        if isinstance(said, float):
            self.fraction = said
            return None
        self.task = None
        if isinstance(said, BaseException):
            raise said
        return said

    def ask_to_stop(self) -> None:
        """Ask once; the process answers with what came of its task."""
        if self.task is not None and not self._asked:
            self._asked = True
            with suppress(OSError):
                self.connection.send(None)

    def end(self) -> None:
        """End the process, at once if it is at work."""
        self.connection.close()
        if self.task is not None:
            self.process.terminate()
        self.process.join(5.0)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()

    def _gone(self, task: Task | None) -> RunError:
        self.process.join(1.0)
        at, code = "" if task is None else f" at {task.text}", self.process.exitcode
        return RunError(f"a process ended by itself{at} (exit code {code}; was there memory enough?)")


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


def _serve(connection: Connection) -> None:
    """What a process does: tasks, until the other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(EOFError, OSError, KeyboardInterrupt):
        for task in _received(connection):
            connection.send(_answer(task, connection))


def _received(connection: Connection) -> Iterator[Task]:
    while True:
        task = connection.recv()
        if isinstance(task, Task):
            yield task


def _answer(task: Task, connection: Connection) -> Done | BaseException:
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
        return carry_out(task, report, stop)
    except Exception as error:  # handed to whoever asked for the task
        return error if isinstance(error, OSError) else RuntimeError(f"{task.text}: {error!r}")
