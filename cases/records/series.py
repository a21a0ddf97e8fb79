"""Reading back what a run wrote for ParaView."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import meshio
import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import InputError
from granfabric.fem.mesh.foreign_files import ForeignFileError, foreign_reader
from granfabric.fem.output.cells import joined
from granfabric.fem.output.merged_pieces import merged
from granfabric.fem.output.series_files import pieces_of

Array = NDArray[np.float64]

DRAWN = ("coordination", "fabric_anisotropy", "stress", "displacement")


def last_file(folder: Path, series: str) -> Path | None:
    """The last file that ``SERIES.pvd`` names; None if there is no series yet.

    Raises
    ------
    InputError
        If the series is damaged or names a file that is gone.
    """
    return _file(folder, series, -1)


def first_file(folder: Path, series: str) -> Path | None:
    """The first file that ``SERIES.pvd`` names; see `last_file`."""
    return _file(folder, series, 0)


def _names(folder: Path, series: str) -> list[str]:
    """Files that ``SERIES.pvd`` names; none if there is no series yet."""
    path = folder / f"{series}.pvd"
    if not path.is_file():
        return []
    try:
        return [entry.attrib["file"] for entry in ElementTree.parse(path).getroot().iter("DataSet")]
    except (ElementTree.ParseError, KeyError) as error:
        raise InputError(f"{path} is damaged") from error


def _checked(folder: Path, series: str, name: str) -> Path:
    path = folder / f"{series}.pvd"
    if not re.fullmatch(rf"{series}_\d{{1,9}}\.p?vtu", name):
        raise InputError(f"{path} is damaged: it names {name!r}")
    file = folder / name
    if not file.is_file():
        raise InputError(f"{path} names {name!r}, which does not exist")
    return file


def _file(folder: Path, series: str, place: int) -> Path | None:
    names = _names(folder, series)
    return _checked(folder, series, names[place]) if names else None


def steps(folder: Path, series: str) -> dict[int, Path]:
    """Every file that ``SERIES.pvd`` names, by the number of its step.

    Raises
    ------
    InputError
        If the series is damaged or names a file that is gone.
    """
    files = [_checked(folder, series, name) for name in _names(folder, series)]
    return {int(file.stem.rpartition("_")[2]): file for file in files}


def read(file: Path, required: Sequence[str] = DRAWN) -> Any:
    """Content of a `.vtu` as a meshio mesh; of a `.pvtu` that of its pieces as if it had been written in one.

    Parameters
    ----------
    file : Path
    required : sequence of str
        Fields that it has to hold, finite, at every point; those that are drawn if not given.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    try:
        pieces = [file] if file.suffix == ".vtu" else pieces_of(file)
        parts = []
        for piece in pieces:
            with foreign_reader(piece.stat().st_size):
                parts.append(meshio.vtu.read(str(piece)))
        if not parts:
            raise ValueError("it names no pieces")
        mesh = parts[0] if file.suffix == ".vtu" else merged(parts)
    except (ForeignFileError, OSError, ValueError) as error:
        raise InputError(f"{file} cannot be read: {error}") from error
    count = len(mesh.points)
    points = np.asarray(mesh.points)
    if points.shape != (count, 3) or points.dtype != np.float64 or not (np.isfinite(points).all() and count):
        raise InputError(f"{file} is damaged: its points are not plain coordinates")
    for block in mesh.cells:
        if len(block.data) and not (0 <= block.data.min() <= block.data.max() < count):
            raise InputError(f"{file} is damaged: a cell names a point that is not there")
    for name in required:
        values = np.asarray(mesh.point_data.get(name))
        if values.dtype != np.float64 or len(values) != count or not np.isfinite(values).all():
            raise InputError(f"{file} is damaged: the field {name!r} is missing or not finite")
    return mesh


_PIECES: dict[str, list[tuple[int, int, int]]] = {
    "triangle": [(0, 1, 2)],
    "triangle6": [(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)],
    "quad": [(0, 1, 2), (0, 2, 3)],
    "quad9": [
        *((0, 4, 8), (0, 8, 7), (4, 1, 5), (4, 5, 8)),
        *((8, 5, 2), (8, 2, 6), (7, 8, 6), (7, 6, 3)),
    ],
}


def elements(mesh: Any) -> tuple[str, NDArray[np.int64]]:
    """Kind and nodes of the elements, also of those that stand in the file cut into straight pieces.

    Raises
    ------
    ValueError
        If the file does not hold elements of one kind.
    """
    return joined(mesh.cells, mesh.cell_data.get("element"))


def triangles(mesh: Any) -> NDArray[np.int64]:
    """All cells cut into triangles of three nodes, shape (n, 3); cells of second order into four or eight."""
    parts = [block.data[:, list(corners)] for block in mesh.cells for corners in _PIECES.get(block.type, [])]
    return np.concatenate(parts).astype(np.int64) if parts else np.zeros((0, 3), dtype=np.int64)


def of_triangles(mesh: Any, name: str) -> NDArray | None:
    """Field of the cells for each of `triangles`; None if the file does not have it."""
    if name not in mesh.cell_data:
        return None
    parts = [np.tile(data, len(_PIECES.get(block.type, []))) for block, data in zip(mesh.cells, mesh.cell_data[name])]
    return np.concatenate(parts)
