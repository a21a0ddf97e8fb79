"""Scenes that have a closed form: errors and orders of convergence, and what the user sees of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from granfabric.cases.commands.convergence import CONSTANT_STIFFNESS, Level, order, solve_level
from granfabric.cases.records import files
from granfabric.cases.scene.reader import load


def levels(scene: str, refinements: tuple[int, ...], *assignments: str) -> list[Level]:
    every = [*CONSTANT_STIFFNESS, "stage.1.increments=1", *assignments]
    return [solve_level(load(scene, [*every, f"mesh.refine={factor}"]), factor) for factor in refinements]


COARSE = {
    "pressurised_cavity": ("mesh.ring.n_radial=4", "mesh.ring.n_around=4"),
    "hole_in_plate": ("mesh.plate_with_hole.n_radial=6", "mesh.plate_with_hole.n_around=8"),
}


@pytest.mark.parametrize("scene", list(COARSE))
@pytest.mark.parametrize("element", ["P1", "P2", "Q1", "Q2"])
def test_orders_of_convergence(scene: str, element: str) -> None:
    """Stress falls with h^k and displacement with h^(k+1), k the order of the element (Strang & Fix 1973, ch. 3), down
    to a straight-sided or parabolic approximation of the circle, which errs by h^2 or h^4. The two meshes are still
    coarse: half an order is allowed to be missing. Meshes as regular as the ring's converge faster."""
    shape = "ring" if scene == "pressurised_cavity" else "plate_with_hole"
    cell = f"mesh.{shape}.cell={'triangle' if element[0] == 'P' else 'quad'}"
    coarse, fine = levels(scene, (2, 4), *COARSE[scene], cell, f"mesh.element={element}")
    k = int(element[1])
    stress, displacement = order(coarse, fine, "stress_error"), order(coarse, fine, "displacement_error")
    assert stress is not None and displacement is not None
    assert stress > k - 0.5 and displacement > min(k + 1, 4) - 0.5
    if scene == "hole_in_plate" and element in ("P1", "P2"):
        assert stress < k + 0.5 and displacement < k + 1.5
    # Across an element at the hole the radius changes by 10 %: what an element of order k cannot follow.
    assert fine.stress_error < 0.1**k


def test_a_run_reports_its_closed_form(granfabric: Callable, tmp_path: Path, is_drawn: Callable) -> None:
    out = tmp_path / "out"
    settings = [
        "--set",
        "effects.contact_loss=false",
        "--set",
        "effects.contact_gain=false",
        "--set",
        "output.every=99",
    ]
    result = granfabric("run", "hole_in_plate", "-o", out, *settings, "--set", "stage.1.increments=2")
    assert result.code == 0, result.err
    assert "difference from Kirsch's hole in a plate (constant stiffness): 0.19 % in stress" in result.out
    found = json.loads((out / "run.json").read_text())["closed_form"]
    assert found["stress_error"] == pytest.approx(0.00186, rel=0.02)
    columns = {name: np.array(values) for name, values in files.read_csv(out / "closed_form.csv").items()}
    # The line starts beside the hole: three times 20 kPa on top of 100 kPa, free of shear and radial change.
    assert columns["closed_form_yy"][0] == pytest.approx(-160e3, rel=1e-12)
    assert columns["closed_form_xx"][0] == pytest.approx(-100e3, rel=1e-12)
    # Recovered by fits at a boundary: an order of magnitude above the mean error is allowed, of the change of 60 kPa.
    np.testing.assert_allclose(columns["stress_yy"], columns["closed_form_yy"], atol=0.02 * 60e3)
    assert is_drawn(out / "closed_form.png") and is_drawn(out / "overview.png")


def test_without_end_and_with(granfabric: Callable) -> None:
    """Uniform tractions on a plate of five radii: the stress beside the hole is too high by a few times (a/w)^2."""
    end = ["stage.1.closed_form=[]", "stage.1.pressure=[{boundary='top', value=120e3}]"]
    without, cut = levels("hole_in_plate", (1,))[0], levels("hole_in_plate", (1,), *end)[0]
    assert without.stress_error < 0.003
    assert (0.02 / 0.1) ** 2 < cut.stress_error < 8 * (0.02 / 0.1) ** 2


def test_convergence_command(granfabric: Callable, tmp_path: Path, is_drawn: Callable) -> None:
    out = tmp_path / "out"
    coarse = [part for text in COARSE["pressurised_cavity"] for part in ("--set", text)]
    result = granfabric("convergence", "pressurised_cavity", "--refine", "1,2", "-o", out, *coarse)
    assert result.code == 0, result.err
    table = files.read_csv(out / "convergence.csv")
    assert table["refine"] == [1, 2] and table["stress_order"][0] == "" and table["stress_order"][1] > 2
    assert is_drawn(out / "convergence.png")
    refused = granfabric("convergence", "pressurised_cavity", "--refine", "2,1", "-o", out)
    assert refused.code == 2 and "ascending" in refused.err
    assert granfabric("convergence", "pressurised_cavity", "--refine", "1,x").code == 2
    nothing = granfabric("convergence", "biaxial", "-o", tmp_path / "new", "--set", "mesh.refine=1")
    assert nothing.code == 2 and not (tmp_path / "new").exists()


def test_contact_loss_moves_the_wall_further() -> None:
    """A network that loses contacts is softer: more displacement than Lame's under the same pressure."""
    from granfabric.cases.field.prepare import prepare
    from granfabric.fem.equilibrium.stepping import solve

    moved = []
    for assignments in ((), CONSTANT_STIFFNESS):
        problem = prepare(load("pressurised_cavity", [*COARSE["pressurised_cavity"], *assignments])).problem
        steps: list = []
        assert solve(problem, on_step=lambda step, kept=steps: kept.append(step)).finished
        inner = problem.space.boundary_nodes("inner")
        moved.append(float(np.linalg.norm(steps[-1].displacement.reshape(-1, 2)[inner], axis=1).mean()))
    assert 1.05 < moved[0] / moved[1] < 1.2


def test_convergence_of_another_kind_of_scene_names_its_command(granfabric: Callable, tmp_path: Path) -> None:
    """Not a key that nobody gave."""
    result = granfabric("convergence", "p_constant", "-o", tmp_path / "out")
    assert result.code == 2 and "use `granfabric point p_constant`" in result.err and "--set" not in result.err
