"""Measures of a sample, each written from its definition.

Directions: a contact normal at angle theta from the x axis enters through ``e = (cos 2 theta, sin 2 theta)``; second
harmonics are vectors in this double-angle plane. Forces are N per metre of thickness, compression positive; stresses
are tension positive, order xx, yy, xy.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.dynamics.motion import branch_vectors, lengths
from granfabric.dem_ref.sample.disks import Sample

SLIDING_FRACTION = 0.995  # of Coulomb's limit; springs and overlaps of a stored sample are half a step apart
HARMONICS_MINIMUM = 8


@dataclass(frozen=True)
class Contacts:
    """Touching pairs of a sample.

    Attributes
    ----------
    first, second : (m,) int64
        Particles, first < second, sorted.
    image : (m, 2) int8
        Periodic image of the second particle.
    normal : (m, 2)
        Unit vector from the first to the second centre.
    length : (m,)
        Distance of the centres.
    normal_force : (m,)
        Positive.
    tangential_force : (m,)
        On the second particle, along the normal turned counter-clockwise by a right angle.
    key : (m,) int64
        ``first * n + second``: identifies a pair for the life of a sample.
    """

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    image: NDArray[np.int8]
    normal: NDArray[np.float64]
    length: NDArray[np.float64]
    normal_force: NDArray[np.float64]
    tangential_force: NDArray[np.float64]
    key: NDArray[np.int64]

    @property
    def count(self) -> int:
        """Number of contacts."""
        return len(self.first)

    @property
    def double_angle(self) -> NDArray[np.float64]:
        """(m, 2) array of (cos 2 theta, sin 2 theta)."""
        nx, ny = self.normal[:, 0], self.normal[:, 1]
        e = np.empty((self.count, 2))
        e[:, 0] = nx * nx - ny * ny
        e[:, 1] = 2.0 * nx * ny
        return e

    def subset(self, mask: NDArray[np.bool_]) -> Contacts:
        """The contacts selected by a mask."""
        return Contacts(
            self.first[mask], self.second[mask], self.image[mask], self.normal[mask], self.length[mask],
            self.normal_force[mask], self.tangential_force[mask], self.key[mask],
        )  # fmt: skip


def contacts_of(sample: Sample) -> Contacts:
    """All pairs that touch, with their forces."""
    vectors = branch_vectors(sample)
    length = lengths(vectors)
    pairs = sample.pairs
    overlap = sample.radius.take(pairs.first) + sample.radius.take(pairs.second) - length
    touch = np.flatnonzero(overlap > 0.0)
    first, second = pairs.first.take(touch).astype(np.int64), pairs.second.take(touch).astype(np.int64)
    length = length.take(touch)
    kn = sample.normal_stiffness
    return Contacts(
        first,
        second,
        pairs.image.take(touch, axis=0),
        vectors.take(touch, axis=0) / length[:, None],
        length,
        kn * overlap.take(touch),
        -kn * sample.stiffness_ratio * pairs.tangential.take(touch),
        first * sample.count + second,
    )


def love_weber_stress(sample: Sample, contacts: Contacts | None = None) -> NDArray[np.float64]:
    """Mean stress of the cell (xx, yy, xy; tension positive): ``-sum f_i l_j / area``, symmetric part."""
    c = contacts or contacts_of(sample)
    nx, ny = c.normal[:, 0], c.normal[:, 1]
    fx = c.normal_force * nx - c.tangential_force * ny
    fy = c.normal_force * ny + c.tangential_force * nx
    lx, ly = c.length * nx, c.length * ny
    # sums, not products: their bits do not depend on the threads of BLAS
    return -np.array([np.sum(fx * lx), np.sum(fy * ly), 0.5 * (np.sum(fx * ly) + np.sum(fy * lx))]) / sample.area


def bearing_particles(count: int, contacts: Contacts, minimum: int) -> NDArray[np.bool_]:
    """Particles left after repeatedly removing those with fewer than `minimum` contacts among the ones left."""
    alive = np.ones(count, bool)
    while True:
        both = alive[contacts.first] & alive[contacts.second]
        number = np.bincount(contacts.first[both], minlength=count) + np.bincount(
            contacts.second[both], minlength=count
        )
        left = alive & (number >= minimum)
        if np.array_equal(left, alive):
            return alive
        alive = left


def rattler_minimum(sample: Sample) -> int:
    """Fewest contacts that can hold a disk: three without friction, two with."""
    return 3 if sample.friction == 0.0 else 2


@dataclass(frozen=True)
class Coordination:
    """Mean contacts per particle: over all particles, and over those that are not rattlers."""

    all_particles: float
    without_rattlers: float
    rattler_fraction: float


def coordination_number(sample: Sample, contacts: Contacts | None = None, minimum: int | None = None) -> Coordination:
    """Coordination number in both countings.

    Parameters
    ----------
    minimum : int, optional
        Particles with fewer contacts are rattlers (removed repeatedly); default `rattler_minimum`.
    """
    c = contacts or contacts_of(sample)
    alive = bearing_particles(sample.count, c, rattler_minimum(sample) if minimum is None else minimum)
    inside = int(np.count_nonzero(alive[c.first] & alive[c.second]))
    held = int(np.count_nonzero(alive))
    return Coordination(2.0 * c.count / sample.count, 2.0 * inside / max(held, 1), 1.0 - held / sample.count)


def fabric_tensor(contacts: Contacts) -> NDArray[np.float64]:
    """``F_ij = <n_i n_j>``, (2, 2)."""
    nx, ny = contacts.normal[:, 0], contacts.normal[:, 1]
    xx, xy, yy = float(np.sum(nx * nx)), float(np.sum(nx * ny)), float(np.sum(ny * ny))
    return np.array([[xx, xy], [xy, yy]]) / max(contacts.count, 1)


def fabric_anisotropy(contacts: Contacts) -> NDArray[np.float64]:
    """``a_c = 2 (F_1 - F_2)`` as a vector: ``2 <e>``, i.e. (2 (F_xx - F_yy), 4 F_xy)."""
    f = fabric_tensor(contacts)
    return np.array([2.0 * (f[0, 0] - f[1, 1]), 4.0 * f[0, 1]])


@dataclass(frozen=True)
class ForceHarmonics:
    """Direction dependence of the mean forces: ``f (1 + a_n . e)`` and ``-f a_t x e``.

    Attributes
    ----------
    mean : float
        f: mean over directions (not over contacts) of the mean normal force.
    contact_mean : float
        Mean normal force over contacts.
    normal, tangential : (2,)
        a_n and a_t.
    """

    mean: float
    contact_mean: float
    normal: NDArray[np.float64]
    tangential: NDArray[np.float64]


def force_harmonics(contacts: Contacts) -> ForceHarmonics:
    """Least-squares harmonics of the forces over all contacts.

    The normal forces are fitted by ``f + f a_n . e``, the tangential ones by ``c + f (a_t2 cos 2 theta - a_t1 sin 2
    theta)``, every contact with the same weight; the constant c vanishes by equilibrium of moments.
    """
    if contacts.count < HARMONICS_MINIMUM:
        return ForceHarmonics(0.0, 0.0, np.zeros(2), np.zeros(2))
    e = contacts.double_angle
    basis = (np.ones(contacts.count), e[:, 0].copy(), e[:, 1].copy())
    matrix = np.array([[np.sum(a * b) for b in basis] for a in basis])
    n0, n1, n2 = np.linalg.solve(matrix, [np.sum(a * contacts.normal_force) for a in basis])
    _, t1, t2 = np.linalg.solve(matrix, [np.sum(a * contacts.tangential_force) for a in basis])
    return ForceHarmonics(
        float(n0), float(contacts.normal_force.mean()), np.array([n1, n2]) / n0, np.array([-t2, t1]) / n0
    )


def sliding_fraction(sample: Sample, contacts: Contacts) -> float:
    """Fraction of contacts whose tangential force is within half a per cent of Coulomb's limit."""
    if sample.friction == 0.0 or contacts.count == 0:
        return 0.0
    limit = SLIDING_FRACTION * sample.friction * contacts.normal_force
    return float(np.mean(np.abs(contacts.tangential_force) >= limit))


def unbalanced_force(sample: Sample, contacts: Contacts | None = None) -> float:
    """Root mean square of the resultant contact force on a particle over the mean normal contact force."""
    c = contacts or contacts_of(sample)
    nx, ny = c.normal[:, 0], c.normal[:, 1]
    total = 0.0
    for along in (c.normal_force * nx - c.tangential_force * ny, c.normal_force * ny + c.tangential_force * nx):
        resultant = np.bincount(c.second, along, sample.count) - np.bincount(c.first, along, sample.count)
        total += float(np.sum(resultant * resultant))
    return float(np.sqrt(total / sample.count) / max(float(c.normal_force.mean()), 1e-300)) if c.count else 0.0


def magnitude(vector: NDArray[np.float64]) -> float:
    """Length of a double-angle vector."""
    return hypot(float(vector[0]), float(vector[1]))


def component_along(vector: NDArray[np.float64], angle: float) -> float:
    """Component of a double-angle vector along the direction at `angle` (radians from the x axis)."""
    return float(vector[0] * np.cos(2.0 * angle) + vector[1] * np.sin(2.0 * angle))
