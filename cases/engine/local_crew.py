"""Parts that are held by processes of this machine."""

from __future__ import annotations

from collections.abc import Mapping
from multiprocessing.connection import wait
from typing import Any

from granfabric.cases.errors import RunError

from .jobs import Job, Stop, WorkerLost
from .local import POLL_SECONDS, Worker
from .parts import Fractions, Part, Question

NAME = "part"


class LocalCrew:
    """A process for each part; a context manager that ends them.

    Parameters
    ----------
    workers : int
    part : Part
        How every one of them begins.
    threads : int
        Of each process.
    """

    def __init__(self, workers: int, part: Part, threads: int = 1) -> None:
        self.workers = workers
        self.text = f"{workers} process{'es' if workers > 1 else ''} of this machine"
        self._part, self._threads = part, threads
        self._crew: list[Worker] = []

    def __enter__(self) -> LocalCrew:
        """Begin all processes, side by side.

        Raises
        ------
        RunError
            If one ends while its part is made.
        """
        self._crew = [Worker(self._threads) for _ in range(self.workers)]
        try:
            self._make(range(self.workers), lambda: False)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._crew:
            worker.end()

    def _make(self, places: Any, stop: Stop) -> None:
        arguments = (NAME, self._part, self._threads)
        job = Job("hold", "a part of the work", "granfabric.cases.engine.parts:hold", arguments, self._part.kernels)
        found = self._done(dict.fromkeys(places, job), lambda fractions: None, stop)
        if len(found) < len(places):
            raise RunError("a process ended by itself while it was begun; was there memory enough?")

    def ask(self, questions: Mapping[int, Question], advance: Fractions, stop: Stop) -> dict[int, Any]:
        """See `Crew`."""
        jobs = {
            place: Job("ask", method, "granfabric.cases.engine.parts:ask", (NAME, method, arguments))
            for place, (method, arguments) in questions.items()
        }
        return self._done(jobs, advance, stop)

    def renew(self, place: int, stop: Stop) -> None:
        """See `Crew`."""
        self._crew[place].end()
        self._crew[place] = Worker(self._threads)
        self._make([place], stop)

    def _done(self, jobs: Mapping[int, Job], advance: Fractions, stop: Stop) -> dict[int, Any]:
        """What came of jobs, one a worker; of those nothing whose process ended."""
        for place, job in jobs.items():
            self._crew[place].begin(job)
        at_work, found = dict.fromkeys(jobs, 0.0), dict[int, Any]()
        lost: set[int] = set()
        while len(found) + len(lost) < len(jobs):
            if stop():
                for place in jobs:
                    self._crew[place].ask_to_stop()
            places = {id(self._crew[place].connection): place for place in jobs if self._crew[place].job}
            for connection in wait([self._crew[place].connection for place in places.values()], POLL_SECONDS):
                place = places[id(connection)]
                ended = self._crew[place].hear()
                at_work[place] = self._crew[place].fraction
                if ended is None:
                    continue
                if isinstance(ended.error, WorkerLost):
                    lost.add(place)
                elif ended.error is not None:
                    raise ended.error
                else:
                    found[place], at_work[place] = ended.value, 1.0
            advance(at_work)
        return found
