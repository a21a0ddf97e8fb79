"""Ctrl-C as a request to stop after the step under way, not as an accident."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

_asked: ContextVar[Callable[[], bool] | None] = ContextVar("asked", default=None)
"""Who is asked whether to stop, of a run that is one of several and has no terminal of its own."""


class InterruptRequest:
    """Becomes true at the first Ctrl-C; the second one interrupts at once, unless something would be lost by it.

    Attributes
    ----------
    shielded : bool
        While set, no Ctrl-C interrupts: what was computed is in memory only, and writing it takes a moment.
    """

    def __init__(self, announce: Callable[[], None], asked: Callable[[], bool] | None = None) -> None:
        self._requested = False
        self.shielded = False
        self._announce = announce
        self._asked = asked

    @property
    def requested(self) -> bool:
        """Whether somebody asked to stop."""
        if not self._requested and self._asked is not None:
            self._requested = self._asked()
        return self._requested

    def __call__(self) -> bool:
        """Whether to stop after this step."""
        return self.requested

    def _on_signal(self, number: int, frame: Any) -> None:
        if self._requested:
            if self.shielded:
                return
            raise KeyboardInterrupt
        self._requested = True
        self._announce()


@contextmanager
def asked_of(stop: Callable[[], bool]) -> Iterator[None]:
    """Let runs within the block stop when `stop` says so, and leave Ctrl-C to whoever began them."""
    token = _asked.set(stop)
    try:
        yield
    finally:
        _asked.reset(token)


@contextmanager
def interrupt_request(announce: Callable[[], None]) -> Iterator[InterruptRequest]:
    """Catch Ctrl-C and a polite kill (SIGINT, SIGTERM) inside the block.

    Outside the main thread, and where another is asked (`asked_of`), nothing is caught.
    """
    asked = _asked.get()
    request = InterruptRequest(announce, asked)
    if asked is not None or threading.current_thread() is not threading.main_thread():
        yield request
        return
    before = {number: signal.signal(number, request._on_signal) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield request
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
