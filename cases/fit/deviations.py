"""Deviations of the law from the curves in units of their scales, and how they change with the free parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .following import Followed
from .law_side import Answer, LawSide
from .parameters import Free, values_of

Array = NDArray[np.float64]

DIFFERENCE = 1e-4
"""Of a sought number, between two curves whose difference gives the derivative."""
SMALLER = (1.0, 0.03)
"""Factors on it, tried one after the other where the law refuses."""
AT_START = ("mean_normal_force", "strain_xx", "strain_yy", "strain_xy", "volumetric_strain", "shear_strain")
"""Columns that are what they are in the first row by definition."""


class StoppedError(Exception):
    """Somebody asked to stop."""


@dataclass(frozen=True)
class Entry:
    """Where a deviation belongs: curve, column, rows."""

    curve: int
    column: str
    rows: NDArray[np.int64]


class Deviations:
    """Deviations of all curves in one vector, each over its scale times the factor of its column in `factors`.

    Parameters
    ----------
    side : LawSide
    stop : callable
        True ends it with `StoppedError`.
    on_evaluation : callable, optional
        Called after each evaluation.
    """

    def __init__(
        self, side: LawSide, stop: Callable[[], bool], on_evaluation: Callable[[], None] | None = None
    ) -> None:
        self.side, self._stop, self._on_evaluation = side, stop, on_evaluation
        self.entries = [
            Entry(number, name, rows)
            for number, curve in enumerate(side.curves)
            for name in curve.compared
            if (rows := compared_rows(curve, name, side.start)).size
        ]
        self.count = sum(entry.rows.size for entry in self.entries)
        self.factors: dict[str, float] = {}
        self.evaluations = 0

    def of_answers(self, answers: Sequence[Answer]) -> Array:
        """Deviations of given answers; NaN where the law refused."""
        parts = [np.zeros(0)]
        for entry in self.entries:
            curve = self.side.curves[entry.curve]
            law = answers[entry.curve].columns[entry.column][entry.rows]
            scale = self.factors.get(entry.column, 1.0) * curve.scales[entry.column][entry.rows]
            parts.append((law - curve.compared[entry.column][entry.rows]) / scale)
        return np.concatenate(parts)

    def of(self, values: dict[str, float]) -> Array:
        """Deviations for given parameters; NaN where the law refused."""
        if self._stop():
            raise StoppedError
        self.evaluations += 1
        found = self.of_answers(self.side.answers(values, self._stop))
        if self._stop():
            raise StoppedError
        if self._on_evaluation is not None:
            self._on_evaluation()
        return found

    def rms(self, here: Array) -> dict[str, float]:
        """Root mean square of the deviations of each column."""
        squares: dict[str, list[float]] = {}
        begin = 0
        for entry in self.entries:
            squares.setdefault(entry.column, []).extend(here[begin : begin + entry.rows.size] ** 2)
            begin += entry.rows.size
        return {name: float(np.sqrt(np.mean(values))) for name, values in squares.items()}

    def derivative(self, free: Sequence[Free], sought: Array, held: dict[str, float], here: Array) -> Array:
        """Derivatives by the sought numbers, shape (ndeviations, nfree).

        Central differences; one-sided at a bound and beside a place where the law refuses. A number that the law
        refuses to move either way has the derivative zero.
        """
        table = np.zeros((here.size, len(free)))
        for place, entry in enumerate(free):
            for factor in SMALLER:
                column = self._one(free, sought, held, here, place, factor * DIFFERENCE, entry.limits)
                if column is not None:
                    table[:, place] = column
                    break
        return table

    def _one(
        self, free: Sequence[Free], sought: Array, held: dict[str, float], here: Array, place: int, step: float,
        limits: tuple[float, float],
    ) -> Array | None:  # fmt: skip
        ends = []
        for sign in (1.0, -1.0):
            moved = sought.copy()
            moved[place] += sign * step
            if not limits[0] <= moved[place] <= limits[1]:
                continue
            there = self.of(values_of(free, moved, held))
            if np.isfinite(there).all():
                ends.append((moved[place], there))
        if not ends:
            return None
        if len(ends) == 1:
            ends.append((float(sought[place]), here))
        return np.asarray((ends[0][1] - ends[1][1]) / (ends[0][0] - ends[1][0]))


def compared_rows(curve: Followed, name: str, start: str) -> NDArray[np.int64]:
    """Rows of a column in which the law can deviate: measured, and not given by what is prescribed at the start."""
    rows = np.flatnonzero(np.isfinite(curve.compared[name]))
    by_row = start == "row" and (name == "coordination" or name.startswith("fabric_anisotropy"))
    prescribed = name in AT_START or name in ("p", "q", "stress_ratio") or name.startswith("stress_")
    return rows[rows > 0] if by_row or prescribed else rows
