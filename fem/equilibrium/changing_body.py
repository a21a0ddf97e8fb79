"""From the body of one stage to that of the next: what stays keeps its state, what comes is placed."""

from __future__ import annotations

import numpy as np

from granfabric.fem.loads.fills import placed
from granfabric.fem.loads.problem import Problem

from .residual import Equilibrium


def begin_body(system: Equilibrium, problem: Problem, index: int) -> bool:
    """Take up the body of a stage at its beginning, and reset displacements if the stage says so.

    Nodes that come, and those that go, have the displacement zero: what is placed moves from where it is placed.

    Returns
    -------
    bool
        Whether the body is another than before.
    """
    terms = problem.program.terms[index]
    body = terms.body
    changed = body is not None and body.changes
    if body is not None and changed:
        material = system.material
        stress, state = system.of_space(material.stress_start), system.of_space(material.state_start)
        strain = system.of_space(material.strain_start)
        points, fresh_stress, fresh_state = placed(problem, index)
        stress[points], state[points], strain[points] = fresh_stress, fresh_state, 0.0
        earlier = problem.program.terms[index - 1].body
        assert earlier is not None
        system.enter(system.part_of(body.active), stress, state, strain)
        system.displacement[~(body.dofs & earlier.dofs)] = 0.0
        system.refresh_internal_force()
    if terms.stage.reset_displacements:
        system.displacement[:] = 0.0
        system.material.strain_start[:] = 0.0
    return changed


def restore_body(system: Equilibrium, problem: Problem, index: int) -> None:
    """Take up the body of a stage in the middle of it; its fields are to be filled in."""
    body = problem.program.terms[index].body
    if body is None or (system.part is not None and np.array_equal(system.part.cells, np.flatnonzero(body.active))):
        return
    system.enter(system.part_of(body.active), problem.initial_stress, problem.initial_state, None)
