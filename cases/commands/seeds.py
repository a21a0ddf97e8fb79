"""A DEM scene on several packings: `granfabric dem SCENE --seeds K`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from granfabric.cases.engine.choice import Choice
from granfabric.cases.errors import InputError
from granfabric.cases.records import files
from granfabric.cases.records.record import Record
from granfabric.cases.scene.material_file import material_text
from granfabric.cases.scene.measured import as_data, from_data, mean_of
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.sweep.plan import Plan, Request
from granfabric.cases.sweep.record import State
from granfabric.cases.terminal.screen import Screen
from granfabric.dem_ref.ensemble import scatter_at_stress_ratios

from .sweep import Sweep, run_sweep

MOST_SEEDS = 100_000
SEED = "packing.seed"
SCATTER = "scatter.csv"
LEVELS = 13
"""Stress ratios from 0 on at which the packings are compared."""


def refuse_without_seeds(choice: Choice) -> None:
    """Refuse workers for one packing.

    Raises
    ------
    InputError
    """
    if choice.workers is not None or choice.scheduler is not None:
        option = "--workers" if choice.workers is not None else "--scheduler"
        raise InputError(f"{option} goes with --seeds K: one packing is one piece of work")


def run_seeds(
    loaded: LoadedScene,
    scene: str,
    assignments: Sequence[str],
    seeds: int,
    folder: Path,
    screen: Screen,
    resume: bool,
    overwrite: bool,
    choice: Choice,
) -> Record:
    """Compute the scene on packings of several seeds; mean and scatter of their histories and measured inputs.

    Parameters
    ----------
    loaded : LoadedScene
        Of kind "dem"; its seed is the first.
    scene : str
    assignments : sequence of str
    seeds : int
    folder : Path
        A folder in it for each packing.
    screen : Screen
    resume, overwrite : bool
        As of a sweep.
    choice : Choice

    Raises
    ------
    InputError, RunError
        As `run_sweep`.
    """
    if loaded.scene.kind == "specimen":
        raise InputError(
            f"--seeds is of periodic packings; granfabric sweep {loaded.called} --set {SEED}=1,2,3 computes specimens"
        )
    loaded.require("dem")
    if not 2 <= seeds <= MOST_SEEDS:
        raise InputError(f"--seeds {seeds} is outside [2, {MOST_SEEDS}]")
    first = loaded.scene.packing.seed
    values = ",".join(str(first + place) for place in range(seeds))
    others = [text for text in assignments if text.partition("=")[0].strip() != SEED]
    request = Request([*others, f"{SEED}={values}"])

    def conclude(record: Record, plan: Plan, states: dict[str, State]) -> None:
        whole = [run.name for run in plan.runs if states[run.name].outcome == "finished"]
        if whole:
            _means(folder, record, whole, screen)

    return run_sweep(Sweep(scene, request, (), False, choice), folder, screen, resume, overwrite, conclude)


def _means(folder: Path, record: Record, names: Sequence[str], screen: Screen) -> None:
    """Mean and scatter of the packings: `scatter.csv` at stress ratios, `material.toml`."""
    records = [files.read_record(folder / name) or {} for name in names]
    measured = [from_data(data["measured"]) for data in records if data.get("measured")]
    many = f"mean of {len(measured)} packings" if len(measured) > 1 else "one packing"
    if measured:
        mean = mean_of(measured)
        text = material_text(mean.values, f"{record.scene['title']}, {many}", mean.errors, mean.missing)
        files.write_text(folder / files.MATERIAL, text)
        record.details["measured"] = as_data(mean)
    histories: list[dict[str, Any]] = []
    for name in names:
        table = files.read_csv(folder / name / files.HISTORY)
        histories.append({column: np.array(values) for column, values in table.items()})
    highest = max(float((history["q"] / np.maximum(history["p"], 1e-300)).max()) for history in histories)
    levels = np.linspace(0.0, highest, LEVELS)
    scatter = scatter_at_stress_ratios(histories, levels.tolist())
    columns = [name for name in scatter if name not in ("step", "dem_steps", "segment")]
    heads = ["stress_ratio", "packings"]
    heads += [f"{name}{part}" for name in columns for part in ("", "_scatter")]
    rows = [
        [
            *(float(level), int(scatter[columns[0]].samples[place])),
            *(_cell(values[place]) for name in columns for values in (scatter[name].mean, scatter[name].deviation)),
        ]
        for place, level in enumerate(levels)
    ]
    files.write_text(folder / SCATTER, files.csv_text(heads, rows))
    screen.say(f"means of {len(names)} packings in {SCATTER}" + (f", inputs in {files.MATERIAL}" if measured else ""))


def _cell(value: float) -> Any:
    return float(value) if np.isfinite(value) else ""
