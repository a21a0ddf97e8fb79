"""A field run against the closed form that its scene names: errors over the body, stresses along a line."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.records import files
from granfabric.cases.records.record import Record
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.terminal.screen import Screen, spread
from granfabric.constitutive.parameters import Material
from granfabric.constitutive.pore_fluid import fluid_stiffness
from granfabric.constitutive.stiffness import moduli_per_contact
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.loads.problem import Problem

from . import closed_forms
from .local_fit import local_fit

Array = NDArray[np.float64]

COLUMNS = {"xx": 0, "yy": 1, "xy": 2}
PLACES = 61
"""Places along the line; the first and last lie on its ends."""


@dataclass(frozen=True)
class Comparison:
    """How far a run is from its closed form.

    Parameters
    ----------
    stress_error : float
        Norm over the body of the difference of the stress changes, relative to the norm of the closed form's.
    displacement_error : float or None
        The same of the displacements; None if the closed form has none or there is no single pair of moduli.
    line : dict of str to list of float
        Columns along the scene's line: x, y, distance [m], stress_xx, closed_form_xx ... [Pa] with the initial
        stress; empty without a line.
    """

    stress_error: float
    displacement_error: float | None
    line: dict[str, list[float]]


def moduli(material: Any) -> tuple[float, float]:
    """Bulk and shear modulus K and G [Pa] of the initial packing [model of section 7]."""
    bulk, shear, _ = moduli_per_contact(
        material.solid_fraction,
        material.normal_stiffness,
        material.stiffness_ratio,
        material.bulk_reduction,
        material.shear_reduction,
    )
    return bulk * material.coordination, shear * material.coordination


def compare(loaded: LoadedScene, problem: Problem, step: StepResult) -> Comparison:
    """Compare a step with the closed form of the scene.

    Parameters
    ----------
    loaded : LoadedScene
        With a closed form.
    problem : Problem
    step : StepResult
        End of the last stage.
    """
    scene, space = loaded.scene, problem.space
    form = scene.closed_form
    there: Any = slice(None) if step.active is None else step.active[space.point_cell]
    points, weights, initial = space.points[there], space.weights[there], problem.initial_stress[there]
    change = step.stress[there] - initial
    exact = closed_forms.stress(form, points[:, 0], points[:, 1])
    stress_error = _norm(weights, change - exact) / _norm(weights, exact)
    line: dict[str, list[float]] = {}
    if form.line is not None:
        line = _along_line(form, points, change, initial)
    return Comparison(stress_error, _displacement_error(scene, space, step), line)


def _norm(weights: Array, values: Array) -> float:
    return float(np.sqrt(weights @ np.sum(values**2, axis=1)))


def _displacement_error(scene: Any, space: Space, step: StepResult) -> float | None:
    if scene.material is None or scene.random_state is not None:
        return None
    # Points of higher degree: those of the element may be where its displacement is best.
    fine = Space(space.host_mesh, space.element, quadrature_degree=2 * space.order + 2)
    there: Any = slice(None) if step.active is None else step.active[fine.point_cell]
    bulk, shear = moduli(scene.material)
    x, y = fine.points[there].T
    if scene.effects.pore_fluid is True and not scene.stage[-1].drained:
        bulk += fluid_stiffness(Material(**scene.material.model_dump()))
    exact = closed_forms.displacement(scene.closed_form, x, y, bulk, shear)
    if exact is None:
        return None
    computed = fine.interpolate(step.displacement.reshape(-1, 2))[there]
    return _norm(fine.weights[there], computed - exact) / _norm(fine.weights[there], exact)


def _along_line(form: Any, points: Array, change: Array, initial: Array) -> dict[str, list[float]]:
    start, end = np.asarray(form.line, dtype=np.float64)
    places = start + np.linspace(0.0, 1.0, PLACES)[:, None] * (end - start)
    both = local_fit(points, np.concatenate([change, initial], axis=1), places)
    exact = closed_forms.stress(form, places[:, 0], places[:, 1])
    columns = {"x": places[:, 0], "y": places[:, 1], "distance": np.linalg.norm(places - start, axis=1)}
    for name in form.components:
        place = COLUMNS[name]
        columns[f"stress_{name}"] = both[:, 3 + place] + both[:, place]
        columns[f"closed_form_{name}"] = both[:, 3 + place] + exact[:, place]
    return {name: values.tolist() for name, values in columns.items()}


def write(folder: Path, record: Record, found: Comparison) -> None:
    """Put the errors into the record, and the line into `closed_form.csv`."""
    record.details["closed_form"] = {
        "stress_error": found.stress_error,
        "displacement_error": found.displacement_error,
    }
    if found.line:
        rows = list(zip(*found.line.values()))
        files.write_text(folder / files.COMPARISON, files.csv_text(list(found.line), rows))


def _percent(fraction: float) -> str:
    return f"{100 * fraction:.2g} %"


def report(record: Record, screen: Screen) -> None:
    """Say how far the run is from the closed form, if there is one."""
    found = record.details.get("closed_form")
    if found is None:
        return
    form = next(name for name in closed_forms.TITLES if name in record.scene["closed_form"])
    text = (
        f"difference from {closed_forms.TITLES[form]} (constant stiffness): {_percent(found['stress_error'])} in stress"
    )
    if found["displacement_error"] is not None:
        text += f", {_percent(found['displacement_error'])} in displacement"
    screen.say(text)
    path = record.folder / files.COMPARISON
    if not path.is_file():
        return
    columns = files.read_csv(path)
    names = [name.removeprefix("stress_") for name in columns if name.startswith("stress_")]
    rows = [
        [
            *(f"{columns[axis][row]:.4g}" for axis in "xy"),
            *(f"{columns[kind + name][row] / 1e3:.2f}" for name in names for kind in ("stress_", "closed_form_")),
        ]
        for row in spread(len(columns["x"]), 6)
    ]
    header = [f"{kind}_{name} [kPa]" for name in names for kind in ("s", "closed form")]
    screen.table("Stress along the line of the scene", ["x [m]", "y [m]", *header], rows)
