"""Grains at integration points: a packing as a law."""

from __future__ import annotations

import numpy as np
import pytest
from grains_points import PRESSURE, SHEAR, call, law, packings, start

from granfabric.cases.grains import law as grains_law
from granfabric.cases.grains import packing_columns
from granfabric.cases.grains.drive import Pace, drive
from granfabric.cases.grains.failures import LARGEST_INCREMENT
from granfabric.cases.grains.law import MEASURES, GrainsLaw
from granfabric.cases.grains.network_stiffness import network_stiffness
from granfabric.constitutive.arrays import ArrayError
from granfabric.constitutive.contract import Law, Status
from granfabric.dem_ref.dynamics.motion import Control, Motion
from granfabric.dem_ref.inputs.probes import elastic_moduli, elastic_probes
from granfabric.dem_ref.measures.contacts import contacts_of, love_weber_stress, sliding_fraction, unbalanced_force

FAST = Pace(strain_step=1e-6, rest=1e-4)


def far_sheared():
    """A packing with sliding contacts whose disks have left their cell: over a tenth of shear strain."""
    sample = packings()[0].copy()
    drive(sample, np.array([0.0, 0.0, 0.12]), FAST)
    return sample


def test_packing_comes_back_from_its_row_with_all_that_it_carries():
    sample = far_sheared()
    assert sliding_fraction(sample, contacts_of(sample)) > 0.0
    assert np.abs(contacts_of(sample).image).max() >= 1
    row = np.empty(packing_columns.width(sample.count))
    packing_columns.write(sample, 2, PRESSURE, row)
    back = packing_columns.read(row, [*packings()[:2], sample])
    for name in ("position", "radius", "cell"):
        assert np.array_equal(getattr(back, name), getattr(sample, name))
    there, here = contacts_of(sample), contacts_of(back)
    assert np.array_equal(here.key, there.key) and np.array_equal(here.image, there.image)
    assert np.array_equal(here.normal_force, there.normal_force)
    np.testing.assert_allclose(here.tangential_force, there.tangential_force, rtol=1e-15)
    again = np.empty_like(row)
    packing_columns.write(back, 2, PRESSURE, again)
    assert np.array_equal(again[: -3 * sample.count], row[: -3 * sample.count])
    np.testing.assert_allclose(again, row, rtol=1e-15)
    np.testing.assert_allclose(love_weber_stress(back), love_weber_stress(sample), rtol=1e-13)


def test_more_contacts_than_a_row_holds_are_refused_and_the_row_is_kept(monkeypatch):
    row = np.full(packing_columns.width(60), 7.0)
    monkeypatch.setattr(packing_columns, "CONTACTS_A_DISK", 1)
    with pytest.raises(packing_columns.PackingError, match="more than lie in a plane"):
        packing_columns.write(packings()[0], 0, PRESSURE, row)
    assert (row == 7.0).all()


def test_law_is_a_law_and_starts_from_the_stress_of_its_packings():
    grains = law()
    assert isinstance(grains, Law)
    stress, state = start(grains)
    assert state.shape == (3, grains.description.nstate)
    assert grains.description.state[-1].hidden and sum(v.hidden for v in grains.description.state) == 1
    assert state[:, MEASURES].tolist() == [0.0, 1.0, 2.0]
    assert grains.lost_pressure(state[0]) == pytest.approx(1e-2 * PRESSURE, rel=1e-3)
    with pytest.raises(ArrayError, match="point 0: its packing carries"):
        grains.initial_state(1.01 * stress)
    with pytest.raises(ArrayError, match="same number of disks"):
        GrainsLaw([packings()[0], packings(61, 1)[0]])


def test_answers_depend_on_the_arguments_alone():
    stress, state = start(law(), 4)
    reference = call(law(threads=1), SHEAR, stress, state)
    assert not reference[3].failed
    grains = law(threads=2)
    call(grains, -2.0 * SHEAR, stress, state)  # what was asked before leaves no trace
    for _ in range(2):
        for found, expected in zip(call(grains, SHEAR, stress, state)[:3], reference[:3]):
            assert np.array_equal(found, expected)
    for point in range(4):
        alone = call(law(threads=1), SHEAR, stress[point : point + 1], state[point : point + 1])
        for found, expected in zip(alone[:3], reference[:3]):
            assert np.array_equal(found[0], expected[point])


