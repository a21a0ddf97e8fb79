"""Stages that change the body: shares that are released, what is placed, what is refused, and what it costs."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from changing_meshes import column, plate_and_core
from fem_meshes import ELASTIC, PLASTIC, run

from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Material
from granfabric.fem.discretisation.assembly import ForceAssembler
from granfabric.fem.discretisation.restricted import restricted_space
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.checkpoint import CheckpointFolder
from granfabric.fem.equilibrium.results import StageStart
from granfabric.fem.equilibrium.stepping import StepControl, solve
from granfabric.fem.loads.kinds import BodyForce, Displacement, Fixed, FixedPoint, LoadError, Pressure, Stage, Traction
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import MeshError

GRAINS = ContactLaw([Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)])
ONE_WAY = ContactLaw(
    [Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)],
    effects=Effects(stiffness_feedback=False),
)
ROLLERS = [Fixed("bottom", ("y",)), Fixed("left", ("x",))]
SIDES = [Fixed("bottom"), Fixed("left", ("x",)), Fixed("right", ("x",))]


@pytest.fixture(scope="module")
def plate():
    return Space(plate_and_core(2)[1], "P2")


@pytest.fixture(scope="module")
def tower():
    return Space(column(3), "P2")


def around(pressure):
    return [Pressure("right", pressure), Pressure("top", pressure)]


def unbalanced(space, law, step, force):
    """Largest nodal force on free degrees of freedom that nothing balances."""
    internal = ForceAssembler(space).internal_force(step.stress, np.empty(space.ndofs))
    return np.abs(internal - force)


# released in shares -------------------------------------------------------------------------------------------------


def excavation(*shares, **more):
    initial = Stage("initial", [*ROLLERS, *around(100.0)])
    first = Stage("excavation", [], 2, deactivate=["core"], release=shares[0])
    return [initial, first, *(Stage(f"then {k}", [], 1, release=share, **more) for k, share in enumerate(shares[1:]))]


def test_shares_add_up(plate):
    stress = (-100.0, -100.0, 0.0)
    whole, _ = run(plate, ELASTIC, excavation(1.0), initial_stress=stress)
    steps, summary = run(plate, ELASTIC, excavation(0.4, 0.4, 0.7, 1.0), initial_stress=stress)
    assert summary.finished
    size = np.abs(whole[-1].displacement).max()
    for step, share in zip(steps[1:], (0.2, 0.4, 0.4, 0.7, 1.0)):
        assert np.abs(step.displacement - share * whole[-1].displacement).max() < 1e-7 * size
    assert np.abs(whole[0].displacement).max() < 1e-7 * size
    assert steps[2].stage_start.held is not None and steps[-1].stage_start.held is None


def test_what_is_left_is_released_by_the_next_stage(plate):
    stress = (-100.0, -100.0, 0.0)
    whole, _ = run(plate, ELASTIC, excavation(1.0), initial_stress=stress)
    steps, _ = run(plate, ELASTIC, [*excavation(0.3), Stage("next")], initial_stress=stress)
    assert np.abs(steps[-1].displacement - whole[-1].displacement).max() < 1e-7 * np.abs(whole[-1].displacement).max()


def test_a_second_excavation_adds_its_forces_to_what_is_held(tower):
    """Unloading a column from above: the order and the shares make no difference to an elastic body in the end."""
    weight = 10.0
    stress = np.zeros((tower.npoints, 3))
    stress[:, 1] = -weight * (3.0 - tower.points[:, 1])
    stress[:, 0] = 0.3 / 0.7 * stress[:, 1]
    first = Stage("initial", [*SIDES, BodyForce((0.0, -weight))])
    one, _ = run(tower, ELASTIC, [first, Stage("a", deactivate=["layer_2", "layer_3"])], initial_stress=stress)
    stages = [first, Stage("a", deactivate=["layer_3"], release=0.5), Stage("b", deactivate=["layer_2"])]
    two, summary = run(tower, ELASTIC, stages, initial_stress=stress)
    assert summary.finished
    modulus = 1000.0 * 0.7 / (1.3 * 0.4)
    there = tower.nodes[:, 1] < 1.0 + 1e-9
    heave = 2 * weight * tower.nodes[there, 1] / modulus
    for steps in (one, two):
        moved = steps[-1].displacement.reshape(-1, 2)
        assert moved[there, 1] == pytest.approx(heave, abs=1e-9 * heave.max())
        assert not moved[~there].any()
        left = steps[-1].active[tower.point_cell]
        assert steps[-1].stress[left, 1] == pytest.approx(-weight * (1.0 - tower.points[left, 1]), abs=1e-6)


def test_every_stage_ends_in_equilibrium(plate):
    stress = (-100e3, -100e3, 0.0)
    stages = [
        Stage("initial", [*ROLLERS, *around(100e3)]),
        Stage("hole", [], 2, deactivate=["core"], release=0.5),
        Stage("lining", [Pressure("hole", 20e3)], 2),
    ]
    problem = Problem(plate, GRAINS, stages, initial_stress=stress)
    steps = []
    assert solve(problem, StepControl(), on_step=steps.append).finished
    for step, terms in zip([steps[0], steps[2], steps[4]], problem.program.terms):
        held = 0.0 if step.stage_start.held is None else step.stage_start.held
        rest = unbalanced(plate, GRAINS, step, terms.force_end + held)
        free = terms.body.dofs.copy()
        free[terms.constrained] = False
        assert rest[free].max() < 1e-6 * np.abs(terms.force_end).max()
        assert not rest[~terms.body.dofs].any()


# what is placed -----------------------------------------------------------------------------------------------------


def test_a_fill_has_the_initial_state_of_its_material_under_its_pressure(tower):
    stages = [
        Stage("initial", [*SIDES, Pressure("top_2", 50e3)]),
        Stage("place", [Pressure("top_2", 0.0), Pressure("top_3", 50e3)], 2, activate=["layer_3"], fill_pressure=20e3),
    ]
    problem = Problem(tower, GRAINS, stages, initial_stress=(-50e3, -50e3, 0.0))
    fill = np.isin(tower.point_cell, tower.host_mesh.cells("layer_3"))
    assert (problem.initial_stress[fill] == (-20e3, -20e3, 0.0)).all()
    columns = GRAINS.description.columns("coordination")
    assert (problem.initial_state[:, columns] == 4.06).all()
    steps = []
    assert solve(problem, StepControl(), on_step=steps.append).finished
    assert not steps[0].state[fill].any() and not steps[0].active[tower.host_mesh.cells("layer_3")].any()
    # the load moves up while the fill comes under it: nothing is left of its own pressure
    assert steps[-1].stress[:, 1] == pytest.approx(np.full(tower.npoints, -50e3), rel=1e-6)
    # the fill is loaded from 20 to 50 kPa, what is below not at all
    assert np.abs(steps[-1].strain[~fill]).max() < 1e-9 < np.abs(steps[-1].strain[fill]).max()


def test_backfill_is_placed_anew(tower):
    stress = np.tile([-50e3, -50e3, 0.0], (tower.npoints, 1))
    up = Pressure("top_3", 50e3)
    stages = [
        Stage("initial", [*SIDES, up]),
        Stage("dig", [Pressure("top_2", 30e3), Pressure("top_3", 0.0)], 2, deactivate=["layer_3"]),
        Stage("fill", [Pressure("top_2", 0.0), up], 2, activate=["layer_3"], fill_pressure=30e3),
    ]
    steps, summary = run(tower, GRAINS, stages, initial_stress=stress)
    assert summary.finished
    fill = np.isin(tower.point_cell, tower.host_mesh.cells("layer_3"))
    zone = np.flatnonzero(tower.nodes[:, 1] > 2.0 + 1e-9)
    assert not steps[2].displacement.reshape(-1, 2)[zone].any()
    assert steps[-1].stress[fill, 1] == pytest.approx(np.full(fill.sum(), -50e3), rel=1e-6)


def test_grains_cannot_be_placed_without_pressure(tower):
    stages = [Stage("initial", SIDES), Stage("place", activate=["layer_3"])]
    with pytest.raises(LoadError, match=r"stage 'place': the material at .* cannot begin under fill_pressure = 0 Pa"):
        Problem(tower, GRAINS, stages, initial_stress=(-1e5, -1e5, 0.0))
    Problem(tower, ELASTIC, stages)


def test_reset_of_displacements(tower):
    press = Stage("press", [*SIDES, Displacement("top_3", "y", -0.01)], 2)
    more = Stage("more", [Displacement("top_3", "y", -0.01)], 2, reset_displacements=True)
    steps, _ = run(tower, PLASTIC, [press, more])
    through, _ = run(tower, PLASTIC, [press, Stage("more", [Displacement("top_3", "y", -0.02)], 2)])
    assert np.abs(steps[-1].stress - through[-1].stress).max() < 1e-6 * np.abs(through[-1].stress).max()
    size = np.abs(through[-1].displacement).max()
    assert np.abs(steps[-1].displacement + through[1].displacement - through[-1].displacement).max() < 1e-8 * size
    assert np.abs(steps[-1].strain + through[1].strain - through[-1].strain).max() < 1e-8


# cost ---------------------------------------------------------------------------------------------------------------


class Counting:
    """A law that counts how many points it is asked for."""

    def __init__(self, law):
        self._law, self.asked = law, []
        self.description = law.description
        self.initial_state = law.initial_state

    def update(self, strain_increment, *arguments, **more):
        self.asked.append(len(strain_increment))
        return self._law.update(strain_increment, *arguments, **more)


def test_the_law_is_not_asked_where_nothing_is(plate):
    law = Counting(PLASTIC)
    steps, _ = run(plate, law, excavation(1.0), initial_stress=(-0.1, -0.1, 0.0))
    assert steps[-1].active.sum() < plate.nelements
    assert law.asked[-1] == steps[-1].active.sum() * plate.points_per_cell
    assert law.asked[0] == plate.npoints


def test_a_program_that_changes_no_body_has_none(plate):
    problem = Problem(plate, ELASTIC, [Stage("initial", ROLLERS), Stage("more", around(1.0))])
    assert not problem.changes_body and all(terms.body is None for terms in problem.program.terms)


def test_one_analysis_for_each_body(plate, monkeypatch):
    from granfabric.fem.equilibrium import unknowns

    made = []
    original = unknowns.TangentAssembler
    monkeypatch.setattr(unknowns, "TangentAssembler", lambda *given: made.append(1) or original(*given))
    run(plate, PLASTIC, excavation(0.3, 0.6, 1.0), initial_stress=(-0.1, -0.1, 0.0))
    assert len(made) == 2


# going on -----------------------------------------------------------------------------------------------------------

LAWS = {"plastic": (PLASTIC, 1e-3), "grains": (GRAINS, 1.0), "one way": (ONE_WAY, 1.0)}


def changing(scale):
    p = 1e5 * scale
    return [
        Stage("initial", [*SIDES, Pressure("top_2", p)], 1),
        Stage("dig", [Pressure("top_1", 0.6 * p), Pressure("top_2", 0.0)], 3, deactivate=["layer_2"], release=0.5),
        Stage("next", [], 2, reset_displacements=True),
        Stage("fill", [Pressure("top_1", 0.0), Pressure("top_3", 0.8 * p)], 3, activate=["layer_2", "layer_3"],
              fill_pressure=0.6 * p),
        Stage("press", [Pressure("top_3", 1.1 * p)], 2),
    ]  # fmt: skip


@pytest.mark.parametrize("name", LAWS)
def test_the_same_bits_follow_from_every_checkpoint(tmp_path, tower, name):
    law, scale = LAWS[name]
    problem = Problem(tower, law, changing(scale), initial_stress=(-1e5 * scale, -1e5 * scale, 0.0))
    folder = CheckpointFolder(tmp_path, "x")
    steps, kept = [], []

    def keep(checkpoint):
        folder.save(checkpoint)
        kept.append(folder.files()[-1].read_bytes())

    assert solve(problem, StepControl(), on_step=steps.append, on_checkpoint=keep).finished
    assert np.abs(steps[-1].displacement).max() > 0
    for number, content in enumerate(kept[:-1]):
        for file in folder.files():
            file.unlink()
        (tmp_path / "checkpoint_000001.npz").write_bytes(content)
        rest = []
        solve(problem, StepControl(), on_step=rest.append, resume=folder.load()[0])
        assert len(rest) == len(steps) - number - 1
        for one, two in zip(steps[number + 1 :], rest):
            same(one, two)


def same(one, two):
    for entry in fields(one):
        left, right = getattr(one, entry.name), getattr(two, entry.name)
        if isinstance(left, StageStart):
            same(left, right)
        elif isinstance(left, np.ndarray):
            assert left.tobytes() == right.tobytes(), entry.name
        else:
            assert left == right, entry.name


def test_one_way_and_coupled_runs_agree_where_the_stiffness_stays(tower):
    """Linear response solved at once, and the same law iterated upon."""
    fixed = ContactLaw(GRAINS.materials, effects=Effects(contact_loss=False, contact_gain=False))
    frozen = run(tower, fixed, changing(1.0), initial_stress=(-1e5, -1e5, 0.0))[0]
    once = run(tower, ONE_WAY, changing(1.0), initial_stress=(-1e5, -1e5, 0.0))[0]
    size = np.abs(frozen[-1].displacement).max()
    assert np.abs(frozen[-1].displacement - once[-1].displacement).max() < 1e-6 * size
    assert np.abs(frozen[-1].stress - once[-1].stress).max() < 1.0


# refused ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stages", "text"),
    [
        ([Stage("a", SIDES, deactivate=["layer_3"])], "stage 'a': the first stage cannot change the body"),
        (
            [Stage("a", SIDES), Stage("b", deactivate=["layer_3"]), Stage("c", deactivate=["layer_3"])],
            "stage 'c' deactivates region 'layer_3', but it is not active",
        ),
        (
            [Stage("a", SIDES), Stage("b", activate=["layer_3"]), Stage("c", activate=["layer_3"])],
            "stage 'c' activates region 'layer_3', but it is active already",
        ),
        (
            [Stage("a", SIDES), Stage("b", deactivate=["layer_3"]), Stage("c", deactivate=["all"])],
            "stage 'c' deactivates region 'all', but a part of it is not active",
        ),
        ([Stage("a", SIDES), Stage("b", deactivate=["all", "layer_1"])], "elements of region 'layer_1' twice"),
        ([Stage("a", SIDES), Stage("b", deactivate=["all"])], "stage 'b' deactivates everything that is left"),
        ([Stage("a", SIDES), Stage("b", activate=["all"])], "every element is activated by a later stage"),
        (
            [Stage("a", SIDES), Stage("b", deactivate=["layer_3"], activate=["layer_3"])],
            "stage 'b' activates and deactivates region 'layer_3'",
        ),
        (
            [Stage("a", SIDES), Stage("b", deactivate=["layer_3"], release=0.5), Stage("c", release=0.4)],
            "stage 'c': release = 0.4 is below 0.5",
        ),
        (
            [Stage("a", SIDES), Stage("b", deactivate=["layer_3"]), Stage("c", release=0.4)],
            "stage 'c': release = 0.4, but no forces of an excavation are held",
        ),
        ([Stage("a", SIDES, release=0.4)], "stage 'a': release = 0.4, but no stage deactivates a region"),
        (
            [Stage("a", SIDES), Stage("b", [Pressure("top_3", 1.0)], deactivate=["layer_3"])],
            "stage 'b': the load on boundary 'top_3' has nothing to act on",
        ),
        (
            [Stage("a", SIDES), Stage("b", [Fixed("top_3")], deactivate=["layer_3"])],
            "stage 'b': the support at boundary 'top_3' has nothing to act on",
        ),
        (
            [Stage("a", SIDES), Stage("b", [FixedPoint((0.5, 3.0))], deactivate=["layer_3"])],
            r"stage 'b': the support at point \(0.5, 3.0\) has nothing to act on",
        ),
        (
            [Stage("a", [*SIDES, BodyForce((0, -1.0), "layer_3")]), Stage("b", activate=["layer_3"])],
            "stage 'a': the body force on region 'layer_3' has nothing to act on",
        ),
        (
            [Stage("a", SIDES), Stage("b", deactivate=["layer_2"]), Stage("c")],
            "stage 'b': of the 2 bodies of the mesh the one of region 'all', 'layer_3'",
        ),
        (
            [Stage("a", SIDES), Stage("b", deactivate=["layer_1"])],
            "stage 'b': what is left of the body is free to move along y",
        ),
        (
            [Stage("a", SIDES), Stage("b", [Pressure("top_3", "1/(y - 3)")])],
            r"stage 'b': the pressure on boundary 'top_3' must be finite.*, 3\) m",
        ),
        (
            [Stage("a", SIDES), Stage("b", [BodyForce((0.0, "sqrt(-1 - y)"))])],
            "stage 'b': the body force must be finite",
        ),
        (
            [Stage("a", SIDES), Stage("b", [Displacement("top_3", "y", "log(y - 3)")])],
            "stage 'b': the displacement of boundary 'top_3' must be finite",
        ),
    ],
)  # fmt: skip
def test_one_sentence_for_what_cannot_be(tower, stages, text):
    if "of the 2 bodies" in text:  # rollers along the sides hold the upper part but for moving up and down
        stages = [Stage("a", [Fixed("bottom")]), *stages[1:]]
    with pytest.raises(LoadError, match=text):
        Problem(tower, ELASTIC, stages)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"deactivate": ["a", "a"]}, "deactivates region 'a' twice"),
        ({"release": 1.5}, "release = 1.5 is not between 0 and 1"),
        ({"activate": ["a"], "fill_pressure": -1.0}, "fill_pressure = -1 is not zero or above"),
        ({"fill_pressure": 1.0}, "the stage activates no region"),
        ({"release": float("nan")}, "not a finite number"),
    ],
)
def test_a_stage_looks_at_itself(arguments, text):
    with pytest.raises(LoadError, match=text):
        Stage("s", **arguments)


def test_a_region_that_is_not_there_is_named(tower):
    with pytest.raises(MeshError, match="stage 'b': the mesh has no region 'layer_9'"):
        Problem(tower, ELASTIC, [Stage("a", SIDES), Stage("b", deactivate=["layer_9"])])


def test_reference_forces_do_not_know_parts(tower):
    with pytest.raises(LoadError, match="where stages change the body"):
        Problem(
            tower, ELASTIC, [Stage("a", SIDES), Stage("b", deactivate=["layer_3"])], balance_initial_stress=True
        )


# loads on new and on covered boundaries -----------------------------------------------------------------------------


def test_a_load_acts_on_the_side_that_is_there(plate):
    """Pressure and traction on the wall of an excavation, whose normal points into what was taken away."""
    for load in (Pressure("hole", 100.0), Traction("hole", lambda x, y, nx, ny: -100.0 * np.stack([nx, ny], axis=1))):
        stages = [*excavation(1.0)[:1], Stage("excavation", [load], 2, deactivate=["core"])]
        steps, _ = run(plate, ELASTIC, stages, initial_stress=(-100.0, -100.0, 0.0))
        there = steps[-1].active[plate.point_cell]
        assert np.abs(steps[-1].stress[there] - (-100.0, -100.0, 0.0)).max() < 1e-5  # the pressure of the core is back


def test_a_load_that_is_covered_has_to_go(tower):
    first = Stage("a", [*SIDES, Pressure("top_2", 5.0)])
    with pytest.raises(MeshError, match="stage 'b': boundary 'top_2' lies inside the body"):
        Problem(tower, ELASTIC, [first, Stage("b", activate=["layer_3"])])
    with pytest.raises(MeshError, match="stage 'a': boundary 'top_1' lies inside the body"):
        Problem(tower, ELASTIC, [Stage("a", [*SIDES, Pressure("top_1", 5.0)]), Stage("b", activate=["layer_3"])])
    steps, summary = run(tower, ELASTIC, [first, Stage("b", [Pressure("top_2", 0.0)], activate=["layer_3"])])
    assert summary.finished and np.abs(steps[-1].stress).max() < 1e-6 * np.abs(steps[0].stress).max()


def test_a_kept_load_goes_with_what_it_acts_on(tower):
    first = Stage("a", [*SIDES, Pressure("top_3", 5.0)])
    steps, _ = run(tower, ELASTIC, [first, Stage("b", deactivate=["layer_3"])])
    assert np.abs(steps[-1].stress).max() < 1e-6 * np.abs(steps[0].stress).max()


# a part as a space of its own ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_a_restricted_space_is_the_part(element):
    space = Space(plate_and_core(3)[1], element)
    active = np.zeros(space.nelements, dtype=bool)
    active[space.host_mesh.cells("plate")] = True
    active[5:9] = False
    part = restricted_space(space, active)
    assert np.array_equal(part.space.nodes, space.nodes[part.nodes])
    assert np.allclose(part.space.points, space.points[part.points], rtol=0, atol=1e-15)
    assert np.allclose(part.space.weights, space.weights[part.points], rtol=1e-13)
    assert np.array_equal(part.nodes[part.space.element_nodes], space.element_nodes[part.cells])
    assert not len(part.space.host_mesh.regions["core"])
    assert len(part.space.host_mesh.regions["plate"]) == active.sum()
