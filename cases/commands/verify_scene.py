"""One field scene by the law and by grains at its points: `granfabric verify SCENE`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from granfabric.cases.errors import InputError
from granfabric.cases.records import files
from granfabric.cases.records.record import Record, resolved, versions
from granfabric.cases.scene.owner import Owner
from granfabric.cases.scene.reader import LoadedScene, load
from granfabric.cases.scene.schema_law_kind import UNUSED, is_grains
from granfabric.cases.scene.toml_text import to_toml
from granfabric.cases.terminal.screen import Screen
from granfabric.cases.verify import scene_fields, scene_picture

from .run import run_field

PARTICLES, PACKINGS = 400, 8
MOST_PARTICLES = 20_000
LAW, GRAINS = "law", "grains"
"""Folders of the two runs inside the result folder."""
TABLE, PICTURE = "scene_comparison.csv", "scene_comparison.png"


def grains_scene(loaded: LoadedScene, particles: int, packings: int) -> dict[str, Any]:
    """The scene, as a table, with grains instead of the law; stiffnesses of the contacts are those of its material.

    Raises
    ------
    InputError
        If it is one that grains cannot follow.
    """
    scene = loaded.scene
    if is_grains(scene):
        raise InputError(f"{loaded.file}: grains stand at its points already; verify takes one with the contact law")
    if scene.material is None:
        raise loaded.error(["materials"], "verify takes scenes with one material; this one has several")
    if scene.random_state is not None:
        raise loaded.error(["random_state"], "packings have no coordination that varies from place to place")
    if scene.initial.pore_pressure or scene.initial.water_level is not None or scene.effects.pore_fluid is True:
        text = "grains at the points are dry: verify takes scenes without pore fluid"
        raise loaded.error(["effects", "pore_fluid"], text)
    table = resolved(loaded, None)
    material = table["material"]
    for name in UNUSED:
        table.pop(name, None)
    table["title"] = f"{table['title']}, grains at the points"[:200]
    table["solver"].pop("tolerance")
    table["law"] = {"kind": "grains", "packings": packings}
    table["packing"] = {
        "particles": particles,
        "normal_stiffness": material["normal_stiffness"],
        "stiffness_ratio": material["stiffness_ratio"],
    }
    return table


def run_verify_scene(
    scene: str,
    folder: Path,
    particles: int | None,
    packings: int | None,
    assignments: Sequence[str],
    screen: Screen,
    overwrite: bool = False,
) -> Record:
    """Compute a scene twice and compare.

    Parameters
    ----------
    scene : str
        Shipped name or file of a field scene.
    folder : Path
        Gets the folders `law` and `grains`, a table and a picture.
    particles, packings : int, optional
        Disks of a packing, different packings.
    assignments : sequence of str
        ``key=value`` of the scene.
    screen : Screen
    overwrite : bool

    Returns
    -------
    Record
        `outcome` is that of the two runs: "failed" if one of them did not finish; what both reached is compared.

    Raises
    ------
    InputError, RunError
        As `run.run_field`, or if they share no step.
    """
    particles, packings = particles or PARTICLES, packings or PACKINGS
    if not 50 <= particles <= MOST_PARTICLES:
        raise InputError(f"--particles {particles} is outside [50, {MOST_PARTICLES}] at the points of a scene")
    loaded = load(scene, assignments)
    loaded.require("field")
    table = grains_scene(loaded, particles, packings)
    owner = Owner("verify", f"verify {loaded.name}", f"{loaded.scene.title}: law and grains")
    with files.held(folder, owner, overwrite):
        files.prepare_output(folder, owner, overwrite)
        data = {"title": owner.title, "kind": "verify", "particles": particles, "packings": packings}
        record = Record(folder, owner.name, data, is_scene=False)
        record.write()
        screen.keep_log(folder / files.LOG, versions())
        file = folder / files.GRAINS
        files.write_text(file, to_toml(table))
        with record.phase("law"):
            first = run_field(loaded, folder / LAW, screen, overwrite=True)
        second = first
        if first.outcome != "stopped":
            with record.phase("grains"):
                second = run_field(load(str(file)), folder / GRAINS, screen, overwrite=True)
        outcomes = [first.outcome, second.outcome]
        record.outcome = next((name for name in ("stopped", "failed") if name in outcomes), "finished")  # type: ignore[assignment]
        record.message = next((run.message for run in (first, second) if run.outcome != "finished"), first.message)
        if record.outcome != "stopped":
            _compare(folder, record, screen)
        record.write()
    return record


def _compare(folder: Path, record: Record, screen: Screen) -> None:
    law, grains = scene_fields.ended((folder / LAW, folder / GRAINS))
    rows = scene_fields.table(law, grains)
    files.write_text(folder / TABLE, files.csv_text(list(scene_fields.COLUMNS), rows))
    with record.phase("pictures"):
        scene_picture.draw(folder / PICTURE, law, grains, str(record.scene["title"]))
    record.details["comparison"] = [dict(zip(scene_fields.COLUMNS, row)) for row in rows]
    shown = [[row[0], *(f"{value:.4g}" if value != "" else "" for value in row[1:])] for row in rows]
    screen.table(str(record.scene["title"]), list(scene_fields.COLUMNS), shown, ("quantity",))
    screen.say(f"law {record.timing['law']:.3g} s, grains {record.timing['grains']:.3g} s; results in {folder}")
