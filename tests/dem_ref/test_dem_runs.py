"""Runs with history and checkpoints, probes and the material table."""

from __future__ import annotations

import numpy as np
import pytest

from granfabric.dem_ref.inputs.material import CLOSURE_KEYS, MATERIAL_KEYS, measure_material
from granfabric.dem_ref.inputs.probes import (
    ELASTIC_LIMITS,
    elastic_moduli,
    elastic_probes,
    settled,
    shear_modulus,
    stress_probe,
)
from granfabric.dem_ref.inputs.weak_contacts import measure_slip, measure_weak_contacts
from granfabric.dem_ref.loading.path import Segment, biaxial_test, loading_cycles, principal_rotation
from granfabric.dem_ref.loading.run import HISTORY_COLUMNS, DemRun, RunOptions, at_stress_ratios
from granfabric.dem_ref.loading.servo import RateLimits
from granfabric.dem_ref.measures.contacts import (
    bearing_particles,
    contacts_of,
    coordination_number,
    fabric_anisotropy,
    force_harmonics,
    love_weber_stress,
)
from granfabric.dem_ref.measures.events import directional_change, match_contacts
from granfabric.dem_ref.measures.tessellation import radical_neighbours
from granfabric.dem_ref.sample.disks import Sample, SampleError

P = 1e5


@pytest.fixture(scope="module")
def biaxial(large_packing) -> DemRun:
    run = DemRun(large_packing, RunOptions(tuple(biaxial_test(stress_ratio=0.3))))
    assert run.execute()
    return run


def test_history_has_its_columns_and_starts_at_the_packing(biaxial, large_packing):
    h = biaxial.history()
    assert tuple(h) == HISTORY_COLUMNS
    assert h["coordination"][0] == coordination_number(large_packing).all_particles
    assert h["mean_normal_force"][0] == 1.0
    assert h["q"][0] / h["p"][0] < 1e-4
    assert np.all(np.diff(h["dem_steps"]) > 0)
    assert h["q"][-1] / h["p"][-1] == pytest.approx(0.3, abs=0.005)
    assert np.diff(h["q"] / h["p"]).max() < 0.02


def test_gained_and_lost_close_over_the_history(biaxial):
    h = biaxial.history()
    assert h["coordination"] - h["coordination"][0] == pytest.approx(
        h["coordination_gained"] - h["coordination_lost"], abs=1e-12
    )
    parts = h["fabric_gained"] + h["fabric_lost"] + h["fabric_persisting"]
    assert h["fabric_anisotropy"] - h["fabric_anisotropy"][0] == pytest.approx(parts, abs=1e-12)
    # at small strain the network changes by loss; turning of contacts is of the order of the strain
    assert abs(h["fabric_persisting"][-1]) < 0.01 * h["fabric_lost"][-1]


def test_stress_force_fabric_relation_holds_along_the_path(biaxial):
    """q/p = (a_c + a_n + a_t)/2 up to products of anisotropies and the grading, a few per cent."""
    h = biaxial.history()
    late = h["q"] / h["p"] > 0.1
    total = 0.5 * (h["fabric_anisotropy"] + h["normal_force_anisotropy"] + h["tangential_force_anisotropy"])
    assert total[late] == pytest.approx((h["q"] / h["p"])[late], rel=0.06)


def test_known_behaviour_at_constant_pressure(biaxial, large_packing):
    """Loss of contacts mostly in the minor direction; a_t about a third of the sum; weak change of the mean force."""
    at = at_stress_ratios(biaxial.history(), [0.2])
    assert 0.03 < 1 - at["coordination"][0] / biaxial.history()["coordination"][0] < 0.08
    assert 0.04 < at["fabric_anisotropy"][0] < 0.12
    assert 0.9 < at["normal_force_anisotropy"][0] / 0.2 < 1.25
    assert 0.2 < at["tangential_force_anisotropy"][0] / 0.4 < 0.4
    assert 1.0 < at["mean_normal_force"][0] < 1.08
    assert 0.05 < at["sliding_fraction"][0] < 0.15
    change = directional_change(contacts_of(large_packing), biaxial.contacts, bins=4)
    assert change.lost[0] > 4 * change.lost[2]  # compression along y: minor direction x


