"""Rigid bodies: closed forms, reciprocity, what displacement-driven runs give, supports on tied nodes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fem_meshes import ELASTIC, PLASTIC, distorted, nodal, run

from granfabric.fem.accounting import Accounting
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.checkpoint import Checkpoint
from granfabric.fem.equilibrium.control import StepControl
from granfabric.fem.equilibrium.residual import Equilibrium
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.loads.kinds import (
    Displacement,
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
from granfabric.fem.mesh.host_mesh import HostMesh, build_mesh, rectangle
from granfabric.fem.mesh.shapes import quarter_ring

E, NU = 1000.0, 0.3
TIGHT = StepControl(tolerance=1e-11)
HOLD = [Fixed("bottom"), Fixed("left", ("x",)), Fixed("right", ("x",))]


def ground(nx: int = 8, ny: int = 4, width: float = 4.0) -> HostMesh:
    """4 m x 2 m with a footing between x = 1 m and 2 m, and its left half."""
    host = rectangle(width, 2.0, nx, ny)
    parts = {"footing": host.facets_between("top", (1.0, 2.0)), "edge": host.facets_between("top", (0.0, 1.0))}
    return replace(host, boundaries={**host.boundaries, **parts})


def turned(host: HostMesh, angle: float) -> HostMesh:
    c, s = np.cos(angle), np.sin(angle)
    lines = {name: host.mesh.facets[:, facets].T for name, facets in host.boundaries.items()}
    return build_mesh(host.mesh.p.T @ np.array([[c, s], [-s, c]]), host.mesh.t.T, lines, host.regions)


@pytest.mark.parametrize("law", [ELASTIC, PLASTIC], ids=["uncoupled", "coupled"])
@pytest.mark.parametrize("rough", [True, False])
@pytest.mark.parametrize("keep_factor", [True, False])
def test_pushed_by_the_reaction_it_moves_as_if_displaced(law, rough, keep_factor):
    space = Space(ground(), "P2")
    control = StepControl(tolerance=1e-11, keep_factor=keep_factor)
    moved = [Displacement("footing", "y", -2e-3)] + ([Displacement("footing", "x", 1e-3)] if rough else [])
    by_nodes, _ = run(space, law, [Stage("push", [*HOLD, *moved], 4)], control)
    body = RigidBody("footing", rough, displacement=(1e-3 if rough else None, -2e-3), rotation="fixed")
    displaced, _ = run(space, law, [Stage("push", [*HOLD, body], 4)], control)
    np.testing.assert_allclose(displaced[-1].displacement, by_nodes[-1].displacement, atol=1e-13)
    np.testing.assert_allclose(displaced[-1].reactions["footing"], by_nodes[-1].reactions["footing"], rtol=1e-8)
    force_x, force_y, moment = displaced[-1].rigid["footing"][3:]
    np.testing.assert_allclose((force_x, force_y), by_nodes[-1].reactions["footing"], rtol=1e-8, atol=1e-9)
    pushed_body = RigidBody("footing", rough, (force_x if rough else 0.0, force_y), moment)
    pushed, summary = run(space, law, [Stage("push", [*HOLD, pushed_body], 4)], control)
    assert summary.finished
    # Plastic steps of other paths end near, not on, the same state.
    np.testing.assert_allclose(
        pushed[-1].rigid["footing"][:3], displaced[-1].rigid["footing"][:3], atol=1e-9 if law is ELASTIC else 2e-5
    )
    np.testing.assert_allclose(pushed[-1].rigid["footing"][3:], (force_x, force_y, moment), rtol=1e-7, atol=1e-9)
    # all of the force is a load: supports of the footing add nothing
    assert np.abs(pushed[-1].reactions["footing"]).max() < 1e-8


@pytest.mark.parametrize("element", ["P2", "Q2"])
def test_bending_and_compression_of_a_column_in_closed_form(element):
    """Smooth platens, force N out of the middle by e: N/(E' b) and N e/(E' I), I = b^3/12, E' = E/(1 - nu^2)."""
    width, height, force, away = 1.0, 2.0, 3.0, 0.2
    space = Space(rectangle(width, height, 2, 4, "triangle" if element == "P2" else "quad"), element)
    hold = [Fixed("bottom", ("y",)), FixedPoint((0.0, 0.0), ("x",))]
    body = RigidBody("top", rough=False, force=(0.0, -force), point=(0.5 + away, height))
    steps, summary = run(space, ELASTIC, [Stage("push", [*hold, body])], TIGHT)
    assert summary.finished
    modulus = E / (1 - NU**2)
    turn = -force * away / (modulus * width**3 / 12) * height
    settlement = -force / (modulus * width) * height
    _, at_point, rotation, _, carried, moment = steps[-1].rigid["top"]
    assert rotation == pytest.approx(turn, rel=1e-9)
    assert at_point == pytest.approx(settlement + turn * away, rel=1e-9)
    assert carried == pytest.approx(-force, rel=1e-12) and moment == pytest.approx(0.0, abs=1e-10)
    expected = -force / width - force * away / (width**3 / 12) * (space.points[:, 0] - 0.5)
    np.testing.assert_allclose(steps[-1].stress[:, 1], expected, atol=1e-8)


