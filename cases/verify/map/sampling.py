"""Places along a path at which both sides are compared, and how far a packing carries the path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, sin

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.loading.path import Segment

from .paths import MapPath

Array = NDArray[np.float64]

OF_PEAK = 0.8
"""A packing that does not carry a path to its end is compared to this fraction of its largest q/p there."""
REACHED = 2e-3
"""In q/p: what a leg that ends at a stress ratio may be short of."""
NEARLY, PLATEAU = 0.95, 4.0
FEWEST, MOST = 10, 30
"""Intervals of a leg, of several and of a single one."""


@dataclass(frozen=True)
class Reach:
    """How far a packing carried a path.

    Attributes
    ----------
    segment : int
        From 0; the first that was not carried to its end. The number of segments if all were.
    ratio : float
        Largest q/p up to there.
    """

    segment: int
    ratio: float


@dataclass(frozen=True)
class Places:
    """Places of comparison in one history.

    Attributes
    ----------
    record : ndarray
        Fractional numbers of records.
    segment : ndarray
        From 1.
    fraction : ndarray
        Of the stress path of the segment, as far as it is compared.
    """

    record: Array
    segment: Array
    fraction: Array


def vectors(history: Mapping[str, Array]) -> Array:
    """p and the two components of the deviator; shape (nrecords, 3)."""
    s1 = -0.5 * (history["stress_xx"] - history["stress_yy"])
    return np.column_stack([history["p"], s1, -history["stress_xy"]])


def ratios(history: Mapping[str, Array]) -> Array:
    """q/p of every record; zero where the pressure is gone."""
    p, s1, s2 = vectors(history).T
    return np.hypot(s1, s2) / np.maximum(p, 1e-9 * p[0])


def is_flowing(history: Mapping[str, Array], segments: Sequence[Segment]) -> bool:
    """Whether the leg under way is driven by strain and q/p has stopped growing: nothing is compared beyond.

    So it is when the strain of the leg is `PLATEAU` times that at which q/p had nearly grown to what it is at most.
    """
    number = int(history["segment"][-1])
    if number >= len(segments) or segments[number].kind != "biaxial":
        return False
    segment = segments[number]
    of_leg = history["segment"] >= number
    p, s1, s2 = vectors(history)[of_leg].T
    sign = 1.0 if segment.shear_strain >= 0.0 else -1.0
    ratio = sign * (s1 * cos(2 * segment.angle) + s2 * sin(2 * segment.angle)) / p
    grown = ratio - ratio[0]
    strain = np.hypot(history["strain_xx"] - history["strain_yy"], history["strain_xy"])[of_leg]
    strain = np.abs(strain - strain[0])
    if not grown.max() > 0.0:
        return False
    nearly = strain[int(np.argmax(grown >= NEARLY * grown.max()))]
    return bool(nearly > 0.0 and strain[-1] > PLATEAU * nearly)


def ends(history: Mapping[str, Array], count: int) -> list[int]:
    """Record with which each of the `count` segments ends, of those that were begun."""
    segment = history["segment"].astype(int)
    found = [int(np.flatnonzero(segment > number)[0]) for number in range(min(count, int(segment[-1])))]
    if len(found) < count and (not found or found[-1] < len(segment) - 1):
        found.append(len(segment) - 1)
    return found


def reach(history: Mapping[str, Array], path: MapPath, reason: str) -> Reach:
    """How far a packing carried a path; `reason` is why the run was given up, if it was."""
    last = ends(history, len(path.segments))
    short = len(path.segments)
    for number, end in enumerate(last):
        segment = path.segments[number]
        if segment.kind == "biaxial" and segment.stress_ratio is not None:
            p, s1, s2 = vectors(history)[end]
            ratio = (s1 * cos(2 * segment.angle) + s2 * sin(2 * segment.angle)) / p
            sign = 1.0 if segment.shear_strain >= 0.0 else -1.0
            if sign * (ratio - segment.stress_ratio) < -REACHED:
                short = min(short, number)
    if reason:
        short = min(short, len(last) - 1)
    end = last[min(short, len(last) - 1)]
    return Reach(short, float(ratios(history)[: end + 1].max()))


def common_reach(reaches: Sequence[Reach], count: int) -> Reach | None:
    """To where all packings are compared; None for the whole path of `count` segments."""
    segment = min(entry.segment for entry in reaches)
    if segment == count:
        return None
    return Reach(segment, OF_PEAK * min(entry.ratio for entry in reaches if entry.segment == segment))


def places(history: Mapping[str, Array], count: int, limit: Reach | None = None) -> Places:
    """Places of comparison along a history.

    Parameters
    ----------
    history : mapping
        Columns of the DEM.
    count : int
        Segments of the path.
    limit : Reach, optional
        Segments before it are compared to their ends, itself until q/p passes its ratio for the first time.
    """
    last = ends(history, count)
    stress, ratio = vectors(history), ratios(history)
    intervals = max(FEWEST, MOST // count)
    fractions = np.linspace(0.0, 1.0, intervals + 1)
    found: list[tuple[Array, int]] = []
    begin = 0
    for number, end in enumerate(last):
        stop = float(end)
        if limit is not None and number >= limit.segment:
            if number > limit.segment:
                break
            beyond = begin + np.flatnonzero(ratio[begin : end + 1] >= limit.ratio)
            if not len(beyond) or beyond[0] == begin:
                break
            after = int(beyond[0])
            step = ratio[after] - ratio[after - 1]
            stop = after - 1 + (limit.ratio - ratio[after - 1]) / step
        length = np.concatenate(
            [[0.0], np.cumsum(np.linalg.norm(np.diff(stress[begin : end + 1], axis=0), axis=1))]
        )
        records = np.arange(begin, end + 1, dtype=float)
        whole = np.interp(stop, records, length)
        found.append((np.interp(fractions * whole, length, records), number + 1))
        begin = end
    if not found:
        nothing = np.zeros(0)
        return Places(nothing, nothing, nothing)
    return Places(
        np.concatenate([records for records, _ in found]),
        np.concatenate([np.full(len(fractions), float(number)) for _, number in found]),
        np.tile(fractions, len(found)),
    )
