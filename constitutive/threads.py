"""Threads over ranges of points, for kernels that release the interpreter's lock.

Plain threads rather than a parallel loop of the compiler: they cost no compilation, and every point is computed by the
same machine code whatever the number of threads, so results are equal to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import Any

import numba

FEWEST_POINTS = 2048
"""Points below which a second thread costs more than it saves."""


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(thread_name_prefix="granfabric")


def run_in_threads(kernel: Callable[..., Any], number: int, arguments: tuple[Any, ...]) -> None:
    """Call ``kernel(first, end, *arguments)`` over ranges that cover 0 ... number - 1.

    The number of threads is that of `numba.get_num_threads`, so `NUMBA_NUM_THREADS` limits it. Several ranges a thread
    even out points that cost more than others.
    """
    threads = min(numba.get_num_threads(), number // FEWEST_POINTS)
    if threads <= 1:
        kernel(0, number, *arguments)
        return
    ranges = 4 * threads
    bounds = [number * i // ranges for i in range(ranges + 1)]
    futures = [_pool().submit(kernel, first, end, *arguments) for first, end in pairwise(bounds)]
    for future in futures:
        future.result()
