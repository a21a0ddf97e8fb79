"""Solution of a linear problem: one linear solve a stage, because within a stage everything moves in proportion.

Where the stiffness at every point is that of the initial state and stays so, displacements, strains and stresses of a
stage go along straight lines from its start to its end. One factorisation serves all stages that hold the same degrees
of freedom.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from granfabric.fem.linear_solvers.direct import FactorisationError
from granfabric.fem.loads.fills import placed
from granfabric.fem.loads.problem import Problem
from granfabric.fem.vectors import Array

from .changing_body import begin_body
from .residual import Equilibrium
from .results import StageStart
from .stage_start import external_force, stage_start, target_displacement

# Relative residual of the linear solves; a direct factor reaches it in one application.
RESIDUAL = 1e-12


class LinearSolutionError(ArithmeticError):
    """The linear problem of a stage has no solution; the text says why."""


@dataclass(frozen=True)
class StageSolution:
    """Straight way of one stage.

    Parameters
    ----------
    start : StageStart
    displacement : ndarray, shape (ndofs,)
        Change over the whole stage [m].
    strain : ndarray, shape (npt, 3)
        Change over the whole stage: xx, yy, engineering xy; tension positive.
    solves : int
        Linear solves that it took.
    """

    start: StageStart
    displacement: Array
    strain: Array
    solves: int


class LinearSolution:
    """Stages one after the other, each solved once with the stiffness of the initial state.

    Parameters
    ----------
    problem : Problem
    system : Equilibrium
        In its initial state; its factor is used, its material is asked for the stiffness only.

    Raises
    ------
    LinearSolutionError
        If a point of the initial state has no stiffness.
    """

    def __init__(self, problem: Problem, system: Equilibrium) -> None:
        self._problem = problem
        self._system = system
        self._displacement = np.zeros(problem.space.ndofs)
        self._internal = system.internal_force.copy()
        self._reference = np.zeros(problem.space.ndofs)
        self._held: Array | None = None
        self._done = 0
        # of all points, where the body changes; the material itself may be at another stage
        self._stress = np.empty((0, 3)) if system.part is None else system.of_space(system.material.stress_start)
        self._ask_stiffness()

    def _ask_stiffness(self) -> None:
        report = self._system.material.still_tangent("elastic")
        if report.failed:
            raise LinearSolutionError(f"the initial state has no stiffness: {self._system.worst(report)[1]}")

    def _use_law(self, index: int) -> None:
        """Draining changes the stiffness: once a stage, and only where the one before was different."""
        law = self._problem.law_of(index)
        if law is not self._system.material.law:
            self._system.material.law = law
            self._ask_stiffness()

    def next_stage(self) -> StageSolution:
        """Solve the next stage.

        Raises
        ------
        LinearSolutionError
        """
        problem, system, index = self._problem, self._system, self._done
        terms = problem.program.terms[index]
        with system.accounting.phase("setup"):
            if begin_body(system, problem, index):
                self._change_body(index)
            if terms.stage.reset_displacements:
                self._displacement = np.zeros(problem.space.ndofs)
            system.constrain(terms.constrained)
            self._use_law(index)
            start = stage_start(problem, index, self._displacement, self._internal, self._reference, self._held)
        self._reference, self._held = start.reference, start.held
        tangent = system.material.tangent_start
        with system.accounting.phase("boundary"):
            change = np.zeros(problem.space.ndofs)
            change[terms.constrained] = target_displacement(terms, start) - start.displacement[terms.constrained]
            end = external_force(problem, index, start, 1.0)
            right_hand_side = (end - self._internal)[system.free]
            if system.any(change):
                right_hand_side -= system.forces.tangent_times(tangent, change, system.scratch)[system.free]
        solves = 0
        if system.worth_solving(right_hand_side, end):
            try:
                change[system.free] += system.linear_solve(right_hand_side, RESIDUAL, committed=True, guess=None)
            except FactorisationError as error:
                raise LinearSolutionError(f"the stiffness cannot be solved: {error}") from error
            solves = 1
        with system.accounting.phase("state"):
            strain = system.forces.strain(change, np.empty((len(tangent), 3)))
            if system.part is not None:
                self._stress[system.part.points] += np.einsum("pij,pj->pi", tangent, strain)
            self._internal = self._internal + system.forces.tangent_times(tangent, change, system.scratch)
            self._displacement = self._displacement + change
        self._done += 1
        return StageSolution(start, change, strain, solves)

    def _change_body(self, index: int) -> None:
        """Stress and stiffness of the body that a stage begins with; both are linear in what was before."""
        problem, system = self._problem, self._system
        body, earlier = problem.program.terms[index].body, problem.program.terms[index - 1].body
        assert body is not None and earlier is not None and system.part is not None
        points, stress, _ = placed(problem, index)
        self._stress[points] = stress
        system.material.law = problem.law_of(index)
        self._ask_stiffness()
        self._internal = system.forces.internal_force(self._stress[system.part.points], np.zeros(problem.space.ndofs))
        self._displacement = np.where(body.dofs & earlier.dofs, self._displacement, 0.0)
