"""A field run says the estimated error of its mesh."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
import pytest

from granfabric.cases.commands.convergence import CONSTANT_STIFFNESS
from granfabric.cases.field.comparison import compare
from granfabric.cases.scene.reader import load
from granfabric.fem.discretisation.mesh_error import stress_error


@pytest.mark.parametrize("element", ["P1", "P2"])
@pytest.mark.parametrize(
    "name, least, most",
    [
        pytest.param("hole_in_plate", 0.75, 1.2, id="smooth"),
        pytest.param("strip_footing", 0.5, 1.2, id="step of the pressure"),
    ],
)
def test_estimate_is_that_of_the_closed_form(
    solve_scene: Callable, name: str, least: float, most: float, element: str
) -> None:
    """At the element's own points, on two meshes. Where the solution is smooth the recovered stress is better than the
    computed one by an order; at a step of the pressure it is about as wrong, and half of the error is seen.
    """
    for refine in (1, 2):
        changes = (*CONSTANT_STIFFNESS, f"mesh.element={element}", f"mesh.refine={refine}")
        problem, steps = solve_scene(name, *changes)
        exact = compare(load(name, list(changes)), problem, steps[-1]).stress_error
        found = stress_error(problem.space, steps[-1].stress - problem.initial_stress).relative
        assert least < found / exact < most


def test_a_run_estimates_the_error_of_its_mesh(granfabric: Callable, tmp_path: Path) -> None:
    fractions = []
    for refine in (1, 2):
        out = tmp_path / str(refine)
        arguments = ("--set", f"mesh.refine={refine}", "--set", "output.pictures=false", "--set", "accuracy=1e-3")
        result = granfabric("run", "hole_in_plate", *arguments, "-o", out)
        assert result.code == 0, result.err
        entry = json.loads((out / "run.json").read_text())
        fractions.append(entry["mesh_error"]["stress"])
        assert f"changes {100 * fractions[-1]:.2g} %" in result.out
        assert ("more than wanted: refine it" in result.out) == (fractions[-1] > 1e-3)
        assert entry["accuracy"]["mesh"] == fractions[-1]
        mesh = meshio.read(out / "mesh_error.vtu")
        cells = mesh.cell_data["stress_error"][0]
        assert np.sum(cells**2) == pytest.approx(fractions[-1] ** 2)
        # at the hole, where stress changes most
        assert np.hypot(*entry["mesh_error"]["place"]) < 0.03
    assert fractions[1] < fractions[0] / 2.5
