"""Pore fluid: effective stress, Skempton's coefficient, the limit of constant volume, and the contract with hosts."""

import numpy as np
import pytest
from contact_law_cases import PRESSURE, SHIFTED, Points, anisotropic_stress, law, material

from granfabric.constitutive.contract import Law, Status
from granfabric.constitutive.effective_stress import effective_stress
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import ParameterError
from granfabric.constitutive.path import Leg, drive
from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.constitutive.plain_laws.von_mises import VonMisesLaw, VonMisesMaterial
from granfabric.constitutive.pore_fluid import PoreFluidLaw, fluid_stiffness

WATER = 2.2e9
ON = Effects(pore_fluid=True)
WET = material(fluid_bulk_stiffness=WATER)
M = np.array([1.0, 1.0, 0.0])
ELASTIC = ElasticMaterial(3e8, 0.2)
ELASTIC_BULK = 3e8 / (2.0 * (1.0 + 0.2) * (1.0 - 2.0 * 0.2))  # lambda + G, that of the plane


def elastic(stiffness=1e9):
    return PoreFluidLaw(LinearElasticLaw(ELASTIC), stiffness)


def contact(effects=ON, packing=WET, **more):
    return law(effects=effects, materials=[packing], **more)


LAWS = {
    "elastic": elastic(),
    "von mises": PoreFluidLaw(VonMisesLaw(VonMisesMaterial(3e8, 0.2, 1.5e5, 1e7)), 4e9),
    "contact law": contact(substeps=3),
    "contact law, wrapped": PoreFluidLaw(law(substeps=3), 1.4e10),
    "shifted": contact(closure=SHIFTED[0], substeps=3),
    "sliding": contact(Effects(pore_fluid=True, sliding=True), substeps=3),
}


@pytest.fixture(params=LAWS)
def any_law(request):
    return LAWS[request.param]


def batch(any_law, number=21, seed=4, size=1e-5):
    rng = np.random.default_rng(seed)
    pressure = rng.uniform(-0.5e5, 2e5, number)
    stress = anisotropic_stress(rng, number, most=0.25) - pressure[:, None] * M
    return Points(any_law, stress, pore_pressure=pressure), rng.uniform(-size, size, (number, 3))


def fluid_of(any_law):
    """K_f/n as the laws above have it."""
    name = next(name for name, entry in LAWS.items() if entry is any_law)
    return {"elastic": 1e9, "von mises": 4e9, "contact law, wrapped": 1.4e10}.get(name, WATER / (1.0 - 0.846))


def pore_pressure(points, state):
    return points.get(state, "pore_pressure")[:, 0]


def mixed(any_law, stress, control, increment, pressure=0.0):
    """One increment under mixed control of one point: total stress and pore pressure at its end, strain, report."""
    points = Points(any_law, stress, pore_pressure=np.array([pressure]))
    end, state, strain, report = points.mixed(control, increment)
    return end[0], pore_pressure(points, state)[0], strain[0], report


def test_obeys_the_protocol(any_law):
    assert isinstance(any_law, Law)
    assert any_law.description.state[-1].name == "pore_pressure"


def test_total_stress_is_effective_stress_less_pore_pressure(any_law):
    """The skeleton goes its own way: exactly that of the law without fluid under the same strain."""
    points, increment = batch(any_law)
    stress, state, _, report = points.update(increment)
    assert report.failed == 0
    dry = Points(any_law.drained(), points.stress, points.state).update(increment)
    change = pore_pressure(points, state) - pore_pressure(points, points.state)
    assert np.abs(change).min() > 0.0
    assert stress == pytest.approx(dry[0] - change[:, None] * M, rel=0, abs=1e-9)
    assert np.array_equal(state[:, :-1], dry[1][:, :-1])
    assert np.array_equal(dry[1][:, -1], points.state[:, -1])
    effective = effective_stress(stress, state, any_law.description)
    assert effective == pytest.approx(stress + pore_pressure(points, state)[:, None] * M, rel=1e-15)


def test_pressure_follows_from_volumetric_strain(any_law):
    points, increment = batch(any_law)
    state = points.update(increment)[1]
    rise = pore_pressure(points, state) - pore_pressure(points, points.state)
    assert rise == pytest.approx(-fluid_of(any_law) * (increment[:, 0] + increment[:, 1]), rel=1e-9)


def test_zero_increment_changes_nothing(any_law):
    points, _ = batch(any_law)
    stress, state, tangent, report = points.update(np.zeros((21, 3)))
    assert report.failed == 0
    assert np.array_equal(stress, points.stress)
    assert np.array_equal(state, points.state)
    if hasattr(any_law, "update_mixed"):
        stress, state, strain, _ = points.mixed(np.ones(3), np.zeros((21, 3)))
        assert np.array_equal(stress, points.stress)
        assert not strain.any()
    assert np.linalg.eigvalsh(0.5 * (tangent + tangent.transpose(0, 2, 1))).min() > 0.0


