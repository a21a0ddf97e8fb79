"""From a checked scene to the objects of the point law."""

from __future__ import annotations

from typing import Any

from constitutive.effects import Effects
from constitutive.law import ContactLaw
from constitutive.parameters import Closure, Integration, Material
from constitutive.path import Leg


def materials(scene: Any) -> list[tuple[Material, str | None]]:
    """Materials of a scene, each with the region that it fills (None: everything)."""
    if scene.material is not None:
        return [(Material(**scene.material.model_dump()), None)]
    return [
        (Material(**section.model_dump(exclude={"region"})), section.region) for section in scene.materials.values()
    ]


def law(scene: Any, effects: Effects) -> ContactLaw:
    """The point law of a scene with the given effect set."""
    return ContactLaw(
        [material for material, _ in materials(scene)],
        closure=Closure(**scene.closure.model_dump()),
        effects=effects,
        integration=Integration(**scene.integration.model_dump()),
    )


def legs(scene: Any) -> list[Leg]:
    """Legs of a point scene's path."""
    made = []
    for part in scene.path:
        if part.rotation_degrees is not None:
            made.append(Leg(rotation_degrees=part.rotation_degrees, increments=part.increments))
        else:
            made.append(Leg(control=tuple(part.control), target=tuple(part.target), increments=part.increments))
    return made
