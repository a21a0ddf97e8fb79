"""Near pairs of disks in a periodic cell, found with cell lists and kept as a half list in a fixed order.

A pair belongs to the list when its gap is below the skin. The pairs are sorted by (first, second), first < second, so
that neighbouring entries touch neighbouring memory, and so that the order of summation, and with it every bit of a
result, does not depend on the skin or on when the list was made.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, sqrt

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import SampleError, disks, finite, images, indices, is_within, numbers
from granfabric.dem_ref.compilation import compiled

FARTHEST = 120
"""Most cells between two disks: an image is stored in eight bits."""


class CellTooSmallError(ValueError):
    """The periodic cell is too small for a pair of disks to have one nearest image only."""


@dataclass
class NearPairs:
    """Half list of near pairs.

    Attributes
    ----------
    first, second : (npairs,) uint32
        Particle indices, first < second, sorted by (first, second).
    image : (npairs, 2) int8
        Periodic image: the branch vector is ``x[second] - x[first] + image[0] * cell[0] + image[1] * cell[1]``.
    tangential : (npairs,) float64
        Tangential spring elongation (length) of those pairs that touch, zero for the others.
    """

    first: NDArray[np.uint32]
    second: NDArray[np.uint32]
    image: NDArray[np.int8]
    tangential: NDArray[np.float64]

    def bring_into_form(self, count: int) -> None:
        """Check the arrays as the compiled kernels need them; one of another kind is replaced by a copy.

        Parameters
        ----------
        count : int
            Number of disks.

        Raises
        ------
        SampleError
        """
        length = np.size(self.first)
        self.first = indices("first", self.first, np.uint32, length, count)
        self.second = indices("second", self.second, np.uint32, length, count)
        self.image = images("image", self.image, length)
        self.tangential = numbers("tangential", self.tangential, (length,))


@compiled()
def _fill_pairs(position, radius, cell, skin, largest, counts, ordered, start, first, second, image):
    """Fill the half list; returns the number of pairs, or the negative number needed when the arrays are too short."""
    n = position.shape[0]
    ax, ay = cell[0, 0], cell[0, 1]
    bx, by = cell[1, 0], cell[1, 1]
    area = ax * by - ay * bx
    na, nb = counts[0], counts[1]
    wrap = np.empty((n, 2), np.int64)
    bin_of = np.empty(n, np.int64)
    for m in range(na * nb + 1):
        start[m] = 0
    for i in range(n):
        ca = (position[i, 0] * by - position[i, 1] * bx) / area
        cb = (position[i, 1] * ax - position[i, 0] * ay) / area
        wa = floor(ca)
        wb = floor(cb)
        wrap[i, 0] = int(wa)
        wrap[i, 1] = int(wb)
        ia = min(int((ca - wa) * na), na - 1)
        ib = min(int((cb - wb) * nb), nb - 1)
        bin_of[i] = ib * na + ia
        start[bin_of[i] + 1] += 1
    for m in range(na * nb):
        start[m + 1] += start[m]
    fill = np.zeros(na * nb, np.int64)
    for i in range(n):
        m = bin_of[i]
        ordered[start[m] + fill[m]] = i
        fill[m] += 1
    capacity = first.shape[0]
    total = 0
    for i in range(n):
        row = total
        ia = bin_of[i] % na
        ib = bin_of[i] // na
        reach_i = radius[i] + skin
        for mb in range(ib - 1, ib + 2):
            # (image shift of the neighbouring bin) = one cell vector when the bin lies beyond the border
            qb = -1 if mb < 0 else (1 if mb >= nb else 0)
            for ma in range(ia - 1, ia + 2):
                qa = -1 if ma < 0 else (1 if ma >= na else 0)
                m = (mb - qb * nb) * na + (ma - qa * na)
                for s in range(start[m], start[m + 1]):
                    j = ordered[s]
                    if j <= i:
                        continue
                    ga = qa + wrap[i, 0] - wrap[j, 0]
                    gb = qb + wrap[i, 1] - wrap[j, 1]
                    dx = position[j, 0] - position[i, 0] + ga * ax + gb * bx
                    dy = position[j, 1] - position[i, 1] + ga * ay + gb * by
                    reach = reach_i + radius[j]
                    if dx * dx + dy * dy >= reach * reach:
                        continue
                    if total < capacity:
                        # insertion into the row of i keeps `second` ascending
                        k = total
                        while k > row and second[k - 1] > j:
                            second[k] = second[k - 1]
                            image[k, 0] = image[k - 1, 0]
                            image[k, 1] = image[k - 1, 1]
                            k -= 1
                        first[total] = i
                        second[k] = j
                        image[k, 0] = ga
                        image[k, 1] = gb
                    total += 1
    if total > capacity:
        return -total
    return total


@compiled()
def _carry_over(first, second, tangential, new_first, new_second, new_tangential):
    """Copy the tangential elongation of pairs that are in both sorted lists."""
    k = 0
    for m in range(new_first.shape[0]):
        i, j = new_first[m], new_second[m]
        while k < first.shape[0] and (first[k] < i or (first[k] == i and second[k] < j)):
            k += 1
        if k < first.shape[0] and first[k] == i and second[k] == j:
            new_tangential[m] = tangential[k]
        else:
            new_tangential[m] = 0.0


def cell_heights(cell: NDArray[np.float64]) -> tuple[float, float]:
    """Distances between opposite sides of the cell; rows of `cell` are the two lattice vectors."""
    area = cell[0, 0] * cell[1, 1] - cell[0, 1] * cell[1, 0]
    return area / sqrt(cell[1, 0] ** 2 + cell[1, 1] ** 2), area / sqrt(cell[0, 0] ** 2 + cell[0, 1] ** 2)


def most_neighbours(radius: NDArray[np.float64]) -> int:
    """Most contacts a disk can have: the smallest disks around the largest, at least six."""
    return max(6, int(np.pi / np.arcsin(radius.min() / (radius.min() + radius.max())) + 1e-9))


def find_near_pairs(
    position: NDArray[np.float64],
    radius: NDArray[np.float64],
    cell: NDArray[np.float64],
    skin: float,
    previous: NearPairs | None = None,
) -> NearPairs:
    """All pairs with a gap below `skin`; tangential elongations are carried over from `previous`.

    Raises
    ------
    CellTooSmallError
        If a cell height is below three interaction distances, so that an image would not be unique.
    SampleError
        If an array has another shape or kind, or values that no packing has.
    """
    position, radius = disks(position, radius)
    n = len(radius)
    position, radius = finite("position", position, (n, 2)), finite("radius", radius, (n,))
    cell = finite("cell", cell, (2, 2))
    if not n or not radius.min() > 0.0:
        raise SampleError("a list of neighbours needs disks with positive radii")
    if not is_within(skin, -1e300, 1e300):
        raise SampleError(f"skin is {skin}, legal are finite values")
    skin = float(skin)
    reach = 2.0 * float(radius.max()) + skin
    with np.errstate(all="ignore"):
        heights = cell_heights(cell)
    if not (reach > 0.0 and min(heights) > 0.0):
        raise SampleError("the cell's rows must be a right-handed pair, and disks must reach beyond their radii")
    if not min(heights) >= 3.0 * reach:
        raise CellTooSmallError(
            f"the periodic cell is {min(heights):.4g} high, below three interaction distances ({3 * reach:.4g}): "
            "take more particles, a smaller ratio of diameters or a smaller skin"
        )
    if np.abs(position).max() > 0.25 * FARTHEST * min(heights):
        reduced = np.floor(position @ np.linalg.inv(cell))
        if np.ptp(reduced, axis=0).max() > FARTHEST:
            raise SampleError(f"disks lie more than {FARTHEST} cells apart; wrap them into the cell")
    limit = max(3, int(sqrt(4.0 * n)) + 3)  # no more bins than useful in a sparse cell
    counts = np.array([int(min(h / reach, limit)) for h in heights], np.int64)
    start = np.empty(counts[0] * counts[1] + 1, np.int64)
    ordered = np.empty(n, np.int64)
    if previous is not None:
        previous.bring_into_form(n)
    capacity = max(64, 4 * n if previous is None else int(1.2 * len(previous.first)) + 64)
    while True:
        first = np.empty(capacity, np.uint32)
        second = np.empty(capacity, np.uint32)
        image = np.empty((capacity, 2), np.int8)
        total = _fill_pairs(position, radius, cell, skin, reach, counts, ordered, start, first, second, image)
        if total >= 0:
            break
        capacity = int(-total * 1.05) + 16
    pairs = NearPairs(first[:total].copy(), second[:total].copy(), image[:total].copy(), np.zeros(total))
    if previous is not None:
        _carry_over(previous.first, previous.second, previous.tangential, pairs.first, pairs.second, pairs.tangential)
    return pairs


def spatial_order(position: NDArray[np.float64], cell: NDArray[np.float64], spacing: float) -> NDArray[np.int64]:
    """Permutation that sorts particles by rows of bins of the given size: near in space, near in memory."""
    reduced = position @ np.linalg.inv(cell)
    reduced -= np.floor(reduced)
    heights = cell_heights(cell)
    counts = [max(1, int(h / spacing)) for h in heights]
    bins = [np.minimum((reduced[:, c] * counts[c]).astype(np.int64), counts[c] - 1) for c in (0, 1)]
    return np.lexsort((np.arange(len(position)), reduced[:, 0], bins[1]))
