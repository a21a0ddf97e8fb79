"""What a scene says about effects: `true`, `false` or `"auto"`, its closure, and the error that may be left.

An effect set is an `Effects` with the closure's `force_change`, because the memory of the weak forces can be left to
the program as well. Nothing is computed here; see `effects_decision` for how "auto" is decided.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

from granfabric.cases.errors import InputError
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.parameters import Closure

from . import accuracy, pore_fluid
from .reader import LoadedScene

AUTO = "auto"
MEMORY = "force_change"
"""Name under which the closure's memory of weak forces is decided, next to the effects."""
WITH_MEMORY, WITHOUT_MEMORY = "shifted_distribution", "mean_field"
SLIDING, SPREAD, FEEDBACK = "sliding", "irreversible_spread", "stiffness_feedback"
SLIP_MEMORY = "tangential_memory"
PEAK = "peak_stress_ratio"
"""Parameter of a material without which sliding means nothing."""
FLUID, BULK = pore_fluid.EFFECT, pore_fluid.BULK
TOLERANCE = 1e-2
"""Error that may be left out if a scene says nothing."""


@dataclass(frozen=True)
class EffectSet:
    """Effects that are on, the closure's `force_change`, and whether with memory of weak forces contacts slip."""

    effects: Effects
    force_change: str
    slips: bool = True

    def has(self, name: str) -> bool:
        """Whether an effect, or the memory of weak forces, is on."""
        return self.force_change == WITH_MEMORY if name == MEMORY else bool(getattr(self.effects, name))

    def with_effect(self, name: str, on: bool) -> EffectSet:
        """The set with an effect on or off, and what has to go with it."""
        if name == MEMORY:
            made = replace(self, force_change=WITH_MEMORY if on else WITHOUT_MEMORY)
        else:
            made = replace(self, effects=replace(self.effects, **{name: on}))
        return made.completed()

    def completed(self) -> EffectSet:
        """Without what cannot act: an irreversible spread of weak forces that nothing follows, a memory of slip that
        there is none of."""
        followed = self.force_change == WITH_MEMORY and self.effects.network_changes
        idle = [name for name, acts in ((SPREAD, followed), (SLIP_MEMORY, followed and self.slips)) if not acts]
        off = {name: False for name in idle if self.has(name)}
        return replace(self, effects=replace(self.effects, **off)) if off else self

    def names(self) -> list[str]:
        """Everything that is on."""
        return [name for name in all_names() if self.has(name)]


def all_names() -> tuple[str, ...]:
    """Everything that can be decided: effects, then the memory of weak forces."""
    return (*Effects.names(), MEMORY)


def asked(scene: Any, name: str) -> bool | str:
    """What a scene says about an effect or the memory: True, False or "auto"."""
    if name != MEMORY:
        said: bool | str = getattr(scene.effects, name)
        # a scene that gives a pore pressure asks for what carries it
        return said if name != FLUID or said is False else pore_fluid.is_given(scene) or said
    said = scene.closure.force_change
    return said if said == AUTO else said == WITH_MEMORY


def tolerance(scene: Any) -> float:
    """Error that may be left by leaving effects out: the scene's own, that of its `accuracy`, or `TOLERANCE`."""
    if scene.effects.tolerance is not None:
        return float(scene.effects.tolerance)
    if scene.accuracy is not None:
        return float(accuracy.NAMED.get(scene.accuracy, scene.accuracy))
    return TOLERANCE


def material_sections(scene: Any) -> dict[str, Any]:
    """Material tables of a scene by the key under which they stand."""
    if getattr(scene, "material", None) is not None:
        return {"material": scene.material}
    return {f"materials.{name}": section for name, section in getattr(scene, "materials", {}).items()}


def sliding_is_possible(scene: Any) -> bool:
    """Whether every material gives a peak stress ratio."""
    return SLIDING in Effects.names() and all(
        PEAK in section.model_fields_set for section in material_sections(scene).values()
    )


def contacts_slip(scene: Any) -> bool:
    """Whether tangential forces are followed up to a limit, if the closure follows weak forces."""
    return Closure(**{**scene.closure.model_dump(), MEMORY: WITH_MEMORY}).slips


def is_possible(scene: Any, name: str) -> bool:
    """Whether the scene gives the parameters without which an effect, or the memory, means nothing."""
    if name == SLIDING:
        return sliding_is_possible(scene)
    return name != FLUID or any(pore_fluid.has_fluid(section) for section in material_sections(scene).values())


