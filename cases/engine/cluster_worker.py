"""What a worker of Dask does for a job. Nothing here is called by the process that hands jobs over."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from . import kernels, machine
from .jobs import Ended, Job, call, portable
from .parts import Part

_stopped: set[str] = set()
"""Sessions that were asked to stop."""
_fit: set[str] = set()
"""Sessions for which this process was found fit."""


@dataclass(frozen=True)
class Terms:
    """What workers have to agree with.

    Attributes
    ----------
    session : str
        Tells the commands that use a cluster apart.
    token : str
        File that holds the session, in the folder of the results; empty while there is none.
    versions : dict of str to str
        As of `machine.versions`.
    threads : int
        Of compiled kernels.
    report_seconds : float
        Least time between two reports of a job; what is done before the first costs nobody a message.
    """

    session: str
    token: str
    versions: dict[str, str]
    threads: int
    report_seconds: float = 1.0


class UnfitError(RuntimeError):
    """A worker does not agree with the terms."""


def refusal(terms: Terms, worker: Any) -> str:
    """Why a worker, that of this process, is not fit; empty if it is."""
    side_by_side = worker.state.nthreads
    if side_by_side != 1:
        return (
            f"{side_by_side} jobs at a time in one process, whose compiled kernels and lock would quarrel; start "
            "workers with --nthreads 1, and more of them with --nworkers"
        )
    other = machine.differences(terms.versions, machine.versions())
    if other:
        return f"{', '.join(other)}; install the same everywhere"
    if not terms.token:
        return ""
    for attempt in range(5):
        try:
            if Path(terms.token).read_text() == terms.session:
                return ""
        except OSError:
            time.sleep(0.2 * attempt)  # shared file systems take a moment
    return f"it does not see the folder {str(Path(terms.token).parent)!r}; results lie on a file system that all share"


def examination(terms: Terms) -> Callable[[], dict[str, str]]:
    """A function that is sent as it is, so that a worker without this program can answer too."""
    token, session, versions, threads = terms.token, terms.session, terms.versions, terms.threads

    def examine(dask_worker: Any = None) -> dict[str, str]:  # Dask hands over the worker by this name
        try:
            from granfabric.cases.engine import cluster_worker, machine
        except ImportError as error:
            return {"refusal": f"granfabric is not installed there ({error}); install the same everywhere"}
        agreed = cluster_worker.Terms(session, token, versions, threads)
        said = cluster_worker.refusal(agreed, dask_worker)
        return {"refusal": said, "processor": machine.versions()["processor"]}

    return examine


def stopping(terms: Terms) -> Callable[[], None]:
    """A function that asks the jobs of a session to stop."""
    session = terms.session

    def ask() -> None:
        from granfabric.cases.engine import cluster_worker

        cluster_worker._stopped.add(session)

    return ask


def perform(job: Job, key: str, terms: Terms) -> Ended:
    """Do a job.

    Raises
    ------
    UnfitError
    """
    from distributed import get_worker

    worker, session = get_worker(), terms.session
    if session not in _fit:
        why = refusal(terms, worker)
        if why:
            raise UnfitError(f"worker {worker.address}: {why}")
        _fit.add(session)
    last = time.monotonic()

    def report(fraction: float) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last > terms.report_seconds:
            last = now
            worker.log_event(f"granfabric-{session}", (key, float(fraction)))

    def stop() -> bool:
        return session in _stopped

    try:
        kernels.make_ready(job.kernels)
        with machine.threads(terms.threads):
            return Ended(call(job, report, stop))
    except Exception as error:
        return Ended(error=portable(error, job.text))


class HeldPart:
    """A part of something that this worker keeps, as an actor; see `parts`.

    Raises
    ------
    UnfitError
    """

    def __init__(self, place: int, terms: Terms) -> None:
        from distributed import get_worker

        self._worker: Any = get_worker()
        self._place, self._terms = place, terms
        why = refusal(terms, self._worker)
        if why:
            raise UnfitError(why)
        self._part: Any = None

    def make(self, part: Part) -> Ended:
        """Make the part, which is sent here directly."""
        try:
            kernels.make_ready(part.kernels)
            with machine.threads(self._terms.threads):
                self._part = part.make(self._terms.threads)
            return Ended()
        except Exception as error:
            return Ended(error=portable(error, "a part of the work"))

    def ask(self, method: str, arguments: tuple[Any, ...]) -> Ended:
        """Call a method of the part."""
        last, topic = time.monotonic(), f"granfabric-{self._terms.session}"

        def report(fraction: float) -> None:
            nonlocal last
            now = time.monotonic()
            if now - last > self._terms.report_seconds:
                last = now
                self._worker.log_event(topic, (self._place, float(fraction)))

        def stop() -> bool:
            return self._terms.session in _stopped

        try:
            with machine.threads(self._terms.threads):
                return Ended(getattr(self._part, method)(*arguments, report, stop))
        except Exception as error:
            return Ended(error=portable(error, method))
