"""Boundary-value problems are solved here: stage by stage, coupled or uncoupled as the law asks for."""

from __future__ import annotations

import time
from collections.abc import Callable

from granfabric.fem.loads.problem import Problem

from .checkpoint import Checkpoint
from .control import ControlError, StepControl
from .coupled import CoupledRun
from .results import FailedPoint, RunSummary, StageStart, StepResult
from .uncoupled import UncoupledRun

__all__ = ["ControlError", "FailedPoint", "RunSummary", "StageStart", "StepControl", "StepResult", "solve"]


def solve(
    problem: Problem,
    control: StepControl | None = None,
    on_step: Callable[[StepResult], None] | None = None,
    stop: Callable[[], bool] | None = None,
    resume: StepResult | Checkpoint | None = None,
    on_checkpoint: Callable[[Checkpoint], None] | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> RunSummary:
    """Run all stages.

    A law with a linear stress response is not iterated on (`granfabric.fem.equilibrium.uncoupled`); all others are,
    step by step (`granfabric.fem.equilibrium.coupled`).

    Parameters
    ----------
    problem : Problem
    control : StepControl, optional
    on_step : callable, optional
        Called with each accepted step.
    stop : callable, optional
        Asked before each attempt; True ends the run cleanly.
    resume : StepResult or Checkpoint, optional
        Go on after this step of the same problem. From a checkpoint the same bits follow; from a step alone Newton's
        iterates may differ within the tolerance, because the predictor starts from the tangent of a zero increment
        instead of the last converged one.
    on_checkpoint : callable, optional
        Called after `on_step` with all that the rest of the run depends on. The solver's own arrays: to be saved or
        copied within the call.
    clock : callable
        Seconds, for the times of the phases, see `granfabric.fem.accounting.Accounting`.

    Returns
    -------
    RunSummary
        `finished` is False if a step could not be made small enough or the run was stopped.

    Raises
    ------
    ControlError
        If `resume` does not belong to the problem.
    LinearSolverError
        If the chosen linear solver is not installed.
    """
    kind = UncoupledRun if problem.law.description.linear_response else CoupledRun
    run = kind(problem, control or StepControl(), on_step, stop, on_checkpoint, clock)
    if isinstance(resume, Checkpoint):
        return run.execute(resume.result, resume.memory)
    return run.execute(resume, None)
