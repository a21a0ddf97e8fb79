"""A specimen between platens and membranes: closed forms of the boundaries, balance of forces and of energy."""

from __future__ import annotations

import numpy as np
import pytest
from dem_samples import two_disks

from granfabric.dem_ref.dynamics.packing import make_packing
from granfabric.dem_ref.measures.contacts import contacts_of
from granfabric.dem_ref.sample.disks import SampleError, write_atomically
from granfabric.dem_ref.specimen.fields import is_inside, specimen_fields
from granfabric.dem_ref.specimen.membrane import MembraneError, enclosed_area, membrane_forces, outer_chain
from granfabric.dem_ref.specimen.run import SpecimenLeg, SpecimenRun
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
    at, radius, lower, upper = specimen.sample.position, specimen.sample.radius, *specimen.platens
    force = np.zeros_like(at)
    membrane_forces(at, radius, specimen.left, lower, upper, PRESSURE, force)
    chain = at[specimen.left] - radius[specimen.left][:, None] * [1.0, 0.0]
    assert force[:, 0].sum() == pytest.approx(PRESSURE * (upper - lower), rel=1e-12)
    assert force[:, 1].sum() == pytest.approx(-PRESSURE * (chain[-1, 0] - chain[0, 0]), rel=1e-9)
    assert np.flatnonzero(np.abs(force).sum(axis=1)).tolist() == sorted(specimen.left.tolist())
    # both sides and no weight: nothing across is left over
    assert specimen._given[:, 0].sum() == pytest.approx(0.0, abs=1e-9 * PRESSURE)
    # the work of a pressure is that of the area
    move = 1e-6 * np.random.default_rng(1).normal(size=at.shape)
    sides = specimen.left, specimen.right
    before, after = (enclosed_area(at + s * move, radius, *sides, lower, upper) for s in (-0.5, 0.5))
    assert np.sum(specimen._given * move) == pytest.approx(-specimen.pressure * (after - before), rel=1e-6)


@pytest.fixture(scope="module")
def compressed() -> Specimen:
    specimen = Specimen(make_packing(300, 1), SpecimenOptions(inertial_number=1e-4, longest_rest=60_000))
    assert specimen.consolidate(), specimen.ending
    assert specimen.compress(5e-3, 10), specimen.ending
    return specimen


def test_it_rests_under_the_same_pressure_on_all_sides(compressed):
    h = compressed.history()
    # the platen carries the pressure times the distance of the membranes' ends; the stress is told over the mean width,
    # from which that of 17 disks departs by a third of a disk
    assert h["axial_stress"][0] == pytest.approx(compressed.pressure, rel=0.03)
    assert h["upper_force"][0] == pytest.approx(h["lower_force"][0], rel=0.05)
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
    again = Specimen(make_packing(300, 1), SpecimenOptions(inertial_number=1e-4, longest_rest=60_000))
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


LEGS = (SpecimenLeg("compression", 1e-4), SpecimenLeg("rest"), SpecimenLeg("compression", 5e-5, stress_ratio=0.01),
        SpecimenLeg("force", axial_stress=1.1e5))  # fmt: skip
QUICK = SpecimenOptions(platen_friction=0.0, inertial_number=1e-4, height_to_width=2.0, longest_rest=50_000)


@pytest.fixture(scope="module")
def smooth() -> SpecimenRun:
    """A specimen between smooth platens, carried along all kinds of legs."""
    run = SpecimenRun(make_packing(300, 1), QUICK, LEGS, 2e-5)
    assert run.execute(), run.reason
    return run


def test_it_is_cut_with_the_shape_asked_for(smooth):
    start = smooth.specimen.start
    assert start.height / start.width == pytest.approx(2.0, rel=0.2)
    assert 100 < smooth.specimen.sample.count < 150


def test_legs_end_where_they_are_asked_to(smooth):
    h = smooth.history()
    strain, leg = h["axial_strain"], h["leg"]
    assert leg.tolist() == [0, *[1] * 5, 2, *[3] * (leg == 3).sum(), 4]
    assert strain[5] == pytest.approx(1e-4, rel=1e-9) and strain[6] == strain[5]
    assert h["unbalanced_force"][6] < QUICK.at_rest
    assert strain[leg == 3][-1] == pytest.approx(5e-5, rel=1e-9)  # q/p stays above where it would have ended
    assert smooth.not_reached and "leg 3 ended at its axial strain" in smooth.not_reached[0]
    assert h["upper_force"][-1] == pytest.approx(1.1e5 * smooth.specimen.start.width, rel=3e-3)


def test_platens_and_what_acts_between_them_balance(smooth):
    """Lower less upper force is what the membranes press downwards, at rest."""
    specimen = smooth.specimen
    upper, lower = specimen.reactions[1, 0], specimen.reactions[0, 0]
    assert lower - upper == pytest.approx(-specimen._given[:, 1].sum(), abs=1e-3 * upper)
    by_disks = specimen.platen_contacts()
    for side in (0, 1):
        found = by_disks.normal_force[by_disks.side == side].sum()
        assert found == pytest.approx(specimen.reactions[side, 0], rel=1e-3)


