"""The part of a problem that a rank owns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.contract import Law
from granfabric.fem.loads.amplitude import Amplitude
from granfabric.fem.loads.checks import LoadError
from granfabric.fem.loads.kinds import Stage
from granfabric.fem.loads.load_program import StageTerms
from granfabric.fem.loads.problem import Problem
from granfabric.fem.loads.rigid import Contact
from granfabric.fem.loads.stage_forces import StageForces

from .distribution import Distribution

Array = NDArray[np.float64]


@dataclass(frozen=True)
class _Program:
    """What `LoadProgram` is for the own host, without rigid bodies, springs and controls."""

    terms: list[StageTerms]
    of_stages: list[StageForces]
    contacts: dict[str, Contact] = field(default_factory=dict)
    spring_boundaries: list[str] = field(default_factory=list)
    controlled: bool = False

    def forces(self, index: int, factors: Sequence[float] = ()) -> StageForces:
        """Nodal forces of a stage that this rank owns."""
        return self.of_stages[index]


def refuse_unknown_loads(problem: Problem) -> None:
    """Refuse what this host does not assemble: what couples degrees of freedom beyond the elements, changing bodies.

    Raises
    ------
    LoadError
    """
    for terms in problem.program.terms:
        if terms.body is not None and terms.body.changes:
            raise LoadError(
                f"stage {terms.stage.name!r} activates or deactivates regions, which the host fenicsx does not know"
            )
        for kind, found in (("a rigid body", terms.ties), ("springs", terms.springs), ("a control", terms.led)):
            if found:
                raise LoadError(f"stage {terms.stage.name!r} has {kind}, which the host fenicsx does not know")


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
    terms, forces = [], []
    for number, stage in enumerate(stages):
        whole = None if problem is None else problem.program.terms[number]
        terms.append(_terms(distribution, stage, whole))
        forces.append(_forces(distribution, None if problem is None else problem.program.forces(number)))
    index = None
    if indexed:
        given = None if problem is None or problem.material_index is None else problem.material_index.astype(float)
        index = points.scatter(given).astype(np.int32)
    return LocalProblem(
        distribution,
        law,
        stages,
        _Program(terms, forces),
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
    ways: list[Amplitude] = distribution.comm.bcast(
        None if whole is None else [amplitude for amplitude, _ in whole.moving], root=0
    )
    moving = []
    for number, amplitude in enumerate(ways):
        told = None
        if whole is not None:
            told = np.zeros_like(whole.force_end)
            told[whole.constrained[whole.moving[number][1]]] = 1.0
        moving.append((amplitude, np.flatnonzero(of_nodes(told)[constrained] > 0.5)))
    corners = distribution.comm.bcast(None if whole is None else whole.corners, root=0)
    part = StageTerms(
        stage,
        constrained,
        of_nodes(target)[constrained],
        np.flatnonzero(of_nodes(released) > 0.5),
        of_nodes(None if whole is None else whole.force_start),
        of_nodes(None if whole is None else whole.force_end),
        tuple(moving),
        corners,
    )
    return part


def _forces(distribution: Distribution, whole: StageForces | None) -> StageForces:
    def of_nodes(vector: Array | None) -> Array:
        return distribution.nodes.scatter(None if vector is None else vector.reshape(-1, 2), (2,)).ravel()

    start, end, ramp_end = (
        of_nodes(None if whole is None else part)
        for part in ((None, None, None) if whole is None else (whole.start, whole.end, whole.ramp_end))
    )
    ways = distribution.comm.bcast(None if whole is None else [amplitude for amplitude, _ in whole.varying], root=0)
    varying = tuple(
        (amplitude, of_nodes(None if whole is None else whole.varying[number][1]))
        for number, amplitude in enumerate(ways)
    )
    return StageForces(start, end, ramp_end, varying)
