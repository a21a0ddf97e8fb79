"""The elements of a rank that are there at a stage."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .distribution import Distribution


class LocalPart:
    """What `ActivePart` is for the own host: some of the cells that this rank owns, perhaps none.

    Parameters
    ----------
    space : Distribution
    active : ndarray of bool, shape (nelements,)
        Those of them that are there.

    Attributes
    ----------
    cells, points : ndarray of int
        Numbers of these cells and of their integration points among those of the rank, ascending.
    point_numbers : ndarray of int
        The points' numbers on rank 0.
    weights : ndarray
        Their areas [m^2].
    """

    def __init__(self, space: Distribution, active: NDArray[np.bool_]) -> None:
        self.cells = np.flatnonzero(active)
        self.points = np.flatnonzero(active[space.point_cell])
        self.point_numbers = space.point_numbers[self.points]
        self.weights = space.weights[self.points]
        self.ndofs = space.ndofs
        self.npoints = len(self.points)
