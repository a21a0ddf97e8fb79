"""The map as tables: materials by paths, on the screen and in `map.md`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from granfabric.cases.verify.model_side import BEST, SOURCE
from granfabric.cases.verify.text import table

from .compare import MapRow
from .paths import MAP_PATHS

if TYPE_CHECKING:
    from .result import MapResult

PAIRS = (
    (("coordination", "fabric_along"), "z [% of z0], a_c"),
    (("normal_along", "tangential_along"), "a_n, a_t"),
)
"""Quantities that share a cell."""
SYMBOLS = {
    "coordination": "z",
    "fabric_along": "a_c",
    "fabric_across": "a_c across",
    "normal_along": "a_n",
    "tangential_along": "a_t",
    "mean_normal_force": "f/f0",
}
NOTHING = "-"
GAP = 2
"""Spaces between columns on the screen."""

Cells = Mapping[tuple[str, str, str, str], MapRow]


def by_cell(rows: Iterable[MapRow]) -> dict[tuple[str, str, str, str], MapRow]:
    """Rows by material, path, closure and quantity."""
    return {(row.material, row.path, row.closure, row.quantity): row for row in rows}


def shown(row: MapRow) -> str:
    """A signed error: per cent of the start for coordination number and mean force."""
    if not math.isfinite(row.error):
        return NOTHING
    return f"{row.error_percent:+.1f}" if math.isfinite(row.error_percent) else f"{row.error:+.3f}"


def scatter_shown(row: MapRow) -> str:
    """The scatter between packings in the unit of the error; empty for a single packing."""
    if not math.isfinite(row.scatter) or not math.isfinite(row.error):
        return ""
    if math.isfinite(row.error_percent) and row.error:
        return f"{row.scatter * row.error_percent / row.error:.1f}"
    return f"{row.scatter:.3f}"


def where_refused(row: MapRow) -> str:
    """To where the law followed the path, in the path's own coordinate; empty if to its end."""
    if not row.refused_packings:
        return f"{_of(row.refused_inputs, row)}inputs refused" if row.refused_inputs else ""
    abscissa = MAP_PATHS[row.path].abscissa
    if abscissa == "pressure_ratio":
        place = f"p/p0 {row.refused_pressure_ratio:.2f}"
    elif abscissa == "stress_ratio":
        place = f"q/p {row.refused_stress_ratio:.2f}"
    else:
        place = f"{100.0 * row.refused_fraction:.0f} % of it"
    return f"{_of(row.refused_packings, row)}refused at {place}"


def _of(count: int, row: MapRow) -> str:
    return f"{count}/{row.all_packings} " if count < row.all_packings else ""


def is_refused(row: MapRow) -> bool:
    """Whether the law did not follow the path to its end on every packing."""
    return row.refused_packings + row.refused_inputs > 0


def lines_of(cells: Cells, material: str, path: str, closure: str, quantities: Sequence[str]) -> list[str]:
    """Lines of a cell: the errors, where the law refused, to where packings carry the path."""
    rows = [cells[material, path, closure, quantity] for quantity in quantities]
    first = rows[0]
    if all(not math.isfinite(row.error) for row in rows) and not is_refused(first):
        return ["no DEM"]
    lines = [" ".join(shown(row) for row in rows)]
    if is_refused(first):
        lines.append(where_refused(first))
    if math.isfinite(first.compared_to_stress_ratio):
        lines.append(f"to q/p {first.compared_to_stress_ratio:.2f}")
    return lines


def blocks(result: MapResult, closure: str, quantities: Sequence[str], width: int) -> list[list[list[str]]]:
    """Tables with head that are no wider than `width` characters each: materials and as many paths as there is room."""
    cells = by_cell(result.rows)
    first = ["material", *(material.name for material in result.materials)]
    left = max(map(len, first))
    columns: list[list[str]] = []
    for name, path in result.paths.items():
        texts = ["\n".join(lines_of(cells, material.name, name, closure, quantities)) for material in result.materials]
        columns.append([path.short, *texts])
    sizes = [max(len(line) for text in column for line in text.split("\n")) for column in columns]
    found: list[list[list[str]]] = []
    used = width + 1
    for column, size in zip(columns, sizes):
        if used + GAP + size > width:
            found.append([first])
            used = left
        found[-1].append(column)
        used += GAP + size
    return [[list(row) for row in zip(*group)] for group in found]


def told_closures(closures: Sequence[str]) -> list[str]:
    """Closures of the printed tables: the one that follows the weak forces, then the source's."""
    return [name for name in (BEST, SOURCE) if name in closures] or list(closures)


def markdown(result: MapResult) -> str:
    """Text of `map.md`."""
    cells = by_cell(result.rows)
    seeds = ", ".join(map(str, result.seeds))
    one = len(result.seeds) == 1
    sections = [
        "# Map of the point law against the DEM",
        f"Packings of {result.particles} disks, {'seed' if one else 'seeds'} {seeds}. Each packing's measured inputs "
        "went into the law; nothing was fitted to the curves. A cell holds the largest error (law minus DEM) along the "
        "path of means over the packings, z in % of z0"
        + ("" if one else ", with the standard deviation of the DEM between packings there in parentheses")
        + ". Where the law refused a path it is said how far it got, and the error is that up to there.",
    ]
    for closure in result.closures:
        sections.append(f"## {closure}")
        for quantities, head in PAIRS:
            sections.append(f"{head}:")
            sections.append(_markdown_table(result, cells, closure, quantities))
    if result.refusals:
        sections.append("## Refused")
        sections += ["\n".join(f"- {line}" for line in result.refusals)]
    if result.failures:
        sections.append("## Missing")
        sections += ["\n".join(f"- {line}" for line in result.failures)]
    sections += ["## Materials", _inputs(result), "## Paths"]
    sections += ["![The map](map.png)"]
    sections += [f"![{path.title}](map_{name}.png)\n\n{path.title}." for name, path in result.paths.items()]
    return "\n\n".join(sections) + "\n"


def _markdown_table(result: MapResult, cells: Cells, closure: str, quantities: Sequence[str]) -> str:
    rows = []
    for material in result.materials:
        texts = []
        for name in result.paths:
            entries = [cells[material.name, name, closure, quantity] for quantity in quantities]
            lines = lines_of(cells, material.name, name, closure, quantities)
            with_scatter = [f"{shown(row)} ({text})" if (text := scatter_shown(row)) else shown(row) for row in entries]
            if lines[0] != "no DEM":
                lines[0] = ", ".join(with_scatter)
            texts.append("; ".join(lines))
        rows.append([material.title, *texts])
    return table(["material", *(path.short for path in result.paths.values())], rows)


INPUTS = ("coordination", "solid_fraction", "force_density_at_zero", "gap_density_at_zero", "slip")


def _inputs(result: MapResult) -> str:
    """Keys of the packings and some of what was measured on them."""
    rows = []
    for material in result.materials:
        measured = result.inputs.get(material.name)
        values = measured.values if measured is not None else {}
        given = ", ".join(f"{key} = {value}" for key, value in material.given.items()) or "defaults"
        rows.append([f"`{material.name}`", given, *(f"{values[key]:.4g}" if key in values else "-" for key in INPUTS)])
    return table(["material", "packing", *(f"`{key}`" for key in INPUTS)], rows)
