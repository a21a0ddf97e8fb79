"""Columns of `history.csv` for what the supports bear: moments, and the resultant of all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.results import StepResult

Array = NDArray[np.float64]

TOTAL = ("reaction_total_x", "reaction_total_y", "reaction_total_moment")


class ReactionColumns:
    """Moments about the origin of the forces of the supports on the body, and their sums; none without supports.

    A node that belongs to two boundaries counts for both, and once in the total, which holds supported points and
    displaced rigid bodies as well: with the loads, and the forces of springs, it is in equilibrium.

    Parameters
    ----------
    space : Space
    supported : list of str
        Boundaries.
    """

    def __init__(self, space: Space, supported: list[str]) -> None:
        self._places = space.nodes
        self._nodes = [space.boundary_nodes(name) for name in supported]
        self.names = [*(f"reaction_{name}_moment" for name in supported), *(TOTAL if supported else ())]

    def values(self, step: StepResult) -> list[float]:
        """Of one step, in the order of the names: moments [N m/m], forces [N/m]."""
        if not self.names:
            return []
        force = np.zeros_like(self._places) if step.support is None else step.support.reshape(-1, 2)
        moment = self._places[:, 0] * force[:, 1] - self._places[:, 1] * force[:, 0]
        of_boundaries = [float(moment[nodes].sum()) for nodes in self._nodes]
        return [*of_boundaries, *map(float, force.sum(axis=0)), float(moment.sum())]
