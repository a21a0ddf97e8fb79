"""Inputs of the point law from a packing of another code: `granfabric measure`."""

from __future__ import annotations

import re
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from granfabric.cases.errors import InputError, RunError
from granfabric.cases.records import files
from granfabric.cases.records.record import Record, versions
from granfabric.cases.scene.material_file import material_text
from granfabric.cases.scene.measured import as_data, from_data, measure_inputs, refused
from granfabric.cases.scene.owner import Owner
from granfabric.cases.terminal.compile_watch import CompileWatch, watching
from granfabric.cases.terminal.screen import Screen
from granfabric.dem_ref.dynamics.motion import UnstableMotionError
from granfabric.dem_ref.exchange.assemble import Imported, summary
from granfabric.dem_ref.exchange.files import import_packing
from granfabric.dem_ref.inputs.material import ISOTROPIC
from granfabric.dem_ref.inputs.probes import ProbeError
from granfabric.dem_ref.loading.legs import stress_invariants
from granfabric.dem_ref.measures.contacts import contacts_of, coordination_number, love_weber_stress, unbalanced_force
from granfabric.dem_ref.sample.disks import Sample, SampleError, save_sample
from granfabric.dem_ref.sample.neighbours import CellTooSmallError

from .dem import COMPILATION_SECONDS, doubts, resting

LEAST_HELD = 0.5
"""Fraction of the disks that bear forces in a packing; of very loose ones a quarter does not."""
LEAST_SOLID = 0.6
"""Solid fraction below which disks that touch are a heap in an empty cell."""
FEWEST = 50
"""Disks below which nothing is measured."""
TABLE = (
    "coordination", "solid_fraction", "normal_stiffness", "stiffness_ratio", "force_density_at_zero",
    "gap_density_at_zero", "neighbours", "bulk_reduction", "shear_reduction", "isostatic_coordination",
)  # fmt: skip
"""Values that are shown on the screen; all are in `material.toml`."""


def run_measure(
    path: Path,
    given: dict[str, Any],
    folder: Path,
    screen: Screen,
    rattlers: str,
    loop_stress_ratio: float,
    overwrite: bool = False,
) -> Record:
    """Import a packing and measure the inputs of the point law on it.

    Parameters
    ----------
    path : Path
        File of the disks.
    given : dict
        Further arguments of `import_packing`.
    folder : Path
        Result folder: new, empty, or of an earlier measurement of the same file, which is replaced.
    screen : Screen
    rattlers : str
        Counting of the coordination number.
    loop_stress_ratio : float
        q/p of the loops.
    overwrite : bool
        Replace results of another scene too.

    Returns
    -------
    Record

    Raises
    ------
    InputError
        If the file is no packing that can be measured, or the folder cannot be used; then nothing was written.
    RunError
        If the results could not be written.
    """
    title = f"Packing {path.name}"
    owner = Owner("measure", path.stem, title, path)
    files.check_output(folder, owner, overwrite)
    imported = _imported(path, given)
    scene: dict[str, Any] = {"title": title, "kind": "measure", "file": str(path.resolve()), "format": imported.format}
    scene |= {name: _plain(value) for name, value in given.items() if value not in (None, False)}
    scene |= {"rattlers": rattlers, "loop_stress_ratio": loop_stress_ratio}
    record = Record(folder, path.stem, scene, is_scene=False, scene_file=owner.place)
    record.details["remarks"] = imported.remarks
    with watching(screen.announce_compilation(COMPILATION_SECONDS)) as watch, ExitStack() as hold:
        hold.enter_context(files.held(folder, owner, overwrite))
        files.prepare_output(folder, owner, overwrite)
        record.write()
        screen.keep_log(folder / files.LOG, versions())
        for line in imported.remarks:
            screen.say(line)
        screen.say(summary(imported.sample))
        try:
            sample = resting(imported.sample, record, screen)
            _measure(sample, record, screen, watch, rattlers, loop_stress_ratio)
            record.outcome = "finished"
        except (CellTooSmallError, SampleError, ProbeError, UnstableMotionError) as error:
            record.outcome, record.message = "failed", str(error)
        except KeyboardInterrupt as error:
            raise record.broken_off("interrupted") from error
        except OSError as error:
            raise record.broken_off(f"results cannot be written any more: {error}") from error
    record.timing["compilation"] = watch.seconds
    record.write()
    if record.outcome == "finished":
        from granfabric.cases.pictures.dem import draw_packing

        try:
            with record.phase("pictures"):
                draw_packing(folder, scene)
        except KeyboardInterrupt as error:
            raise RunError(f"interrupted while drawing; `granfabric plot {folder}` makes the pictures") from error
        record.write()
    _report(record, screen)
    return record


