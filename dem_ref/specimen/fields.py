"""Fields of a specimen at given points: contacts, fabric, stress and strain, averaged with a kernel.

As in `measures.coarse_graining` every disk and every contact is shared out among the points with weights that add up to
one, by the kernel of its distance from each over the sum of these; so is every place between the platens and the
membranes, which gives each point the area that it stands for. At the edges, where a kernel reaches beyond the specimen,
nothing is lost and nothing is averaged with what is not there. A contact of a disk with a platen counts in the stress,
with the branch from its centre to the platen, and so does what a membrane exerts on a disk: the mean of the stress over
the area is what platens and membranes exert. In coordination and fabric contacts between disks count, and disks between
the membranes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from granfabric.dem_ref.arrays import SampleError, finite, number
from granfabric.dem_ref.measures.coarse_graining import (
    GAUSSIAN_REACH,
    LEAST_SOURCES,
    Shares,
    contact_moments,
    kernel_values,
    linear_map_strain,
)
from granfabric.dem_ref.measures.contacts import contacts_of

from .membrane import both_sides, outline
from .specimen import Specimen

Array = NDArray[np.float64]

PLACES = 0.25
"""Distance of the places by which areas are told, mean diameters."""


@dataclass(frozen=True)
class SpecimenFields:
    """Fields of a specimen at m points.

    Attributes
    ----------
    area : (m,)
        That each point stands for; adds up to that between platens and membranes.
    disks : (m,)
        Disks that each point stands for.
    coordination : (m,)
        Contacts with other disks of a disk; NaN where there is none.
    fabric : (m, 2)
        Anisotropy ``a_c`` as a double-angle vector; NaN where there is no contact.
    solid_fraction : (m,)
    stress : (m, 3)
        xx, yy, xy; Pa, tension positive; NaN where a point stands for no area.
    strain : (m, 3)
        xx, yy, xy (engineering shear strain) since the start, tension positive: the linear map of the disks around a
        point that fits best. NaN without a start.
    """

    area: Array
    disks: Array
    coordination: Array
    fabric: Array
    solid_fraction: Array
    stress: Array
    strain: Array


class _Points:
    def __init__(self, places: Array, kernel: str, scale: float) -> None:
        self.kernel, self.scale, self.count = kernel, scale, len(places)
        self.reach = scale * (GAUSSIAN_REACH if kernel == "gaussian" else 1.0)
        self.tree = cKDTree(places)

    def near(self, position: Array) -> tuple[NDArray, NDArray, Array]:
        """Pairs of a point and a source, with the kernel."""
        found = cKDTree(position).sparse_distance_matrix(self.tree, self.reach, output_type="ndarray")
        value = kernel_values(self.kernel, found["v"] / self.scale)
        used = value > 0.0
        return found["j"][used], found["i"][used], value[used]

    def shares(self, position: Array) -> Shares:
        """Of sources at these positions; one out of reach of all points belongs to the nearest."""
        point, source, value = self.near(position)
        total = np.bincount(source, value, len(position))
        lone = np.flatnonzero(~(total > 0.0))
        share = value / total[source]
        if len(lone):
            nearest = np.asarray(self.tree.query(position[lone])[1], dtype=np.int64)
            point, source = np.concatenate([point, nearest]), np.concatenate([source, lone])
            share = np.concatenate([share, np.ones(len(lone))])
        return Shares(point, source, share, self.count)


def is_inside(places: Array, corners: Array) -> NDArray[np.bool_]:
    """Which places, shape (n, 2), lie in a polygon with these corners, shape (m, 2)."""
    order = np.argsort(places[:, 1], kind="stable")
    height = places[order, 1]
    odd = np.zeros(len(places), dtype=bool)
    for (x0, y0), (x1, y1) in zip(corners.tolist(), np.roll(corners, -1, axis=0).tolist()):
        if y0 == y1:
            continue
        first, last = np.searchsorted(height, sorted((y0, y1)))
        there = order[first:last]
        odd[there] ^= places[there, 0] < x0 + (x1 - x0) * (places[there, 1] - y0) / (y1 - y0)
    return odd


def sides(specimen: Specimen) -> tuple[float, float]:
    """Where the membranes stand on average: x of the left and of the right one."""
    position, height = specimen.sample.position, specimen.height
    corners = outline(position, specimen.sample.radius, specimen.left, specimen.right, *specimen.platens)
    right, left = corners[: len(specimen.right) + 2], corners[len(specimen.right) + 2 :][::-1]
    return tuple(  # type: ignore[return-value]
        float(np.sum(0.5 * (line[1:, 0] + line[:-1, 0]) * np.diff(line[:, 1])) / height) for line in (left, right)
    )


def places_in(specimen: Specimen, reduced: Array) -> Array:
    """Places in the specimen as it is now of points given from 0 to 1 across and along it, shape (m, 2)."""
    left, right = sides(specimen)
    return np.column_stack(
        [left + (right - left) * reduced[:, 0], specimen.platens[0] + specimen.height * reduced[:, 1]]
    )


def specimen_fields(
    specimen: Specimen, points: Array, scale: float, kernel: str = "lucy", start: Array | None = None
) -> SpecimenFields:
    """Average a specimen at points.

    Parameters
    ----------
    specimen : Specimen
    points : ndarray, shape (m, 2)
        From 0 at the left membrane and the lower platen to 1 at the right one and the upper one.
    scale : float
        h of the kernel, in mean diameters.
    kernel : str
        ``"gaussian"``, ``"lucy"`` or ``"heaviside"``.
    start : ndarray, shape (n, 2), optional
        Positions from which strains count.

    Raises
    ------
    SampleError
        On values out of bounds, or arrays of another shape.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or not len(points) or not np.isfinite(points).all():
        raise SampleError(f"points have the shape (m, 2) and are finite; got {points.shape}")
    sample = specimen.sample
    diameter = sample.mean_diameter
    scale = number("scale", scale, 1e-3, 1e6) * diameter
    kernel_values(kernel, np.zeros(1))
    grid = _Points(places_in(specimen, points), kernel, scale)
    corners = outline(sample.position, sample.radius, specimen.left, specimen.right, *specimen.platens)
    area = grid.shares(_filled(corners, PLACES * diameter)).of_ones() * (PLACES * diameter) ** 2
    area *= specimen.area / area.sum()
    contacts, outer = contacts_of(sample), specimen.platen_contacts()
    middle = sample.position[contacts.first] + 0.5 * contacts.normal * contacts.length[:, None]
    at = sample.position[outer.disk]
    to_platen = np.column_stack([np.zeros(len(at)), specimen.platens[outer.side] - at[:, 1]])
    on_platen = np.column_stack([outer.shear_force, np.where(outer.side == 0, -1.0, 1.0) * outer.normal_force])
    moments = np.column_stack(
        [
            on_platen[:, 0] * to_platen[:, 0], on_platen[:, 1] * to_platen[:, 1],
            0.5 * (on_platen[:, 0] * to_platen[:, 1] + on_platen[:, 1] * to_platen[:, 0]),
        ]
    )  # fmt: skip
    of_contacts = grid.shares(middle)
    held, from_membrane = _membrane_moments(specimen)
    stress = of_contacts.of(contact_moments(contacts)) + grid.shares(at + 0.5 * to_platen).of(moments)
    stress += grid.shares(sample.position[held]).of(from_membrane)
    between = is_inside(sample.position, corners)
    between[specimen.left] = between[specimen.right] = True
    of_disks = grid.shares(sample.position)
    number_of = np.bincount(np.concatenate([contacts.first, contacts.second]), minlength=sample.count).astype(float)
    disks = of_disks.of(between.astype(float))
    with np.errstate(invalid="ignore", divide="ignore"):
        return SpecimenFields(
            area, disks,
            of_disks.of(np.where(between, number_of, 0.0)) / disks,
            2.0 * of_contacts.of(contacts.double_angle) / of_contacts.of_ones()[:, None],
            of_disks.of(np.where(between, np.pi * sample.radius**2, 0.0)) / area,
            -stress / area[:, None],
            _strain(grid, sample.position, start),
        )  # fmt: skip


