"""Least squares through the point law: a start from which the law follows, the search, and how it ended."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from .deviations import Deviations, StoppedError
from .parameters import Free, values_of

Array = NDArray[np.float64]

MOST_STEPS = 100
TOLERANCE = 1e-9
"""Relative change of parameters, or of the sum of squares, at which the search ends."""
GRADIENT = 1e-6
"""Largest slope of half the sum of squares at which it ends."""
STARTS = 40
"""Other starts that are tried where the law refuses to follow from the first."""
APART = 0.5
"""Their distance from the first, over the sizes of the parameters."""


@dataclass(frozen=True)
class Search:
    """How a search ended.

    Attributes
    ----------
    sought : ndarray, shape (nfree,)
        Best so far.
    deviations : ndarray
    converged : bool
    stopped : bool
    message : str
    steps : int
    """

    sought: Array
    deviations: Array
    converged: bool
    stopped: bool
    message: str
    steps: int


def first_sought(free: Sequence[Free]) -> Array:
    """Where the search begins."""
    return np.array([entry.inside(entry.first) for entry in free])


def start(deviations: Deviations, free: Sequence[Free], held: dict[str, float]) -> Array | None:
    """A start from which the law follows every curve to its end: the first, or the best of some around it; or None."""
    sought = first_sought(free)
    if np.isfinite(deviations.of(values_of(free, sought, held))).all():
        return sought
    limits = np.array([entry.limits for entry in free]).reshape(-1, 2)
    random = np.random.default_rng(1)
    best: tuple[float, Array] | None = None
    for _ in range(STARTS):
        other = np.clip(sought + APART * random.uniform(-1.0, 1.0, sought.size), limits[:, 0], limits[:, 1])
        here = deviations.of(values_of(free, other, held))
        if np.isfinite(here).all() and (best is None or here @ here < best[0]):
            best = (float(here @ here), other)
    return None if best is None else best[1]


def search(
    deviations: Deviations,
    free: Sequence[Free],
    held: dict[str, float],
    begin: Array,
    on_step: Callable[[int, float], None],
) -> Search:
    """Find the parameters with the least sum of squares.

    Where the law refuses a trial its deviations are not finite, and the trust region shrinks until it follows.

    Parameters
    ----------
    deviations : Deviations
    free : sequence of Free
    held : dict of str to float
        All parameters; those of the free ones are not used.
    begin : ndarray, shape (nfree,)
        From which the law follows every curve.
    on_step : callable
        Called with the number of trials and the root mean square of the deviations of the best so far.
    """
    best: list[tuple[float, Array, Array]] = []
    trials = 0
    known: dict[bytes, Array] = {}

    def function(sought: Array) -> Array:
        nonlocal trials
        here = deviations.of(values_of(free, sought, held))
        trials += 1
        cost = float(here @ here) if np.isfinite(here).all() else np.inf
        if np.isfinite(cost) and (not best or cost < best[0][0]):
            best[:] = [(cost, sought.copy(), here)]
        known.clear()
        known[sought.tobytes()] = here
        if best:
            on_step(trials, float(np.sqrt(best[0][0] / max(here.size, 1))))
        return here

    def jacobian(sought: Array) -> Array:
        here = known.get(sought.tobytes())
        if here is None:
            here = best[0][2] if np.array_equal(best[0][1], sought) else deviations.of(values_of(free, sought, held))
        return deviations.derivative(free, sought, held, here)

    limits = np.array([entry.limits for entry in free]).reshape(-1, 2)
    try:
        found = least_squares(
            function, begin, jac=jacobian, bounds=(limits[:, 0], limits[:, 1]), method="trf", max_nfev=MOST_STEPS,
            xtol=TOLERANCE, ftol=TOLERANCE, gtol=GRADIENT,
        )  # fmt: skip
    except StoppedError:
        if not best:
            raise
        return Search(best[0][1], best[0][2], False, True, f"stopped after {trials} trials", trials)
    converged = found.status > 0
    message = "" if converged else f"not converged within {trials} trials"
    return Search(best[0][1], best[0][2], converged, False, message, trials)
