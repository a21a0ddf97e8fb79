"""Numbers that are taken from the files of each run: `--result COLUMN[:HOW]`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import InputError, short, unknown
from granfabric.cases.records import files, pore_columns
from granfabric.cases.records.field_history import BODY, COUNTS, NETWORK
from granfabric.cases.scene.material_file import closure_keys, read_material
from granfabric.constitutive.parameters import Material
from granfabric.constitutive.path import POINT_COLUMNS, PORE_COLUMNS, SLIDING_COLUMNS
from granfabric.dem_ref.loading.run import HISTORY_COLUMNS
from granfabric.dem_ref.specimen.history import COLUMNS as COLUMNS_OF_SPECIMEN

Array = NDArray[np.float64]

HOW: dict[str, Callable[[Array], Any]] = {
    "last": lambda values: values[-1],
    "first": lambda values: values[0],
    "max": np.nanmax,
    "min": np.nanmin,
    "mean": np.nanmean,
}
AT = "at"
RATIO = "q/p"
"""A column that no file has and every history gives; of the effective stress, where there is pore fluid."""
FIELD_FAMILIES = ("displacement_", "reaction_", "rigid_", "spring_", "region_")
"""Columns of a field are further these, by boundary or region."""
LOAD_FACTOR = "load_factor"
"""A column of fields in which a displacement leads the loads."""
MATERIAL, TIMING = "material.", "timing."
"""What a DEM run measured, and times of run.json."""

COLUMNS: dict[str, tuple[str, ...]] = {
    "point": (*POINT_COLUMNS, *SLIDING_COLUMNS, *PORE_COLUMNS, RATIO),
    "field": ("step", "fraction", *BODY, *NETWORK, *pore_columns.PORE, *COUNTS, LOAD_FACTOR, RATIO),
    "dem": (*HISTORY_COLUMNS, RATIO),
    "specimen": COLUMNS_OF_SPECIMEN,
}
DEFAULTS = {
    "point": ("coordination", "fabric_anisotropy", "q/p:max"),
    "field": ("coordination", "fabric_anisotropy", "q/p:max"),
    "dem": ("coordination", "fabric_anisotropy", "q/p:max"),
    "specimen": ("coordination", "fabric_anisotropy", "stress_ratio:max"),
}


@dataclass(frozen=True)
class Result:
    """One number of a run.

    Attributes
    ----------
    text : str
        As asked for, the head of its column.
    column : str
        Of history.csv; ``material.KEY`` or ``timing.NAME``.
    how : str
        Of `HOW`, or ``at``.
    other : str
    value : float
        at: where the column `other` reaches this for the first time.
    """

    text: str
    column: str
    how: str = "last"
    other: str = ""
    value: float = math.nan


def result_of(text: str, kind: str) -> Result:
    """What is meant by the text of one `--result`.

    Raises
    ------
    InputError
    """
    column, _, how = text.strip().partition(":")
    if column.startswith((MATERIAL, TIMING)):
        if how:
            raise InputError(f"--result {text}: {column} is one number; nothing comes after it")
        if column.startswith(MATERIAL) and kind != "dem":
            raise InputError(f"--result {text}: only a DEM run measures a material; this is a {kind} scene")
        measured = [variable.name for variable in Material.variables()] + closure_keys()
        if column.startswith(MATERIAL) and column.removeprefix(MATERIAL) not in measured:
            raise InputError(f"--result {text}: {unknown('the key', column.removeprefix(MATERIAL), measured)}")
        return Result(column, column)
    _check_column(text, column, kind)
    if not how or how in HOW:
        return Result(column if how in ("", "last") else f"{column}:{how}", column, how or "last")
    word, _, where = how.partition(":")
    other, equals, number = where.partition("=")
    if word != AT:
        raise InputError(f"--result {text}: {unknown('after the column', word, [*HOW, 'at:COLUMN=VALUE'])}")
    try:
        value = float(number) if equals else math.nan
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"--result {text}: {short(how)} is not of the form at:COLUMN=VALUE, such as at:q/p=0.2")
    _check_column(text, other, kind)
    return Result(f"{column}:at:{other}={number}", column, AT, other, value)


def _check_column(text: str, column: str, kind: str) -> None:
    if column in COLUMNS[kind] or (kind == "field" and column.startswith(FIELD_FAMILIES)):
        return
    if kind == "field" and column == "stage":
        raise InputError(f"--result {text}: the column 'stage' holds words")
    examples = ("displacement_BOUNDARY_x", "reaction_BOUNDARY_x", "rigid_BOUNDARY_force_y", "region_REGION_p")
    families = list(examples) if kind == "field" else []
    legal = [*COLUMNS[kind], *families, f"{TIMING}total", *([f"{MATERIAL}KEY"] if kind == "dem" else [])]
    raise InputError(f"--result {short(text)}: {unknown('the column of history.csv', column, legal)}")


def results_of(texts: Sequence[str], kind: str) -> list[Result]:
    """All results, those that are sensible for the kind of scene if none is asked for.

    Raises
    ------
    InputError
    """
    found = [result_of(text, kind) for text in texts or DEFAULTS[kind]]
    return list({result.text: result for result in found}.values())


def evaluate(folder: Path, results: Sequence[Result]) -> dict[str, float]:
    """Numbers of a run by the text of each result; NaN for what it does not have."""
    columns = _history(folder)
    found = {}
    for result in results:
        try:
            found[result.text] = _one(folder, columns, result)
        except (InputError, ValueError, TypeError, KeyError, OSError):
            found[result.text] = math.nan
    return found


def _history(folder: Path) -> dict[str, Array]:
    try:
        table = files.read_csv(folder / files.HISTORY)
    except (InputError, OSError):
        return {}
    numbers = {
        name: np.array(values, dtype=np.float64)
        for name, values in table.items()
        if values and all(isinstance(value, float) for value in values)
    }
    carried = "effective_p" if "effective_p" in numbers else "p"  # by the grains, as everywhere else
    if carried in numbers and "q" in numbers:
        p, q = numbers[carried], numbers["q"]
        numbers[RATIO] = np.divide(q, p, out=np.full_like(q, math.nan), where=p > 0.0)
    return numbers


def _one(folder: Path, columns: dict[str, Array], result: Result) -> float:
    if result.column.startswith(MATERIAL):
        tables = read_material(folder / files.MATERIAL)
        name = result.column.removeprefix(MATERIAL)
        return float({**tables.get("closure", {}), **tables["material"]}[name])
    if result.column.startswith(TIMING):
        record = files.read_record(folder) or {}
        return float(record["timing"][result.column.removeprefix(TIMING)])
    values = columns[result.column]
    if result.how == AT:
        return first_crossing(columns[result.other], values, result.value)
    return float(HOW[result.how](values))


def first_crossing(other: Array, values: Array, level: float) -> float:
    """Value where `other` reaches a level for the first time, linear between rows; NaN if it never does."""
    before = other - level
    here = np.flatnonzero(before == 0.0)
    between = np.flatnonzero(before[:-1] * before[1:] < 0.0)
    if len(here) and not (len(between) and between[0] < here[0]):
        return float(values[here[0]])
    if not len(between):
        return math.nan
    row = int(between[0])
    share = before[row] / (before[row] - before[row + 1])
    return float(values[row] + share * (values[row + 1] - values[row]))
