"""Measured inputs of the point law against made-up contact lists and probes whose answers are known.

The numbers of the definitions (windows, fractions of the mean force, sizes of probes) are written out here once more:
what a packing is said to have depends on them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from dem_samples import contact_list, triangular_lattice, two_disks
from hypothesis import given
from hypothesis import strategies as st
from test_dem_sliding import MEASURED as INPUTS
from test_dem_sliding import REFERENCE, history

from granfabric.dem_ref.inputs import material, probes, unloading, weak_contacts
from granfabric.dem_ref.inputs.material import (
    mean_overlap,
    measure_fabric,
    measure_material,
    measure_material_with_errors,
)
from granfabric.dem_ref.inputs.probes import (
    Probe,
    ProbeError,
    elastic_moduli,
    elastic_probes,
    stress_probe,
    uniform_strain_moduli,
)
from granfabric.dem_ref.inputs.sliding import (
    Hardening,
    PlasticPart,
    fit_dilatancy,
    fit_hardening,
    measure_sliding,
    peak_stress_ratio,
    plastic_part,
    sliding_errors,
)
from granfabric.dem_ref.inputs.unloading import (
    Unloading,
    isostatic_coordination,
    measure_unloading,
    shift_that_loses,
)
from granfabric.dem_ref.inputs.weak_contacts import (
    SlipLoop,
    WeakContacts,
    measure_slip,
    measure_slip_with_errors,
    measure_weak_contacts,
    weak_contact_errors,
)
from granfabric.dem_ref.loading.legs import stress_invariants
from granfabric.dem_ref.loading.path import biaxial_test
from granfabric.dem_ref.loading.run import DemRun, RunOptions, at_stress_ratios
from granfabric.dem_ref.measures.contacts import (
    Contacts,
    bearing_particles,
    contacts_of,
    coordination_number,
    fabric_anisotropy,
    force_harmonics,
    love_weber_stress,
    rattler_minimum,
    sliding_fraction,
    unbalanced_force,
)
from granfabric.dem_ref.measures.distribution import edge_density, edge_errors, force_distribution
from granfabric.dem_ref.measures.events import directional_change, network_change
from granfabric.dem_ref.measures.fields import contact_fields, particle_fields
from granfabric.dem_ref.measures.tessellation import closing_gap_density, gap_distribution, radical_neighbours
from granfabric.dem_ref.measures.uncertainty import Measured
from granfabric.dem_ref.sample.disks import Sample, new_sample

P = 1e5


# forces and gaps


def quantiles(inverse, count=200_000):
    """Data of a given inverse cumulative function, without scatter."""
    return inverse((np.arange(count) + 0.5) / count)


def test_p0_is_the_straight_line_over_half_the_mean_force():
    """Exponentially distributed forces of any mean: what the line gives depends on its window, 0.5."""
    force = 7.0 * quantiles(lambda u: -np.log1p(-u))
    w = 0.5
    value = 4 / w * (1 - np.exp(-w)) - 6 / w**2 * (1 - (1 + w) * np.exp(-w))
    slope = 12 / w**3 * (1 - (1 + w) * np.exp(-w)) - 6 / w**2 * (1 - np.exp(-w))
    found = force_distribution(contact_list(np.linspace(0, np.pi, len(force)), force)).at_zero
    assert found.value == pytest.approx(value, abs=1e-4)  # 0.9705
    assert found.slope == pytest.approx(slope, abs=1e-3)
    # the standard error of the mean of h(x), from its second moment
    inside = force / 7.0 < w
    h = np.where(inside, 4 / w - 6 * force / 7.0 / w**2, 0.0)
    assert found.value_error == pytest.approx(h.std() / np.sqrt(len(force)), rel=1e-3)


def test_forces_by_direction_are_over_the_mean_of_their_sector():
    """Six sectors, the first about the x axis; one of them has forces ten times as large and none below 0.5."""
    centres = np.arange(6) * np.pi / 6
    count = 4000
    theta = np.repeat(centres, count) + np.tile(np.linspace(-0.25, 0.25, count), 6)
    spread = quantiles(lambda u: 2.0 * u, count)  # uniform on [0, 2]: density 1/2
    force = np.concatenate([spread, spread, 10.0 * (0.5 + 0.5 * spread), *[spread] * 3])
    found = force_distribution(contact_list(theta, force))
    np.testing.assert_allclose(found.angle, centres)
    for sector, (fit, density) in enumerate(zip(found.at_zero_by_direction, found.by_direction)):
        narrow = sector == 2
        # over its mean 10: from 0.5 to 1.5 with density 1
        assert fit.value == pytest.approx(0.0 if narrow else 0.5, abs=2e-3)
        assert density.count == count
        assert density.density[density.value < 0.45].mean() == pytest.approx(0.0 if narrow else 0.5, abs=1e-2)
        assert density.density[(density.value > 0.6) & (density.value < 1.4)].mean() == pytest.approx(
            1.0 if narrow else 0.5, abs=1e-2
        )
    assert found.overall.value[0] == pytest.approx(0.05) and found.overall.value[-1] == pytest.approx(3.95)


OVERLAP = 1e-4
GAPS = np.array([0.05, 0.1, 0.15, 0.19, 0.21, 0.3, 0.6, 900.0])
"""Over the mean overlap of the contacts; the last is wider than any window of forces but within 0.1 of a diameter."""


@pytest.fixture(scope="module")
def gapped() -> Sample:
    """A lattice of unit disks with some shrunken ones, each with its own gap to its six neighbours."""
    full = triangular_lattice(12, 12, OVERLAP)
    radius = full.radius.copy()
    # every third disk of every third row: no two of them are neighbours
    chosen = [row * 12 + column for row in (0, 3, 6, 9) for column in (1, 4)]
    radius[chosen] = 0.5 - OVERLAP - GAPS * OVERLAP
    return new_sample(full.position, radius, full.cell, normal_stiffness=2e9)


def test_gaps_of_a_lattice_with_shrunken_disks(gapped):
    diameter = gapped.mean_diameter
    pairs = radical_neighbours(gapped)
    assert np.sort(pairs.gap[pairs.gap > 0]) == pytest.approx(np.repeat(GAPS * OVERLAP, 6), rel=1e-6)
    assert mean_overlap(gapped) == pytest.approx(OVERLAP, rel=1e-9)
    for window, inside in ((0.2 * OVERLAP, 4), (0.25 * OVERLAP, 5), (OVERLAP, 7), (0.1, 8)):
        found = gap_distribution(gapped, pairs, window=window / diameter if window < 0.1 else window)
        width = window / diameter if window < 0.1 else window
        assert found.mean_density == pytest.approx(inside / 8 / width, rel=1e-12)
        assert found.neighbours == 6.0 and found.window == width
        xi = GAPS[:inside] * OVERLAP / diameter
        # maximum likelihood of a power law on (0, w): 1 - b = n/sum(log(w/xi))
        assert found.small_gap_exponent == pytest.approx(1 - inside / np.log(width / xi).sum(), abs=1e-6)
        line = (4 / width - 6 * xi / width**2).sum() / 8
        assert found.at_zero.value == pytest.approx(line, rel=1e-9)
    assert gap_distribution(gapped, pairs).window == 0.1


UNLOADED = Unloading(
    ratio=Measured(0.5, 0.12), tangential_loss=Measured(1.7, 0.31), isostatic=Measured(2.65, 0.24)
)


def made_measurements(
    monkeypatch, moduli, moduli_error, weak, weak_error, loop, loop_error, unloading=UNLOADED
) -> dict:
    """Replace all that probes; what each was asked is kept, by name. Packings count as being at rest."""
    asked = {}
    for name, answer in (
        ("elastic_probes", (["isotropic"], ["shear"])), ("elastic_moduli", moduli), ("moduli_errors", moduli_error),
        ("measure_weak_contacts", weak), ("weak_contact_errors", weak_error),
        ("measure_slip_with_errors", (loop, loop_error)), ("measure_unloading", unloading),
    ):  # fmt: skip
        def made(*arguments, name=name, answer=answer, **options):
            asked[name] = arguments
            return answer

        monkeypatch.setattr(material, name, made)

    def resting(sample):
        asked["at_rest"] = (sample,)
        return sample

    monkeypatch.setattr(material, "at_rest", resting)
    return asked


@pytest.fixture(scope="module")
def leaning() -> Sample:
    """The lattice with one of the shrunken disks, and with seven that lean to the right: a gap on the left of each.

    All but the shrunken one touch their five other neighbours and bear forces. What a disk goes to the right is a gap
    beyond its overlap, to the first order.
    """
    full = triangular_lattice(12, 12, OVERLAP)
    radius, position = full.radius.copy(), full.position.copy()
    chosen = [row * 12 + column for row in (0, 3, 6, 9) for column in (1, 4)]
    radius[chosen[0]] -= 1.1 * OVERLAP
    position[chosen[1:], 0] += (1.0 + GAPS[:7]) * OVERLAP
    return new_sample(position, radius, full.cell, normal_stiffness=2e9)


def test_measured_density_of_gaps_counts_what_a_fifth_of_the_mean_force_would_close(gapped, leaning, monkeypatch):
    """The probes are made up: only the gaps are looked at, those between disks that bear forces."""
    one = SimpleNamespace(bulk_reduction=1.0, shear_reduction=1.0, shear=1.0)
    weak, loop = WeakContacts(*7 * [1.0]), SlipLoop(*3 * [1.0])
    made_measurements(monkeypatch, one, (0.0, 0.0), weak, weak, loop, loop)
    monkeypatch.setattr(material, "ISOTROPIC", 1.0)  # the holes do not lie alike in all directions
    measured = measure_material(leaning)
    overlap = mean_overlap(leaning)
    # four gaps up to 0.19 of it, 0.21 beyond; of all there are seven, and six of the shrunken disk
    assert 0.191 < 0.2 * overlap / OVERLAP < 0.209
    assert measured["gap_density_at_zero"] == pytest.approx(4 / 13 / (0.2 * overlap / leaning.mean_diameter), rel=1e-9)
    measured = measure_material(gapped)
    assert measured["gap_density_at_zero"] == 0.0, "disks that float in their holes"
    assert measured["neighbours"] == 6.0
    # 12 x 12 disks of six contacts, eight of them without
    contacts = 3 * 144 - 6 * 8
    assert measured["coordination"] == pytest.approx(2 * contacts / 144)
    assert measure_material(gapped, "excluded")["coordination"] == pytest.approx(2 * contacts / 136)
    assert measured["solid_fraction"] == pytest.approx(np.pi * (gapped.radius**2).sum() / gapped.area)
    assert measured["normal_stiffness"] == 2e9 and measured["stiffness_ratio"] == 1.0
    # all forces are alike
    assert measured["force_density_at_zero"] == 0.0 and measured["force_density_slope"] == 0.0


DISTINCT = {
    "bulk_reduction": 0.88, "shear_reduction": 0.69, "weak_contact_ratio": 0.75, "weak_contact_ratio_isotropic": 0.5,
    "elastic_scatter": 0.45, "elastic_scatter_isotropic": 0.35, "irreversible_scatter": 4.5, "fluctuation": 0.25,
    "tangential_force_ratio": 0.78, "slip": 1.1, "force_anisotropy_ratio": 1.15, "isostatic_coordination": 2.65,
    "weak_contact_gradient": 0.42, "tangential_force_loss": 1.7,
}  # fmt: skip
DISTINCT_ERRORS = {
    "bulk_reduction": 0.02 * 0.88, "shear_reduction": 0.03 * 0.69, "weak_contact_ratio": 0.11,
    "weak_contact_ratio_isotropic": 0.12, "elastic_scatter": 0.13, "elastic_scatter_isotropic": 0.14,
    "irreversible_scatter": 0.21, "fluctuation": 0.15, "tangential_force_ratio": 0.16, "slip": 0.22,
    "force_anisotropy_ratio": 0.23, "isostatic_coordination": 0.24, "normal_stiffness": 0.0, "stiffness_ratio": 0.0,
    "neighbours": 0.0, "weak_contact_gradient": 0.17, "tangential_force_loss": 0.31,
}  # fmt: skip


def test_every_measured_number_goes_to_its_own_key(packing, monkeypatch):
    """Made-up measurements, all different; the slip delay is the friction over the tangential response.

    Errors of the moduli are relative ones, and so is that of the delay: of the response.
    """
    sample = packing.with_friction(0.3)
    moduli = SimpleNamespace(bulk_reduction=0.88, shear_reduction=0.69, shear=5e8, bulk=9e8)
    weak = WeakContacts(
        ratio=0.75, gradient=0.42, scatter=0.45, scatter_isotropic=0.35, fluctuation=0.25, tangential_ratio=0.78,
        tangential_response=0.6,
    )  # fmt: skip
    weak_error = WeakContacts(
        ratio=0.11, gradient=0.17, scatter=0.13, scatter_isotropic=0.14, fluctuation=0.15, tangential_ratio=0.16,
        tangential_response=0.06,
    )  # fmt: skip
    loop = SlipLoop(force_anisotropy_ratio=1.15, slip=1.1, irreversible_scatter=4.5)
    loop_error = SlipLoop(force_anisotropy_ratio=0.23, slip=0.22, irreversible_scatter=0.21)
    asked = made_measurements(monkeypatch, moduli, (0.02, 0.03), weak, weak_error, loop, loop_error)
    found = measure_material_with_errors(sample)
    assert {name: found[name].value for name in DISTINCT} == DISTINCT
    assert {name: found[name].error for name in DISTINCT_ERRORS} == pytest.approx(DISTINCT_ERRORS)
    assert found["slip_delay"] == Measured(pytest.approx(0.3 / 0.6), pytest.approx(0.3 / 0.6 * 0.1))
    assert measure_material(sample) == {name: entry.value for name, entry in found.items()}
    assert asked["at_rest"] == (sample,), "a sample that moves is held first"
    assert asked["measure_slip_with_errors"][1:] == (0.05,), "the loops go to q/p = 0.05"
    for name in ("measure_weak_contacts", "weak_contact_errors"):
        assert asked[name][1:] == (["isotropic"], ["shear"])
    density, slope = found["force_density_at_zero"], found["force_density_slope"]
    assert asked["measure_unloading"][1:-2] == (density, slope, found["tangential_force_ratio"])
    modulus = Measured(5e8, pytest.approx(0.03 * 5e8))
    assert asked["measure_unloading"][-2:] == (modulus, "included"), "the shear modulus, not the bulk modulus"
    assert asked["moduli_errors"] == (["isotropic"], ["shear"])


def test_errors_of_what_is_counted_are_those_of_blocks(packing, monkeypatch):
    """Coordination, P0, the density of gaps and the fabric without each sixteenth of the packing, computed anew."""
    one = SimpleNamespace(bulk_reduction=1.0, shear_reduction=1.0, shear=1.0)
    weak, loop = WeakContacts(*7 * [1.0]), SlipLoop(*3 * [1.0])
    made_measurements(monkeypatch, one, (0.0, 0.0), weak, weak, loop, loop)
    contacts, pairs = contacts_of(packing), radical_neighbours(packing)

    def cut(points):
        """Four by four equal parts."""
        place = np.floor(4 * np.mod(points @ np.linalg.inv(packing.cell), 1.0)).astype(int)
        return 4 * place[:, 0] + place[:, 1]

    def spread(numbers):
        """Of numbers without one of 16 parts: as of a mean of 16, of which each has left out one."""
        return np.sqrt(15 / 16 * np.sum((np.array(numbers) - np.mean(numbers, axis=0)) ** 2, axis=0))

    disk = cut(packing.position)
    middle = cut(packing.position[contacts.first] + 0.5 * contacts.length[:, None] * contacts.normal)
    count = np.zeros(packing.count)
    for i, j in zip(contacts.first, contacts.second):
        count[i] += 1
        count[j] += 1
    found = measure_material_with_errors(packing)
    assert found["coordination"].error == pytest.approx(spread([count[disk != k].mean() for k in range(16)]))
    bears = bearing_particles(packing.count, contacts, 2)
    count = np.zeros(packing.count)
    for i, j in zip(contacts.first, contacts.second):
        count[[i, j]] += bears[i] and bears[j]
    excluded = measure_material_with_errors(packing, "excluded")["coordination"]
    assert excluded.value == pytest.approx(count[bears].mean()) and bears.mean() < 1.0
    assert excluded.error == pytest.approx(spread([count[bears & (disk != k)].mean() for k in range(16)]))

    force = contacts.normal_force
    without, slopes = [], []
    for k in range(16):
        x = force[middle != k] / force[middle != k].mean()
        without.append(np.where(x < 0.5, 4 / 0.5 - 6 * x / 0.25, 0.0).mean())
        slopes.append(np.where(x < 0.5, 12 * x / 0.125 - 6 / 0.25, 0.0).mean())
    counted = np.sqrt(np.count_nonzero(force < 0.5 * force.mean()) + 1) / len(force)
    assert found["force_density_at_zero"].error == pytest.approx(max(spread(without), 2 / 0.5 * counted))
    # the weight of a force in the slope is at most 6/w^2 and 6/(sqrt 3 w^2) on average: sqrt 12/w^2
    assert found["force_density_slope"].error == pytest.approx(max(spread(slopes), np.sqrt(12) / 0.25 * counted))
    x = force / force.mean()
    slope = np.where(x < 0.5, 12 * x / 0.125 - 6 / 0.25, 0.0).mean()
    assert found["force_density_slope"].value == pytest.approx(slope)

    window = 0.2 * force_harmonics(contacts).mean / packing.normal_stiffness / packing.mean_diameter
    apart = pairs.gap > 0
    small = pairs.gap[apart] / packing.mean_diameter < window
    small &= bears[pairs.first[apart]] & bears[pairs.second[apart]]
    own = disk[pairs.first[apart]]
    counted = np.sqrt(small.sum() + 1) / (window * apart.sum())
    expected = max(spread([small[own != k].mean() / window for k in range(16)]), counted)
    assert found["gap_density_at_zero"].error == pytest.approx(expected)

    e = contacts.double_angle
    fabric = measure_fabric(packing)
    expected = spread([2 * e[middle != k].mean(axis=0) for k in range(16)])
    assert [entry.error for entry in fabric] == pytest.approx(expected.tolist())
    assert [entry.value for entry in fabric] == pytest.approx(fabric_anisotropy(contacts).tolist())
    assert expected[0] != pytest.approx(expected[1], rel=1e-2)


# probes


def made_probe(stress_change, strain_change, before=None, after=None) -> Probe:
    before = contact_list(np.linspace(0, np.pi, 20)) if before is None else before
    after = before if after is None else after
    return Probe(
        None, np.array(stress_change), np.array(strain_change), before, after, network_change(before, after, 10)
    )  # type: ignore[arg-type]


def test_moduli_of_made_up_probes():
    """K = dp/d(eps_v) and G = dq/d(eps_1 - eps_2), engineering shear 2 eps_xy; means over the probes."""
    sample = triangular_lattice(6, 6, 1e-4, stiffness=1e9, ratio=0.5)
    k, g = 3e8, 1.7e8
    contacts = contacts_of(sample)
    isotropic = []
    for dp, fraction in ((200.0, 1.1), (-200.0, 0.9)):  # K and its mean, from both signs
        volume = -dp / (fraction * k)
        # an imperfect probe: the two strains differ, their sum counts
        isotropic.append(made_probe([-dp, -dp, 3.0], [0.7 * volume, 0.3 * volume, 1e-9], contacts))
    shear = [
        made_probe([200.0, -200.0, 0.0], [200.0 / (2 * 0.8 * g), -200.0 / (2 * 0.8 * g), 0.0]),
        made_probe([0.0, 0.0, -200.0], [0.0, 0.0, -200.0 / (2 * 1.2 * g)]),
    ]
    found = elastic_moduli(sample, isotropic, shear)
    assert found.bulk == pytest.approx(k, rel=1e-12) and found.shear == pytest.approx(g, rel=1e-12)
    z, phi, kn = 6.0, sample.solid_fraction, 1e9
    assert found.bulk_uniform == pytest.approx(z * phi * kn / (2 * np.pi), rel=1e-12)
    assert found.shear_uniform == pytest.approx(z * phi * 1.5 * kn / (4 * np.pi), rel=1e-12)
    assert (found.bulk_uniform, found.shear_uniform) == uniform_strain_moduli(sample)
    assert found.bulk_reduction == pytest.approx(k / found.bulk_uniform)
    assert found.shear_reduction == pytest.approx(g / found.shear_uniform)


def test_elastic_probes_are_two_thousandths_of_p_up_down_and_on_two_axes(monkeypatch):
    sample = triangular_lattice(6, 6, 1e-4, stiffness=1e9)
    p = stress_invariants(love_weber_stress(sample))[0]
    asked = []
    monkeypatch.setattr(
        probes, "stress_probe", lambda sample, dp, dq, angle=np.pi / 2, **options: asked.append((dp, dq, angle))
    )
    monkeypatch.setattr(probes, "at_rest", lambda moving: sample)  # whatever moves: its p is not what counts
    isotropic, shear = elastic_probes(triangular_lattice(6, 6, 2e-4, stiffness=1e9))
    assert len(isotropic) == len(shear) == 2
    expected = [(0.002 * p, 0.0, np.pi / 2), (-0.002 * p, 0.0, np.pi / 2)]
    expected += [(0.0, 0.002 * p, np.pi / 2), (0.0, 0.002 * p, np.pi / 4)]
    np.testing.assert_allclose(asked, expected, rtol=1e-12)


def test_a_probe_moves_the_stress_where_it_is_told(packing):
    """p by dp, the deviator by dq with its major compression along the angle; strain follows, contacts are listed."""
    angle = 0.3
    probe = stress_probe(packing, 0.02 * P, 0.03 * P, angle)
    c, s = np.cos(2 * angle), np.sin(2 * angle)
    expected = -P * np.array([0.02 + 0.03 * c, 0.02 - 0.03 * c, 0.03 * s])
    np.testing.assert_allclose(probe.stress_change, expected, atol=5e-4 * P)
    shortening = -(probe.strain_change[0] - probe.strain_change[1]) * c - 2 * probe.strain_change[2] * s
    assert shortening > 0.0 and probe.strain_change[:2].sum() < 0.0
    np.testing.assert_allclose(probe.strain_change, probe.sample.strain - packing.strain, atol=0)
    np.testing.assert_array_equal(probe.before.key, contacts_of(packing).key)
    np.testing.assert_array_equal(probe.after.key, contacts_of(probe.sample).key)
    z = [2 * c.count / packing.count for c in (probe.before, probe.after)]
    assert probe.change.coordination_gained - probe.change.coordination_lost == pytest.approx(z[1] - z[0], abs=1e-12)


def test_isostatic_coordination_is_where_the_reduction_of_the_shear_modulus_vanishes():
    """G = a z (z - z_iso) with z_iso = 2.5, before and after an unloading.

    Its error is what a count of contacts and both moduli move, to the first order.
    """
    z0, z1, counted, small = 4.0, 3.3, 0.02, 1e-6

    def found(z1=z1, before=1.0, after=1.0):
        g0, g1 = 7e7 * z0 * (z0 - 2.5) * before, 7e7 * 3.3 * (3.3 - 2.5) * after
        return isostatic_coordination((z0, z1), counted, (Measured(g0, 0.02 * g0), Measured(g1, 0.03 * g1)))

    assert found().value == pytest.approx(2.5, rel=1e-12)
    moved = [
        (found(z1=z1 + small * counted).value - found().value) / small,
        (found(before=1 + small * 0.02).value - found().value) / small,
        (found(after=1 + small * 0.03).value - found().value) / small,
    ]
    assert found().error == pytest.approx(np.sqrt(np.sum(np.square(moved))), rel=1e-4)
    # contacts are lost, and the modulus per contact does not fall: it tells nothing
    for after in (7e7 * 3.3 * 1.5, 7e7 * 3.3 * 1.6):
        nothing = isostatic_coordination((z0, z1), counted, (Measured(7e7 * 4 * 1.5, 0.0), Measured(after, 0.0)))
        assert np.isnan(nothing.value) and np.isnan(nothing.error)


def test_shear_modulus_is_that_of_a_small_unloading(packing, monkeypatch):
    """At q = 0 a loading by 0.2 % of p; under a deviator an unloading along its own axis."""
    asked = []

    def probe(sample, dp, dq, angle=np.pi / 2, **options):
        asked.append((dp, dq, angle))
        e = np.array([np.cos(2 * angle), -np.cos(2 * angle), np.sin(2 * angle)])
        return SimpleNamespace(sample=sample, stress_change=-dq * e, strain_change=-dq * e / (2 * 4e8))

    monkeypatch.setattr(probes, "stress_probe", probe)
    assert probes.shear_modulus(packing) == pytest.approx(4e8)
    p, _, _ = stress_invariants(love_weber_stress(packing))
    assert asked[-1][:2] == (0.0, pytest.approx(2e-3 * p))
    monkeypatch.setattr(probes, "love_weber_stress", lambda sample: -np.array([1.1e5, 0.9e5, 0.0]))
    assert probes.shear_modulus(packing) == pytest.approx(4e8)
    assert asked[-1] == (0.0, pytest.approx(-200.0), pytest.approx(0.0))


# weak contacts

CHI, BELOW, WEAKEST, STRONGEST = 0.7, 0.4, 0.3, 1.9
FORCES = np.array([0.02, 0.05, 0.08, 0.11, 0.14, 0.16, 0.25, 0.4, 2.0, 2.5, 3.3])
"""Over some unit; five of them are weak, below 0.15 of the mean."""


def response_of(force):
    """Change of a contact's force over the mean change of its direction: a line below 0.15, anything above, mean 1."""
    weak = force < 0.15
    fraction = np.where(weak, CHI + BELOW * force, 1.6)
    fraction[-1] += 1.0 * len(force) - fraction.sum()
    return fraction


