"""From a loaded scene to one in which every effect is decided, before a run begins."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from granfabric.cases.field.prepare import Prepared
from granfabric.cases.scene import build, effects_choice
from granfabric.cases.scene.reader import LoadedScene
from granfabric.constitutive.effective_stress import with_pressure
from granfabric.fem.loads.problem import Problem

from .decision import Decision, decide_field, decide_point
from .probe import index_of, network_of_state, pore_pressure_of

DECIDED_BY_SCENE = "the scene leaves nothing to decide"
STOPPED_BEFORE = "stopped before it"
"""The note of a run that was asked to stop before its effects were decided: it took no step."""


def resolve_point(loaded: LoadedScene) -> tuple[LoadedScene, Decision]:
    """Decide a point scene.

    Raises
    ------
    InputError
        If effects contradict each other.
    """
    effects_choice.check(loaded)
    if effects_choice.is_decided(loaded.scene):
        decision = Decision(effects_choice.everything(loaded.scene), note=DECIDED_BY_SCENE)
    elif loaded.scene.initial.state is not None:
        decision = Decision(effects_choice.everything(loaded.scene), note="initial.state tells what is carried")
    else:
        decision = decide_point(loaded)
    return effects_choice.with_decided(loaded, decision.chosen), decision


def resolve_field(
    loaded: LoadedScene, prepared: Prepared, earlier: dict[str, Any] | None = None, hasty: bool = False
) -> tuple[LoadedScene, Prepared, Decision]:
    """Decide a boundary-value problem, or take over what an earlier part of the run decided.

    Parameters
    ----------
    loaded : LoadedScene
        Checked by `effects_choice.check`.
    prepared : Prepared
        With everything on that the scene does not rule out.
    earlier : dict, optional
        Record of the run to go on with.
    hasty : bool
        Do not probe, because the user asks to stop.
    """
    if earlier is not None:
        decision = Decision(effects_choice.recorded(loaded.scene, earlier), note="as the run began")
    elif effects_choice.is_decided(loaded.scene):
        decision = Decision(effects_choice.everything(loaded.scene), note=DECIDED_BY_SCENE)
    elif hasty:
        decision = Decision(effects_choice.everything(loaded.scene), note=STOPPED_BEFORE)
    else:
        decision = decide_field(loaded, prepared)
    made = effects_choice.with_decided(loaded, decision.chosen)
    return made, with_effects(made, prepared), decision


def is_undecided(earlier: dict[str, Any]) -> bool:
    """Whether a run was stopped before its effects were decided, so that to go on with it is to begin."""
    return (earlier.get("decision") or {}).get("note") == STOPPED_BEFORE


def with_effects(loaded: LoadedScene, prepared: Prepared) -> Prepared:
    """The problem with the law of a decided scene."""
    effects = effects_choice.resolve_effects(loaded.scene)
    law = build.law(loaded, effects)
    problem = prepared.problem
    coordination, fabric = network_of_state(problem)
    pressure, stress = pore_pressure_of(problem), problem.initial_stress
    if pressure is not None and not law.effects.pore_fluid:
        stress, pressure = with_pressure(stress, pressure), None
    elif pressure is None and law.effects.pore_fluid:
        pressure = np.zeros(len(stress))
    state = law.initial_state(stress, index_of(problem), coordination, fabric, pressure)
    made = Problem(
        problem.space,
        law,
        problem.stages,
        initial_stress=stress,
        material_index=problem.material_index,
        initial_state=state,
        balance_initial_stress=problem.balance_initial_stress,
    )
    control = replace(prepared.control, report_every=loaded.scene.output.every)
    return replace(prepared, problem=made, control=control, effects=effects)
