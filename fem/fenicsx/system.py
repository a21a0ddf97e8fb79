"""The discrete system at its last commit, spread over the ranks."""

from __future__ import annotations

import importlib
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.accounting import Accounting
from granfabric.fem.equilibrium.control import StepControl
from granfabric.fem.equilibrium.residual import Equilibrium
from granfabric.fem.equilibrium.unknowns import FreeUnknowns
from granfabric.fem.linear_solvers.tangent import FactorMemory
from granfabric.fem.loads.load_program import StageTerms
from granfabric.fem.vectors import dot

from .forces import DistributedForces
from .kept_factor import KeptFactor
from .local_problem import LocalProblem
from .material import DistributedMaterial

Array = NDArray[np.float64]


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
        self._comm = distribution.comm
        self.part = None  # stages that change the body are refused
        self.space = distribution  # type: ignore[assignment]
        self.control = control
        self.accounting = accounting
        forces = DistributedForces(distribution)
        self.forces = forces  # type: ignore[assignment]
        self.material = DistributedMaterial(
            self._comm, problem.law, forces, problem.initial_stress, problem.initial_state, accounting,
            problem.material_index,
        )  # fmt: skip
        ndofs = distribution.ndofs
        self.displacement, self.internal_force = np.zeros(ndofs), np.zeros(ndofs)
        self.internal_trial, self.scratch = np.zeros(ndofs), np.zeros(ndofs)
        self.free = self.constrained = np.empty(0, dtype=np.int64)
        self.unknowns = FreeUnknowns(self.free)
        self._springs = self._spring_offset = None  # `divide` refuses them
        self._had_springs = False
        self._known = False
        self._kept = KeptFactor(self._comm, ndofs, accounting, control.keep_factor)
        self._matrix: Any = None
        self._conditions: list[Any] = []
        self.force_scale = 0.0
        self.refresh_internal_force()

    @property
    def solver_name(self) -> str:
        return self._kept.name

    def norm(self, vector: Array) -> float:
        return math.sqrt(self._comm.allreduce(dot(vector, vector)))

    def any(self, vector: Array) -> bool:
        return bool(self._comm.allreduce(int(vector.any())))

    def constrain(self, terms: StageTerms) -> None:
        constrained = terms.constrained
        same = self._known and np.array_equal(constrained, self.constrained)
        if self._comm.allreduce(int(not same)) == 0:
            return
        self._known = True
        self.constrained = constrained
        mask = np.zeros(self.space.ndofs, dtype=bool)
        mask[constrained] = True
        self.free = np.flatnonzero(~mask)
        self.unknowns = FreeUnknowns(self.free)
        self._conditions = self._prescribed(mask)
        self._kept.reset(mask)

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
        if not self._comm.allreduce(len(self.free)):
            return False
        scale = max(self.force_scale, self.norm(external))
        allowed = max(self.control.tolerance * scale, self.control.absolute_tolerance)
        return self.norm(right_hand_side) > allowed

    def linear_solve(self, right_hand_side: Array, tolerance: float, committed: bool, guess: Array | None) -> Array:
        material, free = self.material, self.free
        forces: Any = self.forces
        forces.set_tangent(material.tangent_start if committed else material.tangent_end)
        full, begin = np.zeros(self.space.ndofs), None
        full[free] = right_hand_side
        if guess is not None:
            begin = np.zeros(self.space.ndofs)
            begin[free] = guess
        self.accounting.newton_iterations += 1
        size = self.norm(right_hand_side)
        return self._kept.solve(forces.action, self._assemble, full, size, tolerance, begin)[free]

    def _assemble(self) -> Any:
        petsc = importlib.import_module("dolfinx.fem.petsc")
        form = self.forces.tangent_form  # type: ignore[attr-defined]
        self.accounting.matrix_assemblies += 1
        with self.accounting.phase("assembly"):
            if self._matrix is None:
                self._matrix = petsc.create_matrix(form)
            self._matrix.zeroEntries()
            petsc.assemble_matrix(self._matrix, form, bcs=self._conditions)
            self._matrix.assemble()
        return self._matrix

    def _raise_scale(self, external: Array) -> None:
        self.force_scale = max(self.force_scale, self.norm(self.internal_force), self.norm(external))
