"""After a run: what was left out is tried on the stress paths that points followed, and what it would change is told.

A boundary-value problem keeps the strains of some points, spread over its area and those at the extremes of the probe.
When it is done, the law follows the same stress paths with each effect that was off, and the difference in stress over
p, strain, z and a_c is the neglected contribution. Above the tolerance on more than 1 % of the area it is a warning.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.records.record import Record
from granfabric.cases.scene import build
from granfabric.cases.scene.effects_choice import (
    MEMORY,
    SLIDING,
    WITH_MEMORY,
    EffectSet,
    all_names,
    everything,
    is_possible,
    tolerance,
)
from granfabric.cases.scene.point_path import legs_of
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.terminal.screen import Screen
from granfabric.constitutive.effective_stress import effective_stress, with_pressure
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import ParameterError
from granfabric.constitutive.path import PathHistory
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.loads.problem import Problem

from .carried import Carried
from .numbers import numbers, quantile
from .probe import Paths, index_of, network_of_state, pore_pressure_of
from .sample import spread_over_area
from .trial import QUANTITIES, Trial, differences, drive_point, follow, stiffness, with_tolerance

Array = NDArray[np.float64]

POINTS = 128
"""Points whose stress paths are kept."""
NODES = 60
"""Steps that are gone through again; beyond, every second goes, or more."""
REVERSAL = 0.02
"""Fall of q/p or ln p from which a closure without memory is called to account although the scene chose it."""
KNOWN_STRESS_RATIO = 0.25
"""Stress ratio beyond which sliding at contacts is not negligible at a friction of 0.5 (DEM of the verification)."""


@dataclass(frozen=True)
class Neglected:
    """What leaving out one effect has changed.

    Parameters
    ----------
    name : str
    mean, most, largest : float
        Mean over the area, exceeded on less than 1 % of the area, and at the worst point; of the quantity that differs
        most. Infinite where the law could not follow a point with what was left out.
    quantity : str
    fraction : float
        Fraction of the area above the tolerance.
    region : str
        Where that is.
    warn : bool
    """

    name: str
    mean: float
    most: float
    largest: float
    quantity: str
    fraction: float
    region: str
    warn: bool


@dataclass(frozen=True)
class Audit:
    """All that was neglected, and the largest q/p (exceeded on less than 1 % of the area)."""

    neglected: list[Neglected]
    stress_ratio: float


class StressPaths:
    """Stress paths of some points of a boundary-value problem, collected step by step.

    Parameters
    ----------
    problem : Problem
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        weights = problem.space.weights / problem.space.weights.sum()
        self.points = spread_over_area(problem.space.points, weights, POINTS)
        self._strain = [np.zeros((len(self.points), 3))]
        self._stress = [problem.initial_stress[self.points]]
        self._drained, self._drains = [False], {stage.name: stage.drained for stage in problem.stages}
        self._state = [problem.initial_state[self.points]]
        self._carried = Carried(problem)

    def add(self, step: StepResult) -> None:
        """Keep a step."""
        strain, stress, state = self._carried(step)
        self._strain.append(strain[self.points])
        self._stress.append(stress[self.points])
        self._drained.append(self._drains[step.stage])
        self._state.append(state[self.points])

    def paths(self) -> tuple[Paths, Trial]:
        """The stress paths, and the outcome of the run along them."""
        problem, points = self._problem, self.points
        last = len(self._strain) - 1
        drained = np.array(self._drained)
        turns = np.flatnonzero(np.diff(drained[1:])) + 1  # no piece is drained in part
        nodes = np.unique([*np.linspace(0, last, min(last, NODES) + 1).round().astype(int), *turns])
        strain, stress = np.array(self._strain)[nodes], np.array(self._stress)[nodes]
        description, state = problem.law.description, np.array(self._state)[nodes]
        pressure = pore_pressure_of(problem)
        at_start = None if pressure is None else pressure[points]
        coordination, fabric = network_of_state(problem)
        fraction = np.full(len(points), 1.0 / len(points))
        if len(points) == problem.space.npoints:
            fraction = problem.space.weights / problem.space.weights.sum()
        paths = Paths(
            strain,
            effective_stress(stress, state, description),
            fraction,
            problem.space.points[points],
            np.ascontiguousarray(index_of(problem)[points]),
            coordination[points],
            fabric[points],
            at_start,
            drained[nodes] if drained.any() else None,
        )
        network = np.zeros((*strain.shape[:2], 2))
        columns = state[..., description.columns("fabric_anisotropy")]
        network[..., : columns.shape[-1]] = columns
        outcome = Trial(
            stress if at_start is None else with_pressure(stress, at_start),
            strain,
            state[..., description.columns("coordination")][..., 0],
            network,
            np.full(len(points), len(nodes) - 1),
            description.nstate,
            None if at_start is None else state[..., -1] - at_start,
        )
        return paths, outcome


