"""Which of many boxes overlap, in a time that grows with their number and not with its square.

Boxes are sorted by size into levels, a factor of two apart, and a box is looked for in a raster as coarse as the larger
of two levels: there it touches four fields at most, and few boxes of its size have room in one.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
Array = NDArray[np.float64]

_AT_ONCE = 2_000_000
"""Candidates that are looked at together; bounds the memory."""


def overlapping_boxes(
    low: Array, high: Array, other_low: Array, other_high: Array
) -> Iterator[tuple[IntArray, IntArray]]:
    """Pairs of boxes that have a point in common, in portions.

    Parameters
    ----------
    low, high : ndarray, shape (n, 2)
        Corners of boxes; a point is a box, too.
    other_low, other_high : ndarray, shape (m, 2)

    Yields
    ------
    first, second : ndarray of int
        Places in the two lists; each pair once.
    """
    if not (len(low) and len(other_low)):
        return
    origin = np.minimum(low.min(axis=0), other_low.min(axis=0))
    level, other_level = _levels(low, high), _levels(other_low, other_high)
    # No raster is so fine that its fields cannot be counted.
    extent = float(np.maximum(high.max(axis=0), other_high.max(axis=0)).max() - origin.min())
    finest = int(np.frexp(max(extent, np.finfo(float).tiny))[1]) - 28
    level, other_level = np.maximum(level, finest), np.maximum(other_level, finest)
    for a in np.unique(level):
        mine = np.flatnonzero(level == a)
        for b in np.unique(other_level):
            theirs = np.flatnonzero(other_level == b)
            field = float(np.ldexp(1.0, int(max(a, b))))
            place, key = _fields(low[mine], high[mine], origin, field)
            other_place, other_key = _fields(other_low[theirs], other_high[theirs], origin, field)
            order = np.argsort(other_key, kind="stable")
            other_place, other_key = other_place[order], other_key[order]
            start = np.searchsorted(other_key, key, side="left")
            count = np.searchsorted(other_key, key, side="right") - start
            for portion in _portions(count):
                repeat = count[portion]
                within = np.arange(int(repeat.sum())) - np.repeat(np.cumsum(repeat) - repeat, repeat)
                i = mine[np.repeat(place[portion], repeat)]
                j = theirs[other_place[np.repeat(start[portion], repeat) + within]]
                lower = np.maximum(low[i], other_low[j])
                meet = (lower <= np.minimum(high[i], other_high[j])).all(axis=1)
                i, j, lower = i[meet], j[meet], lower[meet]
                # Of the fields that both touch, the one with the lower corner of what they have in common counts.
                once = _keys(_raster(lower, origin, field)) == np.repeat(key[portion], repeat)[meet]
                yield i[once], j[once]


def _levels(low: Array, high: Array) -> IntArray:
    """Exponent of the power of two that is no smaller than the box; a point goes to the finest raster."""
    size = (high - low).max(axis=1)
    return np.where(size > 0, np.frexp(size)[1], -2000).astype(np.int64)


def _raster(points: Array, origin: Array, field: float) -> IntArray:
    return np.floor((points - origin) / field).astype(np.int64)


def _keys(raster: IntArray) -> IntArray:
    return raster[:, 0] * (1 << 30) + raster[:, 1]


def _fields(low: Array, high: Array, origin: Array, field: float) -> tuple[IntArray, IntArray]:
    """Box and key of each field that a box touches."""
    first, last = _raster(low, origin, field), _raster(high, origin, field)
    places, keys = [], []
    for along in (0, 1):
        for up in (0, 1):
            step = np.array([along, up])
            inside = (first + step <= last).all(axis=1)
            places.append(np.flatnonzero(inside))
            keys.append(_keys(first[inside] + step))
    return np.concatenate(places), np.concatenate(keys)


def _portions(count: IntArray) -> Iterator[slice]:
    """Runs of entries whose counts add up to a bounded number (a single entry may exceed it)."""
    ends = np.cumsum(count)
    start = 0
    while start < len(count):
        before = int(ends[start - 1]) if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, before + _AT_ONCE, side="right")))
        yield slice(start, stop)
        start = stop
