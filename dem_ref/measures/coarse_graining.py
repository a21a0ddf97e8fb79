"""Fields of a packing on a grid: coordination, fabric, stress, strain, averaged with a kernel.

Every disk and every contact is shared out among the points of the grid with weights that add up to one: by the kernel
of its distance from each point, over the sum of these. So nothing is counted twice or lost, wherever it lies, and
sums over the grid are those of the whole packing: the mean of the stress is that of Love and Weber, the mean of the
coordination over the disks that a point stands for is the coordination number.

Kernels, with the scale h and the distance r: ``"gaussian"`` exp(-r^2/(2 h^2)), cut off at 3 h; ``"lucy"``
(1 + 3 r/h) (1 - r/h)^3 for r < h (Lucy, Astron. J. 82, 1013, 1977); ``"heaviside"`` 1 for r < h. A contact counts at
the middle of its branch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from granfabric.dem_ref.arrays import SampleError, finite, number, whole
from granfabric.dem_ref.sample.disks import Sample
from granfabric.dem_ref.sample.neighbours import cell_heights

from .contacts import Contacts, contacts_of

KERNELS = ("gaussian", "lucy", "heaviside")
GAUSSIAN_REACH = 3.0
MOST_CELLS = 1000
"""Along a side of the grid."""
LEAST_SOURCES = 3.0
"""Disks, as a sum of weights over the largest, of which a displacement gradient can be told."""


@dataclass(frozen=True)
class CoarseFields:
    """Fields at the middles of the cells of a grid in the periodic cell, cell (a, b) at ``a * cells[1] + b``.

    Attributes
    ----------
    cells : tuple of int
        Along the first and the second lattice vector.
    corner : (cells[0] + 1, cells[1] + 1, 2)
        Corners of the grid [length of the sample].
    disks : (m,)
        Disks that each point stands for; adds up to their number.
    coordination : (m,)
        Contacts of a disk, over all disks; NaN where there is none.
    fabric : (m, 2)
        Anisotropy ``a_c`` as a double-angle vector; NaN where there is no contact.
    solid_fraction : (m,)
    stress : (m, 3)
        xx, yy, xy; Pa, tension positive.
    strain : (m, 3) or None
        xx, yy, xy (engineering shear strain) since the start, tension positive; from the best linear map of the disks
        around a point, with the same kernel: exact where the deformation is homogeneous.
    """

    cells: tuple[int, int]
    corner: NDArray[np.float64]
    disks: NDArray[np.float64]
    coordination: NDArray[np.float64]
    fabric: NDArray[np.float64]
    solid_fraction: NDArray[np.float64]
    stress: NDArray[np.float64]
    strain: NDArray[np.float64] | None


def kernel_values(name: str, ratio: NDArray[np.float64]) -> NDArray[np.float64]:
    """Kernel at distances over its scale, not normalised."""
    if name == "gaussian":
        return np.where(ratio < GAUSSIAN_REACH, np.exp(-0.5 * ratio**2), 0.0)
    if name == "lucy":
        return np.where(ratio < 1.0, (1.0 + 3.0 * ratio) * np.maximum(1.0 - ratio, 0.0) ** 3, 0.0)
    if name == "heaviside":
        return np.where(ratio < 1.0, 1.0, 0.0)
    raise SampleError(f"kernel is {name!r}, legal are {', '.join(KERNELS)}")


@dataclass(frozen=True)
class Shares:
    """Shares of sources that points have; those of a source add up to one.

    Attributes
    ----------
    point, source : (k,) int64
    share : (k,)
        Of the source that the point has.
    points : int
    """

    point: NDArray[np.int64]
    source: NDArray[np.int64]
    share: NDArray[np.float64]
    points: int

    def of(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sum over the sources for every point, of values (sources,) or (sources, components)."""
        if values.ndim == 1:
            return np.bincount(self.point, self.share * values[self.source], self.points).astype(np.float64)
        return np.stack([self.of(column) for column in values.T], axis=-1)

    def of_ones(self) -> NDArray[np.float64]:
        """Sum of the shares of every point."""
        return np.bincount(self.point, self.share, self.points).astype(np.float64)


