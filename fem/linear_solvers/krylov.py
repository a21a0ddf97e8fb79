"""Flexible GMRES: the Krylov method behind a kept factor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.vectors import dot, norm

Array = NDArray[np.float64]
Operator = Callable[[Array], Array]


@dataclass(frozen=True)
class KrylovResult:
    """Outcome of `fgmres`; `residual` is the norm of ``b - A x`` by recurrence."""

    solution: Array
    iterations: int
    residual: float
    converged: bool


def fgmres(
    operator: Operator,
    preconditioner: Operator,
    right_hand_side: Array,
    guess: Array | None,
    tolerance: float,
    maximum_iterations: int,
) -> KrylovResult:
    """Solve ``A x = b`` with a preconditioner applied from the right (Saad 1993, SIAM J. Sci. Comput. 14, 461).

    The preconditioned directions are kept, so that no further solve is needed at the end; the residual that is
    minimised and tested is the true one.

    Parameters
    ----------
    operator, preconditioner : callable
        ``x -> A x`` and ``r -> M^-1 r``; must return new arrays.
    right_hand_side : ndarray, shape (n,)
    guess : ndarray, shape (n,), optional
        Start; zero if not given or if it leaves a larger residual than zero does.
    tolerance : float
        Absolute bound of the residual norm.
    maximum_iterations : int
        No restarts: this bounds the memory as well.

    Returns
    -------
    KrylovResult
        `converged` is False at the iteration limit, at breakdown, or if anything is not finite.
    """
    solution = np.zeros_like(right_hand_side)
    residual = right_hand_side
    start = norm(right_hand_side)
    if guess is not None:
        trial = right_hand_side - operator(guess)
        if norm(trial) < start:
            solution, residual, start = guess.copy(), trial, norm(trial)
    if start <= tolerance:
        return KrylovResult(solution, 0, start, True)
    basis = [residual / start]
    directions: list[Array] = []
    hessenberg = np.zeros((maximum_iterations + 1, maximum_iterations))
    cosines, sines = np.zeros(maximum_iterations), np.zeros(maximum_iterations)
    rotated = np.zeros(maximum_iterations + 1)
    rotated[0] = start
    count = 0
    for k in range(maximum_iterations):
        directions.append(preconditioner(basis[k]))
        image = operator(directions[k])
        size = norm(image)
        if not np.isfinite(size):
            return KrylovResult(solution, count, start, False)
        column = hessenberg[:, k]
        for i, vector in enumerate(basis):
            column[i] = dot(vector, image)
            image -= column[i] * vector
        following = norm(image)
        column[k + 1] = following
        for i in range(k):
            upper, lower = column[i], column[i + 1]
            column[i] = cosines[i] * upper + sines[i] * lower
            column[i + 1] = -sines[i] * upper + cosines[i] * lower
        length = float(np.hypot(column[k], column[k + 1]))
        if length == 0.0:
            break
        cosines[k], sines[k] = column[k] / length, column[k + 1] / length
        column[k], column[k + 1] = length, 0.0
        rotated[k + 1] = -sines[k] * rotated[k]
        rotated[k] *= cosines[k]
        count = k + 1
        # The new direction is all rounding: the space is exhausted and the residual as small as it gets.
        if abs(rotated[count]) <= tolerance or following <= 1e-14 * size:
            break
        basis.append(image / following)
    if count:
        weights = np.linalg.solve(np.triu(hessenberg[:count, :count]), rotated[:count])
        for weight, direction in zip(weights, directions):
            solution += weight * direction
    left = abs(float(rotated[count]))
    return KrylovResult(solution, count, left, left <= tolerance)