@pytest.mark.parametrize("rough", [True, False])
def test_reciprocity_energy_and_moment_balance(rough):
    space = Space(ground(), "P2")

    def answer(**loads):
        steps, _ = run(space, ELASTIC, [Stage("push", [*HOLD, RigidBody("footing", rough, **loads)])], TIGHT)
        return steps[-1]

    pushed, turned_by = answer(force=(0.0, -1.0)), answer(moment=1.0)
    assert pushed.rigid["footing"][2] == pytest.approx(-turned_by.rigid["footing"][1], rel=1e-9)
    # work of the force is twice the elastic energy
    energy = 0.5 * np.sum(space.weights * np.sum(pushed.stress * pushed.strain, axis=1))
    assert -0.5 * pushed.rigid["footing"][1] == pytest.approx(energy, rel=1e-9)
    aside = answer(force=(0.0, -1.0), point=(1.8, 2.0))
    both = answer(force=(0.0, -1.0), moment=-0.3)  # 1.5 m is the middle: 0.3 m beside it, clockwise
    np.testing.assert_allclose(aside.displacement, both.displacement, atol=1e-15)
    assert both.rigid["footing"][5] == pytest.approx(-0.3, rel=1e-9)
    total = np.array([aside.reactions[name][1] for name in ("bottom",)]).sum()
    assert total == pytest.approx(1.0, rel=1e-9)


def test_a_smooth_body_on_a_slant_moves_as_on_the_level():
    """Everything turned by 30 degrees: the same settlement, sideways free along the boundary."""
    host, angle = ground(), np.pi / 6
    lean = turned(host, angle)
    level, _ = run(
        Space(host, "P2"),
        PLASTIC,
        [Stage("push", [Fixed("bottom"), RigidBody("footing", False, (0.0, -1.5), 0.1)], 3)],
        TIGHT,
    )
    force = (1.5 * np.sin(angle), -1.5 * np.cos(angle))
    steps, summary = run(
        Space(lean, "P2"),
        PLASTIC,
        [Stage("push", [Fixed("bottom"), RigidBody("footing", False, force, 0.1)], 3)],
        TIGHT,
    )
    assert summary.finished
    across = np.array([-np.sin(angle), np.cos(angle)])
    ours, theirs = steps[-1].rigid["footing"], level[-1].rigid["footing"]
    assert np.dot(across, ours[:2]) == pytest.approx(theirs[1], rel=1e-6)
    assert ours[2] == pytest.approx(theirs[2], rel=1e-6)
    c, s = np.cos(angle), np.sin(angle)
    np.testing.assert_allclose(nodal(steps[-1]) @ np.array([[c, -s], [s, c]]), nodal(level[-1]), atol=1e-8)


@pytest.mark.parametrize("rough", [True, False])
def test_half_of_a_symmetric_footing(rough):
    """A support on the line of symmetry holds the corner of the footing: the body keeps its rotation fixed."""
    host = rectangle(8.0, 2.0, 16, 4)
    # a mesh that is its own mirror image
    host = replace(host, boundaries={**host.boundaries, "footing": host.facets_between("top", (3.0, 5.0))})
    half = rectangle(4.0, 2.0, 8, 4)
    half = replace(half, boundaries={**half.boundaries, "footing": half.facets_between("top", (0.0, 1.0))})
    found = []
    for mesh, force in ((host, -2.0), (half, -1.0)):
        body = RigidBody("footing", rough, (0.0, force), rotation="fixed")
        space = Space(mesh, "P2")
        steps, summary = run(space, ELASTIC, [Stage("push", [*HOLD, body])], TIGHT)
        assert summary.finished
        found.append(steps[-1].rigid["footing"])
        if mesh is half:
            assert np.abs(nodal(steps[-1])[space.boundary_nodes("left"), 0]).max() == 0.0
    assert found[1][1] == pytest.approx(found[0][1], rel=2e-2)  # meshes differ in their diagonals
    assert found[1][0] == 0.0


