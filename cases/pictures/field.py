"""Picture of a field run, from `history.csv` and the last files of the two series."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from granfabric.cases.records import series
from granfabric.cases.records.body_columns import OF_A_BODY
from granfabric.cases.records.units import unit

from .maps import chosen_maps, draw_map, is_wide
from .style import BLACK, BLUE, RED, picture

Array = NDArray[np.float64]

SYMBOLS = {"strain_xx": r"\varepsilon_{xx}", "strain_yy": r"\varepsilon_{yy}", "strain_xy": r"\gamma_{xy}"}


def draw_field(folder: Path, columns: dict[str, NDArray[Any]], scene: dict[str, Any]) -> list[Path]:
    """Draw `overview.png`: curves of the means, and maps of the last step.

    Parameters
    ----------
    folder : Path
    columns : dict of str to ndarray, shape (nsteps + 1,)
        Columns of `history.csv`.
    scene : dict
        The scene as resolved; its output names the maps and the first curve, if they are not left to the program.

    Returns
    -------
    list of Path
    """
    path = folder / "overview.png"
    fields, points = series.last_file(folder, "result"), series.last_file(folder, "points")
    output = scene.get("output", {})
    if fields is None or points is None:
        with picture(path, 5.5, 6.0) as figure:
            _curves(figure.add_subplot(2, 1, 1), figure.add_subplot(2, 1, 2), columns, scene)
        return [path]
    first = series.first_file(folder, "result")
    last, cloud = series.read(fields), series.read(points)
    start = last if first is None else _beginning(folder, last, series.read(first))
    maps = chosen_maps(list(output.get("maps", [])), last)
    above = is_wide(last)
    rows, across = (len(maps), 1) if above else (1, len(maps))
    width, height = (11.0, max(6.0, 3.4 * len(maps))) if above else (5.5 + 3.75 * len(maps), 6.0)
    with picture(path, width, height) as figure:
        parts: Any = figure.subfigures(1, 2, width_ratios=[1.0, 1.2] if above else [1.25, len(maps)])
        left, right = parts
        _curves(left.add_subplot(2, 1, 1), left.add_subplot(2, 1, 2), columns, scene)
        for place, name in enumerate(maps):
            draw_map(right, right.add_subplot(rows, across, place + 1), name, last, start, cloud)
        step, stage = int(columns["step"][-1]), str(columns["stage"][-1])
        title = f"{scene['title']} (step {step}, stage {stage})"
        figure.suptitle(title, x=0.01, ha="left", fontsize=13, parse_math=False)
    return [path]


def _beginning(folder: Path, last: Any, first: Any) -> Any:
    """Fields of the nodes of the last file as each of them began: in the first file that has it."""
    if len(first.points) == len(last.points) and np.array_equal(first.points, last.points):
        return first
    begun = {name: np.full_like(values, np.nan) for name, values in last.point_data.items()}
    missing, wanted = np.arange(len(last.points)), _labelled(last)
    for file in series.steps(folder, "result").values():
        content = series.read(file)
        distance, found = cKDTree(_labelled(content)).query(wanted[missing])
        there = distance == 0.0
        for name, values in begun.items():
            values[missing[there]] = content.point_data[name][found[there]]
        missing = missing[~there]
        if not len(missing):
            break
    return meshio.Mesh(last.points, last.cells, point_data=begun)


def _labelled(mesh: Any) -> Array:
    """Places of the nodes with the material instead of z: where materials meet, each has a node of its own there."""
    places = np.array(mesh.points, dtype=np.float64)
    places[:, 2] = 0.0
    for block, material in zip(mesh.cells, mesh.cell_data.get("material", [])):
        places[block.data, 2] = np.asarray(material)[:, None]
    return places


def _abscissa(columns: dict[str, NDArray[Any]], scene: dict[str, Any]) -> tuple[Array, str]:
    """The mean strain that changes most if displacements drive the scene, else the progress through its stages."""
    stages = scene.get("stage", [])
    if not any(stage.get("displacement") for stage in stages):
        order = {stage["name"]: place for place, stage in enumerate(stages)}
        names = list(order)
        at = np.array([order.get(name, 0) for name in columns["stage"].tolist()])
        where = at + columns["fraction"].astype(np.float64)
        return where, "stage: " + ", ".join(f"{place} to {place + 1} {name}" for place, name in enumerate(names))
    name = max(SYMBOLS, key=lambda key: float(np.ptp(columns[key])))
    sign = -1.0 if columns[name][np.argmax(np.abs(columns[name]))] < 0 else 1.0
    return sign * columns[name] * 1e6, f"mean strain ${'-' if sign < 0 else ''}{SYMBOLS[name]}$ [$10^{{-6}}$]"


def _curves(above: Any, below: Any, columns: dict[str, NDArray[Any]], scene: dict[str, Any]) -> None:
    place, label = _abscissa(columns, scene)
    marker: dict[str, Any] = {"marker": "o", "markersize": 3.5}
    pair = scene.get("output", {}).get("curve")
    if pair and all(name in columns for name in pair):
        (x, x_label), (y, y_label) = (_named(name, columns[name]) for name in pair)
        above.plot(x, y, color=BLACK, **marker)
        above.set(xlabel=x_label, ylabel=y_label, title="Response")
    else:
        carried = columns.get("effective_p", columns["p"])
        above.plot(place, columns["q"] / carried, color=BLACK, label="of the mean stress", **marker)
        above.plot(place, columns["stress_ratio_largest"], color=RED, linestyle="--", label="largest of all points")
        above.set(xlabel=label, ylabel="stress ratio $q/p$ [-]", title="Stress ratio")
        above.legend()
    low, high = columns["coordination_smallest"], columns["coordination_largest"]
    below.fill_between(place, low, high, color=BLUE, alpha=0.2, linewidth=0, label="all points")
    below.plot(place, columns["coordination"], color=BLUE, label="mean", **marker)
    below.set(xlabel=label, ylabel="coordination number $z$ [-]", title="Contact network")
    below.ticklabel_format(axis="y", useOffset=False)
    if float(np.max(high) - np.min(low)) < 1e-9:  # a network that is kept: rounding is not magnified
        below.set_ylim(float(np.min(low)) - 0.01, float(np.max(high)) + 0.01)
    below.legend()


SCALES = {
    "Pa": (1e-3, "kPa"),
    "N/m": (1e-3, "kN/m"),
    "N m/m": (1e-3, "kN m/m"),
    "m": (1e6, "$10^{-6}$ m"),
    "rad": (1e6, "$10^{-6}$ rad"),
}
"""Factor and name of the handy unit for each of the history."""
STRAIN = re.compile(r"(.*_)?strain_(xx|yy|xy)")


def _handy(name: str) -> tuple[float, str]:
    """Factor and name of the unit in which a column is drawn."""
    return (1e6, "$10^{-6}$") if STRAIN.fullmatch(name) else SCALES.get(unit(name), (1.0, "-"))


def _named(name: str, values: Array) -> tuple[Array, str]:
    """A column of the history in handy units, mostly positive, with its label."""
    head, _, rest = name.partition("_")
    factor, shown = _handy(name)
    sign = -1.0 if values[np.argmax(np.abs(values))] < 0 else 1.0
    if head == "rigid":
        what = next(what for what in OF_A_BODY if rest.endswith(f"_{what}"))
        words = f"{what.replace('_', ' ')} of body {rest.removesuffix(f'_{what}')}"
    else:
        of_boundary = head in ("displacement", "reaction", "spring")
        words = " ".join([head, *(["of", *rest.rsplit("_", 1)] if of_boundary else [rest.replace("_", " ")])])
    return sign * factor * values, f"{'minus ' if sign < 0 else ''}{words.strip()} [{shown}]"
