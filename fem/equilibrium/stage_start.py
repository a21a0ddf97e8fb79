"""What a stage finds at its beginning: displacements, forces that fade over it, forces that stay."""

from __future__ import annotations

import numpy as np

from granfabric.fem.loads.load_program import StageTerms
from granfabric.fem.loads.problem import Problem
from granfabric.fem.vectors import Array

from .excavation import excavation_forces
from .results import StageStart


def force_at_start(problem: Problem, index: int) -> Array:
    """Nodal forces of tractions, pressures and body forces at the start of a stage, shape (ndofs,) [N/m]."""
    terms = problem.program.terms[index]
    return terms.force_end if index == 0 and problem.starts_loaded else terms.force_start


def stage_start(
    problem: Problem,
    index: int,
    displacement: Array,
    internal_force: Array,
    reference: Array,
    held: Array | None = None,
) -> StageStart:
    """Displacements and fading forces at the start of a stage; the reference forces at the start of the run.

    Parameters
    ----------
    problem : Problem
    index : int
        Number of the stage.
    displacement, internal_force : ndarray, shape (ndofs,)
        There [m], [N/m].
    reference : ndarray, shape (ndofs,)
        Reference forces so far, zero before the first stage [N/m].
    held : ndarray, shape (ndofs,), optional
        What an earlier stage has left of the forces of excavated parts [N/m].
    """
    terms = problem.program.terms[index]
    fading = np.zeros_like(displacement)
    if index == 0:
        imbalance = internal_force - force_at_start(problem, index)
        imbalance[terms.constrained] = 0.0
        if problem.balance_initial_stress:
            reference = imbalance
        else:
            fading = imbalance
    else:
        released = terms.released
        fading[released] = (internal_force - terms.force_start - reference)[released]
        if terms.body is not None:
            left = internal_force - terms.force_start
            fading, held = excavation_forces(problem, index, left, fading, held)
    return StageStart(displacement.copy(), fading, reference, held)


def external_force(problem: Problem, index: int, start: StageStart, fraction: float) -> Array:
    """External nodal forces at a position within a stage, shape (ndofs,) [N/m]."""
    before = force_at_start(problem, index)
    external = start.reference + before + fraction * (problem.program.terms[index].force_end - before)
    external += (1.0 - fraction) * start.fading
    if start.held is not None:
        external += start.held
    return external


def target_displacement(terms: StageTerms, start: StageStart) -> Array:
    """Displacements of the constrained degrees of freedom at the end of a stage [m]."""
    return np.where(np.isnan(terms.target), start.displacement[terms.constrained], terms.target)
