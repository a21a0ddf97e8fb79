"""Newton's method for one load step in which a control leads a displacement and the load factor is an unknown.

The led displacement is taken out of the unknowns, so that the matrix that is factorised stays positive definite past a
peak of the load, where that of all unknowns is not. With x the solution for the residual and x_P that for the loads
that follow, the equation of the led displacement gives the change of the load factor (bordered solve): two solves with
one factor, one where the loads that follow act on the led displacement alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from granfabric.fem.linear_solvers.direct import FactorisationError
from granfabric.fem.vectors import Array

from .newton import (
    LINE_SEARCH_CUT,
    LINE_SEARCH_LIMIT,
    PREDICTOR_FORCING,
    StepOutcome,
    evaluate,
    next_forcing,
)
from .residual import Equilibrium

# A led displacement that the loads move less than this, relative to their size, is not moved by them.
UNMOVED = 1e-10
# The response to the loads that follow is solved this much better than the correction.
RESPONSE_FORCING = 0.01


@dataclass(frozen=True)
class Lead:
    """What leads and what follows in a step.

    Parameters
    ----------
    direction : ndarray, shape (ndofs,)
        Displacements when what is led grows by one.
    amount : float
        How much it grows in the step [m].
    following : ndarray, shape (ndofs,)
        Nodal forces of the loads that follow, at a load factor of 1 [N/m].
    load_factor : float
        At the last commit.
    """

    direction: Array
    amount: float
    following: Array
    load_factor: float


class UnmovedError(ArithmeticError):
    """The loads that follow do not move what is led."""


def led_step(
    system: Equilibrium, prescribed: Array, base: Array, lead: Lead, carried: Array | None = None
) -> StepOutcome:
    """Find equilibrium and load factor at the end of a load step; converged as `newton.newton_step` has it.

    Parameters
    ----------
    system : Equilibrium
        At the last commit; its trial buffers hold the result.
    prescribed : ndarray, shape (nconstrained,)
        Displacements of the constrained degrees of freedom at the end of the step [m].
    base : ndarray, shape (ndofs,)
        Nodal forces at the end of the step at a load factor of 0 [N/m].
    lead : Lead
    carried : ndarray, shape (ndofs,), optional
        What rigid bodies with a prescribed motion move in this step [m].
    """
    control = system.control
    displacement = system.displacement.copy()
    outcome = StepOutcome(False, "", displacement, system.internal_trial, load_factor=lead.load_factor)
    with system.accounting.phase("boundary"):
        moved = lead.amount * lead.direction
        moved[system.constrained] = prescribed - displacement[system.constrained]
        if carried is not None:
            moved += carried
        unbalanced = base + lead.load_factor * lead.following - system.internal_force
        unbalanced = unbalanced - system.action(system.material.tangent_start, moved, system.scratch)
        displacement += moved
    try:
        forcing = PREDICTOR_FORCING if control.forcing is None else control.forcing
        correction, change = _correction(system, unbalanced, lead, forcing, committed=True)
        outcome.iterations += 1
        system.unknowns.add(displacement, correction)
        outcome.load_factor += change
        external = base + outcome.load_factor * lead.following
        current, message, factor, point = evaluate(system, displacement, external, lead.direction)
        if current is None:
            outcome.reason, outcome.proposed_factor, outcome.failed_point = message, factor, point
            return outcome
        outcome.residuals.append(current.relative)
        before = max(system.norm(unbalanced), current.norm)
        while current.norm > current.allowed(control.tolerance):
            if outcome.iterations >= control.maximum_iterations:
                outcome.reason = (
                    f"no equilibrium within {control.maximum_iterations} iterations (relative residual "
                    f"{current.relative:.1e}, wanted {control.tolerance:.1e})"
                )
                return outcome
            forcing = next_forcing(control.forcing, current, before, control.tolerance)
            unbalanced = base + outcome.load_factor * lead.following - system.internal_trial
            correction, change = _correction(system, unbalanced, lead, forcing, committed=False)
            outcome.iterations += 1
            before = current.norm
            start, length, here = displacement.copy(), 1.0, outcome.load_factor
            for attempt in range(LINE_SEARCH_LIMIT + 1):
                if attempt:
                    system.accounting.line_searches += 1
                displacement[:] = start
                system.unknowns.add(displacement, length * correction)
                outcome.load_factor = here + length * change
                external = base + outcome.load_factor * lead.following
                found, message, factor, point = evaluate(system, displacement, external, lead.direction)
                if found is not None and (found.norm < before or found.norm <= found.allowed(control.tolerance)):
                    break
                length *= LINE_SEARCH_CUT
            else:
                falls = "the residual does not fall along Newton's correction"
                outcome.reason = falls if found is not None else message
                outcome.proposed_factor, outcome.failed_point = (0.5, -1) if found is not None else (factor, point)
                return outcome
            current = found
            outcome.residuals.append(current.relative)
    except FactorisationError as error:
        outcome.reason = f"the tangent cannot be solved: {error}"
        return outcome
    except UnmovedError as error:
        outcome.reason = str(error)
        return outcome
    outcome.converged = True
    return outcome


def _correction(
    system: Equilibrium, unbalanced: Array, lead: Lead, forcing: float, committed: bool
) -> tuple[Array, float]:
    """Changes of the unknowns and of the load factor for unbalanced forces, shape (ndofs,)."""
    unknowns = system.unknowns
    tangent = system.material.tangent_start if committed else system.material.tangent_end
    full = np.zeros_like(unbalanced)

    def along(forces: Array, change: Array) -> float:
        """Force along the lead that is left when the unknowns have moved."""
        if not system.any(change):
            return system.dot(lead.direction, forces)
        action = system.action(tangent, unknowns.expand(change, full), system.scratch)
        return system.dot(lead.direction, forces) - system.dot(lead.direction, action)

    right_hand_side, response_side = unknowns.reduce(unbalanced), unknowns.reduce(lead.following)
    correction = np.zeros(unknowns.count)
    if system.any(right_hand_side):
        correction = system.linear_solve(right_hand_side, forcing, committed, None)
    response = np.zeros(unknowns.count)
    if system.norm(response_side) > 1e-14 * system.norm(lead.following):
        response = system.linear_solve(response_side, RESPONSE_FORCING * forcing, committed, None)
    gained = along(lead.following, response)
    if not abs(gained) > UNMOVED * system.norm(lead.following) * system.norm(lead.direction):
        raise UnmovedError("the loads that follow do not move what the control leads")
    change = -along(unbalanced, correction) / gained
    return correction + change * response, change
