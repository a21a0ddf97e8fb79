"""Processor time of short and long calls on a machine that others use too."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numba

SHORTEST = 0.02
"""A call is repeated until it lasts this long [s], far above the resolution of the clock."""
LONG = 1.0
"""A call that lasts longer [s] averages over disturbances by itself and is made once."""


def best_of(calls: Sequence[Callable[[], object]], rounds: int, tick: Callable[[int], None]) -> list[float]:
    """Least processor time [s] of each call over interleaved rounds.

    The rounds go over all calls in turn, so that a slow minute of the machine does not hit one setting alone. Time of
    the process, not of the wall clock: what others compute meanwhile is not counted.

    Parameters
    ----------
    calls : sequence of callable
        Warm: nothing left to compile or load.
    rounds : int
    tick : callable
        Called with the number of finished calls, of ``rounds * len(calls)``.
    """
    best = [math.inf] * len(calls)
    repetitions = [1] * len(calls)
    done = 0
    for _ in range(rounds):
        for index, call in enumerate(calls):
            if not LONG < best[index] < math.inf:
                seconds = _time(call, repetitions[index])
                if seconds * repetitions[index] < SHORTEST:
                    repetitions[index] = math.ceil(1.2 * SHORTEST / max(seconds, 1e-7))
                    seconds = _time(call, repetitions[index])
                best[index] = min(best[index], seconds)
            done += 1
            tick(done)
    return best


def _time(call: Callable[[], object], repetitions: int) -> float:
    start = time.process_time()
    for _ in range(repetitions):
        call()
    return (time.process_time() - start) / repetitions


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread for the kernels inside the block, so that times of different sizes compare."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before)
