"""A few points that speak for a scene: spread evenly over its area, and those that go to extremes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .probe import Paths

SPREAD_POINTS = 56
"""Points spread over the area; they alone count in area-weighted numbers."""


def sample(paths: Paths) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Points and the fraction of the area that each stands for (zero for extremes).

    The curve of `spread_over_area` keeps neighbours together: columns of the bounding box, up and down.
    """
    npt = len(paths.weights)
    if npt <= SPREAD_POINTS:
        return np.arange(npt), paths.weights / paths.weights.sum()
    chosen = spread_over_area(paths.places, paths.weights, SPREAD_POINTS)
    extremes = np.setdiff1d(_extremes(paths), chosen)
    points = np.concatenate([chosen, extremes]).astype(np.int64)
    fractions = np.concatenate([np.full(len(chosen), 1.0 / len(chosen)), np.zeros(len(extremes))])
    return points, fractions


def spread_over_area(places: NDArray[np.float64], weights: NDArray[np.float64], number: int) -> NDArray[np.int64]:
    """About that many points, or all; ordered along a curve through the bounding box, at equal steps of the area."""
    npt = len(weights)
    if npt <= number:
        return np.arange(npt)
    low, high = places.min(axis=0), places.max(axis=0)
    size = np.maximum(high - low, 1e-300)
    columns = int(np.clip(round(np.sqrt(number * size[0] / size[1])), 1, number))
    column = np.minimum(((places[:, 0] - low[0]) / size[0] * columns).astype(int), columns - 1)
    along = (places[:, 1] - low[1]) / size[1]
    order = np.lexsort((np.where(column % 2, -along, along), column))
    total = np.cumsum(weights[order]) / weights.sum()
    found = np.searchsorted(total, (np.arange(number) + 0.5) / number)
    return np.unique(order[np.minimum(found, npt - 1)])


def _extremes(paths: Paths) -> list[int]:
    stress = paths.stress
    pressure = -0.5 * (stress[..., 0] + stress[..., 1])
    safe = np.maximum(pressure, 1e-3 * pressure[0])
    half, shear = 0.5 * (stress[..., 0] - stress[..., 1]) / safe, stress[..., 2] / safe
    ratio = np.hypot(half, shear)
    way = np.hypot(np.diff(half, axis=0), np.diff(shear, axis=0)).sum(axis=0)
    reversal = (np.maximum.accumulate(ratio, axis=0) - ratio).max(axis=0)
    found = [ratio.max(axis=0), way, reversal, np.abs(shear).max(axis=0), pressure.max(axis=0), -pressure.min(axis=0)]
    return [int(np.argmax(values)) for values in found]
