"""Compilation is timed and announced only when it happens; Ctrl-C handlers come and go."""

from __future__ import annotations

import signal
import threading

import numba
import pytest

from granfabric.cases.terminal.compile_watch import watching
from granfabric.cases.terminal.interruption import interrupt_request


def test_compilation_is_announced_once_and_timed() -> None:
    announced: list[bool] = []

    @numba.njit
    def inner(x: float) -> float:
        return x + 1.0

    @numba.njit
    def outer(x: float) -> float:
        return inner(x) * 2.0

    with watching(lambda: announced.append(True)) as watch:
        assert outer(1.0) == 4.0
    assert announced == [True]
    # `inner` is compiled while `outer` is: two kernels, but their time counts once.
    assert watch.kernels == 2 and watch.seconds > 0.0
    with watching(lambda: announced.append(True)) as again:
        outer(2.0)
    assert announced == [True] and again.kernels == 0 and again.seconds == 0.0


def test_first_interruption_is_a_wish_and_the_second_is_an_interruption() -> None:
    before = signal.getsignal(signal.SIGINT)
    announced: list[bool] = []
    with interrupt_request(lambda: announced.append(True)) as stop:
        assert not stop()
        signal.raise_signal(signal.SIGINT)
        assert stop() and announced == [True]
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_outside_the_main_thread_nothing_is_caught() -> None:
    before = signal.getsignal(signal.SIGINT)
    seen: list[object] = []

    def work() -> None:
        with interrupt_request(lambda: None) as stop:
            seen.extend([signal.getsignal(signal.SIGINT), stop()])

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [before, False]
