"""What a point law promises its host, and what the host promises the law.

The whole boundary between material and solver:

* One call advances all integration points: stress, state and (if asked) tangent together.
* Arrays are point-major, C-contiguous float64: strain and stress ``(npt, 3)`` in the order xx, yy, xy, state
  ``(npt, nstate)``, tangent ``(npt, 3, 3)``. Tension is positive. The shear strain is the engineering one
  (gamma_xy = 2 eps_xy), the shear stress the tensor component.
* Start-of-step arrays are never written. End-of-step arrays are always written, also when a point fails (then with
  its start values), so that nothing uninitialised can leak. The host commits by swapping, reverts by not swapping.
* Nothing else is remembered: the same increment may be asked again and again. A zero increment changes nothing and
  returns the tangent.
* What is handed over is checked before a kernel sees it (`arrays`): a wrong shape, kind, index or code is a ValueError,
  and so is an array to be written that is read-only or shares memory with another one. Arrays that are only read may
  be anything that turns into such an array; read-only, strided or of other numbers they are copied.
* No exception leaves a kernel. Each point has a status; the report names the worst point and a step factor.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TangentKind = Literal["propagated", "continuum", "elastic"]


class Status(IntEnum):
    """Outcome of one point. Up to `LIMITED` the end values are valid; beyond, the point has failed."""

    OK = 0
    LIMITED = 1
    NO_PRESSURE = 2
    NOT_ADMISSIBLE = 3
    STIFFNESS_LOST = 4
    TOO_MANY_SUBSTEPS = 5
    NOT_FINITE = 6
    NOT_CONVERGED = 7
    BEYOND_PEAK = 8


STATUS_TEXT: dict[Status, str] = {
    Status.OK: "updated",
    Status.LIMITED: "updated, with rates clipped at the limit of realisability",
    Status.NO_PRESSURE: "the mean pressure falls to the floor below which grains carry no stress; try a smaller step, "
    "more confinement or an effect that bounds the stress ratio",
    Status.NOT_ADMISSIBLE: "the coordination number or the fabric anisotropy would leave its admissible range; "
    "try a smaller step or the maximum-entropy distribution",
    Status.STIFFNESS_LOST: "the stiffness is no longer positive definite in this state (an isostatic one ends "
    "where z comes to isostatic_coordination); try a smaller step",
    Status.TOO_MANY_SUBSTEPS: "the error tolerance was not met within the allowed number of substeps; "
    "try a smaller step or a looser tolerance",
    Status.NOT_FINITE: "the input holds a value that is not finite, or one so large that the result is not",
    Status.NOT_CONVERGED: "the local equations did not converge; try a smaller step",
    Status.BEYOND_PEAK: "the stress is outside the cone of sliding or shall pass its peak stress ratio, which no "
    "strain can reach; prescribe strain in at least one component, or a smaller stress ratio",
}


@dataclass(frozen=True)
class Variable:
    """One named quantity of a law: a state variable or a parameter.

    Parameters
    ----------
    name : str
        Field name, also the column and array name in files.
    meaning : str
        One line for documentation.
    unit : str
        SI unit, "-" if none.
    components : int
        1 for a scalar, 2 for a vector in the double-angle plane (cos 2 theta, sin 2 theta), 3 for xx, yy, xy.
    lower, upper : float
        Physical bounds; a value outside is refused at input.
    default : float or None
        Initial value (state) or default (parameter); None if the user has to give it.
    hidden : bool
        Columns of a state that mean nothing one by one: writers and pictures pass over them.
    """

    name: str
    meaning: str
    unit: str = "-"
    components: int = 1
    lower: float = -np.inf
    upper: float = np.inf
    default: float | None = None
    hidden: bool = False


@dataclass(frozen=True)
class LawDescription:
    """A law as data: read by writers, drivers, schema and docs.

    Parameters
    ----------
    name : str
    state, parameters : tuple of Variable
    linear_response : bool
        The law promises ``stress_end = stress_start + C strain_increment`` with the elastic stiffness C of the initial
        state, whatever its state does. A host may then solve for displacements first and ask for states afterwards.
    """

    name: str
    state: tuple[Variable, ...]
    parameters: tuple[Variable, ...]
    linear_response: bool = False

    @property
    def nstate(self) -> int:
        """Number of state columns."""
        return sum(variable.components for variable in self.state)

    def columns(self, name: str) -> slice:
        """State columns of the named variable.

        Raises
        ------
        KeyError
            If the law has no such state variable.
        """
        start = 0
        for variable in self.state:
            if variable.name == name:
                return slice(start, start + variable.components)
            start += variable.components
        raise KeyError(name)

    def has_state(self, name: str) -> bool:
        """Whether the law carries the named state variable."""
        return any(variable.name == name for variable in self.state)


@dataclass(frozen=True)
class UpdateReport:
    """What happened in one call.

    Parameters
    ----------
    status : ndarray of int8, shape (npt,)
        `Status` of each point.
    substeps : ndarray of int32, shape (npt,)
        Accepted substeps of each point.
    rejected : ndarray of int32, shape (npt,)
        Rejected substeps of each point.
    proposed_step_factor : float
        Fraction of this increment worth trying next, smallest over the points: below 1 after a failure, else 1 or
        more.
    evaluations : ndarray of int32, shape (npt,), optional
        Evaluations of the rates for each point, those of rejected substeps included; None if the law has no rates.
    """

    status: NDArray[np.int8]
    substeps: NDArray[np.int32]
    rejected: NDArray[np.int32]
    proposed_step_factor: float = 1.0
    evaluations: NDArray[np.int32] | None = None

    @property
    def failed(self) -> int:
        """Number of failed points."""
        return int(np.count_nonzero(self.status > Status.LIMITED))

    @property
    def limited(self) -> int:
        """Number of points whose rates were clipped at the limit of realisability."""
        return int(np.count_nonzero(self.status == Status.LIMITED))

    @property
    def worst_point(self) -> int:
        """Index of the first point with the gravest status; -1 if there are no points."""
        return int(np.argmax(self.status)) if self.status.size else -1

    @property
    def message(self) -> str:
        """One sentence on the worst point."""
        if not self.status.size:
            return "no points"
        worst = Status(int(self.status[self.worst_point]))
        return f"point {self.worst_point}: {STATUS_TEXT[worst]}"


@runtime_checkable
class Law(Protocol):
    """What the host calls. Implementations: linear elastic, von Mises, granular contact gain/loss."""

    @property
    def description(self) -> LawDescription:
        """The law as data."""
        ...

    def initial_state(self, stress: Array, material_index: NDArray[np.int32] | None = None) -> Array:
        """State of points under the given stress before any loading.

        Parameters
        ----------
        stress : ndarray, shape (npt, 3)
            Initial stress, tension positive [Pa].
        material_index : ndarray of int32, shape (npt,), optional
            Row of the law's parameter table for each point; zero everywhere if not given.

        Returns
        -------
        ndarray, shape (npt, nstate)
        """
        ...

    def update(
        self,
        strain_increment: Array,
        stress_start: Array,
        state_start: Array,
        stress_end: Array,
        state_end: Array,
        tangent: Array | None = None,
        tangent_kind: TangentKind = "propagated",
        material_index: NDArray[np.int32] | None = None,
    ) -> UpdateReport:
        """Advance all points by a strain increment (strain-driven).

        Parameters
        ----------
        strain_increment : ndarray, shape (npt, 3)
            xx, yy, engineering xy; tension positive.
        stress_start, state_start : ndarray, shapes (npt, 3), (npt, nstate)
            Read only.
        stress_end, state_end : ndarray, shapes (npt, 3), (npt, nstate)
            Written.
        tangent : ndarray, shape (npt, 3, 3), optional
            Written if given: d stress_end / d strain_increment [Pa].
        tangent_kind : {"propagated", "continuum", "elastic"}
            Exact derivative of the discrete update; tangent of the rate equations at the end state; elastic stiffness
            of the start state.
        material_index : ndarray of int32, shape (npt,), optional
            As in `initial_state`.
        """
        ...
