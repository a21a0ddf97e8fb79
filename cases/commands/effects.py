"""`granfabric effects`: which effects a scene needs, and why; nothing is computed but a probe, nothing is written."""

from __future__ import annotations

from granfabric.cases.effects import report as effects_report
from granfabric.cases.effects.decision import Decision, decide_field, decide_point
from granfabric.cases.errors import InputError
from granfabric.cases.field.prepare import prepare
from granfabric.cases.scene import effects_choice
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.scene.schema_law_kind import is_grains
from granfabric.cases.terminal.compile_watch import watching
from granfabric.cases.terminal.screen import Screen

COMPILATION_SECONDS = 75


def show_effects(loaded: LoadedScene, screen: Screen) -> Decision:
    """Decide a scene's effects and print the table.

    Raises
    ------
    InputError
        If the scene is of a kind that has no effects, or not legal.
    """
    if loaded.scene.kind not in ("point", "field"):
        raise InputError(
            f"{loaded.file}: kind = {loaded.scene.kind!r} has no effects to decide: disks do what disks do; "
            "effects belong to point and field scenes"
        )
    if is_grains(loaded.scene):
        raise InputError(f"{loaded.file}: law.kind = 'grains' has no effects to decide: disks do what disks do")
    effects_choice.check(loaded)
    points, uncoupled = 1, None
    with watching(screen.announce_compilation(COMPILATION_SECONDS)):
        if loaded.scene.kind == "point":
            decision = decide_point(loaded, timed=True)
        else:
            prepared = prepare(loaded)
            decision = decide_field(loaded, prepared, timed=True)
            points, uncoupled = prepared.problem.space.npoints, decision.chosen.effects.linear_response
    heads, rows = effects_report.table(decision, points)
    screen.table(f"{loaded.scene.title}: effects", heads, rows, ("effect", "scene", "number"))
    for name, text in effects_report.scene_effects(loaded.scene):
        screen.say(f"{name}: {text}")
    effects_report.announce(decision, uncoupled, screen)
    return decision
