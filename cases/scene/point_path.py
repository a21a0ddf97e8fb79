"""The path of a point scene as legs of the point driver."""

from __future__ import annotations

from typing import Any

from granfabric.constitutive.path import Leg


def legs_of(scene: Any) -> list[Leg]:
    """Legs of a point scene's path."""
    made = []
    for part in scene.path:
        if part.rotation_degrees is not None:
            made.append(Leg(rotation_degrees=part.rotation_degrees, increments=part.increments))
        else:
            made.append(Leg(control=tuple(part.control), target=tuple(part.target), increments=part.increments))
    return made
