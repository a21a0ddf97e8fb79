"""Figures of the map: errors of materials by paths, and both sides along each path."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from granfabric.cases.pictures.closures import line_of
from granfabric.cases.pictures.style import BLACK, RED, picture

from .closures import CLOSURES
from .compare import Cell, mean_of_all
from .paths import ABSCISSAE
from .table import SYMBOLS, by_cell, is_refused, scatter_shown, shown, told_closures, where_refused

if TYPE_CHECKING:
    from .result import MapResult

MAP = "map.png"
PANELS = {
    "coordination": ("coordination number $z$, error in % of $z_0$", 5.0),
    "fabric_along": ("fabric anisotropy $a_c$, error", 0.05),
    "normal_along": ("normal-force anisotropy $a_n$, error", 0.05),
    "tangential_along": ("tangential-force anisotropy $a_t$, error", 0.05),
}
"""Quantities of the figures, with the error at which the colour is fullest."""
AXES = {
    "coordination": "coordination number $z$ [-]",
    "fabric_along": "$a_c$ [-]",
    "normal_along": "$a_n$ [-]",
    "tangential_along": "$a_t$ [-]",
}


def picture_of(path: str) -> str:
    """File name of the figure of a path."""
    return f"map_{path}.png"


def draw_map(folder: Path, result: MapResult) -> list[Path]:
    """Draw `map.png` and a figure for each path."""
    drawn = [_draw_map(folder / MAP, result)]
    for name in result.paths:
        drawn.append(_draw_path(folder / picture_of(name), result, name))
    return drawn


def _title(text: str, result: MapResult) -> str:
    count = len(result.seeds)
    packings = "one packing" if count == 1 else f"{count} packings"
    return f"{text} ({packings} of {result.particles} disks)"


def _draw_map(path: Path, result: MapResult) -> Path:
    closure = told_closures(result.closures)[0]
    cells = by_cell(result.rows)
    across, down = len(result.paths), len(result.materials)
    width, height = 2 * (2.2 + 1.1 * across), 2 * (1.7 + 0.55 * down)
    with picture(path, max(width, 9.0), max(height, 5.0)) as figure:
        for axes, (quantity, (title, most)) in zip(figure.subplots(2, 2).flat, PANELS.items()):
            sizes = np.full((down, across), np.nan)
            for i, material in enumerate(result.materials):
                for j, name in enumerate(result.paths):
                    row = cells[material.name, name, closure, quantity]
                    size = row.error_percent if quantity == "coordination" else row.error
                    sizes[i, j] = abs(size)
                    _write_cell(axes, i, j, row, bool(abs(size) > 0.6 * most))
            image = axes.imshow(np.ma.masked_invalid(sizes), cmap="YlOrRd", vmin=0.0, vmax=most, aspect="auto")
            axes.set_facecolor("#dddddd")
            axes.set(title=title)
            axes.set_xticks(range(across), [one.short for one in result.paths.values()], rotation=35, ha="right")
            axes.set_yticks(range(down), [material.title for material in result.materials])
            axes.tick_params(labelsize=8.5, length=0)
            axes.grid(visible=False)
            figure.colorbar(image, ax=axes, fraction=0.04, pad=0.01, extend="max")
        text = _title(f"Largest errors along each path: {closure}", result)
        figure.suptitle(text, x=0.01, ha="left", fontsize=13)
    return path


def _write_cell(axes: Any, i: int, j: int, row: Any, dark: bool) -> None:
    """The error with its sign, the scatter, and where the law refused."""
    if not np.isfinite(row.error):
        axes.text(j, i, where_refused(row).replace(" at ", "\nat ") or "no DEM", ha="center", va="center", fontsize=7.5)
        return
    lines = [shown(row)]
    if scatter := scatter_shown(row):
        lines.append(f"±{scatter}")
    if is_refused(row):
        lines.append(where_refused(row).replace("refused at ", "ref. "))
        axes.add_patch(_hatched(i, j))
    axes.text(j, i, "\n".join(lines), ha="center", va="center", fontsize=7.5, color="white" if dark else BLACK)


def _hatched(i: int, j: int) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((j - 0.48, i - 0.47), 0.96, 0.94, fill=False, edgecolor=RED, linewidth=1.4, linestyle="--")


def _draw_path(path: Path, result: MapResult, name: str) -> Path:
    chosen = result.paths[name]
    found = {one.material: one for one in result.cells if one.path == name}
    with picture(path, 15.0, 1.2 + 2.7 * len(result.materials)) as figure:
        grid = figure.subplots(len(result.materials), len(PANELS), squeeze=False)
        for axes_row, material in zip(grid, result.materials):
            cell = found[material.name]
            for axes, quantity in zip(axes_row, PANELS):
                _draw_both(axes, cell, quantity, chosen.abscissa, result.closures)
                axes.set_title(f"{SYMBOLS[quantity]}, {material.title}", fontsize=9.5)
                axes.margins(y=0.08)
        for axes, quantity in zip(grid[-1], PANELS):
            axes.set_xlabel(ABSCISSAE[chosen.abscissa], fontsize=9)
            for one in grid[:, list(PANELS).index(quantity)]:
                one.set_ylabel(AXES[quantity], fontsize=9)
        handles: dict[str, Any] = {}
        for axes in grid.flat:
            for handle, label in zip(*axes.get_legend_handles_labels()):
                handles.setdefault(label, handle)
        if handles:
            figure.legend([*handles.values()], [*handles], loc="outside lower center", ncols=len(handles), fontsize=8.5)
        figure.suptitle(_title(chosen.title[0].upper() + chosen.title[1:], result), x=0.01, ha="left", fontsize=13)
    return path


def _draw_both(axes: Any, cell: Cell, quantity: str, abscissa: str, closures: tuple[str, ...]) -> None:
    """The DEM with its scatter, and every closure; a cross where one refused."""
    if not cell.seeds or not len(cell.segment):
        axes.text(0.5, 0.5, "no DEM", ha="center", va="center", transform=axes.transAxes)
        return
    x = getattr(cell, abscissa)
    chosen = cell.segment >= (2 if abscissa == "angle" and cell.segment[-1] > 1 else 1)  # without the loading before
    measured = cell.dem[quantity]
    mean = measured.mean(axis=0)
    axes.plot(x[chosen], mean[chosen], "o-", color=BLACK, markersize=2.5, linewidth=0.6, label="DEM", zorder=3)
    if len(measured) > 1:
        scatter = measured.std(axis=0, ddof=1)
        for number in np.unique(cell.segment[chosen]):  # a band for each way, or they would cross
            part = cell.segment == number
            label = "standard deviation between packings" if number == cell.segment[chosen][0] else None
            axes.fill_between(
                x[part], (mean - scatter)[part], (mean + scatter)[part], color=BLACK, alpha=0.12, linewidth=0,
                label=label,
            )  # fmt: skip
    for closure in closures:
        colour, style = line_of(CLOSURES.index(closure))
        answers = cell.model[closure][quantity]
        curve = mean_of_all(answers)
        axes.plot(x[chosen], curve[chosen], color=colour, linestyle=style, linewidth=1.2, label=closure)
        if not cell.refusals[closure]:
            continue
        for answer in answers:  # each to where it was refused
            reached = np.flatnonzero(np.isfinite(answer) & chosen)
            if not len(reached):
                continue
            beyond = chosen & ~np.isfinite(curve)
            axes.plot(x[beyond], answer[beyond], color=colour, linewidth=0.7, alpha=0.8)
            if reached[-1] < np.flatnonzero(chosen)[-1]:
                axes.plot(x[reached[-1]], answer[reached[-1]], "x", color=colour, markersize=7, markeredgewidth=1.8)
