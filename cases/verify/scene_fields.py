"""Two runs of one field scene, by the law and by grains at the points: what differs at the end, and how much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import RunError
from granfabric.cases.records import files, series

from .scene_specimens import OneSpecimen, mean_fields, with_error

Array = NDArray[np.float64]

COLUMNS = ("quantity", "law", "grains", "difference", "rms", "correlation")
OF_SPECIMENS = (
    "specimens", "standard_error", "law_rms", "grains_rms", "law_correlation", "grains_correlation",
)  # fmt: skip
"""Further columns with specimens: their mean with its standard error, and how law and grains differ from it."""
AT_POINTS = ("change of z at points", "change of a_c along x at points", "q/p at points")
POINTS, NODES = "points", "nodes"
FIELDS = ("coordination", "fabric_anisotropy", "stress_ratio")
REQUIRED = ("coordination", "fabric_anisotropy", "stress")


@dataclass(frozen=True)
class Ended:
    """A run at the last step that both have.

    Parameters
    ----------
    history : dict of str to ndarray
        Columns of `history.csv`, numbers only.
    row : int
        Of the step in it.
    nodes, points : dict of str to ndarray
        Changes of `FIELDS` since the initial state (the stress ratio itself), at nodes and at integration points; of
        the fabric anisotropy the component along x, positive where more contacts point along x than along y.
    mesh : meshio.Mesh
        Of the step.
    places : ndarray, shape (npt, 2)
        Of the integration points [m].
    at : tuple
        Stage and fraction of it.
    """

    history: dict[str, Array]
    row: int
    nodes: dict[str, Array]
    points: dict[str, Array]
    mesh: Any
    places: Array
    at: tuple[str, float]


def _history(folder: Path) -> tuple[list[tuple[str, float]], dict[str, Array]]:
    names, rows = files.read_rows(folder / files.HISTORY)
    at = [(row[names.index("stage")], round(float(row[names.index("fraction")]), 9)) for row in rows]
    columns = {name: [row[place] for row in rows] for place, name in enumerate(names) if name != "stage"}
    return at, {name: np.array(values, dtype=np.float64) for name, values in columns.items()}


def _fields(mesh: Any) -> dict[str, Array]:
    stress = np.asarray(mesh.point_data["stress"])
    fabric = np.asarray(mesh.point_data["fabric_anisotropy"])
    # of a law whose principal axes stay along x and y it is the one component there is
    along = fabric if fabric.ndim == 1 else fabric[:, 0]
    pressure = -0.5 * (stress[:, 0] + stress[:, 4])
    return {
        "coordination": np.asarray(mesh.point_data["coordination"]).ravel(),
        "fabric_anisotropy": along,
        "stress_ratio": np.hypot(0.5 * (stress[:, 0] - stress[:, 4]), stress[:, 1]) / pressure,
    }


def _changes(folder: Path, kind: str, step: int) -> tuple[dict[str, Array], Any]:
    there = series.steps(folder, kind)
    first, last = (series.read(there[number], REQUIRED) for number in (0, step))
    before, after = _fields(first), _fields(last)
    # each packing has a coordination and an anisotropy of its own to begin with
    found = {name: after[name] - before[name] for name in ("coordination", "fabric_anisotropy")}
    return {**found, "stress_ratio": after["stress_ratio"]}, last


def ended(folders: tuple[Path, Path]) -> tuple[Ended, Ended]:
    """Both runs at the last step at which both are, by stage and fraction of it.

    Raises
    ------
    RunError
        If they share no step beyond the initial state.
    """
    histories = [_history(folder) for folder in folders]
    shared = [at for at in histories[0][0][1:] if at in histories[1][0]]
    for at in reversed(shared):
        rows = [places.index(at) for places, _ in histories]
        steps = [int(columns["step"][row]) for row, (_, columns) in zip(rows, histories)]
        if all(step in series.steps(folder, "points") for folder, step in zip(folders, steps)):
            break
    else:
        raise RunError("the law and the grains have no step in common whose fields were written")
    made = []
    for folder, row, step, (_, columns) in zip(folders, rows, steps, histories):
        nodes, mesh = _changes(folder, "result", step)
        points, there = _changes(folder, "points", step)
        made.append(Ended(columns, row, nodes, points, mesh, np.asarray(there.points)[:, :2], at))
    return made[0], made[1]


def table(law: Ended, grains: Ended) -> list[list[Any]]:
    """Rows of `COLUMNS`: mean values with their difference, and of fields what differs from point to point."""
    rows: list[list[Any]] = []
    for name in law.history:
        if not name.startswith("reaction_") or not name.endswith(("_x", "_y")) or name not in grains.history:
            continue
        start = law.history[name][0]
        values = [run.history[name][run.row] - run.history[name][0] for run in (law, grains)]
        if abs(start) > 1e-6 * max(abs(run.history[other][0]) for run in (law,) for other in run.history
                                   if other.startswith("reaction_")):  # fmt: skip
            rows.append(_row(f"{name}, increment over initial", *(value / start for value in values)))
    rows.append(_row("initial z", *(run.history["coordination"][0] for run in (law, grains))))
    for run_column, text in (("coordination", "mean change of z"), ("stress_ratio_largest", "largest q/p")):
        values = [run.history[run_column][run.row] for run in (law, grains)]
        if run_column == "coordination":
            values = [value - run.history[run_column][0] for value, run in zip(values, (law, grains))]
        rows.append(_row(text, *values))
    for name, text in zip(FIELDS, AT_POINTS):
        a, b = law.points[name], grains.points[name]
        alike = _correlation(a, b)
        rows.append([*_row(text, float(a.mean()), float(b.mean()))[:4], float(np.sqrt(np.mean((a - b) ** 2))), alike])
    return rows


def table_with_specimens(
    rows: list[list[Any]], law: Ended, grains: Ended, found: Sequence[OneSpecimen]
) -> list[list[Any]]:
    """The rows with mean and standard error of the specimens, and what law and grains are off by.

    Of fields at points: root mean square differences of law and of grains from the mean of the specimens, and the
    correlation of each with it.
    """
    means = mean_fields(found, POINTS)
    made = []
    for row in rows:
        text = str(row[0])
        if text.startswith("reaction_"):
            values = with_error([one.reaction for one in found])
        elif text == "initial z":
            values = with_error([one.coordination[0] for one in found])
        elif text == "mean change of z":
            values = with_error([one.coordination[1] - one.coordination[0] for one in found])
        else:
            name = next((name for name, words in zip(FIELDS, AT_POINTS) if text == words), None)
            if name is None:
                made.append([*row, "", "", "", "", "", ""])
                continue
            told = np.isfinite(means[name])
            off = [(run.points[name] - means[name])[told] for run in (law, grains)]
            alike = [_correlation(run.points[name][told], means[name][told]) for run in (law, grains)]
            rms = [float(np.sqrt(np.mean(values**2))) for values in off]
            mean, error = float(means[name][told].mean()), ""
            if name == "fabric_anisotropy":  # over all contacts
                mean, error = with_error([one.fabric[1] - one.fabric[0] for one in found])  # type: ignore[assignment]
            made.append([*row, mean, error, *rms, *alike])
            continue
        made.append([*row, *values, "", "", "", ""])
    return made


def _correlation(a: Array, b: Array) -> float | str:
    return float(np.corrcoef(a, b)[0, 1]) if np.ptp(a) > 1e-12 and np.ptp(b) > 1e-12 else ""


def _row(text: str, law: float, grains: float) -> list[Any]:
    return [text, float(law), float(grains), float(law - grains), "", ""]
