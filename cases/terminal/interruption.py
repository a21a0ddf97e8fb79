"""Ctrl-C as a request to stop after the step under way, not as an accident."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


class InterruptRequest:
    """Becomes true at the first Ctrl-C; the second one interrupts at once, unless something would be lost by it.

    Attributes
    ----------
    requested : bool
    shielded : bool
        While set, no Ctrl-C interrupts: what was computed is in memory only, and writing it takes a moment.
    """

    def __init__(self, announce: Callable[[], None]) -> None:
        self.requested = False
        self.shielded = False
        self._announce = announce

    def __call__(self) -> bool:
        """Whether to stop after this step."""
        return self.requested

    def _on_signal(self, number: int, frame: Any) -> None:
        if self.requested:
            if self.shielded:
                return
            raise KeyboardInterrupt
        self.requested = True
        self._announce()


@contextmanager
def interrupt_request(announce: Callable[[], None]) -> Iterator[InterruptRequest]:
    """Catch Ctrl-C and a polite kill (SIGINT, SIGTERM) inside the block. Outside the main thread nothing is caught."""
    request = InterruptRequest(announce)
    if threading.current_thread() is not threading.main_thread():
        yield request
        return
    before = {number: signal.signal(number, request._on_signal) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
