"""Change of the contact network between two states of a sample, split into gained, lost and persisting contacts.

With M contacts before, M' after, and e = (cos 2 theta, sin 2 theta), the anisotropy ``a_c = 2 <e>`` changes exactly by

    M' (a_c' - a_c) = sum_gained (2 e' - a_c) - sum_lost (2 e - a_c) + sum_persisting 2 (e' - e),

which is the finite form of ``da_c = 2 <(g - l) e> - a_c dz/z`` plus the turning of contacts that stay.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .contacts import Contacts, fabric_anisotropy


@dataclass(frozen=True)
class NetworkChange:
    """Gained, lost and persisting contacts between two states.

    Attributes
    ----------
    coordination_gained, coordination_lost : float
        Change of the coordination number (over all particles) by each; ``dz = gained - lost``.
    fabric_gained, fabric_lost, fabric_persisting : (2,)
        Contributions to the change of a_c; their sum is the change.
    gained, lost, persisting : int
        Numbers of contacts.
    """

    coordination_gained: float
    coordination_lost: float
    fabric_gained: NDArray[np.float64]
    fabric_lost: NDArray[np.float64]
    fabric_persisting: NDArray[np.float64]
    gained: int
    lost: int
    persisting: int


@dataclass(frozen=True)
class Matching:
    """Which contacts of two lists are the same pair: masks of lost and gained, indices of those that persist."""

    lost: NDArray[np.bool_]
    gained: NDArray[np.bool_]
    persisting_before: NDArray[np.int64]
    persisting_after: NDArray[np.int64]


def _shared(before: NDArray[np.int64], after: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Places of the keys that are in both, in ascending order of the keys."""
    if len(before) and len(after) and (np.diff(before) > 0).all() and (np.diff(after) > 0).all():
        place = np.minimum(np.searchsorted(after, before), len(after) - 1)
        old = np.flatnonzero(after.take(place) == before)
        return old, place.take(old)
    _, old, new = np.intersect1d(before, after, assume_unique=True, return_indices=True)
    return old, new


def match_contacts(before: Contacts, after: Contacts) -> Matching:
    """Match the contacts of two states of the same sample by their pairs."""
    old, new = _shared(before.key, after.key)
    lost = np.ones(before.count, bool)
    lost[old] = False
    gained = np.ones(after.count, bool)
    gained[new] = False
    return Matching(lost, gained, old, new)


def network_change(before: Contacts, after: Contacts, particles: int) -> NetworkChange:
    """Split the change of coordination number and fabric anisotropy between two states of the same sample."""
    m = match_contacts(before, after)
    a = fabric_anisotropy(before)
    e0, e1 = before.double_angle, after.double_angle
    turned = e1.take(m.persisting_after, axis=0) - e0.take(m.persisting_before, axis=0)
    scale = 1.0 / max(after.count, 1)
    return NetworkChange(
        2.0 * int(m.gained.sum()) / particles,
        2.0 * int(m.lost.sum()) / particles,
        scale * (2.0 * e1[m.gained] - a).sum(axis=0),
        -scale * (2.0 * e0[m.lost] - a).sum(axis=0),
        scale * 2.0 * np.array([turned[:, 0].sum(), turned[:, 1].sum()]),
        int(m.gained.sum()),
        int(m.lost.sum()),
        len(m.persisting_before),
    )


@dataclass(frozen=True)
class DirectionalChange:
    """Fractions of contacts lost and gained by direction.

    Attributes
    ----------
    angle : (bins,)
        Centres of the bins, radians in [0, pi).
    present : (bins,) int
        Contacts at first.
    lost, gained : (bins,)
        Over the contacts present at first in that direction.
    """

    angle: NDArray[np.float64]
    present: NDArray[np.int64]
    lost: NDArray[np.float64]
    gained: NDArray[np.float64]


def directional_change(before: Contacts, after: Contacts, bins: int = 12) -> DirectionalChange:
    """Lost and gained fractions in bins of the contact direction; one bin is centred on 0."""
    m = match_contacts(before, after)

    def count(normal: NDArray[np.float64]) -> NDArray[np.int64]:
        angle = np.arctan2(normal[:, 1], normal[:, 0])
        index = np.floor(angle / np.pi * bins + 0.5).astype(np.int64) % bins
        return np.bincount(index, minlength=bins)

    present = count(before.normal)
    divide = np.maximum(present, 1)
    return DirectionalChange(
        np.arange(bins) * np.pi / bins,
        present,
        count(before.normal[m.lost]) / divide,
        count(after.normal[m.gained]) / divide,
    )
