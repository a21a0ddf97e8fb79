"""Elements that lock where water keeps the volume: linear ones, whose pore pressures are then of no use."""

from __future__ import annotations

from typing import Any

from granfabric.cases.records.record import Record
from granfabric.cases.terminal.screen import Screen


def locks(scene: Any) -> str:
    """A warning, or nothing.

    Parameters
    ----------
    scene : FieldScene
        With every effect decided.
    """
    element = scene.mesh.element
    if scene.effects.pore_fluid is not True or element.endswith("2") or all(stage.drained for stage in scene.stage):
        return ""
    better = {"P1": "P2", "Q1": "Q2"}[element]
    return (
        f"warning: {element} elements lock where pore fluid keeps the volume: displacements come out too small "
        f"and pore pressures alternate from element to element without bound, unless strains are uniform; use "
        f"mesh.element = {better!r}"
    )


def tell(scene: Any, record: Record, screen: Screen) -> None:
    """Say and record it."""
    text = locks(scene)
    if text:
        screen.say(text)
        record.details["locking"] = text
