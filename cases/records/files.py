"""Result folders and files: whole or not at all."""

from __future__ import annotations

import csv
import io
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from granfabric.cases.errors import InputError
from granfabric.cases.scene.owner import Owner, refuse_another
from granfabric.cases.scene.text_file import EncodingError, read_text

from . import lock

RECORD = "run.json"
HISTORY = "history.csv"
COMPARISON = "closed_form.csv"
MESH_ERROR = "mesh_error.vtu"
SCENE = "scene.toml"
PACKING = "packing.npz"
CHECKPOINT = "checkpoint.npz"
MATERIAL = "material.toml"
FAILED_POINT = "failed_point.toml"
FAILED_PACKING = "failed_point.npz"
"""The packing of a failed point with grains."""
GRAINS = "grains.toml"
"""The scene with grains at its points that a comparison makes."""
OF_DATA = ("fit.csv", "fit.png", "data.csv", "data.png")
OF_SWEEP = ("index.csv", "results.csv", "results.png", "scatter.csv")
PICTURES = (
    *("overview.png", "microvariables.png", "fabric_decomposition.png", "stress_strain.png", "packing.png"),
    *("distributions.png", "scene_comparison.png"),
    *("closed_form.png", "convergence.png", "map.png", *(f"figure_{number}.png" for number in range(1, 7))),
)
TABLES = (
    *("verify.csv", "verify.md", "paths.csv", "probes.csv", "closures.csv", "convergence.csv"),
    *("map.csv", "map_curves.csv", "map.md", "scene_comparison.csv"),
)
LOG = "run.log"
SERIES = ("result", "points", "particles", "contacts", "fields")
OWN_FILES = (
    *(RECORD, HISTORY, LOG, SCENE, FAILED_POINT, FAILED_PACKING, PACKING, CHECKPOINT),
    *(f"{CHECKPOINT}.part", f"{PACKING}.part", GRAINS),
    *(MATERIAL, COMPARISON, MESH_ERROR, *TABLES, *(f"{name}.pvd" for name in SERIES), *PICTURES),
    *OF_DATA,
    *OF_SWEEP,
)
CHECKPOINTS = ("checkpoint_*.npz", ".checkpoint*")
OF_MAP = ("map_*.png", "material_*.toml")
"""A figure for each path of a map, measured inputs of each of its materials."""
PROBES = "probe_*.csv"
OTHER_FORMATS = tuple(
    f"{name[:-4]}.{kind}"
    for name in (*PICTURES, *OF_DATA, *OF_SWEEP)
    if name.endswith(".png")
    for kind in ("pdf", "svg")
)
"""The same pictures as `--format` asks for."""
OWN_PATTERNS = (
    *(*OTHER_FORMATS, "map_*.pdf", "map_*.svg"),
    *(PROBES, ".granfabric-*", ".result*", ".points*"),
    *(*CHECKPOINTS, *OF_MAP, *(f"{name}_*.{kind}" for name in SERIES for kind in ("vtu", "pvtu"))),
)
"""What a run writes; only these are removed when a result folder is used again. Not among them: what `cost` and
`verify` keep of the DEM in `dem`, to be used again, and the studies of `cost`, whose folders nothing else replaces."""

PROGRAM = "granfabric"


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let `write` fill a temporary file beside `path`, then put it in place in one step."""
    handle, name = tempfile.mkstemp(prefix=".granfabric-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        temporary.chmod(0o666 & ~_umask())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def _umask() -> int:
    value = os.umask(0)
    os.umask(value)
    return value


def write_text(path: Path, text: str) -> None:
    """Write a text file in one step."""
    write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write a JSON file in one step; numbers that are not finite are an error."""
    write_text(path, json.dumps(data, indent=2, allow_nan=False) + "\n")


