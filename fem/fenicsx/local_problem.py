"""The part of a problem that a rank owns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.contract import Law
from granfabric.fem.loads.kinds import Stage
from granfabric.fem.loads.load_program import StageTerms
from granfabric.fem.loads.problem import Problem

from .distribution import Distribution

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Program:
    terms: list[StageTerms]


@dataclass(frozen=True)
class LocalProblem:
    """What `Problem` is for the own host, for what this rank owns.

    Parameters
    ----------
    space : Distribution
    law : Law
    stages : list of Stage
        Names and increments; their loads are in `program`.
    program : object
        With `terms`, a `StageTerms` for each stage.
    initial_stress, initial_state : ndarray
    material_index : ndarray of int32, optional
    balance_initial_stress, starts_loaded : bool
    """

    space: Distribution
    law: Law
    stages: list[Stage]
    program: _Program
    initial_stress: Array
    initial_state: Array
    material_index: NDArray[np.int32] | None
    balance_initial_stress: bool
    starts_loaded: bool

    def law_of(self, index: int) -> Law:
        """The law in a stage, as `Problem.law_of` has it."""
        drained = self.stages[index].drained and hasattr(self.law, "drained")
        return self.law.drained() if drained else self.law  # type: ignore[attr-defined,no-any-return]


def divide(distribution: Distribution, problem: Problem | None) -> LocalProblem:
    """Give each rank its part of the problem that rank 0 has."""
    comm = distribution.comm
    head: Any = None
    if problem is not None:
        names = [
            Stage(
                stage.name, [], stage.increments, stage.keep, stage.drained,
                reset_displacements=stage.reset_displacements,
            )
            for stage in problem.stages
        ]  # fmt: skip
        head = (
            problem.law,
            names,
            problem.balance_initial_stress,
            problem.starts_loaded,
            problem.material_index is not None,
            problem.initial_state.shape[1],
        )
    law, stages, balance, loaded, indexed, width = comm.bcast(head, root=0)
    points = distribution.points
    terms = []
    for number, stage in enumerate(stages):
        whole = None if problem is None else problem.program.terms[number]
        terms.append(_terms(distribution, stage, whole))
    index = None
    if indexed:
        given = None if problem is None or problem.material_index is None else problem.material_index.astype(float)
        index = points.scatter(given).astype(np.int32)
    return LocalProblem(
        distribution,
        law,
        stages,
        _Program(terms),
        points.scatter(None if problem is None else problem.initial_stress, (3,)),
        points.scatter(None if problem is None else problem.initial_state, (width,)),
        index,
        balance,
        loaded,
    )


def _terms(distribution: Distribution, stage: Stage, whole: StageTerms | None) -> StageTerms:
    def of_nodes(vector: Array | None) -> Array:
        return distribution.nodes.scatter(None if vector is None else vector.reshape(-1, 2), (2,)).ravel()

    held = target = released = None
    if whole is not None:
        held, target, released = (np.zeros_like(whole.force_end) for _ in range(3))
        held[whole.constrained] = 1.0
        target[whole.constrained] = whole.target
        released[whole.released] = 1.0
    mask = of_nodes(held) > 0.5
    constrained = np.flatnonzero(mask)
    part = StageTerms(
        stage,
        constrained,
        of_nodes(target)[constrained],
        np.flatnonzero(of_nodes(released) > 0.5),
        of_nodes(None if whole is None else whole.force_start),
        of_nodes(None if whole is None else whole.force_end),
    )
    return part
