"""Newton's method for one load step.

The law is never evaluated where only the boundary has moved: the first correction comes from the residual at the last
commit plus the last converged tangent times the movement of the boundary. A point that fails, a residual that does not
fall along the correction, and the iteration limit all end the step as not converged; nothing is committed here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.linear_solvers.direct import FactorisationError

if TYPE_CHECKING:
    from .residual import Equilibrium

Array = NDArray[np.float64]

# The residual counts as zero below this multiple of the rounding of its own sums.
ROUNDING_MULTIPLE = 20.0
# Line search: the factor of one cut, and how often.
LINE_SEARCH_CUT = 0.5
LINE_SEARCH_LIMIT = 5
# Forcing terms (relative tolerance of a linear solve) after Eisenstat & Walker 1996, SIAM J. Sci. Comput. 17, 16,
# choice 2 with exponent 2; the linear solve costs less than a call of the law, hence the small upper bound.
FORCING_FACTOR = 0.9
LARGEST_FORCING = 1e-2
PREDICTOR_FORCING = 1e-3
SMALLEST_FORCING = 1e-12
# No linear solve beyond this fraction of the residual that is still allowed.
ENOUGH = 0.3


@dataclass
class StepOutcome:
    """Result of an attempt at one load step.

    Parameters
    ----------
    converged : bool
    reason : str
        One sentence if not converged.
    displacement : ndarray, shape (ndofs,)
        Last iterate.
    internal_force : ndarray, shape (ndofs,)
    iterations : int
        Linear solves, the predictor included.
    residuals : list of float
        Relative residual after each evaluation of the law.
    proposed_factor : float
        Fraction of the increment worth trying next if not converged.
    failed_point : int
        Point whose law failed; -1 if none did.
    load_factor : float
        Of the last iterate, if a control leads a displacement.
    """

    converged: bool
    reason: str
    displacement: Array
    internal_force: Array
    iterations: int = 0
    residuals: list[float] = field(default_factory=list)
    proposed_factor: float = 0.5
    failed_point: int = -1
    load_factor: float = 0.0


@dataclass
class Evaluation:
    """Residual of a trial, its norm, and what it is compared with."""

    residual: Array
    norm: float
    scale: float
    floor: float

    def allowed(self, tolerance: float) -> float:
        """Norm at which a step has converged."""
        return max(tolerance * self.scale, self.floor)

    @property
    def relative(self) -> float:
        """Norm over the force scale."""
        return self.norm / self.scale if self.scale > 0 else 0.0


def evaluate(
    system: Equilibrium, displacement: Array, external: Array, direction: Array | None = None
) -> tuple[Evaluation | None, str, float, int]:
    """Residual at a trial displacement; None if a point failed, with message, proposed factor and point.

    With a direction, shape (ndofs,), in which a control leads, the forces along it count as well.
    """
    report = system.material.update(displacement, system.displacement, system.control.tangent_kind)
    if report.failed:
        point, message = system.worst(report)
        return None, message, report.proposed_step_factor, point
    with system.accounting.phase("assembly"):
        system.internal(displacement, system.internal_trial)
        residual = system.unknowns.reduce(external - system.internal_trial)
        size = system.norm(residual)
        if direction is not None:
            size = float(np.hypot(size, system.dot(direction, external - system.internal_trial)))
        scale = max(system.force_scale, system.norm(system.internal_trial), system.norm(external))
        rounding = np.finfo(np.float64).eps * system.norm(system.forces.magnitude)
        floor = max(system.control.absolute_tolerance, ROUNDING_MULTIPLE * rounding)
    if not np.isfinite(size):
        return None, "the residual is not finite", 0.5, -1
    return Evaluation(residual, size, scale, floor), "", 1.0, -1


def newton_step(
    system: Equilibrium, prescribed: Array, external: Array, guess: Array | None, carried: Array | None = None
) -> StepOutcome:
    """Find equilibrium at the end of a load step.

    The step has converged when the Euclidean norm of the residual on the free degrees of freedom is at most
    ``tolerance`` times the force scale, or below an absolute floor: ``absolute_tolerance`` or a small multiple of the
    rounding error of the nodal sums. The force scale is the largest norm of internal (reactions included) or external
    nodal forces, now or at an earlier step of the stage, so that loads may fade to zero.

    Parameters
    ----------
    system : Equilibrium
        At the last commit; its trial buffers hold the result.
    prescribed : ndarray, shape (nconstrained,)
        Displacements of the constrained degrees of freedom at the end of the step [m].
    external : ndarray, shape (ndofs,)
        Nodal forces at the end of the step [N/m].
    guess : ndarray, shape (nunknowns,), optional
        Estimate of the increment, start of the predictor's linear solve.
    carried : ndarray, shape (ndofs,), optional
        What rigid bodies with a prescribed motion move in this step [m].

    Returns
    -------
    StepOutcome
    """
    control, unknowns = system.control, system.unknowns
    displacement = system.displacement.copy()
    outcome = StepOutcome(False, "", displacement, system.internal_trial)
    with system.accounting.phase("boundary"):
        moved = np.zeros_like(displacement)
        moved[system.constrained] = prescribed - displacement[system.constrained]
        if carried is not None:
            moved += carried
        right_hand_side = unknowns.reduce(external - system.internal_force)
        if system.any(moved):
            right_hand_side -= unknowns.reduce(system.action(system.material.tangent_start, moved, system.scratch))
            displacement += moved
    try:
        if system.worth_solving(right_hand_side, external):
            forcing = PREDICTOR_FORCING if control.forcing is None else control.forcing
            correction = system.linear_solve(right_hand_side, forcing, committed=True, guess=guess)
            outcome.iterations += 1
            unknowns.add(displacement, correction)
        current, message, factor, point = evaluate(system, displacement, external)
        if current is None:
            outcome.reason, outcome.proposed_factor, outcome.failed_point = message, factor, point
            return outcome
        outcome.residuals.append(current.relative)
        before = max(system.norm(right_hand_side), current.norm)
        while current.norm > current.allowed(control.tolerance):
            if outcome.iterations >= control.maximum_iterations:
                outcome.reason = (
                    f"no equilibrium within {control.maximum_iterations} iterations (relative residual "
                    f"{current.relative:.1e}, wanted {control.tolerance:.1e})"
                )
                return outcome
            forcing = next_forcing(control.forcing, current, before, control.tolerance)
            correction = system.linear_solve(current.residual, forcing, committed=False, guess=None)
            outcome.iterations += 1
            before = current.norm
            found, failure = _line_search(system, displacement, correction, external, before)
            if found is None:
                outcome.reason, outcome.proposed_factor, outcome.failed_point = failure
                return outcome
            current = found
            outcome.residuals.append(current.relative)
    except FactorisationError as error:
        outcome.reason = f"the tangent cannot be solved: {error}"
        return outcome
    outcome.converged = True
    return outcome


def next_forcing(fixed: float | None, current: Evaluation, before: float, tolerance: float) -> float:
    """Relative tolerance of the next linear solve."""
    if fixed is not None:
        return fixed
    forcing = FORCING_FACTOR * (current.norm / before) ** 2
    enough = ENOUGH * current.allowed(tolerance) / current.norm
    return max(min(forcing, LARGEST_FORCING), min(enough, LARGEST_FORCING), SMALLEST_FORCING)


def _line_search(
    system: Equilibrium, displacement: Array, correction: Array, external: Array, before: float
) -> tuple[Evaluation | None, tuple[str, float, int]]:
    """Shorten the correction until the residual falls; `displacement` is moved to the accepted iterate."""
    start = displacement.copy()
    length = 1.0
    no_descent = ("the residual does not fall along Newton's correction", 0.5, -1)
    failure = no_descent
    for attempt in range(LINE_SEARCH_LIMIT + 1):
        if attempt:
            system.accounting.line_searches += 1
        displacement[:] = start
        system.unknowns.add(displacement, length * correction)
        evaluation, message, factor, point = evaluate(system, displacement, external)
        if evaluation is not None and (
            evaluation.norm < before or evaluation.norm <= evaluation.allowed(system.control.tolerance)
        ):
            return evaluation, failure
        failure = no_descent if evaluation is not None else (message, factor, point)
        length *= LINE_SEARCH_CUT
    return None, failure
