"""What a fit or a comparison leaves behind: rows of its table, the material file, entries of the record."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from granfabric.cases.scene.toml_text import value_text
from granfabric.constitutive.parameters import CLOSURE_NUMBERS, Material

from .columns import BY_NAME
from .deviations import compared_rows
from .parameters import told_by
from .settings import MATERIAL_NAMES, SLIDING
from .study import Compared, Fitted

ROW_COLUMNS = (
    "curve", "line", "p", "stress_ratio", "quantity", "data", "scale", "law", "residual", "deviation",
)  # fmt: skip
"""Columns of `fit.csv` and `data.csv`: residual = law - data, deviation = residual over scale; p in Pa."""
SMALL_SHARE = 0.05
"""Part of what tells a parameter below which a column is not named."""


def rows(found: Compared) -> list[list[Any]]:
    """One row for each value of a curve that the law is compared with."""
    table: list[list[Any]] = []
    for curve, answer in zip(found.curves, found.answers):
        for name, data in curve.compared.items():
            law, scale = answer.columns[name], curve.scales[name]
            for row in np.flatnonzero(np.isfinite(data)):
                residual = float(law[row] - data[row])
                table.append([
                    curve.curve.name, curve.curve.lines[row], float(answer.pressure[row]),
                    float(answer.stress_ratio[row]), name, float(data[row]), float(scale[row]), float(law[row]),
                    residual, residual / float(scale[row]),
                ])  # fmt: skip
    return table


@dataclass(frozen=True)
class ColumnError:
    """How far the law is from one column of one curve, over the rows that it reached."""

    curve: str
    quantity: str
    values: int
    largest: float
    line: int
    stress_ratio: float
    rms: float
    scale: float


def column_errors(found: Compared) -> list[ColumnError]:
    """Largest and root mean square residual of each column of each curve."""
    table = []
    for curve, answer in zip(found.curves, found.answers):
        for name, data in curve.compared.items():
            there = compared_rows(curve, name, found.base.settings.start)
            there = there[np.isfinite(answer.columns[name][there])]
            if not there.size:
                table.append(ColumnError(curve.curve.name, name, 0, math.nan, 0, math.nan, math.nan, math.nan))
                continue
            residual = answer.columns[name][there] - data[there]
            worst = int(np.argmax(np.abs(residual)))
            row = int(there[worst])
            table.append(
                ColumnError(
                    curve.curve.name, name, int(there.size), float(residual[worst]), curve.curve.lines[row],
                    float(answer.stress_ratio[row]), float(np.sqrt(np.mean(residual**2))),
                    float(np.mean(curve.scales[name][there])),
                )
            )  # fmt: skip
    return table


def sources(fitted: Fitted, name: str) -> dict[str, float]:
    """Part of the information on a parameter by column, largest first; empty of one on a bound."""
    if name not in fitted.inner or fitted.uncertainty is None:
        return {}
    place = fitted.inner.index(name)
    shares = {column: float(values[place]) for column, values in fitted.uncertainty.shares.items()}
    return dict(sorted(shares.items(), key=lambda entry: -entry[1]))


def sources_text(fitted: Fitted, name: str) -> str:
    """The same in words."""
    if name in fitted.on_bound:
        return f"on its {fitted.on_bound[name]} bound"
    return ", ".join(
        f"{_brief(column)} {share:.0%}" for column, share in sources(fitted, name).items() if share >= SMALL_SHARE
    )


def _brief(column: str) -> str:
    short = BY_NAME[column].short
    return short[0] if short and len(short[0]) < len(column) else column


def parameters(fitted: Fitted) -> dict[str, dict[str, Any]]:
    """For `run.json`: every parameter with its value; of free ones the standard error and where it comes from."""
    table: dict[str, dict[str, Any]] = {}
    for name, value in fitted.values.items():
        if name not in fitted.errors:
            table[name] = {"value": value, "free": False, "from": fitted.base.origins[name]}
            continue
        error = fitted.errors[name]
        table[name] = {
            "value": value,
            "free": True,
            "standard_error": error if math.isfinite(error) else None,
            "on_bound": fitted.on_bound.get(name),
            "sources": {column: round(share, 4) for column, share in sources(fitted, name).items()},
            "told_by": told_by(name),
        }
    return table


ORIGINS = {"set": "held, by --set", "file": "held, of the material file", "rows": "held, of the first rows",
           "default": "held, default"}  # fmt: skip


def material_text(fitted: Fitted) -> str:
    """Text of a material file with every parameter that the law used; errors and origins as comments."""
    names = ", ".join(dict.fromkeys(curve.curve.name for curve in fitted.curves))
    state = "" if fitted.converged else f"# {fitted.message or 'not converged'}\n"
    head = (
        f"# Fitted to {names if names.isprintable() else 'curves'}\n{state}"
        "# Read by point and field scenes: material_file = ..., or --set material_file=...\n"
        "# +- is the standard error; what has none was held\n"
    )
    tables: dict[str, dict[str, Any]] = {"material": {}, "closure": dict(fitted.base.closure)}
    for name in MATERIAL_NAMES:
        if name not in SLIDING or fitted.base.effects.sliding:
            tables["material"][name] = fitted.values[name]
    tables["closure"] |= {name: fitted.values[name] for name in CLOSURE_NUMBERS}
    lines = []
    for section, entries in tables.items():
        lines.append(f"[{section}]")
        for name, value in entries.items():
            lines.append(f"{name} = {value_text(value)}{_comment(fitted, name)}")
        lines.append("")
    return head + "\n".join(lines)


def _comment(fitted: Fitted, name: str) -> str:
    if name in fitted.on_bound:
        return f"  # on its {fitted.on_bound[name]} bound"
    if name in fitted.errors:
        return f"  # +- {fitted.errors[name]:.2g}; {sources_text(fitted, name)}"
    if name not in fitted.values:
        return ""
    unit = next((variable.unit for variable in Material.variables() if variable.name == name), "-")
    return f"  # {ORIGINS[fitted.base.origins[name]]}" + (f" [{unit}]" if unit != "-" else "")


def numbers(value: float, error: float) -> tuple[str, str]:
    """Value and standard error with the digits that mean something."""
    if not math.isfinite(error):
        return f"{value:.5g}", "-"
    if not error > 0.0:
        return f"{value:.6g}", f"{error:.1g}"
    digits = max(2, min(12, math.floor(math.log10(max(abs(value), error))) - math.floor(math.log10(error)) + 2))
    return f"{value:#.{digits}g}".rstrip("."), f"{error:#.2g}".rstrip(".")
