"""Direct solvers, the Krylov method and the policy of keeping a factor."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from fem_meshes import distorted
from scipy.sparse import csr_matrix, diags, random_array

import granfabric.fem.linear_solvers.direct as module
from granfabric.fem.accounting import Accounting
from granfabric.fem.discretisation.assembly import TangentAssembler
from granfabric.fem.discretisation.space import Space
from granfabric.fem.linear_solvers.direct import (
    CholmodSolver,
    FactorisationError,
    LinearSolverError,
    SuperLUSolver,
    make_solver,
)
from granfabric.fem.linear_solvers.krylov import fgmres
from granfabric.fem.linear_solvers.tangent import LARGEST_COUNT, TangentSolver

try:
    CholmodSolver()
    SOLVERS = ("superlu", "cholmod")
except LinearSolverError:
    SOLVERS = ("superlu",)
needs_cholmod = pytest.mark.skipif(len(SOLVERS) == 1, reason="package cvxopt is not installed")


def stiffness(scale=1.0, n=8):
    """Elastic stiffness of a square held at one side."""
    space = Space(distorted("P2", n), "P2")
    held = space.boundary_nodes("left")
    free = np.setdiff1d(np.arange(space.ndofs), np.concatenate([2 * held, 2 * held + 1]))
    tangent = np.tile(scale * np.array([[3.0, 1.0, 0.0], [1.0, 3.0, 0.0], [0.0, 0.0, 1.0]]), (space.npoints, 1, 1))
    assembler = TangentAssembler(space, free)
    return assembler, tangent, assembler.assemble(tangent)


@pytest.mark.parametrize("name", SOLVERS)
def test_solutions_and_kept_analysis(name):
    assembler, tangent, matrix = stiffness()
    solver = make_solver(name)
    right = np.random.default_rng(0).standard_normal(matrix.shape[0])
    for scale in (1.0, 2.0, 5.0):  # new values in the same pattern
        assembler.assemble(scale * tangent)
        solution = solver.factorise(matrix).solve(right)
        assert np.linalg.norm(matrix @ solution - right) <= 1e-10 * np.linalg.norm(right)


@needs_cholmod
def test_cholmod_analyses_once_for_a_pattern():
    assembler, tangent, _ = stiffness()
    solver = CholmodSolver()
    calls = []
    cholmod = solver._cholmod

    class Counting:
        def __getattr__(self, name):
            return getattr(cholmod, name)

        def symbolic(self, *arguments):
            calls.append(1)
            return cholmod.symbolic(*arguments)

    solver._cholmod = Counting()
    for scale in (1.0, 2.0, 3.0):
        solver.factorise(assembler.assemble(scale * tangent))
    assert len(calls) == 1


@needs_cholmod
def test_cholmod_takes_the_symmetric_part_and_refuses_indefinite_ones():
    _, _, matrix = stiffness()
    skew = matrix.copy()
    rng = np.random.default_rng(1)
    rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    noise = rng.standard_normal(matrix.shape)
    skew.data = matrix.data + 0.05 * (noise - noise.T)[rows, matrix.indices]
    right = rng.standard_normal(matrix.shape[0])
    expected = CholmodSolver().factorise(matrix).solve(right)
    np.testing.assert_allclose(CholmodSolver().factorise(skew).solve(right), expected, rtol=1e-9)
    solver = CholmodSolver()
    negative = -matrix
    with pytest.raises(FactorisationError, match="not positive definite"):
        solver.factorise(negative)
    # A failed attempt does no harm to the next.
    np.testing.assert_allclose(solver.factorise(matrix).solve(right), expected, rtol=1e-12)


@pytest.mark.parametrize("name", SOLVERS)
def test_values_that_are_not_finite_are_refused(name):
    _, _, matrix = stiffness()
    matrix.data[3] = np.nan
    with pytest.raises(FactorisationError, match="not finite"):
        make_solver(name).factorise(matrix)


def test_superlu_pivots_when_its_symmetric_mode_is_not_good_enough():
    # Zeros on the diagonal: no elimination without exchanging rows.
    n = 50
    matrix = csr_matrix(diags([np.full(n - 1, 1.0), np.full(n - 1, 1.0)], [-1, 1]))
    matrix = (matrix + diags([np.full(n, 1e-18)], [0])).tocsr()
    right = np.random.default_rng(2).standard_normal(n)
    solution = SuperLUSolver().factorise(matrix).solve(right)
    assert np.linalg.norm(matrix @ solution - right) <= 1e-10 * np.linalg.norm(right)


def test_solver_names(monkeypatch):
    with pytest.raises(LinearSolverError, match="'mumps' is not one of auto, cholmod, superlu"):
        make_solver("mumps")
    original = importlib.import_module

    def without(name, *arguments):
        if name.startswith("cvxopt"):
            raise ImportError(name)
        return original(name, *arguments)

    monkeypatch.setattr(module.importlib, "import_module", without)
    assert make_solver("auto").name == "superlu"
    with pytest.raises(LinearSolverError, match=r"granfabric\[fast\]"):
        make_solver("cholmod")


def test_fgmres_solves_an_unsymmetric_system_and_reports_the_true_residual():
    n = 60
    rng = np.random.default_rng(3)
    noise = random_array((n, n), density=0.1, rng=rng)
    matrix = csr_matrix(noise + diags([np.linspace(3.0, 9.0, n)], [0]))
    right, inverse = rng.standard_normal(n), 1.0 / matrix.diagonal()
    for tolerance in (1e-2, 1e-6, 1e-11):
        result = fgmres(lambda x: matrix @ x, lambda x: inverse * x, right, None, tolerance, n)
        true = np.linalg.norm(right - matrix @ result.solution)
        assert result.converged and true <= 1.01 * tolerance
        assert result.residual == pytest.approx(true, rel=1e-2)
    guess = result.solution
    assert fgmres(lambda x: matrix @ x, lambda x: inverse * x, right, guess, 1e-9, n).iterations == 0
    # A useless guess is not used.
    far = fgmres(lambda x: matrix @ x, lambda x: inverse * x, right, 1e6 * guess, 1e-6, n)
    cold = fgmres(lambda x: matrix @ x, lambda x: inverse * x, right, None, 1e-6, n)
    np.testing.assert_array_equal(far.solution, cold.solution)


def test_fgmres_says_so_when_it_has_not_converged():
    n = 40
    matrix = csr_matrix(diags([np.linspace(1.0, 1e6, n)], [0]))
    result = fgmres(lambda x: matrix @ x, lambda x: x.copy(), np.ones(n), None, 1e-10, 5)
    assert not result.converged and result.iterations == 5
    assert result.residual == pytest.approx(np.linalg.norm(np.ones(n) - matrix @ result.solution), rel=1e-6)


@pytest.mark.parametrize("name", SOLVERS)
def test_a_factor_is_kept_while_it_is_good_and_renewed_when_it_is_worn(name):
    _, _, matrix = stiffness()
    accounting = Accounting()
    solver = TangentSolver(make_solver(name), accounting)
    rng = np.random.default_rng(4)
    right = rng.standard_normal(matrix.shape[0])

    def solve(values):
        solution = solver.solve(lambda x: values @ x, lambda: values, right, 1e-10)
        assert np.linalg.norm(values @ solution - right) <= 1.01e-10 * np.linalg.norm(right)

    solve(matrix)
    assert accounting.factorisations == 1 and accounting.krylov_iterations <= 2
    nearby = matrix.copy()
    for _ in range(3):
        nearby.data = nearby.data * 1.001
        solve(nearby)
    assert accounting.factorisations == 1
    far = matrix.copy()
    far.setdiag(matrix.diagonal() + rng.uniform(0.0, 100.0, matrix.shape[0]))
    solve(far)
    assert accounting.factorisations == 2
    assert accounting.krylov_iterations <= 2 * 4 + LARGEST_COUNT + 2


@needs_cholmod
@pytest.mark.parametrize("kind", ["indefinite", "unsymmetric"])
def test_indefinite_and_strongly_unsymmetric_tangents_fall_back_to_lu(kind):
    _, _, matrix = stiffness()
    accounting = Accounting()
    solver = TangentSolver(CholmodSolver(), accounting)
    rng = np.random.default_rng(5)
    right = rng.standard_normal(matrix.shape[0])
    bad = matrix.copy()
    if kind == "indefinite":
        bad.setdiag(0.5 * matrix.diagonal())
    else:
        rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
        noise = rng.standard_normal(matrix.shape)
        bad.data = matrix.data + 3.0 * (noise - noise.T)[rows, matrix.indices]
    for _ in range(3):
        solution = solver.solve(lambda x: bad @ x, lambda: bad, right, 1e-8)
        assert np.linalg.norm(bad @ solution - right) <= 1.01e-8 * np.linalg.norm(right)
    assert accounting.lu_fallbacks == 1


def test_singular_tangent_is_an_error_not_an_answer():
    n = 20
    matrix = csr_matrix(diags([np.concatenate([[0.0], np.ones(n - 1)])], [0]))
    solver = TangentSolver(SuperLUSolver(), Accounting())
    with pytest.raises(FactorisationError):
        solver.solve(lambda x: matrix @ x, lambda: matrix, np.ones(n), 1e-8)
