"""The path of a point scene as legs of the point driver."""

from __future__ import annotations

from typing import Any

from granfabric.constitutive.path import Leg


def legs_of(scene: Any) -> list[Leg]:
    """Legs of a point scene's path."""
    made = []
    for part in scene.path:
        if part.rotation_degrees is not None:
            made.append(
                Leg(rotation_degrees=part.rotation_degrees, increments=part.increments, drained=part.drained)
            )
        else:
            made.append(
                Leg(
                    control=tuple(part.control),
                    target=tuple(part.target),
                    increments=part.increments,
                    relative=part.relative,
                    drained=part.drained,
                )
            )
    return made


def remarks(scene: Any) -> list[str]:
    """What a path does that may not be meant, a sentence each.

    Strain targets count from the start of the path. After a leg under stress, whose strains nobody wrote down, a leg of
    strains alone therefore takes back what came before, unless it is relative.
    """
    found = []
    stress_before = False
    for number, part in enumerate(scene.path, start=1):
        rotates = part.rotation_degrees is not None
        if not rotates and stress_before and not part.relative and set(part.control) == {"strain"}:
            found.append(
                f"path {number}: strain targets count from the start of the path, so this leg takes back the strain of "
                "those before it; relative = true counts from the start of the leg"
            )
        stress_before = stress_before or rotates or "stress" in part.control
    return found
