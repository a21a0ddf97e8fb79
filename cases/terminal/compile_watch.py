"""How long compiling takes, and saying so while it happens.

Numba announces each real compilation (not a load from its disk cache), so that the time is exact wherever in a run it
falls.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba.core import event


class CompileWatch(event.Listener):
    """Adds up the time spent compiling and calls `announce` when the first compilation begins."""

    def __init__(self, announce: Callable[[], None]) -> None:
        self.seconds = 0.0
        self.kernels = 0
        self._announce = announce
        self._announced = False
        self._depth = 0
        self._since = 0.0

    def announce(self) -> None:
        """Say that kernels are compiled, unless that was said before."""
        if not self._announced:
            self._announced = True
            self._announce()

    def clock(self) -> float:
        """Seconds, as of a clock that stands still while compiling."""
        return time.perf_counter() - self.seconds

    def on_start(self, event: Any) -> None:
        """Numba begins to compile a function; a function it calls may follow inside."""
        self.announce()
        if self._depth == 0:
            self._since = time.perf_counter()
        self._depth += 1
        self.kernels += 1

    def on_end(self, event: Any) -> None:
        """Numba has compiled a function."""
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._since


@contextmanager
def watching(announce: Callable[[], None]) -> Iterator[CompileWatch]:
    """Watch compilations inside the block."""
    watch = CompileWatch(announce)
    with event.install_listener("numba:compile", watch):
        yield watch