def audit_field(loaded: LoadedScene, problem: Problem, stress_paths: StressPaths) -> Audit:
    """What was left out of a finished boundary-value problem.

    Parameters
    ----------
    loaded : LoadedScene
        With everything decided.
    problem : Problem
        As it was run.
    stress_paths : StressPaths
    """
    paths, outcome = stress_paths.paths()
    law = _loose_law(loaded)

    def run(other: ContactLaw) -> Trial:
        return follow(other, paths)

    names = [name for _, name in build.materials(loaded.scene)]
    moduli = stiffness(law, paths)
    return _audit(loaded, law, run, outcome, paths, moduli, lambda points: _region(paths, points, names))


def audit_point(loaded: LoadedScene, history: PathHistory) -> Audit:
    """What was left out of a finished point scene; arguments as of `audit_field`."""
    law, legs = _loose_law(loaded), legs_of(loaded.scene)
    start = loaded.scene.initial.stress
    columns = history.columns
    rows = len(columns["step"])

    def of(*names: str) -> Array:
        return np.stack([columns[name] for name in names], axis=1)[:, None, :]

    given = loaded.scene.initial.pore_pressure
    wet = "pore_pressure" in columns
    outcome = Trial(
        with_pressure(of("stress_xx", "stress_yy", "stress_xy"), given if wet else 0.0),
        of("strain_xx", "strain_yy", "strain_xy"),
        of("coordination")[..., 0],
        of("fabric_anisotropy_1", "fabric_anisotropy_2"),
        np.array([rows - 1]),
        law.description.nstate,
        np.asarray(columns["pore_pressure"])[:, None] - given if wet else None,
    )
    one = np.ones(1)
    paths = Paths(
        outcome.strain,
        outcome.effective,
        one,
        np.zeros((1, 2)),
        np.zeros(1, dtype=np.int32),
        outcome.coordination[0],
        outcome.fabric[0],
    )
    return _audit(
        loaded, law, lambda other: drive_point(other, start, legs, given), outcome, paths, None,
        lambda points: "the point",
    )


def _loose_law(loaded: LoadedScene) -> ContactLaw:
    """The law of the run with looser substeps, but with all its directions: fewer would differ from the run by more."""
    law = build.law(loaded, everything(loaded.scene).effects)
    numerics = with_tolerance(law.integration, tolerance(loaded.scene), law.integration.directions)
    return ContactLaw(law.materials, law.closure, law.effects, numerics)


def _audit(
    loaded: LoadedScene,
    law: ContactLaw,
    run: Any,
    outcome: Trial,
    paths: Paths,
    moduli: Array | None,
    region: Any,
) -> Audit:
    scene = loaded.scene
    used, allowed = everything(scene), tolerance(scene)
    facts = numbers(paths, list(law.materials), law.closure)
    found = []
    for name in all_names():
        if used.has(name) or not is_possible(scene, name):
            continue
        more = used.with_effect(name, True)
        if not more.has(name):
            continue
        try:
            other = run(_with(law, more))
        except ParameterError:
            continue
        parts = differences(other, outcome, paths.weights, moduli)
        # a point that the effect would have stopped: nothing bounds what was neglected there
        stopped = other.reached < outcome.reached
        parts = {key: np.where(stopped, np.inf, values) for key, values in parts.items()}
        quantity = max(QUANTITIES, key=lambda key: (quantile(parts[key], paths.weights), float(parts[key].max())))
        values = parts[quantity]
        above = np.max(np.stack(list(parts.values())), axis=0) > allowed
        most = quantile(values, paths.weights)
        counts = name != MEMORY or facts.reversal > REVERSAL
        found.append(
            Neglected(
                name,
                float(values @ paths.weights),
                most,
                float(values.max()),
                quantity,
                float(paths.weights[above].sum()),
                region(above) if above.any() else "",
                bool(most > allowed and counts),
            )
        )
    return Audit(found, facts.stress_ratio)


