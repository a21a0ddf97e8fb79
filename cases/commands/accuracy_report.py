"""How accurate a run with chosen settings is: said on screen and recorded."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from granfabric.cases.records import files
from granfabric.cases.records.replay import start_state
from granfabric.cases.scene import build
from granfabric.cases.scene.accuracy import Choice
from granfabric.cases.scene.effects_choice import recorded, resolve_effects, with_decided
from granfabric.cases.scene.point_path import legs_of
from granfabric.cases.terminal.interruption import interrupt_request

from .accuracy_field import load_step_error

FINER = 4
"""Increments of the run that assesses another, for each of its increments."""


def expected(choice: Choice) -> float | None:
    """Error of the point law measured with the chosen settings; None if the scene overrides one of them."""
    return None if any(key.startswith("integration.") for key in choice.kept) else choice.settings.measured


def achieved(loaded: Any, folder: Path) -> dict[str, float]:
    """Error of a finished point run against one with a hundredth of the tolerance and shorter increments.

    Shorter increments matter: where one substep an increment suffices, a tighter tolerance alone changes nothing.

    Parameters
    ----------
    loaded : LoadedScene
        Of kind "point".
    folder : Path
        Its results.

    Returns
    -------
    dict of str to float
        Largest errors on the path: `stress` over p, `strain` over its largest value, `coordination` relative,
        `fabric_anisotropy` absolute; and `largest` of these.
    """
    from granfabric.constitutive.law import ContactLaw
    from granfabric.constitutive.path import drive

    record = files.read_record(folder)
    assert record is not None
    loaded = with_decided(loaded, recorded(loaded.scene, record))
    law = build.law(loaded, resolve_effects(loaded.scene))
    tighter = replace(
        law.integration,
        integrator="bogacki_shampine",
        tolerance=max(0.01 * min(law.integration.tolerance, 1e-4), 1e-12),
        substeps=0,
        directions=max(law.integration.directions, 64),
    )
    legs = [replace(leg, increments=FINER * leg.increments) for leg in legs_of(loaded.scene)]
    start = start_state(loaded, law.description)
    fine_law = ContactLaw(law.materials, law.closure, law.effects, tighter)
    water = build.pore_pressure(loaded, law)
    fine = drive(fine_law, loaded.scene.initial.stress, legs, state=start, pore_pressure=water).columns
    exact = {name: values[::FINER] for name, values in fine.items()}
    found = {name: np.array(values) for name, values in files.read_csv(folder / files.HISTORY).items()}
    rows = min(len(found["p"]), len(exact["p"]))

    def error(names: tuple[str, ...], scale: Any) -> float:
        return max(float((np.abs(found[name][:rows] - exact[name][:rows]) / scale).max()) for name in names)

    strains = ("strain_xx", "strain_yy", "strain_xy")
    largest = max(float(np.abs(exact[name]).max()) for name in strains)
    errors = {
        "stress": error(("stress_xx", "stress_yy", "stress_xy"), exact["p"][:rows]),
        "strain": error(strains, largest) if largest > 0.0 else 0.0,
        "coordination": error(("coordination",), exact["coordination"][:rows]),
        "fabric_anisotropy": error(("fabric_anisotropy_1", "fabric_anisotropy_2"), 1.0),
    }
    return {**errors, "largest": max(errors.values())}


def announce(loaded: Any, screen: Any) -> None:
    """Say what `accuracy` chose, if the scene asks for it."""
    if loaded.accuracy is not None:
        screen.say(loaded.accuracy.text())


def report(loaded: Any, record: Any, screen: Any) -> None:
    """Say and record how accurate a run is.

    A point is compared with a tighter run. Of a field: what was measured of the point law with its settings, and the
    load steps against a run in half as many, and the mesh by its stresses.
    """
    choice = loaded.accuracy
    if choice is None or record.outcome != "finished":
        return
    entry: dict[str, Any] = {"wanted": choice.wanted, "chosen": choice.chosen, "kept": choice.kept}
    if loaded.scene.kind == "point":
        with record.phase("accuracy"):
            entry["achieved"] = achieved(loaded, record.folder)
        largest, own = entry["achieved"]["largest"], record.timing.get("path", 0.0)
        verdict = "" if largest <= choice.wanted else f", more than the {choice.wanted:g} that was wanted"
        screen.say(
            f"error estimate {largest:.1e}{verdict} (against a run with a hundredth of the tolerance and {FINER} times "
            f"the increments, {record.timing['accuracy']:.2f} s; the run itself: {own:.2f} s)"
        )
    else:
        entry["expected"] = expected(choice)
        entry["mesh"] = record.details["mesh_error"]["stress"]
        with record.phase("accuracy"), interrupt_request(lambda: screen.say("no estimate of the load steps")) as stop:
            entry["load_steps"] = load_step_error(loaded, record.folder, stop)
        screen.say(_field_text(choice, entry, record))
    record.details["accuracy"] = entry
    record.write()


def _field_text(choice: Choice, entry: dict[str, Any], record: Any) -> str:
    """The estimate of a field run in one sentence."""
    if entry["expected"] is None:
        law = "point law not known, because the scene overrides settings for which it was measured"
    else:
        law = f"point law {entry['expected']:.1e} in each increment (measured by `granfabric cost`)"
    mesh = f"mesh {entry['mesh']:.1e} in the stresses"
    if entry["mesh"] > choice.wanted:
        mesh += ", more than wanted: refine it where mesh_error.vtu says"
    if entry["load_steps"] is None:
        return f"error estimate: {law}; load steps not assessed; {mesh}"
    steps = entry["load_steps"]["largest"]
    verdict = "" if steps <= choice.wanted else f", more than the {choice.wanted:g} wanted: take more increments"
    return (
        f"error estimate: {law}, load steps {steps:.1e} in the means{verdict} (against half as many, "
        f"{record.timing['accuracy']:.1f} s; the run itself: {record.timing.get('run', 0.0):.1f} s); {mesh}"
    )
