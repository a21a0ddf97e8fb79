"""Numerical choices of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

from granfabric.constitutive.contract import TangentKind
from granfabric.fem.linear_solvers.direct import SOLVER_NAMES


class ControlError(ValueError):
    """A numerical choice is not possible; the text names it, the value and what is legal."""


@dataclass(frozen=True, kw_only=True)
class StepControl:
    """How load steps are chosen and solved.

    Parameters
    ----------
    tolerance : float
        Residual allowed, relative to the norm of internal or external nodal forces, whichever is larger.
    absolute_tolerance : float
        Residual below which a step has converged in any case [N/m].
    maximum_iterations : int
        Linear solves in one step; reaching it is a failure.
    first_factor : float
        First step of a stage over its nominal step ``1/increments``.
    smallest_factor, largest_factor : float
        Bounds of the step over the nominal step. Below the smallest the run ends.
    grow : float
        Growth of the step after a step that took at most `easy_iterations`.
    easy_iterations : int
    cut : float
        Reduction after a failure for which nobody proposes a factor; proposals are used between 0.1 and this.
    tangent_kind : {"propagated", "continuum", "elastic"}
    linear_solver : {"auto", "cholmod", "superlu"}
    keep_factor : bool
        Keep a factor as preconditioner over iterations and steps; if False, factorise at every solve.
    forcing : float, optional
        Constant relative tolerance of the linear solves; adapted to the progress of Newton's method if not given.
    report_every : int
        Where the law's stress response is linear: results every so many steps, and at the end of each stage; steps
        between are passed over. Other laws report every step.
    """

    tolerance: float = 1e-8
    absolute_tolerance: float = 0.0
    maximum_iterations: int = 12
    first_factor: float = 1.0
    smallest_factor: float = 1e-4
    largest_factor: float = 1.0
    grow: float = 1.5
    easy_iterations: int = 6
    cut: float = 0.5
    tangent_kind: TangentKind = "propagated"
    linear_solver: str = "auto"
    keep_factor: bool = True
    forcing: float | None = None
    report_every: int = 1

    def __post_init__(self) -> None:
        bounds = {
            "tolerance": (1e-15, 1e-1),
            "absolute_tolerance": (0.0, 1e300),
            "maximum_iterations": (1, 10_000),
            "first_factor": (1e-12, 1e12),
            "smallest_factor": (1e-12, 1.0),
            "largest_factor": (1e-12, 1e12),
            "grow": (1.0, 100.0),
            "easy_iterations": (0, 10_000),
            "cut": (0.01, 0.99),
            "report_every": (1, 10_000_000),
        }
        for name, (lower, upper) in bounds.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not lower <= value <= upper:
                raise ControlError(f"{name} = {value!r} is not a number in [{lower:g}, {upper:g}]")
        if self.forcing is not None and not 1e-15 <= self.forcing <= 0.5:
            raise ControlError(f"forcing = {self.forcing!r} is not a number in [1e-15, 0.5]")
        if not self.smallest_factor <= self.first_factor <= self.largest_factor:
            raise ControlError(
                f"first_factor = {self.first_factor!r} is not between smallest_factor = {self.smallest_factor!r} and "
                f"largest_factor = {self.largest_factor!r}"
            )
        for name, legal in (("tangent_kind", get_args(TangentKind)), ("linear_solver", SOLVER_NAMES)):
            if getattr(self, name) not in legal:
                raise ControlError(f"{name} = {getattr(self, name)!r} is not one of {', '.join(legal)}")