def carrying(pairs):
    """Disks, images and elongations of pairs that hold a tangential force."""
    held = pairs.tangential != 0.0
    return pairs.first[held], pairs.second[held], pairs.image[held], pairs.tangential[held]


@pytest.mark.parametrize(
    ("segments", "moments"),
    [
        (tuple(loading_cycles(0.1)), (1, 37, 70)),
        # unloading at constant lateral stress beyond the start, another pressure, a turn, given strain
        (
            (
                *loading_cycles(0.1, path="constant_lateral_stress")[:1],
                Segment("biaxial", "constant_lateral_stress", -0.02, -0.05),
                Segment("invariants", pressure=0.8, stress_ratio=0.06, angle=0.3),
                Segment("mixed", control=("strain", "stress", "stress"), target=(-2e-5, -0.8e5, 0.0)),
            ),
            (20, 45, 80),
        ),
    ],
    ids=["cycles", "turns"],
)
def test_resumed_run_is_identical_to_the_last_bit(tmp_path, packing, segments, moments):
    options = RunOptions(segments)
    straight = DemRun(packing, options)
    assert straight.execute()
    for chunks in moments:
        run = DemRun(packing, options)
        for _ in range(chunks):
            run.advance()
        run.save(tmp_path / "run.npz")
        resumed = DemRun.resume(tmp_path / "run.npz", options)
        assert not resumed.finished
        assert resumed.execute()
        assert np.array_equal(np.array(resumed.rows), np.array(straight.rows))
        assert np.array_equal(resumed.sample.position, straight.sample.position)
        # which pairs that do not touch are near depends on when their list was made
        for ours, theirs in zip(*(carrying(run.sample.pairs) for run in (resumed, straight))):
            assert np.array_equal(ours, theirs)


def test_stopped_run_is_saved_and_resumes(tmp_path, packing):
    options = RunOptions(tuple(biaxial_test(stress_ratio=0.1)))
    calls, seen = [], []
    run = DemRun(packing, options)
    stopped = run.execute(
        stop=lambda: len(seen) >= 3, on_record=lambda r: seen.append(len(r.rows)), progress=calls.append,
        checkpoint=tmp_path / "c.npz",
    )  # fmt: skip
    assert not stopped and not run.finished and seen == [2, 3, 4]
    resumed = DemRun.resume(tmp_path / "c.npz", options)
    assert resumed.execute(progress=lambda r: calls.append(r.completed_fraction()))
    assert calls[-1] == 1.0
    straight = DemRun(packing, options)
    straight.execute()
    assert np.array_equal(np.array(resumed.rows), np.array(straight.rows))


def test_checkpoints_of_other_options_or_damaged_ones_are_refused(tmp_path, packing):
    options = RunOptions(tuple(biaxial_test(stress_ratio=0.1)))
    run = DemRun(packing, options)
    path = tmp_path / "c.npz"
    run.save(path)
    with pytest.raises(SampleError, match="other options"):
        DemRun.resume(path, RunOptions(tuple(biaxial_test(stress_ratio=0.2))))
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(SampleError, match="not a stored sample"):
        DemRun.resume(path, options)
    with pytest.raises(SampleError, match="no such file"):
        DemRun.resume(tmp_path / "none.npz", options)


def test_bad_runs_are_refused(packing):
    with pytest.raises(SampleError, match="at least one segment"):
        DemRun(packing, RunOptions(()))
    with pytest.raises(SampleError, match="legal are biaxial"):
        DemRun(packing, RunOptions((Segment(kind="triaxial"),))).execute()
    with pytest.raises(SampleError, match="needs a compressed sample"):
        loose = packing.copy()
        loose.radius *= 0.9
        DemRun(loose, RunOptions(tuple(biaxial_test())))


