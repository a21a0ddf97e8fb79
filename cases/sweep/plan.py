"""Which runs a sweep has: their names and what is set in each."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from granfabric.cases.errors import InputError, short
from granfabric.cases.records import files
from granfabric.cases.scene.reader import parse_assignment

from .values import MOST_VALUES, bounds_of, plain, values_of

MOST_RUNS = 100_000
LONGEST_NAME = 80
NAME = "name"
"""Head of the column of a table that names the runs."""
LEGAL_NAME = re.compile(r"[A-Za-z0-9_+=-][A-Za-z0-9_.+=-]{0,99}")


@dataclass(frozen=True)
class Run:
    """One run of a sweep.

    Attributes
    ----------
    name : str
        Of its folder.
    values : dict of str to str
        What varies: text by key.
    assignments : tuple of str
        ``key=value`` for everything that is set, what does not vary included.
    origin : str
        Where its values stand, for messages; empty for `--set`.
    """

    name: str
    values: dict[str, str]
    assignments: tuple[str, ...]
    origin: str = ""


@dataclass(frozen=True)
class Request:
    """What is asked for.

    Attributes
    ----------
    assignments : sequence of str
        ``KEY=VALUE,VALUE,...``: all combinations.
    table : Path or None
        One run a line.
    latin : sequence of str
        ``KEY=LO:HI``.
    samples, seed : int or None
        Of the Latin hypercube.
    """

    assignments: Sequence[str] = ()
    table: Path | None = None
    latin: Sequence[str] = ()
    samples: int | None = None
    seed: int | None = None


@dataclass
class _Part:
    """Values that come together: one row of a table, one sample, one combination."""

    values: dict[str, str]
    origin: str = ""
    name: str = ""


@dataclass(frozen=True)
class Plan:
    """Runs of a sweep, and the keys that vary in them, in order.

    Attributes
    ----------
    keys : tuple of str
    runs : list of Run
    """

    keys: tuple[str, ...]
    runs: list[Run] = field(default_factory=list)


def plan_of(request: Request) -> Plan:
    """All runs: combinations of the values given by `--set`, the lines of the table, the samples.

    Raises
    ------
    InputError
    """
    grid, fixed = _grid(request.assignments)
    sources = [_table(request.table)] if request.table is not None else []
    samples = _latin(request)
    sources += [grid] if grid else []
    sources += [samples] if samples else []
    if not sources:
        raise InputError(
            "a sweep needs something that varies: --set KEY=VALUE,VALUE,..., --table FILE.csv or --latin KEY=LO:HI"
        )
    number = math.prod(len(source) for source in sources)
    if number > MOST_RUNS:
        raise InputError(f"{number} runs are more than the {MOST_RUNS} of a sweep")
    keys: list[str] = []
    for source in sources:
        found = list(dict.fromkeys(key for part in source for key in part.values))
        for key in found:
            if key in keys or key in fixed:
                raise InputError(f"the key {short(key)} is given twice: by --set, --table or --latin")
        keys += found
    rows = [_joined(parts) for parts in product(*sources)]
    names = _names(rows, keys, bool(samples))
    runs = []
    for name, row in zip(names, rows):
        said = [f"{key}={value}" for key, value in {**fixed, **row.values}.items()]
        runs.append(Run(name, row.values, tuple(said), row.origin))
    return Plan(tuple(keys), runs)


def _joined(parts: Sequence[_Part]) -> _Part:
    values = {key: value for part in parts for key, value in part.values.items()}
    origin = ", ".join(part.origin for part in parts if part.origin)
    name = parts[0].name if len(parts) == 1 else ""
    return _Part(values, origin, name)


def _grid(assignments: Sequence[str]) -> tuple[list[_Part], dict[str, str]]:
    """Combinations of what has several values, the last key running fastest; and what has one value."""
    axes: dict[str, list[str]] = {}
    for text in assignments:
        key, values = values_of(text)
        if key in axes:
            raise InputError(f"--set {key} is given twice; several values are parted by commas: {key}=1,2")
        axes[key] = values
    varied = {key: values for key, values in axes.items() if len(values) > 1}
    number = math.prod(map(len, varied.values()))
    if number > MOST_RUNS:
        raise InputError(f"{number} combinations are more than the {MOST_RUNS} runs of a sweep")
    fixed = {key: values[0] for key, values in axes.items() if len(values) == 1}
    if not varied:
        return [], fixed
    return [_Part(dict(zip(varied, row))) for row in product(*varied.values())], fixed


def _table(file: Path) -> list[_Part]:
    """Lines of a table whose heads are keys."""
    try:
        heads, rows = files.read_rows(file)
    except csv.Error as error:
        raise InputError(f"--table {file}: {error}") from error
    except OSError as error:
        raise InputError(f"--table {file}: cannot be read: {error.strerror or error}") from error
    heads = [head.strip() for head in heads]
    if not rows or not any(heads):
        raise InputError(f"--table {file} has no lines below its heads; the heads are keys, one run a line")
    if len(heads) == 1 and ";" in heads[0]:
        raise InputError(f"--table {file} is parted by semicolons; the columns of a table are parted by commas")
    for head in heads:
        if heads.count(head) > 1 or not head:
            raise InputError(f"--table {file}: {'an empty head' if not head else f'the head {short(head)} twice'}")
    if set(heads) == {NAME}:
        raise InputError(f"--table {file} names runs only; the other heads are keys such as material.coordination")
    parts = []
    for number, row in enumerate(rows, start=2):
        origin = f"{file}, line {number}"
        if len(row) != len(heads):
            raise InputError(f"{origin} has {len(row)} entries, the first line {len(heads)}")
        values = {head: cell.strip() for head, cell in zip(heads, row) if cell.strip()}
        name = values.pop(NAME, "")
        if NAME in heads and not LEGAL_NAME.fullmatch(name):
            raise InputError(f"{origin}: the name {short(name)} is not of letters, digits and .+=_-")
        for key, value in values.items():
            try:
                parse_assignment(f"{key}={value}")
            except InputError as error:
                raise InputError(f"{origin}: {str(error).removeprefix('--set ')}") from error
        parts.append(_Part(values, origin, name))
    return parts


def _latin(request: Request) -> list[_Part]:
    """Samples of a Latin hypercube: each range is cut into as many equal parts as there are samples, one in each."""
    if not request.latin:
        for option, value in (("--samples", request.samples), ("--seed", request.seed)):
            if value is not None:
                raise InputError(f"{option} goes with --latin KEY=LO:HI")
        return []
    if request.samples is None:
        raise InputError("--latin needs --samples N, the number of runs")
    if not 2 <= request.samples <= MOST_VALUES:
        raise InputError(f"--samples {request.samples} is outside [2, {MOST_VALUES}]")
    seed = 1 if request.seed is None else request.seed
    if not 0 <= seed < 2**32:
        raise InputError(f"--seed {seed} is outside [0, {2**32 - 1}]")
    bounds = [bounds_of(text) for text in request.latin]
    if len({key for key, *_ in bounds}) < len(bounds):
        raise InputError("--latin names a key twice")
    # columns are drawn one after the other, so that a further key leaves those before it as they were
    streams = [_stream(seed, place) for place in range(len(bounds))]
    unit = [qmc.LatinHypercube(d=1, seed=stream).random(request.samples)[:, 0] for stream in streams]
    columns = {}
    for (key, low, high, log), fraction in zip(bounds, unit):
        if log:
            sign = math.copysign(1.0, low)
            ends = np.log(sign * low), np.log(sign * high)
            columns[key] = sign * np.exp(ends[0] + (ends[1] - ends[0]) * fraction)
        else:
            columns[key] = low + (high - low) * fraction
    return [
        _Part({key: plain(values[row]) for key, values in columns.items()}, f"sample {row + 1} of --latin")
        for row in range(request.samples)
    ]


def _stream(seed: int, place: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(place,)))


def _names(rows: Sequence[_Part], keys: Sequence[str], numbered: bool) -> list[str]:
    """A folder for each run: as the table says, by what varies, or by number where that would be long."""
    if all(row.name for row in rows):
        names = [row.name for row in rows]
        twice = next((name for name in names if names.count(name) > 1), None) if len(set(names)) < len(names) else None
        if twice is not None:
            raise InputError(f"--table: the name {short(twice)} is given twice")
        return names
    names = ["_".join(_pair(key, row.values[key], keys) for key in keys if key in row.values) for row in rows]
    alike = len({name.lower() for name in names}) < len(names)
    if numbered or alike or not all(0 < len(name) <= LONGEST_NAME for name in names):
        digits = max(4, len(str(len(rows))))
        return [f"run_{number:0{digits}d}" for number in range(1, len(rows) + 1)]
    return names


def _pair(key: str, value: str, keys: Sequence[str]) -> str:
    last = key.rpartition(".")[2]
    alone = sum(other.rpartition(".")[2] == last for other in keys) == 1
    return re.sub(r"[^A-Za-z0-9.+=_-]+", "_", f"{last if alone else key}={value.strip(chr(34))}").strip("_")
