"""From `true`, `false` or `"auto"` in a scene to the effect set that is simulated."""

from __future__ import annotations

from typing import Any

from constitutive.effects import Effects


def resolve_effects(scene: Any) -> Effects:
    """Effect set of a scene. An effect on "auto" is on: nothing is left out unless the scene says so."""
    chosen = scene.effects.model_dump()
    return Effects(**{name: True if value == "auto" else value for name, value in chosen.items()})
