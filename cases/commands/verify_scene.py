"""One field scene by the law, by grains at its points and by specimens of grains: `granfabric verify SCENE`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from granfabric.cases.engine.choice import Choice, asked_for
from granfabric.cases.engine.jobs import Ended, Job
from granfabric.cases.errors import InputError
from granfabric.cases.records import files
from granfabric.cases.records.record import Record, resolved, versions
from granfabric.cases.scene.owner import Owner
from granfabric.cases.scene.reader import LoadedScene, load
from granfabric.cases.scene.schema_law_kind import UNUSED, is_grains
from granfabric.cases.scene.toml_text import to_toml
from granfabric.cases.terminal.interruption import interrupt_request
from granfabric.cases.terminal.screen import Screen
from granfabric.cases.verify import scene_fields, scene_picture, specimen_task
from granfabric.cases.verify.scene_plan import SpecimenPlan, plan_of
from granfabric.cases.verify.scene_specimens import INERTIAL_NUMBER, KERNEL, OneSpecimen, mean_fields
from granfabric.cases.verify.specimen_task import SpecimenTask

from .run import run_field
from .verify_measured import measured_scene

PARTICLES, PACKINGS = 400, 8
MOST_PARTICLES = 20_000
LAW, GRAINS = "law", "grains"
"""Folders of the two runs inside the result folder."""
TABLE, PICTURE = "scene_comparison.csv", "scene_comparison.png"
SPECIMEN_PARTICLES, MOST_SPECIMENS = 3000, 100
LEAST_SPECIMEN, MOST_SPECIMEN = 100, 200_000


@dataclass(frozen=True)
class Judges:
    """What a scene is compared with besides grains at the points.

    Attributes
    ----------
    specimens : int, optional
        Of grains; none if not given.
    disks : int, optional
        Of a specimen.
    measured : bool
        The law takes what is measured on the packings, not what the scene says.
    """

    specimens: int | None = None
    disks: int | None = None
    measured: bool = False

    def check(self) -> None:
        """Refuse numbers that are not legal.

        Raises
        ------
        InputError
        """
        if self.disks is not None and self.specimens is None:
            raise InputError("--specimen-particles goes with --specimens N")
        if self.specimens is not None and not 1 <= self.specimens <= MOST_SPECIMENS:
            raise InputError(f"--specimens {self.specimens} is outside [1, {MOST_SPECIMENS}]")
        if self.disks is not None and not LEAST_SPECIMEN <= self.disks <= MOST_SPECIMEN:
            raise InputError(f"--specimen-particles {self.disks} is outside [{LEAST_SPECIMEN}, {MOST_SPECIMEN}]")


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
    judges: Judges | None = None,
    choice: Choice | None = None,
) -> Record:
    """Compute a scene twice, with specimens of grains besides if they are asked for, and compare.

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
    judges : Judges, optional
    choice : Choice, optional
        Workers for the grains at the points and the specimens; if not given, the threads of this process for the
        former, a process a core for the latter. Results do not depend on it.

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
    judges, choice = judges or Judges(), choice or Choice()
    judges.check()
    choice.check()
    workers = asked_for(choice.workers, choice.scheduler, choice.threads)
    loaded = load(scene, assignments)
    loaded.require("field")
    table = grains_scene(loaded, particles, packings)
    plan = plan_of(loaded) if judges.specimens else None
    owner = Owner("verify", f"verify {loaded.name}", f"{loaded.scene.title}: law and grains")
    with files.held(folder, owner, overwrite):
        files.prepare_output(folder, owner, overwrite)
        data = {"title": owner.title, "kind": "verify", "particles": particles, "packings": packings}
        record = Record(folder, owner.name, data, is_scene=False)
        record.write()
        screen.keep_log(folder / files.LOG, versions())
        file = folder / files.GRAINS
        files.write_text(file, to_toml(table))
        if judges.measured:
            with record.phase("measuring"):
                loaded = measured_scene(loaded, scene, assignments, (particles, packings), plan, judges, folder, screen)
        with record.phase("law"):
            first = run_field(loaded, folder / LAW, screen, overwrite=True)
        second = first
        if first.outcome != "stopped":
            with record.phase("grains"):
                second = run_field(load(str(file)), folder / GRAINS, screen, overwrite=True, choice=workers)
        outcomes = [first.outcome, second.outcome]
        record.outcome = next((name for name in ("stopped", "failed") if name in outcomes), "finished")  # type: ignore[assignment]
        record.message = next((run.message for run in (first, second) if run.outcome != "finished"), first.message)
        record.details["audit"] = (files.read_record(folder / LAW) or {}).get("audit", [])
        found: list[OneSpecimen] = []
        if plan is not None and record.outcome != "stopped":
            with record.phase("specimens"):
                found = _specimens(folder, loaded, plan, judges, record, screen, choice)
        if record.outcome != "stopped":
            _compare(folder, record, screen, found)
        record.write()
    return record


