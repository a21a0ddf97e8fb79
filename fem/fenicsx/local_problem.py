"""The part of a problem that a rank owns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.contract import Law
from granfabric.fem.loads.bodies import Body
from granfabric.fem.loads.kinds import Stage
from granfabric.fem.loads.load_program import StageTerms
from granfabric.fem.loads.rigid import Contact
from granfabric.fem.loads.stage_forces import StageForces

from .distribution import Distribution

Array = NDArray[np.float64]

LARGEST_KEPT = 2
"""Forces that are kept, over the number of stages: what a control comes to is asked for again and again."""


@dataclass(frozen=True)
class LocalBody(Body):
    """The part of a body that a rank owns.

    Parameters
    ----------
    of_all : bool
        Whether the stage changes the body anywhere.
    """

    of_all: bool = False

    @property
    def changes(self) -> bool:
        """Whether the stage changes the body, on this rank or on another one."""
        return self.of_all


@dataclass(frozen=True)
class LocalTerms(StageTerms):
    """What a rank knows of a stage; numbers are those of what it owns.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    """

    comm: Any = None

    def lead(self, displacement: Array) -> tuple[Array, float]:
        """See `StageTerms.lead`; made by all ranks together, one of which may own what is led."""
        assert self.led is not None
        if self.led.tie >= 0:
            return super().lead(displacement)
        direction, here = np.zeros_like(displacement), 0.0
        if self.led.dof >= 0:
            direction[self.led.dof], here = 1.0, float(displacement[self.led.dof])
        return direction, float(self.comm.allreduce(here))


@dataclass
class LocalProgram:
    """What `LoadProgram` is for the own host. Rank 0 tells what rigid bodies and springs do, from all of them.

    Parameters
    ----------
    terms : list of StageTerms
    controlled : bool
    ask : callable
        Number of a stage and what controls have come to before it -> the nodal forces that this rank owns; called by
        all ranks together.
    """

    terms: list[StageTerms]
    controlled: bool
    ask: Callable[[int, tuple[float, ...]], StageForces]
    contacts: dict[str, Contact] = field(default_factory=dict)
    _found: dict[tuple[int, tuple[float, ...]], StageForces] = field(default_factory=dict)

    @property
    def spring_boundaries(self) -> list[str]:
        """Boundaries that have springs in some stage."""
        return list(dict.fromkeys(spring.boundary for terms in self.terms for spring, _ in terms.springs))

    def forces(self, index: int, factors: Sequence[float] = ()) -> StageForces:
        """Nodal forces of a stage, see `LoadProgram.forces`."""
        key = (index, tuple(factors)[:index])
        if key not in self._found:
            if len(self._found) > LARGEST_KEPT * len(self.terms):
                self._found.clear()
            self._found[key] = self.ask(*key)
        return self._found[key]


@dataclass(frozen=True)
class LocalProblem:
    """What `Problem` is for the own host, for what this rank owns.

    Parameters
    ----------
    space : Distribution
    law : Law
    stages : list of Stage
        Names, increments and what is placed; their loads are in `program`.
    program : LocalProgram
    initial_stress, initial_state : ndarray
    material_index : ndarray of int32, optional
    balance_initial_stress, starts_loaded : bool
    fills : dict of int to ndarray, shape (ndofs,)
        Forces of what a stage places, by its number.
    """

    space: Distribution
    law: Law
    stages: list[Stage]
    program: LocalProgram
    initial_stress: Array
    initial_state: Array
    material_index: NDArray[np.int32] | None
    balance_initial_stress: bool
    starts_loaded: bool
    fills: dict[int, Array]

    def law_of(self, index: int) -> Law:
        """The law in a stage, as `Problem.law_of` has it."""
        drained = self.stages[index].drained and hasattr(self.law, "drained")
        return self.law.drained() if drained else self.law  # type: ignore[attr-defined,no-any-return]

    def force_of_fill(self, index: int) -> Array:
        """See `Problem.force_of_fill`."""
        return self.fills[index] if index in self.fills else np.zeros(self.space.ndofs)
