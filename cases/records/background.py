"""Files are written by a thread of their own while the run goes on.

Jobs are done in the order in which they came, so that a checkpoint, handed over after the files of its step, vouches
for them. There is room for a few: a disk that is slower than the run holds it up instead of filling the memory. After
an error nothing more is written; the next job, or the end, raises it where the run can tell.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from types import TracebackType

ROOM = 4
"""Jobs that may wait; a step hands over two."""


class BackgroundWriter:
    """Does jobs in a thread; a context manager that leaves nothing undone.

    Attributes
    ----------
    seconds : float
        How long the thread was at work.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self._jobs: queue.Queue[Callable[[], None] | None] = queue.Queue(ROOM)
        self._error: BaseException | None = None
        self._thread: threading.Thread | None = None

    def __enter__(self) -> BackgroundWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.finish()
        else:
            self._join()  # what ended the run is told, not what came after

    def submit(self, job: Callable[[], None]) -> None:
        """Have a job done after those before it; wait while there is no room.

        Raises
        ------
        BaseException
            What an earlier job raised.
        """
        self._raise()
        if self._thread is None:  # now, not before: a process that forks in between has no use for it
            self._thread = threading.Thread(target=self._work, name="granfabric-writer")
            self._thread.start()
        self._jobs.put(job)

    def finish(self) -> None:
        """Wait until all jobs are done.

        Raises
        ------
        BaseException
            What a job raised.
        """
        self._join()
        self._raise()

    def _join(self) -> None:
        if self._thread is not None:
            self._jobs.put(None)
            self._thread.join()
            self._thread = None

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            since = time.perf_counter()
            try:
                if self._error is None:
                    job()
            except BaseException as error:  # told in the thread of the run
                self._error = error
            self.seconds += time.perf_counter() - since
