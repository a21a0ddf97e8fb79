"""Strain, stress and state of all points through a run whose stages change the body or count displacements anew."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.loads.problem import Problem

Array = NDArray[np.float64]


class Carried:
    """Paths without jumps from the steps of a run: a point that is not there stays as it was.

    Before it is placed a point has its initial stress and state; what is taken away stays as it was last. Strains count
    from the beginning, whatever stages reset and however often a part is placed.

    Parameters
    ----------
    problem : Problem
    """

    def __init__(self, problem: Problem) -> None:
        self._cells = problem.space.point_cell
        self._resets = {stage.name for stage in problem.stages if stage.reset_displacements}
        self._stage = problem.stages[0].name
        npt = problem.space.npoints
        self._last = (np.zeros((npt, 3)), problem.initial_stress, problem.initial_state)
        self._offset: Array | None = None
        self._there = np.zeros(npt, dtype=bool)

    def __call__(self, step: StepResult) -> tuple[Array, Array, Array]:
        """Strain, stress and state at all points, shapes (npt, 3), (npt, 3), (npt, nstate); not to be written."""
        there = None if step.active is None else step.active[self._cells]
        if step.stage != self._stage:
            self._stage = step.stage
            if step.stage in self._resets:
                self._offset = self._last[0].copy()
        if there is not None:
            placed = there & ~self._there
            self._there = there
            if placed.any():
                self._offset = np.zeros_like(step.strain) if self._offset is None else self._offset
                self._offset[placed] = self._last[0][placed]
        strain = step.strain if self._offset is None else step.strain + self._offset
        found = (strain, step.stress, step.state)
        if there is not None:
            strain, stress, state = (np.where(there[:, None], new, old) for new, old in zip(found, self._last))
            found = (strain, stress, state)
        self._last = found
        return found
