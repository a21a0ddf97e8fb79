"""Readable summary of the comparison: `verify.md`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from granfabric.cases.scene.measured import mean_of

from .closures import CLOSURE_COLUMNS, closure_rows, probe_rows
from .dem_side import LOADINGS
from .model_side import SOURCE, SOURCE_CLOSED
from .paths import PATHS
from .table import QUANTITIES, TABLE_LEVELS, Comparison, largest_errors

if TYPE_CHECKING:
    from .study import Study

NAMES = {
    "coordination": "coordination number z",
    "fabric_anisotropy": "fabric anisotropy a_c",
    "normal_force_anisotropy": "normal-force anisotropy a_n",
    "tangential_force_anisotropy": "tangential-force anisotropy a_t",
    "mean_normal_force": "mean normal force f/f0",
}
RELATIVE = ("coordination", "mean_normal_force")
"""Quantities whose errors are told in per cent."""

CAPTIONS = (
    "Change of fabric anisotropy by contacts lost, gained and persisting (DEM)",
    "Normal forces: the packing with the value at zero force, and the loaded sample by direction (DEM)",
    "Gaps between neighbours: the packing with the value at zero gap (DEM)",
    "Model against DEM: coordination number, anisotropies and mean force for both loadings",
    "Two cycles of q/p to 0.2 at constant p, and a reversal to -0.2",
    "Principal stress rotation by 180 degrees at constant p and q/p = 0.2",
)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table, first column to the left and the others to the right."""
    lines = ["| " + " | ".join(head) + " |", "|---" + "|---:" * (len(head) - 1) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def _error(row: Comparison) -> str:
    if not math.isfinite(row.error):
        return "-"
    return f"{100.0 * row.error / row.dem:+.2f} %" if row.quantity in RELATIVE else f"{row.error:+.4f}"


def _measured(row: Comparison) -> str:
    if not math.isfinite(row.dem):
        return "-"
    if not math.isfinite(row.dem_scatter):
        return f"{row.dem:.4f}"
    if row.quantity in RELATIVE:
        return f"{row.dem:.4f} ± {100.0 * row.dem_scatter / row.dem:.2f} %"
    return f"{row.dem:.4f} ± {row.dem_scatter:.4f}"


def _inputs(study: Study) -> str:
    mean = mean_of(result.measured for result in study.results)
    names = list(mean.values)
    rows = []
    for name in names:
        values = np.array([result.inputs[name] for result in study.results if name in result.inputs])
        scatter = f"{values.std(ddof=1):.2g}" if len(values) > 1 else "-"
        error = mean.errors.get(name, math.nan)
        shown = "-" if error == 0.0 else f"{error:.2g}" if math.isfinite(error) else "not known"
        rows.append([f"`{name}`", f"{values.mean():.5g}", scatter, shown])
    return table(["input", "mean", "scatter", "standard error of the mean"], rows)


def _errors(study: Study, loading: str) -> str:
    parts = []
    for quantity in QUANTITIES:
        of = [row for row in study.rows if row.loading == loading and row.quantity == quantity]
        rows = [["**DEM**", *(_measured(row) for row in of if row.closure == study.closures[0])]]
        rows += [[closure, *(_error(row) for row in of if row.closure == closure)] for closure in study.closures]
        head = [f"{NAMES[quantity]}; q/p =", *(f"{ratio:g}" for ratio in TABLE_LEVELS)]
        parts.append(table(head, rows))
    return "\n\n".join(parts)


def _worst(study: Study) -> str:
    worst = largest_errors(study.rows)
    rows = []
    for loading, text in LOADINGS.items():
        for closure in study.closures:
            cells = []
            for quantity in QUANTITIES:
                row = worst.get((loading, closure, quantity))
                if row is None:
                    cells.append("-")
                    continue
                units = row.error_over_scatter
                cells.append(_error(row) + (f" ({units:.1f})" if math.isfinite(units) else ""))
            rows.append([f"{text}: {closure}", *cells])
    return table(["loading: closure", "z", "a_c", "a_n", "a_t", "f/f0"], rows)


def _closures(study: Study) -> str:
    head = [
        *("closure", "z", "a_c", "a_n", "a_t", "f/f0"),
        *("cycles: z", "a_c", "rotation: z", "a_c", "probes: dz", "da_c", "µs"),
    ]  # fmt: skip
    rows = []
    for row in closure_rows(study):
        cells = [str(row[0])]
        for name, value in zip(CLOSURE_COLUMNS[1:], row[1:]):
            number = float(value)
            if not math.isfinite(number):
                cells.append("-")
            elif "percent" in name:
                cells.append(f"{number:.3g} %")
            else:
                cells.append(f"{number:.2f}" if "micro" in name else f"{number:.4f}")
        rows.append(cells)
    return table(head, rows)


def _probes(study: Study) -> str:
    rows = []
    for probe, side, dz, dz_scatter, da, da_scatter in probe_rows(study):
        cells = [f"{dz:+.4f}", f"{da:+.4f}"]
        if side == "DEM" and math.isfinite(float(dz_scatter)):
            cells = [f"{dz:+.4f} ± {dz_scatter:.4f}", f"{da:+.4f} ± {da_scatter:.4f}"]
        rows.append([f"**{probe}**" if side == "DEM" else "", str(side), *cells])
    return table(["probe", "side", "dz", "da_c"], rows)


def _times(study: Study) -> str:
    shown = {"packing": "DEM packing", "measuring": "DEM measuring of the inputs", "probes": "DEM stress probes"}
    shown |= {loading: f"DEM loading, {text}" for loading, text in LOADINGS.items()}
    shown |= {path: f"DEM, {text}" for path, (text, _) in PATHS.items()}
    count = len(study.results)
    curves = len(LOADINGS) * len(study.closures)
    shown["model"] = f"model, {curves} curves of {len(study.levels) - 1} increments"
    rows = [[text, f"{study.seconds[name] / count:.3f} s"] for name, text in shown.items() if name in study.seconds]
    return table(["a packing", "time"], rows)


def summary(study: Study) -> str:
    """Text of `verify.md`."""
    results = study.results
    count = len(results)
    particles = results[0].packing.count
    seeds = "seed 1" if count == 1 else f"seeds 1 to {count}"
    voids = [result.packing.void_ratio for result in results]
    scatter_text = (
        f"± is the standard deviation between the {count} packings; in the table of the largest errors the number in "
        "parentheses is the error in units of it."
        if count > 1
        else "One packing has no scatter; `--seeds 5` gives one to compare errors with."
    )
    sections = [
        "# Point law against DEM",
        f"{count} packing{'s' if count > 1 else ''} of {particles} disks ({seeds}), void ratio "
        f"{np.mean(voids):.4f}, kn/p = 1e4, kt = kn, friction 0.5; biaxial compression at constant mean pressure and "
        "at constant lateral stress. Each packing's measured inputs went into the model; nothing was fitted to the "
        "curves. The coordination number counts all disks. Errors are model minus DEM, averaged over the packings. "
        + scatter_text,
        f"`{SOURCE}` is the source's closure with constant a_t, `{SOURCE_CLOSED}` the same with a_t from the "
        "stress-force-fabric relation.",
        "## The closures side by side",
        "Largest errors on both loadings to q/p = 0.3, on the cycles, under rotation and in the probes (of "
        "the changes that are larger than 0.01); processor time of an update of one point with its tangent.",
        _closures(study),
        "## Largest errors",
        _worst(study),
        f"![{CAPTIONS[3]}](figure_4.png)",
        "## Cycles and rotation",
        *(f"![{caption}](figure_{place}.png)\n\n{caption}." for place, caption in enumerate(CAPTIONS[4:], 5)),
        "## Stress probes from the isotropic state",
        _probes(study),
    ]
    for loading, text in LOADINGS.items():
        sections += [f"## Errors, {text}", _errors(study, loading)]
    sections += ["## Measured inputs", _inputs(study)]
    sections += ["## What the DEM shows"]
    sections += [f"![{caption}](figure_{place}.png)\n\n{caption}." for place, caption in enumerate(CAPTIONS[:3], 1)]
    sections += ["## Time", _times(study)]
    if study.messages:
        sections += ["## Curves that ended early", *(f"- {message}" for message in study.messages)]
    return "\n\n".join(sections) + "\n"