def _specimens(
    folder: Path, loaded: LoadedScene, plan: SpecimenPlan, judges: Judges, record: Record, screen: Screen,
    choice: Choice,
) -> list[OneSpecimen]:  # fmt: skip
    """Specimens that follow the scene to the last step that law and grains share; the record tells of those that fail.

    Raises
    ------
    InputError
        If the packings cannot be made.
    """
    law, _ = scene_fields.ended((folder / LAW, folder / GRAINS))
    material, wanted = loaded.scene.material, judges.specimens or 0
    places = {
        scene_fields.POINTS: law.places - _corner(law),
        scene_fields.NODES: np.asarray(law.mesh.points)[:, :2] - _corner(law),
    }
    task = SpecimenTask(
        0, judges.disks or SPECIMEN_PARTICLES, plan, material.normal_stiffness, material.stiffness_ratio, law.at,
        places, len(law.places),
    )  # fmt: skip
    function = f"{specimen_task.__name__}:{specimen_task.carry_out.__name__}"
    jobs = [
        Job(f"specimen-{seed}", f"specimen {seed}", function, (replace(task, seed=seed),), ("dem",))
        for seed in range(1, wanted + 1)
    ]
    done: dict[str, OneSpecimen | str] = {}

    def follow(job: Job, ended: Ended) -> list[Job]:
        if ended.error is not None:
            done[job.key] = str(ended.error)
        elif ended.value is not None:
            done[job.key] = ended.value
        return []

    with (
        interrupt_request(screen.announce_stop) as stop,
        choice.engine(folder, screen, stop, wanted) as engine,
        screen.progress("specimens", float(wanted)) as advance,
    ):
        screen.say(f"{wanted} specimens; {engine.text}")
        engine.carry_out(jobs, follow, lambda work: advance(len(done) + sum(work.values()), "; ".join(work)), stop)
        if stop.requested and len(done) < wanted:
            record.outcome, record.message = "stopped", "stopped while specimens were compressed"
    # in the order of their seeds, whoever was first
    ended = [(job.text, done[job.key]) for job in jobs if job.key in done]
    found = [one for _, one in ended if isinstance(one, OneSpecimen)]
    lost = [f"{name}: {one}" for name, one in ended if isinstance(one, str)]
    for text in lost:
        screen.say(text, insist=True)
    record.details["specimens"] = {
        "asked": wanted,
        "computed": len(found),
        "disks": [one.disks for one in found],
        "given_up": lost,
        "inertial_number": INERTIAL_NUMBER,
        "kernel": KERNEL,
        "kernel_reach": found[0].reach if found else None,
        "platens": "rough" if plan.is_rough else "smooth",
    }
    if not found and record.outcome != "stopped":
        record.outcome, record.message = "failed", "no specimen could be compressed to the end"
    return found


def _corner(law: scene_fields.Ended) -> Any:
    return np.asarray(law.mesh.points)[:, :2].min(axis=0)


def _compare(folder: Path, record: Record, screen: Screen, found: Sequence[OneSpecimen]) -> None:
    law, grains = scene_fields.ended((folder / LAW, folder / GRAINS))
    rows, columns = scene_fields.table(law, grains), list(scene_fields.COLUMNS)
    maps = None
    if found:
        rows = scene_fields.table_with_specimens(rows, law, grains, found)
        columns += scene_fields.OF_SPECIMENS
        maps = mean_fields(found, scene_fields.NODES)
    files.write_text(folder / TABLE, files.csv_text(columns, rows))
    with record.phase("pictures"):
        scene_picture.draw(folder / PICTURE, law, grains, str(record.scene["title"]), maps)
    record.details["comparison"] = [dict(zip(columns, row)) for row in rows]
    shown = [[row[0], *(f"{value:.4g}" if value != "" else "" for value in row[1:])] for row in rows]
    heads = columns
    if found:  # what fits on a screen; the file has all of it
        heads = ["quantity", "law", "grains", "specimens", "law corr.", "grains corr."]
        shown = [[*row[:3], f"{row[6]} +- {row[7]}" if row[7] else row[6], *row[10:]] for row in shown]
    screen.table(str(record.scene["title"]), heads, shown, ("quantity",))
    told = [name for name in ("law", "grains", "specimens", "measuring") if name in record.timing]
    outside = [entry["name"] for entry in record.details["audit"] if entry.get("fraction", 0.0) > 0.0]
    if outside:
        screen.say(f"the law leaves out more than it may here: {', '.join(outside)} ({folder / LAW / files.RECORD})")
    screen.say(f"{', '.join(f'{name} {record.timing[name]:.3g} s' for name in told)}; results in {folder}")