def test_a_stress_beyond_the_strength_is_given_up_and_told(tmp_path, packing):
    """mu = 0.5 carries q/p of 0.3 to 0.5; asked for by stress alone, the sample flows until the run gives up."""
    options = RunOptions((Segment("invariants", stress_ratio=0.8),), limits=RateLimits(1e-3, 1e-1, lag=0.05))
    run = DemRun(packing, options)
    assert not run.execute(checkpoint=tmp_path / "c.npz")
    assert run.finished and "cannot carry" in run.message
    assert DemRun.resume(tmp_path / "c.npz", options).message == run.message


def test_turning_axes_run_ends_turned(packing):
    run = DemRun(packing, RunOptions(tuple(principal_rotation(0.1, turns=0.25))))
    assert run.execute()
    stress = run.motion.stress
    assert 0.5 * (stress[1] - stress[0]) == pytest.approx(0.1 * P, rel=0.02)
    assert len(run.options.segments) == 3


def test_probe_does_not_change_its_sample_and_reaches_its_stress(packing):
    before = packing.position.copy()
    probe = stress_probe(packing, -0.1 * P, 0.0)
    assert np.array_equal(packing.position, before)
    assert probe.stress_change == pytest.approx([0.1 * P, 0.1 * P, 0.0], abs=1e-3 * P)
    assert probe.strain_change[:2].sum() > 0.0


def test_isotropic_probes_open_contacts_but_hardly_close_any(large_packing):
    """Ten per cent less pressure opens 4-5 % of the contacts; ten per cent more closes next to none."""
    down = stress_probe(large_packing, -0.1 * P, 0.0)
    up = stress_probe(large_packing, 0.1 * P, 0.0)
    contacts = contacts_of(large_packing).count
    assert 0.03 < down.change.lost / contacts < 0.06
    assert up.change.gained / contacts < 0.01
    assert np.hypot(*(fabric_anisotropy(down.after) - fabric_anisotropy(down.before))) < 0.015


def test_moduli_are_below_uniform_strain_by_known_factors(large_packing):
    isotropic, shear = elastic_probes(large_packing)
    moduli = elastic_moduli(large_packing, isotropic, shear)
    weak = measure_weak_contacts(large_packing, isotropic, shear)
    assert moduli.bulk_reduction == pytest.approx(0.89, abs=0.03)
    assert moduli.shear_reduction == pytest.approx(0.70, abs=0.03)
    assert 0.5 < weak.ratio < 0.95 and 0.2 < weak.gradient < 0.8
    assert 0.3 < weak.scatter < 0.6 and 0.2 < weak.scatter_isotropic < 0.5
    # a_n + a_t = 2 s in an elastic probe, so that a_t is the lesser part for kt = kn
    assert 0.7 < weak.tangential_ratio < 0.85


def test_loop_returns_most_lost_contacts(large_packing: Sample):
    run = DemRun(large_packing, RunOptions(tuple(loading_cycles(0.2)[:2])))
    loaded = None
    while not run.finished:
        run.advance()
        if run.segment == 1 and loaded is None:
            loaded = run.sample.copy()
    start, top, end = contacts_of(large_packing), contacts_of(loaded), contacts_of(run.sample)
    lost_top, lost_end = match_contacts(start, top).lost, match_contacts(start, end).lost
    assert np.count_nonzero(lost_top & ~lost_end) > 0.5 * np.count_nonzero(lost_top)
    # what stays open is spread over all directions
    assert np.hypot(*fabric_anisotropy(end)) < 0.35 * np.hypot(*fabric_anisotropy(top))
    assert shear_modulus(loaded) < shear_modulus(large_packing)


def paired(before, after):
    """Rows of contacts that are in both lists, found one by one."""
    place = {key: row for row, key in enumerate(after.key.tolist())}
    rows = [(row, place[key]) for row, key in enumerate(before.key.tolist()) if key in place]
    return np.array(rows).T


