"""The discrete system at its last commit: what one load step starts from."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from granfabric.constitutive.contract import UpdateReport
from granfabric.fem.accounting import Accounting
from granfabric.fem.discretisation.active_part import ActivePart
from granfabric.fem.discretisation.assembly import ForceAssembler
from granfabric.fem.discretisation.quadrature_material import QuadratureMaterial
from granfabric.fem.linear_solvers.direct import make_solver
from granfabric.fem.linear_solvers.tangent import FactorMemory, TangentSolver
from granfabric.fem.loads.load_program import StageTerms
from granfabric.fem.loads.problem import Problem
from granfabric.fem.vectors import dot, norm

from .control import StepControl
from .unknowns import FreeUnknowns, Unknowns, UnknownsTangent, unknowns_of

Array = NDArray[np.float64]
Kind = TypeVar("Kind", bound=np.generic)


class Equilibrium:
    """Displacements, internal forces, material and solvers of a run.

    Parameters
    ----------
    problem : Problem
    control : StepControl
    accounting : Accounting

    Attributes
    ----------
    displacement, internal_force : ndarray, shape (ndofs,)
        At the last commit [m], [N/m].
    internal_trial : ndarray, shape (ndofs,)
        At the last trial.
    force_scale : float
        Largest norm of internal or external nodal forces at the commits of the current stage and at its start [N/m].
    constrained : ndarray of int
        Prescribed degrees of freedom, without one that a control leads; set by `constrain`.
    unknowns : Unknowns
        Set by `constrain`.
    part : ActivePart or None
        Where stages change the body, what of it is there: arrays of points are those of the part.
    """

    def __init__(self, problem: Problem, control: StepControl, accounting: Accounting) -> None:
        space = problem.space
        self._problem = problem
        self.space = space
        self.control = control
        self.accounting = accounting
        self.part: ActivePart | None = None
        self._tangent_matrix: UnknownsTangent | None = None
        body = problem.program.terms[0].body
        part = None if body is None else self.part_of(body.active)
        self.enter(part, problem.initial_stress, problem.initial_state, None)
        self.displacement = np.zeros(space.ndofs)
        self.internal_force = np.zeros(space.ndofs)
        self.internal_trial = np.zeros(space.ndofs)
        self.scratch = np.zeros(space.ndofs)
        self._product = np.zeros(space.ndofs)
        self._full = np.zeros(space.ndofs)
        self.constrained = np.empty(0, dtype=np.int64)
        self.unknowns: Unknowns = FreeUnknowns(self.constrained)
        self._kind: tuple[object, ...] = ()
        self._ties: csr_matrix | None = None
        self._springs: csr_matrix | None = None
        self._had_springs = False
        self._spring_offset: Array | None = None
        self._direct = make_solver(control.linear_solver)
        self._solver = TangentSolver(self._direct, accounting, control.keep_factor)
        self.force_scale = 0.0
        self.refresh_internal_force()

    def part_of(self, active: NDArray[np.bool_]) -> ActivePart:
        """The elements of a mask, shape (nelem,), as `enter` takes them."""
        return ActivePart(self.space, active)

    def enter(self, part: ActivePart | None, stress: Array, state: Array, strain: Array | None) -> None:
        """Take up another part of the body, the whole if None; `constrain` has to follow before anything is solved.

        Parameters
        ----------
        part : ActivePart or None
        stress, state, strain : ndarray, shapes (npt, 3), (npt, nstate), (npt, 3)
            Of all points of the space; strain zero if None.
        """
        rows = self._problem.material_index
        if part is not None:
            stress, state = stress[part.points], state[part.points]
            strain = None if strain is None else strain[part.points]
            rows = None if rows is None else rows[part.points]
        self.part = part
        self.forces = ForceAssembler(self.space if part is None else part)
        self.material = QuadratureMaterial(
            self._problem.law, self.forces, stress, state, self.accounting, strain, material_index=rows
        )
        self._tangent_matrix = None

    def of_space(self, values: NDArray[Kind]) -> NDArray[Kind]:
        """Values at all points of the space of those at the points that are there; zero elsewhere. Always a copy."""
        if self.part is None:
            return values.copy()
        whole = np.zeros((self.space.npoints, *values.shape[1:]), dtype=values.dtype)
        whole[self.part.points] = values
        return whole

    def worst(self, report: UpdateReport) -> tuple[int, str]:
        """Point of a report with the gravest status, by its number in the space, and the sentence on it."""
        if self.part is None or report.worst_point < 0:
            return report.worst_point, report.message
        point = int(self.part.points[report.worst_point])
        return point, f"point {point}: {report.message.partition(': ')[2]}"

    @property
    def solver_name(self) -> str:
        """Name of the direct solver in use."""
        return self._direct.name

    def norm(self, vector: Array) -> float:
        """Euclidean norm of a vector of degrees of freedom."""
        return norm(vector)

    def dot(self, first: Array, second: Array) -> float:
        """Inner product of two vectors of degrees of freedom."""
        return dot(first, second)

    def any(self, vector: Array) -> bool:
        """Whether anything in a vector differs from zero."""
        return bool(vector.any())

    def refresh_internal_force(self) -> None:
        """Internal forces of the committed stress and of the springs."""
        self.forces.internal_force(self.material.stress_start, self.internal_force)
        self._add_springs(self.displacement, self.internal_force)

    def internal(self, displacement: Array, out: Array) -> Array:
        """Internal forces of the last trial, under these displacements; also sets the magnitude of their parts."""
        self.forces.internal_force(self.material.stress_end, out)
        self._add_springs(displacement, out)
        return out

    def _add_springs(self, displacement: Array, out: Array) -> None:
        if self._springs is not None:
            out += self._springs @ displacement
            if self._spring_offset is not None:
                out -= self._spring_offset

    def action(self, tangent: Array, displacement: Array, out: Array) -> Array:
        """Tangent of body and springs times displacements, shape (ndofs,)."""
        self.forces.tangent_times(tangent, displacement, out)
        if self._springs is not None:
            out += self._springs @ displacement
        return out

    def constrain(self, terms: StageTerms) -> None:
        """Take up the supports, ties and springs of a stage; pattern and factor are kept if they do not change."""
        led = -1 if terms.led is None else terms.led.dof
        springs = tuple(spring for spring, _ in terms.springs)
        ties = None if terms.ties is None else terms.ties.matrix
        kind = (led, springs)
        same = kind == self._kind and np.array_equal(terms.constrained, self.constrained) and _same(ties, self._ties)
        if self._tangent_matrix is not None and same:
            return
        self._kind, self._ties = kind, ties
        self.constrained = terms.constrained
        self._springs = sum((matrix for _, matrix in terms.springs[1:]), terms.springs[0][1]) if springs else None
        self.unknowns = unknowns_of(terms, self.space.ndofs)
        self._full[:] = 0.0
        self._tangent_matrix = self.unknowns.tangent(self.space if self.part is None else self.part, self._springs)
        self._solver.reset()

    def set_springs(self, offsets: Array) -> None:
        """Where springs have no force, as the start of the stage says; after `constrain`."""
        self._spring_offset = offsets.sum(axis=0) if len(offsets) else None
        if self._springs is not None or self._had_springs:
            self.refresh_internal_force()
        self._had_springs = self._springs is not None

    def factor_memory(self) -> FactorMemory:
        """What the linear solver remembers."""
        return self._solver.memory()

    def restore_factor(self, memory: FactorMemory) -> None:
        """Let the linear solver go on as if it had never stopped; after `constrain`.

        Raises
        ------
        FactorisationError
        """
        assert self._tangent_matrix is not None
        self._solver.restore(memory, self._tangent_matrix.matrix)

    def pattern_size(self) -> int:
        """Number of entries of the tangent matrix; after `constrain`."""
        assert self._tangent_matrix is not None
        return int(self._tangent_matrix.matrix.nnz)

    def worth_solving(self, right_hand_side: Array, external: Array) -> bool:
        """Whether a predicted residual is above what counts as equilibrium."""
        if not self.unknowns.count:
            return False
        scale = max(self.force_scale, norm(external))
        allowed = max(self.control.tolerance * scale, self.control.absolute_tolerance)
        return norm(right_hand_side) > allowed

    def linear_solve(self, right_hand_side: Array, tolerance: float, committed: bool, guess: Array | None) -> Array:
        """Solve with the exact tangent, of the last commit or of the last trial.

        Parameters
        ----------
        right_hand_side : ndarray, shape (nunknowns,)
        tolerance : float
            Relative residual.
        committed : bool
            Tangent of the last commit instead of the last trial.
        guess : ndarray, shape (nunknowns,), optional

        Raises
        ------
        FactorisationError
        """
        tangent = self.material.tangent_start if committed else self.material.tangent_end
        unknowns = self.unknowns

        def operator(x: Array) -> Array:
            # Products with D point by point cost about as much as with the assembled matrix, which takes ten times
            # as long to assemble; it is only made for a factorisation.
            unknowns.expand(x, self._full)
            return unknowns.reduce(self.action(tangent, self._full, self._product))

        def matrix() -> csr_matrix:
            assert self._tangent_matrix is not None
            self.accounting.matrix_assemblies += 1
            with self.accounting.phase("assembly"):
                return self._tangent_matrix.assemble(tangent)

        self.accounting.newton_iterations += 1
        return self._solver.solve(operator, matrix, right_hand_side, tolerance, guess)

    def start_scale(self, external: Array) -> None:
        """Begin a new stage: forget the force scale of the last one."""
        self.force_scale = 0.0
        self._raise_scale(external)

    def _raise_scale(self, external: Array) -> None:
        now = max(norm(self.internal_force), norm(external))
        self.force_scale = max(self.force_scale, now)

    def commit(self, displacement: Array, external: Array) -> None:
        """Accept the last trial, in equilibrium with the given external forces."""
        self.material.commit()
        with self.accounting.phase("state"):
            self.displacement[:] = displacement
            self.internal_force, self.internal_trial = self.internal_trial, self.internal_force
            self._raise_scale(external)


def _same(one: csr_matrix | None, other: csr_matrix | None) -> bool:
    if one is None or other is None:
        return one is other
    return one.shape == other.shape and one.nnz == other.nnz and abs(one - other).nnz == 0
