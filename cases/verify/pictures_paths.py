"""Figures of the comparison along paths that turn."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.pictures.closures import line_of
from granfabric.cases.pictures.style import BLACK, picture

if TYPE_CHECKING:
    from .study import PathStudy, Study

CYCLES = {
    "coordination": "$z$ [-]",
    "fabric_along": "$a_c$ [-]",
    "normal_along": "$a_n$ [-]",
    "tangential_along": "$a_t$ [-]",
}
ROTATION = {
    "coordination": "$z$ [-]",
    "fabric_along": "$a_c$ along the major compression [-]",
    "fabric_across": "$a_c$ across it [-]",
}


def draw_cycles(path: Path, study: Study, title: str) -> Path:
    """Two cycles of q/p and a reversal."""
    along = study.paths["cycles"]
    return _draw(path, study, title, along, along.stress_ratio, CYCLES, "stress ratio $q/p$ [-]", 15.0)


def draw_rotation(path: Path, study: Study, title: str) -> Path:
    """A turn of the principal axes at constant p and q; the loading before it is left out."""
    along = study.paths["rotation"]
    return _draw(
        path, study, title, along, along.angle, ROTATION, "direction of the major compression from its start [degrees]",
        13.0, first_segment=2,
    )  # fmt: skip


def _draw(
    path: Path,
    study: Study,
    title: str,
    along: PathStudy,
    x: NDArray[np.float64],
    quantities: Mapping[str, str],
    label: str,
    width: float,
    first_segment: int = 1,
) -> Path:
    chosen = along.segment >= first_segment
    with picture(path, width, 4.4) as figure:
        axes: Any = figure.subplots(1, len(quantities))
        for one, (quantity, symbol) in zip(axes, quantities.items()):
            measured = np.mean([columns[quantity] for columns in along.dem], axis=0)
            one.plot(x[chosen], measured[chosen], "o-", color=BLACK, markersize=3, linewidth=0.6, label="DEM")
            for place, closure in enumerate(study.closures):
                colour, style = line_of(place)
                curve = np.mean([columns[quantity] for columns in along.model[closure]], axis=0)
                one.plot(x[chosen], curve[chosen], color=colour, linestyle=style, linewidth=1.2, label=closure)
            one.set(title=symbol, xlabel=label)
            one.xaxis.label.set_fontsize(9)
            one.title.set_fontsize(9.5)
            one.margins(y=0.06)
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=8.5)
        figure.suptitle(title, x=0.01, ha="left", fontsize=13)
    return path
