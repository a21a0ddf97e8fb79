"""Which engine a command takes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from granfabric.cases.errors import InputError
from granfabric.cases.terminal.screen import Screen

from .jobs import Engine, Stop
from .local import Here, Processes
from .local_crew import LocalCrew
from .machine import checked_number, checked_threads, cores
from .parts import Crew, Part

MOST_WORKERS = 1000


@dataclass(frozen=True)
class Choice:
    """What was asked for; None for what was not.

    Parameters
    ----------
    workers : int or None
        Processes of this machine; one a core if not given, less if each takes several threads.
    scheduler : str or None
        Address of a scheduler of Dask, whose workers are taken instead.
    threads : int or None
        Of each worker; 1 if not given.
    option : str
        What the number of workers was asked for by.
    """

    workers: int | None = None
    scheduler: str | None = None
    threads: int | None = None
    option: str = "--workers"

    def check(self) -> None:
        """See that what is asked for is legal, and the workers of a scheduler fit.

        Raises
        ------
        InputError
        """
        if self.workers is not None:
            checked_number(self.option, self.workers, MOST_WORKERS)
        if self.threads is not None:
            checked_threads(self.threads)
        if self.scheduler is not None and self.workers is not None:
            raise InputError(
                f"{self.option} is of processes on this machine, --scheduler of workers elsewhere; give one of them"
            )
        if self.scheduler is not None:
            from .cluster import examine

            examine(self.scheduler)

    @contextmanager
    def engine(self, folder: Path, screen: Screen, stop: Stop, jobs: int | None = None) -> Iterator[Engine]:
        """The engine.

        Parameters
        ----------
        folder : Path
            Where jobs keep their results.
        screen : Screen
        stop : callable
        jobs : int, optional
            So many at most, more workers than that are not begun.

        Raises
        ------
        InputError
        """
        threads = self.threads or 1
        if self.scheduler is not None:
            from .cluster import connected

            with connected(self.scheduler, folder, screen, stop, threads) as cluster:
                yield cluster
            return
        workers = self.workers or max(1, cores() // threads)
        if jobs is not None:
            workers = min(workers, max(1, jobs))
        yield Here(threads) if workers == 1 else Processes(workers, threads)

    @contextmanager
    def crew(self, part: Part, most: int, screen: Screen, stop: Stop) -> Iterator[Crew]:
        """Workers that hold a part each.

        Parameters
        ----------
        part : Part
            How each of them begins.
        most : int
            More workers than that are not begun.
        screen : Screen
        stop : callable

        Raises
        ------
        InputError, RunError
        """
        threads = self.threads or 1
        if self.scheduler is not None:
            from . import cluster_crew

            with cluster_crew.crew(self.scheduler, screen, stop, part, most, threads) as distant:
                yield distant
            return
        with LocalCrew(min(self.workers or 1, most), part, threads) as near:
            yield near


def asked_for(workers: int | None, scheduler: str | None, threads: int | None) -> Choice | None:
    """Workers, if any were asked for."""
    return None if workers is None and scheduler is None else Choice(workers, scheduler, threads)
