"""The discrete system at its last commit, spread over the ranks."""

from __future__ import annotations

import importlib
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.contract import UpdateReport
from granfabric.fem.accounting import Accounting
from granfabric.fem.equilibrium.control import StepControl
from granfabric.fem.equilibrium.residual import Equilibrium
from granfabric.fem.equilibrium.unknowns import FreeUnknowns, Unknowns, free_dofs
from granfabric.fem.linear_solvers.tangent import FactorMemory
from granfabric.fem.loads.load_program import StageTerms
from granfabric.fem.vectors import dot

from .forces import DistributedForces
from .kept_factor import KeptFactor
from .local_problem import LocalProblem
from .material import DistributedMaterial
from .part import LocalPart
from .springs import SpringSum
from .ties import DistributedUnknowns

Array = NDArray[np.float64]


def unknowns_of(terms: StageTerms, ndofs: int) -> Unknowns:
    """What `granfabric.fem.equilibrium.unknowns.unknowns_of` is for the own host."""
    free = free_dofs(terms, ndofs)
    if terms.ties is None:
        return FreeUnknowns(free)
    ties: Any = terms.ties
    return DistributedUnknowns(free, ties)


class DistributedEquilibrium(Equilibrium):
    """What `Equilibrium` is for the own host; vectors hold the degrees of freedom that this rank owns.

    Parameters
    ----------
    problem : LocalProblem
    control : StepControl
    accounting : Accounting
    """

    def __init__(self, problem: LocalProblem, control: StepControl, accounting: Accounting) -> None:
        distribution = problem.space
        self._problem = problem  # type: ignore[assignment]
        self._comm = distribution.comm
        self.space = distribution  # type: ignore[assignment]
        self.control = control
        self.accounting = accounting
        self._forces = DistributedForces(distribution)
        self.forces = self._forces  # type: ignore[assignment]
        self._known = False
        body = problem.program.terms[0].body
        part = None if body is None else self.part_of(body.active)
        self.enter(part, problem.initial_stress, problem.initial_state, None)
        ndofs = distribution.ndofs
        self.displacement, self.internal_force = np.zeros(ndofs), np.zeros(ndofs)
        self.internal_trial, self.scratch = np.zeros(ndofs), np.zeros(ndofs)
        self.constrained = np.empty(0, dtype=np.int64)
        self.unknowns: Unknowns = FreeUnknowns(self.constrained)
        self._tied: Any = None
        self._spring_sum: SpringSum | None = None
        self._springs = self._spring_offset = None
        self._had_springs = False
        self._kept = KeptFactor(self._comm, accounting, control.keep_factor)
        self._matrix: Any = None
        self._transformation: Any = None
        self._transformed: Any = None
        self._held = np.zeros(ndofs, dtype=bool)
        self._conditions: list[Any] = []
        self.force_scale = 0.0
        self.refresh_internal_force()

    @property
    def solver_name(self) -> str:
        return self._kept.name

    def norm(self, vector: Array) -> float:
        return math.sqrt(self._comm.allreduce(dot(vector, vector)))

    def dot(self, first: Array, second: Array) -> float:
        return float(self._comm.allreduce(dot(first, second)))

    def any(self, vector: Array) -> bool:
        return bool(self._comm.allreduce(int(vector.any())))

    def part_of(self, active: NDArray[np.bool_]) -> Any:
        return LocalPart(self.space, active)  # type: ignore[arg-type]

    def enter(self, part: Any, stress: Array, state: Array, strain: Array | None) -> None:
        rows = self._problem.material_index
        if part is not None:
            stress, state = stress[part.points], state[part.points]
            strain = None if strain is None else strain[part.points]
            rows = None if rows is None else rows[part.points]
        self.part = part
        self._forces.enter(part, self.space)  # type: ignore[arg-type]
        self.material = DistributedMaterial(
            self._comm, self._problem.law, self._forces, stress, state, self.accounting, strain, rows
        )
        self._known = False

    def worst(self, report: UpdateReport) -> tuple[int, str]:
        return report.worst_point, report.message  # whose number is that on rank 0

    def constrain(self, terms: StageTerms) -> None:
        springs = tuple(spring for spring, _ in terms.springs)
        led = -1 if terms.led is None else terms.led.dof
        kind = (led, springs)
        ties: Any = terms.ties
        same = self._known and kind == self._kind and np.array_equal(terms.constrained, self.constrained)
        same = same and (ties is None) == (self._tied is None) and (ties is None or ties.same(self._tied))
        if self._comm.allreduce(int(not same)) == 0:
            return
        self._known, self._kind, self._tied = True, kind, ties
        self.constrained = terms.constrained
        self._spring_sum = SpringSum([matrix for _, matrix in terms.springs]) if springs else None  # type: ignore[misc]
        self._springs = self._spring_sum  # type: ignore[assignment]
        self.unknowns = unknowns_of(terms, self.space.ndofs)
        if isinstance(self.unknowns, DistributedUnknowns):
            self._held[:] = False
            self._conditions = []
            petsc = importlib.import_module("petsc4py.PETSc")
            self._transformation = self.unknowns.transformation(self._comm, petsc, self.space.ndofs)
            self._transformed = None
            self._kept.reset(np.zeros(self.unknowns.count, dtype=bool))
        else:
            self._held[:] = True
            self._held[self.unknowns.free] = False  # type: ignore[attr-defined]
            self._conditions = self._prescribed(self._held)
            self._transformation = None
            self._kept.reset(self._held.copy())

    def _prescribed(self, mask: NDArray[np.bool_]) -> list[Any]:
        """dolfinx's conditions, of ghosts too; only which degrees of freedom they hold matters."""
        fem = importlib.import_module("dolfinx.fem")
        space = self.space.displacements  # type: ignore[attr-defined]
        told = fem.Function(space)
        told.x.array[: len(mask)] = mask
        told.x.scatter_forward()
        held = np.flatnonzero(told.x.array > 0.5).astype(np.int32)
        conditions = []
        for component in range(2):
            dofs = held[held % 2 == component]
            conditions.append(fem.dirichletbc(np.float64(0.0), dofs, space.sub(component)))
        return conditions

    def factor_memory(self) -> FactorMemory:
        return FactorMemory()  # made anew where a run goes on

    def restore_factor(self, memory: FactorMemory) -> None:
        return

    def pattern_size(self) -> int:
        return 0

    def worth_solving(self, right_hand_side: Array, external: Array) -> bool:
        if not self._comm.allreduce(self.unknowns.count):
            return False
        scale = max(self.force_scale, self.norm(external))
        allowed = max(self.control.tolerance * scale, self.control.absolute_tolerance)
        return self.norm(right_hand_side) > allowed

    def linear_solve(self, right_hand_side: Array, tolerance: float, committed: bool, guess: Array | None) -> Array:
        material, unknowns = self.material, self.unknowns
        self._forces.set_tangent(material.tangent_start if committed else material.tangent_end)
        self.accounting.newton_iterations += 1
        size = self.norm(right_hand_side)
        if isinstance(unknowns, DistributedUnknowns):

            def action(x: Array) -> Array:
                return unknowns.reduce(self._action(unknowns.expand(x, self.scratch)))

            return self._kept.solve(action, self._assemble, right_hand_side, size, tolerance, guess)
        full = unknowns.expand(right_hand_side, np.zeros(self.space.ndofs))
        begin = None if guess is None else unknowns.expand(guess, np.zeros(self.space.ndofs))
        return unknowns.reduce(self._kept.solve(self._action, self._assemble, full, size, tolerance, begin))

    def _action(self, displacement: Array) -> Array:
        force = self._forces.action(displacement)
        return force if self._spring_sum is None else force + self._spring_sum @ displacement

    def _assemble(self) -> Any:
        petsc = importlib.import_module("dolfinx.fem.petsc")
        form = self._forces.tangent_form
        self.accounting.matrix_assemblies += 1
        with self.accounting.phase("assembly"):
            if self._matrix is None:
                self._matrix = petsc.create_matrix(form)
            self._matrix.zeroEntries()
            petsc.assemble_matrix(self._matrix, form, bcs=self._conditions)
            self._matrix.assemble()
            if self._spring_sum is not None:
                self._spring_sum.add_to(self._matrix, self.space.first_dof, self._held)  # type: ignore[attr-defined]
            if self._transformation is None:
                return self._matrix
            # springs' columns and new stages leave the pattern as it is
            self._transformed = self._matrix.ptap(self._transformation, result=self._transformed)
        return self._transformed

    def _raise_scale(self, external: Array) -> None:
        self.force_scale = max(self.force_scale, self.norm(self.internal_force), self.norm(external))
