"""Linear solves by PETSc: a factor that is kept, as preconditioner of GMRES on the exact tangent.

The rules for its renewal are those of `granfabric.fem.linear_solvers.tangent`. Prescribed degrees of freedom stay in
the system as rows of the identity, so that its layout stays; where rigid bodies tie some, there are other unknowns.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.accounting import Accounting
from granfabric.fem.linear_solvers.direct import FactorisationError
from granfabric.fem.linear_solvers.tangent import LARGEST_COUNT, LARGEST_COUNT_FRESH, RENEWAL_COST

Array = NDArray[np.float64]

PACKAGES = ("mumps", "superlu_dist", "superlu")
"""Direct solvers in the order in which they are tried; the last one on one rank only."""


class _Action:
    """The matrix that PETSc sees: x -> K x for the free degrees of freedom, the identity for the others."""

    def __init__(self) -> None:
        self.action: Callable[[Array], Array] | None = None
        self.constrained: NDArray[np.bool_] = np.empty(0, dtype=bool)

    def mult(self, matrix: Any, given: Any, out: Any) -> None:
        """Called by PETSc."""
        assert self.action is not None
        x = given.getArray(readonly=True)
        image = self.action(np.where(self.constrained, 0.0, x))
        out.setArray(np.where(self.constrained, x, image))


class KeptFactor:
    """Solve ``K x = b`` for a slowly changing K, spread over the ranks.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    accounting : Accounting
    keep_factor : bool
        If False, every solve factorises anew.

    Attributes
    ----------
    name : str
        Of the direct solver.
    """

    def __init__(self, comm: Any, accounting: Accounting, keep_factor: bool) -> None:
        self._petsc = importlib.import_module("petsc4py.PETSc")
        self._comm = comm
        self._accounting = accounting
        self._keep = keep_factor
        self._context = _Action()
        self._size = -1
        self._make(0)
        self._has_factor = False
        self._excess = 0
        self._count_when_fresh: int | None = None

    def _make(self, size: int) -> None:
        """Vectors and solver for so many unknowns of this rank."""
        self._shell = self._petsc.Mat().createPython(((size, None), (size, None)), self._context, comm=self._comm)
        self._shell.setUp()
        self._x, self._b = self._shell.createVecs()
        self._solver = self._petsc.KSP().create(self._comm)
        self._solver.setType("fgmres")
        self._solver.setGMRESRestart(LARGEST_COUNT_FRESH)
        preconditioner = self._solver.getPC()
        preconditioner.setType("lu")
        self.name = self._choose(preconditioner, self._comm.size)

    def _choose(self, preconditioner: Any, ranks: int) -> str:
        for name in PACKAGES[: None if ranks == 1 else -1]:
            try:
                preconditioner.setFactorSolverType(name)
                return f"petsc-{name}"
            except self._petsc.Error:
                continue
        raise FactorisationError("this PETSc has no direct solver for several ranks (MUMPS or SuperLU_DIST)")

    def reset(self, constrained: NDArray[np.bool_]) -> None:
        """Forget the factor; from now on these of this rank's unknowns are prescribed."""
        if self._comm.allreduce(int(len(constrained) != self._size)):
            self._size = len(constrained)
            self._make(self._size)
        self._context.constrained = constrained
        self._has_factor = False
        self._excess = 0

    def _renew(self, matrix: Callable[[], Any]) -> None:
        assembled = matrix()
        with self._accounting.phase("factorise"):
            self._accounting.factorisations += 1
            self._solver.setOperators(self._shell, assembled)
            self._solver.setUp()
        self._has_factor = True
        self._excess = 0
        self._count_when_fresh = None

    def solve(
        self,
        action: Callable[[Array], Array],
        matrix: Callable[[], Any],
        right_hand_side: Array,
        size: float,
        relative_tolerance: float,
        guess: Array | None,
    ) -> Array:
        """Solution with ``|b - K x| <= relative_tolerance |b|``.

        Parameters
        ----------
        action : callable
            ``x -> K x`` on the unknowns that this rank owns; called by all ranks together.
        matrix : callable
            Assembles K as a PETSc matrix, prescribed rows and columns those of the identity.
        right_hand_side : ndarray, shape (n,)
            Zero where prescribed.
        size : float
            Its norm over all ranks.
        relative_tolerance : float
        guess : ndarray, shape (n,), optional

        Raises
        ------
        FactorisationError
            On all ranks, if K is singular or the iteration fails with a fresh factor.
        """
        if size == 0.0:
            return np.zeros_like(right_hand_side)
        if not np.isfinite(size):
            raise FactorisationError("the right-hand side is not finite")
        self._accounting.linear_solves += 1
        self._context.action = action
        fresh = not self._has_factor or not self._keep or self._excess >= RENEWAL_COST
        if fresh:
            self._renew(matrix)
        while True:
            with self._accounting.phase("solve"):
                reason, count, left = self._iterate(right_hand_side, guess, relative_tolerance * size, fresh)
            self._accounting.krylov_iterations += count
            if reason > 0:
                break
            if not np.isfinite(left) or reason == self._petsc.KSP.ConvergedReason.DIVERGED_PCSETUP_FAILED:
                if fresh:
                    self._has_factor = False
                    raise FactorisationError(f"{self.name}: the matrix has no factor")
            elif fresh and left <= 100 * relative_tolerance * size:
                break  # as far as rounding lets it come; Newton's own residual decides
            elif fresh:
                raise FactorisationError(
                    f"the linear solve stalled at a relative residual of {left / size:.1e}; the tangent is (nearly) "
                    "singular"
                )
            self._renew(matrix)
            fresh = True
        if self._count_when_fresh is None:
            self._count_when_fresh = count
        self._excess += max(0, count - self._count_when_fresh)
        return np.where(self._context.constrained, 0.0, self._x.getArray(readonly=True))

    def _iterate(
        self, right_hand_side: Array, guess: Array | None, tolerance: float, fresh: bool
    ) -> tuple[int, int, float]:
        self._b.setArray(right_hand_side)
        self._x.setArray(np.zeros_like(right_hand_side) if guess is None else guess)
        limit = LARGEST_COUNT_FRESH if fresh else LARGEST_COUNT
        self._solver.setInitialGuessNonzero(guess is not None)
        self._solver.setTolerances(rtol=1e-50, atol=tolerance, divtol=1e10, max_it=limit)
        self._solver.solve(self._b, self._x)
        return (
            int(self._solver.getConvergedReason()),
            int(self._solver.getIterationNumber()),
            float(self._solver.getResidualNorm()),
        )
