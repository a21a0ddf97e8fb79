"""A study as data: its question, what is varied, and one function that returns rows.

Every row of a study says which series and facet of the picture it belongs to, how large its error is, what it cost in
seconds of processor time and in a count that does not depend on the machine. Further columns are the study's own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Row = dict[str, Any]


class StudyStopped(Exception):
    """The user asked to stop; rows of the study under way are given up."""


class StudyError(RuntimeError):
    """A reference of a study could not be computed; the text says which and why."""


@dataclass(frozen=True)
class Effort:
    """How much work a study may do.

    Parameters
    ----------
    quick : bool
        Few and small settings, for a first look and for tests.
    rounds : int
        Each time is the best of this many rounds over all settings.
    advance : callable
        ``advance(done, total, text)`` reports progress; raises `StudyStopped` if the user asks to stop.
    store : Path
        Folder for what is expensive and may be used again: DEM packings and runs.
    """

    quick: bool = False
    rounds: int = 3
    advance: Callable[[int, int, str], None] = lambda done, total, text: None
    store: Path = Path("results/cost/dem")


@dataclass(frozen=True)
class Column:
    """One column of the table: name, meaning, unit."""

    name: str
    meaning: str
    unit: str = "-"


@dataclass(frozen=True)
class Axes:
    """Labels of a work-precision picture.

    Parameters
    ----------
    error, seconds, count : str
        Axis labels with units.
    facet_titles : dict of str to str
        Title of each facet (a row of panels), in order.
    """

    error: str
    seconds: str
    count: str
    facet_titles: dict[str, str]


@dataclass(frozen=True)
class Study:
    """One work-precision study.

    Parameters
    ----------
    name : str
    title, question : str
    knobs : tuple of (str, str)
        What is varied or fixed, and its values, in words.
    columns : tuple of Column
        Columns of the table, in order.
    rows : callable
        ``rows(effort)`` computes the table.
    draw : callable
        ``draw(path, rows)`` makes the picture.
    findings : callable
        ``findings(rows)`` returns sentences that follow from the numbers.
    """

    name: str
    title: str
    question: str
    knobs: tuple[tuple[str, str], ...]
    columns: tuple[Column, ...]
    rows: Callable[[Effort], list[Row]]
    draw: Callable[[Path, Sequence[Row]], None]
    findings: Callable[[Sequence[Row]], list[str]]


COMMON_COLUMNS = (
    Column("facet", "row of panels in the picture"),
    Column("series", "line in the picture"),
    Column("setting", "what was varied along the line"),
    Column("error", "error against the reference; empty if the setting failed"),
    Column("seconds", "processor time, best of several", "s"),
    Column("count", "cost that does not depend on the machine"),
    Column("on_front", "1 if no other row of the facet is both faster and more accurate"),
    Column("on_front_by_count", "the same with the count instead of the time"),
)
"""What every study has."""
