"""Pore fluid in the host: equilibrium of the total stress, hydrostatic pressure, drained stages, uncoupled runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fem_meshes import run

from granfabric.constitutive.effective_stress import effective_stress, with_pressure
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Material
from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.constitutive.pore_fluid import PoreFluidLaw, fluid_stiffness
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.checkpoint import Checkpoint
from granfabric.fem.equilibrium.stepping import StepControl, solve
from granfabric.fem.loads.kinds import BodyForce, Displacement, Fixed, Pressure, Stage
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import rectangle
from granfabric.fem.mesh.shapes import quarter_ring

PACKING = Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9, fluid_bulk_stiffness=2.2e9)
LAMBDA, SHEAR = 1e8, 1.5e8
ELASTIC = LinearElasticLaw(
    ElasticMaterial(SHEAR * (3 * LAMBDA + 2 * SHEAR) / (LAMBDA + SHEAR), LAMBDA / (2 * (LAMBDA + SHEAR)))
)
ROLLERS = [Fixed("left", ("x",)), Fixed("bottom", ("y",))]


def network_kept() -> ContactLaw:
    """A contact law whose response is linear."""
    effects = Effects(contact_loss=False, contact_gain=False, irreversible_spread=False, pore_fluid=True)
    return ContactLaw([PACKING], effects=effects)


def pressure_of(law, step) -> np.ndarray:
    return step.state[:, law.description.columns("pore_pressure")][:, 0]


@pytest.mark.parametrize("fluid", [1e8, 1e10, 1e12])
def test_undrained_cavity_is_lame_with_the_undrained_bulk_modulus(fluid):
    """u_r/r = A/(2 K_u) + B/(2 G r^2) with K_u = K + K_f/n, and u = -K_f/n A/K_u everywhere."""
    law = PoreFluidLaw(ELASTIC, fluid)
    space = Space(quarter_ring(1.0, 3.0, 8, 8, "triangle"), "P2")
    loads = [Fixed("bottom", ("y",)), Fixed("left", ("x",)), Pressure("inner", 1e5)]
    steps, summary = run(space, law, [Stage("load", loads, 1)], StepControl(tolerance=1e-9))
    assert summary.finished
    uniform, decaying = 1e5 / 8.0, 1e5 * 9.0 / 8.0
    bulk = LAMBDA + SHEAR + fluid
    radius = np.hypot(*space.nodes.T)
    exact = (uniform / (2 * bulk) + decaying / (2 * SHEAR * radius**2))[:, None] * space.nodes
    error = np.linalg.norm(steps[-1].displacement.reshape(-1, 2) - exact) / np.linalg.norm(exact)
    assert error < 2e-5
    # the divergence of quadratic elements is exact to their own order only: the mean over the body is
    mean = space.weights @ pressure_of(law, steps[-1]) / space.weights.sum()
    assert mean == pytest.approx(-fluid * uniform / bulk, rel=2e-3)


def test_linear_elements_lock_and_quadratic_ones_do_not():
    """Displacement of a cavity in a nearly incompressible body, against the limit of no change of volume."""
    errors = {}
    for element, cell in (("P1", "triangle"), ("P2", "triangle"), ("Q1", "quad"), ("Q2", "quad")):
        space = Space(quarter_ring(1.0, 3.0, 8, 8, cell), element)
        loads = [Fixed("bottom", ("y",)), Fixed("left", ("x",)), Pressure("inner", 1e5)]
        steps, _ = run(space, PoreFluidLaw(ELASTIC, 1e12), [Stage("load", loads, 1)])
        inner = space.boundary_nodes("inner")
        radial = np.hypot(*steps[-1].displacement.reshape(-1, 2)[inner].T).mean()
        errors[element] = abs(radial / (1e5 * 9.0 / 8.0 / (2 * SHEAR)) - 1.0)
    assert errors["P1"] > 0.1
    assert errors["Q1"] > 0.1
    assert errors["P2"] < 1e-3
    assert errors["Q2"] < 1e-3


@pytest.mark.parametrize("law", [PoreFluidLaw(ELASTIC, 1e10), ContactLaw([PACKING], effects=Effects(pore_fluid=True))])
def test_hydrostatic_pressure_in_a_column_moves_nothing(law):
    """Saturated weight, submerged effective stress and water: in balance, so that no displacement follows."""
    height, top, weight, water = 2.0, 1e5, 20e3, 9.81e3
    space = Space(rectangle(1.0, height, 2, 4), "P2")
    depth = height - space.points[:, 1]
    effective = np.zeros((space.npoints, 3))
    effective[:, 1] = -(top + (weight - water) * depth)
    effective[:, 0] = 0.6 * effective[:, 1]
    u = water * depth
    total = with_pressure(effective, -u)
    loads = [Fixed("left", ("x",)), Fixed("right", ("x",)), Fixed("bottom"), Pressure("top", top)]
    state = law.initial_state(total, pore_pressure=u)
    # what the reactions cannot see: vertical equilibrium alone keeps the column where it is
    steps, summary = run(
        space,
        law,
        [Stage("initial", [*loads, BodyForce((0.0, -weight))], 2)],
        initial_stress=total,
        initial_state=state,
    )
    assert summary.finished
    settlement = np.abs(steps[-1].displacement).max()
    assert settlement < 1e-9 * top / LAMBDA * height
    assert pressure_of(law, steps[-1]) == pytest.approx(u, rel=1e-9)
    # without the water the same stresses are out of balance
    dry, _ = run(space, law, [Stage("initial", [*loads, BodyForce((0.0, -weight))], 2)], initial_stress=effective)
    assert np.abs(dry[-1].displacement).max() > 1e6 * settlement


def test_drained_stages_keep_the_pore_pressure():
    """Drained, undrained, drained: u moves in the second alone, by Skempton's B."""
    law = PoreFluidLaw(ELASTIC, 1e9)
    space = Space(rectangle(1.0, 1.0, 2, 2), "P2")
    sides = [("right", 1e5), ("top", 1e5)]
    stages = [Stage("initial", [*ROLLERS, *(Pressure(name, value) for name, value in sides)])]
    for number, drained in enumerate((True, False, True), start=2):
        loads = [Pressure(name, number * value) for name, value in sides]
        stages.append(Stage(f"stage {number}", loads, 2, drained=drained))
    steps, summary = run(space, law, stages, initial_stress=(-1e5, -1e5, 0.0))
    assert summary.finished
    b = 1.0 / (1.0 + (LAMBDA + SHEAR) / 1e9)
    found = [pressure_of(law, step).mean() / 1e5 for step in steps]
    assert found == pytest.approx([0.0, 0.0, 0.0, 0.5 * b, b, b, b], abs=1e-9)
    carried = [effective_stress(step.stress, step.state, law.description)[:, 0].mean() / 1e5 for step in steps]
    assert carried == pytest.approx([-1.0, -1.5, -2.0, -2.5 + 0.5 * b, -3.0 + b, -3.5 + b, -4.0 + b], rel=1e-9)


