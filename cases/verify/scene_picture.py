"""Maps of one scene by the law and by grains at the points, side by side, and their difference."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.tri import Triangulation

from granfabric.cases.pictures.style import picture
from granfabric.cases.records import series

from .scene_fields import Ended

NAMES = {"coordination": "change of $z$", "fabric_anisotropy": "change of $a_{c,x}$", "stress_ratio": "$q/p$"}


def draw(path: Path, law: Ended, grains: Ended, title: str) -> None:
    """A row of three maps for each field."""
    x, y = np.asarray(law.mesh.points)[:, :2].T
    if len(law.mesh.points) != len(grains.mesh.points):
        return
    shape = Triangulation(x, y, series.triangles(law.mesh))
    tall = float(np.ptp(y) / np.ptp(x))
    with picture(path, 11.0, 0.6 + 3.3 * len(NAMES) * min(max(tall, 0.5), 1.3)) as figure:
        grid: Any = figure.subplots(len(NAMES), 3, squeeze=False)
        for row, (name, label) in zip(grid, NAMES.items()):
            a, b = law.nodes[name], grains.nodes[name]
            low, high = float(min(a.min(), b.min())), float(max(a.max(), b.max()))
            most = max(float(np.abs(a - b).max()), 1e-12)
            for axes, values, text, limits, colours in (
                (row[0], a, f"law: {label}", (low, max(high, low + 1e-12)), "viridis"),
                (row[1], b, f"grains: {label}", (low, max(high, low + 1e-12)), "viridis"),
                (row[2], a - b, "law less grains", (-most, most), "RdBu_r"),
            ):
                drawn = axes.tripcolor(
                    shape, values, shading="gouraud", vmin=limits[0], vmax=limits[1], cmap=colours
                )
                axes.set(title=text, aspect="equal", xticks=[], yticks=[])
                axes.grid(False)
                figure.colorbar(drawn, ax=axes)
        figure.suptitle(title, x=0.01, ha="left", fontsize=13, parse_math=False)
