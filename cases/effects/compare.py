"""Whole runs of a scene with different effects, side by side: how far they lie apart, and what they cost."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.field.prepare import Prepared
from granfabric.cases.scene import build
from granfabric.cases.scene.effects_choice import EffectSet, with_decided
from granfabric.cases.scene.point_path import legs_of
from granfabric.cases.scene.reader import LoadedScene
from granfabric.constitutive.effective_stress import with_pressure
from granfabric.constitutive.path import drive
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.equilibrium.stepping import solve

from .carried import Carried
from .numbers import quantile
from .probe import pore_pressure_of
from .resolve import with_effects
from .trial import QUANTITIES, Trial, differences

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Outcome:
    """One run.

    Parameters
    ----------
    trial : Trial
        All steps of all points.
    keys : list of (str, float)
        Stage and position of each step but the start.
    seconds : float
        Processor time of the computation, nothing written.
    counters : dict of str to int
        Of the host; empty for a point.
    uncoupled : bool
    finished : bool
    """

    trial: Trial
    keys: list[tuple[str, float]]
    seconds: float
    counters: dict[str, int]
    uncoupled: bool
    finished: bool


@dataclass(frozen=True)
class Distance:
    """How far a run is from another: on 99 % of the area, at the worst point, and of which quantity."""

    error: float
    largest: float
    quantity: str


def run_field(loaded: LoadedScene, prepared: Prepared, chosen: EffectSet) -> Outcome:
    """Solve a boundary-value problem with an effect set; arguments as of `resolve.with_effects`."""
    made = with_effects(with_decided(loaded, chosen), prepared)
    problem = made.problem
    steps: list[StepResult] = []
    since = time.process_time()
    summary = solve(problem, made.control, on_step=steps.append)
    seconds = time.process_time() - since
    description = problem.law.description

    def network(state: Array) -> tuple[Array, Array]:
        fabric = np.zeros((len(state), 2))
        columns = state[:, description.columns("fabric_anisotropy")]
        fabric[:, : columns.shape[1]] = columns
        return state[:, description.columns("coordination")][:, 0], fabric

    carried = Carried(problem)
    fields = [carried(step) for step in steps]
    states = [network(problem.initial_state), *(network(state) for _, _, state in fields)]
    pressure = pore_pressure_of(problem)
    stresses = np.array([problem.initial_stress, *(stress for _, stress, _ in fields)])
    trial = Trial(
        stresses if pressure is None else with_pressure(stresses, pressure),
        np.array([np.zeros((problem.space.npoints, 3)), *(strain for strain, _, _ in fields)]),
        np.array([coordination for coordination, _ in states]),
        np.array([fabric for _, fabric in states]),
        np.full(problem.space.npoints, len(steps)),
        description.nstate,
        None if pressure is None else np.array([problem.initial_state, *(s.state for s in steps)])[..., -1] - pressure,
    )
    keys = [(step.stage, round(step.fraction, 9)) for step in steps]
    return Outcome(trial, keys, seconds, summary.counters, description.linear_response, summary.finished)


def run_point(loaded: LoadedScene, chosen: EffectSet) -> Outcome:
    """Drive a point scene with an effect set."""
    made = with_decided(loaded, chosen)
    law, legs = build.law(made, chosen.effects), legs_of(made.scene)
    since = time.process_time()
    history = drive(law, made.scene.initial.stress, legs, pore_pressure=build.pore_pressure(made, law))
    seconds = time.process_time() - since
    columns = history.columns
    steps = len(columns["step"]) - 1

    def of(*names: str) -> Array:
        return np.stack([columns[name] for name in names], axis=1)[:, None, :]

    datum = made.scene.initial.pore_pressure if law.effects.pore_fluid else 0.0
    trial = Trial(
        with_pressure(of("stress_xx", "stress_yy", "stress_xy"), datum),
        of("strain_xx", "strain_yy", "strain_xy"),
        of("coordination")[..., 0],
        of("fabric_anisotropy_1", "fabric_anisotropy_2"),
        np.array([steps]),
        law.description.nstate,
        columns["pore_pressure"][:, None] - datum if law.effects.pore_fluid else None,
    )
    keys = [("path", float(step)) for step in range(1, steps + 1)]
    return Outcome(trial, keys, seconds, {}, False, history.finished)


def distance(reference: Outcome, other: Outcome, weights: Array) -> Distance:
    """Largest difference over the steps that both have; fractions of the area as weights."""
    common = [key for key in reference.keys if key in set(other.keys)]
    first, second = (_at(outcome, common) for outcome in (reference, other))
    found = differences(first, second, weights)
    by_name = {name: quantile(found[name], weights) for name in QUANTITIES}
    name = max(by_name, key=lambda key: by_name[key])
    return Distance(by_name[name], max(float(values.max()) for values in found.values()), name)


def _at(outcome: Outcome, keys: list[tuple[str, float]]) -> Trial:
    places = {key: place + 1 for place, key in enumerate(outcome.keys)}
    nodes = [0, *(places[key] for key in keys)]
    trial = outcome.trial
    return Trial(
        trial.stress[nodes],
        trial.strain[nodes],
        trial.coordination[nodes],
        trial.fabric[nodes],
        np.full(trial.stress.shape[1], len(nodes) - 1),
        trial.columns,
        None if trial.excess is None else trial.excess[nodes],
    )
