"""Neighbours in the radical (power, Laguerre) tessellation of a periodic packing, and the gaps between them.

The tessellation's dual, the regular triangulation, is the lower convex hull of the points (x, y, x^2 + y^2 - r^2); the
periodic cell is surrounded by images.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from granfabric.dem_ref.sample.disks import Sample, SampleError
from granfabric.dem_ref.sample.neighbours import cell_heights

from .distribution import Density, EdgeFit, edge_density, histogram
from .uncertainty import Measured, blocks_of, jackknife

GAP_WINDOW = 0.1


@dataclass(frozen=True)
class RadicalNeighbours:
    """Pairs of particles whose radical cells share a side.

    Attributes
    ----------
    first, second : (m,) int64
        first < second.
    image : (m, 2) int64
        Periodic image of the second.
    gap : (m,)
        Distance of the surfaces; negative for contacts.
    mean_number : float
        Neighbours per particle; 6 in every periodic tessellation in which each disk has a cell.
    """

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    image: NDArray[np.int64]
    gap: NDArray[np.float64]
    mean_number: float


@dataclass(frozen=True)
class _Triangulation:
    """Regular triangulation of the cell with images around it, in mean diameters.

    `base` and `image` say which disk, in which image of the cell, a point is; `wrap` how far its disk lies from the
    cell in the sample.
    """

    triangles: NDArray[np.int64]
    point: NDArray[np.float64]
    radius: NDArray[np.float64]
    base: NDArray[np.int64]
    image: NDArray[np.int64]
    cell: NDArray[np.float64]
    wrap: NDArray[np.int64]


def _triangulation(sample: Sample) -> _Triangulation:
    n = sample.count
    scale = sample.mean_diameter
    cell = sample.cell / scale
    inverse = np.linalg.inv(cell)
    reduced = (sample.position / scale) @ inverse
    wrap = np.floor(reduced).astype(np.int64)
    reduced -= wrap
    heights = cell_heights(cell)
    parts, bases, images = [], [], []
    spacing = float(np.sqrt(np.linalg.det(cell) / n))
    margin = min(6.0 * max(1.0, spacing), 0.99 * min(heights))
    pad = [margin / h for h in heights]
    for a in (-1, 0, 1):
        for b in (-1, 0, 1):
            moved = reduced + (a, b)
            near = np.ones(n, bool)
            for c in (0, 1):
                near &= (moved[:, c] > -pad[c]) & (moved[:, c] < 1.0 + pad[c])
            index = np.flatnonzero(near)
            parts.append(moved[index])
            bases.append(index)
            images.append(np.tile([a, b], (len(index), 1)))
    base, image = np.concatenate(bases), np.concatenate(images)
    point = (np.concatenate(parts) - 0.5) @ cell
    radius = sample.radius[base] / scale
    hull = ConvexHull(np.column_stack([point, np.sum(point**2, axis=1) - radius**2]))
    triangles = hull.simplices[hull.equations[:, 2] < 0.0].astype(np.int64)
    return _Triangulation(triangles, point, radius, base, image, cell, wrap)


def radical_neighbours(sample: Sample) -> RadicalNeighbours:
    """Neighbours of every disk in the radical tessellation of the periodic packing.

    Raises
    ------
    SampleError
        If the packing is so loose or small that the images around the cell do not close the tessellation.
    """
    n = sample.count
    made = _triangulation(sample)
    base, image, wrap = made.base, made.image, made.wrap
    own = np.all(image == 0, axis=1)
    triangles = made.triangles[own[made.triangles].any(axis=1)]
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    edges = edges[own[edges].any(axis=1)]
    i, j = base[edges[:, 0]], base[edges[:, 1]]
    shift = image[edges[:, 1]] - image[edges[:, 0]]
    swap = i > j
    i, j = np.where(swap, j, i), np.where(swap, i, j)
    shift = np.where(swap[:, None], -shift, shift)
    table = np.unique(np.column_stack([i, j, shift]), axis=0)
    table = table[table[:, 0] != table[:, 1]]
    hidden = n - len(np.unique(table[:, :2]))
    if len(table) != 3 * (n - hidden):
        raise SampleError(
            f"the radical tessellation of {n} disks does not close ({len(table)} pairs instead of {3 * (n - hidden)}): "
            "the packing is too small or too loose"
        )
    first, second = table[:, 0], table[:, 1]
    # images refer to wrapped positions; the sample's positions are not wrapped
    shift = table[:, 2:] + wrap[first] - wrap[second]
    vector = sample.position[second] - sample.position[first] + shift @ sample.cell
    gap = np.hypot(vector[:, 0], vector[:, 1]) - sample.radius[first] - sample.radius[second]
    return RadicalNeighbours(first, second, shift, gap, 2.0 * len(table) / n)


@dataclass(frozen=True)
class GapDistribution:
    """Density of gaps between neighbours that do not touch, as ``xi = gap/(2 r)`` with the mean radius r.

    Attributes
    ----------
    density : Density
    at_zero : EdgeFit
        Straight line on [0, window]: P_xi0 and its slope.
    small_gap_exponent : float
        Maximum-likelihood exponent b of a power law ``xi^-b`` on (0, window); a frictionless packing at the onset of
        rigidity has a weak divergence there, so that P_xi0 depends on the window.
    window : float
    mean_density : float
        Fraction of the gaps that lie within the window, over the window: P_xi0 for displacements of that size.
    neighbours : float
        Mean number of neighbours in the tessellation.
    """

    density: Density
    at_zero: EdgeFit
    small_gap_exponent: float
    window: float
    mean_density: float
    neighbours: float


def gap_distribution(
    sample: Sample, neighbours: RadicalNeighbours | None = None, window: float = GAP_WINDOW, bins: int = 40
) -> GapDistribution:
    """Gap distribution of the radical neighbours of a sample."""
    pairs = neighbours or radical_neighbours(sample)
    xi = pairs.gap[pairs.gap > 0.0] / sample.mean_diameter
    small = xi[(xi > 0.0) & (xi < window)]
    exponent = 1.0 - len(small) / float(np.sum(np.log(window / small))) if len(small) else 0.0
    edges = np.linspace(0.0, 0.8, bins + 1)
    mean_density = len(small) / (window * max(len(xi), 1))
    return GapDistribution(
        histogram(xi, edges), edge_density(xi, window), exponent, window, mean_density, pairs.mean_number
    )


def closing_gap_density(
    sample: Sample, neighbours: RadicalNeighbours, window: float, bearing: NDArray[np.bool_]
) -> Measured:
    """Density of gaps within a window between particles that bear forces, over all gaps, with its standard error.

    A rattler lies near a neighbour wherever it happens to be, and is pushed away without a force by the first one that
    closes in: its gaps gain no contact of the network. The error is that of blocks of the packing, or of a count of one
    gap more.
    """
    apart = neighbours.gap > 0.0
    small = neighbours.gap[apart] / sample.mean_diameter < window
    small &= bearing[neighbours.first[apart]] & bearing[neighbours.second[apart]]
    block = blocks_of(sample.position, sample.cell)[neighbours.first[apart]]
    number = max(len(small), 1)
    counted = float(np.sqrt(np.count_nonzero(small) + 1.0)) / (window * number)
    error = float(np.fmax(jackknife(lambda without: small[block != without].mean() / window), counted))
    return Measured(float(np.count_nonzero(small) / (window * number)), error)


def solid_fraction_error(sample: Sample) -> float:
    """Standard error of the solid fraction, from blocks of the triangles between neighbours.

    A triangle holds a sector of the disk at each of its corners, and all triangles together hold all of every disk.
    """
    made = _triangulation(sample)
    corners = made.point[made.triangles]
    centre = corners.mean(axis=1) @ np.linalg.inv(made.cell) + 0.5
    own = np.all((centre >= 0.0) & (centre < 1.0), axis=1)
    corners, radius = corners[own], made.radius[made.triangles[own]]
    area, solid = np.zeros(len(corners)), np.zeros(len(corners))
    for k in range(3):
        one, other = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        across = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
        solid += 0.5 * radius[:, k] ** 2 * np.arctan2(across, np.sum(one * other, axis=1))
        area = 0.5 * across
    block = blocks_of(corners.mean(axis=1) + 0.5 * made.cell.sum(axis=0), made.cell)
    return float(jackknife(lambda without: solid[block != without].sum() / area[block != without].sum()))
