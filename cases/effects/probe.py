"""One cheap elastic probe of a scene: how far stresses would go if nothing but the initial stiffness acted.

A boundary-value problem takes one factorisation and one linear solve a stage
(`granfabric.fem.equilibrium.linear_solution`), after which every integration point has its path of stress and strain, a
chain of straight pieces. A point scene has its own path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.accounting import Accounting
from granfabric.fem.equilibrium.control import StepControl
from granfabric.fem.equilibrium.linear_solution import LinearSolution, LinearSolutionError
from granfabric.fem.equilibrium.residual import Equilibrium
from granfabric.fem.loads.problem import Problem

Array = NDArray[np.float64]

PIECES = 6
"""Pieces of one stage, for what turns on the way although stress goes straight."""


MOST_NODES = 240
"""Nodes of all paths; with more stages than that, one a stage."""
MOST_VALUES = 4_000_000
"""Nodes times points that are kept; beyond, every second point goes, or more."""


class ProbeError(ArithmeticError):
    """The scene has no elastic answer; the text says why."""


@dataclass(frozen=True)
class Paths:
    """Paths of points as chains of straight pieces, the start included.

    Parameters
    ----------
    strain : ndarray, shape (nodes, npt, 3)
        Total strain: xx, yy, engineering xy; tension positive.
    stress : ndarray, shape (nodes, npt, 3)
        Tension positive [Pa].
    weights : ndarray, shape (npt,)
        Fraction of the area that each point stands for; they sum up to one.
    places : ndarray, shape (npt, 2)
        Coordinates [m].
    material_index : ndarray of int32, shape (npt,)
    coordination, fabric : ndarray, shapes (npt,), (npt, 2)
        Of the initial packing.
    """

    strain: Array
    stress: Array
    weights: Array
    places: Array
    material_index: NDArray[np.int32]
    coordination: Array
    fabric: Array

    def at(self, points: NDArray[np.int64]) -> Paths:
        """The paths of some points, which then stand for the whole area."""
        weights = self.weights[points]
        return Paths(
            np.ascontiguousarray(self.strain[:, points]),
            np.ascontiguousarray(self.stress[:, points]),
            weights / weights.sum(),
            self.places[points],
            np.ascontiguousarray(self.material_index[points]),
            self.coordination[points],
            self.fabric[points],
        )


def network_of_state(problem: Problem) -> tuple[Array, Array]:
    """Coordination number (npt,) and fabric anisotropy (npt, 2) of the initial state."""
    description, state = problem.law.description, problem.initial_state
    fabric = np.zeros((len(state), 2))
    columns = state[:, description.columns("fabric_anisotropy")]
    fabric[:, : columns.shape[1]] = columns
    return state[:, description.columns("coordination")][:, 0].copy(), fabric


def index_of(problem: Problem) -> NDArray[np.int32]:
    """Row of the parameter table of each point."""
    if problem.material_index is None:
        return np.zeros(problem.space.npoints, dtype=np.int32)
    return problem.material_index


MOST_CORNERS = 40
"""Turns of a stage's loads that its path goes through; later cycles repeat them."""


def _places(corners: tuple[float, ...], pieces: int) -> list[float]:
    """Fractions of a stage that the path goes through: equal pieces, or from turn to turn of the loads."""
    if len(corners) == 1:
        return [piece / pieces for piece in range(1, pieces + 1)]
    return [*corners[: MOST_CORNERS - 1], corners[-1]] if len(corners) > MOST_CORNERS else list(corners)


def field_paths(problem: Problem, control: StepControl) -> Paths:
    """Paths of all integration points of a boundary-value problem under the stiffness of its initial state.

    Raises
    ------
    ProbeError
        If a stage cannot be solved.
    """
    system = Equilibrium(problem, control, Accounting())
    most = max(1, min(PIECES, MOST_NODES // len(problem.stages)))
    stride = 1 + (len(problem.stages) * most + 1) * problem.space.npoints // MOST_VALUES
    try:
        solution = LinearSolution(problem, system)
        stiffness = system.material.tangent_start
        stresses = [problem.initial_stress[::stride]]
        strains = [np.zeros_like(stresses[0])]
        for stage in problem.stages:
            way = solution.next_stage()
            places = _places(way.corners, min(most, stage.increments))
            changes = [way.strain_at(place)[::stride] for place in places]
            responses = [np.einsum("pij,pj->pi", stiffness[::stride], change) for change in changes]
            before, stress = strains[-1], stresses[-1]
            if not max(np.abs(one).max() for one in responses) > 1e-9 * np.abs(problem.initial_stress).max():
                continue  # a stage that only holds what is there
            strains += [before + change for change in changes]
            stresses += [stress + response for response in responses]
    except LinearSolutionError as error:
        raise ProbeError(str(error)) from error
    weights = problem.space.weights[::stride]
    coordination, fabric = network_of_state(problem)
    return Paths(
        np.array(strains),
        np.array(stresses),
        weights / weights.sum(),
        problem.space.points[::stride],
        index_of(problem)[::stride],
        coordination[::stride],
        fabric[::stride],
    )
