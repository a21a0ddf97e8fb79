"""Pictures of a run from its files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from granfabric.cases.errors import InputError
from granfabric.cases.records import files
from granfabric.cases.records.field_history import MEANS
from granfabric.cases.scene.reader import check
from granfabric.cases.scene.schema import MODELS
from granfabric.constitutive.path import POINT_COLUMNS
from granfabric.dem_ref.loading.run import HISTORY_COLUMNS
from granfabric.dem_ref.sample.disks import SampleError
from granfabric.dem_ref.specimen.history import COLUMNS

from . import formats

DATA_TABLES = {"fit": "fit.csv", "data": "data.csv"}
"""Table from which a fit, or a comparison with a user's curves, is drawn."""
DATA_NUMBERS = ("p", "stress_ratio", "data", "law", "deviation")


def draw_folder(folder: Path) -> list[Path]:
    """Make the pictures of a result folder anew; their files in the chosen formats.

    Raises
    ------
    InputError
        If the folder is not a result of ours, or nothing was computed yet.
    """
    return [file for picture in _draw_folder(folder) for file in formats.paths(picture)]


def _draw_folder(folder: Path) -> list[Path]:
    record = files.whole_record(folder)
    if record is None:
        raise InputError(f"{str(folder)!r} is not a result folder: it has no {files.RECORD} of {files.PROGRAM}")
    if record["kind"] == "verify":
        raise InputError(
            f"{str(folder)!r} holds a comparison; `granfabric verify -o {folder}` draws it anew from the DEM runs "
            "there, a map with the options that run.log begins with"
        )
    if record["kind"] in DATA_TABLES:
        return _draw_data(folder, record)
    if record["kind"] == "measure":
        from .dem import draw_packing

        try:
            return draw_packing(folder, record["scene"])
        except SampleError as error:
            raise InputError(str(error)) from error
    if record["kind"] not in MODELS or record["scene"].get("kind") != record["kind"]:
        raise InputError(f"{str(folder)!r} holds a result of the kind {record['kind']!r}, which has no pictures")
    check(record["scene"], folder / files.RECORD)
    if not (folder / files.HISTORY).is_file():
        raise InputError(f"{str(folder)!r} holds no {files.HISTORY}: nothing was computed before the run ended")
    _check_history(folder, record["kind"])
    try:
        return draw(folder, record["scene"])
    except SampleError as error:
        raise InputError(str(error)) from error


def _draw_data(folder: Path, record: dict[str, Any]) -> list[Path]:
    """The picture of a law along a user's curves."""
    from .data import draw_data

    name = DATA_TABLES[record["kind"]]
    if not (folder / name).is_file():
        raise InputError(f"{str(folder)!r} holds no {name}")
    table = files.read_csv(folder / name)
    for column in ("curve", "quantity", *DATA_NUMBERS):
        if column not in table or not table[column]:
            raise InputError(f"{folder / name} has no column {column!r}, or nothing in it")
        if column in DATA_NUMBERS and not all(isinstance(value, float) for value in table[column]):
            raise InputError(f"{folder / name}: the column {column!r} holds something that is not a number")
    title = record["scene"].get("title")
    return draw_data(folder, name, title if isinstance(title, str) else name)


def _check_history(folder: Path, kind: str) -> None:
    """See that the history has the columns that are drawn, and numbers in them."""
    table = files.read_csv(folder / files.HISTORY)
    of_dem = {"dem": HISTORY_COLUMNS, "specimen": COLUMNS}
    needed = {"point": POINT_COLUMNS, **of_dem, "field": ("step", "stage", *MEANS)}[kind]
    for name in needed:
        if name not in table:
            raise InputError(f"{folder / files.HISTORY} has no column {name!r}")
        if name != "stage" and not all(isinstance(value, float) and math.isfinite(value) for value in table[name]):
            raise InputError(f"{folder / files.HISTORY}: the column {name!r} holds something that is not a number")


def draw(folder: Path, scene: dict[str, Any]) -> list[Path]:
    """Make the pictures that belong to the kind of scene.

    Parameters
    ----------
    folder : Path
        Holds `history.csv` and, for fields, the files that `result.pvd` and `points.pvd` name.
    scene : dict
        The scene as resolved.

    Returns
    -------
    list of Path
    """
    table = files.read_csv(folder / files.HISTORY)
    if not table or not next(iter(table.values())):
        return []
    columns = {name: np.array(values) for name, values in table.items()}
    if scene["kind"] == "point":
        from .point import draw_point

        return draw_point(folder, columns, scene)
    if scene["kind"] == "dem":
        from .dem import draw_dem

        return draw_dem(folder, columns, scene)
    if scene["kind"] == "specimen":
        from .specimen import draw_specimen

        return draw_specimen(folder, columns, scene)
    from .field import draw_field

    pictures = draw_field(folder, columns, scene)
    if (folder / files.COMPARISON).is_file():
        from .comparison import draw_comparison

        pictures += draw_comparison(folder, scene)
    return pictures