def loop_by_hand(sample: Sample, s: float, angle: float) -> tuple[float, float, float]:
    """c_n, k and c_i of one loop, written from their definitions."""
    c2, s2 = np.cos(2 * angle), np.sin(2 * angle)
    rest = settled(sample)
    p = -love_weber_stress(rest)[:2].mean()
    up = stress_probe(rest, 0.0, s * p, angle, limits=ELASTIC_LIMITS).sample
    down = stress_probe(up, 0.0, -s * p, angle, limits=ELASTIC_LIMITS).sample

    def harmonic_along(values, theta, *shapes):
        columns = np.stack([np.ones_like(theta), *shapes], axis=1)
        return np.linalg.solve(columns.T @ columns, columns.T @ values)

    def direction(contacts):
        return np.arctan2(contacts.normal[:, 1], contacts.normal[:, 0])

    grown = []
    for state in (rest, up):
        contacts = contacts_of(state)
        theta = direction(contacts)
        mean, xx, xy = harmonic_along(contacts.normal_force, theta, np.cos(2 * theta), np.sin(2 * theta))
        grown.append((xx * c2 + xy * s2) / mean)
    start, end = contacts_of(rest), contacts_of(down)
    theta = direction(start)
    force = harmonic_along(start.normal_force, theta, np.cos(2 * theta), np.sin(2 * theta))[0]
    old, new = paired(start, end)
    normal = (end.normal_force[new] - start.normal_force[old]) / force
    tangential = (end.tangential_force[new] - start.tangential_force[old]) / force
    turned = 2 * (theta[old] - angle)
    # f_t = -a_t sin 2(theta - axis) f, and the loop leaves a_t = -k s^2/2
    a_t = -np.sum(tangential * np.sin(turned)) / np.sum(np.sin(turned) ** 2)
    weak = (start.normal_force[old] > 0.1 * force) & (start.normal_force[old] < 0.5 * force)
    fit = harmonic_along(normal[weak], turned[weak], np.cos(turned[weak]))
    left = normal[weak] - fit[0] - fit[1] * np.cos(turned[weak])
    return (grown[1] - grown[0]) / s, -2 * a_t / s**2, np.sqrt(np.mean(left**2)) / s**2


def test_loops_give_what_their_contact_lists_say(packing):
    found = measure_slip(packing, 0.1)
    wanted = np.mean([loop_by_hand(packing, 0.1, angle) for angle in (np.pi / 2, np.pi / 4)], axis=0)
    assert [found.force_anisotropy_ratio, found.slip, found.irreversible_scatter] == pytest.approx(wanted, rel=1e-9)


def test_slip_grows_with_the_square_of_the_stress_ratio(large_packing):
    """Thresholds spread evenly above zero: what a loop leaves, over s^2, hardly depends on s.

    Told as exponents of s over a factor of four; the few contacts that a small loop changes leave them uncertain by a
    tenth or two.
    """
    small, large = measure_slip(large_packing, 0.025), measure_slip(large_packing, 0.1)
    exponents = {
        name: 2.0 + np.log(getattr(large, name) / getattr(small, name)) / np.log(4.0)
        for name in ("slip", "irreversible_scatter")
    }
    assert exponents["slip"] == pytest.approx(2.0, abs=0.2)
    assert 1.5 < exponents["irreversible_scatter"] < 2.1
    assert small.slip == pytest.approx(1.0, abs=0.35)
    # all but elastic: the same fraction of the stress ratio, whatever the loop
    assert large.force_anisotropy_ratio == pytest.approx(small.force_anisotropy_ratio, rel=0.12)


def gap_density(sample: Sample, fraction: float) -> float:
    """Density of the gaps that an approach by this fraction of the mean overlap closes, over the mean diameter.

    Those between disks with two contacts or more, over all gaps; a disk loses what a disk without them was for it.
    """
    contacts, pairs = contacts_of(sample), radical_neighbours(sample)
    held = bearing_particles(sample.count, contacts, 2)
    diameter = 2 * sample.radius.mean()
    window = fraction * force_harmonics(contacts).mean / sample.normal_stiffness / diameter
    gap = pairs.gap / diameter
    between = zip(gap, pairs.first, pairs.second)
    counted = sum(0.0 < xi < window and held[i] and held[j] for xi, i, j in between)
    return counted / int(np.sum(gap > 0.0)) / float(window)