def everything(scene: Any) -> EffectSet:
    """All that a scene does not rule out: "auto" is on, but what needs parameters of its own only with them."""
    values = {}
    for name in Effects.names():
        said = asked(scene, name)
        values[name] = said if isinstance(said, bool) else is_possible(scene, name)
    change = scene.closure.force_change
    made = EffectSet(Effects(**values), WITH_MEMORY if change == AUTO else change, contacts_slip(scene))
    return made.completed()


def resolve_effects(scene: Any) -> Effects:
    """Effect set of a scene in which nothing that is on "auto" is left out."""
    return everything(scene).effects


def check(loaded: LoadedScene) -> None:
    """Refuse effects that contradict each other or lack what they need.

    Raises
    ------
    InputError
    """
    scene = loaded.scene
    network = [asked(scene, name) for name in ("contact_loss", "contact_gain")]
    for name, lacking in (
        (SPREAD, "which follows no distribution of weak forces that could spread"),
        (SLIP_MEMORY, "which does not tell when contacts slip"),
    ):
        if asked(scene, name) is not True:
            continue
        if asked(scene, MEMORY) is False:
            raise loaded.error(
                ["effects", name],
                f"effects.{name} = true needs closure.force_change = {WITH_MEMORY!r}, not "
                f"{scene.closure.force_change!r}, {lacking}",
            )
        if network == [False, False]:
            raise loaded.error(
                ["effects", name],
                f"effects.{name} = true has nothing to act on with contact_loss = false and contact_gain = false",
            )
    if asked(scene, SLIP_MEMORY) is True and not contacts_slip(scene):
        raise loaded.error(
            ["effects", SLIP_MEMORY],
            f"effects.{SLIP_MEMORY} = true needs contacts that slip: closure.tangential = 'frictional' with "
            "tangential_force_ratio and slip above 0",
        )
    if SLIDING in Effects.names() and asked(scene, SLIDING) is True and not sliding_is_possible(scene):
        place = next(key for key, part in material_sections(scene).items() if PEAK not in part.model_fields_set)
        raise loaded.error(
            ["effects", SLIDING],
            f"effects.{SLIDING} = true needs {place}.{PEAK}, which is not given (and should be looked at together with "
            "the other parameters of sliding)",
        )
    if asked(scene, FLUID) is True and not is_possible(scene, FLUID):
        pressure = pore_fluid.is_given(scene) and scene.effects.pore_fluid == AUTO
        what = "initial: a pore pressure" if pressure else f"effects.{FLUID} = true"
        places = ", ".join(f"{key}.{BULK}" for key in material_sections(scene))
        raise loaded.error(
            ["initial"] if pressure else ["effects", FLUID],
            f"{what} needs the bulk modulus of what fills the pores, {places} [Pa] (2.2e9 for water); none is given",
        )
    if asked(scene, FLUID) is False and pore_fluid.is_given(scene):
        raise loaded.error(
            ["effects", FLUID],
            f"effects.{FLUID} = false leaves nothing that carries the pore pressure of [initial]: turn it on (a stage "
            "with drained = true keeps pore pressures as they are), or give no pore pressure",
        )


def with_decided(loaded: LoadedScene, chosen: EffectSet) -> LoadedScene:
    """The scene with every effect and the closure decided."""
    scene = loaded.scene
    effects = scene.effects.model_copy(update={name: chosen.has(name) for name in Effects.names()})
    closure = scene.closure.model_copy(update={MEMORY: chosen.force_change})
    return replace(loaded, scene=scene.model_copy(update={"effects": effects, "closure": closure}))


def is_decided(scene: Any) -> bool:
    """Whether a scene leaves nothing to decide."""
    return all(asked(scene, name) != AUTO for name in all_names())


def recorded(scene: Any, record: dict[str, Any]) -> EffectSet:
    """What an earlier run of the same scene decided, as far as the scene leaves it open.

    Raises
    ------
    InputError
        If the record does not say.
    """
    said = everything(scene)
    try:
        values = {
            entry.name: bool(asked(scene, entry.name))
            if asked(scene, entry.name) != AUTO
            else bool(record["scene"]["effects"][entry.name])
            for entry in fields(said.effects)
        }
        change = record["scene"]["closure"][MEMORY] if asked(scene, MEMORY) == AUTO else said.force_change
    except KeyError as error:
        raise InputError(
            f"--resume: the record of the run does not tell what was decided about {error} (start anew without it)"
        ) from None
    return EffectSet(Effects(**values), change, said.slips)
