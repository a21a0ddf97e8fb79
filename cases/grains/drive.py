"""A strain increment applied to a packing: slowly, then held until it is at rest."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.dynamics.motion import Control, Motion
from granfabric.dem_ref.measures.contacts import love_weber_stress
from granfabric.dem_ref.sample.disks import Sample

Array = NDArray[np.float64]

CHUNK = 50
"""Steps between two looks at the unbalanced force."""


@dataclass(frozen=True)
class Pace:
    """How slowly packings are driven.

    Parameters
    ----------
    strain_step : float
        Largest strain (norm of the tensor) of one step of the motion.
    rest : float
        Unbalanced force over the mean contact force below which a packing is at rest.
    longest_rest : int
        Steps in which it has to come to rest.
    """

    strain_step: float = 2e-8
    rest: float = 1e-5
    longest_rest: int = 200_000


@dataclass(frozen=True)
class Driven:
    """What became of a packing.

    Parameters
    ----------
    stress : ndarray, shape (3,)
        xx, yy, xy, tension positive [Pa].
    at_rest : bool
    steps : int
        Of the motion.
    """

    stress: Array
    at_rest: bool
    steps: int


def drive(sample: Sample, increment: Array, pace: Pace) -> Driven:
    """Strain a packing at rest and let it come to rest again; it is changed in place.

    An increment in one go would send a wave through the packing that opens and slides contacts: the stress is then
    wrong by several per cent.

    Parameters
    ----------
    sample : Sample
    increment : ndarray, shape (3,)
        xx, yy, engineering xy, tension positive.
    pace : Pace
    """
    tensor = np.array([increment[0], increment[1], 0.5 * increment[2]])
    size = float(np.sqrt(tensor[0] ** 2 + tensor[1] ** 2 + 2.0 * tensor[2] ** 2))
    steps = max(1, ceil(size / pace.strain_step))
    motion = Motion(sample, threads=1)  # points are at work side by side
    motion.stress[:] = love_weber_stress(sample)
    # the strain of a step is not to be cut where it is the one that was asked for
    motion.run(steps, Control(drive=tensor / steps, fastest_rate=2.0 * size / steps + 1e-300))
    still, taken = Control(fastest_rate=0.0), 0
    while taken < pace.longest_rest:
        taken += motion.run(CHUNK, still)
        if motion.unbalanced_force <= pace.rest:
            break
    sample.velocity[:] = 0.0
    sample.spin[:] = 0.0
    sample.strain_rate[:] = 0.0
    return Driven(love_weber_stress(sample), motion.unbalanced_force <= pace.rest, motion.steps_done)