def line_through(force, fraction):
    """Slope of the least-squares line through the responses below half of the mean force."""
    x, y = force[force < 0.5], fraction[force < 0.5]
    return np.cov(x, y)[0, 1] / np.var(x, ddof=1)


def grid():
    """Directions, forces (mean 1) and both signs of scatter, every combination once."""
    theta = np.arange(40) * np.pi / 40
    strong = FORCES.copy()
    strong[-3:] += (len(FORCES) - FORCES.sum()) / 3
    at, force, sign = (part.ravel() for part in np.meshgrid(theta, strong, [-1.0, 1.0], indexing="ij"))
    fraction = response_of(strong)[np.searchsorted(strong, force)]
    return at, force, sign, fraction


def weak_probe(unit, mean, vector, scatter, tangential=(0.0, 0.0), strain=(0.0, 0.0, 0.0), stress=(0.0, 0.0, 0.0)):
    """Contacts before and after whose weak ones feel `CHI` of the mean change, with a known scatter.

    `tangential` is a_t of the weak and of the other contacts, along the axis of `vector`. A ring of contacts is lost
    and another is gained: they have no part in it.
    """
    theta, force, sign, fraction = grid()
    e = np.column_stack([np.cos(2 * theta), np.sin(2 * theta)])
    change = fraction * (mean + e @ vector) + scatter * sign
    axis = np.asarray(vector) / (np.hypot(*vector) or 1.0)
    across = axis[0] * e[:, 1] - axis[1] * e[:, 0]
    weak = force < 0.15
    t = -np.where(weak, tangential[0], tangential[1]) * across
    t += np.where(weak, 0.3 * np.hypot(*vector), 0.0) * sign
    ring = np.arange(30) * np.pi / 30
    n = len(theta)
    old, new = np.r_[np.arange(n), n + np.arange(30)], np.r_[np.arange(n), 2 * n + np.arange(30)]
    before = contact_list(np.r_[theta, ring], unit * np.r_[force, np.ones(30)], 0.1 * unit, old)
    after = contact_list(
        np.r_[theta, ring], unit * np.r_[force + change, 5 * np.ones(30)], unit * np.r_[0.1 + t, np.ones(30)], new
    )
    return made_probe(stress, strain, before, after)


