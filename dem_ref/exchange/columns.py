"""Named columns of disks and of contacts, whichever file they come from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import SampleError

from .raw import ALIASES, FORCE_COLUMNS, RawContacts, RawDisks
from .text import TextFile, significant_digits

Rows = list[tuple[int, list[str]]]
"""Line number, from 1, and tokens of each row."""

DISK_NAMES = {"r": "radius", "rad": "radius", "d": "diameter", "number": "id"}
ALONG = {"x": ("x", "xu"), "y": ("y", "yu"), "z": ("z", "zu")}
SCALED = ("xs", "ys", "xsu", "ysu")
FLAT = 1e-6
"""Largest spread of the third coordinate, over the mean radius, of disks in a plane."""


def disk_columns(names: Sequence[str]) -> list[str]:
    """Names of columns as they are known here."""
    plain = [name.strip().lower() for name in names]
    return [DISK_NAMES.get(name, name) for name in plain]


def contact_columns(names: Sequence[str]) -> list[str]:
    """Names of columns of contacts as they are known here."""
    plain = [name.strip().lower() for name in names]
    return [ALIASES.get(name, name) for name in plain]


def _refuse_twice(file: TextFile, line: int, names: Sequence[str], known: Sequence[str]) -> None:
    for name in known:
        if names.count(name) > 1:
            raise file.error(line, f"the column {name!r} stands there {names.count(name)} times")


def _column(file: TextFile, rows: Rows, place: int, name: str, positive: bool = False) -> NDArray[np.float64]:
    return np.array([file.number(tokens[place], line, name, positive) for line, tokens in rows], dtype=np.float64)


def disks_of(
    file: TextFile, header: int, given: Sequence[str], rows: Rows, cell: NDArray[np.float64] | None = None
) -> tuple[RawDisks, str]:
    """Disks from rows of tokens; the plane in which they lie is ``"xy"``, ``"xz"`` or ``"yz"``.

    Parameters
    ----------
    file : TextFile
    header : int
        Line of the names.
    given : sequence of str
        Names of the columns; those that are not known are passed over.
    rows : list
        Line number and tokens of each row.
    cell : (2, 2) ndarray, optional
        For scaled coordinates.

    Raises
    ------
    SampleError
    """
    names = disk_columns(given)
    known = ("id", "radius", "diameter", *ALONG["x"], *ALONG["y"], *ALONG["z"], *SCALED)
    _refuse_twice(file, header, names, known)
    if not rows:
        raise SampleError(f"{file.origin}: no disks")
    for line, tokens in rows:
        file.row(tokens, line, given)
    if ("radius" in names) == ("diameter" in names):
        said = "both a radius and a diameter" if "radius" in names else "neither a radius nor a diameter"
        raise file.error(header, f"{said} among the columns ({', '.join(given)}); one of them is wanted")
    size = "radius" if "radius" in names else "diameter"
    sizes = _column(file, rows, names.index(size), size, positive=True)
    radius = sizes if size == "radius" else 0.5 * sizes
    position, digits, plane = _positions(file, header, given, names, rows, radius, cell)
    numbered = "id" in names
    lines = np.array([line for line, _ in rows], dtype=np.int64)
    identity = np.arange(1, len(rows) + 1, dtype=np.int64)
    if numbered:
        place = names.index("id")
        identity = np.array([file.whole(tokens[place], line, "id", 0) for line, tokens in rows], dtype=np.int64)
    order = np.argsort(identity, kind="stable")
    twice = np.flatnonzero(np.diff(identity[order]) == 0)
    if len(twice):
        raise file.error(
            int(lines[order[twice[0] + 1]]),
            f"id = {identity[order[twice[0]]]} stands in line {lines[order[twice[0]]]} already",
        )
    return (
        RawDisks(
            file.origin, identity[order], numbered, lines[order], position[order], radius[order], digits=digits
        ),
        plane,
    )


def _positions(
    file: TextFile, header: int, given: Sequence[str], names: list[str], rows: Rows, radius: NDArray[np.float64],
    cell: NDArray[np.float64] | None,
) -> tuple[NDArray[np.float64], int, str]:  # fmt: skip
    found = {axis: next((name for name in choices if name in names), None) for axis, choices in ALONG.items()}
    columns = {
        axis: _column(file, rows, names.index(name), name) for axis, name in found.items() if name is not None
    }
    if len(columns) == 3:
        flat = FLAT * float(radius.mean())
        spread = {axis: float(np.ptp(values)) for axis, values in columns.items()}
        across = next((axis for axis in "zyx" if spread[axis] <= flat), None)
        if across is None:
            raise SampleError(
                f"{file.origin}: a packing in space, z from {columns['z'].min():.6g} to {columns['z'].max():.6g}; "
                "wanted are disks in a plane, one coordinate the same for all"
            )
        del columns[across]
    if len(columns) == 2:
        plane = "".join(sorted(columns))
        tokens = [found[axis] for axis in plane]
        digits = max(significant_digits(row[names.index(str(name))]) for _, row in rows for name in tokens)
        return np.column_stack([columns[axis] for axis in plane]), digits, plane
    for pair in (("xs", "ys"), ("xsu", "ysu")):
        if all(name in names for name in pair) and cell is not None:
            reduced = np.column_stack([_column(file, rows, names.index(name), name) for name in pair])
            digits = max(significant_digits(row[names.index(name)]) for _, row in rows for name in pair)
            return reduced @ cell, digits, "xy"
    missing = [axis for axis in "xy" if axis not in columns]
    raise file.error(
        header, f"no column {' and '.join(missing)} among the columns ({', '.join(given)}); wanted are x, y and r"
    )


def contacts_of_rows(file: TextFile, header: int, given: Sequence[str], rows: Rows) -> RawContacts:
    """Contacts from rows of tokens.

    Raises
    ------
    SampleError
    """
    names = contact_columns(given)
    _refuse_twice(file, header, names, ("id1", "id2", *FORCE_COLUMNS))
    missing = [name for name in ("id1", "id2") if name not in names]
    if missing:
        legal = ", ".join(["id1", "id2", *FORCE_COLUMNS])
        raise file.error(
            header,
            f"no column {' and '.join(missing)} among the columns ({', '.join(given)}); known names are {legal}; "
            "columns of other names are given their meaning by contact_columns, '-' for what is not wanted",
        )
    for pair in (("fn_x", "fn_y"), ("ft_x", "ft_y"), ("ft1_x", "ft1_y")):
        if (pair[0] in names) != (pair[1] in names):
            raise file.error(header, f"of the columns {pair[0]} and {pair[1]} only one is there; both are needed")
    for line, tokens in rows:
        file.row(tokens, line, given)
    at = {name: names.index(name) for name in ("id1", "id2", *FORCE_COLUMNS) if name in names}
    first, second = (
        np.array([file.whole(tokens[at[name]], line, name, 0) for line, tokens in rows], dtype=np.int64)
        for name in ("id1", "id2")
    )
    columns = {name: _column(file, rows, at[name], name) for name in FORCE_COLUMNS if name in at}
    return RawContacts(file.origin, np.array([line for line, _ in rows], dtype=np.int64), first, second, columns)
