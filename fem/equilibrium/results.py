"""What a run hands out: one record a load step, and a summary."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StageStart:
    """What a stage remembers of its beginning; with it a run can go on from any step.

    Parameters
    ----------
    displacement : ndarray, shape (ndofs,)
        At the start of the stage [m].
    fading : ndarray, shape (ndofs,)
        Nodal forces that fade to zero over the stage: released reactions, unbalanced initial stress [N/m].
    reference : ndarray, shape (ndofs,)
        Constant forces that balance the initial stress, if that was asked for [N/m].
    spring_offsets : ndarray, shape (nsprings, ndofs)
        For each of the stage's springs, stiffness times the displacement at which it has no force [N/m].
    load_factors : ndarray, shape (number of the stage,)
        What controls of the stages before have come to, 1 for stages without; empty if no stage has one.
    held : ndarray, shape (ndofs,), optional
        What is left at the end of the stage of the forces that excavated parts had exerted [N/m]; None without any.
    """

    displacement: Array
    fading: Array
    reference: Array
    spring_offsets: Array = field(default_factory=lambda: np.empty((0, 0)))
    load_factors: Array = field(default_factory=lambda: np.empty(0))
    held: Array | None = None


@dataclass(frozen=True)
class StepResult:
    """An accepted load step. All arrays are copies that the receiver may keep.

    Parameters
    ----------
    stage : str
    step : int
        Number of the step, counted from 1 over all stages.
    fraction : float
        Position within the stage, 1 at its end.
    displacement : ndarray, shape (ndofs,)
        x and y of node 0, of node 1, ... [m].
    reactions : dict of str to (float, float)
        Force of the supports on the body, summed over each named boundary [N/m].
    stress, strain : ndarray, shape (npt, 3)
        xx, yy, xy (strain: engineering), tension positive [Pa].
    state : ndarray, shape (npt, nstate)
    status : ndarray of int8, shape (npt,)
    iterations, factorisations, cuts : int
        Of this step, its abandoned attempts included.
    residuals : tuple of float
        Relative residual after each evaluation of the law in the accepted attempt.
    substeps : int
        Substeps of the law over all points in the accepted update.
    limited : int
        Points whose rates were clipped.
    next_increment : float
        Fraction of the stage that the next step will try.
    stage_start : StageStart
    load_factor : float
        Of the loads that follow the control of the stage; without one the position within the stage.
    rigid : dict of str to (float, ...)
        For each boundary that is tied to a rigid body in some stage: displacement of its point along x and y [m],
        rotation [rad], force of the body on the boundary along x and y [N/m], moment about the point [N m/m]; rotation
        and moment anticlockwise.
    springs : dict of str to (float, float)
        Force of the springs on the body, summed over each boundary that has some in some stage [N/m].
    active : ndarray of bool, shape (nelem,), optional
        Elements that are there, where stages change the body. Everything at a point of another one is zero.
    support : ndarray, shape (ndofs,), optional
        Nodal forces of the supports on the body, zero at free degrees of freedom [N/m].
    """

    stage: str
    step: int
    fraction: float
    displacement: Array
    reactions: dict[str, tuple[float, float]]
    stress: Array
    strain: Array
    state: Array
    status: NDArray[np.int8]
    iterations: int
    factorisations: int
    cuts: int
    residuals: tuple[float, ...]
    substeps: int
    limited: int
    next_increment: float
    stage_start: StageStart
    load_factor: float = 1.0
    rigid: dict[str, tuple[float, ...]] = field(default_factory=dict)
    springs: dict[str, tuple[float, float]] = field(default_factory=dict)
    active: NDArray[np.bool_] | None = None
    support: Array | None = None


@dataclass(frozen=True)
class FailedPoint:
    """Everything needed to replay a point that failed, alone.

    Parameters
    ----------
    point : int
    position : (float, float)
        [m].
    stress_start, strain_increment : ndarray, shape (3,)
    state_start : ndarray, shape (nstate,)
    material_index : int
    message : str
    """

    point: int
    position: tuple[float, float]
    stress_start: Array
    strain_increment: Array
    state_start: Array
    material_index: int
    message: str


@dataclass(frozen=True)
class RunSummary:
    """How a run ended.

    Parameters
    ----------
    finished : bool
        Whether all stages were completed.
    message : str
    stage : str
        Stage reached.
    fraction : float
        Position reached within it.
    solver : str
        Direct solver used.
    counters : dict of str to int
    seconds : dict of str to float
        Wall-clock time by phase, see `fem.accounting.Accounting`.
    failed_point : FailedPoint or None
        The point at which the last attempt failed, if it did at a point.
    band_fraction : float
        Area fraction in which the tangent of the end lets shear bands form, see `granfabric.fem.equilibrium.bands`.
    """

    finished: bool
    message: str
    stage: str
    fraction: float
    solver: str
    counters: dict[str, int] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    failed_point: FailedPoint | None = None
    band_fraction: float = 0.0