def test_weak_contacts_of_made_up_probes():
    """chi, a, c_e, c_p, c_w, c_t and the tangential response are what was put in; two probes of each kind."""
    sample = triangular_lattice(6, 6, 1e-4, stiffness=1e9)
    p = stress_invariants(love_weber_stress(sample))[0]
    unit = 37.0
    scatters_p = (2e-4, 5e-4)
    isotropic = [
        weak_probe(unit, mean, (0.0, 0.0), scatter) for mean, scatter in zip((2e-3, -2e-3), scatters_p)
    ]
    scatters, ratios, strains = (4e-4, 8e-4), (2e-3, 2.2e-3), (3e-6, 4e-6)
    a_t = [(1.5e-3, 2e-3), (1.2e-3, 1.8e-3)]
    shear = [
        weak_probe(unit, 0.0, np.array([-2e-3, 0.0]), scatters[0], a_t[0],
                   (strains[0] / 2, -strains[0] / 2, 0.0), (ratios[0] * p, -ratios[0] * p, 0.0)),
        weak_probe(unit, 0.0, np.array([0.0, 2e-3]), scatters[1], a_t[1],
                   (0.0, 0.0, -strains[1] / 2), (0.0, 0.0, -ratios[1] * p)),
    ]  # fmt: skip
    found = measure_weak_contacts(sample, isotropic, shear)
    assert found.ratio == pytest.approx(CHI, rel=1e-9)
    _, force, _, fraction = grid()
    assert found.gradient == pytest.approx(line_through(force, fraction), rel=1e-9) and found.gradient > 1.0
    assert found.scatter == pytest.approx(np.mean(scatters) / (CHI * 2e-3), rel=1e-9)
    assert found.scatter_isotropic == pytest.approx(np.mean(scatters_p) / (CHI * 2e-3), rel=1e-9)
    # over |dgamma| kn r/f
    expected = [s / (strain * 1e9 * 0.5 / unit) for s, strain in zip(scatters, strains)]
    assert found.fluctuation == pytest.approx(np.mean(expected), rel=1e-9)
    fraction = 5 / len(FORCES)
    expected = [(fraction * weak + (1 - fraction) * other) / s for (weak, other), s in zip(a_t, ratios)]
    assert found.tangential_ratio == pytest.approx(np.mean(expected), rel=1e-9)
    expected = [np.hypot(weak, 0.3 * 2e-3) / s for (weak, _), s in zip(a_t, ratios)]
    assert found.tangential_response == pytest.approx(np.mean(expected), rel=1e-9)


