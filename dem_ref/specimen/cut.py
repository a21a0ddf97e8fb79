"""What a specimen is cut from, and what bounds it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import SampleError, number, whole
from granfabric.dem_ref.sample.disks import Sample
from granfabric.dem_ref.sample.neighbours import find_near_pairs

MARGIN = 1.0
"""Empty space beside the specimen on each side, over its size."""
FEWEST_DISKS = 20


@dataclass(frozen=True)
class SpecimenOptions:
    """Boundaries of a specimen.

    Attributes
    ----------
    platen_friction : float
        Between disks and platens; 0 is smooth.
    lateral_pressure : float, optional
        Of the membranes, Pa; that of the packing if not given.
    unit_weight : float
        Of the disks, N per cubic metre, downwards; 0 for no gravity.
    consolidation_friction : float
        Between disks, and on platens no more than theirs, while the specimen comes to rest after the cut.
    inertial_number : float
        Of a compression, strain rate times sqrt(m/p).
    height_to_width : float, optional
        Of the specimen; the largest one that the cell of the packing holds is cut. All of the cell if not given.
    at_rest : float
        Unbalanced force, over the mean contact force, that counts as rest.
    longest_rest : int
        Steps in which it has to come to rest.
    """

    platen_friction: float = 0.5
    lateral_pressure: float | None = None
    unit_weight: float = 0.0
    consolidation_friction: float = 0.0
    inertial_number: float = 3e-5
    height_to_width: float | None = None
    at_rest: float = 1e-4
    longest_rest: int = 400_000

    def check(self) -> None:
        """Raise `SampleError` on the first value out of bounds."""
        number("platen_friction", self.platen_friction, 0.0, 1e3)
        number("consolidation_friction", self.consolidation_friction, 0.0, 1e3)
        number("unit_weight", self.unit_weight, 0.0, 1e300)
        number("inertial_number", self.inertial_number, 1e-12, 0.1)
        number("at_rest", self.at_rest, 1e-8, 1e-2)
        whole("longest_rest", self.longest_rest, 1)
        if self.height_to_width is not None:
            number("height_to_width", self.height_to_width, 0.1, 10.0)
        if self.lateral_pressure is not None:
            number("lateral_pressure", self.lateral_pressure, 1e-300, 1e300)


def cut(packing: Sample, size: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Places and numbers of the disks of the periodic packing in a rectangle of this size.

    Their centres are inside it, and above and below, where the platens come, they are inside with all of themselves.
    """
    reduced = packing.position @ np.linalg.inv(packing.cell)
    inside = (reduced - np.floor(reduced)) @ packing.cell
    places, numbers = [], []
    for a in (-1, 0, 1):
        for b in (-1, 0, 1):
            place = inside + np.array([a, b]) @ packing.cell
            kept = (place[:, 0] >= 0.0) & (place[:, 0] < size[0])
            kept &= (place[:, 1] >= packing.radius) & (place[:, 1] <= size[1] - packing.radius)
            places.append(place[kept])
            numbers.append(np.flatnonzero(kept))
    number, place = np.concatenate(numbers), np.concatenate(places)
    order = np.argsort(number, kind="stable")  # that of the packing, near in space
    return place[order], number[order]


def size_of(packing: Sample, height_to_width: float | None) -> NDArray[np.float64]:
    """Width and height of the specimen that is cut from a packing."""
    width, height = float(packing.cell[0, 0]), float(packing.cell[1, 1])
    if height_to_width is None:
        return np.array([width, height])
    if height_to_width > height / width:
        return np.array([height / height_to_width, height])
    return np.array([width, width * height_to_width])


def disks_of(packing: Sample, height_to_width: float | None, skin: float) -> tuple[Sample, float]:
    """The disks of a specimen, standing on y = 0 with their middle at x = 0, and the height of the highest point.

    Raises
    ------
    SampleError
        If there are too few, or the cell of the packing is no rectangle along the axes.
    """
    if abs(packing.cell[0, 1]) + abs(packing.cell[1, 0]) > 0.2 * min(packing.cell[0, 0], packing.cell[1, 1]):
        raise SampleError("a specimen is cut from a packing whose cell is nearly a rectangle along the axes")
    size = size_of(packing, height_to_width)
    place, kept = cut(packing, size)
    if len(kept) < FEWEST_DISKS:
        raise SampleError(f"{len(kept)} disks are too few for a specimen")
    cell = np.diag((1.0 + 2.0 * MARGIN) * size)
    position = np.ascontiguousarray(place - [0.5 * size[0], 0.0])
    radius = np.ascontiguousarray(packing.radius[kept])
    pairs = find_near_pairs(position, radius, cell, skin)
    sample = Sample(
        position, radius, cell, packing.normal_stiffness, packing.stiffness_ratio, packing.friction,
        np.zeros((len(kept), 2)), np.zeros(len(kept)), pairs, seed=packing.seed,
    )  # fmt: skip
    _carry_tangential(sample, packing, kept)
    # onto the disks, which the cut has left at some distance
    sample.position[:, 1] -= (sample.position[:, 1] - radius).min()
    return sample, float((sample.position[:, 1] + radius).max())


def _carry_tangential(sample: Sample, packing: Sample, kept: NDArray[np.int64]) -> None:
    """Elongations of those contacts of the packing that the cut has left."""
    number_of = np.full(packing.count, -1)
    number_of[kept] = np.arange(len(kept))
    known = packing.pairs.tangential != 0.0
    ends = number_of[packing.pairs.first[known]], number_of[packing.pairs.second[known]]
    held = {(i, j): e for i, j, e in zip(*(a.tolist() for a in ends), packing.pairs.tangential[known]) if i >= 0}
    for k, key in enumerate(zip(sample.pairs.first.tolist(), sample.pairs.second.tolist())):
        sample.pairs.tangential[k] = held.get(key, 0.0)
