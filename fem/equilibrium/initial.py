"""The state before the first step, as a step like any other: number 0 at the beginning of the first stage."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.discretisation.active_part import ActivePart
from granfabric.fem.discretisation.assembly import ForceAssembler
from granfabric.fem.discretisation.space import Space
from granfabric.fem.loads.problem import Problem
from granfabric.fem.vectors import Array

from .results import StageStart, StepResult
from .tied_results import rigid_bodies, support_forces


def initial_result(problem: Problem) -> StepResult:
    """Fields and reactions of the initial state.

    The reactions balance the initial stress and the loads that act from the outset at the supports of the first stage.

    Parameters
    ----------
    problem : Problem

    Returns
    -------
    StepResult
        With ``step = 0`` and ``fraction = 0``.
    """
    space, terms = problem.space, problem.program.terms[0]
    internal = initial_internal_force(problem)
    external = terms.force_end if problem.starts_loaded else terms.force_start
    support = support_forces(terms, internal, external)
    nothing = np.zeros(space.ndofs)
    start = StageStart(nothing, nothing, nothing)
    fraction = 1.0 if problem.starts_loaded else 0.0
    stress, state = problem.initial_stress.copy(), problem.initial_state.copy()
    if terms.body is not None:
        absent = ~terms.body.active[space.point_cell]
        stress[absent], state[absent] = 0.0, 0.0
    return StepResult(
        stage=terms.stage.name,
        step=0,
        fraction=0.0,
        displacement=nothing,
        reactions=boundary_sums(named_nodes(space), support),
        stress=stress,
        strain=np.zeros((space.npoints, 3)),
        state=state,
        status=np.zeros(space.npoints, dtype=np.int8),
        iterations=0,
        factorisations=0,
        cuts=0,
        residuals=(),
        substeps=0,
        limited=0,
        next_increment=1.0 / terms.stage.increments,
        stage_start=start,
        load_factor=0.0,
        rigid=rigid_bodies(problem.program, 0, nothing, support, fraction, 0.0, start),
        springs=dict.fromkeys(problem.program.spring_boundaries, (0.0, 0.0)),
        active=None if terms.body is None else terms.body.active,
        support=support,
    )


def initial_internal_force(problem: Problem) -> Array:
    """Internal forces of the initial stress of what is there at the outset, shape (ndofs,) [N/m]."""
    space, body = problem.space, problem.program.terms[0].body
    force = np.empty(space.ndofs)
    if body is None:
        return ForceAssembler(space).internal_force(problem.initial_stress, force)
    part = ActivePart(space, body.active)
    return ForceAssembler(part).internal_force(problem.initial_stress[part.points], force)


def named_nodes(space: Space) -> dict[str, NDArray[np.int64]]:
    """Nodes on each named boundary."""
    return {name: space.boundary_nodes(name) for name in space.host_mesh.boundaries}


def boundary_sums(nodes: dict[str, NDArray[np.int64]], forces: Array) -> dict[str, tuple[float, float]]:
    """Nodal forces, shape (ndofs,), summed over each named boundary: x and y [N/m]."""
    by_node = forces.reshape(-1, 2)
    sums = {}
    for name, members in nodes.items():
        x, y = by_node[members].sum(axis=0)
        sums[name] = (float(x), float(y))
    return sums