def test_isotropic_and_shear_probes_are_not_exchanged():
    """a and c_p from other contacts than chi: weak ones respond half as much in the isotropic probes."""
    sample = triangular_lattice(6, 6, 1e-4, stiffness=1e9)
    shear = [weak_probe(1.0, 0.0, np.array([2e-3, 0.0]), 1e-4, (1e-3, 1e-3), (1e-6, -1e-6, 0), (-2e2, 2e2, 0))]
    probe = weak_probe(1.0, 2e-3, (0.0, 0.0), 1e-4)
    theta, force, _, _ = grid()
    weak = force < 0.15
    # weak contacts feel less, the strongest make up for it
    after = probe.after.normal_force.copy()
    after[: len(theta)][weak] = force[weak] + 0.5 * (after[: len(theta)][weak] - force[weak])
    missing = (0.5 * 2e-3 * response_of(np.sort(np.unique(force)))[:5]).sum() / 1.0
    strongest = force == force.max()
    after[: len(theta)][strongest] += missing
    halved = replace(probe, after=replace(probe.after, normal_force=after))
    found = measure_weak_contacts(sample, [halved], shear)
    assert found.ratio == pytest.approx(CHI, rel=1e-9)
    halved_fraction = np.where(weak, 0.5, 1.0) * response_of(np.unique(force))[np.searchsorted(np.unique(force), force)]
    assert found.gradient == pytest.approx(line_through(force, halved_fraction), rel=1e-9)
    assert found.scatter_isotropic == pytest.approx(0.5e-4 / (0.5 * CHI * 2e-3), rel=1e-9)
    assert found.scatter == pytest.approx(1e-4 / (CHI * 2e-3), rel=1e-9)


BLOCKS = 16


def block_numbers(mean, size, seed):
    """One number a block about a mean, exactly this mean."""
    away = np.random.default_rng(seed).normal(size=BLOCKS)
    return mean + size * (away - away.mean())


def error_of_blocks(values):
    """Standard error of a mean over blocks."""
    return np.std(values, ddof=1) / np.sqrt(BLOCKS)


def copies_of_grid():
    """The grid once in every block: block, directions, forces, signs."""
    at, force, sign, _ = grid()
    return np.repeat(np.arange(BLOCKS), len(at)), *(np.tile(part, BLOCKS) for part in (at, force, sign))


def of_blocks(sample, contacts):
    """Block of contacts whose keys say where they are; of the others, which have no part in it, any."""
    return contacts.key // len(grid()[0]) % BLOCKS


def probe_of_blocks(chi, scatter, a_t, mean, vector):
    """Contacts of which each block has its own chi, scatter and tangential harmonic; a ring is lost in each."""
    block, at, force, sign = copies_of_grid()
    e = np.column_stack([np.cos(2 * at), np.sin(2 * at)])
    weak = force < 0.15
    fraction = np.where(weak, chi[block] + BELOW * force, 1.6)
    # the strongest of every direction make up for the others of their block, so that the mean is that of all
    strongest = force == force.max()
    feels = [fraction[(block == k) & ~strongest].sum() / strongest[block == k].sum() for k in range(BLOCKS)]
    fraction[strongest] = (len(FORCES) - np.array(feels))[block[strongest]]
    change = fraction * (mean + e @ vector) + np.where(weak, scatter[block], 0.0) * sign
    axis = np.asarray(vector) / (np.hypot(*vector) or 1.0)
    t = -a_t[block] * (axis[0] * e[:, 1] - axis[1] * e[:, 0])
    n = len(at)
    lost, key = np.arange(0, n, 7), np.arange(n)
    # those that are lost lie among the others in the list
    before = contact_list(np.r_[at[lost], at], np.r_[np.ones(len(lost)), force], 0.1, np.r_[10 * n + lost, key])
    after = contact_list(at, force + change, 0.1 + t, key)
    return before, after


def test_errors_of_weak_contacts_are_those_of_blocks(monkeypatch):
    """What is a mean over contacts has the standard error of a mean over 16 blocks; others to the first order."""
    monkeypatch.setattr(weak_contacts, "blocks_of_contacts", of_blocks)
    # the lost ones come first, so that blocks of all contacts are not those of the persisting ones
    sample = triangular_lattice(6, 6, 1e-4, stiffness=1e9)
    p = stress_invariants(love_weber_stress(sample))[0]
    same = np.ones(BLOCKS)
    chi, chi_p = block_numbers(CHI, 0.05, 1), block_numbers(CHI, 0.08, 2)
    a_t, strain, ratio = block_numbers(2e-3, 1e-4, 3), 3e-6, 2e-3

    def shear(chi, scatter, a_t):
        before, after = probe_of_blocks(chi, scatter, a_t, 0.0, np.array([-2e-3, 0.0]))
        return made_probe((ratio * p, -ratio * p, 0.0), (strain / 2, -strain / 2, 0.0), before, after)

    def isotropic(chi, scatter):
        before, after = probe_of_blocks(chi, scatter, 0 * same, 2e-3, np.zeros(2))
        return made_probe((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), before, after)

    quiet = 1e-5 * same
    value = measure_weak_contacts(sample, [isotropic(chi_p, quiet)], [shear(chi, quiet, a_t)])
    error = weak_contact_errors(sample, [isotropic(chi_p, quiet)], [shear(chi, quiet, a_t)])
    assert value.ratio == pytest.approx(CHI)
    assert error.ratio == pytest.approx(error_of_blocks(chi), rel=1e-6)
    # the line below half of the mean force falls by as much as chi_p moves the weakest
    _, force, _, fraction = grid()
    assert value.gradient == pytest.approx(line_through(force, fraction), rel=1e-6)
    tilt = abs(line_through(force, (force < 0.15).astype(float)))
    assert error.gradient == pytest.approx(tilt * error_of_blocks(chi_p), rel=1e-6)
    assert value.tangential_ratio == pytest.approx(2e-3 / ratio, rel=1e-6)
    assert error.tangential_ratio == pytest.approx(error_of_blocks(a_t) / ratio, rel=1e-6)

    # scatter: its square is a mean over blocks
    scatter, scatter_p = block_numbers(4e-4, 1e-5, 4), block_numbers(5e-4, 2e-5, 5)
    made = [isotropic(CHI * same, scatter_p)], [shear(CHI * same, scatter, 2e-3 * same)]
    value, error = measure_weak_contacts(sample, *made), weak_contact_errors(sample, *made)
    first_order = error_of_blocks(scatter**2) / (2 * np.sqrt(np.mean(scatter**2)))
    assert error.scatter == pytest.approx(first_order / (CHI * 2e-3), rel=0.01)
    unit = strain * 1e9 * 0.5 / force_harmonics(made[1][0].before).mean
    assert error.fluctuation == pytest.approx(first_order / unit, rel=0.01)
    first_order = error_of_blocks(scatter_p**2) / (2 * np.sqrt(np.mean(scatter_p**2)))
    assert error.scatter_isotropic == pytest.approx(first_order / (CHI * 2e-3), rel=0.01)
    assert error.ratio < 1e-9 and error.gradient < 1e-9 and error.tangential_ratio < 1e-9

    # two probes of the same contacts: what one has more the other has less, and their mean is sure of it
    pair = [shear(chi, quiet, a_t), shear(2 * CHI - chi, quiet, a_t)]
    assert weak_contact_errors(sample, [isotropic(chi_p, quiet)], pair).ratio < 1e-9
    pair = [shear(chi, quiet, a_t), shear(chi, quiet, a_t)]
    assert weak_contact_errors(sample, [isotropic(chi_p, quiet)], pair).ratio == pytest.approx(
        error_of_blocks(chi), rel=1e-6
    )