def _with(law: ContactLaw, chosen: EffectSet) -> ContactLaw:
    changed: Any = {MEMORY: chosen.force_change}
    return ContactLaw(law.materials, replace(law.closure, **changed), chosen.effects, law.integration)


def _region(paths: Paths, points: NDArray[np.bool_], names: Sequence[str | None]) -> str:
    """Bounding box of points, and the materials they lie in."""
    (x0, y0), (x1, y1) = paths.places[points].min(axis=0), paths.places[points].max(axis=0)
    text = f"x = {x0:.3g} ... {x1:.3g} m, y = {y0:.3g} ... {y1:.3g} m"
    if len(names) > 1:
        hit = np.unique(paths.material_index[points])
        text += ", in " + ", ".join(str(names[index]) for index in hit.tolist())
    return text


def messages(audit: Audit, scene: Any) -> list[str]:
    """A warning for each effect that should not have been left out, and one line on the rest."""
    found, stress_ratio = audit.neglected, audit.stress_ratio
    said = [
        f"warning: {entry.name} is off and would have changed {_words(entry)} on {entry.fraction:.0%} of the area "
        f"({entry.region}); on the mean {_number(entry.mean)}, tolerance {tolerance(scene):g}; --upgrade turns it on"
        for entry in found
        if entry.warn
    ]
    small = [f"{entry.name} {_number(entry.most)}" for entry in found if not entry.warn]
    if small:
        said.append(f"audit of what was left out: {', '.join(small)}")
    assessed = SLIDING in [entry.name for entry in found] or SLIDING in everything(scene).names()
    used_up = friction_used_up(scene.closure)
    if not assessed and stress_ratio > min(KNOWN_STRESS_RATIO, used_up):
        known = f"beyond {KNOWN_STRESS_RATIO:g} sliding at contacts is not negligible"
        if used_up < KNOWN_STRESS_RATIO:
            known = (
                f"beyond {used_up:.2g}, tangential_force_ratio/(2 slip), tangential forces have reached all that "
                "friction carries, and disks lose contacts that the law keeps"
            )
        said.append(f"audit: q/p reaches {stress_ratio:.2g} without sliding; {known} (effects.sliding)")
    return said


def friction_used_up(closure: Any) -> float:
    """q/p at which a_t = c_t q/p - k (q/p)^2 is largest; infinite where nothing slips or a_t is no function of q/p."""
    frictional = closure.force_change == WITH_MEMORY and closure.tangential != "self_consistent"
    return closure.tangential_force_ratio / (2.0 * closure.slip) if frictional and closure.slip > 0.0 else math.inf


def _words(entry: Neglected) -> str:
    names = {"stress": "stress over p", "strain": "strain", "coordination": "z", "fabric": "a_c"}
    if math.isinf(entry.largest):
        return "everything: points cannot be followed with it"
    return f"{names[entry.quantity]} by up to {_number(entry.largest)}"


def _number(value: float) -> str:
    return "without bound" if math.isinf(value) else f"{value:.1e}"


def as_data(audit: Audit) -> list[dict[str, Any]]:
    """For `run.json`."""

    def finite(value: Any) -> Any:
        return "without bound" if isinstance(value, float) and math.isinf(value) else value

    return [{key: finite(value) for key, value in vars(entry).items()} for entry in audit.neglected]


def to_upgrade(audit: Audit) -> list[str]:
    """Assignments that turn on what should not have been left out."""
    return [
        f'closure.{MEMORY}="{WITH_MEMORY}"' if entry.name == MEMORY else f"effects.{entry.name}=true"
        for entry in audit.neglected
        if entry.warn
    ]


def conclude(audit: Audit, loaded: LoadedScene, record: Record, screen: Screen) -> None:
    """Say and record what was neglected."""
    record.details["audit"] = as_data(audit)
    record.details["upgrade"] = to_upgrade(audit)
    for text in messages(audit, loaded.scene):
        screen.say(text)
