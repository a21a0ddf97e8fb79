"""Picture of a sweep, from `results.csv`: results against what varies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import InputError
from granfabric.cases.pictures.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, SKY, picture
from granfabric.cases.records import files

from .record import KIND, PICTURE, RESULTS

Array = NDArray[np.float64]

COLOURS = (BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK)
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
MOST_RESULTS, MOST_KEYS, MOST_LINES = 6, 5, len(COLOURS)
LONGEST_LABEL = 28
WIDE = 30.0
"""Largest over smallest value from which an axis is logarithmic."""


class Axis:
    """What varies: numbers as they are, anything else side by side in the order of the runs.

    Parameters
    ----------
    name : str
    values : sequence
        Of the table, one a run.
    """

    def __init__(self, name: str, values: Sequence[Any]) -> None:
        self.name = self.label_text = name
        self.is_number = all(isinstance(value, float) and math.isfinite(value) for value in values)
        distinct = dict.fromkeys(values)
        if self.is_number:
            self.distinct: list[Any] = sorted(distinct)
            self.places = np.array(values, dtype=np.float64)
        else:
            self.distinct = list(distinct)
            self.places = np.array([self.distinct.index(value) for value in values], dtype=np.float64)

    @property
    def by_ratio(self) -> bool:
        """Whether the values spread over powers of ten."""
        return self.is_number and self.distinct[0] > 0.0 and self.distinct[-1] >= WIDE * self.distinct[0]

    def label(self, place: int) -> str:
        """A value in words."""
        value = self.distinct[place]
        text = f"{value:.4g}" if self.is_number else str(value) or "as in the scene"
        return text if len(text) <= LONGEST_LABEL else f"{text[: LONGEST_LABEL - 3]}..."

    def describe(self, axis: Any) -> None:
        """Label and ticks of an axis of a panel."""
        axis.set_label_text(self.label_text)
        if not self.is_number:
            axis.set_ticks(range(len(self.distinct)), [self.label(place) for place in range(len(self.distinct))])
        elif self.by_ratio:
            axis.axes.set_xscale("log") if axis.axis_name == "x" else axis.axes.set_yscale("log")


def draw_sweep(folder: Path, title: str) -> list[Path]:
    """Draw `results.png`: lines over one key, maps or lines over two, points over each of more.

    Parameters
    ----------
    folder : Path
    title : str

    Returns
    -------
    list of Path
        Empty if there is nothing to draw.

    Raises
    ------
    InputError
        If the table is damaged.
    """
    table = files.read_csv(folder / RESULTS)
    record = files.read_record(folder) or {}
    keys = [key for key in record.get("keys", []) if key in table]
    names = [name for name in record.get("results", []) if name in table]
    if not table or not keys or not table[keys[0]]:
        raise InputError(f"{folder / RESULTS} is damaged: it has no columns of a sweep")
    axes = [axis for axis in (Axis(key, table[key]) for key in keys) if len(axis.distinct) > 1]
    axes = axes or [Axis("run", table["run"])]
    for axis in axes:  # without its tables where that tells it from the others
        last = axis.name.rpartition(".")[2]
        if sum(other.name.rpartition(".")[2] == last for other in axes) == 1:
            axis.label_text = last
    numbers = {name: np.array([v if isinstance(v, float) else math.nan for v in table[name]]) for name in names}
    drawn = {name: values for name, values in numbers.items() if np.isfinite(values).any()}
    drawn = dict(list(drawn.items())[:MOST_RESULTS])
    if not drawn:
        return []
    path = folder / PICTURE
    if len(axes) == 1:
        _lines(path, title, axes[0], None, drawn)
    elif len(axes) == 2 and _is_grid(axes) and all(axis.is_number and len(axis.distinct) > 3 for axis in axes):
        _maps(path, title, axes, drawn)
    elif len(axes) == 2 and min(len(axis.distinct) for axis in axes) <= MOST_LINES:
        first, second = axes
        if len(second.distinct) > MOST_LINES or (first.is_number < second.is_number):
            first, second = second, first
        _lines(path, title, first, second, drawn)
    else:
        _points(path, title, axes[:MOST_KEYS], drawn)
    return [path]


def draw_sweep_folder(folder: Path) -> list[Path]:
    """Make the picture anew if the folder is that of a sweep; nothing if it is not.

    Raises
    ------
    InputError
        If it holds no table yet, or a damaged one.
    """
    record = files.whole_record(folder)
    if record is None or record["kind"] != KIND:
        return []
    if not (folder / RESULTS).is_file():
        raise InputError(f"{str(folder)!r} holds no {RESULTS}: nothing was computed before the sweep ended")
    drawn = draw_sweep(folder, str(record["scene"].get("title", "")))
    if not drawn:
        raise InputError(f"{folder / RESULTS} holds no numbers that could be drawn")
    return drawn


def _is_grid(axes: Sequence[Axis]) -> bool:
    places = set(zip(*(axis.places.tolist() for axis in axes)))
    return len(places) == math.prod(len(axis.distinct) for axis in axes) == len(axes[0].places)


def _lines(path: Path, title: str, over: Axis, each: Axis | None, numbers: dict[str, Array]) -> None:
    """A panel a result over one key, a line a value of the other."""
    with picture(path, max(3.8 * len(numbers), 5.0), 4.0) as figure:
        figure.suptitle(title, fontsize=11)
        for place, (name, values) in enumerate(numbers.items()):
            axes: Any = figure.add_subplot(1, len(numbers), place + 1)
            groups = [None] if each is None else list(range(len(each.distinct)))
            for group in groups:
                chosen = np.ones(len(values), bool)
                label = None
                if each is not None and group is not None:
                    at = each.distinct[group] if each.is_number else group
                    chosen, label = each.places == at, each.label(group)
                rows = np.flatnonzero(chosen & np.isfinite(values))
                rows = rows[np.argsort(over.places[rows], kind="stable")]
                style = 0 if group is None else group
                joined = over.is_number and len(set(over.places[rows].tolist())) == len(rows)
                axes.plot(
                    over.places[rows], values[rows], color=COLOURS[style], marker=MARKERS[style], label=label,
                    linestyle="-" if joined else "none", markersize=5,
                )  # fmt: skip
            over.describe(axes.xaxis)
            axes.set_ylabel(name)
            if not over.is_number:
                axes.tick_params(axis="x", rotation=30)
            if each is not None and place == 0:
                axes.legend(title=each.label_text)


def _maps(path: Path, title: str, axes: Sequence[Axis], numbers: dict[str, Array]) -> None:
    """A map a result over two keys, a cell a run."""
    first, second = axes
    with picture(path, max(4.2 * len(numbers), 5.0), 4.0) as figure:
        figure.suptitle(title, fontsize=11)
        for place, (name, values) in enumerate(numbers.items()):
            panel: Any = figure.add_subplot(1, len(numbers), place + 1)
            grid = np.full((len(second.distinct), len(first.distinct)), math.nan)
            rows = [second.distinct.index(value) for value in second.places.tolist()]
            columns = [first.distinct.index(value) for value in first.places.tolist()]
            grid[rows, columns] = values
            image = panel.pcolormesh(first.distinct, second.distinct, grid, shading="nearest", cmap="viridis")
            figure.colorbar(image, ax=panel, label=name)
            panel.grid(False)
            first.describe(panel.xaxis)
            second.describe(panel.yaxis)


def _points(path: Path, title: str, axes: Sequence[Axis], numbers: dict[str, Array]) -> None:
    """A row a result, a panel a key, a point a run."""
    with picture(path, max(3.2 * len(axes), 5.0), 2.7 * len(numbers) + 0.3) as figure:
        figure.suptitle(title, fontsize=11)
        for row, (name, values) in enumerate(numbers.items()):
            for column, axis in enumerate(axes):
                panel: Any = figure.add_subplot(len(numbers), len(axes), row * len(axes) + column + 1)
                panel.plot(axis.places, values, color=BLUE, marker="o", linestyle="none", markersize=4)
                if row == len(numbers) - 1:
                    axis.describe(panel.xaxis)
                    if not axis.is_number:
                        panel.tick_params(axis="x", rotation=30)
                else:
                    axis.describe(panel.xaxis)
                    panel.set_xlabel("")
                if column == 0:
                    panel.set_ylabel(name)
