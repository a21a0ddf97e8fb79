"""Loads and stages against closed forms, and contradictions refused in one sentence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fem_meshes import ELASTIC, ELEMENTS, distorted, nodal, run

from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.control import ControlError, StepControl
from granfabric.fem.loads.kinds import BodyForce, Displacement, Fixed, FixedPoint, LoadError, Pressure, Stage, Traction
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import MeshError, rectangle

E, NU = 1000.0, 0.3
OEDOMETRIC = E * (1 - NU) / ((1 + NU) * (1 - 2 * NU))
ROLLERS = [Fixed("bottom", ("y",)), Fixed("left", ("x",)), Fixed("right", ("x",))]


@pytest.mark.parametrize("element", ["P2", "Q2"])
def test_column_under_gravity(element):
    # u_y = -rho g (H y - y^2/2)/M, sigma_yy = -rho g (H - y): quadratic, so exact for second order.
    space = Space(distorted(element), element)
    steps, summary = run(space, ELASTIC, [Stage("weight", [*ROLLERS, BodyForce((0.0, -20.0))])])
    assert summary.finished
    y = space.nodes[:, 1]
    exact = -20.0 * (y - y**2 / 2) / OEDOMETRIC
    tolerance = 1e-8 if element == "P2" else 2e-3  # Q2 mapped to distorted quadrilaterals only approximates y^2
    np.testing.assert_allclose(nodal(steps[-1])[:, 1], exact, rtol=0, atol=tolerance * np.abs(exact).max())
    assert steps[-1].reactions["bottom"][1] == pytest.approx(20.0 * 2.0, rel=1e-7)
    if element == "P2":
        expected = -20.0 * (1.0 - space.points[:, 1])
        np.testing.assert_allclose(steps[-1].stress[:, 1], expected, rtol=0, atol=1e-6 * 20)


@pytest.mark.parametrize("element", ELEMENTS)
def test_pressure_compresses_and_traction_pulls(element):
    space = Space(distorted(element), element)
    control = StepControl(tolerance=1e-12)
    pressed, _ = run(space, ELASTIC, [Stage("press", [*ROLLERS, Pressure("top", 7.0)])], control)
    pulled, _ = run(space, ELASTIC, [Stage("pull", [*ROLLERS, Traction("top", (0.0, 7.0))])], control)
    np.testing.assert_allclose(pressed[-1].stress[:, 1], -7.0, rtol=1e-10)
    np.testing.assert_allclose(pulled[-1].stress[:, 1], 7.0, rtol=1e-10)
    top = space.boundary_nodes("top")
    np.testing.assert_allclose(nodal(pressed[-1])[top, 1], -7.0 / OEDOMETRIC, rtol=1e-10)


def test_body_force_in_a_region_only():
    host = rectangle(1.0, 1.0, 2, 2, "quad")
    lower = np.flatnonzero(host.mesh.p[1, host.mesh.t].max(axis=0) <= 0.5)
    assert len(lower) == 2
    space = Space(replace(host, regions={"lower": lower}), "Q2")
    steps, _ = run(space, ELASTIC, [Stage("weight", [*ROLLERS, BodyForce((0.0, -8.0), "lower")])])
    assert steps[-1].reactions["bottom"][1] == pytest.approx(8.0 * 0.5, rel=1e-7)
    with pytest.raises(MeshError, match="nearest is 'lower'"):
        Problem(space, ELASTIC, [Stage("weight", [BodyForce((0.0, -8.0), "lowr")])])


def test_stages_ramp_keep_and_release():
    space = Space(distorted("P2"), "P2")
    press = Stage("press", [*ROLLERS, Displacement("top", "y", -0.01)], increments=2)
    hold = Stage("push", [Traction("right", (0.0, 0.0))], increments=1)
    release = Stage("free", [*ROLLERS], increments=4, keep=False)
    steps, summary = run(space, ELASTIC, [press, hold, release], StepControl(tolerance=1e-12))
    assert summary.finished
    assert [step.stage for step in steps] == ["press"] * 2 + ["push"] + ["free"] * 4
    assert [step.fraction for step in steps] == pytest.approx([0.5, 1.0, 1.0, 0.25, 0.5, 0.75, 1.0], rel=1e-15)
    assert steps[-1].fraction == 1.0 and steps[1].fraction == 1.0
    top = np.array([step.stress[:, 1].mean() for step in steps])
    full = -0.01 * OEDOMETRIC
    # Ramped, kept without being named, then the reaction fades linearly to nothing.
    np.testing.assert_allclose(top, full * np.array([0.5, 1.0, 1.0, 0.75, 0.5, 0.25, 0.0]), atol=1e-9 * abs(full))
    assert np.abs(steps[-1].displacement).max() <= 1e-12


def test_fixed_holds_where_it_is_and_forces_fade_without_keep():
    space = Space(distorted("P2"), "P2")
    press = Stage("press", [*ROLLERS, Pressure("top", 7.0)])
    lock = Stage("lock", [*ROLLERS, Fixed("top", ("y",))], keep=False, increments=2)
    steps, summary = run(space, ELASTIC, [press, lock], StepControl(tolerance=1e-12))
    assert summary.finished
    np.testing.assert_allclose(steps[-1].displacement, steps[0].displacement, rtol=0, atol=1e-12)
    # The pressure has gone, the support carries what it carried.
    assert steps[0].reactions["top"][1] == 0.0
    assert steps[-1].reactions["top"][1] == pytest.approx(-14.0, rel=1e-9)


def test_loads_of_an_initial_stage_act_at_once_and_its_imbalance_fades():
    space = Space(distorted("P2"), "P2")
    initial = Stage("initial", [*ROLLERS, Pressure("top", 7.0)], increments=2)
    steps, _ = run(space, ELASTIC, [initial], StepControl(tolerance=1e-12), initial_stress=(-2.0, -5.0, 0.0))
    # Half of the 2 Pa that the initial stress lacks after the first of two steps.
    assert steps[0].stress[:, 1] == pytest.approx(-6.0, rel=1e-10)
    assert steps[1].stress[:, 1] == pytest.approx(-7.0, rel=1e-10)


def test_reference_forces_balance_an_initial_stress_for_good():
    space = Space(distorted("P2"), "P2")
    stress = np.column_stack([space.points[:, 1], -5.0 * space.points[:, 0], np.zeros(space.npoints)])
    stages = [Stage("rest", [*ROLLERS]), Stage("press", [Pressure("top", 7.0)])]
    steps, summary = run(
        space, ELASTIC, stages, StepControl(tolerance=1e-12), initial_stress=stress, balance_initial_stress=True
    )
    assert summary.finished
    assert (steps[0].displacement == 0.0).all()
    np.testing.assert_allclose(steps[1].stress[:, 1] - stress[:, 1], -7.0, rtol=1e-9)


@pytest.mark.parametrize(
    ("stages", "sentence"),
    [
        ([], "there are no stages"),
        ([Stage("a", []), Stage("a", [])], "two stages are named 'a'"),
        ([Stage("a", []), Stage("initial", [])], "must be the first"),
        ([Stage("a", [Fixed("top"), Displacement("top", "y", 1.0)])], "component y of boundary 'top' twice"),
        (
            [Stage("a", [Fixed("left"), Displacement("top", "y", 1.0)])],
            r"node at \(0, 1\) is told two displacements of component y",
        ),
        ([Stage("a", [Pressure("top", 1.0), Pressure("top", 2.0)])], "the pressure on 'top' twice"),
    ],
)
def test_contradictions_are_refused(stages, sentence):
    space = Space(rectangle(1.0, 1.0, 2, 2), "P1")
    with pytest.raises(LoadError, match=sentence):
        Problem(space, ELASTIC, stages)


def test_unknown_names_and_values():
    space = Space(rectangle(1.0, 1.0, 2, 2), "P1")
    with pytest.raises(MeshError, match="nearest is 'bottom'"):
        Problem(space, ELASTIC, [Stage("a", [Fixed("botom")])])
    with pytest.raises(LoadError, match="component 'z' is not one of 'x', 'y'"):
        Displacement("top", "z", 0.0)
    with pytest.raises(LoadError, match="not a finite number"):
        Pressure("top", float("nan"))
    with pytest.raises(LoadError, match="increments = 0"):
        Stage("a", [], increments=0)
    with pytest.raises(LoadError, match="shape"):
        Problem(space, ELASTIC, [Stage("a", [])], initial_stress=np.zeros((2, 3)))
    with pytest.raises(ControlError, match="tolerance"):
        StepControl(tolerance=2.0)
    with pytest.raises(ControlError, match="'tangential' is not one of propagated"):
        StepControl(tangent_kind="tangential")


def test_a_node_told_the_same_twice_is_no_contradiction():
    space = Space(rectangle(1.0, 1.0, 2, 2), "P1")
    loads = [Fixed("bottom"), Fixed("left", ("x",)), Displacement("top", "x", 0.0), FixedPoint((0.0, 0.0))]
    steps, summary = run(space, ELASTIC, [Stage("a", loads)])
    assert summary.finished and (steps[-1].displacement == 0.0).all()


def test_two_materials_by_region():
    # A column of two layers: the same stress in both, strains in the ratio of the moduli.
    space = Space(rectangle(1.0, 1.0, 2, 4, "quad"), "Q2")
    law = LinearElasticLaw([ElasticMaterial(E, NU), ElasticMaterial(4 * E, NU)])
    upper = space.points[:, 1] > 0.5
    steps, _ = run(
        space,
        law,
        [Stage("press", [*ROLLERS, Pressure("top", 7.0)])],
        StepControl(tolerance=1e-12),
        material_index=upper,
    )
    np.testing.assert_allclose(steps[-1].stress[:, 1], -7.0, rtol=1e-9)
    np.testing.assert_allclose(steps[-1].strain[:, 1], -7.0 / (OEDOMETRIC * np.where(upper, 4, 1)), rtol=1e-9)


def test_nothing_left_to_solve_for():
    space = Space(rectangle(1.0, 1.0, 1, 1), "P1")
    loads = [
        Displacement(side, component, lambda x, y: 1e-3 * x)
        for side in ("bottom", "right", "top", "left")
        for component in ("x", "y")
    ]
    steps, summary = run(space, ELASTIC, [Stage("all", loads)])
    assert summary.finished and summary.counters["linear_solves"] == 0
    np.testing.assert_allclose(steps[-1].strain, [[1e-3, 0.0, 1e-3]] * space.npoints, rtol=1e-12, atol=1e-18)


WEIGHT = Space(rectangle(2.0, 1.0, 4, 2), "P2")


def turned(x, y, *_):
    """Components first, as a function for another code may have them."""
    return np.stack([0 * x, -7 + 0 * x])


@pytest.mark.parametrize(
    ("load", "word"),
    [
        (lambda: Traction("top", (-7.0,)), "not a pair of numbers"),  # would act along y as well
        (lambda: Traction("top", (0.0, -7.0, 0.0)), "not a pair of numbers"),
        (lambda: Traction("top", -7.0), "not a pair of numbers"),
        (lambda: Traction("top", "xy"), "not a pair of numbers"),
        (lambda: BodyForce((0.0, -7.0, 0.0)), "not a pair of numbers"),
        (lambda: FixedPoint((0.0, 0.0, 0.0)), "not a pair of numbers"),
        (lambda: Fixed("bottom", 1), "must be in a list, got a int"),
        (lambda: Traction("top", turned), r"traction on boundary 'top' .*\(2, 12\)"),
        (lambda: BodyForce(turned), r"the body force must be .* got float64 \(2, 48\)"),
        (lambda: Pressure("top", lambda x, y: np.full(3, 7.0)), r"the pressure on boundary 'top' must be .*\(12,\)"),
        (lambda: Pressure("top", lambda x, y: 7.0 + 0j * x), "complex128"),
        (lambda: Pressure("top", lambda x, y: x * np.nan), "must be finite, but holds nan"),
        (lambda: Pressure("top", lambda x, y: None), "the pressure on boundary 'top' must be"),
        (lambda: Displacement("top", "y", lambda x, y: np.zeros(2)), "the displacement of boundary 'top' must be"),
    ],
)
def test_loads_of_another_shape_are_other_loads(load, word):
    with pytest.raises(LoadError, match=word):
        Problem(WEIGHT, ELASTIC, [Stage("weight", [*ROLLERS, load()])])


@pytest.mark.parametrize("name", [None, 3, ["top"]])
def test_a_boundary_goes_by_its_name(name):
    with pytest.raises(MeshError, match="the mesh has no boundary"):
        Problem(WEIGHT, ELASTIC, [Stage("weight", [*ROLLERS, Pressure(name, 7.0)])])
    with pytest.raises(MeshError, match="the mesh has no region"):
        Problem(WEIGHT, ELASTIC, [Stage("weight", [*ROLLERS, BodyForce((0.0, 1.0), name or 1)])])


def test_loads_that_can_be_read_once_act():
    # a generator was used up by the check of its loads: the stage ended well, and nothing had acted
    given = (load for load in [Fixed("bottom", iter("y")), *ROLLERS[1:], Pressure("top", np.int64(7))])
    stage = Stage("weight", given, np.int64(1))
    steps, _ = run(WEIGHT, ELASTIC, [stage])
    assert steps[-1].reactions["bottom"][1] == pytest.approx(14.0)
    with pytest.raises(LoadError, match="stage 'weight': loads must be in a list, got a Pressure"):
        Stage("weight", Pressure("top", 7.0))


def test_a_callable_may_give_a_constant():
    stage = Stage("weight", [*ROLLERS, Traction("top", lambda x, y, nx, ny: (0.0, -7.0))])
    steps, _ = run(WEIGHT, ELASTIC, [stage])
    assert steps[-1].reactions["bottom"][1] == pytest.approx(14.0)
