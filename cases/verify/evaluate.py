"""The model on the inputs of every packing, and the comparison with the DEM."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.loading.run import DemRun, at_stress_ratios

from .cost import microseconds_per_update
from .dem_side import LOADINGS, SeedResult
from .model_side import closures, follow
from .paths import PATHS, PathRow, compare_path, dem_columns, model_columns, positions, sampled
from .probes import PROBES, model_probes
from .study import PathStudy, Study
from .table import Comparison, compare

Array = NDArray[np.float64]

LEVELS = np.linspace(0.0, 0.3, 61)
"""Stress ratios q/p at which curves are compared."""


def evaluate(results: Sequence[SeedResult], levels: Array = LEVELS) -> Study:
    """Run the model on the inputs of every packing and compare."""
    dem: dict[str, dict[str, Array]] = {}
    model: dict[str, dict[str, dict[str, Array]]] = {}
    rows: list[Comparison] = []
    messages: list[str] = []
    seconds = {"model": 0.0}
    for result in results:
        for name, spent in result.seconds.items():
            seconds[name] = seconds.get(name, 0.0) + spent
    for name, closure in closures(results[0].inputs).items():  # compile before the clock runs
        first = next(iter(LOADINGS))
        follow(closure, results[0].inputs, first, pressure_of(results[0].runs[first]), levels[:2])
        for loading in LOADINGS:
            model.setdefault(loading, {})[name] = {}
    for loading in LOADINGS:
        tables = [at_stress_ratios(result.runs[loading].history(), levels.tolist()) for result in results]
        dem[loading] = {column: np.array([table[column] for table in tables]) for column in tables[0]}
        answers: dict[str, list[dict[str, Array]]] = {}
        for result in results:
            pressure = pressure_of(result.runs[loading])
            for name, closure in closures(result.inputs).items():
                curve = follow(closure, result.inputs, loading, pressure, levels)
                answers.setdefault(name, []).append(curve.columns)
                seconds["model"] += curve.seconds
                if curve.message:
                    messages.append(f"{name}, {LOADINGS[loading]}, seed {result.seed}: {curve.message}")
        for name, curves in answers.items():
            model[loading][name] = {column: np.array([curve[column] for curve in curves]) for column in curves[0]}
            rows += compare(loading, name, dem[loading], model[loading][name], levels)
    paths, path_rows = {}, []
    for path in PATHS:
        paths[path], found, ended = _along(path, results)
        path_rows += found
        messages += ended
    probes = {name: {"DEM": np.array([result.probes[name] for result in results])} for name in PROBES}
    for name in closures(results[0].inputs):
        answers_in = [
            model_probes(closures(result.inputs)[name], result.inputs, pressure_of(result.runs[next(iter(LOADINGS))]))
            for result in results
        ]
        for probe in PROBES:
            probes[probe][name] = np.array([answer[probe] for answer in answers_in])
    inputs = results[0].inputs
    cost = {name: microseconds_per_update(closure, inputs) for name, closure in closures(inputs).items()}
    return Study(levels, dem, model, list(results), rows, seconds, paths, path_rows, probes, cost, messages)


def _along(path: str, results: Sequence[SeedResult]) -> tuple[PathStudy, list[PathRow], list[str]]:
    """Both sides along a path; rows of the table; where a closure ended early."""
    turning = path == "rotation"
    dem, places, segments, ratios, angles = [], [], [], [], []
    for result in results:
        history = result.runs[path].history()
        at, segment = positions(history)
        places.append(at)
        segments.append(segment)
        dem.append(sampled(dem_columns(history, turning), at))
        stress = sampled({name: history[name] for name in ("stress_xx", "stress_yy", "stress_xy", "p")}, at)
        s1, s2 = -0.5 * (stress["stress_xx"] - stress["stress_yy"]), -stress["stress_xy"]
        ratios.append(np.hypot(s1, s2) / stress["p"] if turning else -s1 / stress["p"])
        angles.append(np.degrees(np.unwrap(np.arctan2(-s2, -s1))) / 2.0)
    model: dict[str, list[dict[str, Array]]] = {}
    rows: list[PathRow] = []
    messages = []
    ratio, angle = np.mean(ratios, axis=0), np.mean(angles, axis=0)
    for name in closures(results[0].inputs):
        model[name] = []
        for result, at in zip(results, places):
            columns, message = model_columns(
                closures(result.inputs)[name], result.inputs, result.runs[path].history(), turning
            )
            model[name].append(sampled(columns, at))
            if message:
                messages.append(f"{name}, {PATHS[path][0]}, seed {result.seed}: {message}")
        rows += compare_path(path, name, dem, model[name], segments[0], ratio, angle)
    return PathStudy(segments[0], ratio, angle, dem, model), rows, messages


def pressure_of(run: DemRun) -> float:
    """Mean pressure [Pa] at the start of a run."""
    return float(run.history()["p"][0])
