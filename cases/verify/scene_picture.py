"""Maps of one scene by the law, by grains at the points and by specimens, side by side, and their differences."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from granfabric.cases.pictures.style import picture
from granfabric.cases.records import series

from .scene_fields import Ended

Array = NDArray[np.float64]

NAMES = {"coordination": "change of $z$", "fabric_anisotropy": "change of $a_{c,x}$", "stress_ratio": "$q/p$"}


def draw(path: Path, law: Ended, grains: Ended, title: str, specimens: dict[str, Array] | None = None) -> None:
    """A row of maps for each field: law, grains, specimens if there are any (at the nodes), and differences."""
    x, y = np.asarray(law.mesh.points)[:, :2].T
    if len(law.mesh.points) != len(grains.mesh.points):
        return
    shape = Triangulation(x, y, series.triangles(law.mesh))
    tall = float(np.ptp(y) / np.ptp(x))
    across = 3 if specimens is None else 6
    width = 11.0 if specimens is None else 20.0
    with picture(path, width, 0.6 + 3.3 * len(NAMES) * min(max(tall, 0.5), 1.3)) as figure:
        grid: Any = figure.subplots(len(NAMES), across, squeeze=False)
        for row, (name, label) in zip(grid, NAMES.items()):
            shown = {"law": law.nodes[name], "grains": grains.nodes[name]}
            pairs = [("law", "grains")]
            if specimens is not None:
                shown["specimens"] = np.nan_to_num(specimens[name])
                pairs += [("law", "specimens"), ("grains", "specimens")]
            low = min(float(values.min()) for values in shown.values())
            high = max(max(float(values.max()) for values in shown.values()), low + 1e-12)
            apart = {f"{a} less {b}": shown[a] - shown[b] for a, b in pairs}
            most = max(max(float(np.abs(values).max()) for values in apart.values()), 1e-12)
            maps = [(f"{text}: {label}", values, (low, high), "viridis") for text, values in shown.items()]
            maps += [(text, values, (-most, most), "RdBu_r") for text, values in apart.items()]
            for axes, (text, values, limits, colours) in zip(row, maps):
                drawn = axes.tripcolor(
                    shape, values, shading="gouraud", vmin=limits[0], vmax=limits[1], cmap=colours
                )
                axes.set(title=text, aspect="equal", xticks=[], yticks=[])
                axes.grid(False)
                figure.colorbar(drawn, ax=axes)
        figure.suptitle(title, x=0.01, ha="left", fontsize=13, parse_math=False)
