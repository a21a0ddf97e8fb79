"""`cost.md`: question, picture, findings and table of each study on one page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from .study import Column, Row, Study

SHOWN = ("facet", "series", "setting", "error", "seconds", "count", "on_front")
"""Columns of every table on the page; the CSV has all."""
EXTRA = {
    "integrators": ("substeps", "rejected"),
    "arcs": ("rate_evaluations",),
    "distributions": ("difference", "difference_median"),
    "footing": ("mean_pressure", "newton_iterations", "factorisations"),
    "closures": ("error_coordination", "error_fabric", "scatter_of_packings"),
    "tangents": ("newton_iterations", "factorisations", "krylov_iterations"),
    "mesh": ("stress_error", "nonzeros", "factorisations"),
    "load_steps": ("newton_iterations", "factorisations", "cuts"),
    "effects": ("quantity", "relative_time", "state_columns", "memory_per_point", "uncoupled"),
    "decisions": ("estimate", "left_out", "seconds_everything", "seconds_probe", "speedup", "uncoupled", "within"),
    "dem": ("error_coordination", "error_fabric", "packing_seconds"),
}


def page(record: dict[str, Any], studies: Sequence[tuple[Study, Sequence[Row]]]) -> str:
    """The page in Markdown.

    Parameters
    ----------
    record : dict
        Content of `cost.json`.
    studies : sequence of (Study, rows)
        What is in the folder.
    """
    out = [
        "# What accuracy costs",
        "",
        "Made by `granfabric cost`. Times are processor time of one thread, the best of several, and belong to one "
        "machine; counts do not. Filled markers lie on the Pareto front: nothing else is both cheaper and more "
        "accurate.",
        "",
    ]
    for study, rows in studies:
        out += _section(study, rows, record["studies"][study.name])
    versions = ", ".join(f"{name} {number}" for name, number in record["versions"].items())
    out += ["## Made with", "", f"{versions}; {record['machine']}.", ""]
    return "\n".join(out)


def _section(study: Study, rows: Sequence[Row], entry: dict[str, Any]) -> list[str]:
    out = [f"## {study.title}", "", study.question, ""]
    if entry["quick"]:
        out += ["*Few and small settings (`--quick`): a first look, not a basis for choices.*", ""]
    out += [f"![{study.title}]({study.name}.png)", ""]
    out += [f"- {text}" for text in entry["findings"]]
    out += ["", "| what | values |", "|---|---|"]
    out += [f"| {name} | {values} |" for name, values in study.knobs]
    names = [name for name in (*SHOWN, *EXTRA.get(study.name, ())) if len({row[name] for row in rows}) > 1]
    meaning = {column.name: column for column in study.columns}
    out += ["", "| " + " | ".join(_head(meaning[name]) for name in names) + " |"]
    out += ["|" + "|".join("---" if isinstance(rows[0][name], str) else "---:" for name in names) + "|"]
    out += ["| " + " | ".join(_cell(name, row[name]) for name in names) + " |" for row in rows]
    out += ["", f"Computed {entry['finished']} in {entry['duration']:.0f} s; all columns in "
            f"[{study.name}.csv]({study.name}.csv).", ""]  # fmt: skip
    return out


def _head(column: Column) -> str:
    name = column.name.replace("_", " ")
    return name if column.unit == "-" else f"{name} [{column.unit}]"


def _cell(name: str, value: Any) -> str:
    if name.startswith("on_front"):
        return "yes" if value else ""
    if isinstance(value, float):
        if math.isnan(value):
            return "failed"
        return f"{value:.2e}" if "error" in name or name == "seconds" else f"{value:.4g}"
    return str(value)
