"""Giving each rank its part of the problem that rank 0 has."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.loads.amplitude import Amplitude
from granfabric.fem.loads.bodies import Body
from granfabric.fem.loads.kinds import Stage
from granfabric.fem.loads.load_program import Led, StageTerms
from granfabric.fem.loads.problem import Problem
from granfabric.fem.loads.stage_forces import StageForces

from .distribution import Distribution
from .local_problem import LocalBody, LocalProblem, LocalProgram, LocalTerms
from .springs import spread_springs
from .ties import spread_ties

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def divide(distribution: Distribution, problem: Problem | None) -> LocalProblem:
    """Give each rank its part of the problem that rank 0 has."""
    head: Any = None
    if problem is not None:
        names = [
            Stage(
                stage.name, [], stage.increments, stage.keep, stage.drained, activate=stage.activate,
                fill_pressure=stage.fill_pressure, reset_displacements=stage.reset_displacements,
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
            problem.program.controlled,
        )
    law, stages, balance, loaded, indexed, width, controlled = distribution.comm.bcast(head, root=0)
    points = distribution.points
    springs = spread_springs(distribution, None if problem is None else problem.program.terms, len(stages))
    terms: list[StageTerms] = []
    fills = {}
    for number, stage in enumerate(stages):
        made = _terms(distribution, stage, None if problem is None else problem.program.terms[number], springs[number])
        if stage.activate:
            fills[number] = of_nodes(distribution, None if problem is None else problem.force_of_fill(number))
        terms.append(made)

    def ask(index: int, factors: tuple[float, ...]) -> StageForces:
        return _forces(distribution, None if problem is None else problem.program.forces(index, factors))

    index = None
    if indexed:
        given = None if problem is None or problem.material_index is None else problem.material_index.astype(float)
        index = points.scatter(given).astype(np.int32)
    return LocalProblem(
        distribution,
        law,
        stages,
        LocalProgram(terms, controlled, ask),
        points.scatter(None if problem is None else problem.initial_stress, (3,)),
        points.scatter(None if problem is None else problem.initial_state, (width,)),
        index,
        balance,
        loaded,
        fills,
    )


def of_nodes(distribution: Distribution, vector: Array | None) -> Array:
    """This rank's part, shape (ndofs,), of a vector of degrees of freedom that rank 0 has."""
    return distribution.nodes.scatter(None if vector is None else vector.reshape(-1, 2), (2,)).ravel()


def _mask(distribution: Distribution, whole: Mask | None) -> Mask:
    return np.asarray(of_nodes(distribution, None if whole is None else whole.astype(np.float64)) > 0.5)


def _terms(distribution: Distribution, stage: Stage, whole: StageTerms | None, springs: Any) -> StageTerms:
    comm = distribution.comm
    held = target = released = None
    if whole is not None:
        held, target, released = (np.zeros_like(whole.force_end) for _ in range(3))
        held[whole.constrained] = 1.0
        target[whole.constrained] = whole.target
        released[whole.released] = 1.0
    constrained = np.flatnonzero(of_nodes(distribution, held) > 0.5)
    ways: list[Amplitude] = comm.bcast(None if whole is None else [amplitude for amplitude, _ in whole.moving], root=0)
    moving = []
    for number, amplitude in enumerate(ways):
        told = None
        if whole is not None:
            told = np.zeros_like(whole.force_end)
            told[whole.constrained[whole.moving[number][1]]] = 1.0
        moving.append((amplitude, np.flatnonzero(of_nodes(distribution, told)[constrained] > 0.5)))
    corners = comm.bcast(None if whole is None else whole.corners, root=0)
    ties: Any = spread_ties(distribution, None if whole is None else whole.ties, constrained)
    return LocalTerms(
        stage,
        constrained,
        of_nodes(distribution, target)[constrained],
        np.flatnonzero(of_nodes(distribution, released) > 0.5),
        of_nodes(distribution, None if whole is None else whole.force_start),
        of_nodes(distribution, None if whole is None else whole.force_end),
        tuple(moving),
        corners,
        ties,
        springs,
        _led(distribution, whole),
        _body(distribution, whole),
        comm,
    )


def _led(distribution: Distribution, whole: StageTerms | None) -> Led | None:
    led: Led | None = distribution.comm.bcast(None if whole is None else whole.led, root=0)
    if led is None or led.dof < 0:
        return led
    node, component = divmod(led.dof, 2)
    here = np.flatnonzero(distribution.node_numbers == node)
    return Led(led.target, 2 * int(here[0]) + component if len(here) else -1)


def _body(distribution: Distribution, whole: StageTerms | None) -> Body | None:
    body = None if whole is None else whole.body
    head = distribution.comm.bcast(
        None if body is None else (body.released_before, body.released, body.changes), root=0
    )
    if head is None:
        return None

    def cells(given: NDArray[Any] | None) -> Mask:
        """Mask of this rank's cells from a mask or from numbers."""
        told = None
        if given is not None and body is not None:
            told = np.zeros(len(body.active))
            told[given] = 1.0
        return np.asarray(distribution.elements.scatter(told) > 0.5)

    active, removed, placed = (
        cells(part) for part in ((None,) * 3 if body is None else (body.active, body.removed, body.placed))
    )
    before, released, changes = head
    return LocalBody(
        active,
        _mask(distribution, None if body is None else body.dofs),
        _mask(distribution, None if body is None else body.beside),
        np.flatnonzero(removed),
        np.flatnonzero(placed),
        before,
        released,
        changes,
    )


def _forces(distribution: Distribution, whole: StageForces | None) -> StageForces:
    comm = distribution.comm
    start, end, ramp_end = (
        of_nodes(distribution, part)
        for part in ((None, None, None) if whole is None else (whole.start, whole.end, whole.ramp_end))
    )
    head = None if whole is None else ([amplitude for amplitude, _ in whole.varying], whole.following is not None)
    ways, follows = comm.bcast(head, root=0)
    varying = tuple(
        (amplitude, of_nodes(distribution, None if whole is None else whole.varying[number][1]))
        for number, amplitude in enumerate(ways)
    )
    following = of_nodes(distribution, None if whole is None else whole.following) if follows else None
    return StageForces(start, end, ramp_end, varying, following)
