"""What the contact law promises its host."""

import threading

import numba
import numpy as np
import pytest
from contact_law_cases import (
    ALL_CLOSURES,
    EFFECT_SETS,
    PRESSURE,
    SHIFTED,
    Points,
    anisotropic_stress,
    closure_name,
    effects_name,
    law,
    material,
)

from granfabric.constitutive.contract import Law, Status
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.parameters import Closure, Integration, Material, ParameterError


def random_batch(contact_law, number, seed=0, size=1e-5):
    rng = np.random.default_rng(seed)
    return Points(contact_law, anisotropic_stress(rng, number)), rng.uniform(-size, size, (number, 3))


def test_obeys_the_protocol():
    assert isinstance(law(), Law)


@pytest.mark.parametrize("closure", ALL_CLOSURES, ids=closure_name)
def test_start_is_read_only_and_the_call_repeats(closure):
    points, increment = random_batch(law(closure=closure), 50)
    stress, state = points.stress.copy(), points.state.copy()
    first = points.update(increment)
    points.stress.flags.writeable = points.state.flags.writeable = False
    second = points.update(increment)
    assert np.array_equal(points.stress, stress)
    assert np.array_equal(points.state, state)
    for a, b in zip(first[:3], second[:3], strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize("effects", EFFECT_SETS, ids=effects_name)
def test_zero_increment_changes_nothing_and_returns_the_stiffness(effects):
    points, _ = random_batch(law(effects=effects), 5)
    stress, state, tangent, report = points.update(np.zeros((5, 3)))
    assert np.array_equal(stress, points.stress)
    assert np.array_equal(state, points.state)
    assert report.failed == 0
    assert report.substeps.sum() == 0
    tiny = points.update(np.full((5, 3), 1e-16))[2]
    assert tangent == pytest.approx(tiny, abs=1e-9 * tangent.max())


@pytest.mark.parametrize("closure", ALL_CLOSURES, ids=closure_name)
def test_batch_equals_singles_in_any_order(closure):
    """Bit for bit: what a lane's neighbours hold does not matter, nor in which lane a point lies."""
    contact_law = law(closure=closure, tolerance=1e-8)
    points, increment = random_batch(contact_law, 67, size=5e-5)
    stress, state, tangent, report = points.update(increment)
    assert report.substeps.max() > 3
    order = np.random.default_rng(5).permutation(67)
    shuffled = Points(contact_law, points.stress[order], points.state[order]).update(increment[order])
    assert np.array_equal(shuffled[0], stress[order])
    assert np.array_equal(shuffled[2], tangent[order])
    for i in range(0, 67, 13):
        single = Points(contact_law, points.stress[i], points.state[i : i + 1]).update(increment[i])
        assert np.array_equal(single[0][0], stress[i])
        assert np.array_equal(single[1][0], state[i])
        assert np.array_equal(single[2][0], tangent[i])


@pytest.mark.parametrize("effects", [Effects(), Effects(principal_rotation=False), Effects(sliding=True),
                                     Effects(principal_rotation=False, sliding=True)], ids=effects_name)  # fmt: skip
@pytest.mark.parametrize("closure", [Closure(), SHIFTED[0]], ids=closure_name)
def test_lanes_without_a_point_do_not_matter(closure, effects):
    """Batches of every size up to two blocks, some points at rest: what a lane held before, or never, is not seen."""
    contact_law = law(closure=closure, effects=effects)
    points, increment = random_batch(contact_law, 17, size=2e-5)
    increment[[3, 9]] = 0.0
    whole = points.update(increment)
    assert whole[3].failed == 0
    for number in range(1, 17):
        part = Points(contact_law, points.stress[-number:], points.state[-number:]).update(increment[-number:])
        for one, other in zip(part[:3], whole[:3], strict=True):
            assert np.array_equal(one, other[-number:])


def test_threads_do_not_matter():
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one thread only")
    contact_law = law(tolerance=1e-7)
    points, increment = random_batch(contact_law, 10_000, size=1e-5)
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        one = points.update(increment)
        numba.set_num_threads(2)
        two = points.update(increment)
    finally:
        numba.set_num_threads(before)
    for a, b in zip(one[:3], two[:3], strict=True):
        assert np.array_equal(a, b)
    assert threading.active_count() > 1


def test_materials_by_index():
    """Each point follows its own row of the table."""
    soft, stiff = material(normal_stiffness=1e8), material(coordination=4.3, force_density_at_zero=0.7)
    both = law(materials=[soft, stiff])
    index = np.array([1, 0, 1], dtype=np.int32)
    stress = np.tile([-1.1e5, -0.9e5, 5e3], (3, 1))
    points = Points(both, stress, material_index=index)
    end = points.update(np.tile([-1e-5, 2e-6, 3e-6], (3, 1)), material_index=index)[0]
    for row, packing in zip(range(3), (stiff, soft, stiff), strict=True):
        alone = Points(law(materials=[packing]), stress[0]).update((-1e-5, 2e-6, 3e-6))[0]
        assert np.array_equal(alone[0], end[row])
    with pytest.raises(ValueError, match="material_index"):
        points.update(np.zeros((3, 3)), material_index=np.array([0, 2, 0], dtype=np.int32))


@pytest.mark.parametrize("effects", EFFECT_SETS, ids=effects_name)
def test_columns_follow_the_effects(effects):
    """An effect that is off has no column."""
    description = law(effects=effects).description
    assert description.has_state("coordination_gained") == effects.contact_gain
    assert description.has_state("coordination_lost") == effects.contact_loss
    assert description.has_state("reference_coordination") == (
        effects.network_changes and not effects.stiffness_feedback
    )
    columns = description.columns("fabric_anisotropy")
    assert columns.stop - columns.start == (2 if effects.principal_rotation else 1)


def test_off_executes_nothing():
    """Parameters of an effect that is off cannot matter, whatever they are; without both the network stays."""
    stress, increment = (-1.2e5, -0.9e5, 1e4), (-2e-5, 1e-5, 5e-6)
    for effects, changes in (
        (Effects(contact_gain=False), {"gap_density_at_zero": 1e6, "neighbours": 20.0}),
        (Effects(contact_loss=False), {"force_density_at_zero": 10.0}),
    ):
        ends = [
            Points(law(effects=effects, materials=[packing]), stress).update(increment)
            for packing in (material(), material(**changes))
        ]
        assert np.array_equal(ends[0][0], ends[1][0])
        assert np.array_equal(ends[0][1], ends[1][1])
    points = Points(law(effects=Effects(contact_loss=False, contact_gain=False)), stress)
    end, state, tangent, report = points.update(increment)
    assert points.get(state, "coordination")[0, 0] == 4.06
    assert end[0] == pytest.approx(points.stress[0] + tangent[0] @ increment, rel=1e-14)
    assert report.substeps[0] == 1


def test_frozen_stiffness():
    """Without feedback the response is linear in strain, while the network still evolves."""
    points = Points(law(effects=Effects(stiffness_feedback=False)), (-1.1e5, -0.9e5, 0.0))
    increment = np.array([-3e-5, 2e-5, 1e-5])
    stress, state, tangent, _ = points.update(increment)
    assert stress[0] - points.stress[0] == pytest.approx(tangent[0] @ increment, rel=1e-12)
    assert points.get(state, "coordination")[0, 0] < 4.05
    assert points.get(state, "reference_coordination")[0, 0] == 4.06


@pytest.mark.parametrize("position", range(3))
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_input_that_is_not_finite(position, value):
    """Only that point fails; its end is its start; nothing not finite comes out."""
    points, increment = random_batch(law(), 20)
    healthy = points.update(increment)
    increment[7, position] = value
    stress, state, tangent, report = points.update(increment)
    assert report.status[7] == Status.NOT_FINITE
    assert report.failed == 1
    assert report.worst_point == 7
    assert "not finite" in report.message
    assert np.array_equal(stress[7], points.stress[7])
    assert np.array_equal(np.delete(stress, 7, axis=0), np.delete(healthy[0], 7, axis=0))
    assert np.all(np.isfinite(state)) and np.all(np.isfinite(tangent))


def test_start_in_tension_is_refused():
    points = Points(law(), [(-1e5, -1e5, 0.0), (1e5, 0.5e5, 0.0), (1e5, -1e5, 0.0)])
    stress, _, _, report = points.update(np.full((3, 3), -1e-7))
    assert list(report.status) == [Status.OK, Status.NO_PRESSURE, Status.NO_PRESSURE]
    assert np.array_equal(stress[1:], points.stress[1:])
    assert report.proposed_step_factor < 1


def test_unloading_through_zero_pressure_is_refused():
    """Extension far past zero pressure: the point fails with a reason; just before it, it does not."""
    points = Points(law(), (-1e5, -1e5, 0.0))
    _, state, _, report = points.mixed((1, 1, 1), (2e5, 2e5, 0.0))
    assert report.status[0] == Status.NO_PRESSURE
    assert np.array_equal(state, points.state)
    _, state, _, report = points.mixed((1, 1, 1), (0.999e5, 0.999e5, 0.0))
    assert report.failed == 0
    assert 0 < points.get(state, "coordination")[0, 0] < 4.06


def test_too_many_substeps():
    points = Points(law(maximum_substeps=5, tolerance=1e-12), (-1e5, -1e5, 0.0))
    stress, _, _, report = points.update((-3e-4, 3e-4, 0.0))
    assert report.status[0] == Status.TOO_MANY_SUBSTEPS
    assert report.substeps[0] + report.rejected[0] == 5
    assert np.array_equal(stress, points.stress)


def test_indefinite_stiffness_is_refused():
    packing = material(stiffness_ratio=0.0, initial_fabric_xx=1.5)
    points = Points(law(closure=Closure(distribution="maximum_entropy"), materials=[packing]), (-1e5, -1e5, 0.0))
    assert points.update((-1e-6, 0.0, 0.0))[3].status[0] == Status.STIFFNESS_LOST


def test_continuum_and_elastic_tangent():
    points = Points(law(), (-1.2e5, -0.9e5, 1e4))
    increment = (-4e-5, 3e-5, 1e-5)
    _, state, continuum, _ = points.update(increment, "continuum")
    _, _, elastic, _ = points.update(increment, "elastic")
    assert np.array_equal(elastic, points.update((0.0, 0.0, 0.0))[2])
    again = Points(points.law, (-1.2e5, -0.9e5, 1e4), state)
    assert np.array_equal(continuum, again.update((0.0, 0.0, 0.0))[2])
    with pytest.raises(ValueError, match="tangent_kind"):
        points.update(increment, "consistent")


@pytest.mark.parametrize("control", [(1, 1, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (0, 1, 1), (1, 0, 1)])
def test_mixed_control_agrees_with_strain_control(control):
    """Strains that a mixed increment returns, imposed as strains, give its stress back, to the tolerance of both."""
    points = Points(law(tolerance=1e-10), (-1.2e5, -0.9e5, 1e4))
    increment = np.where(np.array(control) == 1, [-4e3, 3e3, 2e3], [-2e-5, 1e-5, 5e-6])
    stress, _, strain, report = points.mixed(control, increment)
    assert report.failed == 0
    given = np.where(np.array(control) == 1, stress[0] - points.stress[0], strain[0])
    assert given == pytest.approx(increment, rel=1e-12)
    again = points.update(strain)
    # the path between differs: strains are not linear in stress, so only the order of the increment's square agrees
    assert again[0] == pytest.approx(stress, rel=3e-3)
    small = 1e-3 * increment
    stress, _, strain, _ = points.mixed(control, small)
    assert points.update(strain)[0] == pytest.approx(stress, rel=1e-8)


@pytest.mark.parametrize(
    ("build", "text"),
    [
        (lambda: material(coordination=7.0), "coordination = 7.0 is outside"),
        (lambda: material(stiffness_ratio=-0.1), "stiffness_ratio"),
        (lambda: material(normal_stiffness=float("nan")), "normal_stiffness"),
        (lambda: material(solid_fraction="dense"), "not a number"),
        (lambda: Closure(distribution="harmonics"), "nearest is 'harmonic'"),
        (lambda: Integration(tolerance=0.0), "tolerance"),
        (lambda: Integration(integrator="forward_euler"), "no error estimate"),
        (lambda: Integration(substeps=-1), "substeps"),
        (lambda: law(materials=[material(initial_fabric_xx=1.5)]), "admits at most 1"),
        (
            lambda: law(materials=[material(force_density_at_zero=1.2)], closure=Closure(tangential="self_consistent")),
            "not below 1",
        ),
    ],
)
def test_bad_parameters_say_what_is_legal(build, text):
    with pytest.raises(ParameterError, match=text):
        build()


def test_arrays_of_the_wrong_kind_are_refused():
    points = Points(law(), (-1e5, -1e5, 0.0))
    with pytest.raises(ValueError, match="C-contiguous float64"):
        points.law.update(np.zeros((1, 3), dtype=np.float32), points.stress, points.state, points.stress, points.state)


def test_parameter_names_are_those_of_the_table():
    """The kernels address the table by position."""
    from granfabric.constitutive import material_table

    names = [variable.name for variable in Material.variables()]
    assert names[material_table.PAR_P_ZERO] == "force_density_at_zero"
    assert names[material_table.PAR_SHEAR] == "shear_reduction"
    assert names[material_table.PAR_FABRIC_XY] == "initial_fabric_xy"
    assert names[material_table.PAR_M_CV] == "constant_volume_stress_ratio"
    assert names[material_table.PAR_COHESION] == "apparent_cohesion"
    assert len(names) == material_table.PAR_FLUID_POROSITY + 1
    assert names[material_table.PAR_KN] == "normal_stiffness"
    assert names[material_table.PAR_C_N] == "force_anisotropy_ratio"
    assert PRESSURE / 1e9 == 1e-4