def csv_text(names: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Comma-separated text with a header; floats keep all their digits."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        writer.writerow([repr(float(value)) if isinstance(value, float) else value for value in row])
    return out.getvalue()


def read_rows(path: Path) -> tuple[list[str], list[list[str]]]:
    """First line and the others of comma-separated text, as it stands there.

    Raises
    ------
    EncodingError, OSError, csv.Error
    """
    reader = csv.reader(io.StringIO(read_text(path), newline=""))
    return next(reader, []), [row for row in reader if row]


def read_json(path: Path) -> Any:
    """Content of a JSON file.

    Raises
    ------
    EncodingError, OSError, ValueError, RecursionError
    """
    return json.loads(read_text(path))


def read_csv(path: Path) -> dict[str, list[Any]]:
    """Columns of a file written by `csv_text`; numbers become floats, anything else stays text.

    Raises
    ------
    InputError
        If the file is damaged.
    """
    try:
        names, rows = read_rows(path)
    except EncodingError:
        raise
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path} cannot be read: {error}") from error
    for number, row in enumerate(rows, start=2):
        if len(row) != len(names):
            raise InputError(f"{path}, line {number} has {len(row)} entries, the first line {len(names)}")
    return {name: [_number(row[place]) for row in rows] for place, name in enumerate(names)}


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def read_record(folder: Path) -> dict[str, Any] | None:
    """The `run.json` of a folder if it is one of ours, else None."""
    try:
        data = read_json(folder / RECORD)
    except (OSError, ValueError, RecursionError):
        return None
    return data if isinstance(data, dict) and data.get("program") == PROGRAM else None


def whole_record(folder: Path) -> dict[str, Any] | None:
    """The `run.json` of a folder if it is one of ours and holds what a run writes, else None.

    Raises
    ------
    EncodingError
        If it is saved in another encoding than UTF-8.
    """
    data = read_record(folder)
    if data is None and (folder / RECORD).is_file():
        with suppress(OSError):
            read_text(folder / RECORD)  # says what it is saved as if that is the reason
    parts = {"kind": str, "outcome": str, "message": str, "scene": dict, "timing": dict, "versions": dict}
    return data if data and all(isinstance(data.get(name), kind) for name, kind in parts.items()) else None


def check_output(folder: Path, owner: Owner | None = None, overwrite: bool = False) -> None:
    """Refuse a folder that cannot be written, holds somebody else's files or another run. Nothing is changed.

    A folder may be new, empty, or hold an earlier run (a `run.json` of ours) of the same scene, which is then replaced.

    Parameters
    ----------
    folder : Path
    owner : Owner, optional
        What is going to be written there; if not given, any earlier run may be replaced.
    overwrite : bool
        Results of another scene may be replaced.

    Raises
    ------
    InputError
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"the output folder {str(folder)!r} is a file; choose another with -o")
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise InputError(f"the output folder {str(folder)!r} cannot be made: {str(existing)!r} is a file")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise InputError(f"the output folder {str(folder)!r} cannot be written: {str(existing)!r} is write-protected")
    if not folder.is_dir():
        return
    lock.refuse_held(folder)
    record = read_record(folder)
    # the lock is what a run leaves that was killed before it wrote its record
    if record is None and any(file.name != lock.NAME for file in folder.iterdir()):
        raise InputError(
            f"the output folder {str(folder)!r} holds files that are not a result of {PROGRAM}; "
            "choose a new or empty folder with -o"
        )
    if record is not None and owner is not None and not overwrite:
        refuse_another(folder, record, owner)


def prepare_output(folder: Path, owner: Owner | None = None, overwrite: bool = False) -> None:
    """Make the folder, see that it can be written, and remove the files of an earlier run; see `check_output`.

    Raises
    ------
    InputError
        If the folder cannot be made or written, or must not be replaced.
    """
    check_output(folder, owner, overwrite)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        for pattern in OWN_PATTERNS:
            for file in folder.glob(pattern):
                file.unlink()
        # The record goes last: as long as it is there, the folder can be told to be ours.
        for name in reversed(OWN_FILES):
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"the output folder {str(folder)!r} cannot be written: {error.strerror}") from error


@contextmanager
def held(folder: Path, owner: Owner | None = None, overwrite: bool = False, resume: bool = False) -> Iterator[None]:
    """Keep other runs out of a result folder within the block, see `lock.held`; it is made if it does not exist.

    Whose results are in there is looked at again once nobody else can change it.

    Raises
    ------
    InputError
        If another run is at work there, or the folder cannot be made or must not be replaced.
    """
    made = not folder.exists()
    check_output(folder, owner, overwrite or resume)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"the output folder {str(folder)!r} cannot be written: {error.strerror}") from error
    with lock.held(folder):
        if not made:
            check_output(folder, owner, overwrite or resume)
        yield


def remove_unfinished(folder: Path) -> None:
    """Remove what a run that was killed left of files that it had not finished, and its record of a failure.

    Raises
    ------
    InputError
        If the folder cannot be written.
    """
    try:
        for pattern in (".granfabric-*", ".result*", ".points*", ".checkpoint*", FAILED_POINT, FAILED_PACKING):
            for file in folder.glob(pattern):
                file.unlink()
    except OSError as error:
        raise InputError(f"the output folder {str(folder)!r} cannot be written: {error.strerror}") from error
