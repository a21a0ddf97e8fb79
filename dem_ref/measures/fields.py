"""Plain arrays of particles and contacts for a writer of pictures or VTK files."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.sample.disks import Sample

from .contacts import bearing_particles, contacts_of, rattler_minimum


def particle_fields(sample: Sample) -> dict[str, NDArray]:
    """Particles as points: position (n, 2) wrapped into the cell, radius, contacts, bears_force (0/1), pressure (Pa).

    `pressure` is the mean compressive stress of a particle: ``sum f_n r/(2 pi r^2)`` over its contacts.
    """
    n = sample.count
    contacts = contacts_of(sample)
    ends = np.concatenate([contacts.first, contacts.second])
    force = np.concatenate([contacts.normal_force, contacts.normal_force])
    return {
        "position": sample.position - np.floor(sample.position @ np.linalg.inv(sample.cell)) @ sample.cell,
        "radius": sample.radius.copy(),
        "contacts": np.bincount(ends, minlength=n),
        "bears_force": bearing_particles(n, contacts, rattler_minimum(sample)).astype(np.int64),
        "pressure": np.bincount(ends, force, n) / (2.0 * np.pi * sample.radius),
    }


def contact_fields(sample: Sample, wrapped: bool = True) -> dict[str, NDArray]:
    """Contacts as lines: start and end (m, 2), normal_force, tangential_force, mobilisation ``|ft|/(mu fn)``.

    A line starts at its wrapped first centre and ends at the image of the second that touches it, so that lines across
    the border stick out of the cell instead of crossing it. Centres are taken as they are if not `wrapped`.
    """
    contacts = contacts_of(sample)
    first = sample.position[contacts.first]
    start = first - np.floor(first @ np.linalg.inv(sample.cell)) @ sample.cell if wrapped else first
    limit = np.maximum(sample.friction * contacts.normal_force, 1e-300)
    return {
        "start": start,
        "end": start + contacts.normal * contacts.length[:, None],
        "normal_force": contacts.normal_force,
        "tangential_force": contacts.tangential_force,
        "mobilisation": np.abs(contacts.tangential_force) / limit,
    }
