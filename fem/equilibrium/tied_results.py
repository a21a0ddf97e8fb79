"""What supports, rigid bodies and springs exert, from the nodal forces of a step."""

from __future__ import annotations

import numpy as np

from granfabric.fem.loads.load_program import LoadProgram, StageTerms
from granfabric.fem.vectors import Array

from .results import StageStart


def support_forces(terms: StageTerms, internal: Array, external: Array) -> Array:
    """Forces of supports and of rigid bodies, beyond the loads of these, at the nodes, shape (ndofs,) [N/m].

    Where a body is pushed by a force, that is among the external ones: what is left sums up to nothing.
    """
    support = np.zeros_like(internal)
    support[terms.constrained] = (internal - external)[terms.constrained]
    if terms.ties is not None:
        tied = terms.ties.dofs
        support[tied] = (internal - external)[tied]
    return support


def rigid_bodies(
    program: LoadProgram,
    index: int,
    displacement: Array,
    support: Array,
    fraction: float,
    load_factor: float,
    start: StageStart,
) -> dict[str, tuple[float, ...]]:
    """Motion, force and moment of each body, see `StepResult`; of a boundary that is not tied now what fits best."""
    found: dict[str, tuple[float, ...]] = {}
    for name in program.contacts:
        contact = program.contact(name, index)
        terms = program.terms[index]
        own = program.forces(index, tuple(start.load_factors)).of_body(
            name, fraction, terms.stage.increments, load_factor
        )
        tied = None
        if terms.ties is not None:
            tied = next((tie.contact for tie in terms.ties.ties if tie.contact.body.boundary == name), None)
        if tied is not None:
            # what held the boundary before the body came fades out over the stage, and is felt meanwhile
            contact, own = tied, own + (1.0 - fraction) * start.fading
        along, across, turn = contact.at_point(displacement).tolist()
        force_x, force_y, moment = contact.resultant(support + own).tolist()
        found[name] = (along, across, turn / contact.arm, force_x, force_y, moment * contact.arm)
    return found


def spring_forces(
    program: LoadProgram, index: int, displacement: Array, start: StageStart
) -> dict[str, tuple[float, float]]:
    """Force of the springs on the body, summed over each boundary that has some in some stage [N/m]."""
    sums = dict.fromkeys(program.spring_boundaries, (0.0, 0.0))
    for row, (spring, matrix) in enumerate(program.terms[index].springs):
        x, y = (start.spring_offsets[row] - matrix @ displacement).reshape(-1, 2).sum(axis=0)
        sums[spring.boundary] = (float(x), float(y))
    return sums
