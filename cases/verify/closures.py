"""The closures side by side: largest errors on all paths, and what an update costs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .table import largest_errors

if TYPE_CHECKING:
    from .study import Study

PROBE_COLUMNS = ("probe", "side", "coordination_change", "coordination_scatter", "fabric_change", "fabric_scatter")
CLOSURE_COLUMNS = (
    "closure", "loading_z_percent", "loading_a_c", "loading_a_n", "loading_a_t", "loading_f_percent",
    "cycles_z_percent", "cycles_a_c", "rotation_z_percent", "rotation_a_c", "probes_z_percent", "probes_a_c_percent",
    "microseconds_per_update",
)  # fmt: skip
LOADING_QUANTITIES = {
    "coordination": True,
    "fabric_anisotropy": False,
    "normal_force_anisotropy": False,
    "tangential_force_anisotropy": False,
    "mean_normal_force": True,
}
"""Quantities of the two loadings, and whether their error is relative."""
NOTICEABLE = 0.01
"""Changes in a probe are compared where the DEM's is at least this large in z or a_c."""


def probe_rows(study: Study) -> list[list[str | float]]:
    """Changes in every probe, DEM and closures; mean and standard deviation over the packings."""
    rows: list[list[str | float]] = []
    for probe, sides in study.probes.items():
        for side, values in sides.items():
            scatter = values.std(axis=0, ddof=1) if len(values) > 1 else np.full(2, np.nan)
            mean = values.mean(axis=0)
            rows.append([probe, side, float(mean[0]), float(scatter[0]), float(mean[1]), float(scatter[1])])
    return rows


def closure_rows(study: Study) -> list[list[str | float]]:
    """One row a closure, in the order of `CLOSURE_COLUMNS`: largest sizes of the errors of means over the packings."""
    worst = largest_errors(study.rows)
    rows: list[list[str | float]] = []
    for closure in study.closures:
        row: list[str | float] = [closure]
        for quantity, relative in LOADING_QUANTITIES.items():
            found = [entry for key, entry in worst.items() if key[1:] == (closure, quantity)]
            sizes = [100.0 * abs(entry.error / entry.dem) if relative else abs(entry.error) for entry in found]
            row.append(max(sizes, default=float("nan")))
        for path in study.paths:
            for quantity, relative in (("coordination", True), ("fabric_along", False)):
                sizes = [
                    100.0 * abs(entry.error / entry.dem) if relative else abs(entry.error)
                    for entry in study.path_rows
                    if (entry.path, entry.closure, entry.quantity) == (path, closure, quantity)
                    and np.isfinite(entry.error)
                ]
                row.append(max(sizes, default=float("nan")))
        for place in range(2):
            sizes = []
            for sides in study.probes.values():
                measured, answered = sides["DEM"].mean(axis=0)[place], sides[closure].mean(axis=0)[place]
                if abs(measured) >= NOTICEABLE:
                    sizes.append(100.0 * abs(answered / measured - 1.0))
            row.append(max(sizes, default=float("nan")))
        row.append(study.cost[closure])
        rows.append(row)
    return rows
