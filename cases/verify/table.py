"""Arithmetic of the comparison: errors of the model and the scatter between packings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

QUANTITIES = (
    "coordination",
    "fabric_anisotropy",
    "normal_force_anisotropy",
    "tangential_force_anisotropy",
    "mean_normal_force",
)
TABLE_LEVELS = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3)


@dataclass(frozen=True)
class Comparison:
    """One quantity of one closure at one stress ratio; means over the packings that reached it.

    Attributes
    ----------
    loading, closure, quantity : str
    stress_ratio : float
        q/p.
    dem, dem_scatter : float
        Mean over packings and standard deviation between them (NaN for a single one).
    model : float
        Mean of the model's answers, each with the inputs of its packing.
    error, error_scatter : float
        Mean and standard deviation of model minus DEM, packing by packing.
    packings : int
    """

    loading: str
    closure: str
    quantity: str
    stress_ratio: float
    dem: float
    dem_scatter: float
    model: float
    error: float
    error_scatter: float
    packings: int

    @property
    def error_over_scatter(self) -> float:
        """Size of the error in units of the scatter between packings."""
        return abs(self.error) / self.dem_scatter if self.dem_scatter > 0.0 else float("nan")

    def row(self) -> list[str | float | int]:
        """Values in the order of `COLUMNS`."""
        return [*(getattr(self, entry.name) for entry in fields(self)), self.error_over_scatter]


COLUMNS = (*(entry.name for entry in fields(Comparison)), "error_over_scatter")


def mean_and_scatter(values: Array) -> tuple[float, float]:
    """Mean, and standard deviation between samples (n - 1; NaN for fewer than two)."""
    if len(values) == 0:
        return float("nan"), float("nan")
    return float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else float("nan")


def compare(
    loading: str,
    closure: str,
    dem: Mapping[str, Array],
    model: Mapping[str, Array],
    levels: Array,
    wanted: Iterable[float] = TABLE_LEVELS,
) -> list[Comparison]:
    """Compare all quantities at the wanted stress ratios.

    Parameters
    ----------
    loading, closure : str
    dem, model : mapping of str to ndarray, shape (npackings, nlevels)
        Quantities at the same stress ratios; NaN where a packing, or the model, did not get there.
    levels : ndarray, shape (nlevels,)
    wanted : iterable of float
        Stress ratios among `levels`.

    Raises
    ------
    ValueError
        If a wanted stress ratio is not among the levels.
    """
    rows = []
    for quantity in QUANTITIES:
        for ratio in wanted:
            place = int(np.argmin(np.abs(levels - ratio)))
            if abs(levels[place] - ratio) > 1e-9:
                raise ValueError(f"q/p = {ratio:g} is not among the levels of the comparison")
            measured, answered = dem[quantity][:, place], model[quantity][:, place]
            both = np.isfinite(measured) & np.isfinite(answered)
            error = mean_and_scatter((answered - measured)[both])
            rows.append(
                Comparison(
                    loading, closure, quantity, float(ratio), *mean_and_scatter(measured[both]),
                    mean_and_scatter(answered[both])[0], *error, int(both.sum()),
                )
            )  # fmt: skip
    return rows


def largest_errors(rows: Iterable[Comparison]) -> dict[tuple[str, str, str], Comparison]:
    """By loading, closure and quantity the comparison with the largest error."""
    worst: dict[tuple[str, str, str], Comparison] = {}
    for row in rows:
        key = (row.loading, row.closure, row.quantity)
        if np.isfinite(row.error) and (key not in worst or abs(row.error) > abs(worst[key].error)):
            worst[key] = row
    return worst
