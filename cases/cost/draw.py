"""Work-precision pictures: error against time and against a machine-independent count."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import (
    FuncFormatter,
    LogFormatterSciNotation,
    LogLocator,
    MaxNLocator,
    NullFormatter,
    NullLocator,
)

from granfabric.cases.pictures.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, SKY, picture

from .study import Axes, Row

FRONT = "Pareto front (filled markers)"

LOOKS = (
    (RED, "s"),
    (ORANGE, "^"),
    (BLUE, "o"),
    (GREEN, "D"),
    (PURPLE, "v"),
    (SKY, "P"),
    (BLACK, "X"),
)
"""Colour and marker of each series; markers tell the series apart in print without colour."""


def work_precision(
    path: Path, title: str, labels: Axes, rows: Sequence[Row], front: bool = True, legend: dict[str, str] | None = None
) -> None:
    """Draw one row of two panels a facet: error over time, error over count, both with the Pareto front.

    Parameters
    ----------
    path : Path
        PNG file to write.
    title : str
    labels : Axes
    rows : sequence of Row
        With fronts marked.
    front : bool
        Whether the series compete, so that their common front means something.
    legend : dict of str to str, optional
        Text of a series in the legend, if not its name.
    """
    facets = [facet for facet in labels.facet_titles if any(row["facet"] == facet for row in rows)]
    names = list(dict.fromkeys(row["series"] for row in rows))
    looks = {name: LOOKS[place % len(LOOKS)] for place, name in enumerate(names)}
    with picture(path, 11.0, 0.9 + 4.0 * len(facets)) as figure:
        grid = figure.subplots(len(facets), 2, squeeze=False, sharey="row")
        handles: dict[str, Any] = {}
        for place, facet in enumerate(facets):
            members = [row for row in rows if row["facet"] == facet and np.isfinite(row["error"])]
            for side, (cost, mark, label) in enumerate(
                (("seconds", "on_front", labels.seconds), ("count", "on_front_by_count", labels.count))
            ):
                axes = grid[place, side]
                handles |= panel(axes, members, cost, mark, looks, front)
                log_axes(axes)
                letter = "abcdefgh"[2 * place + side]
                head = labels.facet_titles[facet] if side == 0 else "the same, by count"
                axes.set(title=f"({letter}) {head}", xlabel=label)
            grid[place, 0].set_ylabel(labels.error)
        ordered = {(legend or {}).get(name, name): handles[name] for name in (*names, FRONT) if name in handles}
        figure.legend(
            ordered.values(), ordered.keys(), loc="outside lower center", ncols=min(5, len(ordered)), fontsize=9
        )
        figure.suptitle(title, x=0.01, ha="left", fontsize=13)


def panel(
    axes: Any, members: Sequence[Row], cost: str, mark: str, looks: dict[str, tuple[str, str]], front: bool = True
) -> dict[str, Any]:
    """Draw series, and their common front, into one panel; handles for the legend by name.

    Parameters
    ----------
    axes : matplotlib Axes
    members : sequence of Row
        Of one facet; rows without an error are left out.
    cost, mark : str
        Columns of the abscissa and of its front.
    looks : dict of str to (colour, marker)
        By series.
    front : bool
    """
    usable = [row for row in members if np.isfinite(row["error"])]
    handles = _front(axes, usable, cost, mark) if front else {}
    for name, look in looks.items():
        line = [row for row in usable if row["series"] == name]
        if line:
            handles[name] = _series(axes, line, cost, mark, *look)
    return handles


def _series(axes: Any, line: Sequence[Row], cost: str, mark: str, colour: str, marker: str) -> Any:
    x, y = [row[cost] for row in line], [row["error"] for row in line]
    (handle,) = axes.plot(x, y, color=colour, marker=marker, markersize=5, linewidth=1.3, markerfacecolor="white")
    chosen = [row for row in line if row[mark]]
    axes.plot(
        [row[cost] for row in chosen],
        [row["error"] for row in chosen],
        color=colour,
        marker=marker,
        markersize=5,
        linestyle="none",
    )
    return handle


def _front(axes: Any, members: Sequence[Row], cost: str, mark: str) -> dict[str, Any]:
    """The front as the border of what can be had: a staircase."""
    points = sorted({(row[cost], row["error"]) for row in members if row[mark]})
    if len(points) < 2:
        return {}
    x, y = zip(*points)
    (handle,) = axes.step(x, y, where="post", color="#d4d4d4", linewidth=5, solid_joinstyle="round", zorder=0.5)
    return {FRONT: handle}


def log_axes(axes: Any) -> None:
    """Logarithmic axes with enough labels."""
    axes.set(xscale="log", yscale="log")
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        axis.set_major_locator(LogLocator(numticks=9))
        axis.set_minor_formatter(NullFormatter())
        # over a short range powers of ten alone would say too little
        if 0.0 < low < high < 4.0 * low:
            axis.set_major_locator(MaxNLocator(4))
            axis.set_major_formatter(FuncFormatter(lambda value, place: f"{value:g}"))
            axis.set_minor_locator(NullLocator())
        elif 0.0 < low < high < 30.0 * low:
            axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
            axis.set_minor_formatter(LogFormatterSciNotation(minor_thresholds=(np.inf, np.inf)))
    axes.grid(which="minor", visible=False)
    axes.margins(0.06)
