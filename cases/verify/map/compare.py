"""Errors of the point law along the paths of the map, with the scatter between packings as the yardstick."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.verify.paths import QUANTITIES, dem_columns, sampled
from granfabric.cases.verify.table import mean_and_scatter

from .paths import MapPath
from .sampling import Reach, common_reach, places, reach, vectors

Array = NDArray[np.float64]

RELATIVE = ("coordination", "mean_normal_force")
"""Quantities whose errors are told in per cent of their values at the start."""

ROUNDING = 1e-6
"""Of fractional numbers of records."""


@dataclass(frozen=True)
class MapRow:
    """The largest error of one quantity of one closure along a path; means over the packings.

    Attributes
    ----------
    material, path, closure, quantity : str
    packings : int
        Those of which both sides got to where the error is largest.
    error : float
        Model minus DEM.
    error_percent : float
        The same over the DEM's value at the start; of coordination number and mean force, NaN for the others.
    segment, fraction, stress_ratio, pressure_ratio, angle
        Where: segment from 1, fraction of its stress path, q/p (signed along the first loading unless the axes turn),
        p over its first value, direction of the major compression from y [degrees].
    dem, model : float
        There, means over those packings.
    scatter : float
        Standard deviation of the DEM's value between all packings there; NaN for a single one.
    error_over_scatter : float
    compared_to_stress_ratio : float
        q/p to which packings are compared that do not carry the path to its end; NaN if all do.
    refused_inputs : int
        Packings whose measured inputs the law refused.
    refused_packings : int
        Others whose path it did not follow to the end.
    refused_fraction, refused_stress_ratio, refused_pressure_ratio : float
        Where, counted over the whole path; of the packing with which it got least far.
    all_packings : int
        That the DEM carried.
    message : str
        Why the law refused, or why there is nothing of the DEM.
    """

    material: str
    path: str
    closure: str
    quantity: str
    packings: int
    error: float
    error_percent: float
    segment: int
    fraction: float
    stress_ratio: float
    pressure_ratio: float
    angle: float
    dem: float
    model: float
    scatter: float
    error_over_scatter: float
    compared_to_stress_ratio: float
    refused_inputs: int
    refused_packings: int
    refused_fraction: float
    refused_stress_ratio: float
    refused_pressure_ratio: float
    all_packings: int
    message: str

    def row(self) -> list[str | float | int]:
        """Values in the order of `MAP_COLUMNS`."""
        return [getattr(self, entry.name) for entry in fields(self)]


MAP_COLUMNS = tuple(entry.name for entry in fields(MapRow))


@dataclass(frozen=True)
class Refusal:
    """Where the law went no further on a packing.

    Attributes
    ----------
    seed : int
    fraction : float
        Of the places of comparison, that it passed.
    stress_ratio, pressure_ratio : float
    message : str
    of_inputs : bool
        It does not take the inputs: there is no first step.
    """

    seed: int
    fraction: float
    stress_ratio: float
    pressure_ratio: float
    message: str
    of_inputs: bool = False


@dataclass
class Cell:
    """Both sides along a path, on the packings of a material.

    Attributes
    ----------
    material, path : str
    seeds : list of int
        Those with both sides.
    segment, fraction, stress_ratio, pressure_ratio, angle : ndarray, shape (nplaces,)
        Places of comparison; means over the packings.
    dem : dict of ndarray, shape (npackings, nplaces)
        By quantity.
    model : dict of dict of ndarray, shape (npackings, nplaces)
        By closure and quantity; NaN beyond where the law refused.
    refusals : dict of list of Refusal
        By closure.
    limit : Reach or None
        To where packings are compared that do not carry the whole path.
    failures : list of str
        Why packings are missing.
    """

    material: str
    path: str
    seeds: list[int] = field(default_factory=list)
    segment: Array = field(default_factory=lambda: np.zeros(0))
    fraction: Array = field(default_factory=lambda: np.zeros(0))
    stress_ratio: Array = field(default_factory=lambda: np.zeros(0))
    pressure_ratio: Array = field(default_factory=lambda: np.zeros(0))
    angle: Array = field(default_factory=lambda: np.zeros(0))
    dem: dict[str, Array] = field(default_factory=dict)
    model: dict[str, dict[str, Array]] = field(default_factory=dict)
    refusals: dict[str, list[Refusal]] = field(default_factory=dict)
    limit: Reach | None = None
    failures: list[str] = field(default_factory=list)


def cell(
    material: str,
    name: str,
    path: MapPath,
    closures: Sequence[str],
    packings: Mapping[int, tuple[Mapping[str, Any], Mapping[str, Any]]],
    failures: Sequence[str] = (),
) -> Cell:
    """Both sides at the same places.

    Parameters
    ----------
    material, name : str
    path : MapPath
    closures : sequence of str
    packings : mapping
        By seed: what came of the DEM (``history``, ``reason``) and of the law (by closure ``columns``, ``message``).
    failures : sequence of str
    """
    found = Cell(material, name, failures=list(failures), refusals={closure: [] for closure in closures})
    if not packings:
        return found
    count = len(path.segments)
    found.seeds = list(packings)
    found.limit = common_reach([reach(dem["history"], path, dem["reason"]) for dem, _ in packings.values()], count)
    at = {seed: places(dem["history"], count, found.limit) for seed, (dem, _) in packings.items()}
    shortest = min(len(entry.record) for entry in at.values())
    first = next(iter(at.values()))
    found.segment, found.fraction = first.segment[:shortest], first.fraction[:shortest]
    measured, stresses = [], []
    answers: dict[str, list[dict[str, Array]]] = {closure: [] for closure in closures}
    for seed, (dem, law) in packings.items():
        history, records = dem["history"], at[seed].record[:shortest]
        measured.append(sampled(dem_columns(history, path.turning), records))
        stress = vectors(history)
        stresses.append(np.column_stack([np.interp(records, np.arange(len(stress)), part) for part in stress.T]))
        stresses[-1] /= stress[0, 0]
        for closure in closures:
            answer = law[closure]
            answers[closure].append(_answered(answer["columns"], records))
            refusal = _refusal(seed, answer, records, stress / stress[0, 0])
            if refusal is not None:
                found.refusals[closure].append(refusal)
    p, s1, s2 = np.mean(stresses, axis=0).T if shortest else np.zeros((3, 0))
    found.pressure_ratio = p
    found.stress_ratio = (np.hypot(s1, s2) if path.turning else -s1) / p
    found.angle = _angle(p, s1, s2)
    found.dem = {name: np.array([columns[name] for columns in measured]) for name in QUANTITIES}
    found.model = {
        closure: {name: np.array([columns[name] for columns in entries]) for name in QUANTITIES}
        for closure, entries in answers.items()
    }
    return found


def _angle(p: Array, s1: Array, s2: Array) -> Array:
    """Direction of the major compression from y [degrees], continuous; zero while the stress is isotropic."""
    clear = np.hypot(s1, s2) > 1e-2 * p
    angle = np.zeros(len(p))
    angle[clear] = np.degrees(np.unwrap(np.arctan2(-s2[clear], -s1[clear]))) / 2.0
    return angle


def _answered(columns: Mapping[str, Array], records: Array) -> dict[str, Array]:
    """The law's columns at fractional records, NaN beyond the last that it has."""
    if not columns:
        return {name: np.full(len(records), np.nan) for name in QUANTITIES}
    count = int(np.count_nonzero(np.isfinite(columns["coordination"])))
    found = sampled({name: columns[name][:count] for name in QUANTITIES}, records)
    return {name: np.where(records <= count - 1 + ROUNDING, values, np.nan) for name, values in found.items()}


