"""A user's curve from a CSV file, or from columns in memory: legal names, units, one sentence on what is wrong."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import InputError, nearest, several, short
from granfabric.cases.scene.text_file import decoded

from .columns import BY_NAME, ERROR, HEAD, LEGAL, PASSED_OVER, UNITS, legal_names

Array = NDArray[np.float64]

LARGEST_FILE = 50_000_000
MOST_ROWS = 20_000
LARGEST = 1e300
MISSING = ("", "nan", "na", "-")
"""Cells without a value, in small letters; legal where a column is only compared."""


@dataclass(frozen=True)
class Curve:
    """Columns of one curve.

    Attributes
    ----------
    name : str
        Of the file, without folder.
    lines : list of int
        Line of the file in which each row stands.
    columns : dict of str to ndarray, shape (nrows,)
        In SI units; NaN where a cell is empty.
    errors : dict of str to ndarray, shape (nrows,)
        Standard errors by the name of the column they belong to.
    notes : list of str
        What was passed over.
    place : str
        The file as it was given, for sentences.
    """

    name: str
    lines: list[int]
    columns: dict[str, Array]
    errors: dict[str, Array] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    place: str = ""

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.lines)

    def where(self, row: int, column: str) -> str:
        """Beginning of a sentence on one value."""
        return f"{self.place}, line {self.lines[row]}, column {column}"

    def shown(self, row: int, column: str) -> str:
        """One value, for a sentence."""
        return f"{self.columns[column][row]:g}"


def read_curve(file: Path) -> Curve:
    """Read a curve.

    Raises
    ------
    InputError
        A sentence on every error (up to some), with file, line, column and value.
    """
    try:
        if file.exists() and not file.is_file():
            raise OSError(0, "it is a folder, a device or a pipe")
        if file.stat().st_size > LARGEST_FILE:
            raise OSError(0, f"{file.stat().st_size / 1e6:.0f} MB is more than {LARGEST_FILE / 1e6:.0f} MB")
        text = decoded(file.read_bytes(), file)
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror or os.strerror(error.errno or 0)}") from error
    return _parsed(text, file)


def _parsed(text: str, file: Path) -> Curve:
    lines, rows = _cells(text, file)
    if not rows:
        raise InputError(f"{file}: the file is empty; its first line names the columns: p,q,z,a_c")
    head, body = rows[0], rows[1:]
    if all(_number(cell) is not None for cell in head):
        raise InputError(
            f"{file}, line {lines[0]}: numbers where the names of the columns belong; "
            f"legal names: {', '.join(legal_names())}"
        )
    if len(body) < 2:
        raise InputError(f"{file}: {len(body)} row(s) of numbers; a curve has at least two")
    if len(body) > MOST_ROWS:
        raise InputError(f"{file}: {len(body)} rows are more than the {MOST_ROWS} that are followed")
    for number, row in zip(lines[1:], body):
        if len(row) != len(head):
            raise InputError(f"{file}, line {number}: {len(row)} cells, but {len(head)} names in line {lines[0]}")
    table = {place: [row[place] for row in body] for place in range(len(head))}
    return _checked(file.name, str(file), lines[1:], head, table)


def curve_of(columns: Mapping[str, Any], name: str = "curve") -> Curve:
    """A curve from columns in memory, by the names that a file may have.

    Raises
    ------
    InputError
    """
    table: dict[int, list[Any]] = {}
    for place, (head, values) in enumerate(columns.items()):
        try:
            table[place] = np.asarray(values, dtype=float).ravel().tolist()
        except (TypeError, ValueError):
            table[place] = [str(value) for value in np.asarray(values, dtype=object).ravel()]
        if len(table[place]) != len(table[0]):
            raise InputError(f"{name}: {len(table[place])} values in {head!r}, {len(table[0])} in the first column")
    count = len(table[0]) if table else 0
    if count < 2:
        raise InputError(f"{name}: {count} row(s) of numbers; a curve has at least two")
    return _checked(name, name, list(range(1, count + 1)), [str(head) for head in columns], table)


def _cells(text: str, file: Path) -> tuple[list[int], list[list[str]]]:
    """Lines that are neither empty nor comments, with their numbers, divided at commas, semicolons or tabs."""
    kept = [
        (number, line)
        for number, line in enumerate(text.split("\n"), start=1)
        if line.strip(" \t\r,;") and not line.lstrip().startswith("#")
    ]
    if not kept:
        return [], []
    mark = max(",;\t", key=kept[0][1].count)
    rows = []
    for number, line in kept:
        try:
            cells = next(csv.reader(io.StringIO(line), delimiter=mark, strict=True))
        except (csv.Error, StopIteration) as error:
            raise InputError(f"{file}, line {number}: not comma-separated text: {error}") from error
        rows.append([cell.strip() for cell in cells])
    return [number for number, _ in kept], rows


def _number(cell: Any) -> float | None:
    """The number in a cell, NaN if it is empty; None if there is something else."""
    if isinstance(cell, float):
        return cell if math.isnan(cell) or abs(cell) < LARGEST else None
    if cell.lower() in MISSING:
        return math.nan
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if abs(value) < LARGEST and "_" not in cell else None


def _checked(
    name: str, place: str, lines: list[int], head: Sequence[str], table: Mapping[int, Sequence[Any]]
) -> Curve:
    wrong: list[str] = []
    passed: list[str] = []
    columns: dict[str, Array] = {}
    for position, given in enumerate(head):
        known = _name(given, place, wrong, passed)
        if known is None:
            continue
        column, factor = known
        if column in columns:
            wrong.append(f"{place}: the column {column} is there twice")
            continue
        values = np.full(len(lines), math.nan)
        for row, cell in enumerate(table[position]):
            value = _number(cell)
            if value is None or abs(value * factor) >= LARGEST:
                said = f"{place}, line {lines[row]}, column {short(given.strip())[1:-1]}"
                wrong.append(f"{said}: {short(cell)} is not a finite number")
            else:
                values[row] = value * factor
        columns[column] = values
    if wrong:
        raise several(wrong)
    errors = {
        column.removesuffix(ERROR): columns.pop(column) for column in list(columns) if column.endswith(ERROR)
    }
    for column in list(columns):
        if np.isnan(columns[column]).all():
            passed.append(f"{column} (empty)")
            del columns[column]
    curve = Curve(name, list(lines), columns, errors, (), place)
    _check_errors(curve)
    if not columns:
        raise InputError(f"{place}: none of the columns is known; legal names: {', '.join(legal_names())}")
    notes = (f"{name}: passed over {', '.join(passed)}",) if passed else ()
    return Curve(name, curve.lines, columns, errors, notes, place)


def _name(given: str, place: str, wrong: list[str], passed: list[str]) -> tuple[str, float] | None:
    """Full name of a column and the factor of its unit; None for one that is passed over or unknown."""
    found = HEAD.fullmatch(given)
    name, unit = (found["name"], found["unit"]) if found is not None else (given.strip(), None)
    ending = ERROR if name.endswith(ERROR) else ""
    plain = name.removesuffix(ERROR)
    if name.startswith("_") or name in PASSED_OVER or plain in PASSED_OVER:
        passed.append(short(name)[1:-1])
        return None
    full = LEGAL.get(plain)
    if full is None:
        guess = nearest(plain, LEGAL) or ""
        wrong.append(
            f"{place}: the column {short(name)} is unknown; the nearest is {guess + ending!r} (legal: "
            f"{', '.join(legal_names())}, each with {ERROR} for its standard error, and a unit in brackets; "
            "a name that begins with _ is passed over)"
        )
        return None
    legal = UNITS[BY_NAME[full].unit]
    if unit is not None and unit not in legal:
        wrong.append(
            f"{place}: the unit {short(unit)} of the column {name} is unknown; legal: {', '.join(legal)}; "
            f"the nearest is {nearest(unit, legal)!r}"
        )
        return None
    return full + ending, 1.0 if unit is None else legal[unit]


def _check_errors(curve: Curve) -> None:
    """See that standard errors belong to columns that are there, and are positive where these have values."""
    wrong = []
    for column, errors in curve.errors.items():
        if column not in curve.columns:
            wrong.append(f"{curve.place}: the column {column}{ERROR} belongs to no column {column}")
            continue
        bad = ~np.isnan(curve.columns[column]) & ~(errors > 0.0)
        if bad.any():
            row = int(np.argmax(bad))
            wrong.append(
                f"{curve.where(row, column + ERROR)}: {errors[row]:g} is not a standard error, which is above zero"
            )
    if wrong:
        raise several(wrong)
