"""How a load goes through a stage: the factor from its value at the start of the stage (0) to its new one (1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .checks import LoadError

NAMES = ("ramp", "step", "sine", "triangle", "haversine")
PERIODIC = ("sine", "triangle", "haversine")
MOST_CYCLES = 10_000
MOST_ROWS = 10_000
# Two corners closer than this fraction of the stage are one.
SAME_CORNER = 1e-9


@dataclass(frozen=True)
class Amplitude:
    """Factor over the fraction of a stage; 0 is the load's value at the start of the stage, 1 the value that it names.

    Parameters
    ----------
    kind : {"ramp", "step", "sine", "triangle", "haversine", "table"}
        ``ramp``: linear. ``step``: whole within the first increment, then held. ``sine``: ``sin(2 pi n t)``.
        ``triangle``: straight lines through the extremes and zeros of the sine. ``haversine``:
        ``(1 - cos(2 pi n t))/2``, between 0 and 1. ``table``: straight lines through `table`.
    cycles : float
        n, for the periodic ones; quarters are legal.
    table : tuple of (float, float)
        Fraction of the stage, ascending from 0 to at most 1, and factor, which begins with 0; the last factor is held.
    """

    kind: str = "ramp"
    cycles: float = 1.0
    table: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in (*NAMES, "table"):
            raise LoadError(f"amplitude = {self.kind!r} is not one of {', '.join(NAMES)}, or a table")
        number = isinstance(self.cycles, (int, float, np.integer, np.floating)) and not isinstance(self.cycles, bool)
        if not number or not 0.0 < self.cycles <= MOST_CYCLES:
            raise LoadError(f"cycles = {self.cycles!r} is not a number in (0, {MOST_CYCLES}]")
        if self.cycles != 1.0 and self.kind not in PERIODIC:
            raise LoadError(
                f"cycles = {self.cycles!r} goes with {', '.join(PERIODIC)}, not with amplitude {self.kind!r}"
            )
        if self.kind == "table":
            _check_table(self.table)

    def factor(self, fraction: float, increments: int) -> float:
        """At a fraction of a stage of so many nominal increments."""
        if self.kind == "ramp":
            return fraction
        if self.kind == "step":
            return min(1.0, fraction * increments)
        if self.kind == "table":
            times, factors = zip(*self.table)
            return float(np.interp(fraction, times, factors))
        turns = self.cycles * fraction
        if self.kind == "triangle":
            quarter = 4.0 * (turns - np.floor(turns + 0.25))  # -1 to 3 over one cycle from trough to trough
            return float(quarter if quarter <= 1.0 else 2.0 - quarter)
        # of the part of a turn, so that whole cycles come back to exactly 0
        part = turns - np.floor(turns)
        if self.kind == "sine":
            return 0.0 if part in (0.0, 0.5) else float(np.sin(2.0 * np.pi * part))
        return float(np.sin(np.pi * part) ** 2)

    def corners(self, increments: int) -> list[float]:
        """Fractions within (0, 1) where the direction or the rate of loading changes, and extremes."""
        if self.kind == "step":
            found = [1.0 / increments]
        elif self.kind == "table":
            found = [time for time, _ in self.table]
        elif self.kind in ("sine", "triangle"):
            found = [(2 * k + 1) / (4.0 * self.cycles) for k in range(int(2 * self.cycles) + 1)]
        elif self.kind == "haversine":
            found = [k / (2.0 * self.cycles) for k in range(1, int(2 * self.cycles) + 1)]
        else:
            found = []
        return [place for place in found if SAME_CORNER < place < 1.0 - SAME_CORNER]


RAMP = Amplitude()


def amplitude(given: Any, cycles: float = 1.0) -> Amplitude:
    """An amplitude from a name, a table of pairs, or an `Amplitude`.

    Raises
    ------
    LoadError
        Saying what is legal.
    """
    if isinstance(given, Amplitude):
        if cycles != 1.0:
            raise LoadError(f"cycles = {cycles!r} belongs into the Amplitude itself")
        return given
    if isinstance(given, str):
        return Amplitude(given, cycles)
    try:
        rows = tuple((float(time), float(factor)) for time, factor in given)
    except (TypeError, ValueError):
        raise LoadError(
            f"amplitude = {given!r:.200} is neither one of {', '.join(NAMES)} nor a table of pairs "
            "[fraction of the stage, factor]"
        ) from None
    return Amplitude("table", cycles, rows)


def _check_table(table: Sequence[tuple[float, float]]) -> None:
    if not 2 <= len(table) <= MOST_ROWS:
        raise LoadError(f"the table of an amplitude has {len(table)} rows, it needs 2 to {MOST_ROWS}")
    values = np.asarray(table, dtype=np.float64)
    if values.shape != (len(table), 2) or not np.isfinite(values).all():
        raise LoadError("the table of an amplitude holds something that is no pair of finite numbers")
    times, factors = values.T
    if times[0] != 0.0 or factors[0] != 0.0:
        raise LoadError(
            f"the table of an amplitude begins with [{times[0]:g}, {factors[0]:g}], not with [0, 0], the value at the "
            'start of the stage; for a load that is there at once take "step"'
        )
    if times[-1] > 1.0:
        raise LoadError(f"the table of an amplitude ends at {times[-1]:g}; a stage ends at 1")
    close = np.flatnonzero(np.diff(times) <= SAME_CORNER)
    if len(close):
        row = int(close[0])
        raise LoadError(
            f"the table of an amplitude goes from {times[row]:g} to {times[row + 1]:g} in rows {row + 1} and "
            f"{row + 2}; fractions have to ascend"
        )


def positions(corners: Sequence[float], increments: int) -> list[float]:
    """Fractions of a stage at which equal increments end that do not step over corners, ascending, the last is 1.

    Between two corners there are as many as of the nominal length fit, rounded up.
    """
    found: list[float] = []
    before = 0.0
    for corner in corners:
        number = max(1, math.ceil((corner - before) * increments * (1.0 - SAME_CORNER)))
        if len(corners) == 1:
            return [step / number for step in range(1, number + 1)]
        found += [before + (corner - before) * step / number for step in range(1, number)]
        found.append(corner)
        before = corner
    return found


def merged_corners(amplitudes: Sequence[Amplitude], increments: int) -> list[float]:
    """Corners of all, ascending, each once, and 1 at the end."""
    found = sorted(place for one in amplitudes for place in one.corners(increments))
    merged: list[float] = []
    for place in found:
        if not merged or place - merged[-1] > SAME_CORNER:
            merged.append(place)
    return [*merged, 1.0]