def _refusal(seed: int, answer: Mapping[str, Any], records: Array, stress: Array) -> Refusal | None:
    """Where the law stopped; None if it got to the last place of comparison."""
    answered = answer["columns"].get("coordination", np.zeros(0))
    last = max(int(np.count_nonzero(np.isfinite(answered))) - 1, 0)
    if not len(records) or (answer["columns"] and records[-1] <= last + ROUNDING):
        return None
    p, s1, s2 = stress[last]
    passed = int(np.count_nonzero(records <= last + ROUNDING)) - 1
    return Refusal(
        seed, max(passed, 0) / (len(records) - 1), float(np.hypot(s1, s2) / p), float(p), answer["message"],
        not answer["columns"],
    )  # fmt: skip


def rows_of(found: Cell) -> list[MapRow]:
    """One row a closure and quantity."""
    return [_row(found, closure, quantity) for closure in found.refusals for quantity in QUANTITIES]


def _row(found: Cell, closure: str, quantity: str) -> MapRow:
    refusals = found.refusals[closure]
    on_its_way = [entry for entry in refusals if not entry.of_inputs]
    least = min(on_its_way or refusals, key=lambda entry: entry.fraction, default=None)
    error, place, count = largest_error(found, closure, quantity)
    where = dict.fromkeys(_WHERE, np.nan)
    dem = model = scatter = percent = np.nan
    if place is not None:
        where = {name: float(getattr(found, name)[place]) for name in _WHERE}
        measured, answered = found.dem[quantity], found.model[closure][quantity][:, place]
        both = np.isfinite(answered)
        dem, model = float(measured[both, place].mean()), float(answered[both].mean())
        scatter = mean_and_scatter(measured[:, place])[1]
        if quantity in RELATIVE:
            percent = 100.0 * error / float(measured[:, 0].mean())
    return MapRow(
        material=found.material,
        path=found.path,
        closure=closure,
        quantity=quantity,
        packings=count,
        error=error,
        error_percent=percent,
        segment=0 if place is None else int(found.segment[place]),
        **where,
        dem=dem,
        model=model,
        scatter=scatter,
        error_over_scatter=abs(error) / scatter if scatter > 0.0 else np.nan,
        compared_to_stress_ratio=np.nan if found.limit is None else found.limit.ratio,
        refused_inputs=len(refusals) - len(on_its_way),
        refused_packings=len(on_its_way),
        refused_fraction=np.nan if least is None else least.fraction,
        refused_stress_ratio=np.nan if least is None else least.stress_ratio,
        refused_pressure_ratio=np.nan if least is None else least.pressure_ratio,
        all_packings=len(found.seeds),
        message=least.message if least is not None else "; ".join(found.failures),
    )


