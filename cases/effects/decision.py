"""Which effects a scene needs: everything tried on a few of its points, with and without.

1. One elastic probe gives every integration point a path (`effects_probe`); a point scene has its own.
2. The point law goes these paths with all effects, then without each of them (`effects_trial`). The error of leaving
   an effect out is the largest difference of stress over p, strain, z and a_c, exceeded on less than 1 % of the area.
3. Effects on "auto" are left out, the least important first, as long as the error of leaving out all of them together
   stays below half the tolerance. The other half is for what a probe cannot see: that stresses go elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.field.prepare import Prepared
from granfabric.cases.scene import build
from granfabric.cases.scene.effects_choice import (
    AUTO,
    FEEDBACK,
    MEMORY,
    EffectSet,
    all_names,
    asked,
    everything,
    is_possible,
    tolerance,
)
from granfabric.cases.scene.point_path import legs_of
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.terminal.clock import best_of
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, ParameterError

from .numbers import Numbers, numbers, quantile
from .probe import Paths, ProbeError, field_paths
from .sample import sample
from .trial import Trial, differences, drive_point, follow, largest, shortened, stiffness, with_tolerance

Array = NDArray[np.float64]

REFUSED = "the law refuses this start with everything on"
LOST_FRACTION = 0.05
"""Fraction of the area without an elastic answer that makes sense, above which nothing is left out."""
TIMED = 3
MARGIN = 0.5
"""Part of the tolerance that the estimated error may take."""


@dataclass(frozen=True)
class AssessedEffect:
    """One effect, or the memory of the weak forces.

    Parameters
    ----------
    name : str
    asked : bool or "auto"
    on : bool
    error : float
        Estimated error of leaving it out, on 99 % of the area; infinite if points cannot be followed without it.
    largest : float
        The same at the worst of the points that were tried.
    quantity : str
        The quantity with the largest error; empty for what cannot act in this scene, or lacks its parameters.
    columns : int
        State columns that it costs.
    time_ratio : float
        Time of the point law with it over that without it, if that was measured.
    """

    name: str
    asked: bool | str
    on: bool
    error: float
    largest: float
    quantity: str
    columns: int
    time_ratio: float = np.nan


@dataclass(frozen=True)
class Decision:
    """What was decided, and why.

    Parameters
    ----------
    chosen : EffectSet
    assessed : list of AssessedEffect
    error : float
        Estimated error of leaving out all that is left out on "auto", together.
    tolerance : float
    numbers : Numbers or None
        None if there was no probe.
    note : str
        Why nothing was left out, where the probe failed.
    refused_fraction : float
        Fraction of the area where even with everything on the law could not follow the probe.
    """

    chosen: EffectSet
    assessed: list[AssessedEffect] = field(default_factory=list)
    error: float = 0.0
    tolerance: float = 0.0
    numbers: Numbers | None = None
    note: str = ""
    refused_fraction: float = 0.0

    def left_out(self) -> list[AssessedEffect]:
        """What was left to the program, could have acted, and is off."""
        return [entry for entry in self.assessed if entry.asked == AUTO and not entry.on and entry.quantity]


class _Bench:
    """The law of a scene with any effect set, tried once for each."""

    def __init__(self, base: ContactLaw, run: Callable[[ContactLaw], Trial], fractions: Array, moduli: Array | None):
        self._base, self._run, self._fractions, self._moduli = base, run, fractions, moduli
        self._known: dict[EffectSet, Trial | None] = {}

    def _law(self, chosen: EffectSet) -> ContactLaw:
        changed: Any = {MEMORY: chosen.force_change}
        closure = replace(self._base.closure, **changed)
        return ContactLaw(self._base.materials, closure, chosen.effects, self._base.integration)

    def trial(self, chosen: EffectSet) -> Trial | None:
        """None if the law refuses the combination."""
        if chosen not in self._known:
            try:
                self._known[chosen] = self._run(self._law(chosen))
            except ParameterError:
                self._known[chosen] = None
        return self._known[chosen]

    def seconds(self, *chosen: EffectSet) -> list[float]:
        """Processor time of trials with each set, best of several; kernels are warm."""
        return best_of([partial(self._run, self._law(entry)) for entry in chosen], TIMED, lambda done: None)

    def error(self, reference: EffectSet, other: EffectSet) -> tuple[float, float, str]:
        """On 99 % of the area, at the worst point, and of which quantity."""
        first, second = self.trial(reference), self.trial(other)
        if first is None or second is None:
            return np.inf, np.inf, "refused"
        found = differences(first, second, self._fractions, self._moduli)
        by_name = {name: quantile(values, self._fractions) for name, values in found.items()}
        name = max(by_name, key=lambda key: by_name[key])
        return by_name[name], float(largest(found).max()), name


def decide_point(loaded: LoadedScene, timed: bool = False) -> Decision:
    """Decide a point scene along its own path; if `timed`, also measure what effects cost."""
    scene = loaded.scene
    law = _base_law(loaded)
    legs = shortened(legs_of(scene))
    start = scene.initial.stress
    fractions = np.ones(1)
    bench = _Bench(law, lambda other: drive_point(other, start, legs, scene.initial.pore_pressure), fractions, None)
    reference = bench.trial(everything(scene))
    if reference is None:
        return Decision(everything(scene), tolerance=tolerance(scene), note=REFUSED)
    paths = Paths(
        reference.strain,
        reference.effective,
        fractions,
        np.zeros((1, 2)),
        np.zeros(1, dtype=np.int32),
        reference.coordination[0],
        reference.fabric[0],
    )
    return _decide(loaded, bench, paths, reference.reached < len(reference.stress) - 1, timed)


def decide_field(loaded: LoadedScene, prepared: Prepared, timed: bool = False) -> Decision:
    """Decide a boundary-value problem from an elastic probe; if `timed`, also measure what effects cost."""
    problem = prepared.problem
    try:
        paths = field_paths(problem, prepared.control)
    except ProbeError as error:
        return Decision(everything(loaded.scene), tolerance=tolerance(loaded.scene), note=str(error))
    if len(paths.strain) == 1:
        return Decision(everything(loaded.scene), tolerance=tolerance(loaded.scene), note="no stage changes the stress")
    points, fractions = sample(paths)
    few = replace(paths.at(points), weights=fractions)
    law = _base_law(loaded)
    try:
        moduli = stiffness(law, few)
    except ParameterError:
        return Decision(everything(loaded.scene), tolerance=tolerance(loaded.scene), note=REFUSED)
    bench = _Bench(law, lambda other: follow(other, few), fractions, moduli)
    reference = bench.trial(everything(loaded.scene))
    if reference is None:
        return Decision(everything(loaded.scene), tolerance=tolerance(loaded.scene), note=REFUSED)
    return _decide(loaded, bench, paths, reference.reached < len(few.strain) - 1, timed, fractions)


def _base_law(loaded: LoadedScene) -> ContactLaw:
    law = build.law(loaded, everything(loaded.scene).effects)
    return ContactLaw(law.materials, law.closure, law.effects, with_tolerance(law.integration, tolerance(loaded.scene)))


def _decide(
    loaded: LoadedScene,
    bench: _Bench,
    paths: Paths,
    refused: NDArray[np.bool_],
    timed: bool,
    fractions: Array | None = None,
) -> Decision:
    scene = loaded.scene
    full = everything(scene)
    allowed = MARGIN * tolerance(scene)
    refused_fraction = float((np.ones(1) if fractions is None else fractions)[refused].sum())
    alone: dict[str, tuple[float, float, str]] = {}
    for name in all_names():
        if full.has(name):
            alone[name] = bench.error(full, full.with_effect(name, False))
        elif not is_possible(scene, name):
            alone[name] = (0.0, 0.0, "")  # parameters nobody gave say nothing
        else:
            more = full.with_effect(name, True)
            alone[name] = bench.error(more, full) if more.has(name) else (0.0, 0.0, "")
    chosen, error, note = full, 0.0, ""
    facts = numbers(paths, [material for material, _ in build.materials(scene)], _closure(scene))
    if facts.low_pressure_fraction > LOST_FRACTION:
        note = "where so much pressure is gone, an elastic probe is no guide: nothing is left out"
    elif refused_fraction > LOST_FRACTION:
        note = f"even with everything on, {refused_fraction:.0%} of the area cannot be followed along the elastic probe"
    else:
        # what costs most time is tried first among what matters not at all
        order = sorted(
            (name for name in all_names() if asked(scene, name) == AUTO and full.has(name)),
            key=lambda name: (alone[name][0] > 0.01 * allowed and name != FEEDBACK, alone[name][0]),
        )
        for name in order:
            if alone[name][0] > allowed:
                continue
            without = chosen.with_effect(name, False)
            together = bench.error(full, without)[0]
            if together <= allowed:
                chosen, error = without, together
    assessed = [
        AssessedEffect(
            name,
            asked(scene, name),
            chosen.has(name),
            *alone[name],
            _columns(bench, chosen, name),
            _time_ratio(bench, chosen, name) if timed else np.nan,
        )
        for name in all_names()
    ]
    return Decision(chosen, assessed, error, tolerance(scene), facts, note, refused_fraction)


def _closure(scene: Any) -> Closure:
    return Closure(**{**scene.closure.model_dump(), "force_change": everything(scene).force_change})


def _columns(bench: _Bench, chosen: EffectSet, name: str) -> int:
    """State columns that an effect costs next to the others that were chosen."""
    with_it, without = bench.trial(chosen.with_effect(name, True)), bench.trial(chosen.with_effect(name, False))
    return 0 if with_it is None or without is None else with_it.columns - without.columns


def _time_ratio(bench: _Bench, chosen: EffectSet, name: str) -> float:
    """Time of the point law with an effect over that without it, next to the others that were chosen."""
    with_it, without = chosen.with_effect(name, True), chosen.with_effect(name, False)
    if bench.trial(with_it) is None or bench.trial(without) is None:
        return np.nan
    more, less = bench.seconds(with_it, without)
    return more / max(less, 1e-9)