@pytest.mark.parametrize("kernel", ["gaussian", "lucy", "heaviside"])
@pytest.mark.parametrize("shape", [(1, 1), (3, 7), (6, 12)])
def test_nothing_is_lost_at_the_edges_and_stress_is_that_of_the_boundaries(smooth, kernel, shape):
    """Shares add up to one wherever points and kernel lie: sums over points are those of the whole specimen."""
    specimen = smooth.specimen
    middles = [(np.arange(number) + 0.5) / number for number in shape]
    points = np.stack(np.meshgrid(*middles), axis=-1).reshape(-1, 2)
    found = specimen_fields(specimen, points, 2.0, kernel, smooth.start_position)
    assert found.area.sum() == pytest.approx(specimen.area, rel=1e-12)
    assert found.disks.sum() == pytest.approx(specimen.sample.count, rel=1e-9)
    told = found.disks > 0.0
    contacts = found.disks[told] @ found.coordination[told]
    assert contacts == pytest.approx(2.0 * contacts_of(specimen.sample).count, rel=1e-9)
    stress = np.nansum(found.area[:, None] * found.stress, axis=0) / specimen.area
    # smooth platens: across, the pressure of the membranes and nothing else
    assert stress[0] == pytest.approx(-specimen.pressure, rel=1e-3)
    # along, the forces at their heights: of the upper platen, the lower one at zero, and of the membranes
    moment = specimen._given[:, 1] @ specimen.sample.position[:, 1] - specimen.reactions[1, 0] * specimen.platens[1]
    assert stress[1] == pytest.approx(moment / specimen.area, rel=2e-3)


def test_a_homogeneous_deformation_has_its_strain_at_every_point(smooth):
    specimen = smooth.specimen
    gradient = np.array([[2e-3, 5e-4], [1e-3, -3e-3]])
    start = specimen.sample.position @ np.linalg.inv(np.eye(2) + gradient).T
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.5], [1.0, 1.0]])
    found = specimen_fields(specimen, corners, 6.0, "lucy", start)
    assert found.strain == pytest.approx(np.tile([2e-3, -3e-3, 1.5e-3], (4, 1)), abs=1e-12)
    assert np.isnan(specimen_fields(specimen, corners, 6.0).strain).all()


def test_places_inside_a_polygon():
    corners = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [1.0, 0.5], [0.0, 2.0]])
    places = np.array([[1.0, 0.4], [1.0, 0.6], [0.1, 1.5], [1.9, 1.5], [2.1, 1.0], [-0.1, 0.1], [1.0, -0.1]])
    assert is_inside(places, corners).tolist() == [True, False, True, True, False, False, False]


def test_a_stopped_run_leaves_its_last_record_and_goes_on_to_the_same_bits(smooth, tmp_path):
    run = SpecimenRun(make_packing(300, 1), QUICK, LEGS, 2e-5)
    assert not run.execute(stop=lambda: len(run.specimen.rows) >= 3, checkpoint=tmp_path / "c.npz")
    again = SpecimenRun.resume(tmp_path / "c.npz", QUICK, LEGS, 2e-5)
    assert again.specimen.rows == smooth.specimen.rows[:3] and not again.finished
    again.execute()
    assert again.specimen.rows == smooth.specimen.rows and again.leg_of_row == smooth.leg_of_row
    assert again.not_reached == smooth.not_reached
    assert np.array_equal(again.specimen.sample.position, smooth.specimen.sample.position)


def test_damaged_and_foreign_checkpoints_are_refused(smooth, tmp_path):
    arrays = smooth.arrays()
    path = tmp_path / "c.npz"
    for name in ("motion", "wall_disk", "left", "specimen_numbers", "start_position", "run_numbers", "texts"):
        wrong_ones = [None, np.full_like(arrays[name], 10**6)] if name == "left" else [None, arrays[name][..., :-1]]
        for wrong in wrong_ones:
            changed = {key: value for key, value in arrays.items() if key != name}
            write_atomically(path, changed if wrong is None else {**changed, name: wrong})
            with pytest.raises(SampleError, match=r"c\.npz"):
                SpecimenRun.resume(path, QUICK, LEGS, 2e-5)
    write_atomically(path, arrays)
    with pytest.raises(SampleError, match="other options"):
        SpecimenRun.resume(path, SpecimenOptions(), LEGS, 2e-5)
    with pytest.raises(SampleError, match="another path"):
        SpecimenRun.resume(path, QUICK, LEGS[:2], 2e-5)


def test_loose_disks_under_gravity_do_not_keep_it_from_rest():
    """Disks that have fallen on the lower platen, or lie in gaps, neither bounce for ever nor count."""
    specimen = Specimen(make_packing(200, 2), SpecimenOptions(unit_weight=500.0, longest_rest=60_000))
    assert specimen.consolidate(), specimen.ending
    contacts = contacts_of(specimen.sample)
    number = np.bincount(np.concatenate([contacts.first, contacts.second]), minlength=specimen.sample.count)
    assert (number < 2).any()  # there are such
    pressed = specimen.reactions[0, 0] - specimen.reactions[1, 0]
    assert pressed == pytest.approx(-specimen._given[:, 1].sum(), rel=0.05)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"loading": "shear"}, "loading is 'shear', legal are compression, force, rest"),
        ({"loading": "compression", "axial_strain": 0.5}, "axial_strain is"),
        ({"loading": "force", "axial_stress": -1.0}, "axial_stress is"),
        ({"loading": "compression", "stress_ratio": 2.0}, "stress_ratio is"),
    ],
)
def test_bad_legs_are_refused(values, words):
    with pytest.raises(SampleError, match=words):
        SpecimenLeg(**values)