_WHERE = ("fraction", "stress_ratio", "pressure_ratio", "angle")


def largest_error(found: Cell, closure: str, quantity: str) -> tuple[float, int | None, int]:
    """Largest mean error by size, its place, and how many packings it is a mean of; NaN, None and 0 without any."""
    if closure not in found.model or not found.model[closure][quantity].size:
        return float("nan"), None, 0
    difference = found.model[closure][quantity] - found.dem[quantity]
    count = np.isfinite(difference).sum(axis=0)
    if not count.any():
        return float("nan"), None, 0
    mean = np.where(count > 0, np.nansum(difference, axis=0) / np.maximum(count, 1), np.nan)
    place = int(np.nanargmax(np.abs(mean)))
    return float(mean[place]), place, int(count[place])


CURVE_COLUMNS = (
    "material", "path", "segment", "fraction", "stress_ratio", "pressure_ratio", "angle", "quantity", "dem", "scatter",
)  # fmt: skip


def curve_rows(found: Cell) -> list[list[str | float | int]]:
    """Every place and quantity; the columns after `CURVE_COLUMNS` are the closures."""
    rows: list[list[str | float | int]] = []
    for quantity, measured in found.dem.items():
        for place in range(len(found.segment)):
            rows.append(
                [
                    found.material, found.path, int(found.segment[place]),
                    *(float(getattr(found, name)[place]) for name in _WHERE), quantity,
                    *mean_and_scatter(measured[:, place]),
                    *(float(mean_of_all(answer[quantity])[place]) for answer in found.model.values()),
                ]
            )  # fmt: skip
    return rows


def mean_of_all(values: Array) -> Array:
    """Mean over the packings that the law takes, NaN from where the first of them is refused; shape (nplaces,)."""
    taken = values[np.isfinite(values).any(axis=1)] if values.size else values
    return taken.mean(axis=0) if len(taken) else np.full(values.shape[1], np.nan)
