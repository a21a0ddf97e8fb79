"""Forces that excavated parts had exerted on what is left: held when the part goes, released in shares.

Before the excavation the stress of the part that goes is in balance with what is left. When it is gone, the nodes of
the new boundary lack the forces ``R = int B^T sigma dV - f`` (stress and loads of what is left). They are put there and
fade linearly, in the stage of the excavation to ``(1 - release) R``, later to what the `release` of the stage leaves.
"""

from __future__ import annotations

import numpy as np

from granfabric.fem.loads.problem import Problem
from granfabric.fem.vectors import Array


def excavation_forces(
    problem: Problem, index: int, left: Array, fading: Array, held: Array | None
) -> tuple[Array, Array | None]:
    """Forces that fade over a stage, and those that are still held at its end.

    Parameters
    ----------
    problem : Problem
        One whose stages change the body.
    index : int
        Number of the stage.
    left : ndarray, shape (ndofs,)
        Internal forces of what is there at the start of the stage minus the loads on it [N/m].
    fading : ndarray, shape (ndofs,)
        Reactions of supports that the stage releases [N/m].
    held : ndarray, shape (ndofs,), optional
        What the stage before has left of the forces of earlier excavations [N/m].

    Returns
    -------
    fading : ndarray, shape (ndofs,)
    held : ndarray, shape (ndofs,), or None
    """
    space, terms = problem.space, problem.program.terms[index]
    body = terms.body
    assert body is not None
    if not body.changes and held is None:
        return fading, None
    free = body.dofs.copy()
    free[terms.constrained] = False
    free[terms.released] = False
    if terms.ties is not None:
        free[terms.ties.dofs] = False  # nothing changes beside a rigid body
    before = np.zeros(space.ndofs) if held is None else np.where(free, held, 0.0)
    excavated = np.zeros(space.ndofs)
    placing = problem.force_of_fill(index)
    if body.changes:
        missing = np.where(free & body.beside, left - before, 0.0)
        placing = np.where(free, placing, 0.0)
        excavated = missing - placing
    kept = 1.0 - body.released
    whole = excavated + (before / (1.0 - body.released_before) if held is not None else 0.0)
    after = kept * whole
    fading = fading + (before + excavated - after) + placing
    return fading, after if kept > 0.0 else None
