"""Ctrl-C as a wish to stop after the step under way, not as an accident."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


class StopWish:
    """Becomes true at the first Ctrl-C; the second one interrupts at once, unless something would be lost by it.

    Attributes
    ----------
    wished : bool
    shielded : bool
        While set, no Ctrl-C interrupts: what was computed is in memory only, and writing it takes a moment.
    """

    def __init__(self, announce: Callable[[], None]) -> None:
        self.wished = False
        self.shielded = False
        self._announce = announce

    def __call__(self) -> bool:
        """Whether to stop after this step."""
        return self.wished

    def _on_signal(self, number: int, frame: Any) -> None:
        if self.wished:
            if self.shielded:
                return
            raise KeyboardInterrupt
        self.wished = True
        self._announce()


@contextmanager
def stop_wish(announce: Callable[[], None]) -> Iterator[StopWish]:
    """Catch Ctrl-C and a polite kill (SIGINT, SIGTERM) inside the block. Outside the main thread nothing is caught."""
    wish = StopWish(announce)
    if threading.current_thread() is not threading.main_thread():
        yield wish
        return
    before = {number: signal.signal(number, wish._on_signal) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield wish
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
