"""What a boundary-value problem with grains at its points does beside one with the contact law."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace

from granfabric.cases.engine.choice import Choice
from granfabric.cases.engine.parts import Part
from granfabric.cases.errors import InputError, RunError
from granfabric.cases.grains.law import GrainsLaw
from granfabric.cases.grains.spread_law import BLOCK, SpreadGrainsLaw
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.scene.schema_law_kind import is_grains, remarks
from granfabric.cases.terminal.screen import Screen
from granfabric.constitutive.contract import Array, Law
from granfabric.fem.equilibrium.checkpoint import Checkpoint

from .grains import with_grains
from .prepare import Prepared

NO_EFFECTS = "grains at the points: disks do what disks do, there are no effects to decide or to audit"

Advance = Callable[[float, str], None]


def check(loaded: LoadedScene, choice: Choice | None) -> None:
    """See that there are points to share out if workers are asked for, and that these fit.

    Raises
    ------
    InputError
    """
    if choice is None:
        return
    if not is_grains(loaded.scene) or loaded.scene.kind != "field":
        asked = choice.option if choice.scheduler is None else "--scheduler"
        raise InputError(
            f"No such option for this scene: {asked} shares out the points of a field scene with grains (law.kind = "
            "'grains'); points of the contact law are computed by the threads of one process (--threads)"
        )
    choice.check()


def begin(
    loaded: LoadedScene,
    prepared: Prepared,
    screen: Screen,
    stop: Callable[[], bool],
    hold: ExitStack,
    choice: Choice | None = None,
) -> Prepared:
    """The problem with packings at its points.

    Parameters
    ----------
    loaded : LoadedScene
    prepared : Prepared
    screen : Screen
    stop : callable
    hold : ExitStack
        Ends the workers.
    choice : Choice, optional
        Workers that hold the packings; the threads of this process if not given.

    Raises
    ------
    InputError, RunError
        As `granfabric.cases.field.grains.grains_law`.
    """
    for text in remarks(loaded.scene):
        screen.say(text)

    def spread(law: GrainsLaw, state: Array) -> tuple[GrainsLaw, Array]:
        if choice is None:
            return law, state
        part = Part(BLOCK, law.recipe, ("dem",))
        try:
            crew = hold.enter_context(choice.crew(part, len(state), screen, stop))
        except KeyboardInterrupt as error:
            raise RunError("stopped before the workers had begun; nothing was written") from error
        screen.say(f"{len(state)} points are shared out to {crew.text}")
        shared = SpreadGrainsLaw(law, crew)
        return shared, shared.begin(state)

    made = with_grains(loaded, prepared, screen, stop, spread)
    screen.say(NO_EFFECTS)
    return made


def taken_up(law: Law, checkpoint: Checkpoint | None) -> Checkpoint | None:
    """A checkpoint as the law of this run can go on from it."""
    if checkpoint is None or not isinstance(law, SpreadGrainsLaw):
        return checkpoint
    return replace(checkpoint, result=replace(checkpoint.result, state=law.adopted(checkpoint.result.state)))


def kept(law: Law, save: Callable[[Checkpoint], None]) -> Callable[[Checkpoint], None]:
    """Save checkpoints that hold all packings, wherever they are."""
    if not isinstance(law, SpreadGrainsLaw):
        return save
    return lambda made: save(replace(made, result=replace(made.result, state=law.expanded(made.result.state))))


def watched(law: Law, advance: Advance, stop: Callable[[], bool]) -> Advance:
    """Show the points of a call of the law as they are done, and leave the call when the user asks to stop."""
    if not isinstance(law, GrainsLaw):
        return advance
    at = 0.0

    def steps(done: float, text: str) -> None:
        nonlocal at
        at = done
        advance(done, text)

    law.on_points = lambda done, total: advance(at, f"{done} of {total} points")
    law.stop = stop
    return steps


def how_to_go_on(law: Law) -> str:
    """End of the sentence about an interruption."""
    return " (--resume goes on after the last one that was finished)" if isinstance(law, GrainsLaw) else ""
