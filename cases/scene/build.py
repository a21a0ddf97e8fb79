"""From a checked scene to the objects of the point law."""

from __future__ import annotations

import re
from typing import Any

from granfabric.constitutive import warm_up
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, ForceChange, Integration, Material, ParameterError

from .effects_choice import everything
from .reader import LoadedScene
from .schema_law_kind import is_grains


def materials(scene: Any) -> list[tuple[Material, str | None]]:
    """Materials of a scene, each with the region that it fills (None: everything)."""
    if scene.material is not None:
        return [(Material(**scene.material.model_dump()), None)]
    return [
        (Material(**section.model_dump(exclude={"region"})), section.region) for section in scene.materials.values()
    ]


def law(loaded: LoadedScene, effects: Effects) -> ContactLaw:
    """The point law of a scene with the given effect set.

    Raises
    ------
    InputError
        If the law refuses the combination of values.
    """
    scene = loaded.scene
    try:
        return ContactLaw(
            [material for material, _ in materials(scene)],
            closure=Closure(**{**scene.closure.model_dump(), "force_change": everything(scene).force_change}),
            effects=effects,
            integration=Integration(**scene.integration.model_dump()),
        )
    except ParameterError as error:
        raise loaded.error(_place(loaded, str(error)), str(error)) from error


def pore_pressure(loaded: LoadedScene, law: ContactLaw) -> float:
    """Pore pressure with which a point scene starts [Pa]; 0 if the law carries none."""
    return float(loaded.scene.initial.pore_pressure) if law.effects.pore_fluid else 0.0


def _place(loaded: LoadedScene, text: str) -> tuple[str, ...]:
    """Key that a sentence of the law begins with; where several materials have it, one that came from a file."""
    found = re.match(r"(\w+)\.(\w+)", text)
    if found is None:
        return ("material",)
    section, key = found.groups()
    several = [("materials", name, key) for name in getattr(loaded.scene, "materials", {})]
    return next((place for place in several if place in loaded.included), (section, key))


def kernels(loaded: LoadedScene) -> list[ForceChange]:
    """Names of the compiled kernels that a run of the scene calls, see `warm_up`; what it needs first comes first.

    What is left out is tried and audited with other closures than the scene's own. Grains need none of them.
    """
    if is_grains(loaded.scene):
        return []
    choice = everything(loaded.scene)
    closure = Closure(**{**loaded.scene.closure.model_dump(), "force_change": choice.force_change})
    return sorted(warm_up.KERNELS, key=lambda name: name != warm_up.kernel_of(closure, choice.effects))
