"""Whether a call may use the compiler's own threads.

They belong to the process that started them: OpenMP ends a forked child that uses them again. And they serve one caller
at a time: the plain pool that numba falls back to ends the process if two Python threads call. Whoever is told no takes
one thread, with the same bits.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numba
from numba.core.compiler_lock import global_compiler_lock

TWO_PAY = 1000
"""Disks from which on two threads pay on a quiet machine (`tests/benchmarks/dem_threads.py`)."""
TRIED_AGAIN = 32
"""Calls after which the number of threads that was slower is tried again."""
TELLING = 20_000
"""Steps times disks from which on the time of a call tells something."""

_in_use = threading.Lock()
_inherited = False


def _after_fork() -> None:
    global _in_use, _inherited
    _in_use = threading.Lock()
    try:
        numba.threading_layer()
    except ValueError:  # not started
        return
    _inherited = True


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
    # A fork while another thread compiles would copy the compiler's lock as held, for ever.
    os.register_at_fork(
        before=global_compiler_lock.acquire,
        after_in_parent=global_compiler_lock.release,
        after_in_child=global_compiler_lock.release,
    )


class Faster:
    """One thread or two, whichever has been faster lately.

    Two are almost twice as fast as one on a quiet machine and slower on one whose cores are taken, since they wait for
    each other twice a step. The bits are the same, so that the choice may change at any call.

    Parameters
    ----------
    count : int
        Disks; below `TWO_PAY` it is always one.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._cost: dict[int, float] = {}
        self._calls = 0

    def choose(self) -> int:
        """1 or 2, for the call that comes."""
        if self._count < TWO_PAY or numba.get_num_threads() < 2:
            return 1
        for threads in (2, 1):
            if threads not in self._cost:
                return threads
        self._calls += 1
        faster = min(self._cost, key=lambda threads: self._cost[threads])
        return 3 - faster if self._calls % TRIED_AGAIN == 0 else faster

    def tell(self, threads: int, steps: int, seconds: float) -> None:
        """What the call took."""
        if steps * self._count >= TELLING:
            self._cost[threads] = seconds / steps


@contextmanager
def two_threads(wanted: bool) -> Iterator[bool]:
    """Whether the block may run a parallel kernel; the threads are its own until it ends."""
    lock = _in_use
    if not wanted or _inherited or not lock.acquire(blocking=False):
        yield False
        return
    try:
        yield True
    finally:
        lock.release()
