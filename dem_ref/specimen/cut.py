"""What a specimen is cut from, and what bounds it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import number
from granfabric.dem_ref.sample.disks import Sample


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
    """

    platen_friction: float = 0.5
    lateral_pressure: float | None = None
    unit_weight: float = 0.0
    consolidation_friction: float = 0.0
    inertial_number: float = 3e-5

    def check(self) -> None:
        """Raise `SampleError` on the first value out of bounds."""
        number("platen_friction", self.platen_friction, 0.0, 1e3)
        number("consolidation_friction", self.consolidation_friction, 0.0, 1e3)
        number("unit_weight", self.unit_weight, 0.0, 1e300)
        number("inertial_number", self.inertial_number, 1e-12, 0.1)
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
