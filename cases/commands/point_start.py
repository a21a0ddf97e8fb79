"""What a point scene begins with, with the contact law or with grains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from granfabric.cases.effects.decision import Decision
from granfabric.cases.field.grains import grains_law
from granfabric.cases.field.grains_run import NO_EFFECTS
from granfabric.cases.grains.law import GrainsLaw
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.scene.schema_law_kind import remarks
from granfabric.cases.terminal.screen import Screen
from granfabric.constitutive.contract import Array
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw


@dataclass(frozen=True)
class PointStart:
    """A point scene turned into a law and a state.

    Parameters
    ----------
    loaded : LoadedScene
        With every effect decided.
    law : ContactLaw or GrainsLaw
    state : ndarray, shape (1, nstate), optional
        If not the law's own for the initial stress.
    effects : Effects, optional
    decision : Decision, optional
        Without grains.
    compilation : float
        Seconds of it so far.
    """

    loaded: LoadedScene
    law: ContactLaw | GrainsLaw
    state: Array | None
    effects: Effects | None = None
    decision: Decision | None = None
    compilation: float = 0.0


def begin(loaded: LoadedScene, screen: Screen) -> PointStart:
    """A packing under the initial stress of a point scene.

    Raises
    ------
    InputError, RunError
        As `granfabric.cases.field.grains.grains_law`.
    """
    for text in remarks(loaded.scene):
        screen.say(text)
    law, state = grains_law(loaded, np.array([loaded.scene.initial.stress]), screen)
    screen.say(NO_EFFECTS)
    return PointStart(loaded, law, state)
