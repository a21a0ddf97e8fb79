"""What can be found wrong with a scene before its computation begins, beyond what `load` finds."""

from __future__ import annotations

from typing import Any

import numpy as np

from granfabric.cases.scene import build, effects_choice
from granfabric.cases.scene.dem_path import PathError, packing_options, run_options
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.scene.schema_law_kind import is_grains


def refuse_unready(loaded: LoadedScene) -> None:
    """See that a run of the scene can begin: mesh, groups, stages, initial state, effects, path.

    Nothing is computed: no kernel is called, no packing made, no effect decided.

    Raises
    ------
    InputError
        As the run itself would raise it before its first step.
    """
    {"point": _point, "field": _field, "dem": _dem}[loaded.scene.kind](loaded)


def _point(loaded: LoadedScene) -> None:
    from granfabric.cases.records.replay import start_state

    from .point import refuse_too_long

    refuse_too_long(loaded)
    if is_grains(loaded.scene):
        _packings(loaded, [loaded.scene.initial.stress])
        return
    effects_choice.check(loaded)
    start_state(loaded, build.law(loaded, effects_choice.resolve_effects(loaded.scene)).description)


def _field(loaded: LoadedScene) -> None:
    from granfabric.cases.field.prepare import prepare

    grains = is_grains(loaded.scene)
    if not grains:
        effects_choice.check(loaded)
    prepared = prepare(loaded)
    if grains:
        _packings(loaded, prepared.problem.initial_stress)


def _packings(loaded: LoadedScene, stress: Any) -> None:
    """See that packings can be asked for under the mean of the initial stresses, shape (npt, 3) [Pa]."""
    from granfabric.cases.field.grains import options_of

    if loaded.scene.law.packing_file is None:
        options_of(loaded, float(-0.5 * np.asarray(stress)[:, :2].sum(axis=1).mean()))


def _dem(loaded: LoadedScene) -> None:
    for keys, made in (
        (["path"], lambda: run_options(loaded.scene)),
        (["packing", "grading_file"], lambda: packing_options(loaded.scene, loaded.file.parent)),
    ):
        try:
            made()
        except PathError as error:
            raise loaded.error(keys, str(error)) from error