def test_one_weak_contact_tells_nothing_and_two_do():
    """No number instead of a line through one point; the harmonic of all contacts is told all the same."""
    sample = triangular_lattice(6, 6, 1e-4, stiffness=1e9)
    theta = np.arange(40) * np.pi / 40
    e = np.column_stack([np.cos(2 * theta), np.sin(2 * theta)])
    for weak in (1, 2):
        force = np.r_[0.05 + 0.01 * np.arange(weak), np.full(40 - weak, 1.0)]
        change, t = 1e-3 * e[:, 0], -1e-3 * e[:, 1]
        probe = made_probe(
            (2.0, -2.0, 0.0), (1e-6, -1e-6, 0.0), contact_list(theta, force), contact_list(theta, force + change, t)
        )
        found = measure_weak_contacts(sample, [probe], [probe])
        told = [found.ratio, found.scatter, found.fluctuation, found.tangential_response, found.gradient]
        assert np.isfinite(told).all() == (weak == 2) and np.isnan(told).all() == (weak == 1)
        assert np.isfinite(found.tangential_ratio)


# what an unloading loses


@pytest.mark.parametrize("slope", [-0.6, 0.0, 0.4])
def test_slope_of_the_force_density_and_its_error(slope):
    """Forces whose density is 0.7 + slope F up to the mean; of independent forces the error is that of their number."""
    x = np.linspace(0.0, 1.0, 200_001)
    below = np.interp(quantiles(lambda u: u, 60_000), 0.7 * x + 0.5 * slope * x * x, x)
    # the rest far from the window, so that the mean is one
    share = 0.7 + 0.5 * slope
    inside = below[quantiles(lambda u: u, 60_000) < share]
    force = np.r_[inside, np.full(60_000 - len(inside), (60_000 - inside.sum()) / (60_000 - len(inside)))]
    found = edge_density(force / force.mean(), 0.5)
    assert found.slope == pytest.approx(slope, abs=1e-3) and found.value == pytest.approx(0.7, abs=1e-3)
    # sixteen times the same: what blocks do not tell, the number of forces does; sqrt(12)/w^2 a force
    block = np.arange(len(force)) % 16
    counted = np.sqrt(12.0) / 0.25 * np.sqrt(np.count_nonzero(force < 0.5) + 1) / len(force)
    assert edge_errors(37.0 * force, block, 0.5)[1] == pytest.approx(counted, rel=0.35)
    # blocks that are not alike: one has no weak forces
    other = np.where(block == 3, 10.0, force)
    without = [edge_density(o / o.mean(), 0.5).slope for o in (other[block != k] for k in range(16))]
    expected = np.sqrt(15 / 16 * np.sum((without - np.mean(without)) ** 2))
    counted = np.sqrt(12.0) / 0.25 * np.sqrt(np.count_nonzero(other < 0.5 * other.mean()) + 1) / len(other)
    assert edge_errors(other, block, 0.5)[1] == pytest.approx(max(expected, counted), rel=1e-9)


@given(p0=st.floats(0.05, 3.0), slope=st.floats(-5.0, 5.0), shift=st.floats(0.0, 2.0))
def test_shift_that_loses_is_the_inverse_of_what_a_shift_loses(p0, slope, shift):
    """Forward by quadrature of the line, up to where a falling one ends."""
    shift = min(shift, -0.99 * p0 / slope) if slope < 0.0 else shift
    node, weight = np.polynomial.legendre.leggauss(4)
    lost = 0.5 * shift * weight @ (p0 + slope * 0.5 * shift * (node + 1.0))
    fraction = 1.0 - np.exp(-lost - lost**2 / 2)
    if fraction < 0.999:
        assert shift_that_loses(fraction, p0, slope) == pytest.approx(shift, rel=1e-6, abs=1e-9)


def test_a_line_that_does_not_hold_as_many_gives_no_shift():
    # a triangle of 0.5^2/(2 0.5) = 0.25
    all_of_it = 1.0 - np.exp(-0.25 - 0.25**2 / 2)
    assert shift_that_loses(all_of_it - 1e-9, 0.5, -0.5) == pytest.approx(1.0, abs=1e-3)
    for fraction, p0, slope in ((all_of_it + 1e-9, 0.5, -0.5), (1.0, 0.5, 0.0), (0.1, 0.0, 1.0), (-0.1, 0.5, 0.0)):
        assert np.isnan(shift_that_loses(fraction, p0, slope))
    assert shift_that_loses(0.0, 0.5, -0.5) == 0.0


MODULUS = Measured(4e8, 4e6)


def test_an_unloading_of_a_packing_counts_what_it_loses(packing, monkeypatch):
    """By 60 % of p: chi_p is the shift of the line that loses as many, kappa how much less a_t the rest calls up.

    On to a fifth of p: z_iso from the shear modulus that is left.
    """
    p = stress_invariants(love_weber_stress(packing))[0]
    unloaded = stress_probe(packing, -0.6 * p, 0.0)
    softened = stress_probe(unloaded.sample, -0.2 * p, 0.0)
    asked = []

    def unload(sample, dp, dq, **options):
        asked.append((sample is packing, dp, dq))
        return unloaded if sample is packing else softened

    one = WeakContacts(*7 * [1.0])
    weak, weak_error = replace(one, tangential_ratio=0.6), replace(one, tangential_ratio=0.03)
    probed = []
    monkeypatch.setattr(unloading, "stress_probe", unload)
    monkeypatch.setattr(unloading, "elastic_probes", lambda sample: (probed.append(sample) or "isotropic", "shear"))
    monkeypatch.setattr(unloading, "measure_weak_contacts", lambda *asked: weak)
    monkeypatch.setattr(unloading, "weak_contact_errors", lambda *asked: weak_error)
    softer = Measured(8e7, 8e7 * 0.05)
    monkeypatch.setattr(unloading, "elastic_moduli", lambda *asked: SimpleNamespace(shear=8e7, bulk=2e8))
    monkeypatch.setattr(unloading, "moduli_errors", lambda *asked: (0.5, 0.05))
    before, after = contacts_of(packing), contacts_of(unloaded.sample)
    lost = len(set(before.key.tolist()) - set(after.key.tolist()))
    assert 0.1 < lost / before.count < 0.4
    far = len(set(before.key.tolist()) - set(contacts_of(softened.sample).key.tolist()))
    for slope in (-0.3, 0.0, 0.3):
        density, c_t = Measured(0.6, 0.04), Measured(0.75, 0.01)
        found = measure_unloading(packing, density, Measured(slope, 0.1), c_t, MODULUS)
        shift = 0.6 * found.ratio.value
        line = 0.6 * shift + slope * shift**2 / 2
        assert np.exp(-line - line**2 / 2) == pytest.approx(1 - lost / before.count, rel=1e-9)
        assert found.ratio.error == pytest.approx(found.ratio.value * np.hypot(1 / np.sqrt(lost), 0.04 / 0.6))
        left = 0.6 * shift
        kappa = np.log(0.75 / 0.6) / (left + left**2 / 2)
        assert found.tangential_loss.value == pytest.approx(kappa)
        of_ratios = np.hypot(0.01 / 0.75, 0.03 / 0.6) / (left + left**2 / 2)
        assert found.tangential_loss.error == pytest.approx(np.hypot(of_ratios, kappa / np.sqrt(lost)))
        z = tuple(2 * contacts.count / packing.count for contacts in (before, contacts_of(softened.sample)))
        counted = 2 * np.sqrt(far) / packing.count
        wanted = isostatic_coordination(z, counted, (MODULUS, softer))
        assert found.isostatic == Measured(pytest.approx(wanted.value), pytest.approx(wanted.error))
    bare = measure_unloading(packing, density, Measured(0.0, 0.1), c_t, MODULUS, "excluded").isostatic
    z = tuple(coordination_number(each).without_rattlers for each in (packing, softened.sample))
    assert bare.value == pytest.approx(isostatic_coordination(z, 0.0, (MODULUS, softer)).value)
    assert asked == 4 * [(True, pytest.approx(-0.6 * p), 0.0), (False, pytest.approx(-0.2 * p), 0.0)]
    assert probed == 4 * [unloaded.sample, softened.sample]
    # c_t that has grown loses nothing, one that is not there tells nothing
    grown = measure_unloading(packing, density, Measured(0.0, 0.1), Measured(0.5, 0.01), MODULUS)
    assert grown.tangential_loss.value == 0.0
    nothing = measure_unloading(packing, density, Measured(0.0, 0.1), Measured(0.0, 0.0), MODULUS).tangential_loss
    assert np.isnan(nothing.value) and np.isnan(nothing.error)
    no_line = measure_unloading(packing, Measured(0.0, 0.1), Measured(0.0, 0.1), c_t, MODULUS)
    assert np.isnan(no_line.ratio.value) and np.isnan(no_line.tangential_loss.value)


