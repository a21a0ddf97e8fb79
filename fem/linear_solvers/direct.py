"""Sparse direct solvers behind one small interface: ``factorise(matrix)`` returns something that can ``solve(b)``.

SuperLU (in SciPy) is always there; CHOLMOD (package cvxopt) is several times faster on symmetric positive definite
matrices and is used if it is installed.
"""

from __future__ import annotations

import importlib
import logging
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix, csr_matrix
from scipy.sparse.linalg import SuperLU, splu

from granfabric.fem.vectors import norm

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)

SOLVER_NAMES = ("auto", "cholmod", "superlu")
# A solve of SuperLU in its symmetric mode (pivots on the diagonal) is checked; beyond this relative residual the
# matrix is factorised again with row pivoting.
_LARGEST_RESIDUAL = 1e-8


class LinearSolverError(ValueError):
    """The chosen solver is unknown or not installed."""


class FactorisationError(ArithmeticError):
    """The matrix has no such factorisation: singular, not finite, or not positive definite."""


class Factor(Protocol):
    """A factorised matrix."""

    def solve(self, right_hand_side: Array) -> Array:
        """Solution for one right-hand side, shape (n,), as a new array."""
        ...


class LinearSolver(Protocol):
    """A direct solver that keeps its symbolic analysis as long as the pattern object stays the same."""

    name: str
    symmetric_only: bool

    def factorise(self, matrix: csr_matrix) -> Factor:
        """Factorise a matrix with symmetric pattern and ascending columns.

        Raises
        ------
        FactorisationError
            If there is no factorisation.
        """
        ...


class _SuperLUFactor:
    def __init__(self, matrix: csr_matrix) -> None:
        self._matrix = matrix.copy()
        # The rows of the matrix read as columns are its transpose: no conversion, and solved with trans="T".
        self._transposed = csc_matrix((self._matrix.data, matrix.indices, matrix.indptr), shape=matrix.shape)
        self._pivoting = False
        self._factor = self._decompose(diagonal=True)

    def _decompose(self, diagonal: bool) -> SuperLU:
        try:
            if diagonal:
                return splu(
                    self._transposed, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
                )
            return splu(self._transposed, permc_spec="COLAMD")
        except RuntimeError as error:
            raise FactorisationError(f"SuperLU: {error}") from None

    def solve(self, right_hand_side: Array) -> Array:
        solution = self._factor.solve(right_hand_side, trans="T")
        size = norm(right_hand_side)
        if not self._pivoting:
            residual = norm(self._matrix @ solution - right_hand_side)
            if not residual <= _LARGEST_RESIDUAL * size:
                logger.info("SuperLU in symmetric mode left a residual of %.1e; pivoting now", residual / size)
                self._factor = self._decompose(diagonal=False)
                self._pivoting = True
                solution = self._factor.solve(right_hand_side, trans="T")
        if not np.isfinite(solution).all():
            raise FactorisationError("SuperLU: the matrix is singular")
        return solution


class SuperLUSolver:
    """SuperLU with minimum degree ordering of A^T + A and pivots on the diagonal; residual checked."""

    name = "superlu"
    symmetric_only = False

    def factorise(self, matrix: csr_matrix) -> Factor:
        """See `LinearSolver.factorise`; the matrix may be unsymmetric."""
        if not np.isfinite(matrix.data).all():
            raise FactorisationError("the matrix holds values that are not finite")
        return _SuperLUFactor(matrix)


class _CholmodFactor:
    def __init__(self, modules: tuple[Any, Any], factor: Any) -> None:
        self._base, self._cholmod = modules
        self._factor = factor

    def solve(self, right_hand_side: Array) -> Array:
        column = self._base.matrix(np.ascontiguousarray(right_hand_side))
        self._cholmod.solve(self._factor, column)
        return np.array(column, dtype=np.float64).reshape(-1)


class CholmodSolver:
    """CHOLMOD's supernodal factorisation of the symmetric part ``(K + K^T)/2``.

    Raises
    ------
    LinearSolverError
        If package cvxopt is not installed.
    """

    name = "cholmod"
    symmetric_only = True

    def __init__(self) -> None:
        try:
            self._base = importlib.import_module("cvxopt.base")
            self._cholmod = importlib.import_module("cvxopt.cholmod")
        except ImportError:
            raise LinearSolverError(
                "the linear solver 'cholmod' needs package cvxopt (pip install granfabric[fast])"
            ) from None
        self._pattern: tuple[Any, Any] | None = None

    def _analyse(self, matrix: csr_matrix) -> None:
        """Half pattern, symbolic factorisation and the places of K_ij and K_ji, once for each pattern."""
        n = matrix.shape[0]
        rows = np.repeat(np.arange(n, dtype=np.int64), np.diff(matrix.indptr))
        columns = matrix.indices.astype(np.int64)
        # Rows ascend within the transpose's order, so that entry k of this order is the mirror image of entry k.
        mirror = np.lexsort((rows, columns))
        if not (np.array_equal(rows[mirror], columns) and np.array_equal(columns[mirror], rows)):
            raise FactorisationError("the pattern of the matrix is not symmetric")
        half = columns >= rows
        self._places = np.flatnonzero(half)
        self._mirrors = mirror[half]
        # The upper half by rows is the lower half by columns, in exactly the order that cvxopt keeps.
        self._half = self._base.spmatrix(
            self._base.matrix(np.where(rows[half] == columns[half], 1.0, 0.0)),
            self._base.matrix(columns[half]),
            self._base.matrix(rows[half]),
            (n, n),
        )
        self._symbolic = self._cholmod.symbolic(self._half)
        self._pattern = (matrix.indptr, matrix.indices)

    def factorise(self, matrix: csr_matrix) -> Factor:
        """See `LinearSolver.factorise`; raises `FactorisationError` unless the symmetric part is positive definite."""
        if self._pattern is None or self._pattern[0] is not matrix.indptr or self._pattern[1] is not matrix.indices:
            self._analyse(matrix)
        values = 0.5 * (matrix.data[self._places] + matrix.data[self._mirrors])
        if not np.isfinite(values).all():
            raise FactorisationError("the matrix holds values that are not finite")
        # Assigning to a slice of V would write into a copy; assigning V itself does not.
        self._half.V = self._base.matrix(values)
        try:
            self._cholmod.numeric(self._half, self._symbolic)
        except ArithmeticError:
            # The symbolic object is spent by a failed attempt.
            self._pattern = None
            raise FactorisationError("the symmetric part of the matrix is not positive definite") from None
        return _CholmodFactor((self._base, self._cholmod), self._symbolic)


def make_solver(name: str = "auto") -> LinearSolver:
    """Direct solver by name.

    Parameters
    ----------
    name : {"auto", "cholmod", "superlu"}
        "auto" takes CHOLMOD if it is installed.

    Raises
    ------
    LinearSolverError
        If the name is unknown or the solver is not installed.
    """
    if name not in SOLVER_NAMES:
        raise LinearSolverError(f"linear solver {name!r} is not one of {', '.join(SOLVER_NAMES)}")
    solver: LinearSolver
    if name == "superlu":
        solver = SuperLUSolver()
    elif name == "cholmod":
        solver = CholmodSolver()
    else:
        try:
            solver = CholmodSolver()
        except LinearSolverError:
            solver = SuperLUSolver()
    logger.info("linear solver: %s", solver.name)
    return solver
