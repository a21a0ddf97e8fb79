"""Arithmetic of work-precision tables: Pareto fronts, slopes, the cheapest setting that is accurate enough."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from .study import Row


def on_front(cost: ArrayLike, error: ArrayLike) -> np.ndarray:
    """Which settings are not dominated: no other one costs no more and has no larger error, and less in one of the two.

    Parameters
    ----------
    cost, error : array_like, shape (n,)
        A value that is not finite is never on the front.

    Returns
    -------
    ndarray of bool, shape (n,)
        Equal settings are on the front together.
    """
    costs, errors = np.asarray(cost, dtype=np.float64), np.asarray(error, dtype=np.float64)
    finite = np.isfinite(costs) & np.isfinite(errors)
    front = np.zeros(costs.shape, dtype=bool)
    for i in np.flatnonzero(finite):
        no_worse = finite & (costs <= costs[i]) & (errors <= errors[i])
        front[i] = not np.any(no_worse & ((costs < costs[i]) | (errors < errors[i])))
    return front


def mark_fronts(rows: Sequence[Row]) -> None:
    """Set `on_front` and `on_front_by_count` of each row, facet by facet."""
    for facet in dict.fromkeys(row["facet"] for row in rows):
        members = [row for row in rows if row["facet"] == facet]
        errors = [row["error"] for row in members]
        for name, cost in (("on_front", "seconds"), ("on_front_by_count", "count")):
            for row, member in zip(members, on_front([row[cost] for row in members], errors)):
                row[name] = int(member)


def slope(x: ArrayLike, y: ArrayLike) -> float:
    """Least-squares slope of log y over log x; NaN for fewer than two usable points."""
    abscissa, ordinate = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    usable = (abscissa > 0) & (ordinate > 0) & np.isfinite(abscissa) & np.isfinite(ordinate)
    if np.count_nonzero(usable) < 2:
        return float("nan")
    return float(np.polyfit(np.log(abscissa[usable]), np.log(ordinate[usable]), 1)[0])


def cheapest(rows: Sequence[Row], error: float, cost: str = "seconds") -> Row | None:
    """The row of least cost whose error is at most the given one; None if there is none."""
    accurate = [row for row in rows if np.isfinite(row["error"]) and row["error"] <= error]
    return min(accurate, key=lambda row: row[cost]) if accurate else None