def test_disks_that_fall_apart_have_no_isostatic_coordination(packing, monkeypatch):
    """What else the unloading tells is kept."""
    p = stress_invariants(love_weber_stress(packing))[0]
    unloaded = stress_probe(packing, -0.6 * p, 0.0)

    def unload(sample, dp, dq, **options):
        if sample is packing:
            return unloaded
        raise ProbeError("it flows")

    monkeypatch.setattr(unloading, "stress_probe", unload)
    found = measure_unloading(packing, Measured(0.6, 0.04), Measured(0.0, 0.1), Measured(0.75, 0.01), MODULUS)
    assert np.isnan(found.isostatic.value) and 0.3 < found.ratio.value < 1.0 and found.tangential_loss.value > 0.5


def test_gaps_of_rattlers_do_not_close():
    """One disk of a lattice floats in its hole, near all six neighbours; another pair is just apart."""
    full = triangular_lattice(12, 12, OVERLAP)
    radius = full.radius.copy()
    floating, pair = 4 * 12 + 4, 8 * 12 + 4
    radius[floating] -= 1.1 * OVERLAP
    radius[pair] -= 1.1 * OVERLAP
    sample = new_sample(full.position, radius, full.cell, normal_stiffness=2e9)
    pairs, contacts = radical_neighbours(sample), contacts_of(sample)
    bearing = bearing_particles(sample.count, contacts, 2)
    assert not bearing[floating] and not bearing[pair] and np.count_nonzero(~bearing) == 2
    window = OVERLAP
    every = gap_distribution(sample, pairs, window).mean_density
    assert every == pytest.approx(1.0 / window)
    assert closing_gap_density(sample, pairs, window, bearing).value == 0.0
    # of a disk that bears forces all six count
    bearing[pair] = True
    found = closing_gap_density(sample, pairs, window, bearing)
    assert found.value == pytest.approx(6 / 12 / window)
    assert found.error >= np.sqrt(7.0) / (window * 12)


C_N, SLIP, C_I = 1.15, 1.3, 5.0


@dataclass
class MadeUp:
    """A sample whose contacts follow the law that loops are measured for: a state of a stress ratio vector.

    Blocks may have their own numbers, and so may directions of loading.
    """

    ratio: np.ndarray
    slipped: np.ndarray
    largest: float = 0.0
    c_n: np.ndarray | float = C_N
    slip: np.ndarray | float = SLIP
    c_i: np.ndarray | float = C_I

    @property
    def stress(self):
        return -P * np.array([1.0 + self.ratio[0], 1.0 - self.ratio[0], self.ratio[1]])

    @property
    def contacts(self):
        """a_n = c_n s; a_t = -k s^2/2 left by a loop; residual changes of the normal forces of middling contacts."""
        block, at, force, sign = copies_of_grid()
        c_n, slip, c_i = (np.broadcast_to(number, BLOCKS)[block] for number in (self.c_n, self.slip, self.c_i))
        e = np.column_stack([np.cos(2 * at), np.sin(2 * at)])
        middling = (force > 0.1) & (force < 0.5)
        # what a loop leaves besides, beyond the forces that are looked at, must not count; a shift and a harmonic of
        # the middling contacts must not either
        scatter = np.where(middling, c_i, 40.0) * self.largest**2
        shift = np.where(middling, 0.2 * self.largest + 0.3 * (e @ self.slipped), 0.0)
        normal = force * (1.0 + c_n * (e @ self.ratio)) + scatter * sign + shift
        left = -0.5 * np.hypot(*self.slipped) * self.slipped
        tangential = -slip * (left[0] * e[:, 1] - left[1] * e[:, 0])
        return contact_list(at, 11.0 * normal, 11.0 * tangential)


def made_up_probe(sample, dp, dq, angle=np.pi / 2, **options):
    step = dq / P * np.array([np.cos(2 * angle), np.sin(2 * angle)])
    after = sample.ratio + step
    returned = np.hypot(*after) < 1e-12
    slipped = sample.ratio if returned else sample.slipped
    largest = max(sample.largest, float(np.hypot(*sample.ratio))) if returned else sample.largest
    return SimpleNamespace(
        sample=replace(sample, ratio=after, slipped=slipped, largest=largest), before=sample.contacts
    )


@pytest.fixture
def loops(monkeypatch):
    """Loops of made-up samples; a sample that moves is held first, as is recorded."""
    held = []
    monkeypatch.setattr(weak_contacts, "settled", lambda sample, *rest, **options: (held.append(sample), sample)[1])
    monkeypatch.setattr(weak_contacts, "stress_probe", made_up_probe)
    monkeypatch.setattr(weak_contacts, "contacts_of", lambda sample: sample.contacts)
    monkeypatch.setattr(weak_contacts, "love_weber_stress", lambda sample, *rest: sample.stress)
    monkeypatch.setattr(weak_contacts, "blocks_of_contacts", lambda sample, contacts: of_blocks(sample, contacts))
    return held


def test_loops_of_a_made_up_sample(loops):
    """c_n at the top, k and c_i from what a loop leaves, over s^2; the loop's size does not matter."""
    start = MadeUp(np.zeros(2), np.zeros(2))
    for size in (0.05, 0.02):
        found = measure_slip(start, size)  # type: ignore[arg-type]
        assert found.force_anisotropy_ratio == pytest.approx(C_N, rel=1e-9)
        assert found.slip == pytest.approx(SLIP, rel=1e-6)
        assert found.irreversible_scatter == pytest.approx(C_I, rel=1e-6)
    default = measure_slip(start)  # type: ignore[arg-type]
    assert default.slip == pytest.approx(SLIP, rel=1e-6)
    assert loops == [start] * 3
    value, error = measure_slip_with_errors(start)  # type: ignore[arg-type]
    assert value == default and len(loops) == 4
    # alike in all blocks and directions
    assert (error.force_anisotropy_ratio, error.slip, error.irreversible_scatter) == pytest.approx((0, 0, 0), abs=1e-7)


def test_errors_of_loops_are_those_of_blocks(loops):
    """c_n and k are means over blocks; the square of c_i is one, so that its error is known to the first order."""
    c_n, slip, c_i = block_numbers(C_N, 0.1, 6), block_numbers(SLIP, 0.2, 7), block_numbers(C_I, 0.1, 8)
    start = MadeUp(np.zeros(2), np.zeros(2), c_n=c_n, slip=slip, c_i=c_i)
    value, error = measure_slip_with_errors(start)  # type: ignore[arg-type]
    assert value == measure_slip(start)  # type: ignore[arg-type]
    assert (value.force_anisotropy_ratio, value.slip) == (pytest.approx(C_N), pytest.approx(SLIP))
    assert error.force_anisotropy_ratio == pytest.approx(error_of_blocks(c_n), rel=1e-6)
    assert error.slip == pytest.approx(error_of_blocks(slip), rel=1e-6)
    expected = error_of_blocks(c_i**2) / (2 * np.sqrt(np.mean(c_i**2)))
    assert error.irreversible_scatter == pytest.approx(expected, rel=0.02)


def test_errors_of_loops_are_at_least_what_directions_differ_by(loops, monkeypatch):
    """Four loops, two of them of the other sign; the value is the mean of the first two, and so is its error.

    A sample that does not carry the other sign has the error of its blocks.
    """
    of_angle = {90.0: 1.0, 45.0: 1.4, 180.0: 1.1, 135.0: 1.3}
    carried = set(of_angle)

    def probe(sample, dp, dq, angle=np.pi / 2, **options):
        degrees = round(float(np.degrees(angle)), 6)
        if degrees not in carried:
            raise ProbeError("it does not settle")
        factor = of_angle[degrees]
        return made_up_probe(replace(sample, c_n=factor, slip=2 * slip * factor, c_i=3 * factor), dp, dq, angle)

    monkeypatch.setattr(weak_contacts, "stress_probe", probe)
    slip = block_numbers(1.0, 0.1, 9)
    start = MadeUp(np.zeros(2), np.zeros(2), slip=2 * slip)
    value, error = measure_slip_with_errors(start)  # type: ignore[arg-type]
    assert value.force_anisotropy_ratio == pytest.approx(1.2) and value.slip == pytest.approx(2.4, rel=1e-6)
    apart = np.std([1.0, 1.4, 1.1, 1.3], ddof=1) / np.sqrt(2)
    assert error.force_anisotropy_ratio == pytest.approx(apart, rel=1e-6)
    assert error.slip == pytest.approx(2 * apart, rel=1e-6)
    assert error.irreversible_scatter == pytest.approx(3 * apart, rel=1e-6)
    carried -= {135.0}
    value, error = measure_slip_with_errors(start)  # type: ignore[arg-type]
    assert value.slip == pytest.approx(2.4, rel=1e-6)
    assert error.slip == pytest.approx(2.4 * error_of_blocks(slip), rel=1e-6)
    assert error.force_anisotropy_ratio == pytest.approx(0.0, abs=1e-9)


