"""What a stage adds to the body: with which stress and state it is placed, and whether the law can begin with these."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.discretisation.active_part import ActivePart
from granfabric.fem.discretisation.assembly import ForceAssembler
from granfabric.fem.discretisation.space import Space

from .bodies import Body, bodies_of_stages
from .kinds import LoadError, Stage

if TYPE_CHECKING:
    from .problem import Problem

Array = NDArray[np.float64]
Points = NDArray[np.int64]


def fill_stress(stage: Stage) -> Array:
    """Stress under which a stage places what it activates, shape (3,) [Pa], tension positive."""
    return np.array([-stage.fill_pressure, -stage.fill_pressure, 0.0])


def points_of(space: Space, cells: NDArray[np.int64]) -> Points:
    """Integration points of elements, ascending."""
    points_per_cell = space.points_per_cell
    return (cells[:, None] * points_per_cell + np.arange(points_per_cell)).ravel()


def stress_with_fills(space: Space, stages: Sequence[Stage], given: Array) -> Array:
    """Initial stress, shape (npt, 3): as given where the body is from the outset, elsewhere that of the placement."""
    stress = given.copy()
    bodies = bodies_of_stages(space, stages)
    for stage, body in zip(reversed(stages), reversed(bodies)):  # the first placement counts
        if body is not None and bodies[0] is not None:
            fresh = body.placed[~bodies[0].active[body.placed]]
            stress[points_of(space, fresh)] = fill_stress(stage)
    return stress


def placed(problem: Problem, index: int) -> tuple[Points, Array, Array]:
    """Points that a stage adds, with their stress and state: the packing of their material under the fill pressure.

    Where the points were not there before, that is their initial state in the problem, a random one included.

    Returns
    -------
    points : ndarray of int, ascending
    stress, state : ndarray, shapes (n, 3), (n, nstate)
    """
    body = _body(problem, index)
    points = points_of(problem.space, body.placed)
    stress = np.tile(fill_stress(problem.stages[index]), (len(points), 1))
    again = np.zeros(problem.space.nelements, dtype=bool)
    for earlier in range(index):
        again |= _body(problem, earlier).active
    used = again[problem.space.point_cell[points]]
    state = problem.initial_state[points]
    if used.any():
        rows = None if problem.material_index is None else problem.material_index[points[used]]
        state[used] = problem.law.initial_state(stress[used], rows)
    return points, stress, state


def force_of_fill(problem: Problem, index: int) -> Array:
    """Forces that the pressure of what a stage adds exerts on its nodes, shape (ndofs,) [N/m]."""
    space = problem.space
    chosen = np.zeros(space.nelements, dtype=bool)
    chosen[_body(problem, index).placed] = True
    force = np.zeros(space.ndofs)
    if not chosen.any():
        return force
    part = ActivePart(space, chosen)
    stress = np.tile(fill_stress(problem.stages[index]), (part.npoints, 1))
    return ForceAssembler(part).internal_force(stress, force)


def refuse_unbearable(problem: Problem) -> None:
    """See that the law can begin from the state of each fill.

    Raises
    ------
    LoadError
        Naming the stage and what to give.
    """
    for index, stage in enumerate(problem.stages):
        if not len(_body(problem, index).placed):
            continue
        points, stress, state = placed(problem, index)
        rows = None if problem.material_index is None else problem.material_index[points]
        nothing = np.zeros_like(stress)
        report = problem.law.update(
            nothing, stress, state, np.empty_like(stress), np.empty_like(state), material_index=rows
        )
        if report.failed:
            x, y = problem.space.points[points[report.worst_point]]
            reason = report.message.partition(": ")[2]
            raise LoadError(
                f"stage {stage.name!r}: the material at ({x:.4g}, {y:.4g}) m cannot begin under fill_pressure = "
                f"{stage.fill_pressure:g} Pa: {reason}; give the pressure under which the fill is placed, of the order "
                "of its unit weight times the height of a layer"
            )


def _body(problem: Problem, index: int) -> Body:
    body = problem.program.terms[index].body
    assert body is not None
    return body
