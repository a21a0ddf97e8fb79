"""How far a measured number may be off because the packing is small: standard errors from its parts.

What a packing gives is a sample of what all packings made alike would give. The standard error is that of one packing
against their mean. A packing is cut into blocks, the number is computed without each of them in turn (the jackknife),
and the scatter of these values says how much the parts differ. Blocks, not single contacts, because forces of
neighbours go together. Counts of few events get at least the error of a Poisson count of one more.

What blocks cannot tell is what all of a packing shares. The number of contacts without rattlers is nearly fixed by
isostaticity, so that for it, and for the bulk modulus, the error stated is an upper bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from granfabric.dem_ref.sample.disks import Sample

from .contacts import Contacts

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ALONG = 4
"""Blocks along each side of the cell."""
BLOCKS = ALONG * ALONG


@dataclass(frozen=True)
class Measured:
    """A measured number with its standard error.

    Attributes
    ----------
    value : float
        NaN if the packing does not give it.
    error : float
        Zero for what was chosen or follows from topology; NaN or infinite if the packing does not tell.
    """

    value: float
    error: float


def blocks_of(points: Array, cell: Array) -> NDArray[np.int64]:
    """Block, 0 to 15, of points anywhere in the periodic plane; shape (n,)."""
    reduced = points @ np.linalg.inv(cell)
    place = np.minimum((ALONG * (reduced - np.floor(reduced))).astype(np.int64), ALONG - 1)
    return ALONG * place[:, 0] + place[:, 1]


def blocks_of_contacts(sample: Sample, contacts: Contacts) -> NDArray[np.int64]:
    """Block of the middle of each contact."""
    half = 0.5 * contacts.length[:, None] * contacts.normal
    return blocks_of(sample.position[contacts.first] + half, sample.cell)


def jackknife(function: Callable[[int], ArrayLike]) -> Array:
    """Standard errors of what `function(block)` gives without a block: a number, or an array of numbers.

    NaN where the packing without some block gives no number.
    """
    with np.errstate(all="ignore"):
        values = np.array([np.asarray(function(block), dtype=np.float64) for block in range(BLOCKS)])
        deviation = values - values.mean(axis=0)
        return np.asarray(np.sqrt((BLOCKS - 1) / BLOCKS * np.sum(deviation**2, axis=0)))
