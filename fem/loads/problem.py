"""A boundary-value problem: space, law, stages and initial conditions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from granfabric.constitutive.contract import Law
from granfabric.fem.discretisation.space import Space

from .kinds import INITIAL, LoadError, Stage
from .load_program import LoadProgram

Array = NDArray[np.float64]


class Problem:
    """Everything that a run needs to know, checked.

    Initial stress and loads at the start. If the first stage is named "initial", its loads act from the outset at full
    value and should balance the initial stress; what they do not balance fades out linearly over that stage, so that
    its end is in equilibrium with its loads alone. Without such a stage the whole imbalance of the initial stress fades
    out over the first stage. With ``balance_initial_stress=True`` constant reference forces balance the initial stress
    (together with the loads of an "initial" stage) throughout the run instead, as if the initial stress had been there
    before anything was measured.

    Parameters
    ----------
    space : Space
    law : Law
    stages : sequence of Stage
    initial_stress : array_like, shape (3,) or (npt, 3), optional
        xx, yy, xy, tension positive [Pa]; zero if not given.
    material_index : array_like of int, shape (npt,), optional
        Row of the law's parameter table for each point.
    initial_state : array_like, shape (npt, nstate), optional
        Asked of the law if not given.
    balance_initial_stress : bool

    Raises
    ------
    LoadError
        If the stages contradict each other or an array has the wrong shape.
    MeshError
        If a load names something that the mesh does not have.
    """

    def __init__(
        self,
        space: Space,
        law: Law,
        stages: Sequence[Stage],
        initial_stress: ArrayLike | None = None,
        material_index: ArrayLike | None = None,
        initial_state: ArrayLike | None = None,
        balance_initial_stress: bool = False,
    ) -> None:
        self.space = space
        self.law = law
        self.stages = list(stages)
        self.program = LoadProgram(space, self.stages)
        self.balance_initial_stress = balance_initial_stress
        stress = np.zeros(3) if initial_stress is None else np.asarray(initial_stress, dtype=np.float64)
        if stress.shape not in ((3,), (space.npoints, 3)) or not np.isfinite(stress).all():
            raise LoadError(
                f"the initial stress must be finite and of shape (3,) or ({space.npoints}, 3), not {stress.shape}"
            )
        self.initial_stress: Array = np.array(np.broadcast_to(stress, (space.npoints, 3)), order="C")
        self.material_index: NDArray[np.int32] | None = None
        if material_index is not None:
            self.material_index = np.ascontiguousarray(material_index, dtype=np.int32)
            if self.material_index.shape != (space.npoints,):
                raise LoadError(f"the material index must have shape ({space.npoints},)")
        nstate = law.description.nstate
        if initial_state is None:
            state = law.initial_state(self.initial_stress, self.material_index)
        else:
            state = np.array(initial_state, dtype=np.float64)
        if state.shape != (space.npoints, nstate):
            raise LoadError(f"the initial state must have shape ({space.npoints}, {nstate}), not {state.shape}")
        self.initial_state: Array = np.ascontiguousarray(state)

    @property
    def starts_loaded(self) -> bool:
        """Whether the loads of the first stage act from the outset."""
        return self.stages[0].name == INITIAL
