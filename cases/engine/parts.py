"""Workers that hold a part of something from call to call, where a job alone would have to bring it along every time.

A part is an object that lives in a worker. Its methods are asked side by side; what they are told and what they answer
travels, the part itself does not. A worker that is lost takes its part along: it is made anew as it was at first, and
whoever asks has to bring it up to date.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol

from .jobs import Report, Stop

Question = tuple[str, tuple[Any, ...]]
"""A method of a part and its arguments."""
Fractions = Callable[[Mapping[int, float]], None]
"""Told how far the parts that are asked are with their answers, by their place."""


@dataclass(frozen=True)
class Part:
    """How a part is made.

    Attributes
    ----------
    function : str
        ``module:name`` of what makes it: ``name(*arguments, threads)``.
    arguments : tuple
        Plain enough to be sent.
    kernels : tuple of str
        Groups of compiled kernels that it calls, see `kernels.GROUPS`.
    """

    function: str
    arguments: tuple[Any, ...] = ()
    kernels: tuple[str, ...] = ()

    def make(self, threads: int) -> Any:
        """The part, in the process that holds it."""
        module, _, name = self.function.partition(":")
        return getattr(import_module(module), name)(*self.arguments, threads)


class Crew(Protocol):
    """Workers that hold a part each.

    Attributes
    ----------
    workers : int
        Parts are known by their place in ``range(workers)``.
    text : str
        Who is at work, for the screen.
    """

    workers: int
    text: str

    def ask(self, questions: Mapping[int, Question], advance: Fractions, stop: Stop) -> dict[int, Any]:
        """Ask parts side by side, ``method(*arguments, report, stop)``.

        Parameters
        ----------
        questions : dict of int to (str, tuple)
            By the place of the part.
        advance : callable
        stop : callable
            Asked all the time; when true, the methods at work are told so.

        Returns
        -------
        dict of int to Any
            The answers. A part whose worker was lost gives none.

        Raises
        ------
        Exception
            What a method raised.
        """
        ...

    def renew(self, place: int, stop: Stop) -> None:
        """Have a part made anew by another worker.

        Raises
        ------
        RunError
            If there is none.
        """
        ...


_held: dict[str, Any] = {}
"""Parts of this process, by the name that was given to them."""


def hold(name: str, part: Part, threads: int, report: Report, stop: Stop) -> None:
    """Make a part and keep it; a job."""
    _held[name] = part.make(threads)


def ask(name: str, method: str, arguments: tuple[Any, ...], report: Report, stop: Stop) -> Any:
    """Ask a part that is kept; a job."""
    return getattr(_held[name], method)(*arguments, report, stop)
