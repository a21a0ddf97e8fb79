"""Picture of a law along a user's curves, and of what is left between them, from `fit.csv` or `data.csv`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.records import files

from .style import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, SKY, picture

COLOURS = (BLUE, RED, GREEN, ORANGE, PURPLE, SKY)
ACROSS = 4
"""Quantities beside each other."""
MARKERS = 50
"""Most markers of a curve."""
VARIES = 1e-3
LABELS = {
    "coordination": "$z$ [-]", "fabric_anisotropy": "$a_c$ [-]", "normal_force_anisotropy": "$a_n$ [-]",
    "tangential_force_anisotropy": "$a_t$ [-]", "mean_normal_force": "$f/f_0$ [-]", "stress_ratio": "$q/p$ [-]",
    "strain_xx": r"$\varepsilon_{xx}$ [-]", "strain_yy": r"$\varepsilon_{yy}$ [-]", "strain_xy": r"$\gamma_{xy}$ [-]",
}  # fmt: skip

Columns = dict[str, NDArray[Any]]


def draw_data(folder: Path, table: str, title: str) -> list[Path]:
    """Draw `fit.png` or `data.png`: for each quantity data as points and the law as lines, deviations below.

    Parameters
    ----------
    folder : Path
    table : str
        Name of the file with the rows, whose ending is replaced.
    title : str

    Returns
    -------
    list of Path
    """
    path = (folder / table).with_suffix(".png")
    columns = {name: np.array(values) for name, values in files.read_csv(folder / table).items()}
    quantities = list(dict.fromkeys(str(name) for name in columns["quantity"]))
    curves = list(dict.fromkeys(str(name) for name in columns["curve"]))
    across = len(quantities) if len(quantities) <= ACROSS else 3 if len(quantities) <= 6 else ACROSS
    bands = -(-len(quantities) // across)
    axis, label, factor = horizontal(columns, curves)
    with picture(path, max(3.6 * across, 6.0), 4.4 * bands + 0.5) as figure:
        grid = figure.add_gridspec(2 * bands, across, height_ratios=[2.4, 1.0] * bands)
        for place, quantity in enumerate(quantities):
            band, column = divmod(place, across)
            upper = figure.add_subplot(grid[2 * band, column])
            lower = figure.add_subplot(grid[2 * band + 1, column], sharex=upper)
            for number, curve in enumerate(curves):
                here = (columns["quantity"] == quantity) & (columns["curve"] == curve)
                if here.any():
                    part = {name: values[here] for name, values in columns.items()}
                    x = factor * part[axis] if axis else np.arange(int(here.sum()))
                    _curve(upper, lower, x, part, COLOURS[number % len(COLOURS)], curve)
            upper.set_ylabel(LABELS.get(quantity, _plain(quantity)))
            upper.tick_params(labelbottom=False)
            upper.ticklabel_format(axis="y", useOffset=False)
            lower.axhspan(-1.0, 1.0, color="#e8e8e8", zorder=0)
            lower.set(xlabel=label, ylabel="law - data\n[scales]")
            if place == 0:
                upper.legend(fontsize=7)
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, parse_math=False)
    return [path]


def horizontal(columns: Columns, curves: list[str]) -> tuple[str, str, float]:
    """Column of the horizontal axis (empty: the row), its label and a factor: q/p or p where all curves vary in it."""
    for name, label, factor, reach in (
        ("stress_ratio", "$q/p$ [-]", 1.0, VARIES), ("p", "$p$ [kPa]", 1e-3, 0.0),
    ):  # fmt: skip
        ranges, finite = [], True
        for curve in curves:
            values = columns[name][columns["curve"] == curve].astype(float)
            finite = finite and bool(np.isfinite(values).all())
            ranges.append(float(np.ptp(values)) if finite else 0.0)
            finite = finite and (name != "p" or ranges[-1] > VARIES * float(values.max()))
        if finite and min(ranges) > reach:
            return name, label, factor
    return "", "row", 1.0


def _curve(upper: Any, lower: Any, x: NDArray[Any], part: Columns, colour: str, name: str) -> None:
    every = max(1, len(x) // MARKERS)
    label = name if len(name) < 30 else name[:27] + "..."
    upper.plot(x, part["law"].astype(float), color=colour, label=f"law, {_plain(label)}")
    upper.plot(
        x, part["data"].astype(float), color=BLACK, linestyle="none", marker="o", markersize=4, markeredgewidth=0.6,
        markerfacecolor=colour, markevery=every, label=_plain(label),
    )  # fmt: skip
    lower.plot(x, part["deviation"].astype(float), color=colour, linewidth=1.2)


def _plain(text: str) -> str:
    """A name as it is, no formula."""
    return text.replace("$", r"\$")
