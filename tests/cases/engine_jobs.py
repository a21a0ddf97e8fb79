"""What the tests of the engines have done: importable by workers too."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path


def squared(number: int, report: Callable, stop: Callable) -> int:
    return number * number


def refused(number: int, report: Callable, stop: Callable) -> int:
    raise ArithmeticError(f"{number} is odd")


def no_disk(number: int, report: Callable, stop: Callable) -> int:
    raise OSError(28, "No space left on device", "history.csv")


def killed_once(folder: str, report: Callable, stop: Callable) -> str:
    """Ends its process as the system does for want of memory, the first time that it is called."""
    mark = Path(folder) / "begun"
    if not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


def killed_always(report: Callable, stop: Callable) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def waiting(folder: str, name: str, report: Callable, stop: Callable) -> str:
    """Works until it is asked to stop, half done; leaves its process number."""
    (Path(folder) / name).write_text(str(os.getpid()))
    for _ in range(600):
        if stop():
            return "stopped"
        report(0.5)
        time.sleep(0.05)
    return "finished"


def patient(folder: str, report: Callable, stop: Callable) -> str:
    """Is killed from outside the first time, while it works."""
    mark = Path(folder) / "pid"
    if mark.exists():
        return "again"
    mark.write_text(str(os.getpid()))
    time.sleep(60.0)
    return "undisturbed"


def threads(report: Callable, stop: Callable) -> tuple[int, str]:
    import numba

    return numba.get_num_threads(), os.environ.get("OPENBLAS_NUM_THREADS", "")