class _Grid:
    """Points in a periodic cell with their images as far as a kernel reaches."""

    def __init__(self, cell: NDArray[np.float64], cells: tuple[int, int], kernel: str, scale: float) -> None:
        self.cell, self.kernel, self.scale = cell, kernel, scale
        self.reach = scale * (GAUSSIAN_REACH if kernel == "gaussian" else 1.0)
        heights = cell_heights(cell)
        if self.reach > 0.5 * min(heights):
            raise SampleError(
                f"the kernel reaches {self.reach:.4g}, beyond half of the height of the cell, {min(heights):.4g}"
            )
        a, b = ((np.arange(number) + 0.5) / number for number in cells)
        middle = np.stack(np.meshgrid(a, b, indexing="ij"), axis=-1).reshape(-1, 2)
        self.count = len(middle)
        pad = [self.reach / height for height in heights]
        places, index, image = [], [], []
        for shift in np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 2):
            moved = middle + shift
            near = np.flatnonzero(np.all((moved > -np.array(pad)) & (moved < 1.0 + np.array(pad)), axis=1))
            places.append(moved[near])
            index.append(near)
            image.append(np.tile(shift, (len(near), 1)))
        self.place = np.concatenate(places) @ cell
        self.index, self.image = np.concatenate(index), np.concatenate(image)
        self.tree = cKDTree(self.place)

    def near(self, position: NDArray[np.float64]) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """Pairs of a point and a source: point, source, kernel, and cells by which the point's image is shifted."""
        wrap = np.floor(position @ np.linalg.inv(self.cell))
        inside = cKDTree(position - wrap @ self.cell)
        found = inside.sparse_distance_matrix(self.tree, self.reach, output_type="ndarray")
        value = kernel_values(self.kernel, found["v"] / self.scale)
        used = value > 0.0
        source, tiled = found["i"][used], found["j"][used]
        return self.index[tiled], source, value[used], self.image[tiled] + wrap[source]

    def shares(self, position: NDArray[np.float64]) -> Shares:
        """Of sources at these positions."""
        point, source, value, _ = self.near(position)
        total = np.bincount(source, value, len(position))
        if len(position) and not total.min() > 0.0:
            raise SampleError(
                f"the scale {self.scale:.4g} of the kernel is too small for the distance of the points: some disks or "
                "contacts belong to none"
            )
        return Shares(point, source, value / total[source], self.count)


def coarse_grained(
    sample: Sample,
    cells: tuple[int, int],
    scale: float,
    kernel: str = "lucy",
    start: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
) -> CoarseFields:
    """Average a sample over a grid of its periodic cell.

    Parameters
    ----------
    sample : Sample
    cells : tuple of int
        Of the grid along both lattice vectors.
    scale : float
        h of the kernel, in mean diameters.
    kernel : str
        ``"gaussian"``, ``"lucy"`` or ``"heaviside"``.
    start : tuple of ndarray, optional
        Positions (n, 2) and cell (2, 2) from which strains count; no strain if not given.

    Raises
    ------
    SampleError
        On values out of bounds, a kernel beyond half of the cell, or one so narrow that disks belong to no point.
    """
    cells = (whole("cells", cells[0], 1, MOST_CELLS), whole("cells", cells[1], 1, MOST_CELLS))
    scale = number("scale", scale, 1e-3, 1e6) * sample.mean_diameter
    kernel_values(kernel, np.zeros(1))
    grid = _Grid(sample.cell, cells, kernel, scale)
    contacts = contacts_of(sample)
    middle = sample.position[contacts.first] + 0.5 * contacts.normal * contacts.length[:, None]
    of_disks, of_contacts = grid.shares(sample.position), grid.shares(middle)
    number_of = np.bincount(np.concatenate([contacts.first, contacts.second]), minlength=sample.count).astype(float)
    disks, crowd = of_disks.of(np.ones(sample.count)), of_contacts.of(np.ones(contacts.count))
    area = sample.area / grid.count
    with np.errstate(invalid="ignore", divide="ignore"):
        coordination = of_disks.of(number_of) / disks
        fabric = 2.0 * of_contacts.of(contacts.double_angle) / crowd[:, None]
    edge = np.stack(
        np.meshgrid(*(np.linspace(0.0, 1.0, number + 1) for number in cells), indexing="ij"), axis=-1
    )  # fmt: skip
    return CoarseFields(
        cells, edge @ sample.cell, disks, coordination, fabric,
        of_disks.of(np.pi * sample.radius**2) / area,
        -of_contacts.of(contact_moments(contacts)) / area,
        None if start is None else _strain(sample, grid, *start),
    )  # fmt: skip


