"""Runge-Kutta pairs and the constants of step control, all in one place.

A substep that goes from t to t + h advances with the higher order of the pair; the difference to the embedded lower
order is the error estimate. References: Hairer, Norsett & Wanner, Solving ODEs I, section II.4; Bogacki & Shampine
1989; Kennedy & Carpenter, Appl. Numer. Math. 44 (2003) 139, for the implicit one.

Why no pair 3(2) with three stages: isotropic unloading follows z ~ p^P0, and the estimate of every such pair is
proportional to ``f''(f, f) + 4 f' f' f``, which for this solution is P0 (P0 - 1)(1 - 2 P0): it vanishes identically at
P0 = 1/2, the value of the source. The estimate of Bogacki and Shampine is proportional to the third derivative itself,
and so is that of the implicit pair, because its stages are of order two.
"""

from dataclasses import dataclass

import numpy as np

SAFETY = 0.9
"""Aim below the tolerance, so that most next substeps are accepted."""
MIN_FACTOR = 0.2
"""A substep never shrinks by more than this at once: the estimate is only asymptotic."""
MAX_FACTOR = 10.0
"""Nor grows by more than this."""
FAILED_STAGE_FACTOR = 0.25
"""Shrink by this when a stage leaves the admissible set."""
LARGEST_CHANGE = 0.5
"""Most by which p and z may change in one substep relative to themselves, and a_c absolutely. An estimate of
the error means nothing beyond."""
APEX_FRACTION = 1e-6
"""A point that gets stuck at less than this fraction of its start pressure is reported as having lost its pressure."""
SMALLEST_SUBSTEP = 1e-13
"""A substep smaller than this fraction of the increment is a failure."""


@dataclass(frozen=True)
class Tableau:
    """Coefficients of a pair.

    Parameters
    ----------
    a : ndarray, shape (s, s)
        Lower triangular; a stage with an entry on the diagonal is implicit. The first stage is explicit in all pairs.
    b : ndarray, shape (s,)
        Weights of the order that is used.
    error : ndarray, shape (s,)
        `b` minus the weights of the embedded order; zeros if there is none.
    order : int
        Order of `b`.
    error_order : int
        Order of the embedded method; 0 if there is none (fixed substeps).
    """

    a: np.ndarray
    b: np.ndarray
    error: np.ndarray
    order: int
    error_order: int


def _tableau(rows: list[list[float]], b: list[float], embedded: list[float] | None, order: int) -> Tableau:
    s = len(b)
    a = np.zeros((s, s))
    for i, row in enumerate(rows):
        a[i + 1, : len(row)] = row
    weights = np.array(b)
    if embedded is None:
        return Tableau(a, weights, np.zeros(s), order, 0)
    return Tableau(a, weights, weights - np.array(embedded), order, order - 1)


def _kennedy_carpenter() -> Tableau:
    """ESDIRK3(2)4L[2]SA: explicit first stage, one diagonal entry, L-stable, stiffly accurate, stages of order two.

    The diagonal solves gamma^3 - 3 gamma^2 + 3 gamma/2 - 1/6 = 0, the third node is 3/5; everything but the embedded
    weights follows from the order conditions.
    """
    gamma, c3 = 0.43586652150845899942, 3 / 5
    c2 = 2 * gamma
    a32 = c3 * (c3 / 2 - gamma) / c2
    # sum b = 1, b.c = 1/2, b.c^2 = 1/3 with b_4 = gamma at c_4 = 1
    b3 = ((1 / 3 - gamma) - (1 / 2 - gamma) * c2) / (c3 * (c3 - c2))
    b2 = (1 / 2 - gamma - b3 * c3) / c2
    b = np.array([1 - b2 - b3 - gamma, b2, b3, gamma])
    embedded = np.array(
        [
            2756255671327 / 12835298489170,
            -10771552573575 / 22201958757719,
            9247589265047 / 10645013368117,
            2193209047091 / 5459859503100,
        ]
    )
    a = np.array([[0.0] * 4, [gamma, gamma, 0.0, 0.0], [c3 - a32 - gamma, a32, gamma, 0.0], b])
    return Tableau(a, b, b - embedded, 3, 2)


TABLEAUS: dict[str, Tableau] = {
    "forward_euler": _tableau([], [1.0], None, 1),
    "modified_euler": _tableau([[1.0]], [0.5, 0.5], [1.0, 0.0], 2),
    "bogacki_shampine": _tableau(
        [[1 / 2], [0.0, 3 / 4], [2 / 9, 1 / 3, 4 / 9]],
        [2 / 9, 1 / 3, 4 / 9, 0.0],
        [7 / 24, 1 / 4, 1 / 3, 1 / 8],
        3,
    ),
    "dormand_prince": _tableau(
        [
            [1 / 5],
            [3 / 40, 9 / 40],
            [44 / 45, -56 / 15, 32 / 9],
            [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
            [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656],
            [35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
        ],
        [35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84, 0.0],
        [5179 / 57600, 0.0, 7571 / 16695, 393 / 640, -92097 / 339200, 187 / 2100, 1 / 40],
        5,
    ),
    "kennedy_carpenter": _kennedy_carpenter(),
}


def ending_at_the_end(tableau: Tableau) -> Tableau:
    """The same scheme with its end as last stage: the rates there are the next substep's first ones.

    Pairs that have no such stage get one without weight.
    """
    if np.array_equal(tableau.a[-1], tableau.b):
        return tableau
    s = len(tableau.b)
    a = np.zeros((s + 1, s + 1))
    a[:s, :s], a[s, :s] = tableau.a, tableau.b
    return Tableau(a, np.append(tableau.b, 0.0), np.append(tableau.error, 0.0), tableau.order, tableau.error_order)