def squeezed(law) -> Problem:
    """Undrained, then drained, between rough platens."""
    space = Space(rectangle(1.0, 1.0, 2, 2), "P2")
    held = [Fixed("bottom"), Fixed("top"), Pressure("left", 1e5), Pressure("right", 1e5)]
    stages = [
        Stage("initial", held),
        Stage("undrained", [Displacement("top", "y", -2e-5)], 3),
        Stage("drained", [Displacement("top", "y", -5e-5)], 3, drained=True),
    ]
    return Problem(space, law, stages, initial_stress=(-1e5, -1e5, 0.0))


def test_an_uncoupled_run_gives_what_a_coupled_one_does():
    law = network_kept()
    assert law.description.linear_response
    one, other = [], []
    assert solve(squeezed(law), on_step=one.append).finished

    class Coupled(ContactLaw):
        @property
        def description(self):
            return replace(law.description, linear_response=False)

    coupled = Coupled([PACKING], effects=law.effects)
    assert solve(squeezed(coupled), StepControl(tolerance=1e-12), on_step=other.append).finished
    assert [step.fraction for step in one] == pytest.approx([step.fraction for step in other])
    for first, second in zip(one, other, strict=True):
        assert first.displacement == pytest.approx(second.displacement, abs=1e-9 * 5e-5)
        assert first.stress == pytest.approx(second.stress, abs=1e-4)
        assert first.state[:, -1] == pytest.approx(second.state[:, -1], abs=1e-4)
    assert np.ptp(one[4].state[:, -1]) > 1e3
    assert np.array_equal(one[3].state[:, -1], one[6].state[:, -1])


@pytest.mark.parametrize("law", [network_kept(), ContactLaw([PACKING], effects=Effects(pore_fluid=True))])
def test_going_on_from_any_step_gives_the_same_bits(law):
    kept: list[Checkpoint] = []

    def keep(checkpoint: Checkpoint) -> None:
        memory = replace(checkpoint.memory, tangent=np.array(checkpoint.memory.tangent))
        kept.append(Checkpoint(checkpoint.result, memory))

    whole = []
    assert solve(squeezed(law), on_step=whole.append, on_checkpoint=keep).finished
    for place in (2, 3, 4):
        rest = []
        assert solve(squeezed(law), on_step=rest.append, resume=kept[place]).finished
        assert len(rest) == len(whole) - place - 1
        assert np.array_equal(rest[-1].stress, whole[-1].stress)
        assert np.array_equal(rest[-1].state, whole[-1].state)
        assert np.array_equal(rest[-1].displacement, whole[-1].displacement)


def test_sides_of_other_materials_may_be_dry():
    """Two columns side by side, the right one without water: only the left one builds up pressure."""
    law = ContactLaw([PACKING, replace(PACKING, fluid_bulk_stiffness=0.0)], effects=Effects(pore_fluid=True))
    space = Space(rectangle(2.0, 1.0, 4, 2), "P2")
    index = space.points[:, 0] > 1.0
    loads = [Fixed("left", ("x",)), Fixed("right", ("x",)), Fixed("bottom"), Displacement("top", "y", -1e-6)]
    steps, summary = run(
        space, law, [Stage("press", loads, 2)], initial_stress=(-1e5, -1e5, 0.0), material_index=index,
        balance_initial_stress=True,
    )  # fmt: skip
    assert summary.finished
    u = pressure_of(law, steps[-1])
    assert not u[index].any()
    volumetric = steps[-1].strain[:, 0] + steps[-1].strain[:, 1]
    assert u[~index] == pytest.approx(-fluid_stiffness(PACKING) * volumetric[~index], rel=1e-9)
    assert u[~index].min() > 0.0


def test_a_drained_stage_means_nothing_to_a_law_without_fluid():
    """The same bits with and without."""
    found = []
    for drained in (False, True):
        space = Space(rectangle(1.0, 1.0, 1, 1), "P2")
        stage = Stage("press", [*ROLLERS, Pressure("top", 1e5)], 1, drained=drained)
        found.append(run(space, ELASTIC, [stage])[0][-1].displacement)
    assert np.array_equal(*found)
