"""What a stage finds at its beginning: displacements, forces that fade over it, forces that stay, springs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from granfabric.fem.loads.load_program import StageTerms
from granfabric.fem.loads.problem import Problem
from granfabric.fem.vectors import Array

from .excavation import excavation_forces
from .results import StageStart

NONE = np.empty(0)


def force_at_start(problem: Problem, index: int, factors: Array = NONE) -> Array:
    """Nodal forces of all loads at the start of a stage, shape (ndofs,) [N/m].

    `factors` are what the controls of the stages before have come to (`StageStart.load_factors`).
    """
    forces = problem.program.forces(index, tuple(factors))
    return forces.end if index == 0 and problem.starts_loaded else forces.start


def stage_start(
    problem: Problem,
    index: int,
    displacement: Array,
    internal_force: Array,
    reference: Array,
    before: StageStart | None = None,
    factors: Array = NONE,
) -> StageStart:
    """Displacements and fading forces at the start of a stage; the reference forces at the start of the run.

    Parameters
    ----------
    problem : Problem
    index : int
        Number of the stage.
    displacement, internal_force : ndarray, shape (ndofs,)
        There [m], [N/m]; with the forces of the springs of the stage before.
    reference : ndarray, shape (ndofs,)
        Reference forces so far, zero before the first stage [N/m].
    before : StageStart, optional
        Of the stage before, if there is one.
    factors : ndarray, shape (index,)
        What the controls of the stages before have come to; empty if no stage has one.
    """
    terms = problem.program.terms[index]
    fading = np.zeros_like(displacement)
    offsets, dropped = _springs(problem, index, displacement, before)
    held: Array | None = None
    if index == 0:
        imbalance = internal_force - force_at_start(problem, index)
    else:
        imbalance = internal_force - force_at_start(problem, index, factors) - reference
    if dropped is not None:
        # springs that are gone no longer are in the internal forces
        imbalance = imbalance - dropped
    tied = None
    if terms.ties is not None:
        # what the nodes of a body exert on each other stays; what it feels as a whole fades
        tied = terms.ties.faded(imbalance)
        for tie in terms.ties.ties:
            tie.contact.take_out(imbalance)
    if index == 0:
        imbalance[terms.constrained] = 0.0
        if tied is not None:
            imbalance += tied
        if problem.balance_initial_stress:
            reference = imbalance
        else:
            fading = imbalance
    else:
        released = terms.released
        fading[released] = imbalance[released]
        taken = np.union1d(terms.constrained, released)
        if tied is not None:
            assert terms.ties is not None
            along = np.setdiff1d(terms.ties.dofs, taken)
            fading[along] = imbalance[along]
            fading += tied
            taken = np.union1d(taken, along)
        if dropped is not None:
            free = np.setdiff1d(np.arange(len(fading)), taken)
            fading[free] -= dropped[free]
        if terms.body is not None:
            left = internal_force - force_at_start(problem, index, factors)
            held = None if before is None else before.held
            fading, held = excavation_forces(problem, index, left, fading, held)
    return StageStart(displacement.copy(), fading, reference, offsets, np.array(factors, dtype=np.float64), held)


def counted_anew(problem: Problem, index: int, before: StageStart | None, displacement: Array) -> StageStart | None:
    """What the stage before remembers of its springs when displacements count from the beginning of this one.

    Their forces stay: with the displacements there, shape (ndofs,), the offsets lose what these exert.
    """
    if before is None or not problem.stages[index].reset_displacements or not len(before.spring_offsets):
        return before
    springs = problem.program.terms[index - 1].springs
    offsets = [row - matrix @ displacement for row, (_, matrix) in zip(before.spring_offsets, springs)]
    return replace(before, spring_offsets=np.array(offsets))


def _springs(
    problem: Problem, index: int, displacement: Array, before: StageStart | None
) -> tuple[Array, Array | None]:
    """Offsets of the stage's springs, and the force of those of the stage before that are gone."""
    terms = problem.program.terms[index]
    last = problem.program.terms[index - 1].springs if index else ()
    if not terms.springs and not last:
        return np.empty((0, 0)), None
    old = {} if before is None else {spring: (row, matrix) for row, (spring, matrix) in enumerate(last)}
    offsets = np.empty((len(terms.springs), len(displacement)))
    for row, (spring, matrix) in enumerate(terms.springs):
        if spring in old:
            assert before is not None
            offsets[row] = before.spring_offsets[old.pop(spring)[0]]
        else:
            offsets[row] = matrix @ displacement
    if not old:
        return offsets, None
    assert before is not None
    gone = np.zeros_like(displacement)
    for place, matrix in old.values():
        gone += matrix @ displacement - before.spring_offsets[place]
    return offsets, gone


def external_force(problem: Problem, index: int, start: StageStart, fraction: float, load_factor: float = 0.0) -> Array:
    """External nodal forces at a position within a stage, shape (ndofs,) [N/m].

    The load factor is of the loads that follow a control.
    """
    terms = problem.program.terms[index]
    forces = problem.program.forces(index, tuple(start.load_factors))
    if index == 0 and problem.starts_loaded:
        external = start.reference + forces.end
    else:
        external = forces.at(fraction, terms.stage.increments, load_factor, start.reference)
    external += (1.0 - fraction) * start.fading
    if start.held is not None:
        external += start.held
    return external


def target_displacement(terms: StageTerms, start: StageStart) -> Array:
    """Displacements of the constrained degrees of freedom at the end of a stage [m]."""
    return np.where(np.isnan(terms.target), start.displacement[terms.constrained], terms.target)


def carried_by_ties(terms: StageTerms, start: StageStart, fraction: float) -> Array | None:
    """What rigid bodies with a prescribed motion have moved in the stage, shape (ndofs,) [m]; None without bodies."""
    if terms.ties is None:
        return None
    here = start.displacement[terms.constrained]
    moved = terms.moved(fraction, here, target_displacement(terms, start)) - here
    increments = terms.stage.increments
    return terms.ties.carried(start.displacement, moved, lambda amplitude: amplitude.factor(fraction, increments))
