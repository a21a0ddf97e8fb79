"""Stiffness of a packing as it stands: springs of its contacts, disks free to find their balance (static condensation).

Contacts at Coulomb's limit keep their normal spring alone, and forces that turn with the contacts are left out: both
matter little for what it is used for, a first guess of the tangent.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix, identity
from scipy.sparse.linalg import splu

from granfabric.dem_ref.measures.contacts import SLIDING_FRACTION, contacts_of
from granfabric.dem_ref.sample.disks import Sample

Array = NDArray[np.float64]

LOOSE = 1e-7
"""Of the normal stiffness: a spring to the ground for every disk, so that those without contacts stay where
they are."""


def network_stiffness(sample: Sample) -> Array:
    """``d stress / d strain`` of a packing, shape (3, 3): xx, yy, xy; engineering shear strain [Pa].

    Zero where there are no contacts.
    """
    contacts = contacts_of(sample)
    if not contacts.count:
        return np.zeros((3, 3))
    count, kn = sample.count, sample.normal_stiffness
    nx, ny, length = contacts.normal[:, 0], contacts.normal[:, 1], contacts.length
    slides = np.abs(contacts.tangential_force) >= SLIDING_FRACTION * sample.friction * contacts.normal_force
    shear = np.where(slides, 0.0, kn * sample.stiffness_ratio)
    rows = np.arange(contacts.count)
    one = np.ones(contacts.count)
    first, second = 3 * contacts.first, 3 * contacts.second
    # elongations of the springs: along the normal, and along the tangent less what both disks turn
    normal = csc_matrix(
        (
            np.concatenate([-nx, -ny, nx, ny]),
            (np.tile(rows, 4), np.concatenate([first, first + 1, second, second + 1])),
        ),
        shape=(contacts.count, 3 * count),
    )
    tangential = csc_matrix(
        (
            np.concatenate([ny, -nx, -one, -ny, nx, -one]),
            (np.tile(rows, 6), np.concatenate([first, first + 1, first + 2, second, second + 1, second + 2])),
        ),
        shape=(contacts.count, 3 * count),
    )
    # the same of a strain of the cell, for xx, yy, engineering xy
    normal_strain = length[:, None] * np.stack([nx * nx, ny * ny, nx * ny], axis=1)
    tangential_strain = length[:, None] * np.stack([-nx * ny, nx * ny, 0.5 * (nx * nx - ny * ny)], axis=1)
    inner = (normal.T * kn) @ normal + tangential.T.multiply(shear) @ tangential + LOOSE * kn * identity(3 * count)
    coupling = normal.T @ (kn * normal_strain) + tangential.T @ (shear[:, None] * tangential_strain)
    outer = normal_strain.T @ (kn * normal_strain) + tangential_strain.T @ (shear[:, None] * tangential_strain)
    relaxed = splu(csc_matrix(inner), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(coupling)
    stiffness: Array = (outer - coupling.T @ relaxed) / sample.area
    return 0.5 * (stiffness + stiffness.T)
