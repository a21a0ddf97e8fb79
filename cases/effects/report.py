"""What was decided about effects, in three lines, as a table and as data."""

from __future__ import annotations

import math
from typing import Any

from granfabric.cases.scene.effects_choice import (
    AUTO,
    FEEDBACK,
    FLUID,
    MEMORY,
    SLIDING,
    SLIP_MEMORY,
    SPREAD,
    all_names,
)
from granfabric.cases.terminal.screen import Screen

from .decision import AssessedEffect, Decision
from .numbers import Numbers

MEANING = {"stress": "stress/p", "strain": "strain", "coordination": "z", "fabric": "a_c", "refused": "", "": ""}


def number_of(name: str, facts: Numbers) -> str:
    """The number of the probe that speaks for or against an effect."""
    if name == "contact_loss":
        return f"first-order loss {facts.loss:.1%}"
    if name == "contact_gain":
        return f"gain within {facts.gain_bound:.1e}"
    if name == "principal_rotation":
        return f"off axes {facts.off_axis:.2g}, turn {facts.turn_degrees:.0f} deg"
    if name == FEEDBACK:
        return f"stiffness within {facts.stiffness_change:.1%}"
    if name in (MEMORY, SPREAD):
        return f"q/p, ln p fall by {abs(facts.reversal):.2g}"
    if name == SLIP_MEMORY:
        return f"s turns back by {facts.turning_back:.2g}"
    if name == SLIDING:
        return f"q/p reaches {facts.stress_ratio:.2g}"
    if name == FLUID:
        return f"K_f/n eps_v reaches {facts.excess_pressure:.2g} p"
    return ""


def scene_effects(scene: Any) -> list[tuple[str, str]]:
    """Effects that the scene itself brings in, with what it says."""
    sections = getattr(scene, "materials", {})
    bodies = [load for part in getattr(scene, "stage", []) for load in part.body_force]
    held = [part.name for part in getattr(scene, "stage", []) if part.body_force]
    return [
        ("several_materials", f"on: {', '.join(sections)}" if len(sections) > 1 else "off: one material"),
        ("body_force", f"on: in {', '.join(dict.fromkeys(held))}" if bodies else "off: none given"),
    ]


def shown_error(value: float) -> str:
    """An error as text."""
    return "not followed" if math.isinf(value) else "0" if value == 0.0 else f"{value:.1e}"


def lines(decision: Decision, uncoupled: bool | None) -> list[str]:
    """Three lines: what is on, what was left out and why that may be, what the probe saw."""
    shown = [name for name in decision.chosen.names() if name != MEMORY]
    first = f"effects: {', '.join(shown) or 'none'}; force_change = {decision.chosen.force_change}"
    out = [f"{entry.name} {shown_error(entry.error)}" for entry in decision.left_out()]
    if decision.numbers is None:
        off = [name for name in all_names() if name != MEMORY and not decision.chosen.has(name)]
        return [first, f"off: {', '.join(off) or 'nothing'}", f"no probe: {decision.note}"]
    second = f"left out (estimated error of each): {', '.join(out) or 'nothing'}"
    if out:
        second += f"; together {shown_error(decision.error)}, tolerance {decision.tolerance:g}"
    forced = [entry for entry in decision.assessed if entry.asked is False and entry.error > decision.tolerance]
    if forced:
        named = ", ".join(f"{entry.name} {shown_error(entry.error)}" for entry in forced)
        second += f"; switched off by the scene, error above the tolerance: {named}"
    facts = decision.numbers
    third = (
        f"elastic probe: q/p to {facts.stress_ratio:.2g}, principal stress rotation {facts.turn_degrees:.0f} deg, ln p "
        f"{-facts.pressure_fall:+.2g} to {facts.pressure_rise:+.2g}"
    )
    if facts.low_pressure_fraction > 0.0:
        third += f", pressure nearly gone on {facts.low_pressure_fraction:.1%} of the area"
    if uncoupled is not None:
        third += "; " + ("displacements by one linear solve a stage" if uncoupled else "stiffness follows the state")
    if decision.note:
        third += f"; {decision.note}"
    return [first, second, third]


def table(decision: Decision, points: int) -> tuple[list[str], list[list[str]]]:
    """Heads and rows: effect, on or off, the number that speaks for it, error of leaving it out and its quantity, the
    same at the worst point; what it costs next to the others that are on: state columns, memory, time of the law."""
    heads = ["effect", "scene", "is", "number", "error", "of", "worst", "columns", "memory", "time"]
    rows = []
    for entry in decision.assessed:
        said = entry.asked if entry.asked == AUTO else str(entry.asked).lower()
        memory = 2 * 8 * entry.columns * points
        rows.append(
            [
                entry.name,
                str(said),
                "on" if entry.on else "off",
                "" if decision.numbers is None else number_of(entry.name, decision.numbers),
                shown_error(entry.error) if entry.quantity else "",
                MEANING[entry.quantity],
                shown_error(entry.largest) if entry.quantity else "",
                f"{entry.columns:+d}",
                f"{memory / 1e6:+.2f} MB" if points > 1 else f"{memory:+d} B",
                "" if math.isnan(entry.time_ratio) else f"x {entry.time_ratio:.2f}",
            ]
        )
    return heads, rows


def announce(decision: Decision, uncoupled: bool | None, screen: Screen) -> None:
    """The three lines on screen."""
    for text in lines(decision, uncoupled):
        screen.say(text)


def as_data(decision: Decision) -> dict[str, Any]:
    """For `run.json`."""

    def finite(value: float) -> float | str:
        return value if math.isfinite(value) else "not followed"

    return {
        "tolerance": decision.tolerance,
        "error_left_out": finite(decision.error),
        "note": decision.note,
        "refused_fraction": decision.refused_fraction,
        "numbers": None if decision.numbers is None else vars(decision.numbers),
        "effects": [_entry(entry, finite) for entry in decision.assessed],
    }


def _entry(entry: AssessedEffect, finite: Any) -> dict[str, Any]:
    return {
        "name": entry.name,
        "asked": entry.asked,
        "on": entry.on,
        "error_if_left_out": finite(entry.error),
        "error_at_worst_point": finite(entry.largest),
        "quantity": entry.quantity,
        "state_columns": entry.columns,
    }
