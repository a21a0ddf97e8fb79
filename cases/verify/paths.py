"""Both sides of the comparison along paths that turn: cycles of q/p with a reversal, a turn of the principal axes.

The point law is driven along the stresses that the DEM recorded; both are compared at the same fraction of every
segment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure
from granfabric.constitutive.path import Leg, drive
from granfabric.dem_ref.loading.path import Segment, loading_cycles, principal_rotation

from .model_side import material
from .table import mean_and_scatter

Array = NDArray[np.float64]

AMPLITUDE = 0.2
"""Largest q/p of the cycles, and q/p of the turn."""

PATHS: dict[str, tuple[str, tuple[Segment, ...]]] = {
    "cycles": (
        "two cycles of q/p and a reversal",
        (
            *loading_cycles(AMPLITUDE, 2)[:4],
            Segment("biaxial", "constant_pressure", -0.02, -AMPLITUDE),
        ),
    ),
    "rotation": ("half a turn of the principal axes", tuple(principal_rotation(AMPLITUDE, 0.5))),
}
"""By name: what it is, and its segments."""

QUANTITIES = ("coordination", "fabric_along", "fabric_across", "normal_along", "tangential_along", "mean_normal_force")
FRACTIONS = np.linspace(0.0, 1.0, 11)
"""Where a segment is compared."""
TABLE_FRACTIONS = (0.5, 1.0)


@dataclass(frozen=True)
class PathRow:
    """One quantity of one closure somewhere along a path; means over the packings.

    Attributes
    ----------
    path, closure, quantity : str
    segment : int
        From 1.
    fraction : float
        Of the segment's stress path.
    stress_ratio, angle : float
        Signed q/p along the axis of first loading; direction of the major compression from it [degrees].
    dem, dem_scatter, model, error, error_scatter : float
    """

    path: str
    closure: str
    quantity: str
    segment: int
    fraction: float
    stress_ratio: float
    angle: float
    dem: float
    dem_scatter: float
    model: float
    error: float
    error_scatter: float

    def row(self) -> list[str | float | int]:
        """Values in the order of `PATH_COLUMNS`."""
        return [getattr(self, entry.name) for entry in fields(self)]


PATH_COLUMNS = tuple(entry.name for entry in fields(PathRow))


def positions(history: Mapping[str, Array]) -> tuple[Array, Array]:
    """Records (as floats) and segments at `FRACTIONS` of every segment; shape (nsegments * nfractions,) each."""
    segment = history["segment"].astype(int)
    stress = np.column_stack([history["stress_xx"] - history["stress_yy"], 2.0 * history["stress_xy"]])
    places, numbers = [], []
    # the last record of a segment already counts it as done
    for number in range(int(segment[-1])):
        first = int(np.flatnonzero(segment >= number)[0])
        last = int(np.flatnonzero(segment > number)[0])
        moved = np.hypot(*np.diff(stress[first : last + 1], axis=0).T)
        length = np.concatenate([[0.0], np.cumsum(moved)])
        places.append(np.interp(FRACTIONS * length[-1], length, np.arange(first, last + 1)))
        numbers.append(np.full(len(FRACTIONS), number + 1))
    return np.concatenate(places), np.concatenate(numbers)


def sampled(columns: Mapping[str, Array], places: Array) -> dict[str, Array]:
    """Columns interpolated at fractional records."""
    return {name: np.interp(places, np.arange(len(values)), values) for name, values in columns.items()}


def dem_columns(history: Mapping[str, Array], turning: bool) -> dict[str, Array]:
    """Quantities of the DEM; harmonics along the axis of first loading (y), or the major compression if `turning`."""
    axis = _axis(history, turning)
    columns = {"coordination": history["coordination"], "mean_normal_force": history["mean_normal_force"]}
    for name, prefix in (("fabric", "fabric"), ("normal", "normal_force"), ("tangential", "tangential_force")):
        vector = np.column_stack([history[f"{prefix}_xx"], history[f"{prefix}_xy"]])
        columns[f"{name}_along"] = np.einsum("ri,ri->r", vector, axis)
        if name == "fabric":
            columns["fabric_across"] = vector[:, 1] * axis[:, 0] - vector[:, 0] * axis[:, 1]
    return columns


def _axis(history: Mapping[str, Array], turning: bool) -> Array:
    """Double-angle direction of the axis at every record."""
    if not turning:
        return np.tile([-1.0, 0.0], (len(history["p"]), 1))
    s = -np.column_stack([0.5 * (history["stress_xx"] - history["stress_yy"]), history["stress_xy"]])
    size = np.hypot(*s.T)
    return np.where((size > 1e-3 * history["p"])[:, None], s / np.maximum(size, 1e-300)[:, None], [-1.0, 0.0])


def model_columns(
    closure: Closure, inputs: Mapping[str, float], history: Mapping[str, Array], turning: bool
) -> tuple[dict[str, Array], str]:
    """The point law along the recorded stresses; NaN beyond where it could not go on, and why."""
    law = ContactLaw([material(inputs)], closure=closure, effects=Effects())
    stress = np.column_stack([history[f"stress_{name}"] for name in ("xx", "yy", "xy")])
    found = drive(law, tuple(stress[0]), [Leg(target=tuple(target)) for target in stress[1:]])
    axis = _axis(history, turning)
    count = len(history["p"])

    def whole(values: Array) -> Array:
        padded = np.full(count, np.nan)
        padded[: len(values)] = values
        return padded

    columns = {name: whole(found.columns[name]) for name in ("coordination", "mean_normal_force")}
    for name, prefix in (("fabric", "fabric"), ("normal", "normal_force"), ("tangential", "tangential_force")):
        first, second = (whole(found.columns[f"{prefix}_anisotropy_{part}"]) for part in (1, 2))
        columns[f"{name}_along"] = first * axis[:, 0] + second * axis[:, 1]
        if name == "fabric":
            columns["fabric_across"] = second * axis[:, 0] - first * axis[:, 1]
    return columns, "" if found.finished else found.message


def compare_path(
    path: str,
    closure: str,
    dem: Sequence[Mapping[str, Array]],
    model: Sequence[Mapping[str, Array]],
    segments: Array,
    stress_ratio: Array,
    angle: Array,
) -> list[PathRow]:
    """Rows at `TABLE_FRACTIONS` of every segment, from samples of every packing."""
    rows = []
    wanted = [place for place in range(len(segments)) if FRACTIONS[place % len(FRACTIONS)] in TABLE_FRACTIONS]
    for quantity in QUANTITIES:
        measured = np.array([columns[quantity] for columns in dem])
        answered = np.array([columns[quantity] for columns in model])
        for place in wanted:
            both = np.isfinite(measured[:, place]) & np.isfinite(answered[:, place])
            one, other = measured[both, place], answered[both, place]
            rows.append(
                PathRow(
                    path, closure, quantity, int(segments[place]), float(FRACTIONS[place % len(FRACTIONS)]),
                    float(stress_ratio[place]), float(angle[place]), *mean_and_scatter(one), mean_and_scatter(other)[0],
                    *mean_and_scatter(other - one),
                )
            )  # fmt: skip
    return rows