# sliding


def test_peak_is_the_largest_mean_over_a_tenth_of_the_strain():
    """A tent 0.4 - 0.2 |x - 1/2| over strains up to 3: its best tenth has the mean 0.4 - 0.2/40."""
    x = np.linspace(0.0, 1.0, 4001)
    ratio = 0.4 - 0.2 * np.abs(x - 0.5)
    part = PlasticPart(ratio, 3.0 * x, 3.0 * x, x, x)
    assert peak_stress_ratio(part) == pytest.approx(0.4 - 0.2 / 40, abs=2e-4)


def test_dilatancy_compares_before_and_after_nine_tenths_of_the_peak():
    """Rates of dilation that are constant on either side of q/p = 0.9 M_peak, and nothing else."""
    ratio = np.concatenate([np.linspace(0.0, 0.4, 4001), np.full(4000, 0.4)])
    gamma = np.arange(8001.0) * 1e-6
    after = ratio >= 0.36
    rate = np.where(after, 0.25, -0.05)
    # the rate holds over the interval that follows a record
    dilation = np.concatenate([[0.0], np.cumsum(rate[:-1] * 1e-6)])
    means = [ratio[~after].mean(), np.trapezoid(ratio[after], gamma[after]) / np.ptp(gamma[after])]
    slope, constant = fit_dilatancy(PlasticPart(ratio, gamma, gamma, dilation, dilation), 0.4)
    expected = 0.3 / (means[1] - means[0])
    assert slope == pytest.approx(expected, rel=2e-3)
    assert constant == pytest.approx(means[1] - 0.25 / expected, rel=2e-3)


def test_hardening_is_fitted_from_a_twentieth_to_nine_tenths_of_the_peak():
    """Points off the curve outside these levels change nothing; within them they do, and are told as misfit."""
    peak, reference = 0.4, 5e-5
    h = np.concatenate([np.linspace(0, 0.99, 4000)])
    gamma = reference * h**2 / (1 - h)
    shear = gamma + h * 4e-5
    ratio = peak * h

    def fitted(low, high):
        """A kink of the plastic strain between two levels, kept rising."""
        bent = gamma * np.where((ratio > low) & (ratio < high), 1.3, 1.0)
        return fit_hardening(PlasticPart(ratio, shear - gamma + bent, bent, h, h), peak)

    straight = fitted(1.0, 1.0)
    assert straight.reference == pytest.approx(reference, rel=1e-3) and straight.misfit < 2e-3
    assert (straight.peak, straight.exponent, straight.first) == (peak, 2.0, 0.0)
    for low, high in ((0.0, 0.049), (0.361, 0.4)):
        assert fitted(low, high).reference == pytest.approx(straight.reference, rel=2e-3)
    for low, high in ((0.051, 0.08), (0.33, 0.355)):
        assert abs(fitted(low, high).reference / straight.reference - 1) > 5e-3 or fitted(low, high).misfit > 0.02


def made_history(rattlers=0.15, counted=0.0):
    """Loading at constant p with falling coordination, elastic strain only; G goes by z + `counted`."""
    ratio = np.linspace(0.0, 0.3, 3001)
    z = 4.0 - 1.0 * ratio
    unit = 0.85 * 1e9 / (4 * np.pi)
    of = z + counted
    g = unit * 1.5 * 4.0 * 0.7 * of / of[0] * (of - 2.6) / (of[0] - 2.6)
    strain = np.concatenate([[0.0], np.cumsum(0.5 * (1 / g[1:] + 1 / g[:-1]) * np.diff(ratio * P))])
    zero = np.zeros_like(ratio)
    return {
        "strain_xx": 0.5 * strain, "strain_yy": -0.5 * strain, "strain_xy": zero, "stress_xx": -P * (1 - ratio),
        "stress_yy": -P * (1 + ratio), "stress_xy": zero, "p": zero + P, "q": P * ratio, "coordination": z,
        "coordination_without_rattlers": z + rattlers,
    }  # fmt: skip


MEASURED = {
    "coordination": 4.0, "solid_fraction": 0.85, "normal_stiffness": 1e9, "stiffness_ratio": 0.5, "bulk_reduction": 0.9,
    "shear_reduction": 0.7, "isostatic_coordination": 2.6,
}  # fmt: skip


def test_elastic_strain_is_taken_off_to_nothing_in_either_counting():
    """kt/kn = 0.5; the shear modulus falls with z (z - z_iso), of either counting of rattlers."""
    part = plastic_part(made_history(), MEASURED)
    assert np.abs(part.plastic_shear).max() < 1e-6 * part.shear.max()
    other = plastic_part(made_history(counted=0.15), MEASURED, "excluded")
    assert np.abs(other.plastic_shear).max() < 1e-6 * part.shear.max()
    # the wrong counting leaves something
    wrong = plastic_part(made_history(0.5), MEASURED, "excluded")
    assert np.abs(wrong.plastic_shear).max() > 1e-3 * part.shear.max()


def test_a_soft_network_keeps_a_fifth_of_its_shear_modulus():
    made = made_history()
    made["coordination"] = np.full(3001, 2.0)
    made["coordination"][0] = 4.0
    part = plastic_part(made, MEASURED)
    g = 0.85 * 1e9 / (4 * np.pi) * 1.5 * 4.0 * 0.7 * 0.2
    elastic = part.shear[-1] - part.plastic_shear[-1]
    assert elastic == pytest.approx(0.3 * P / g, rel=1e-3)


def test_volume_follows_the_bulk_modulus_of_the_present_network():
    """Isotropic loading beside: dv = dp/K with K = 2 z phi kn/(4 pi) times its reduction."""
    made = made_history()
    p = np.linspace(P, 2 * P, 3001)
    made["p"] = p
    part = plastic_part(made, MEASURED)
    k = 2 * 0.85 * 1e9 / (4 * np.pi) * made["coordination"] * 0.9
    expected = np.trapezoid(1 / k, p)
    assert part.plastic_dilation[-1] - part.dilation[-1] == pytest.approx(expected, rel=1e-9)


def test_sliding_wants_fifty_reference_strains():
    """The whole strain counts, over the reference strain that is fitted."""
    refused = []
    for last in np.linspace(30, 60, 13) * REFERENCE:
        made = history(last=last)
        whole = plastic_part(made, INPUTS)
        reached = whole.shear[-1] / fit_hardening(whole, peak_stress_ratio(whole)).reference
        if abs(reached - 50.0) < 0.5:
            continue
        try:
            measure_sliding(made, INPUTS)
        except ValueError as error:
            assert "50 times the reference strain" in str(error)
            refused.append(True)
        else:
            refused.append(False)
        assert refused[-1] == (reached < 50.0)
    assert True in refused and False in refused


def test_error_of_the_peak_is_the_scatter_of_the_plateau():
    """Steps as wide as the window of the peak, from 0.9 of it on; what is straight or chosen has no error."""
    steps = np.array([0.40, 0.38, 0.41, 0.39, 0.37, 0.42, 0.40, 0.38])
    # the rise to below nine tenths of the peak, eight whole windows of ten, and less than one that does not count
    x = np.r_[np.linspace(0.0, 0.14, 5601)[:-1], 0.14 + 0.8 * np.arange(3200) / 3200, np.linspace(0.94, 1.0, 241)]
    ratio = np.r_[0.35 * np.linspace(0.0, 1.0, 5601)[:-1] ** 4, np.repeat(steps, 400), np.full(241, 0.41)]
    # as much dilation as goes with a line of slope 1.2 from q/p = 0.2 on
    rate = np.r_[0.0, 0.5 * (ratio[1:] + ratio[:-1]) * np.diff(x)]
    dilation = 1.2 * (np.cumsum(rate) - 0.2 * x)
    part = PlasticPart(ratio, x, x, dilation, dilation)
    peak = peak_stress_ratio(part)
    assert peak == pytest.approx(0.42, abs=2e-3)
    found = sliding_errors(part, Hardening(peak, 0.0, 0.01, 2.0, 0.0))
    assert found["peak_stress_ratio"] == pytest.approx(np.std(steps, ddof=1), rel=0.02)
    assert found["dilatancy"] < 0.01 and found["constant_volume_stress_ratio"] < 0.005
    assert found["first_yield_stress_ratio"] == found["hardening_exponent"] == 0.0


# events and fields


