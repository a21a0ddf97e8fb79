"""Whether a sample from a file can be one that this program left: the geometry behind the numbers.

A stored sample brings its own list of near pairs. One that leaves out contacts would change forces without a word, and
disks heaped upon one another would make more pairs than fit into memory.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .neighbours import NearPairs, cell_heights, find_near_pairs

LARGEST_SHAPE = 1e6
"""Largest ratio of lengths in a sample: cell to disk, place of a disk to cell."""
SMALLEST_LENGTH, LARGEST_LENGTH = 1e-140, 1e140
"""Lengths whose squares are numbers."""
LARGEST_CROWD = 4.0
"""Area of the disks over that of the square that holds their centres: 0.9 at the densest, twice that at its rim."""


def misfit(position: NDArray[np.float64], radius: NDArray[np.float64], cell: NDArray[np.float64]) -> str:
    """Why these disks do not lie side by side in this periodic cell; empty if they may.

    Parameters
    ----------
    position, radius, cell : ndarray
        As in `sample.Sample`; finite, radii positive, the cell's rows right-handed.
    """
    smallest, largest, long = float(radius.min()), float(radius.max()), float(np.abs(cell).max())
    if not (smallest > SMALLEST_LENGTH and long < LARGEST_LENGTH):  # before any is squared
        return "its cell is too long and thin"
    heights = cell_heights(cell)
    if not long < LARGEST_SHAPE * min(heights):
        return "its cell is too long and thin"
    if not (largest < LARGEST_SHAPE * smallest and max(heights) < LARGEST_SHAPE * largest):
        return "its disks and its cell do not fit together"
    reduced = position @ np.linalg.inv(cell)
    if np.abs(reduced).max() > LARGEST_SHAPE:
        return "a disk lies far outside the cell"
    reduced -= np.floor(reduced)
    bins = np.maximum(1, (np.array(heights) / (2.0 * largest)).astype(np.int64))
    place = np.minimum((reduced * bins).astype(np.int64), bins - 1)
    _, crowd = np.unique(place[:, 0] * bins[1] + place[:, 1], return_inverse=True)
    filled = np.bincount(crowd, weights=np.pi * radius**2)
    square = float(np.linalg.det(cell)) / float(bins.prod())
    if filled.max() > LARGEST_CROWD * square:
        return "its disks lie upon one another"
    return ""


def implausible(
    position: NDArray[np.float64], radius: NDArray[np.float64], cell: NDArray[np.float64], pairs: NearPairs
) -> str:
    """Why this is no sample in a periodic cell with all its contacts; empty if it is one.

    Parameters
    ----------
    position, radius, cell : ndarray
        As for `misfit`.
    pairs : NearPairs
        A sorted half list.
    """
    if reason := misfit(position, radius, cell):
        return reason
    smallest = float(radius.min())
    # a pair that touches by rounding alone may be missing
    touching = find_near_pairs(position, radius, cell, -1e-9 * smallest)
    key = pairs.first.astype(np.int64) * len(radius) + pairs.second
    wanted = touching.first.astype(np.int64) * len(radius) + touching.second
    at = np.minimum(np.searchsorted(key, wanted), max(len(key) - 1, 0))
    if len(wanted) and (not len(key) or (key[at] != wanted).any() or (pairs.image[at] != touching.image).any()):
        return "its list of pairs lacks contacts that its disks have"
    return ""
