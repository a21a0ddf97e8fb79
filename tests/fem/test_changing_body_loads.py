"""Stages that change the body beside amplitudes, expressions, controls, springs and rigid bodies."""

from __future__ import annotations

import numpy as np
import pytest
from changing_meshes import column
from fem_meshes import ELASTIC, PLASTIC, run
from test_changing_body import GRAINS, ONE_WAY, SIDES, same

from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.checkpoint import CheckpointFolder
from granfabric.fem.equilibrium.control import StepControl
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.loads.kinds import (
    Displacement,
    Fixed,
    LoadControl,
    LoadError,
    Pressure,
    RigidBody,
    Spring,
    Stage,
    Traction,
)
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import build_mesh, rectangle

P = 1e5
INITIAL = (-P, -P, 0.0)
FROZEN = ContactLaw(GRAINS.materials, effects=Effects(contact_loss=False, contact_gain=False))
WAYS = {"iterated": FROZEN, "at once": ONE_WAY}
WALLS = [Fixed("left", ("x",)), Fixed("right", ("x",))]
ENDS_HALFWAY = [[0.0, 0.0], [0.5, 1.0], [1.0, 0.5]]


@pytest.fixture(scope="module")
def tower():
    return Space(column(3), "P2")


@pytest.fixture(scope="module")
def ledge():
    """Ground of 4 m x 2 m with a pit of 2 m x 1 m on the right, and a footing of 1 m on the left."""
    host = rectangle(4.0, 2.0, 8, 4)
    middle = host.mesh.p.T[host.mesh.t.T].mean(axis=1)
    pit = (middle[:, 0] > 2.0) & (middle[:, 1] > 1.0)
    lines = {name: host.mesh.facets[:, facets].T for name, facets in host.boundaries.items()}
    regions = {"ground": np.flatnonzero(~pit), "pit": np.flatnonzero(pit)}
    made = build_mesh(host.mesh.p.T, host.mesh.t.T, lines, regions)
    made.boundaries["footing"] = made.facets_between("top", (0.5, 1.5), None)
    return Space(made, "P2")


def vertical(tower, step):
    """Vertical stress of what is there; the same at all points of a column without weight."""
    there = np.ones(tower.npoints, dtype=bool) if step.active is None else step.active[tower.point_cell]
    stress = step.stress[there, 1]
    assert np.ptp(stress) < 1e-6 * P
    return float(stress.mean())


# amplitudes and expressions -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", WAYS.values(), ids=WAYS)
def test_a_load_that_has_gone_half_its_way_leaves_with_its_part(tower, law):
    stages = [
        Stage("initial", [*SIDES, Pressure("top_3", P)]),
        Stage("press", [Pressure("top_3", 1.2 * P, amplitude=ENDS_HALFWAY)], 4),
        Stage("dig", [Pressure("top_2", "0.3e5 + 0*x", amplitude="haversine")], 4, deactivate=["layer_3"], release=0.5),
        Stage("next", [], 2),
    ]
    steps, summary = run(tower, law, stages, initial_stress=INITIAL)
    assert summary.finished
    assert vertical(tower, steps[4]) == pytest.approx(-1.1 * P, rel=1e-6)
    for step in steps[5:9]:
        pressed = 0.3 * 0.5 * (1 - np.cos(2 * np.pi * step.fraction))
        assert vertical(tower, step) == pytest.approx(-(1.1 * (1 - 0.5 * step.fraction) + pressed) * P, rel=1e-6)
    assert vertical(tower, steps[-1]) == pytest.approx(0.0, abs=1e-5 * P)


def test_a_kept_load_acts_on_what_is_left_with_the_value_it_has_come_to(tower):
    """Sideways traction on the right that has come to half of its value; a third of its side goes, and comes again."""
    half = Traction("right", (lambda x, y, nx, ny: np.stack([y, 0 * y], axis=1)), amplitude=ENDS_HALFWAY)
    stages = [
        Stage("initial", [Fixed("bottom")]),
        Stage("pull", [half], 2),
        Stage("dig", deactivate=["layer_3"]),
        Stage("fill", activate=["layer_3"]),
        Stage("more", [Traction("right", (1.0, 0.0))]),
    ]
    program = Problem(tower, ELASTIC, stages).program
    sums = [(terms.force_start[0::2].sum(), terms.force_end[0::2].sum()) for terms in program.terms]
    assert np.array(sums) == pytest.approx(
        np.array([[0, 0], [0, 2.25], [1.0, 1.0], [1.0, 2.25], [2.25, 3.0]]), abs=1e-12
    )


