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

TWO_PAY = 4000
"""Disks from which on two threads are taken where nothing is said; on a quiet machine they pay from 1,000 on, on one
that is busy the waiting for each other grows (`tests/benchmarks/dem_threads.py`)."""

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


def threads_for(count: int) -> int:
    """Threads for a packing of `count` disks where nothing is said: 2 where they pay and may be used, else 1."""
    return 2 if count >= TWO_PAY and numba.get_num_threads() >= 2 else 1


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
