"""How far the initial stress and the loads at the outset are from equilibrium, before anything is computed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from granfabric.fem.loads.problem import Problem
from granfabric.fem.vectors import Array

from .initial import initial_internal_force
from .stage_start import force_at_start

# A direction in which hardly any forces act is assessed by this fraction of the forces of both.
LEAST_FRACTION = 1e-3


@dataclass(frozen=True)
class InitialImbalance:
    """Imbalance of the initial state.

    Parameters
    ----------
    fraction : float
        Nodal forces that nothing balances over the nodal forces that act; see `initial_imbalance`.
    fraction_at_end : float
        The same for the initial stress with the loads of the end of the first stage: what that stage changes.
    place : (float, float)
        Where the largest unbalanced nodal force acts [m].
    acting : float
        Sum of the nodal forces that act, in both directions [N/m].
    total : float
        Sum of the magnitudes of the unbalanced nodal forces [N/m].
    resultant : (float, float)
        Their vector sum [N/m].
    """

    fraction: float
    fraction_at_end: float
    place: tuple[float, float]
    acting: float
    total: float
    resultant: tuple[float, float]


def initial_imbalance(problem: Problem) -> InitialImbalance:
    """Compare the internal forces of the initial stress with the loads at the outset.

    Unbalanced is what is left of internal minus external forces at degrees of freedom that the first stage leaves
    free; at supports reactions balance everything. In each direction the absolute values are summed over the nodes and
    divided by the sum of the internal forces at all nodes (supports included) or of the loads at free ones, whichever
    is larger; the fraction is the larger of both directions. Sums of nodal forces, unlike their Euclidean norms, do not
    change with the size of the elements, neither for forces on a boundary nor for those in the body. What cancels
    inside the body enters neither sum: the internal forces left there are those that stress gradients or jumps exert.
    Without any load the fraction is 1 where the boundary is free; with a pressure of the wrong sign it is 2.

    Parameters
    ----------
    problem : Problem

    Returns
    -------
    InitialImbalance
    """
    space, terms = problem.space, problem.program.terms[0]
    internal = initial_internal_force(problem)
    free = np.ones(space.ndofs, dtype=bool)
    free[terms.constrained] = False

    def left(external: Array) -> tuple[Array, float, float]:
        """Unbalanced nodal forces, shape (nnodes, 2), the sum of the acting ones, and their fraction of these."""
        rest = np.where(free, internal - external, 0.0).reshape(-1, 2)
        acting = np.maximum(_sums(internal), _sums(np.where(free, external, 0.0)))
        whole = float(acting.sum())
        acting = np.maximum(acting, LEAST_FRACTION * whole)
        sums = np.abs(rest).sum(axis=0)
        return rest, whole, float(np.divide(sums, acting, out=np.zeros(2), where=acting > 0.0).max())

    rest, acting, fraction = left(force_at_start(problem, 0))
    _, _, fraction_at_end = left(terms.force_end)
    size = np.hypot(rest[:, 0], rest[:, 1])
    x, y = space.nodes[int(size.argmax())]
    across, along = rest.sum(axis=0)
    return InitialImbalance(
        fraction, fraction_at_end, (float(x), float(y)), acting, float(size.sum()), (float(across), float(along))
    )


def _sums(forces: Array) -> Array:
    """Sums of absolute values over the nodes, in x and y."""
    return np.asarray(np.abs(forces.reshape(-1, 2)).sum(axis=0))
