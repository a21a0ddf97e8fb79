"""One cheap elastic probe of a scene: how far stresses would go if nothing but the initial stiffness acted.

A boundary-value problem takes one factorisation and one linear solve a stage
(`granfabric.fem.equilibrium.linear_solution`), after which every integration point has its path of stress and strain, a
chain of straight pieces. A point scene has its own path.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.effective_stress import effective_stress, with_pressure
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.pore_fluid import fluid_stiffness
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
        Effective, tension positive [Pa].
    weights : ndarray, shape (npt,)
        Fraction of the area that each point stands for; they sum up to one.
    places : ndarray, shape (npt, 2)
        Coordinates [m].
    material_index : ndarray of int32, shape (npt,)
    coordination, fabric : ndarray, shapes (npt,), (npt, 2)
        Of the initial packing.
    pore_pressure : ndarray, shape (npt,), optional
        Before any loading [Pa]; zero if not given.
    drained : ndarray of bool, shape (nodes,), optional
        Whether pore water can leave on the way to a node; nowhere if not given.
    """

    strain: Array
    stress: Array
    weights: Array
    places: Array
    material_index: NDArray[np.int32]
    coordination: Array
    fabric: Array
    pore_pressure: Array | None = None
    drained: NDArray[np.bool_] | None = None

    def start(self, law: ContactLaw) -> tuple[Array, Array]:
        """Stress (total, if the law has pore fluid) and state of a law before any loading."""
        network = (self.material_index, self.coordination, self.fabric)
        if not law.effects.pore_fluid:
            stress = self.stress[0].copy()
            return stress, law.initial_state(stress, *network)
        stress = with_pressure(self.stress[0], -self.datum(law))
        return stress, law.initial_state(stress, *network, pore_pressure=self.datum(law))

    def datum(self, law: ContactLaw) -> Array:
        """Pore pressure with which a law starts, shape (npt,); zeros if it has none."""
        if self.pore_pressure is None or not law.effects.pore_fluid:
            return np.zeros(self.stress.shape[1])
        return self.pore_pressure

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
            None if self.pore_pressure is None else self.pore_pressure[points],
            self.drained,
        )


def network_of_state(problem: Problem) -> tuple[Array, Array]:
    """Coordination number (npt,) and fabric anisotropy (npt, 2) of the initial state."""
    description, state = problem.law.description, problem.initial_state
    fabric = np.zeros((len(state), 2))
    columns = state[:, description.columns("fabric_anisotropy")]
    fabric[:, : columns.shape[1]] = columns
    return state[:, description.columns("coordination")][:, 0].copy(), fabric


def pore_pressure_of(problem: Problem) -> Array | None:
    """Pore pressure of the initial state, shape (npt,) [Pa]; None if the law has none."""
    description = problem.law.description
    if not description.has_state("pore_pressure"):
        return None
    return problem.initial_state[:, description.columns("pore_pressure")][:, 0].copy()


def _fluid_stiffness(problem: Problem) -> Array:
    """K_f/n of each point [Pa]; zeros if the law has no pore fluid."""
    law: Any = problem.law
    rows = [fluid_stiffness(row) if law.effects.pore_fluid else 0.0 for row in law.materials]
    return np.array(rows)[index_of(problem)]


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
        effective = effective_stress(problem.initial_stress, problem.initial_state, problem.law.description)
        stresses = [effective[::stride]]
        strains = [np.zeros_like(stresses[0])]
        fluid, drained = _fluid_stiffness(problem)[::stride], [False]
        for stage in problem.stages:
            way = solution.next_stage()
            places = _places(way.corners, min(most, stage.increments))
            # where stages change the body: points that are not there do not change
            changes = [system.of_space(way.strain_at(place))[::stride] for place in places]
            stiffness = system.of_space(system.material.tangent_start)[::stride]
            responses = [np.einsum("pij,pj->pi", stiffness, change) for change in changes]
            if not stage.drained:
                responses = [
                    with_pressure(response, -fluid * (change[:, 0] + change[:, 1]))
                    for response, change in zip(responses, changes)
                ]
            before, stress = strains[-1], stresses[-1]
            if not max(np.abs(one).max() for one in responses) > 1e-9 * np.abs(problem.initial_stress).max():
                continue  # a stage that only holds what is there
            drained += [stage.drained] * len(changes)
            strains += [before + change for change in changes]
            stresses += [stress + response for response in responses]
    except LinearSolutionError as error:
        raise ProbeError(str(error)) from error
    weights = problem.space.weights[::stride]
    coordination, fabric = network_of_state(problem)
    pressure = pore_pressure_of(problem)
    return Paths(
        np.array(strains),
        np.array(stresses),
        weights / weights.sum(),
        problem.space.points[::stride],
        index_of(problem)[::stride],
        coordination[::stride],
        fabric[::stride],
        None if pressure is None else pressure[::stride],
        np.array(drained) if any(drained) else None,
    )
