"""Small samples that several tests of the DEM build on."""

from __future__ import annotations

import numpy as np

from granfabric.dem_ref.measures.contacts import Contacts
from granfabric.dem_ref.sample.disks import Sample, new_sample


def two_disks(gap: float, stiffness: float = 1.0, friction: float = 0.5, radius: float = 0.5) -> Sample:
    """Two disks side by side along x, in the middle of a wide cell."""
    distance = 2 * radius + gap
    position = np.array([[6.0 - distance / 2, 6.0], [6.0 + distance / 2, 6.0]])
    return new_sample(
        position,
        np.full(2, radius),
        12.0 * np.eye(2),
        normal_stiffness=stiffness,
        friction=friction,
        stiffness_ratio=1.0,
    )


def triangular_lattice(columns: int, rows: int, overlap: float, stiffness: float = 1.0, ratio: float = 1.0) -> Sample:
    """Equal disks of diameter 1 on a triangular lattice, six contacts each with the given overlap; `rows` even."""
    spacing = 1.0 - overlap
    height = spacing * np.sqrt(3.0) / 2.0
    position = [[(i + 0.5 * (j % 2)) * spacing, j * height] for j in range(rows) for i in range(columns)]
    cell = np.diag([columns * spacing, rows * height])
    return new_sample(
        np.array(position) + 0.1, np.full(rows * columns, 0.5), cell, normal_stiffness=stiffness, stiffness_ratio=ratio
    )


def contact_list(theta, normal_force=1.0, tangential_force=0.0, key=None) -> Contacts:
    """Contacts made up from their directions and forces; lengths are 1, pairs are told by `key`."""
    theta = np.asarray(theta, dtype=float)
    identity = np.arange(len(theta)) if key is None else np.asarray(key)
    normal, tangential = (np.broadcast_to(f, theta.shape).astype(float) for f in (normal_force, tangential_force))
    return Contacts(
        identity, identity + 1, np.zeros((len(theta), 2), np.int8), np.column_stack([np.cos(theta), np.sin(theta)]),
        np.ones(len(theta)), normal, tangential, identity,
    )  # fmt: skip
