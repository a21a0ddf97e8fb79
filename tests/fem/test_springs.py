"""Springs on a boundary: closed forms, stages that put them in and take them away."""

from __future__ import annotations

import numpy as np
import pytest
from fem_meshes import ELASTIC, ELEMENTS, PLASTIC, distorted, nodal, run

from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.control import StepControl
from granfabric.fem.loads.kinds import (
    BodyForce,
    Fixed,
    FixedPoint,
    LoadError,
    Pressure,
    RigidBody,
    Spring,
    Stage,
    Traction,
)
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import rectangle

OEDOMETRIC = 1000.0 * 0.7 / (1.3 * 0.4)
SIDES = [Fixed("left", ("x",)), Fixed("right", ("x",))]
TIGHT = StepControl(tolerance=1e-12)


@pytest.mark.parametrize("law", [ELASTIC, PLASTIC], ids=["uncoupled", "coupled"])
@pytest.mark.parametrize("element", ELEMENTS)
def test_column_on_springs(element, law):
    """Springs and column in series: p/k + p H/M."""
    space = Space(distorted(element), element)
    stage = Stage("press", [*SIDES, Spring("bottom", normal=50.0), Pressure("top", 0.7)], 2)
    steps, summary = run(space, law, [stage], TIGHT)
    assert summary.finished
    bottom, top = space.boundary_nodes("bottom"), space.boundary_nodes("top")
    np.testing.assert_allclose(nodal(steps[-1])[bottom, 1], -0.7 / 50.0, rtol=1e-8)
    np.testing.assert_allclose(nodal(steps[-1])[top, 1], -0.7 / 50.0 - 0.7 / OEDOMETRIC, rtol=1e-8)
    assert steps[-1].springs["bottom"] == pytest.approx((0.0, 1.4), abs=1e-9)


def test_winkler_beam_of_a_stiff_body():
    """A stiff block on a bed: settlement F/(k b), rotation F e/(k b^3/12); along the bed H/(k_t b)."""
    stiff = LinearElasticLaw(ElasticMaterial(1e6, 0.3))
    space = Space(distorted("P2"), "P2")
    body = RigidBody("top", force=(0.3, -2.0), point=(1.25, 0.0))
    steps, _ = run(space, stiff, [Stage("push", [Spring("bottom", 10.0, 4.0), body])])
    along, at_point, turn, *_ = steps[-1].rigid["top"]
    rotation = -2.0 * 0.25 / (10.0 * 2.0**3 / 12)
    assert turn == pytest.approx(rotation, rel=1e-4)
    assert along == pytest.approx(0.3 / (4.0 * 2.0), rel=1e-4)
    assert at_point == pytest.approx(-2.0 / (10.0 * 2.0) + 0.25 * rotation, rel=1e-4)


def test_stiffness_by_an_expression_and_stiff_springs_are_a_support():
    """k = k0 (1 + x) under a rigid settlement d: force k0 d int (1 + x); the stiffer, the nearer to a roller."""
    space = Space(distorted("P2"), "P2")
    stiff = LinearElasticLaw(ElasticMaterial(1e6, 0.3))
    stage = Stage(
        "a", [*SIDES, Spring("bottom", "5*(1 + x)"), RigidBody("top", displacement=(None, -0.01), rotation="fixed")]
    )
    steps, _ = run(space, stiff, [stage])
    assert steps[-1].springs["bottom"][1] == pytest.approx(0.01 * 5 * 4.0, rel=1e-4)
    held, _ = run(space, ELASTIC, [Stage("a", [*SIDES, Fixed("bottom"), Pressure("top", 1.0)])], TIGHT)
    errors = []
    for stiffness in (1e4, 1e6):
        bed = Spring("bottom", stiffness, stiffness)
        near, _ = run(space, ELASTIC, [Stage("a", [*SIDES, bed, Pressure("top", 1.0)])], TIGHT)
        errors.append(np.abs(near[-1].displacement - held[-1].displacement).max())
    assert errors[1] == pytest.approx(errors[0] / 100, rel=0.05)


