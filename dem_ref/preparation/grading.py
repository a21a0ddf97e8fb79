"""Gradings given as a curve of sizes and passing fractions, and the grading that a packing has."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import SampleError
from granfabric.dem_ref.dynamics.packing import LARGEST_RATIO
from granfabric.dem_ref.exchange.text import TextFile, read_text_file

PASSING = {"passing_by_area": 2, "passing_by_mass": 2, "passing_by_number": 0}
"""Columns of a file, and the power of the diameter that a disk counts with; the mass of a disk goes with its area."""
PERCENT = 100.0
LARGEST_FILE = 10_000


def read_grading(path: str | Path) -> tuple[tuple[float, float], ...]:
    """Curve of a CSV file as pairs of diameter and passing fraction by number, both ascending, from 0 to 1.

    The file has the column ``size`` (diameter, m) and one of ``passing_by_area``, ``passing_by_mass`` (of disks the
    same) and ``passing_by_number``; passing ends at 1, or at 100 if in per cent. Between two points passing is linear
    in the size.

    Raises
    ------
    SampleError
        With file, line and value.
    """
    file = read_text_file(path)
    rows = [
        (line, [token.strip() for token in text.replace(";", ",").replace("\t", ",").split(",")])
        for line, text in enumerate(file.lines, start=1)
        if text.strip() and not text.strip().startswith("#")
    ]
    if not rows:
        raise SampleError(f"{file.origin}: is empty; wanted are the columns size and passing_by_area")
    head, names = rows[0][0], [name.lower() for name in rows[0][1]]
    found = [name for name in names if name in PASSING]
    if "size" not in names or len(found) != 1:
        raise file.error(
            head, f"columns {', '.join(names)}; wanted are size [m] and one of {', '.join(PASSING)}"
        )
    size, passing = [], []
    for line, tokens in rows[1:]:
        file.row(tokens, line, names)
        size.append(file.number(tokens[names.index("size")], line, "size", positive=True))
        passing.append(file.number(tokens[names.index(found[0])], line, found[0]))
    if len(size) < 2 or len(size) > LARGEST_FILE:
        raise SampleError(f"{file.origin}: {len(size)} points; wanted are at least two, from passing 0 to 1 (or 100 %)")
    return _by_number(file, [line for line, _ in rows[1:]], size, passing, PASSING[found[0]])


def _by_number(
    file: TextFile, lines: Sequence[int], size: list[float], passing: list[float], power: int
) -> tuple[tuple[float, float], ...]:
    for before, after, line in zip(range(len(size)), range(1, len(size)), lines[1:]):
        if size[after] < size[before] or passing[after] < passing[before]:
            what, values = ("size", size) if size[after] < size[before] else ("passing", passing)
            raise file.error(line, f"{what} = {values[after]:g} is below that of the line before, {values[before]:g}")
    whole = PERCENT if passing[-1] == PERCENT else 1.0
    if passing[0] != 0.0 or passing[-1] != whole:
        raise file.error(
            lines[0] if passing[0] != 0.0 else lines[-1],
            f"passing runs from {passing[0]:g} to {passing[-1]:g}; legal is from 0 to 1, or to 100 in per cent",
        )
    used = [place for place in range(len(size) - 1) if passing[place + 1] > passing[place]]
    small, large = size[used[0]], size[used[-1] + 1]
    if large > LARGEST_RATIO * small:
        raise file.error(
            lines[used[-1] + 1],
            f"size = {large:g} is {large / small:.3g} times the smallest, {small:g}; legal is up to {LARGEST_RATIO:g}",
        )  # fmt: skip
    curve: list[tuple[float, float]] = []
    total = 0.0
    for place in used:
        low, high = size[place], size[place + 1]
        steps = np.linspace(low, high, 1 if high == low else FINE + 1)
        part = (passing[place + 1] - passing[place]) / whole
        if high == low:
            curve += [(low, total), (low, total + part / low**power)]
            total += part / low**power
            continue
        # of disks in a narrow class the number is the area over the square of the geometric mean diameter
        numbers = part / FINE / (steps[1:] * steps[:-1]) ** (power / 2)
        levels = total + np.concatenate([[0.0], np.cumsum(numbers)])
        curve += list(zip(steps.tolist(), levels.tolist()))
        total = float(levels[-1])
    return tuple((diameter, level / total) for diameter, level in curve)


FINE = 50
"""Pieces of a class within which the density by number is taken as constant."""


def grading_of(radius: NDArray[np.float64]) -> dict[str, float]:
    """What is told of a grading: smallest, largest and mean diameter, and those that a fraction by area passes."""
    diameter = np.sort(2.0 * radius)
    area = np.cumsum(diameter**2)
    at = {name: float(diameter[np.searchsorted(area, level * area[-1])]) for name, level in LEVELS.items()}
    return {"smallest": float(diameter[0]), "largest": float(diameter[-1]), "mean": float(diameter.mean()), **at}


LEVELS = {"d10": 0.1, "d50": 0.5, "d90": 0.9}


def largest_departure(radius: NDArray[np.float64], curve: Sequence[tuple[float, float]]) -> float:
    """Largest difference between the passing fractions by number of a packing and of a curve."""
    diameter = np.sort(2.0 * radius)
    points = np.array(curve)
    below = np.searchsorted(diameter, points[:, 0] * (1.0 - 1e-9), side="left") / len(diameter)
    above = np.searchsorted(diameter, points[:, 0] * (1.0 + 1e-9), side="right") / len(diameter)
    return float(np.maximum(np.maximum(below - points[:, 1], points[:, 1] - above), 0.0).max())
