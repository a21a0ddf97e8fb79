"""A specimen between platens and membranes: closed forms of the boundaries, balance of forces and of energy."""

from __future__ import annotations

import numpy as np
import pytest
from dem_samples import two_disks

from granfabric.dem_ref.dynamics.packing import make_packing
from granfabric.dem_ref.sample.disks import SampleError
from granfabric.dem_ref.specimen.membrane import MembraneError, enclosed_area, membrane_forces, outer_chain
from granfabric.dem_ref.specimen.specimen import Specimen, SpecimenOptions

PRESSURE = 1e5


def wall_of_disks(count: int = 8, columns: int = 3):
    """A square array of unit disks between platens at 0 and `count`."""
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(count) + 0.5)
    return np.column_stack([x.ravel(), y.ravel()]), np.full(count * columns, 0.5)


def test_the_chain_is_the_outer_column_from_below_upwards():
    position, radius = wall_of_disks()
    chain = outer_chain(position, radius, 0.0, 8.2, 1.0)
    assert position[chain].tolist() == [[0.5, k + 0.5] for k in range(8)]


def test_the_chain_finds_what_sticks_out_and_enters_a_notch_as_wide_as_the_ball():
    position, radius = wall_of_disks(12)
    position[6, 0] -= 0.3  # first of the third row: a bulge
    left_out = (position[:, 0] < 1.0) & (position[:, 1] > 5.0) & (position[:, 1] < 9.0)
    position, radius = position[~left_out], radius[~left_out]
    chain = outer_chain(position, radius, 0.0, 12.0, 1.0)
    assert [0.2, 2.5] in position[chain].tolist()
    assert [1.5, 7.5] in position[chain].tolist()
    with pytest.raises(MembraneError, match="no disk lies near the lower platen"):
        outer_chain(position, radius, -5.0, 12.0, 1.0)


def test_a_membrane_presses_with_its_pressure_times_the_height_whatever_its_shape(packing):
    """Across: p H. Along: p times the distance of its ends in x. Moments of a straight one are those of a line load."""
    specimen = Specimen(packing)
    at, lower, upper = specimen.sample.position, *specimen.platens
    force = np.zeros_like(at)
    membrane_forces(at, specimen.left, lower, upper, PRESSURE, force)
    chain = at[specimen.left]
    assert force[:, 0].sum() == pytest.approx(PRESSURE * (upper - lower), rel=1e-12)
    assert force[:, 1].sum() == pytest.approx(-PRESSURE * (chain[-1, 0] - chain[0, 0]), rel=1e-9)
    assert np.flatnonzero(np.abs(force).sum(axis=1)).tolist() == sorted(specimen.left.tolist())
    # both sides and no weight: nothing across is left over
    assert specimen._given[:, 0].sum() == pytest.approx(0.0, abs=1e-9 * PRESSURE)
    # the work of a pressure is that of the area
    move = 1e-6 * np.random.default_rng(1).normal(size=at.shape)
    before, after = (enclosed_area(at + s * move, specimen.left, specimen.right, lower, upper) for s in (-0.5, 0.5))
    assert np.sum(specimen._given * move) == pytest.approx(-specimen.pressure * (after - before), rel=1e-6)


@pytest.fixture(scope="module")
def compressed() -> Specimen:
    specimen = Specimen(make_packing(300, 1), SpecimenOptions(inertial_number=1e-4))
    assert specimen.consolidate(), specimen.ending
    assert specimen.compress(5e-3, 10), specimen.ending
    return specimen


def test_it_rests_under_the_same_pressure_on_all_sides(compressed):
    h = compressed.history()
    assert h["axial_stress"][0] == pytest.approx(compressed.pressure, rel=0.01)
    assert h["upper_force"][0] == pytest.approx(h["lower_force"][0], rel=0.02)
    assert h["upper_shear"][0] == pytest.approx(-h["lower_shear"][0], abs=1e-3 * h["upper_force"][0])
    assert h["unbalanced_force"][0] < 1e-4


def test_compression_strengthens_it_and_platens_agree(compressed):
    h = compressed.history()
    assert h["axial_strain"][-1] == pytest.approx(5e-3, rel=1e-9)
    assert h["stress_ratio"].max() > 0.2
    assert h["coordination"][-1] < h["coordination"][0] - 0.2
    apart = np.abs(h["upper_force"] - h["lower_force"]) / h["upper_force"]
    assert np.median(apart) < 0.1


def test_what_is_worked_is_stored_or_heat(compressed):
    h = compressed.history()
    turned = np.abs(h["platen_work"][-1]) + np.abs(h["given_work"][-1])
    assert np.abs(h["energy_error"]).max() < 2e-3 * turned
    assert np.abs(h["following_work"]).max() < 0.1 * turned
    assert (np.diff(h["friction_heat"]) >= 0.0).all() and (np.diff(h["drag_heat"]) >= 0.0).all()


@pytest.mark.slow
def test_the_same_again_has_the_same_bits(compressed):
    again = Specimen(make_packing(300, 1), SpecimenOptions(inertial_number=1e-4))
    again.consolidate()
    again.compress(5e-3, 10)
    assert again.rows == compressed.rows


@pytest.mark.slow
def test_smooth_platens_carry_no_shear():
    specimen = Specimen(make_packing(200, 2), SpecimenOptions(platen_friction=0.0, inertial_number=3e-4))
    assert specimen.consolidate(), specimen.ending
    specimen.compress(2e-3, 4)
    h = specimen.history()
    assert not h["upper_shear"].any() and not h["lower_shear"].any()


@pytest.mark.slow
def test_the_weight_is_the_difference_of_the_platens():
    """At rest: lower minus upper force is the weight, and what the membranes press down or up."""
    packing = make_packing(200, 2)
    weight = 0.02 * PRESSURE
    specimen = Specimen(packing, SpecimenOptions(unit_weight=weight))
    # a disk that lies on the platen beside the specimen rolls about: this is as quiet as it gets
    assert specimen.hold(specimen.pressure * specimen.area / specimen.height, rest=5e-3), specimen.ending
    total = weight * np.pi * np.sum(specimen.sample.radius**2)
    pressed = float(specimen._given[:, 1].sum())
    assert specimen.reactions[0, 0] - specimen.reactions[1, 0] == pytest.approx(-pressed, rel=0.1)
    assert -pressed == pytest.approx(total, rel=0.3)


def test_what_does_not_come_to_rest_is_told_with_the_disk_that_moves(packing):
    specimen = Specimen(packing)
    assert not specimen.hold(specimen.pressure * 10.0, steps=500)
    for words in ("does not come to rest within 500 steps", "the fastest disk is number"):
        assert words in specimen.ending


def test_bad_input_is_refused_with_a_sentence(packing):
    with pytest.raises(SampleError, match="from a sample"):
        Specimen(None)
    with pytest.raises(SampleError, match="needs a compressed packing"):
        Specimen(two_disks(0.1))
    with pytest.raises(SampleError, match="nearly a rectangle"):
        Specimen(packing.rotated(0.4))
    for name in ("platen_friction", "lateral_pressure", "unit_weight", "consolidation_friction", "inertial_number"):
        for value in (-1.0, np.nan, "1", True):
            with pytest.raises(SampleError, match=name):
                Specimen(packing, SpecimenOptions(**{name: value}))
    specimen = Specimen(packing)
    with pytest.raises(SampleError, match="consolidated before it is compressed"):
        specimen.compress(0.01)
    with pytest.raises(SampleError, match="force is"):
        specimen.hold(-1.0)
