"""The shipped biaxial test on a coarse regular mesh, with chosen numerics."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.field.stage_loads import stages
from granfabric.cases.scene import build
from granfabric.cases.scene.effects_choice import resolve_effects
from granfabric.cases.scene.reader import load
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Integration
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.control import StepControl
from granfabric.fem.equilibrium.results import RunSummary, StepResult
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.loads.kinds import INITIAL
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import rectangle

from .study import StudyError

Array = NDArray[np.float64]

WIDTH, HEIGHT = 0.05, 0.1
"""Size of the shipped specimen [m]."""


@dataclass(frozen=True)
class Means:
    """Volume means at the end of the test.

    Parameters
    ----------
    stress_ratio : float
        q/p of the mean stress.
    coordination : float
    fabric : float
        Magnitude of the mean fabric anisotropy.
    """

    stress_ratio: float
    coordination: float
    fabric: float

    def errors(self, reference: Means) -> tuple[float, float, float]:
        """Errors of q/p (absolute), z (relative), a_c (absolute)."""
        return (
            abs(self.stress_ratio - reference.stress_ratio),
            abs(self.coordination / reference.coordination - 1.0),
            abs(self.fabric - reference.fabric),
        )


class Biaxial:
    """The problem, ready to be solved several times.

    Parameters
    ----------
    across : int
        Squares over the width; twice as many over the height. Each is halved into two triangles with quadratic
        displacements.
    increments : int
        Load steps of the compression.
    integration : Integration
        Numerics of the point law.
    """

    def __init__(self, across: int, increments: int, integration: Integration) -> None:
        loaded = load("biaxial")
        scene = loaded.scene
        effects = resolve_effects(scene)
        shipped = build.law(loaded, effects)
        law = ContactLaw(shipped.materials, shipped.closure, effects, integration)
        space = Space(rectangle(WIDTH, HEIGHT, across, 2 * across), scene.mesh.element)
        parts = [part if part.name == INITIAL else replace(part, increments=increments) for part in stages(scene)]
        self.problem = Problem(
            space, law, parts, initial_stress=scene.initial.stress, balance_initial_stress=scene.initial.balance
        )

    def run(self, control: StepControl) -> tuple[Means, RunSummary, StepResult]:
        """Solve.

        Raises
        ------
        StudyError
            If the test does not come to its end.
        """
        steps: list[StepResult] = []

        def keep(step: StepResult) -> None:
            steps[:] = [step]

        summary = solve(self.problem, control, on_step=keep)
        if not summary.finished:
            raise StudyError(f"the biaxial test did not come to its end: {summary.message}")
        return self._means(steps[-1]), summary, steps[-1]

    def _means(self, step: StepResult) -> Means:
        weights = self.problem.space.weights / self.problem.space.weights.sum()
        xx, yy, xy = weights @ step.stress
        columns = self.problem.law.description.columns
        fabric = weights @ step.state[:, columns("fabric_anisotropy")]
        return Means(
            float(np.hypot((xx - yy) / 2, xy) / (-(xx + yy) / 2)),
            float(weights @ step.state[:, columns("coordination")][:, 0]),
            float(np.hypot(*fabric)),
        )