# controls -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", WAYS.values(), ids=WAYS)
def test_the_load_that_a_control_found_is_what_is_dug_away(tower, law):
    initial = Stage("initial", [*SIDES, Pressure("top_3", P)])
    drive = Stage("drive", [Displacement("top_3", "y", -2e-5)], 2)
    driven, _ = run(tower, law, [initial, drive], initial_stress=INITIAL)
    pressed = -vertical(tower, driven[-1])
    stages = [
        initial,
        Stage("lead", [Pressure("top_3", 1.5 * P)], 2, control=LoadControl(-2e-5, point=(0.0, 3.0))),
        Stage("dig", [], 2, deactivate=["layer_3"], release=0.4),
        Stage("again", [Pressure("top_2", P)], 2, release=0.4, control=LoadControl(1e-5, point=(0.0, 2.0))),
    ]
    steps, summary = run(tower, law, stages, initial_stress=INITIAL)
    assert summary.finished and pressed > 1.05 * P
    assert steps[2].load_factor == pytest.approx((pressed / P - 1) / 0.5, rel=1e-5)
    assert vertical(tower, steps[4]) == pytest.approx(-0.6 * pressed, rel=1e-5)
    last = steps[-1]
    top = np.flatnonzero(np.abs(tower.nodes[:, 1] - 2.0) < 1e-9)
    assert last.displacement[2 * top + 1] == pytest.approx(np.full(len(top), 1e-5), rel=1e-5)
    assert vertical(tower, last) == pytest.approx(-0.6 * pressed - last.load_factor * P, rel=1e-5)


@pytest.mark.parametrize("law", WAYS.values(), ids=WAYS)
def test_a_control_may_lead_while_the_body_changes(tower, law):
    stages = [
        Stage("initial", [*SIDES, Pressure("top_3", P)]),
        Stage("dig", [Pressure("top_2", P)], 2, deactivate=["layer_3"], control=LoadControl(5e-6, point=(0.0, 2.0))),
    ]
    steps, summary = run(tower, law, stages, initial_stress=INITIAL)
    assert summary.finished
    top = int(np.flatnonzero((np.abs(tower.nodes - (0.0, 2.0)) < 1e-9).all(axis=1))[0])
    assert steps[-1].displacement[2 * top + 1] == pytest.approx(5e-6, rel=1e-9)
    assert vertical(tower, steps[-1]) == pytest.approx(-steps[-1].load_factor * P, rel=1e-5)
    assert 0.0 < steps[-1].load_factor < 1.0


# springs ------------------------------------------------------------------------------------------------------------


BED = 1e9


def on_a_bed(release=0.5, **more):
    return [
        Stage("initial", [*SIDES, Pressure("top_3", P)]),
        Stage("bed", [*WALLS, Spring("bottom", normal=BED), Pressure("top_3", P)], keep=False),
        Stage("dig", [], 2, deactivate=["layer_3"], release=release),
        Stage("count", [], 2, release=release, **more),
        Stage("press", [Pressure("top_2", 0.2 * P)], 2, release=release),
    ]


@pytest.mark.parametrize("law", WAYS.values(), ids=WAYS)
def test_a_column_on_a_bed_rises_by_what_is_dug_away(tower, law):
    base = np.flatnonzero(tower.nodes[:, 1] < 1e-9)
    found = {}
    for reset in (False, True):
        steps, summary = run(tower, law, on_a_bed(reset_displacements=reset), initial_stress=INITIAL)
        assert summary.finished
        found[reset] = [step.displacement[2 * base + 1].mean() for step in steps]
        for step, pressed in zip(steps[1:], (1.0, 0.75, 0.5, 0.5, 0.5, 0.6, 0.7)):
            assert vertical(tower, step) == pytest.approx(-pressed * P, rel=1e-6)
            assert step.springs["bottom"][1] == pytest.approx(pressed * P, rel=1e-6)
    # the bed is without force where it was put
    assert np.array(found[False]) == pytest.approx(
        -np.array([0.0, 1.0, 0.75, 0.5, 0.5, 0.5, 0.6, 0.7]) * P / BED, abs=1e-6 * P / BED
    )
    assert np.array(found[True][4:]) == pytest.approx(-np.array([0.0, 0.0, 0.1, 0.2]) * P / BED, abs=1e-6 * P / BED)


def test_springs_that_go_with_the_excavation(tower):
    stages = [*on_a_bed()[:2], Stage("dig", [*SIDES], 2, keep=False, deactivate=["layer_3"])]
    steps, summary = run(tower, FROZEN, stages, initial_stress=INITIAL)
    assert summary.finished
    assert vertical(tower, steps[-1]) == pytest.approx(0.0, abs=1e-5 * P)
    assert steps[-1].springs["bottom"] == (0.0, 0.0)


# rigid bodies -------------------------------------------------------------------------------------------------------

BASE = [Fixed("bottom"), Fixed("left", ("x",)), Fixed("right", ("x",))]