def _membrane_moments(specimen: Specimen) -> tuple[NDArray[np.int64], Array]:
    """Disks of the chains, and xx, yy, xy of force and branch from each one's centre to the membrane outside of it."""
    sample = specimen.sample
    force = np.zeros((sample.count, 2))
    lower, upper = (float(height) for height in specimen.platens)
    both_sides(sample.position, sample.radius, specimen.left, specimen.right, lower, upper, specimen.pressure, force)
    held = np.concatenate([specimen.left, specimen.right])
    inwards = np.concatenate([np.ones(len(specimen.left)), -np.ones(len(specimen.right))])
    branch = inwards * sample.radius[held]
    return held, branch[:, None] * np.column_stack([force[held, 0], np.zeros(len(held)), 0.5 * force[held, 1]])


def _filled(corners: Array, distance: float) -> Array:
    """Places on a square array inside a polygon."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    x, y = (np.arange(a + 0.5 * distance, b, distance) for a, b in zip(low, high))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return places[is_inside(places, corners)]


def _strain(grid: _Points, now: Array, start: Array | None) -> Array:
    if start is None:
        return np.full((grid.count, 3), np.nan)
    then = finite("start", start, now.shape)
    point, source, value = grid.near(now)
    least = LEAST_SOURCES * float(kernel_values(grid.kernel, np.zeros(1))[0])
    return linear_map_strain(point, value, now[source], then[source], grid.count, least)