def contact_moments(contacts: Contacts) -> NDArray[np.float64]:
    """Force times branch of every contact, symmetric part: xx, yy, xy."""
    nx, ny = contacts.normal.T
    fx = contacts.normal_force * nx - contacts.tangential_force * ny
    fy = contacts.normal_force * ny + contacts.tangential_force * nx
    lx, ly = contacts.length * nx, contacts.length * ny
    return np.column_stack([fx * lx, fy * ly, 0.5 * (fx * ly + fy * lx)])


def _strain(
    sample: Sample, grid: _Grid, position: NDArray[np.float64], cell: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Strain of the linear map from the start that fits the disks around each point best."""
    position, cell = finite("start", position, (sample.count, 2)), finite("start", cell, (2, 2))
    point, source, value, image = grid.near(sample.position)
    # the same image of the disk, now and at the start, beside the point where it lies
    now = sample.position[source] - image @ sample.cell
    then = position[source] - image @ cell
    least = LEAST_SOURCES * float(kernel_values(grid.kernel, np.zeros(1))[0])
    return linear_map_strain(point, value, now, then, grid.count, least)


def linear_map_strain(
    point: NDArray[np.int64],
    value: NDArray[np.float64],
    now: NDArray[np.float64],
    then: NDArray[np.float64],
    count: int,
    least: float,
) -> NDArray[np.float64]:
    """Strain of the linear map that fits the places of sources around each point best, now and at the start.

    Parameters
    ----------
    point : (k,) int64
        Point of each pair of a point and a source.
    value : (k,)
        Its weight.
    now, then : (k, 2)
        Places of its source.
    count : int
        Points.
    least : float
        Sum of weights of which a map can be told.

    Returns
    -------
    (count, 3) float64
        xx, yy, xy (engineering shear strain), tension positive; NaN where there are too few sources.
    """

    def added(terms: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.bincount(point, value * terms, count).astype(np.float64)

    total = added(np.ones(len(value)))
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_now = np.stack([added(now[:, k]) / total for k in (0, 1)], axis=-1)
        mean_then = np.stack([added(then[:, k]) / total for k in (0, 1)], axis=-1)
    d_now, d_then = now - mean_now[point], then - mean_then[point]
    cross = np.array([[added(d_now[:, i] * d_then[:, j]) for j in (0, 1)] for i in (0, 1)]).transpose(2, 0, 1)
    own = np.array([[added(d_then[:, i] * d_then[:, j]) for j in (0, 1)] for i in (0, 1)]).transpose(2, 0, 1)
    strain = np.full((count, 3), np.nan)
    enough = total >= least
    told = np.flatnonzero(enough & (np.linalg.det(own) > 0.0))
    gradient = cross[told] @ np.linalg.inv(own[told])
    strain[told, 0], strain[told, 1] = gradient[:, 0, 0] - 1.0, gradient[:, 1, 1] - 1.0
    strain[told, 2] = gradient[:, 0, 1] + gradient[:, 1, 0]
    return strain