def test_gained_lost_and_turned_contacts_of_a_small_network():
    """Four contacts of a square network, one lost, two gained, one turned; written out."""
    before = contact_list([0.0, 0.5 * np.pi, 0.0, 0.25 * np.pi], key=[1, 2, 3, 4])
    after = contact_list([0.0, 0.5 * np.pi, 0.1, 0.75 * np.pi, 0.0], key=[1, 2, 4, 8, 9])
    change = network_change(before, after, 4)
    assert (change.gained, change.lost, change.persisting) == (2, 1, 3)
    assert change.coordination_gained == 2 * 2 / 4 and change.coordination_lost == 2 * 1 / 4
    a = np.array([2 * (1 - 1 + 1 + 0) / 4, 2 * 1 / 4])
    np.testing.assert_allclose(fabric_anisotropy(before), a, atol=1e-15)
    gained = (2 * np.array([0.0, -1.0]) - a) + (2 * np.array([1.0, 0.0]) - a)
    np.testing.assert_allclose(change.fabric_gained, gained / 5, atol=1e-15)
    np.testing.assert_allclose(change.fabric_lost, -(2 * np.array([1.0, 0.0]) - a) / 5, atol=1e-15)
    turned = 2 * (np.array([np.cos(0.2), np.sin(0.2)]) - np.array([0.0, 1.0]))
    np.testing.assert_allclose(change.fabric_persisting, turned / 5, atol=1e-15)


def test_fractions_of_lost_contacts_are_of_those_present_at_first():
    """Twelve bins unless told otherwise; gained ones are counted where they are, over what was there."""
    theta = np.concatenate([np.zeros(4), np.full(8, np.pi / 2)])
    before = contact_list(theta)
    after = contact_list([0.0, np.pi / 2, np.pi / 2, np.pi / 2], key=[0, 4, 5, 100])
    found = directional_change(before, after)
    np.testing.assert_allclose(found.angle, np.arange(12) * np.pi / 12)
    assert found.present.tolist() == [4, 0, 0, 0, 0, 0, 8, 0, 0, 0, 0, 0]
    assert found.lost[[0, 6]].tolist() == [3 / 4, 6 / 8] and found.gained[[0, 6]].tolist() == [0.0, 1 / 8]


def test_fields_of_two_disks_that_press_and_slide():
    """Force 1e-3 kn r-independent; pressure f r/(2 pi r^2); the line goes from centre to centre."""
    sample = two_disks(-1e-3, stiffness=4.0, friction=0.5, radius=0.5)
    sample.pairs.tangential[:] = 2e-4
    particles, contacts = particle_fields(sample), contact_fields(sample)
    force = 4.0 * 1e-3
    np.testing.assert_allclose(contacts["normal_force"], [force], rtol=1e-9)
    np.testing.assert_allclose(contacts["tangential_force"], [-4.0 * 2e-4], rtol=1e-9)
    np.testing.assert_allclose(contacts["mobilisation"], [4.0 * 2e-4 / (0.5 * force)], rtol=1e-9)
    np.testing.assert_allclose(contacts["start"], sample.position[:1])
    np.testing.assert_allclose(contacts["end"], sample.position[1:])
    np.testing.assert_allclose(particles["pressure"], np.full(2, force * 0.5 / (2 * np.pi * 0.25)), rtol=1e-9)
    assert particles["contacts"].tolist() == [1, 1] and particles["bears_force"].tolist() == [0, 0]
    np.testing.assert_array_equal(particles["radius"], [0.5, 0.5])
    lattice = triangular_lattice(4, 4, 1e-3)
    assert particle_fields(lattice)["bears_force"].tolist() == [1] * 16


def test_unbalanced_force_of_two_disks():
    """Each carries the whole force: the resultant over the mean contact force is 1."""
    assert unbalanced_force(two_disks(-1e-3)) == pytest.approx(1.0)
    assert unbalanced_force(two_disks(1e-3)) == 0.0
    assert unbalanced_force(triangular_lattice(4, 4, 1e-3)) < 1e-9


# history of a run


@pytest.fixture(scope="module")
def followed(packing):
    """A run along an oblique axis, and its sample at every record."""
    options = RunOptions(tuple(replace(part, angle=0.4) for part in biaxial_test(stress_ratio=0.1)))
    run, samples = DemRun(packing, options), [packing.copy()]
    run.execute(on_record=lambda state: samples.append(state.sample.copy()))
    return run.history(), samples


def test_columns_of_a_history_are_measures_of_the_samples(followed):
    """Every column but the energies, computed from the samples themselves."""
    recorded, samples = followed
    assert len(samples) == len(recorded["step"]) > 5
    axis = np.array([np.cos(0.8), np.sin(0.8)])
    first = force_harmonics(contacts_of(samples[0])).mean
    gained = lost = 0.0
    parts = np.zeros((3, 2))
    old = contacts_of(samples[0])
    for row, sample in enumerate(samples):
        contacts = contacts_of(sample)
        change = network_change(old, contacts, sample.count)
        gained, lost = gained + change.coordination_gained, lost + change.coordination_lost
        parts = parts + [change.fabric_gained, change.fabric_lost, change.fabric_persisting]
        old = contacts
        stress, z, forces = love_weber_stress(sample), coordination_number(sample), force_harmonics(contacts)
        fabric = fabric_anisotropy(contacts)
        p, q, _ = stress_invariants(stress)
        expected = {
            "step": row, "strain_xx": sample.strain[0], "strain_yy": sample.strain[1],
            "strain_xy": 2 * sample.strain[2], "stress_xx": stress[0], "stress_yy": stress[1], "stress_xy": stress[2],
            "p": p, "q": q, "coordination": z.all_particles, "coordination_without_rattlers": z.without_rattlers,
            "fabric_anisotropy": fabric @ axis, "normal_force_anisotropy": forces.normal @ axis,
            "tangential_force_anisotropy": forces.tangential @ axis, "mean_normal_force": forces.mean / first,
            "sliding_fraction": sliding_fraction(sample, contacts), "coordination_gained": gained,
            "coordination_lost": lost, "fabric_gained": parts[0] @ axis, "fabric_lost": parts[1] @ axis,
            "fabric_persisting": parts[2] @ axis, "fabric_xx": fabric[0], "fabric_xy": fabric[1],
            "normal_force_xx": forces.normal[0], "normal_force_xy": forces.normal[1],
            "tangential_force_xx": forces.tangential[0], "tangential_force_xy": forces.tangential[1],
            "void_ratio": sample.area / (np.pi * (sample.radius**2).sum()) - 1.0,
        }  # fmt: skip
        for name, value in expected.items():
            assert recorded[name][row] == pytest.approx(value, rel=1e-9, abs=1e-12), (name, row)
    # the run is one of loading: contacts open across the axis, forces grow along it
    assert lost > 0 and parts[1] @ axis > 0 and recorded["normal_force_anisotropy"][-1] > 0.05
    assert recorded["strain_xy"][-1] * axis[1] < 0.0


def test_rows_at_stress_ratios_are_interpolated_where_they_are_first_passed():
    made = {"p": np.full(5, 2.0), "q": np.array([0.0, 0.2, 0.6, 0.4, 0.8]), "z": np.array([4.0, 3.9, 3.5, 3.6, 3.0])}
    found = at_stress_ratios(made, [0.0, 0.05, 0.2, 0.35, 0.5])
    np.testing.assert_allclose(found["z"], [4.0, 3.95, 3.7, 3.15, np.nan])


def test_a_line_of_the_edge_density_has_both_errors():
    """Of two contacts a straight line says next to nothing; of one, nothing."""
    one = edge_density(np.array([0.1]), 0.5)
    assert (one.value, one.slope) == (0.0, 0.0) and one.value_error == np.inf
    data = np.array([0.1, 0.3, 0.6, 0.9])
    w = 0.5
    value = np.array([4 / w - 6 * 0.1 / w**2, 4 / w - 6 * 0.3 / w**2, 0, 0])
    slope = np.array([12 * 0.1 / w**3 - 6 / w**2, 12 * 0.3 / w**3 - 6 / w**2, 0, 0])
    found = edge_density(data, w)
    assert (found.value, found.slope) == (pytest.approx(value.mean()), pytest.approx(slope.mean()))
    assert found.value_error == pytest.approx(value.std() / 2) and found.slope_error == pytest.approx(slope.std() / 2)


def test_contacts_slide_within_half_a_per_cent_of_their_limit(packing):
    """Friction 0.5: tangential forces of 0.996 of the limit slide, of 0.994 do not; without friction none does."""
    force = np.ones(400)
    fractions = np.tile([0.996, -0.996, 0.994, 0.5], 100)
    contacts = contact_list(np.zeros(400), force, 0.5 * fractions)
    assert sliding_fraction(packing, contacts) == 0.5
    assert sliding_fraction(packing.with_friction(0.0), contacts) == 0.0


def test_disks_are_held_by_two_contacts_with_friction_and_three_without():
    """A ring of disks, two contacts each."""
    lattice = triangular_lattice(4, 4, 1e-3)
    assert rattler_minimum(lattice) == 2 and rattler_minimum(lattice.with_friction(0.0)) == 3
    made = contact_list(np.zeros(16))
    ring = Contacts(np.arange(16), (np.arange(16) + 1) % 16, made.image, made.normal, made.length, made.normal_force,
                    made.tangential_force, made.key)  # fmt: skip
    z = coordination_number(lattice, ring)
    assert (z.all_particles, z.without_rattlers, z.rattler_fraction) == (2.0, 2.0, 0.0)
    z = coordination_number(lattice.with_friction(0.0), ring)
    assert (z.all_particles, z.without_rattlers, z.rattler_fraction) == (2.0, 0.0, 1.0)
