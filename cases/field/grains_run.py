"""What a boundary-value problem with grains at its points does beside one with the contact law."""

from __future__ import annotations

from collections.abc import Callable

from granfabric.cases.grains.law import GrainsLaw
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.scene.schema_law_kind import remarks
from granfabric.cases.terminal.screen import Screen
from granfabric.constitutive.contract import Law

from .grains import with_grains
from .prepare import Prepared

NO_EFFECTS = "grains at the points: disks do what disks do, there are no effects to decide or to audit"

Advance = Callable[[float, str], None]


def begin(
    loaded: LoadedScene, prepared: Prepared, screen: Screen, stop: Callable[[], bool]
) -> Prepared:
    """The problem with packings at its points.

    Raises
    ------
    InputError, RunError
        As `granfabric.cases.field.grains.grains_law`.
    """
    for text in remarks(loaded.scene):
        screen.say(text)
    made = with_grains(loaded, prepared, screen, stop)
    screen.say(NO_EFFECTS)
    return made


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
