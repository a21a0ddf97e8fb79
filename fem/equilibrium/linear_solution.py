"""Solution of a linear problem: one linear solve a stage for each way in which its loads go through it.

Where the stiffness at every point is that of the initial state and stays so, displacements, strains and stresses of a
stage follow from superposition: what goes linearly over the stage, and for each other amplitude its response times the
factor. One factorisation serves all stages that hold the same degrees of freedom.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_matrix

from granfabric.fem.linear_solvers.direct import FactorisationError
from granfabric.fem.loads.amplitude import RAMP, Amplitude
from granfabric.fem.loads.fills import placed
from granfabric.fem.loads.load_program import StageTerms
from granfabric.fem.loads.problem import Problem
from granfabric.fem.loads.springs import Spring
from granfabric.fem.vectors import Array

from .changing_body import begin_body
from .residual import Equilibrium
from .results import StageStart
from .stage_start import counted_anew, external_force, stage_start, target_displacement

# Relative residual of the linear solves; a direct factor reaches it in one application.
RESIDUAL = 1e-12
# A led displacement that the loads move less than this, relative to their size, is not moved by them.
UNMOVED = 1e-10


class LinearSolutionError(ArithmeticError):
    """The linear problem of a stage has no solution; the text says why."""


@dataclass(frozen=True)
class StageSolution:
    """Way of one stage.

    Parameters
    ----------
    start : StageStart
    displacement : ndarray, shape (ndofs,)
        Change over the whole stage of what goes linearly [m].
    strain : ndarray, shape (npt, 3)
        The same of the strain: xx, yy, engineering xy; tension positive.
    solves : int
        Linear solves that it took.
    increments : int
        Of the stage, nominal.
    corners : tuple of float
        Fractions at which the direction changes.
    varying : tuple of (Amplitude, ndarray, ndarray)
        Displacements and strains of loads with another amplitude, at a factor of 1.
    load_factor : float
        That the control has come to at the end of the stage.
    """

    start: StageStart
    displacement: Array
    strain: Array
    solves: int
    increments: int = 1
    corners: tuple[float, ...] = (1.0,)
    varying: tuple[tuple[Amplitude, Array, Array], ...] = field(default=())
    load_factor: float = 1.0

    def displacement_at(self, fraction: float) -> Array:
        """Change of the displacements at a position within the stage, shape (ndofs,) [m]."""
        change = fraction * self.displacement
        for amplitude, displacement, _ in self.varying:
            change += amplitude.factor(fraction, self.increments) * displacement
        return change

    def strain_at(self, fraction: float) -> Array:
        """Change of the strains there, shape (npt, 3)."""
        change = fraction * self.strain
        for amplitude, _, strain in self.varying:
            change += amplitude.factor(fraction, self.increments) * strain
        return change

    def strain_between(self, first: float, last: float) -> Array:
        """Change of the strains from one position to another."""
        change = (last - first) * self.strain
        for amplitude, _, strain in self.varying:
            factors = amplitude.factor(last, self.increments) - amplitude.factor(first, self.increments)
            change += factors * strain
        return change


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
        self._done = 0
        self._start: StageStart | None = None
        self._factors: list[float] = []
        self._solves = 0
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
            self._start = counted_anew(problem, index, self._start, self._displacement)
            if begin_body(system, problem, index):
                self._change_body(index)
            if terms.stage.reset_displacements:
                self._displacement = np.zeros(problem.space.ndofs)
            system.constrain(terms)
            self._use_law(index)
            factors = np.array(self._factors if problem.program.controlled else [])
            start = stage_start(
                problem, index, self._displacement, self._internal, self._reference, self._start, factors
            )
            self._internal = self._after_springs(index, start)
        self._reference, self._start = start.reference, start
        self._solves = 0
        factor, load_factor = 1.0, 1.0
        with system.accounting.phase("boundary"):
            end = external_force(problem, index, start, 1.0)
            forces = problem.program.forces(index, tuple(factors))
            # what other amplitudes add at the end is not of the part that goes linearly
            varying = () if index == 0 and problem.starts_loaded else forces.varying
            for amplitude, change in varying:
                end -= amplitude.factor(1.0, terms.stage.increments) * change
            moved = self._moved(terms, start, RAMP)
            scale = external_force(problem, index, start, 1.0, 1.0)
        if terms.led is None:
            change = self._solve(end - self._internal, moved, scale)
        else:
            change, load_factor = self._led(terms, end - self._internal, moved, forces.following, scale)
        parts = []
        pending = dict(varying)
        for amplitude in [*pending, *(a for a in _amplitudes(terms) if a not in pending)]:
            force = pending.get(amplitude, np.zeros_like(change))
            response = self._solve(force, self._moved(terms, start, amplitude), scale)
            parts.append((amplitude, response))
        with system.accounting.phase("state"):
            points = len(system.material.tangent_start)
            strain = system.forces.strain(change, np.empty((points, 3)))
            made = tuple((a, part, system.forces.strain(part, np.empty((points, 3)))) for a, part in parts)
            whole = change
            for amplitude, part in parts:
                factor = amplitude.factor(1.0, terms.stage.increments)
                whole = whole + factor * part
            tangent = system.material.tangent_start
            if system.part is not None:
                moved_strain = strain if not parts else system.forces.strain(whole, np.empty((points, 3)))
                self._stress[system.part.points] += np.einsum("pij,pj->pi", tangent, moved_strain)
            self._internal = self._internal + system.action(tangent, whole, system.scratch)
            self._displacement = self._displacement + whole
        self._factors.append(load_factor if terms.led is not None else 1.0)
        self._done += 1
        return StageSolution(
            start, change, strain, self._solves, terms.stage.increments, terms.corners, made, load_factor
        )

    def _after_springs(self, index: int, start: StageStart) -> Array:
        """Internal forces with the springs of this stage instead of those of the last one."""
        terms = self._problem.program.terms
        internal = self._internal
        if index and terms[index - 1].springs:
            internal = internal - self._spring_force(terms[index - 1].springs)
        for row, (_, matrix) in enumerate(terms[index].springs):
            internal = internal + (matrix @ self._displacement - start.spring_offsets[row])
        return internal

    def _moved(self, terms: StageTerms, start: StageStart, amplitude: Amplitude) -> Array:
        """Displacements over the stage that are prescribed with one amplitude, shape (ndofs,) [m]."""
        moved = np.zeros(self._problem.space.ndofs)
        change = target_displacement(terms, start) - start.displacement[terms.constrained]
        chosen = np.full(len(change), amplitude == RAMP)
        for other, places in terms.moving:
            chosen[places] = other == amplitude
        change = np.where(chosen, change, 0.0)
        moved[terms.constrained] = change
        if terms.ties is not None:
            moved += terms.ties.carried(start.displacement, change, lambda other: float(other == amplitude))
        return moved

    def _solve(self, force: Array, moved: Array, scale: Array) -> Array:
        """Displacements of a change of the external forces and of what is prescribed."""
        system = self._system
        change = moved
        with system.accounting.phase("boundary"):
            right_hand_side = system.unknowns.reduce(force)
            if system.any(change):
                action = system.action(system.material.tangent_start, change, system.scratch)
                right_hand_side = right_hand_side - system.unknowns.reduce(action)
        if system.worth_solving(right_hand_side, scale):
            try:
                system.unknowns.add(change, system.linear_solve(right_hand_side, RESIDUAL, committed=True, guess=None))
            except FactorisationError as error:
                raise LinearSolutionError(f"the stiffness cannot be solved: {error}") from error
            self._solves += 1
        return change

    def _change_body(self, index: int) -> None:
        """Stress and stiffness of the body that a stage begins with; both are linear in what was before."""
        problem, system = self._problem, self._system
        last, terms = problem.program.terms[index - 1 : index + 1]
        body, earlier = terms.body, last.body
        assert body is not None and earlier is not None and system.part is not None
        points, stress, _ = placed(problem, index)
        self._stress[points] = stress
        system.material.law = problem.law_of(index)
        self._ask_stiffness()
        internal = system.forces.internal_force(self._stress[system.part.points], np.zeros(problem.space.ndofs))
        self._displacement = np.where(body.dofs & earlier.dofs, self._displacement, 0.0)
        self._internal = internal + self._spring_force(last.springs)

    def _spring_force(self, springs: tuple[tuple[Spring, csr_matrix], ...]) -> Array:
        """Of those of the stage before, as internal forces."""
        force = np.zeros_like(self._displacement)
        for row, (_, matrix) in enumerate(springs):
            assert self._start is not None
            force += matrix @ self._displacement - self._start.spring_offsets[row]
        return force

    def _led(
        self, terms: StageTerms, force: Array, moved: Array, following: Array | None, scale: Array
    ) -> tuple[Array, float]:
        """Displacements and load factor when the control leads one displacement to its target."""
        assert terms.led is not None and following is not None
        tangent, system = self._system.material.tangent_start, self._system
        direction, here = terms.lead(self._displacement)
        change = self._solve(force, moved + (terms.led.target - here) * direction, scale)
        missing = system.dot(direction, force - system.action(tangent, change, system.scratch))
        response = self._solve(following, np.zeros_like(change), scale)
        gained = system.dot(direction, following - system.action(tangent, response, system.scratch))
        if not abs(gained) > UNMOVED * system.norm(following) * system.norm(direction):
            raise LinearSolutionError("the loads do not move what the control leads")
        factor = -missing / gained
        return change + factor * response, factor


def _amplitudes(terms: StageTerms) -> list[Amplitude]:
    """Amplitudes, other than linear, of what supports and rigid bodies prescribe."""
    found = [amplitude for amplitude, _ in terms.moving]
    if terms.ties is not None:
        found += [tie.amplitude for tie in terms.ties.ties]
    return list(dict.fromkeys(amplitude for amplitude in found if amplitude != RAMP))