def test_stiffness_of_a_start_state_is_found_once(monkeypatch):
    stress, state = start(law())
    found = []
    monkeypatch.setattr(grains_law, "KEPT", 1)
    monkeypatch.setattr(grains_law, "network_stiffness", lambda sample: found.append(0) or network_stiffness(sample))
    grains = law(threads=1)
    first = call(grains, np.zeros(3), stress, state)[2]
    for increment in (np.zeros(3), SHEAR):
        call(grains, increment, stress, state)
    assert len(found) == 3
    assert np.array_equal(call(grains, np.zeros(3), stress, state)[2], first)


def test_zero_increment_changes_nothing_and_gives_the_stiffness():
    stress, state = start(law())
    stress_end, state_end, tangent, report = call(law(), np.zeros(3), stress, state)
    assert np.array_equal(stress_end, stress) and np.array_equal(state_end, state)
    assert report.failed == 0
    for point, sample in enumerate(packings()):
        np.testing.assert_allclose(tangent[point], network_stiffness(sample), rtol=1e-9)


def test_tangent_gives_the_stress_increment_exactly():
    stress, state = start(law())
    stress_end, _, tangent, _ = call(law(), SHEAR, stress, state)
    np.testing.assert_allclose(tangent @ SHEAR, stress_end - stress, rtol=1e-9)
    _, _, elastic, _ = call(law(), SHEAR, stress, state, kind="elastic")
    _, _, network, _ = call(law(secant=False), SHEAR, stress, state)
    assert np.array_equal(elastic, network)
    assert np.abs(elastic @ SHEAR - (stress_end - stress)).max() > 1e-3 * np.abs(stress_end - stress).max()


def test_network_stiffness_is_symmetric_and_agrees_with_elastic_probes():
    sample = packings()[1]
    stiffness = network_stiffness(sample)
    assert np.array_equal(stiffness, stiffness.T)
    assert np.linalg.eigvalsh(stiffness).min() > 0.0
    for probe in [probe for kind in elastic_probes(sample) for probe in kind]:
        strain = probe.strain_change * [1.0, 1.0, 2.0]
        size = np.abs(probe.stress_change).max()
        np.testing.assert_allclose(stiffness @ strain, probe.stress_change, atol=2e-2 * size)
    moduli = elastic_moduli(sample, *elastic_probes(sample))
    bulk = 0.25 * (stiffness[0, 0] + stiffness[1, 1] + 2.0 * stiffness[0, 1])
    assert bulk == pytest.approx(moduli.bulk, rel=2e-2)


def test_small_increment_follows_the_network():
    stress, state = start(law())
    small = 1e-2 * SHEAR
    stress_end, _, tangent, _ = call(law(secant=False, pace=Pace(rest=1e-8)), small, stress, state)
    expected = tangent @ small
    off = np.abs(stress_end - stress - expected).max(axis=1) / np.abs(expected).max(axis=1)
    # in one of the three a contact that hardly carries opens
    assert sorted(off)[1] < 1e-3 and max(off) < 0.1


def test_no_contacts_give_no_stiffness():
    sample = packings()[0].copy()
    drive(sample, np.array([2e-3, 2e-3, 0.0]), FAST)
    assert contacts_of(sample).count == 0
    assert not network_stiffness(sample).any()


def assert_left_as_it_was(stress, state, found):
    assert np.array_equal(found[0], stress) and np.array_equal(found[1], state)
    assert np.isfinite(found[2]).all()
    assert found[3].proposed_step_factor < 1.0


def test_lost_pressure_is_told_and_leaves_start_values():
    stress, state = start(law())
    found = call(law(pace=FAST), np.array([2e-3, 2e-3, 0.0]), stress, state)
    assert found[3].status.tolist() == [Status.NO_PRESSURE] * 3
    assert_left_as_it_was(stress, state, found)


def test_pressure_that_counts_as_lost_can_be_said():
    stress, state = start(law())
    assert call(law(), SHEAR, stress, state)[3].failed == 0
    assert call(law(lost_pressure=2.0 * PRESSURE), SHEAR, stress, state)[3].status.tolist() == [Status.NO_PRESSURE] * 3