def test_material_table_has_what_the_packing_and_its_probes_say(packing):
    table = measure_material(packing)
    assert set(table) == {*MATERIAL_KEYS, *CLOSURE_KEYS}
    assert all(isinstance(value, float) and np.isfinite(value) for value in table.values())
    contacts = contacts_of(packing)
    kn, radius = packing.normal_stiffness, packing.radius
    area = np.linalg.det(packing.cell)
    solid = np.pi * np.sum(radius**2) / area
    z = 2 * contacts.count / packing.count
    assert table["coordination"] == pytest.approx(z, rel=1e-12)
    assert table["solid_fraction"] == pytest.approx(solid, rel=1e-12)
    assert (table["normal_stiffness"], table["stiffness_ratio"], table["neighbours"]) == (1e9, 1.0, 6.0)
    # the straight line on [0, 1/2] with the fraction and the mean of the forces there
    force = contacts.normal_force / contacts.normal_force.mean()
    low = force[force < 0.5]
    fraction, moment = len(low) / len(force), low.sum() / len(force)
    value, _ = np.linalg.solve([[0.5, 0.5**2 / 2], [0.5**2 / 2, 0.5**3 / 3]], [fraction, moment])
    assert table["force_density_at_zero"] == pytest.approx(value, rel=1e-9)
    assert table["gap_density_at_zero"] == pytest.approx(gap_density(packing, 0.2), rel=1e-9)
    # moduli: pressure over change of area, deviator over shear, against uniform strain
    bulk, shear = [], []
    p = -love_weber_stress(packing)[:2].mean()
    for dp in (2e-3 * p, -2e-3 * p):
        probe = stress_probe(packing, dp, 0.0, limits=ELASTIC_LIMITS)
        bulk.append(probe.stress_change[:2].mean() / probe.strain_change[:2].sum())
    for angle in (np.pi / 2, np.pi / 4):
        probe = stress_probe(packing, 0.0, 2e-3 * p, angle, limits=ELASTIC_LIMITS)
        stress = np.array([(probe.stress_change[0] - probe.stress_change[1]) / 2, probe.stress_change[2]])
        strain = np.array([probe.strain_change[0] - probe.strain_change[1], 2 * probe.strain_change[2]])
        shear.append(np.sum(stress * strain) / np.sum(strain**2))
    assert table["bulk_reduction"] == pytest.approx(np.mean(bulk) / (z * solid * kn / (2 * np.pi)), rel=1e-9)
    assert table["shear_reduction"] == pytest.approx(np.mean(shear) / (z * solid * 2 * kn / (4 * np.pi)), rel=1e-9)
    # z - dz/s: the coordination number lost by unloading to 0.2 p, over the fall of the modulus per contact
    unloaded = stress_probe(stress_probe(packing, -0.6 * p, 0.0).sample, -0.2 * p, 0.0).sample
    moduli = elastic_moduli(unloaded, *elastic_probes(unloaded))
    left = 2 * contacts_of(unloaded).count / packing.count
    softening = 1 - moduli.shear / np.mean(shear) * z / left
    assert table["isostatic_coordination"] == pytest.approx(z - (z - left) / softening, rel=1e-6)
    loops = np.mean([loop_by_hand(packing, 0.05, angle) for angle in (np.pi / 2, np.pi / 4)], axis=0)
    named = [table[name] for name in ("force_anisotropy_ratio", "slip", "irreversible_scatter")]
    assert named == pytest.approx(loops, rel=1e-9)


def test_rattlers_are_left_out_where_asked(packing):
    table, other = measure_material(packing), measure_material(packing, rattlers="excluded")
    contacts = contacts_of(packing)
    held = bearing_particles(packing.count, contacts, 2)
    inside = held[contacts.first] & held[contacts.second]
    assert other["coordination"] == pytest.approx(2 * inside.sum() / held.sum(), rel=1e-12)
    assert other["isostatic_coordination"] > table["isostatic_coordination"] > 2.0
    same = set(table) - {"coordination", "isostatic_coordination"}
    assert {name: other[name] for name in same} == {name: table[name] for name in same}
    with pytest.raises(SampleError, match="rattlers is 'some'"):
        measure_material(packing, rattlers="some")
