"""What callers from Python get wrong, one by one: arrays that used to be taken, and values that are no parameters."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from granfabric.constitutive.arrays import ArrayError, keep_apart
from granfabric.constitutive.contract import Status
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Integration, Material, ParameterError
from granfabric.constitutive.path import Leg, drive
from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.constitutive.plain_laws.von_mises import VonMisesLaw, VonMisesMaterial

PACKING = {"solid_fraction": 0.846, "normal_stiffness": 1e9}
TWO = ContactLaw([Material(coordination=4.06, **PACKING), Material(coordination=3.6, **PACKING)])
ISOTROPIC = (-100e3, -100e3, 0.0)


def points(number, law=TWO):
    stress = np.tile(ISOTROPIC, (number, 1))
    state = law.initial_state(stress)
    return np.tile([1e-6, -3e-6, 2e-6], (number, 1)), stress, state, np.empty_like(stress), np.empty_like(state)


@pytest.mark.parametrize(
    ("control", "text"),
    [
        (np.ones((1, 3), np.uint8), r"control .* of shape \(6, 3\), got uint8 \(1, 3\)"),
        (np.full((6, 3), 2), "control .* codes 0 .strain. and 1 .stress. .* holds 2"),
        (np.full((6, 3), 257), "holds 257"),
    ],
)
def test_a_control_that_is_none(control, text):
    """Stress of 6e11 Pa with status OK: two rows too few, or a code that is neither."""
    _, stress, state, *ends = points(6)
    increment = np.tile([1e3, -1e3, 0.0], (6, 1))
    with pytest.raises(ValueError, match=text):
        TWO.update_mixed(control, increment, stress, state, *ends, np.zeros((6, 3)))
    TWO.update_mixed(np.ones((6, 3), bool), increment, stress, state, *ends, np.zeros((6, 3)))
    assert ends[0][:, 0] == pytest.approx(-99e3)


@pytest.mark.parametrize(("index", "number"), [([0, 1], 6), ([1], 3000)])
def test_a_short_material_index(index, number):
    """Rows were read from whatever lies behind the array."""
    increment, *others = points(number)
    with pytest.raises(ValueError, match=rf"material_index .* of shape \({number},\), got int32 \({len(index)},\)"):
        TWO.update(increment, *others, material_index=np.array(index, np.int32))


def test_a_short_strain_increment():
    """Written or read beyond its end, and a segmentation fault at 4000 points."""
    increment, *others = points(4000)
    with pytest.raises(ValueError, match=r"strain_increment .* of shape \(4000, 3\), got float64 \(1, 3\)"):
        TWO.update_mixed(np.ones((4000, 3)), 1e9 * increment, *others, np.zeros((1, 3)))
    with pytest.raises(ValueError, match=r"strain_increment has the shape \(1, 3\), stress_start \(4000, 3\)"):
        TWO.update(increment[:1].copy(), *others)


def test_a_read_only_output_is_told():
    increment, stress, state, stress_end, state_end = points(3)
    stress_end.flags.writeable = False
    with pytest.raises(ValueError, match=r"stress_end must be a writable C-contiguous .* float64 \(3, 3\) read-only"):
        TWO.update(increment, stress, state, stress_end, state_end)


def test_states_of_no_points_and_of_rows_that_are_none():
    """A process that has no point of a law still asks; six numbers a row are not three."""
    for law in (
        TWO,
        LinearElasticLaw(ElasticMaterial(1e9, 0.3)),
        VonMisesLaw(VonMisesMaterial(1e9, 0.3, 1e5)),
        ContactLaw(TWO.materials, Closure(force_change="shifted_distribution"), Effects(sliding=True)),
    ):
        empty = law.initial_state(np.zeros((0, 3)))
        assert empty.shape == (0, law.description.nstate)
        none = np.zeros((0, 3))
        report = law.update(none, none, empty, none.copy(), empty.copy(), np.zeros((0, 3, 3)))
        assert report.status.shape == (0,) and report.message == "no points"
        shapes = ((3, 5), (6,), (1, 6), (3,), (2, 3, 1), ())
        for wrong in (*(np.zeros(shape) for shape in shapes), [[1, 2, np.nan]]):
            with pytest.raises(ValueError, match="stress must be"):
                law.initial_state(wrong)


def test_points_without_pressure_have_a_state_without_forces():
    """Documented: no force, no stress ratio; every update reports them."""
    stress = np.array([ISOTROPIC, (0.0, 0.0, 0.0), (1e5, 5e4, 2e4), (1e5, -1e5, 0.0)])
    state = TWO.initial_state(stress)
    force = state[:, TWO.description.columns("mean_normal_force")][:, 0]
    assert force[0] > 0 and not force[1:].any()
    assert not state[1:, TWO.description.columns("normal_force_anisotropy")].any()
    report = TWO.update(np.full((4, 3), -1e-7), stress, state, np.empty_like(stress), np.empty_like(state))
    assert list(report.status) == [Status.OK] + [Status.NO_PRESSURE] * 3


def test_bounds_of_given_fields():
    stress = np.tile(ISOTROPIC, (2, 1))
    for wrong in ([4.0, 0.0], [4.0, -1.0], [7.0, 4.0]):
        with pytest.raises(ParameterError, match=r"coordination = .* outside its physical bounds"):
            TWO.initial_state(stress, coordination=wrong)
    with pytest.raises(ParameterError, match=r"fabric_anisotropy has the magnitude 1.5"):
        TWO.initial_state(stress, fabric_anisotropy=[[0.1, 0.2], [1.5, 0.0]])


def test_a_fabric_that_cannot_carry_the_stress():
    """Not a number in every state before, and a status that blamed the input of the first update."""
    law = ContactLaw(TWO.materials, Closure(force_change="shifted_distribution"))
    stress = np.array([ISOTROPIC, (-1.99e5, -0.01e5, 0.0)])
    with pytest.raises(ParameterError, match="at point 1 has no admissible state"):
        law.initial_state(stress, fabric_anisotropy=[[0.0, 0.0], [0.98, 0.0]])


def test_interleaved_views_that_do_not_share_are_taken():
    """Bounds that overlap are not enough to refuse: here no element is in both."""
    room = np.zeros((4, 5, 3))
    increment, stress, state, _, state_end = points(4)
    room[:, 0] = stress
    report = TWO.update(increment, room[:, 0], state, room[0, 1:], state_end)
    assert report.failed == 0
    # a copy is made of the start, which must not change under the caller all the same
    with pytest.raises(ArrayError, match=r"stress_end .* shares memory with stress_start"):
        TWO.update(increment, room[:, 0], state, room[0, :4], state_end)


def test_inputs_may_be_one_array():
    _, stress, state, *ends = points(2)
    TWO.update_stress_driven(stress, stress, state, *ends, np.empty((2, 3)))
    assert np.array_equal(ends[0], 2 * stress)


def test_an_output_over_the_index_of_its_points():
    """Rows of the table would be written while they are read, whoever owns the memory."""
    increment, stress, state, _, state_end = points(2)
    index = np.zeros(12, np.int32)
    with pytest.raises(ArrayError, match=r"stress_end .* shares memory with material_index"):
        TWO.update(increment, stress, state, index.view(float).reshape(2, 3), state_end, material_index=index[:2])
    room = np.zeros((2, 3))
    with pytest.raises(ArrayError, match=r"stress_end .* shares memory with material_index"):
        TWO.update(increment, stress, state, room, state_end, material_index=room.view(np.int32)[0, :2])


def test_what_is_too_hard_to_tell_counts_as_shared(monkeypatch):
    def hard(*_, **__):
        raise RuntimeError("too hard")

    room = np.zeros((4, 6))
    keep_apart({"out": room[1]}, [("in", room[::2, :3], None)])
    monkeypatch.setattr(np, "shares_memory", hard)
    with pytest.raises(ArrayError, match=r"out .* shares memory with in"):
        keep_apart({"out": room[1]}, [("in", room[::2, :3], None)])


@pytest.mark.parametrize("kind", [None, "consistent", 1, ["propagated"], b"elastic", np.array(["elastic", "x"])])
def test_kinds_of_tangent(kind):
    for law in (TWO, LinearElasticLaw(ElasticMaterial(1e9, 0.3)), VonMisesLaw(VonMisesMaterial(1e9, 0.3, 1e5))):
        with pytest.raises(ValueError, match="tangent_kind"):
            law.update(*points(2, law), None, kind)


@pytest.mark.parametrize("law", [LinearElasticLaw, VonMisesLaw])
def test_not_finite_in_the_other_laws(law):
    """Once NaN in the start stress, or a stress that overflows, came out with status OK."""
    law = law(ElasticMaterial(1e9, 0.3) if law is LinearElasticLaw else VonMisesMaterial(1e9, 0.3, 1e5))
    for value in (np.nan, np.inf, 1e308):
        for place in range(3):
            increment, stress, state, *ends = points(3, law)
            stress[1, place], increment[1, place] = value, abs(value)
            tangent = np.full((3, 3, 3), np.nan)
            report = law.update(increment, stress, state, *ends, tangent)
            assert list(report.status) == [Status.OK, Status.NOT_FINITE, Status.OK]
            assert np.array_equal(ends[0][1], stress[1], equal_nan=True)
            assert np.isfinite(tangent).all()


SILLY = [
    *(np.nan, np.inf, -np.inf, -1.0, -1, 1e300, 10**400, 0.5, 1, True, np.True_, None, "1", "yes", b"1", 1j),
    *([], [1.0], (1.0, 2.0), {}, np.array([0.5, 0.5]), np.array(0.5), np.float32(0.5), np.int64(1), object(), len),
]


@pytest.mark.parametrize(
    ("kind", "good"),
    [
        (Material, {"coordination": 4.06, **PACKING}),
        (Closure, {}),
        (Integration, {}),
        (Effects, {}),
        (Leg, {"target": (-1e5, -1e5, 0.0)}),
        (ElasticMaterial, {"youngs_modulus": 1e9, "poissons_ratio": 0.3}),
        (VonMisesMaterial, {"youngs_modulus": 1e9, "poissons_ratio": 0.3, "yield_stress": 1e5}),
    ],
)
def test_silly_values(kind, good):
    """Every value of a caller is refused in one sentence, or does what it says."""
    refused = 0
    for field in dataclasses.fields(kind):
        for value in SILLY:
            try:
                made = kind(**{**good, field.name: value})
            except ParameterError as error:
                assert "\n" not in str(error)
                refused += 1
                continue
            assert getattr(made, field.name) is value
            if kind is Material:
                ContactLaw([made])
            elif kind is Effects:
                assert value is True or value is np.True_
            elif kind is Leg:
                drive(TWO, ISOTROPIC, [made])
            elif kind in (Closure, Integration):
                law = ContactLaw(TWO.materials, **{kind.__name__.lower(): made})
                assert law.update(*points(2, law)).failed == 0
    assert refused > 10 * len(dataclasses.fields(kind))


@pytest.mark.parametrize("law", [ContactLaw, LinearElasticLaw, VonMisesLaw])
def test_laws_of_nothing_or_of_something_else(law):
    """A law without a row had a table of no rows, whose first one every point read."""
    for wrong in ([], (), None, 1.0, "material", [None], [object()], {}, np.zeros(2)):
        with pytest.raises(ParameterError, match="needs"):
            law(wrong)


@pytest.mark.parametrize("name", ["closure", "effects", "integration"])
def test_choices_of_another_class(name):
    for wrong in ({}, "mean_field", True, Material):
        with pytest.raises(ParameterError, match=name):
            ContactLaw(TWO.materials, **{name: wrong})


def test_numbers_of_another_kind_do_not_compile_again():
    """Whole numbers where kernels expect floating ones: the closure's went into one as they were."""
    from granfabric.constitutive.network.force_fabric import initial_force_fabric

    for numbers in ({}, {"tangential_force_ratio": 1, "slip": 1}, {"slip": np.float32(1.0)}):
        ContactLaw(TWO.materials, Closure(force_change="shifted_distribution", **numbers)).initial_state([ISOTROPIC])
    assert len(initial_force_fabric.signatures) == 1


def test_paths_of_another_kind():
    leg = Leg(target=(-1.1e5, -0.9e5, 0.0), increments=2)
    for stress in ((-1e5, -1e5), (-1e5, -1e5, np.nan), "abc", None, [ISOTROPIC], (1e5, 1e5, 0.0), np.zeros(6)):
        with pytest.raises(ValueError, match=r"initial.stress"):
            drive(TWO, stress, [leg])
    state = TWO.initial_state([ISOTROPIC])
    for wrong in (state[0], state[:, :3], np.full_like(state, np.nan), "state"):
        with pytest.raises(ValueError, match="state must be"):
            drive(TWO, ISOTROPIC, [leg], state=wrong)
    with pytest.raises(ParameterError, match="mean normal force"):
        drive(TWO, ISOTROPIC, [leg], state=np.where(state == state[0, 3], 0.0, state))
    with pytest.raises(ParameterError, match="legs"):
        drive(TWO, ISOTROPIC, [(-1e5, -1e5, 0.0)])
    given = state.copy()
    given.flags.writeable = False
    assert drive(TWO, np.array(ISOTROPIC, dtype=np.float32), iter([leg]), state=given).finished