def test_tangent_by_taylor_remainder(any_law):
    points, increment = batch(any_law, 6)
    direction = np.random.default_rng(1).uniform(-1e-5, 1e-5, (6, 3))
    stress, _, tangent, _ = points.update(increment)
    change = np.einsum("pij,pj->pi", tangent, direction)
    sizes = 0.02 * 0.5 ** np.arange(5)  # sliding has kinks further away
    remainder = np.array([np.abs(points.update(increment + t * direction)[0] - stress - t * change) for t in sizes])
    worst = remainder.max(axis=(1, 2))
    if worst.max() > 1e-6:  # else linear, and the tangent exact
        assert np.polyfit(np.log(sizes[:3]), np.log(worst[:3]), 1)[0] > 1.8
    dry = Points(any_law.drained(), points.stress, points.state).update(increment)[2]
    assert tangent - dry == pytest.approx(np.broadcast_to(fluid_of(any_law) * np.outer(M, M), dry.shape), rel=1e-12)


def test_start_is_read_only_and_the_call_repeats(any_law):
    points, increment = batch(any_law)
    stress, state = points.stress.copy(), points.state.copy()
    first, second = points.update(increment), points.update(increment)
    assert np.array_equal(points.stress, stress)
    assert np.array_equal(points.state, state)
    for one, other in zip(first[:3], second[:3], strict=True):
        assert np.array_equal(one, other)