def _imported(path: Path, given: dict[str, Any]) -> Imported:
    """The packing of a file, if it is one that can be measured."""
    try:
        imported = import_packing(path, **given)
    except (SampleError, CellTooSmallError) as error:
        raise InputError(str(error)) from error
    sample = imported.sample
    if sample.count < FEWEST:
        raise InputError(f"{path}: {sample.count} disks; measured are packings of {FEWEST} and more")
    contacts = contacts_of(sample)
    p, q, _ = stress_invariants(love_weber_stress(sample, contacts))
    if not p > 0.0:
        raise InputError(
            f"{path}: no pressure, {contacts.count} contacts among {sample.count} disks that fill "
            f"{100 * sample.solid_fraction:.3g} % of the cell; are radii taken for diameters, or is the cell too large?"
        )
    share = 1.0 - coordination_number(sample, contacts).rattler_fraction
    if share < LEAST_HELD or sample.solid_fraction < LEAST_SOLID:
        raise InputError(
            f"{path}: no packing under pressure: the disks fill {100 * sample.solid_fraction:.3g} % of the cell, and "
            f"{100 * share:.3g} % of them bear forces; is the cell too large, or another unit meant?"
        )
    if q > ISOTROPIC * p:
        missing = "" if imported.forces_given else " (tangential forces were not given; with them it may be less)"
        raise InputError(
            f"{path}: q/p = {q / p:.3g}{missing}, but the inputs are measured on an isotropic packing, q/p up to "
            f"{ISOTROPIC:g}; take the state before the loading"
        )
    return imported


def _plain(value: Any) -> Any:
    return str(value) if isinstance(value, Path) else value


def _measure(
    sample: Sample, record: Record, screen: Screen, watch: CompileWatch, rattlers: str, loop_stress_ratio: float
) -> None:
    """Write the packing and `material.toml`."""
    contacts = contacts_of(sample)
    z = coordination_number(sample, contacts)
    ratio = np.abs(contacts.tangential_force) / contacts.normal_force
    record.details["packing"] = {
        "particles": sample.count,
        "contacts": contacts.count,
        "void_ratio": sample.void_ratio,
        "coordination": z.all_particles,
        "coordination_without_rattlers": z.without_rattlers,
        "unbalanced_force": unbalanced_force(sample, contacts),
        "pressure": float(stress_invariants(love_weber_stress(sample, contacts))[0]),
        "largest_tangential_force_ratio": float(ratio.max()),
    }
    save_sample(record.folder / files.PACKING, sample)
    with screen.progress("measuring", 1.0) as advance, record.phase("measuring", watch):
        advance(0.0, "probes and a loop on copies of the packing")
        measured = measure_inputs(sample, rattlers, loop_stress_ratio)
    text = material_text(measured.values, record.scene["title"], measured.errors, measured.missing)
    files.write_text(record.folder / files.MATERIAL, text)
    record.details["material"] = files.MATERIAL
    record.details["measured"] = as_data(measured)


def _report(record: Record, screen: Screen) -> None:
    measured = from_data(record.details.get("measured"))
    if record.outcome != "finished":
        screen.say(f"{record.outcome}: {record.message}", insist=True)
        screen.say(f"results in {record.folder}")
        return
    rows = [
        [name, f"{measured.values[name]:.4g}", f"{measured.errors[name]:.2g}"]
        for name in TABLE
        if name in measured.values
    ]
    screen.table(record.scene["title"], ["input", "value", "standard error"], rows)
    packing = record.details["packing"]
    screen.say(
        f"{packing['particles']} disks, void ratio {packing['void_ratio']:.4f}, z {packing['coordination']:.3f} "
        f"({packing['coordination_without_rattlers']:.3f} without rattlers), p {packing['pressure']:.4g} Pa"
    )
    doubtful = doubts(measured)
    for line in doubtful:
        screen.say(f"{files.MATERIAL}: {line}", insist=True)
    illegal = refused(measured)
    warned = f"; the law will refuse {', '.join(illegal)}" if illegal else ""
    screen.say(
        f"measuring {record.timing.get('measuring', 0.0):.1f} s; results in {record.folder}{warned}\n"
        f"to use them: --set material_file={record.folder / files.MATERIAL}"
    )


def cell_from(text: str) -> list[float]:
    """Numbers of the option ``--cell``.

    Raises
    ------
    InputError
    """
    tokens = [token for token in re.split(r"[\s,;\[\]()]+", text) if token]
    try:
        numbers = [float(token) for token in tokens]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 4):
        raise InputError(
            f"--cell {text!r} is not legal; wanted are width and height, or both lattice vectors: a_x a_y b_x b_y"
        )
    return numbers
