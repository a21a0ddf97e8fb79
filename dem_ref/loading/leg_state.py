"""Where a loading is within its leg, and whether it still gets on."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.sample.disks import SampleError

LEG_NUMBERS = 23
UNSEEN = 1e300
"""Unrest of a leg that is not at its end yet."""

WATCH = 50_000
"""Chunks after which a loading is looked at for whether it still gets on: two million steps. A thousand disks without
friction were seen to take half a million until a rearrangement had come to rest and the loading went on."""
LEAST_PROGRESS = 1e-6
LEAST_STRAIN = 0.1
"""In units of p over the bulk modulus; a sample that flows under a stress it lags behind moves a hundred times that."""
LEAST_CALMING = 0.5


@dataclass
class LegState:
    """Where a loading is within its leg; with the sample all that is needed to go on.

    `softening` is what the stress-controlled directions were found to need in strain beyond the elastic estimate, per
    strain asked for; it is learnt on the way, so that a softening sample does not lag behind its path. `watched` counts
    chunks since progress, strain and unrest were last looked at, and the `seen_` values are what they were then.
    """

    progress: float = 0.0
    pace: float = 0.0
    settled: float = 0.0
    start_stress: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    start_strain: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    target: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    softening: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    inertial_number: float = 0.0
    unbalanced_force: float = 0.0
    watched: float = 0.0
    seen_progress: float = 0.0
    seen_unrest: float = UNSEEN
    seen_strain: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))

    def to_array(self) -> NDArray[np.float64]:
        """All numbers in one array, for a checkpoint."""
        head = [self.progress, self.pace, self.settled, self.inertial_number, self.unbalanced_force]
        seen = [self.watched, self.seen_progress, self.seen_unrest]
        vectors = [self.start_stress, self.start_strain, self.target, self.softening, self.seen_strain]
        return np.concatenate([head, seen, *vectors])

    @staticmethod
    def from_array(a: NDArray[np.float64]) -> LegState:
        """Inverse of `to_array`."""
        if a.shape != (LEG_NUMBERS,):
            raise SampleError(f"a stored state of a leg has {LEG_NUMBERS} numbers, not {a.shape}")
        progress, pace, settled, inertial_number, unbalanced, *seen = (float(v) for v in a[:8])
        start_stress, start_strain, target, softening, seen_strain = (a[k : k + 3].copy() for k in range(8, 23, 3))
        return LegState(
            progress, pace, settled, start_stress, start_strain, target, softening, inertial_number, unbalanced,
            seen[0], seen[1], seen[2], seen_strain,
        )  # fmt: skip

    def stands_still(self, strain: NDArray[np.float64], unrest: float, elastic_strain: float) -> bool:
        """Whether, since the last look `WATCH` chunks ago, nothing moved, got on or became calmer; call once a chunk.

        Parameters
        ----------
        strain : (3,)
            Tensor strain of the sample.
        unrest : float
            What keeps the leg from its end, over what is allowed; counts when all of its path has been gone.
        elastic_strain : float
            p over the bulk modulus.
        """
        self.watched += 1.0
        if self.watched < WATCH:
            return False
        arrived = self.progress >= 1.0
        alive = (
            self.progress - self.seen_progress > LEAST_PROGRESS
            or float(np.abs(strain - self.seen_strain).max()) > LEAST_STRAIN * elastic_strain
            or (arrived and unrest < LEAST_CALMING * self.seen_unrest)
        )
        self.watched, self.seen_progress = 0.0, self.progress
        self.seen_strain = strain.copy()
        self.seen_unrest = unrest if arrived else UNSEEN
        return not alive