def test_skempton_of_the_elastic_law():
    """B = 1/(1 + n K/K_f), with the bulk modulus of the plane; under a deviator A = 1/2."""
    for stiffness in (0.0, 1e7, 1e9, 1e12):
        skeleton = elastic(stiffness)
        b = stiffness / (stiffness + ELASTIC_BULK)
        stress, rise, _, report = mixed(skeleton, -1e5 * M, [1, 1, 1], -1e4 * M)
        assert not report.failed
        assert stress == pytest.approx(-1.1e5 * M, rel=1e-12)
        assert rise == pytest.approx(1e4 * b, rel=1e-9, abs=1e-9)
        rise = mixed(skeleton, -1e5 * M, [1, 1, 1], [0.0, -2e4, 3e3])[1]
        assert rise == pytest.approx(0.5 * 2e4 * b, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("steps", [1, 7, 100])
def test_elastic_answer_does_not_depend_on_increments(steps):
    points = Points(elastic(), -1e5 * M)
    whole = points.update([-3e-4, 1e-4, 2e-4])
    for _ in range(steps):
        stress, state, _, _ = points.update(np.array([-3e-4, 1e-4, 2e-4]) / steps)
        points = Points(points.law, stress, state)
    assert points.stress == pytest.approx(whole[0], rel=1e-12)
    assert points.state == pytest.approx(whole[1], rel=1e-12)


def test_skempton_of_the_granular_law():
    """B tends to that of the tangent, Kw m S m/(1 + Kw m S m), in proportion to the increment."""
    stress = np.array([-1.2e5, -0.9e5, 8e3])
    contact_law = contact(tolerance=1e-10)
    water = fluid_stiffness(WET)
    tangent = Points(contact_law.drained(), stress).update(np.zeros(3))[2][0]
    compliance = M @ np.linalg.solve(tangent, M)
    b = water * compliance / (1.0 + water * compliance)
    errors = [mixed(contact_law, stress, [1, 1, 1], -size * M)[1] / size - b for size in (1e4, 1e3, 1e2)]
    errors = np.abs(errors)
    assert 0.9 < b < 1.0
    assert errors[-1] < 1e-4
    assert np.log10(errors[0] / errors[1]) == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize("closure", [None, SHIFTED[0]], ids=["mean field", "shifted"])
def test_constant_volume_is_the_limit_of_a_stiff_fluid(closure):
    """Undrained biaxial test: the effective path and the network tend to those at constant volume with 1/K_f."""
    legs = [Leg(("stress", "strain", "stress"), (-PRESSURE, -1e-4, 0.0), 10)]
    kept = drive(
        law(closure=closure, tolerance=1e-10),
        -PRESSURE * M,
        [Leg(("strain", "strain", "strain"), (1e-4, -1e-4, 0.0), 10)],
    ).columns
    errors = []
    for size in (1e11, 1e12, 1e13, 1e14):
        packing = material(fluid_bulk_stiffness=size)
        found = drive(contact(packing=packing, closure=closure, tolerance=1e-10), -PRESSURE * M, legs)
        assert found.finished
        columns = found.columns
        assert columns["stress_xx"] == pytest.approx(np.full(11, -PRESSURE), rel=1e-12)
        errors.append(np.abs(columns["effective_p"] / kept["p"] - 1.0).max())
        errors[-1] = max(errors[-1], np.abs(columns["coordination"] - kept["coordination"]).max())
        # u is what the total stress leaves: constant lateral stress, so p = 100 kPa + q
        assert columns["p"] == pytest.approx(PRESSURE + columns["q"], rel=1e-12)
        assert columns["pore_pressure"] == pytest.approx(columns["p"] - columns["effective_p"], abs=1e-6)
    slopes = np.diff(np.log10(errors))
    assert slopes == pytest.approx(-1.0, abs=0.05)


def test_materials_with_other_fluids_and_without():
    index = np.array([0, 1, 2, 0], dtype=np.int32)
    packings = [WET, material(), material(fluid_bulk_stiffness=1e8, fluid_porosity=0.4)]
    several = ContactLaw(packings, effects=ON)
    stress, increment = np.tile([-1.1e5, -0.9e5, 2e3], (4, 1)), np.tile([-4e-6, -2e-6, 1e-6], (4, 1))
    points = Points(several, stress, material_index=index, pore_pressure=np.full(4, 1e4))
    end, state, tangent, _ = points.update(increment, material_index=index)
    for row in range(4):
        alone = ContactLaw([packings[index[row]]], effects=ON)
        single = Points(alone, stress[row], pore_pressure=np.full(1, 1e4)).update(increment[row])
        assert np.array_equal(single[0][0], end[row])
        assert np.array_equal(single[1][0], state[row])
        assert np.array_equal(single[2][0], tangent[row])
    rise = 6e-6 * WATER / 0.154
    assert pore_pressure(points, state) - 1e4 == pytest.approx([rise, 0.0, 6e-6 * 2.5e8, rise])


def test_failed_points_keep_their_start():
    """No effective pressure left, whatever the total one; and a pore pressure that is not finite."""
    points = Points(contact(), np.tile(-1e5 * M, (3, 1)), pore_pressure=np.array([0.0, 0.0, 0.0]))
    points.state[1, -1] = np.nan
    stress, state, _, report = points.update([[2e-3, 2e-3, 0.0], [1e-6, 0.0, 0.0], [1e-6, 0.0, 0.0]])
    assert list(report.status) == [Status.NO_PRESSURE, Status.NOT_FINITE, Status.OK]
    assert np.array_equal(stress[:2], points.stress[:2])
    assert np.array_equal(state[:2], points.state[:2], equal_nan=True)
    end, state, strain, report = points.mixed(np.ones(3), np.tile([0.0, -1e3, 0.0], (3, 1)))
    assert report.status[1] == Status.NOT_FINITE
    assert np.array_equal(end[1], points.stress[1])
    assert np.array_equal(state[1], points.state[1], equal_nan=True)
    assert not strain[1].any()
    assert strain[0, :2].all()


def test_stress_control_meets_what_is_prescribed(any_law):
    points, _ = batch(any_law, 30, seed=8)
    rng = np.random.default_rng(2)
    control = rng.integers(0, 2, (30, 3)).astype(np.uint8)
    increment = np.where(control == 1, rng.uniform(-1e3, 1e3, (30, 3)), rng.uniform(-1e-6, 1e-6, (30, 3)))
    stress, state, strain, report = points.mixed(control, increment)
    assert report.failed == 0
    assert np.where(control, stress - points.stress, strain) == pytest.approx(increment, rel=1e-7, abs=1e-12)
    again = points.update(strain)
    assert np.array_equal(again[0], stress)
    assert np.array_equal(again[1], state)


def test_the_contact_law_has_what_the_wrapper_gives():
    """Two ways to the same: columns beside those of the kernels, or copied."""
    inner, outer = contact(), PoreFluidLaw(law(), fluid_stiffness(WET))
    one, increment = batch(inner)
    other, _ = batch(outer)
    assert np.array_equal(one.state, other.state)
    for first, second in zip(one.update(increment)[:3], other.update(increment)[:3], strict=True):
        assert np.array_equal(first, second)


def test_what_is_refused():
    with pytest.raises(ParameterError, match="needs pores"):
        contact(packing=material(solid_fraction=1.0, fluid_bulk_stiffness=WATER))
    assert fluid_stiffness(material(solid_fraction=1.0, fluid_bulk_stiffness=2.0, fluid_porosity=0.5)) == 4.0
    with pytest.raises(ParameterError, match="fluid_stiffness"):
        PoreFluidLaw(law(), -1.0)
    with pytest.raises(ParameterError, match=r"effects\.pore_fluid"):
        law().initial_state(-1e5 * M[None], pore_pressure=np.ones(1))
    with pytest.raises(ParameterError, match=r"effects\.pore_fluid"):
        drive(law(), -1e5 * M, [Leg(target=(-1e5, -1e5, 0.0))], pore_pressure=1e4)
    with pytest.raises(ValueError, match="pore_pressure has 2 entries"):
        contact().initial_state(-1e5 * M[None], pore_pressure=np.ones(2))