def test_packing_that_does_not_come_to_rest_is_told():
    stress, state = start(law())
    found = call(law(pace=Pace(rest=1e-14, longest_rest=100)), SHEAR, stress, state)
    assert found[3].status.tolist() == [Status.NOT_CONVERGED] * 3
    assert found[3].message.startswith("point 0: its packing does not come to rest within law.longest_rest steps")
    assert_left_as_it_was(stress, state, found)


def test_trial_far_off_is_refused_before_it_takes_minutes():
    stress, state = start(law())
    grains = law()
    found = call(grains, np.array([0.0, -1.1 * LARGEST_INCREMENT, 0.0]), stress, state)
    assert found[3].status.tolist() == [Status.TOO_MANY_SUBSTEPS] * 3 and grains.work.steps == 0
    assert found[3].message.startswith("point 0: a strain increment of more than 0.005 at once is not followed")
    assert_left_as_it_was(stress, state, found)


def test_one_failing_point_does_not_touch_the_others():
    stress, state = start(law())
    increment = np.array([SHEAR, [np.nan, 0.0, 0.0], SHEAR])
    found = call(law(), increment, stress, state)
    assert found[3].status.tolist() == [Status.OK, Status.NOT_FINITE, Status.OK]
    assert np.array_equal(found[1][1], state[1]) and np.array_equal(found[0][1], stress[1])
    whole = call(law(), SHEAR, stress, state)
    assert np.array_equal(found[1][[0, 2]], whole[1][[0, 2]])


def test_packings_are_at_rest_and_in_balance_with_the_stress_told():
    stress, state = start(law())
    grains = law()
    stress_end, state_end, _, _ = call(grains, SHEAR, stress, state)
    for point in range(3):
        sample = grains.packing(state_end[point])
        assert unbalanced_force(sample) <= 1.05 * grains.pace.rest
        np.testing.assert_allclose(love_weber_stress(sample), stress_end[point], atol=1e-6 * PRESSURE)


def test_path_in_one_or_in_several_increments_ends_alike():
    stress, state = start(law())
    whole = call(law(), 4.0 * SHEAR, stress, state)
    grains, part_stress, part_state = law(), stress, state
    for _ in range(4):
        part_stress, part_state, _, report = call(grains, SHEAR, part_stress, part_state)
        assert not report.failed
    # of 4e-5 strain: within a thousandth of the pressure, where single contacts of 60 disks slide or not
    assert np.abs(part_stress - whole[0]).max() < 1e-3 * PRESSURE
    assert np.abs(part_state[:, 0] - whole[1][:, 0]).max() <= 2.0 / 60.0 + 1e-12


def test_work_of_the_stress_is_stored_or_turned_into_heat():
    sample = packings()[0].copy()
    motion = Motion(sample)
    motion.stress[:] = love_weber_stress(sample)
    before = motion.energies()
    motion.run(1000, Control(drive=np.array([0.0, -2e-8, 0.0]), fastest_rate=1e-6))
    motion.run(20_000, Control(fastest_rate=0.0))
    after = motion.energies()
    stored = sum(after[name] - before[name] for name in ("normal", "tangential", "kinetic"))
    heat = after["friction"] + after["drag"]
    assert after["kinetic"] < 1e-6 * stored and heat > 0.0  # disks without contacts fly on
    assert after["work"] == pytest.approx(stored + heat, rel=1e-3)


def test_closed_loop_gives_no_energy():
    stress, state = start(law())
    grains, now, at = law(), state, stress
    work = np.zeros(3)
    for part in (SHEAR, SHEAR, -SHEAR, -SHEAR):
        after, now, _, _ = call(grains, part, at, now)
        work += 0.5 * (at + after) @ part
        at = after
    assert (work > -1e-9 * PRESSURE * np.abs(SHEAR).max()).all()


def test_call_can_be_watched_and_left():
    stress, state = start(law())
    for threads in (1, 2):
        grains, told = law(threads=threads), []
        grains.on_points = lambda done, total, told=told: told.append((done, total))
        call(grains, SHEAR, stress, state)
        assert told == [(1, 3), (2, 3), (3, 3)]
        grains.stop = lambda: True
        with pytest.raises(KeyboardInterrupt):
            call(grains, SHEAR, stress, state)