def test_matrix_and_products_agree_and_are_symmetric():
    """T^T K T as a matrix is what the products are, springs included; the pattern is symmetric."""
    space = Space(turned(ground(), 0.4), "P2")
    for rough in (True, False):
        stage = Stage(
            "a", [Fixed("bottom"), RigidBody("footing", rough), Spring("edge", 50.0, 20.0), Spring("right", 3.0)]
        )
        problem = Problem(space, ELASTIC, [stage])
        system = Equilibrium(problem, StepControl(), Accounting())
        system.constrain(problem.program.terms[0])
        system.material.still_tangent("elastic")
        tangent = system.unknowns.tangent(space, system._springs)
        matrix = tangent.assemble(system.material.tangent_start)
        z = np.random.default_rng(1).normal(size=system.unknowns.count)
        full = system.unknowns.expand(z, np.zeros(space.ndofs))
        product = system.unknowns.reduce(system.action(system.material.tangent_start, full, np.zeros(space.ndofs)))
        np.testing.assert_allclose(matrix @ z, product, rtol=1e-10, atol=1e-9)
        assert abs(matrix - matrix.T).max() < 1e-9
        assert (matrix != 0).nnz <= matrix.nnz and abs(matrix).T.nnz == matrix.nnz
        np.testing.assert_allclose(system.unknowns.of(full), z, atol=1e-10)
        assert np.linalg.eigvalsh(matrix.toarray())[0] > 0.0


def test_stages_take_over_from_supports_release_and_keep():
    """Reactions of a displaced footing become its force; let go, the force fades; kept, it stays."""
    space = Space(ground(), "P2")
    stages = [
        Stage("displace", [*HOLD, Displacement("footing", "y", -1e-3), Displacement("footing", "x", 0.0)]),
        Stage("push", [RigidBody("footing", force=(0.0, -2.0))], 2),
        Stage("wait", [Pressure("edge", 0.5)], 1),
        Stage("off", [*HOLD, Pressure("edge", 0.5)], 2, keep=False),
    ]
    steps, summary = run(space, ELASTIC, stages, TIGHT)
    assert summary.finished
    displaced = steps[0].reactions["footing"][1]
    assert steps[0].rigid["footing"][4] == pytest.approx(displaced, rel=1e-9)
    assert [step.rigid["footing"][4] for step in steps[1:4]] == pytest.approx(
        [(displaced - 2.0) / 2, -2.0, -2.0], rel=1e-8
    )
    alone, _ = run(space, ELASTIC, [Stage("off", [*HOLD, Pressure("edge", 0.5)])], TIGHT)
    np.testing.assert_allclose(steps[-1].displacement, alone[-1].displacement, atol=1e-12)
    nearly, _ = run(
        space, ELASTIC, [Stage("a", [*HOLD, RigidBody("footing", force=(0.0, -2.0)), Pressure("edge", 0.5)])], TIGHT
    )
    np.testing.assert_allclose(steps[3].displacement, nearly[-1].displacement, atol=1e-12)


@pytest.mark.parametrize("law", [ELASTIC, PLASTIC], ids=["uncoupled", "coupled"])
def test_rotation_and_amplitude_of_a_body_that_is_moved(law):
    space = Space(ground(), "P2")
    body = RigidBody("footing", displacement=(None, -1e-3), rotation=2e-3, amplitude="triangle", point=(1.0, 2.0))
    steps, summary = run(space, law, [Stage("turn", [*HOLD, body], 4), Stage("keep", [Pressure("edge", 1e-3)])], TIGHT)
    assert summary.finished
    for step in steps[:-1]:
        factor = {0.25: 1.0, 0.5: 0.0, 0.75: -1.0, 1.0: 0.0}[step.fraction]
        motion = step.rigid["footing"]
        assert motion[1:3] == pytest.approx((-1e-3 * factor, 2e-3 * factor), abs=1e-16)
        assert motion[3] == pytest.approx(0.0, abs=1e-8)  # free along x
    assert steps[-1].rigid["footing"][1:3] == pytest.approx((0.0, 0.0), abs=1e-16)


@pytest.mark.parametrize("law", [ELASTIC, PLASTIC], ids=["uncoupled", "coupled"])
def test_the_same_bits_follow_from_a_checkpoint(law):
    space = Space(ground(), "P2")
    stages = [
        Stage("push", [*HOLD[:1], RigidBody("footing", force=(0.2, -1.5)), Spring("right", 20.0, 5.0)], 3),
        Stage("cycle", [RigidBody("footing", force=(0.1, -0.5), amplitude="sine"), Traction("left", (0.01, 0.0))], 6),
    ]
    problem = Problem(space, law, stages)
    whole: list = []
    checkpoints: list[Checkpoint] = []

    def keep(checkpoint: Checkpoint) -> None:
        memory = checkpoint.memory
        copies = {name: np.copy(getattr(memory, name)) for name in ("tangent",)}
        last = None if memory.last_correction is None else memory.last_correction.copy()
        checkpoints.append(replace(checkpoint, memory=replace(memory, **copies, last_correction=last)))

    assert solve(problem, on_step=whole.append, on_checkpoint=keep).finished
    for number in (2, 4, 5):
        rest: list = []
        assert solve(problem, on_step=rest.append, resume=checkpoints[number - 1]).finished
        assert [step.step for step in rest] == [step.step for step in whole[number:]]
        np.testing.assert_array_equal(rest[-1].displacement, whole[-1].displacement)
        assert rest[-1].rigid == whole[-1].rigid and rest[-1].springs == whole[-1].springs


