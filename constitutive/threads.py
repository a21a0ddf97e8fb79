"""Threads over ranges of points or elements, for kernels that release the interpreter's lock.

Plain threads rather than a parallel loop of the compiler: they cost no compilation, and every point is computed by the
same machine code whatever the number of threads, so results are equal to the last bit. They also survive a fork: the
threads of a parallel loop belong to OpenMP, which ends a forked child that uses them again.

The calling thread works, too, and helpers only join in. A call therefore never waits for a helper that has not begun,
whoever else keeps the pool busy, and needs none where no thread can be started.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import pairwise
from typing import Any

import numba
from numba.core.compiler_lock import global_compiler_lock

FEWEST_POINTS = 2048
"""Points below which a second thread costs more than it saves."""

FEWEST_CHEAP_POINTS = 8192
"""The same for points that cost some ten nanoseconds."""

RANGES_OF_A_THREAD = 4
"""Several ranges a thread even out points that cost more than others."""


class _Pool:
    """The helpers of this process, as many as numba may use threads, less the one that calls."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._executor: ThreadPoolExecutor | None = None

    def submit(self, work: Callable[[], None]) -> None:
        """Call for a helper; nobody comes if threads can no longer be started, as at the interpreter's end."""
        with suppress(RuntimeError):
            with self._lock:
                if self._executor is None:
                    number = max(1, numba.config.NUMBA_NUM_THREADS - 1)  # type: ignore[attr-defined]
                    self._executor = ThreadPoolExecutor(number, thread_name_prefix="granfabric")
            self._executor.submit(work)


_pool = _Pool()


def _renew_pool() -> None:
    """In a forked child: the pool was copied without its threads, its lock perhaps while it was held."""
    global _pool
    _pool = _Pool()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew_pool)
    # A fork while another thread compiles would copy the compiler's lock as held, for ever.
    os.register_at_fork(
        before=global_compiler_lock.acquire,
        after_in_parent=global_compiler_lock.release,
        after_in_child=global_compiler_lock.release,
    )


class _Ranges:
    """The ranges still to be done, from which all threads of a call take."""

    def __init__(self, kernel: Callable[..., Any], number: int, count: int, arguments: tuple[Any, ...]) -> None:
        bounds = [number * i // count for i in range(count + 1)]
        self._left = deque(pairwise(bounds))
        self._kernel = kernel
        self._arguments = arguments
        self._change = threading.Condition()
        self._helping = 0
        self._closed = False
        self._error: BaseException | None = None

    def work(self) -> None:
        """Take ranges until none is left."""
        while True:
            try:
                first, end = self._left.popleft()
            except IndexError:
                return
            self._kernel(first, end, *self._arguments)

    def help(self) -> None:
        """What a helper does, who may come late; an error leaves nothing to the others."""
        with self._change:
            if self._closed:
                return
            self._helping += 1
        try:
            self.work()
        except BaseException as error:
            self._left.clear()
            self._error = error
        finally:
            with self._change:
                self._helping -= 1
                self._change.notify_all()

    def close(self) -> BaseException | None:
        """Leave nothing to do and wait until nobody writes any more; the first error, or interruption of the wait."""
        interruption: BaseException | None = None
        while True:
            try:
                self._closed = True
                self._left.clear()
                with self._change:
                    while self._helping:
                        self._change.wait()
                return self._error or interruption
            except BaseException as caught:  # Ctrl-C: helpers end with the range that they are at
                interruption = interruption or caught


def run_in_threads(
    kernel: Callable[..., Any], number: int, arguments: tuple[Any, ...], fewest: int = FEWEST_POINTS
) -> None:
    """Call ``kernel(first, end, *arguments)`` over ranges that cover 0 ... number - 1.

    The number of threads is that of `numba.get_num_threads`, so `NUMBA_NUM_THREADS` limits it. Nothing is written any
    more when the call returns, also when it is interrupted: then what was written is incomplete.

    Parameters
    ----------
    kernel : callable
        Releases the interpreter's lock; writes to what belongs to its range alone.
    number : int
    arguments : tuple
    fewest : int
        Points for which a second thread pays.
    """
    # not asked where there is no choice: the answer starts the threads of the compiler
    threads = min(numba.get_num_threads(), number // fewest) if number >= 2 * fewest else 1
    if threads <= 1:
        kernel(0, number, *arguments)
        return
    ranges = _Ranges(kernel, number, RANGES_OF_A_THREAD * threads, arguments)
    try:
        for _ in range(threads - 1):
            _pool.submit(ranges.help)
        ranges.work()
    except BaseException:
        ranges.close()
        raise
    error = ranges.close()
    if error is not None:
        raise error
