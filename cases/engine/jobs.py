"""Independent pieces of work and what comes of them: all that an engine knows of what it computes.

A job names an importable function, so that any process of any machine can find it. What it computes it keeps in a
folder; what it returns is small.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol

from granfabric.cases.errors import RunError

Report = Callable[[float], None]
"""Told the fraction of a job that is done."""
Stop = Callable[[], bool]
"""Asked whether to stop."""
Advance = Callable[[dict[str, float]], None]
"""Told the jobs at work, by their text, with the fraction of each that is done."""

ATTEMPTS = 2
"""Times that a job is begun whose worker is lost."""


@dataclass(frozen=True)
class Job:
    """A piece of work.

    Attributes
    ----------
    key : str
        Tells jobs of one command apart.
    text : str
        For the progress, and to speak of it.
    function : str
        ``module:name`` of what is called: ``name(*arguments, report, stop)``. It looks into its folder first, so that
        a job that is begun again goes on where it was.
    arguments : tuple
        Small, and plain enough to be sent.
    kernels : tuple of str
        Groups of compiled kernels that it calls, see `kernels.GROUPS`.
    """

    key: str
    text: str
    function: str
    arguments: tuple[Any, ...] = ()
    kernels: tuple[str, ...] = ()


@dataclass(frozen=True)
class Ended:
    """What came of a job.

    Attributes
    ----------
    value : Any
        What the function returned; None if it did not.
    error : Exception or None
        `WorkerLost` if its worker ended by itself every time, else what the function raised.
    """

    value: Any = None
    error: Exception | None = None


Follow = Callable[[Job, Ended], Iterable[Job]]
"""Told each job that has ended and what came of it; gives the jobs that can be done now, which come next."""


class WorkerLost(RunError):
    """The worker of a job ended by itself, and the next one too."""


class Engine(Protocol):
    """What carries out jobs.

    Attributes
    ----------
    text : str
        What is at work, for the screen.
    workers : int
        Side by side.
    """

    text: str
    workers: int

    def carry_out(self, first: Iterable[Job], follow: Follow, advance: Advance, stop: Stop) -> None:
        """Do all jobs, and those that follow from them.

        Parameters
        ----------
        first : iterable of Job
        follow : callable
        advance : callable
        stop : callable
            Asked all the time; when true, jobs under way are asked to stop and keep what they have reached, and no
            other is begun.

        Raises
        ------
        RunError
            If there is nobody left to work.
        InputError
            If workers are not fit for the work; then nothing was begun.
        """
        ...


def call(job: Job, report: Report, stop: Stop) -> Any:
    """Call the function of a job."""
    module, _, name = job.function.partition(":")
    return getattr(import_module(module), name)(*job.arguments, report, stop)


def portable(error: Exception, text: str) -> Exception:
    """An error that can be sent to another process and raised there: itself if it is of a kind that everybody has."""
    if type(error) in (OSError, MemoryError, FileNotFoundError, PermissionError):
        return error
    if isinstance(error, OSError):
        return OSError(error.errno, error.strerror or str(error), error.filename)
    return RuntimeError(f"{text}: {error!r}")
