"""Stages and legs that say whether pore fluid can leave, in scenes that have none."""

from __future__ import annotations

from typing import Any

from . import effects_choice
from .reader import LoadedScene
from .schema_law_kind import is_grains

DRAINED = "drained"


def without_fluid(loaded: LoadedScene) -> list[str]:
    """A line for the first stage or leg that says `drained` though there is no pore fluid.

    ``drained = true`` says what happens anyway. ``drained = false`` asks for an undrained response, which does not come
    about, so that its line is a warning; of a scene that turns the fluid off, or has grains, only the former is told,
    because its resolved scene says ``drained = false`` everywhere.

    Parameters
    ----------
    loaded : LoadedScene
        Of kind "point" or "field", as read: what is left out by "auto" is there.
    """
    scene = loaded.scene
    why = _why_dry(scene)
    if not why:
        return []
    key, parts = ("path", scene.path) if scene.kind == "point" else ("stage", scene.stage)
    by_choice = is_grains(scene) or effects_choice.asked(scene, effects_choice.FLUID) is False
    said = [
        (place, part.drained)
        for place, part in enumerate(parts)
        if part.drained or (DRAINED in part.model_fields_set and not by_choice)
    ]
    lines = []
    for value in dict.fromkeys(value for _, value in said):
        place = next(place for place, other in said if other == value)
        others = sum(other == value for _, other in said) - 1
        more = f" (and {others} more)" if others else ""
        where = f"{loaded.label([key, place])}{more}: {DRAINED} = {str(value).lower()}"
        lines.append(
            f"note: {where} changes nothing: {why}"
            if value
            else f"warning: {where} has no effect, the response is drained: {why}"
        )
    return lines


def _why_dry(scene: Any) -> str:
    """Why there is no pore fluid; empty if there is one, or may be."""
    if is_grains(scene):
        return "grains are dry"
    if effects_choice.asked(scene, effects_choice.FLUID) is False:
        return f"effects.{effects_choice.FLUID} = false"
    if effects_choice.is_possible(scene, effects_choice.FLUID):
        return ""
    places = ", ".join(f"{key}.{effects_choice.BULK}" for key in effects_choice.material_sections(scene))
    return f"there is no pore fluid; it comes with its bulk modulus, {places} [Pa] (2.2e9 for water)"
