"""Linear solves with a kept factor: preconditioner of a Krylov method on the exact tangent, renewed when it is worn."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from granfabric.fem.accounting import Accounting
from granfabric.fem.vectors import norm

from .direct import Factor, FactorisationError, LinearSolver, SuperLUSolver
from .krylov import fgmres

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)

# A factorisation costs about as much as this many Krylov iterations (measured at 10,000 to 50,000 unknowns with
# CHOLMOD, one core). A worn factor is renewed when the iterations that a fresh one would have saved add up to it:
# whatever happens afterwards, that is at most twice the cost of the best choice in hindsight.
RENEWAL_COST = 10
# A solve that takes more iterations than this renews the factor at once.
LARGEST_COUNT = 25
# With a fresh factor of the same matrix, or of its symmetric part.
LARGEST_COUNT_FRESH = 60
# Where the symmetric part did not do, this many factorisations go straight to LU before it is tried again.
LU_RENEWALS = 5


@dataclass(frozen=True)
class FactorMemory:
    """What a `TangentSolver` remembers from one solve to the next.

    Parameters
    ----------
    values : ndarray, shape (nnz,), optional
        Entries of the matrix whose factor is kept, in the order of the pattern; None if there is no factor.
    exact : bool
        Whether the factor is that of the matrix itself, not of its symmetric part.
    lu_renewals, excess : int
    count_when_fresh : int, optional
    """

    values: Array | None = None
    exact: bool = False
    lu_renewals: int = 0
    excess: int = 0
    count_when_fresh: int | None = None


class TangentSolver:
    """Solve ``K x = b`` for a slowly changing, possibly unsymmetric K.

    Parameters
    ----------
    solver : LinearSolver
        Direct solver of the factor (of the symmetric part, if it knows only symmetric matrices).
    accounting : Accounting
    keep_factor : bool
        If False, every solve factorises anew.
    """

    def __init__(self, solver: LinearSolver, accounting: Accounting, keep_factor: bool = True) -> None:
        self._solver = solver
        self._unsymmetric: LinearSolver = SuperLUSolver()
        self._accounting = accounting
        self._keep = keep_factor
        self._factor: Factor | None = None
        self._values: Array | None = None
        self._exact = False
        self._lu_renewals = 0
        self._count_when_fresh: int | None = None
        self._excess = 0

    def reset(self) -> None:
        """Forget the factor (another set of unknowns, or a tangent that has nothing to do with the last)."""
        self._factor = None
        self._values = None
        self._excess = 0
        self._lu_renewals = 0

    def memory(self) -> FactorMemory:
        """Everything on which later solves depend, but for the pattern; the array is not copied."""
        return FactorMemory(self._values, self._exact, self._lu_renewals, self._excess, self._count_when_fresh)

    def restore(self, memory: FactorMemory, pattern: csr_matrix) -> None:
        """Take up a memory: the same solves follow, to the last bit. `pattern` receives the values of the factor.

        Raises
        ------
        FactorisationError
            If the matrix cannot be factorised again.
        """
        self.reset()
        if memory.values is not None:
            pattern.data[:] = memory.values
            unsymmetric = memory.exact and self._solver.symmetric_only
            with self._accounting.phase("factorise"):
                self._factor = (self._unsymmetric if unsymmetric else self._solver).factorise(pattern)
            self._values = pattern.data.copy()
        self._exact, self._lu_renewals = memory.exact, memory.lu_renewals
        self._excess, self._count_when_fresh = memory.excess, memory.count_when_fresh

    def _renew(self, matrix: Callable[[], csr_matrix]) -> None:
        values = matrix()
        self._factor = None
        self._values = values.data.copy()
        self._excess = 0
        self._count_when_fresh = None
        self._exact = not self._solver.symmetric_only
        with self._accounting.phase("factorise"):
            if self._lu_renewals == 0:
                try:
                    self._accounting.factorisations += 1
                    self._factor = self._solver.factorise(values)
                    return
                except FactorisationError as error:
                    if not self._solver.symmetric_only:
                        raise
                    logger.info("%s: %s; using %s", self._solver.name, error, self._unsymmetric.name)
                    self._lu_renewals = LU_RENEWALS
            self._lu_renewals -= 1
            self._accounting.lu_fallbacks += 1
            self._exact = True
            self._accounting.factorisations += 1
            self._factor = self._unsymmetric.factorise(values)

    def solve(
        self,
        operator: Callable[[Array], Array],
        matrix: Callable[[], csr_matrix],
        right_hand_side: Array,
        relative_tolerance: float,
        guess: Array | None = None,
    ) -> Array:
        """Solution with ``|b - K x| <= relative_tolerance |b|``.

        Parameters
        ----------
        operator : callable
            ``x -> K x`` with the exact tangent.
        matrix : callable
            Assembles K; called only when the factor is renewed.
        right_hand_side : ndarray, shape (n,)
        relative_tolerance : float
        guess : ndarray, shape (n,), optional

        Raises
        ------
        FactorisationError
            If K is singular, not finite, or the iteration fails even with a fresh factor of K itself.
        """
        size = norm(right_hand_side)
        if size == 0.0:
            return np.zeros_like(right_hand_side)
        if not np.isfinite(size):
            raise FactorisationError("the right-hand side is not finite")
        self._accounting.linear_solves += 1
        tolerance = relative_tolerance * size
        fresh = False
        if self._factor is None or not self._keep or self._excess >= RENEWAL_COST:
            self._renew(matrix)
            fresh = True
        while True:
            assert self._factor is not None
            with self._accounting.phase("solve"):
                limit = LARGEST_COUNT_FRESH if fresh else LARGEST_COUNT
                result = fgmres(operator, self._factor.solve, right_hand_side, guess, tolerance, limit)
            self._accounting.krylov_iterations += result.iterations
            if result.converged:
                break
            guess = result.solution
            if not fresh:
                self._renew(matrix)
                fresh = True
            elif not self._exact:
                logger.info("the symmetric part is no good preconditioner; using %s", self._unsymmetric.name)
                self._lu_renewals = LU_RENEWALS
                self._renew(matrix)
            elif result.residual <= 100 * tolerance:
                break  # as far as rounding lets it come; Newton's own residual decides
            else:
                raise FactorisationError(
                    f"the linear solve stalled at a relative residual of {result.residual / size:.1e}; "
                    "the tangent is (nearly) singular"
                )
        if self._count_when_fresh is None:
            self._count_when_fresh = result.iterations
        self._excess += max(0, result.iterations - self._count_when_fresh)
        return result.solution