@pytest.mark.parametrize("law", [ELASTIC, PLASTIC], ids=["uncoupled", "coupled"])
def test_installed_without_force_kept_and_removed(law):
    """Put in under load they bear only what comes after; another one takes over as the old one fades."""
    space = Space(distorted("P2"), "P2")
    base = [*SIDES, Spring("bottom", 100.0)]
    stages = [
        Stage("first", [*base, Pressure("top", 0.2)], 1),
        Stage("prop", [Spring("top", 40.0)], 1),
        Stage("more", [Pressure("top", 0.6)], 2),
        Stage("off", [*base, Pressure("top", 0.6)], 2, keep=False),
    ]
    steps, summary = run(space, law, stages, TIGHT)
    assert summary.finished
    named = {step.stage: step for step in steps}
    top = space.boundary_nodes("top")
    below = 1 / (1 / 100.0 + 1 / OEDOMETRIC)  # column and bed in series
    at = {name: nodal(step)[top, 1].mean() for name, step in named.items()}
    assert at["first"] == pytest.approx(-0.2 / below, rel=1e-9)
    assert at["prop"] == pytest.approx(at["first"], rel=1e-9) and named["prop"].springs["top"][1] == pytest.approx(
        0.0, abs=1e-9
    )
    assert at["more"] - at["first"] == pytest.approx(-0.4 / (below + 40.0), rel=1e-9)
    assert named["more"].springs["top"][1] == pytest.approx(2 * 0.4 * 40.0 / (below + 40.0), rel=1e-9)
    assert at["off"] == pytest.approx(-0.6 / below, rel=1e-9)
    assert named["off"].springs["top"] == (0.0, 0.0)
    half = next(step for step in steps if step.stage == "off")
    assert nodal(half)[top, 1].mean() == pytest.approx((at["more"] + at["off"]) / 2, rel=1e-8)


def test_shear_on_a_bed_and_all_forces_in_balance():
    space = Space(distorted("P2"), "P2")
    loads = [Spring("bottom", 30.0, 20.0), Spring("left", 5.0), Traction("top", (0.4, 0.0)), BodyForce((0.0, -1.0))]
    steps, _ = run(space, PLASTIC, [Stage("a", loads, 2)], TIGHT)
    total = np.sum(list(steps[-1].springs.values()), axis=0)
    np.testing.assert_allclose(total, (-0.8, 2.0), rtol=1e-7)


def test_springs_hold_a_body_and_bad_ones_are_refused():
    space = Space(distorted("P2"), "P2")
    for given in ({"normal": -1.0}, {}, {"normal": np.inf}, {"normal": "1/"}, {"tangential": True}):
        with pytest.raises(LoadError, match="spring on boundary 'top'"):
            Spring("top", **given)
    with pytest.raises(LoadError, match=r"negative, -[0-9.]+ Pa/m at \("):
        Problem(space, ELASTIC, [Stage("a", [Spring("top", "x - 1.9")])])
    with pytest.raises(LoadError, match="twice"):
        Problem(space, ELASTIC, [Stage("a", [Spring("top", 1.0), Spring("top", 2.0)])])
    from granfabric.fem.loads.supports import free_motions

    held = Problem(
        space, ELASTIC, [Stage("a", [Spring("top", 1.0, 1.0)]), Stage("b", [FixedPoint((0, 0))], keep=False)]
    )
    assert free_motions(space, held.program.terms) == ["", "turn"]
    assert free_motions(space, Problem(space, ELASTIC, [Stage("a", [Spring("top", 1.0)])]).program.terms) == [
        "move along x"
    ]
    tied = Problem(space, ELASTIC, [Stage("a", [RigidBody("top", rotation="fixed", displacement=(0.0, 0.0))])])
    assert free_motions(space, tied.program.terms) == [""]
    loose = Problem(space, ELASTIC, [Stage("a", [RigidBody("top", rotation="fixed")])])
    assert free_motions(space, loose.program.terms) == ["move along x and to move along y"]


def test_rectangle_patch_of_first_order_with_springs_on_three_sides():
    """Constant stress under pressure from the right against springs on the left."""
    space = Space(rectangle(2.0, 1.0, 3, 2, "quad"), "Q1")
    stage = Stage("a", [Fixed("bottom", ("y",)), Fixed("top", ("y",)), Spring("left", 25.0), Pressure("right", 0.5)])
    steps, _ = run(space, ELASTIC, [stage], TIGHT)
    np.testing.assert_allclose(steps[-1].stress[:, 0], -0.5, rtol=1e-9)