@pytest.mark.parametrize(
    ("loads", "sentence"),
    [
        ([Fixed("bottom"), Fixed("footing"), RigidBody("footing")], "has a support and a rigid body"),
        ([RigidBody("footing"), RigidBody("footing")], "the rigid body on 'footing' twice"),
        ([RigidBody("footing"), RigidBody("edge")], "share a node"),
        ([RigidBody("footing", False, (1.0, 0.0))], "bears no force along its boundary"),
        ([RigidBody("ftg")], "nearest is 'footing'"),
        (
            [
                Fixed("bottom", ("y",)),
                Displacement("left", "x", 0.1),
                RigidBody("edge", displacement=(0.0, None), rotation="fixed"),
            ],
            "contradict each other",
        ),
    ],
)
def test_contradictions_are_refused(loads, sentence):
    with pytest.raises(ValueError) as error:
        Problem(Space(ground(), "P2"), ELASTIC, [Stage("a", loads)])
    assert sentence in str(error.value) and str(error.value).startswith("stage 'a'")


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"force": (1.0, 0.0), "displacement": (0.1, None)}, "a displacement and a force along x"),
        ({"rotation": "fixed", "moment": 1.0}, "the moment 1 has no effect"),
        ({"rotation": "held"}, "not 'free', 'fixed' or a number"),
        ({"rotation": np.nan}, "is not a finite number"),
        ({"force": (1.0,)}, "not a pair of numbers"),
        ({"displacement": 0.1}, "is not a pair"),
        ({"rough": 1}, "neither true nor false"),
        ({"amplitude": "rmp"}, "is not one of ramp"),
    ],
)
def test_bad_values_are_refused(given, sentence):
    with pytest.raises(LoadError) as error:
        RigidBody("footing", **given)
    assert sentence in str(error.value)


def test_a_smooth_body_around_a_circle_feels_no_rotation():
    space = Space(quarter_ring(1.0, 2.0, 3, 4, "triangle"), "P2")
    hold = [Fixed("outer")]
    with pytest.raises(LoadError, match="no moment that it does not feel"):
        Problem(space, ELASTIC, [Stage("a", [*hold, RigidBody("inner", False, moment=1.0, point=(0.0, 0.0))])])


def test_a_support_beside_a_slanted_smooth_body_is_refused_and_later_ones_too():
    space = Space(turned(ground(), 0.3), "P2")
    with pytest.raises(LoadError, match="along a slant"):
        Problem(space, ELASTIC, [Stage("a", [Fixed("bottom"), Fixed("left", ("x",)), RigidBody("edge", False)])])
    space = Space(distorted("P2"), "P2")
    stages = [Stage("a", [Fixed("bottom"), RigidBody("top")]), Stage("b", [Displacement("top", "y", 0.1)])]
    with pytest.raises(LoadError, match="boundary 'top' is tied to a rigid body"):
        Problem(space, ELASTIC, stages)


def test_before_a_body_comes_its_boundary_is_told_at_the_point_of_that_body():
    """Not of a later one on the same boundary; what supports exert there is its force until then."""
    space = Space(ground(), "P2")
    tilt = Stage("tilt", [*HOLD, Pressure("footing", lambda x, y: 10.0 * x)], 2)
    gone = Pressure("footing", 0.0)
    first, later = (
        Stage(f"at {place}", [gone, RigidBody("footing", force=(0.0, -5.0), point=(place, 2.0))], 2)
        for place in (1.0, 2.0)
    )
    alone, _ = run(space, ELASTIC, [tilt, first])
    both, _ = run(space, ELASTIC, [tilt, first, later])
    assert [step.rigid for step in alone] == [step.rigid for step in both[: len(alone)]]  # to the last bit
    at_left, at_right = (steps[1].rigid["footing"] for steps in (both, run(space, ELASTIC, [tilt, later])[0]))
    assert at_left[2] == pytest.approx(at_right[2], rel=1e-12) != 0.0
    assert at_right[1] - at_left[1] == pytest.approx(at_left[2] * 1.0, rel=1e-9)
    assert at_left[3:] == (0.0, 0.0, 0.0)
    held, _ = run(space, ELASTIC, [Stage("hold", [*HOLD, Displacement("footing", "y", -1e-3)]), first])
    down = held[0].reactions["footing"][1]
    assert held[0].rigid["footing"][4] == pytest.approx(down, rel=1e-12) and down < 0.0
