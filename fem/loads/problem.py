"""A boundary-value problem: space, law, stages and initial conditions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from granfabric.constitutive.arrays import ArrayError, finite, found, index
from granfabric.constitutive.contract import Law
from granfabric.fem.discretisation.space import Space

from .fills import force_of_fill, refuse_unbearable, stress_with_fills
from .kinds import INITIAL, LoadError, Stage
from .load_program import LoadProgram
from .supports import refuse_loose_bodies

Array = NDArray[np.float64]


class Problem:
    """Everything that a run needs to know, checked.

    Initial stress and loads at the start. If the first stage is named "initial", its loads act from the outset at full
    value and should balance the initial stress; what they do not balance fades out linearly over that stage, so that
    its end is in equilibrium with its loads alone. Without such a stage the whole imbalance of the initial stress fades
    out over the first stage. With ``balance_initial_stress=True`` constant reference forces balance the initial stress
    (together with the loads of an "initial" stage) throughout the run instead, as if the initial stress had been there
    before anything was measured.

    Where stages change the body (`Stage.activate`, `Stage.deactivate`), initial stress and state are those of the body
    at the outset; what comes later is placed under the pressure of its stage, with the initial state of its material.

    Parameters
    ----------
    space : Space
    law : Law
    stages : sequence of Stage
    initial_stress : array_like, shape (3,) or (npt, 3), optional
        xx, yy, xy, tension positive [Pa]; zero if not given.
    material_index : array_like of int or bool, shape (npt,), optional
        Row of the law's parameter table for each point.
    initial_state : array_like, shape (npt, nstate), optional
        Asked of the law if not given.
    balance_initial_stress : bool

    Raises
    ------
    LoadError
        If the stages contradict each other, an array has the wrong shape, or one of several bodies is not held.
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
        self._drained: Law = law.drained() if hasattr(law, "drained") else law
        self.stages = list(stages)
        self.program = LoadProgram(space, self.stages)
        refuse_loose_bodies(space, self.program.terms)
        self.balance_initial_stress = balance_initial_stress
        self.initial_stress = _initial_stress(initial_stress, space.npoints)
        if self.changes_body:
            if balance_initial_stress:
                raise LoadError(
                    "constant reference forces that balance the initial stress do not tell which part of the body they "
                    "belong to; where stages change the body, loads and supports have to balance it"
                )
            self.initial_stress = stress_with_fills(space, self.stages, self.initial_stress)
        nstate = law.description.nstate
        self.material_index: NDArray[np.int32] | None = None
        try:
            if material_index is not None:
                # a question of yes or no, as it is asked of places, chooses between two
                chosen = np.asarray(material_index, dtype=np.int32) if _is_mask(material_index) else material_index
                # how many rows there are only the law knows, which refuses others
                self.material_index = index("the material index", chosen, space.npoints, 2**31)
            if initial_state is None:
                state = law.initial_state(self.initial_stress, self.material_index)
            else:
                state = finite("the initial state", initial_state, (space.npoints, nstate)).copy()
        except ArrayError as error:
            raise LoadError(str(error)) from None
        if state.shape != (space.npoints, nstate):
            raise LoadError(f"the initial state must have shape ({space.npoints}, {nstate}), not {state.shape}")
        self.initial_state: Array = np.ascontiguousarray(state)
        if self.changes_body:
            refuse_unbearable(self)

    @property
    def changes_body(self) -> bool:
        """Whether a stage takes something away or adds something."""
        return self.program.terms[0].body is not None

    def law_of(self, index: int) -> Law:
        """The law in a stage: the problem's own, or what that is while water can leave."""
        return self._drained if self.stages[index].drained else self.law

    def force_of_fill(self, index: int) -> Array:
        """Forces of the pressure under which a stage places what it adds to the body, shape (ndofs,) [N/m]."""
        return force_of_fill(self, index)

    @property
    def starts_loaded(self) -> bool:
        """Whether the loads of the first stage act from the outset."""
        return self.stages[0].name == INITIAL


def _is_mask(given: ArrayLike) -> bool:
    return isinstance(given, np.ndarray) and given.dtype == np.bool_ and not isinstance(given, np.ma.MaskedArray)


def _initial_stress(given: ArrayLike | None, npoints: int) -> Array:
    """Stress of every point, shape (npt, 3), from that of all or of each; zero if None."""
    stress = np.zeros(3) if given is None else given
    try:
        if np.shape(stress) == (3,):
            return np.tile(finite("the initial stress", stress, (3,)), (npoints, 1))
        return finite("the initial stress", stress, (npoints, 3)).copy()
    except ValueError:
        raise LoadError(
            f"the initial stress must be finite and of shape (3,) or ({npoints}, 3), not {found(stress)}"
        ) from None
