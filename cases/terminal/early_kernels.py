"""The law's kernels compiled by a second process while this one reads, checks and compiles the rest.

Only where the disk cache does not hold them yet. Whatever happens to that process, the law compiles what it does not
find in the cache at its first call.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from granfabric.constitutive import warm_up
from granfabric.constitutive.parameters import ForceChange

POLL_SECONDS = 0.05
COMMAND = ("-P", "-m", "granfabric.constitutive.warm_up")
"""Arguments of the interpreter, before the kernels; -P keeps the working folder out of the search path."""


class EarlyKernels:
    """A second process at work, or none."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def running(self) -> bool:
        """Whether kernels are being compiled elsewhere."""
        return self._process is not None and self._process.poll() is None

    def start(self, kernels: Sequence[ForceChange]) -> None:
        """Start compiling those that the cache does not hold, if a second core is there to do it.

        Parameters
        ----------
        kernels : sequence of str
            Names, see `warm_up`; what is needed first comes first.
        """
        missing = [kernel for kernel in kernels if not warm_up.cached(kernel)]
        if (os.cpu_count() or 1) < 2 or not missing:
            return
        try:
            # A session of its own: Ctrl-C on the terminal is ours to answer.
            self._process = subprocess.Popen(
                [sys.executable, *COMMAND, *missing],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
        except OSError:
            self._process = None

    def wait(self, stop: Callable[[], bool]) -> float:
        """Wait until the kernels are in the cache, the other process has failed, or `stop` says so.

        Returns
        -------
        float
            Seconds waited.
        """
        since = time.perf_counter()
        while self.running and not stop():
            time.sleep(POLL_SECONDS)
        return time.perf_counter() - since

    def end(self) -> None:
        """End the other process if it is still at work."""
        if self._process is not None:
            if self.running:
                self._process.terminate()
            self._process.wait()


@contextmanager
def early_kernels() -> Iterator[EarlyKernels]:
    """A process that can be started in the block and ends with it at the latest."""
    kernels = EarlyKernels()
    try:
        yield kernels
    finally:
        kernels.end()
