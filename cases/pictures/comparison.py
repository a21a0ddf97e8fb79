"""Picture of a run against its closed form, from `closed_form.csv`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from granfabric.cases.field.closed_forms import TITLES
from granfabric.cases.records import files

from .style import BLACK, BLUE, ORANGE, RED, picture

COLOURS = (BLUE, RED, ORANGE)


def draw_comparison(folder: Path, scene: dict[str, Any]) -> list[Path]:
    """Draw `closed_form.png`: computed stresses as points, the closed form as lines, along the scene's line.

    Parameters
    ----------
    folder : Path
    scene : dict
        The scene as resolved.

    Returns
    -------
    list of Path
    """
    path = folder / "closed_form.png"
    columns = {name: np.array(values) for name, values in files.read_csv(folder / files.COMPARISON).items()}
    form = next(name for name in TITLES if name in scene["closed_form"])
    (x0, y0), (x1, y1) = ((columns["x"][row], columns["y"][row]) for row in (0, -1))
    names = [name.removeprefix("stress_") for name in columns if name.startswith("stress_")]
    with picture(path, 6.5, 4.2) as figure:
        axes = figure.add_subplot()
        for name, colour in zip(names, COLOURS):
            axes.plot(
                columns["distance"], columns[f"closed_form_{name}"] / 1e3, color=colour, label=f"closed form, {name}"
            )
            axes.plot(
                columns["distance"],
                columns[f"stress_{name}"] / 1e3,
                color=BLACK,
                linestyle="none",
                marker="o",
                markerfacecolor=colour,
                markersize=4,
                markeredgewidth=0.6,
                markevery=2,
                label=f"computed, {name}",
            )
        axes.set(
            xlabel=f"distance from ({x0:g}, {y0:g}) towards ({x1:g}, {y1:g}) [m]",
            ylabel="stress, tension positive [kPa]",
            title=f"{scene['title']}: {TITLES[form]}",
        )
        axes.legend(ncols=len(names))
    return [path]
