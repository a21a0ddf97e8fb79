"""A packing as one row of state columns, and back.

What does not change while it is loaded (radii, stiffness, friction) stays outside: the row names the packing it began
as. A row holds that number, the pressure that it began with, the periodic cell, the centres, and of each contact its
key and its tangential elongation. A planar packing has fewer than three contacts a disk, so that eight columns a disk
and six more are enough.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.measures.contacts import contacts_of
from granfabric.dem_ref.sample.disks import Sample
from granfabric.dem_ref.sample.neighbours import NearPairs

Array = NDArray[np.float64]

HEAD = 6
CONTACTS_A_DISK = 3
MOST_DISKS = 100_000
"""Above, the key of a contact and its image are no longer whole numbers in a column."""
_OFFSET, _BASE = 128, 256
"""Of an image's two numbers, each of eight bits."""


class PackingError(ValueError):
    """A packing does not fit its row."""


def width(disks: int) -> int:
    """Columns of a packing."""
    return HEAD + (2 + 2 * CONTACTS_A_DISK) * disks


def write(sample: Sample, number: int, pressure: float, row: Array) -> None:
    """Put a packing at rest into a row of `width` columns; its velocities are left out.

    Parameters
    ----------
    sample : Sample
    number : int
        Of the packing as which it began.
    pressure : float
        Mean pressure with which it began [Pa].
    row : ndarray, shape (width,)
        Written.

    Raises
    ------
    PackingError
        If it has more contacts than a planar packing can have.
    """
    count = sample.count
    contacts = contacts_of(sample)
    if contacts.count > CONTACTS_A_DISK * count:
        raise PackingError(f"{contacts.count} contacts of {count} disks are more than lie in a plane")
    row[:] = 0.0
    row[0], row[1] = number, pressure
    row[2:HEAD] = sample.cell.ravel()
    row[HEAD : HEAD + 2 * count] = sample.position.ravel()
    image = (contacts.image[:, 0].astype(np.int64) + _OFFSET) * _BASE + contacts.image[:, 1] + _OFFSET
    begin = HEAD + 2 * count
    # one is added so that zero means: no contact
    row[begin : begin + contacts.count] = contacts.key * _BASE**2 + image + 1
    begin += CONTACTS_A_DISK * count
    stiffness = sample.normal_stiffness * sample.stiffness_ratio
    row[begin : begin + contacts.count] = -contacts.tangential_force / stiffness


def read(row: Array, packings: list[Sample]) -> Sample:
    """The packing of a row, at rest; `packings` are those that rows may have begun as."""
    first = packings[int(row[0])]
    count = first.count
    begin = HEAD + 2 * count
    end = begin + CONTACTS_A_DISK * count
    used = int(np.count_nonzero(row[begin:end]))
    key, image = np.divmod(row[begin : begin + used].astype(np.int64) - 1, _BASE**2)
    image = np.stack([image // _BASE - _OFFSET, image % _BASE - _OFFSET], axis=1)
    pairs = NearPairs(
        (key // count).astype(np.uint32), (key % count).astype(np.uint32), image.astype(np.int8),
        row[end : end + used].copy(),
    )  # fmt: skip
    return Sample(
        row[HEAD:begin].reshape(count, 2).copy(), first.radius, row[2:HEAD].reshape(2, 2).copy(),
        first.normal_stiffness, first.stiffness_ratio, first.friction, np.zeros((count, 2)), np.zeros(count), pairs,
        seed=first.seed,
    )  # fmt: skip