@pytest.mark.parametrize("law", [ELASTIC, PLASTIC])
def test_a_footing_that_is_displaced_is_the_support_that_it_stands_for(ledge, law):
    down = 0.01 if law is ELASTIC else 1e-3
    body = RigidBody("footing", displacement=(0.0, -down), rotation="fixed")
    held = [Fixed("footing", ("x",)), Displacement("footing", "y", -down)]
    dig = Stage("dig", [], 2, deactivate=["pit"])
    tied, _ = run(ledge, law, [Stage("press", [*BASE, body], 2), dig])
    plain, _ = run(ledge, law, [Stage("press", [*BASE, *held], 2), dig])
    size = np.abs(plain[-1].displacement).max()
    assert np.abs(tied[-1].displacement - plain[-1].displacement).max() < 1e-6 * size
    assert np.abs(tied[-1].displacement - tied[1].displacement).max() > 1e-3 * size
    assert tied[-1].rigid["footing"][3:5] == pytest.approx(plain[-1].reactions["footing"], rel=1e-5, abs=1e-6)


def test_order_of_digging_and_pushing_makes_no_difference_to_an_elastic_body(ledge):
    first, dig = Stage("first", BASE), Stage("dig", [], 2, deactivate=["pit"])
    push = Stage("push", [RigidBody("footing", force=(1.0, -10.0), moment=0.5)], 2)
    one, _ = run(ledge, ELASTIC, [first, push, dig])
    other, summary = run(ledge, ELASTIC, [first, dig, push])
    assert summary.finished
    size = np.abs(one[-1].displacement).max()
    assert np.abs(one[-1].displacement - other[-1].displacement).max() < 1e-6 * size
    for steps in (one, other):
        assert steps[-1].rigid["footing"] == pytest.approx(other[-1].rigid["footing"], rel=1e-5)
        assert steps[-1].rigid["footing"][3:] == pytest.approx((1.0, -10.0, 0.5), rel=1e-6)
        assert not steps[-1].stress[~steps[-1].active[ledge.point_cell]].any()


# going on -----------------------------------------------------------------------------------------------------------


def with_everything(scale):
    p = P * scale
    return [
        Stage("initial", [*SIDES, Pressure("top_3", p)], 1),
        Stage("bed", [*WALLS, Spring("bottom", normal=BED * scale), Pressure("top_3", p)], 2, keep=False),
        Stage("lead", [Pressure("top_3", 1.2 * p)], 2, control=LoadControl(-1.3e-4, point=(0.0, 3.0))),
        Stage("dig", [Pressure("top_2", 0.6 * p, amplitude="step")], 3, deactivate=["layer_3"], release=0.5),
        Stage("next", [], 2, reset_displacements=True),
    ]


@pytest.mark.parametrize("law", [GRAINS, ONE_WAY], ids=["iterated", "at once"])
def test_the_same_bits_follow_from_every_checkpoint(tmp_path, tower, law):
    problem = Problem(tower, law, with_everything(1.0), initial_stress=INITIAL)
    folder = CheckpointFolder(tmp_path, "x")
    steps, kept = [], []

    def keep(checkpoint):
        folder.save(checkpoint)
        kept.append(folder.files()[-1].read_bytes())

    assert solve(problem, StepControl(), on_step=steps.append, on_checkpoint=keep).finished
    for number, content in enumerate(kept[:-1]):
        for file in folder.files():
            file.unlink()
        (tmp_path / "checkpoint_000001.npz").write_bytes(content)
        rest = []
        solve(problem, StepControl(), on_step=rest.append, resume=folder.load()[0])
        assert len(rest) == len(steps) - number - 1
        for one, two in zip(steps[number + 1 :], rest):
            same(one, two)


# refused ------------------------------------------------------------------------------------------------------------


def test_what_stands_on_a_part_that_changes_is_refused(tower, ledge):
    dig = Stage("dig", deactivate=["layer_3"])
    with pytest.raises(LoadError, match=r"stage 'a' has springs on boundary 'right', and stage 'dig' activates or"):
        Problem(tower, ELASTIC, [Stage("a", [*SIDES, Spring("right", normal=1.0)]), dig])
    with pytest.raises(LoadError, match=r"stage 'a' has a rigid body on boundary 'right', and stage 'dig'"):
        Problem(tower, ELASTIC, [Stage("a", [Fixed("bottom"), RigidBody("right", force=(1.0, 0.0))]), dig])
    lead = Stage("b", [Pressure("top_2", 1.0)], control=LoadControl(-0.1, point=(0.0, 3.0)))
    with pytest.raises(LoadError, match=r"the control leads the node at \(0, 3\), which is not active in this stage"):
        Problem(tower, ELASTIC, [Stage("a", SIDES), dig, lead])
