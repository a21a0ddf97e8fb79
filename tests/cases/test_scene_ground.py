"""Scenes of ground: geostatic balance, thrust on a wall, stress under a footing."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from granfabric.cases.commands.convergence import CONSTANT_STIFFNESS, order, solve_level
from granfabric.cases.field.comparison import compare, moduli
from granfabric.cases.scene.reader import load

COARSE = ("mesh.rectangle.nx=8", "mesh.rectangle.ny=4")


def test_geostatic_stress_is_in_balance(solve_scene: Callable) -> None:
    """Stress linear in depth, weight and surcharge balance exactly: nothing moves in the initial stage."""
    _, steps = solve_scene("retaining_wall", *COARSE, "stage.1.increments=3")
    initial = next(step for step in reversed(steps) if step.stage == "initial")
    # The solver's tolerance of 1e-8 of the forces, over a stiffness of 5e8 Pa: far below the wall's 2e-5 m.
    assert np.abs(initial.displacement).max() < 1e-8 * 2e-5 * 1e3
    # At rest: 0.75 (20 kPa 2 m + 18 kN/m3 (2 m)^2/2) = 57 kN/m.
    assert initial.reactions["left"][0] == pytest.approx(57e3, rel=1e-7)
    for step in steps:  # walls are smooth: the base carries all weight
        assert step.reactions["bottom"][1] == pytest.approx((20e3 + 18e3 * 2.0) * 4.0, rel=1e-6)
    thrust = [step.reactions["left"][0] for step in steps]
    assert all(later < earlier for earlier, later in pairwise(thrust[1:]))


def test_elastic_wall_on_a_smooth_base(solve_scene: Callable) -> None:
    """Wall moved by d from ground of length L on a smooth base: the thrust falls by H d/L 4 K G/(K + G)."""
    base = "[{boundary='left', components=['x']}, {boundary='right', components=['x']}, "
    base += "{boundary='bottom', components=['y']}]"
    _, steps = solve_scene(
        "retaining_wall",
        *(*COARSE, *CONSTANT_STIFFNESS, "stage.1.increments=1", f"stage.0.fixed={base}"),
        "stage.1.displacement=[{boundary='left', component='x', value=-1e-5}]",
    )
    bulk, shear = moduli(load("retaining_wall").scene.material)
    fall = 2.0 * 1e-5 / 4.0 * 4 * bulk * shear / (bulk + shear)
    assert 57e3 - steps[-1].reactions["left"][0] == pytest.approx(fall, rel=1e-6)


def test_low_pressure_loses_most_contacts(solve_scene: Callable) -> None:
    """The wall moves most where the pressure is least: z falls towards the surface, and at the wall."""
    problem, steps = solve_scene("retaining_wall", *COARSE, "stage.1.increments=5")
    z = steps[-1].state[:, problem.law.description.columns("coordination")][:, 0]
    x, y = problem.space.points.T
    at_wall = x < 0.5
    profile = [z[at_wall & (y > low) & (y < low + 0.5)].mean() for low in (0.0, 0.5, 1.0, 1.5)]
    assert profile == sorted(profile, reverse=True) and profile[0] - profile[-1] > 0.1
    assert z[~(x < 3.5) & (y > 1.5)].mean() > profile[-1]


def test_stress_under_a_footing(solve_scene: Callable) -> None:
    """p/pi (alpha + sin alpha) below the centre. The step of the pressure at the footing's edge makes the stress there
    depend on the direction in which one arrives, so that its error over the body falls with h, whatever the element;
    half a width below the centre it is not felt any more."""
    assignments = (*CONSTANT_STIFFNESS, "stage.0.increments=1")
    coarse, fine = (
        solve_level(load("strip_footing", [*assignments, "mesh.rectangle.nx=8", "mesh.rectangle.ny=8", refine]), factor)
        for factor, refine in ((1, "mesh.refine=1"), (2, "mesh.refine=2"))
    )
    slope = order(coarse, fine, "stress_error")
    assert slope is not None and 0.8 < slope < 1.3
    problem, steps = solve_scene("strip_footing", *assignments)
    found = compare(load("strip_footing", assignments), problem, steps[-1])
    line = {name: np.array(values) for name, values in found.line.items()}
    deep = line["distance"] >= 1.0
    np.testing.assert_allclose(line["stress_yy"][deep], line["closed_form_yy"][deep], atol=0.005 * 20e3)
    depth = line["distance"][deep]
    alpha = 2 * np.arctan(1.0 / depth)
    by_hand = -(20e3 + 18e3 * depth) - 20e3 / np.pi * (alpha + np.sin(alpha))
    np.testing.assert_allclose(line["closed_form_yy"][deep], by_hand, rtol=1e-9)


def test_part_of_a_boundary_and_graded_stress_are_refused_with_a_sentence(granfabric: Callable, tmp_path: Path) -> None:
    for assignment, words in (
        ("mesh.part=[{name='footing', boundary='top', x=[0.0, 1.1]}]", "lies across an end"),
        ("mesh.part=[{name='footing', boundary='top', x=[5.0, 6.0]}]", "no side of boundary 'top' lies between"),
        ("mesh.part=[{name='top', boundary='top', x=[0.0, 1.0]}]", "has a boundary 'top' already"),
        ("mesh.part=[{name='footing', boundary='tip', x=[0.0, 1.0]}]", "nearest is 'top'"),
        ("initial.stress=[0.0, 0.0, 1e3]", "the stress must be compressive in every direction"),
        ("random_state={seed=1, standard_deviation=1.5, correlation_length=[1.0, 1.0]}", "smaller standard_deviation"),
    ):
        result = granfabric("run", "strip_footing", "-o", tmp_path / "out", "--set", assignment)
        assert result.code == 2 and words in result.err, (assignment, result.err)
        assert result.err.count("\n") == 1 and not (tmp_path / "out").exists()


@pytest.mark.slow
def test_bearing_capacity_against_prandtl(solve_scene: Callable) -> None:
    """N_q of Prandtl and Reissner with associated flow. Displacement elements come to the
    limit load from above here, and err in proportion to the size of the elements at the singular edge: two meshes,
    extrapolated to zero size, meet the closed form within what the second order leaves, h^2 of 1/16, about 2 %."""
    sine, apex = 0.3, 1e3
    prandtl = np.exp(np.pi * np.tan(np.arcsin(sine))) * (1 + sine) / (1 - sine) * (100e3 + apex) - apex
    limit = []
    for nx, ny in ((16, 8), (24, 12)):
        _, steps = solve_scene("footing_capacity", f"mesh.rectangle.nx={nx}", f"mesh.rectangle.ny={ny}")
        reaction = [-step.reactions["footing"][1] for step in steps if step.stage == "push" and step.fraction > 0.8]
        assert np.ptp(reaction) < 0.005 * reaction[-1]  # a plateau
        limit.append(reaction[-1])
    assert prandtl < limit[1] < limit[0] < 1.1 * prandtl
    drawn_on = limit[1] - (limit[0] - limit[1]) * (1 / 24) / (1 / 16 - 1 / 24)
    assert drawn_on == pytest.approx(prandtl, rel=0.02)


def test_bearing_capacity_factors_of_the_text() -> None:
    """Prandtl, Reissner and Davis for sin phi = 0.3, cone with its apex at 1 kPa of tension, surcharge 100 kPa."""

    def factors(sine: float) -> tuple[float, float]:
        friction = np.arcsin(sine)
        q = np.exp(np.pi * np.tan(friction)) * (1 + sine) / (1 - sine)
        return float(q), float((q - 1) / np.tan(friction))

    sine = 0.3
    # psi = 0: eta = cos psi cos phi / (1 - sin psi sin phi) = cos phi, tan phi* = eta tan phi = sin phi
    davis = float(np.sin(np.arctan(sine)))
    (associated, cohesion), (cautious, less) = factors(sine), factors(davis)
    assert (associated, cautious) == pytest.approx((4.988, 4.636), abs=6e-4)
    assert (cohesion, less) == pytest.approx((12.7, 12.1), abs=0.06)
    assert associated * 101 - 1 == pytest.approx(502.8, abs=0.06)
    assert cautious * 101 - 1 == pytest.approx(467.2, abs=0.06)
    assert np.degrees(np.arcsin(davis)) == pytest.approx(16.7, abs=0.01)


@pytest.mark.slow
def test_isochoric_flow_reaches_a_plateau_between_davis_and_prandtl(solve_scene: Callable) -> None:
    """On one mesh: below associated flow, above associated flow at Davis's angle; led by the settlement as well."""
    mesh = ("mesh.rectangle.nx=16", "mesh.rectangle.ny=8")
    davis = 0.28735
    angle = (f"material.peak_stress_ratio={davis}", f"material.first_yield_stress_ratio={davis * 0.29 / 0.3}")
    loose = ("material.dilatancy=0.0", "solver.tolerance=1e-5", "solver.maximum_iterations=40")
    plateau = {}
    for name, sets in (("associated", ()), ("davis", angle), ("isochoric", loose)):
        _, steps = solve_scene("footing_capacity", *mesh, *sets)
        pushed = [step for step in steps if step.stage == "push" and step.fraction > 0.8]
        late = np.array([-step.reactions["footing"][1] for step in pushed])
        assert steps[-1].fraction == 1.0 and np.ptp(late) < 0.02 * late[-1]
        plateau[name] = float(late.mean())
    assert 1.02 * plateau["davis"] < plateau["isochoric"] < plateau["associated"]
