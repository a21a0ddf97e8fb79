"""Measures against their definitions, identities and synthetic data of known answer."""

from __future__ import annotations

import numpy as np
import pytest
from dem_samples import triangular_lattice
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from granfabric.dem_ref.measures.contacts import (
    Contacts,
    bearing_particles,
    contacts_of,
    coordination_number,
    fabric_anisotropy,
    fabric_tensor,
    force_harmonics,
    love_weber_stress,
    sliding_fraction,
)
from granfabric.dem_ref.measures.distribution import edge_density, force_distribution, histogram
from granfabric.dem_ref.measures.events import directional_change, match_contacts, network_change
from granfabric.dem_ref.measures.fields import contact_fields, particle_fields
from granfabric.dem_ref.measures.tessellation import gap_distribution, radical_neighbours
from granfabric.dem_ref.sample.disks import SampleError, new_sample


def synthetic(theta, normal_force=None, tangential_force=None, key=None) -> Contacts:
    theta = np.asarray(theta, dtype=float)
    m = len(theta)
    force = np.ones(m) if normal_force is None else np.asarray(normal_force)
    tangential = np.zeros(m) if tangential_force is None else np.asarray(tangential_force)
    normal = np.column_stack([np.cos(theta), np.sin(theta)])
    identity = np.arange(m) if key is None else np.asarray(key)
    return Contacts(identity, identity + 1, np.zeros((m, 2), np.int8), normal, np.ones(m), force, tangential, identity)


def by_density(a, count=20_000):
    """Angles whose density is (1 + a . e)/(2 pi), by inverting the cumulative function."""
    grid = np.linspace(0.0, 2 * np.pi, 200_001)
    cumulative = grid + 0.5 * (a[0] * np.sin(2 * grid) + a[1] * (1 - np.cos(2 * grid)))
    return np.interp((np.arange(count) + 0.5) / count * 2 * np.pi, cumulative, grid)


def test_stress_is_the_sum_over_contacts_written_out(packing):
    total = np.zeros((2, 2))
    c = contacts_of(packing)
    for k in range(c.count):
        n = c.normal[k]
        t = np.array([-n[1], n[0]])
        total += np.outer(c.normal_force[k] * n + c.tangential_force[k] * t, c.length[k] * n)
    expected = -total / packing.area
    assert love_weber_stress(packing) == pytest.approx([expected[0, 0], expected[1, 1], expected[0, 1]], abs=1e-6 * 1e5)


@pytest.mark.parametrize("a", [(0.3, 0.0), (-0.2, 0.5), (0.0, 0.0)])
def test_fabric_of_a_known_density(a):
    contacts = synthetic(by_density(a))
    assert fabric_anisotropy(contacts) == pytest.approx(a, abs=1e-3)
    f = fabric_tensor(contacts)
    assert np.trace(f) == pytest.approx(1.0, abs=1e-12)
    eigen = np.linalg.eigvalsh(f)
    assert 2 * (eigen[1] - eigen[0]) == pytest.approx(np.hypot(*a), abs=1e-3)


def test_force_harmonics_recover_known_ones():
    theta = by_density((0.3, -0.1))
    e = np.column_stack([np.cos(2 * theta), np.sin(2 * theta)])
    f, an, at = 7.0, np.array([0.4, -0.2]), np.array([0.1, 0.25])
    cross = at[0] * e[:, 1] - at[1] * e[:, 0]
    h = force_harmonics(synthetic(theta, f * (1 + e @ an), -f * cross))
    assert h.mean == pytest.approx(f, rel=1e-12)
    assert h.normal == pytest.approx(an, abs=1e-12)
    assert h.tangential == pytest.approx(at, abs=1e-12)
    # mean over contacts differs from the mean over directions by half of a_c . a_n
    assert h.contact_mean == pytest.approx(f * (1 + 0.5 * (0.3 * 0.4 + 0.1 * 0.2)), rel=1e-3)


def test_stress_force_fabric_relation_of_synthetic_contacts():
    """s = (a_c + a_n + a_t)/2 to first order, the sign of a_t included."""
    a = np.array([0.02, 0.01])
    theta = by_density(a)
    e = np.column_stack([np.cos(2 * theta), np.sin(2 * theta)])
    an, at = np.array([0.03, -0.01]), np.array([0.01, 0.02])
    c = synthetic(theta, 1 + e @ an, -(at[0] * e[:, 1] - at[1] * e[:, 0]))
    nx, ny = c.normal.T
    fx, fy = c.normal_force * nx - c.tangential_force * ny, c.normal_force * ny + c.tangential_force * nx
    sxx, syy, sxy = fx @ nx, fy @ ny, 0.5 * (fx @ ny + fy @ nx)
    ratio = np.array([(sxx - syy) / 2, sxy]) / ((sxx + syy) / 2)
    assert ratio == pytest.approx((a + an + at) / 2, abs=1e-3)


def test_rattlers_are_removed_repeatedly():
    """A triangle with a tail of two particles, and one loose particle."""
    pairs = np.array([[0, 1], [1, 2], [0, 2], [2, 3], [3, 4]])
    c = synthetic(np.zeros(5))
    c = Contacts(pairs[:, 0], pairs[:, 1], c.image, c.normal, c.length, c.normal_force, c.tangential_force, c.key)
    assert bearing_particles(6, c, 2).tolist() == [True, True, True, False, False, False]
    assert not bearing_particles(6, c, 3).any()


def test_coordination_of_a_lattice_counts_a_removed_disk():
    full = triangular_lattice(6, 6, 1e-4)
    keep = np.arange(full.count) != 14
    loose = new_sample(full.position[keep], full.radius[keep], full.cell)
    z = coordination_number(loose)
    assert z.all_particles == pytest.approx((6 * 36 - 12) / 35)
    small = full.radius.copy()
    small[14] *= 0.9
    z = coordination_number(new_sample(full.position, small, full.cell))
    assert z.all_particles == pytest.approx((6 * 36 - 12) / 36)
    assert z.without_rattlers == pytest.approx((6 * 36 - 12) / 35)
    assert z.rattler_fraction == pytest.approx(1 / 36)


def test_sliding_fraction_counts_forces_at_the_limit(packing):
    sample = packing.copy()
    touching = contacts_of(sample)
    force = touching.normal_force
    fraction = np.where(np.arange(len(force)) % 4 == 0, 0.5, 0.4)
    at_limit = Contacts(
        touching.first,
        touching.second,
        touching.image,
        touching.normal,
        touching.length,
        force,
        -fraction * force,
        touching.key,
    )
    assert sliding_fraction(sample, at_limit) == pytest.approx(0.25, abs=1 / len(force))


lists = st.lists(st.tuples(st.integers(0, 40), st.floats(0, 6.2)), min_size=1, max_size=40, unique_by=lambda t: t[0])


@settings(max_examples=200, deadline=None)
@given(lists, lists)
def test_fabric_change_closes_to_rounding(before, after):
    """Gained + lost + persisting = change, whatever the two lists."""
    a = synthetic([t for _, t in sorted(before)], key=sorted(k for k, _ in before))
    b = synthetic([t for _, t in sorted(after)], key=sorted(k for k, _ in after))
    change = network_change(a, b, 50)
    total = change.fabric_gained + change.fabric_lost + change.fabric_persisting
    assert total == pytest.approx(fabric_anisotropy(b) - fabric_anisotropy(a), abs=1e-12)
    assert a.count - change.lost == change.persisting == b.count - change.gained
    dz = change.coordination_gained - change.coordination_lost
    assert dz == pytest.approx(2 * (b.count - a.count) / 50, abs=1e-12)


def test_directional_change_counts_every_event_once():
    a = synthetic([0.0, 0.05, 1.5, -1.5, 3.1], key=[1, 2, 3, 4, 5])
    b = synthetic([0.0, 1.6, 1.55], key=[1, 3, 9])
    d = directional_change(a, b, bins=4)
    assert d.present.tolist() == [3, 0, 2, 0]
    assert (d.lost * d.present).sum() == pytest.approx(3)
    assert d.lost == pytest.approx([2 / 3, 0, 1 / 2, 0])
    assert d.gained == pytest.approx([0, 0, 1 / 2, 0])
    assert match_contacts(a, b).lost.tolist() == [False, True, False, True, True]


def test_edge_density_is_exact_for_a_straight_line():
    """Quantiles of the density 1.5 - x on [0, 1] give value 1.5 and slope -1 for every window."""
    u = (np.arange(200_000) + 0.5) / 200_000
    x = 1.5 - np.sqrt(2.25 - 2 * u)
    for window in (0.2, 0.5, 1.0):
        fit = edge_density(x, window)
        assert fit.value == pytest.approx(1.5, abs=2e-3)
        assert fit.slope == pytest.approx(-1.0, abs=2e-2)


def test_edge_density_states_its_error():
    random = np.random.default_rng(2)
    fits = [edge_density(random.exponential(size=2000), 0.5) for _ in range(200)]
    values = np.array([f.value for f in fits])
    assert np.mean([f.value_error for f in fits]) == pytest.approx(values.std(), rel=0.2)
    # exp(-x) is convex: the straight line of its first two moments on [0, 1/2] starts a little below 1
    assert values.mean() == pytest.approx(4 / 0.5 * (1 - np.exp(-0.5)) - 6 / 0.25 * (1 - 1.5 * np.exp(-0.5)), abs=0.01)


def test_densities_integrate_to_one(packing):
    contacts = contacts_of(packing)
    forces = force_distribution(contacts, largest=10.0)
    for density in (forces.overall, *forces.by_direction):
        width = density.value[1] - density.value[0]
        assert np.sum(density.density) * width == pytest.approx(1.0, abs=1e-12)
    assert sum(d.count for d in forces.by_direction) == forces.overall.count == contacts.count
    assert histogram(np.array([0.5, 2.0]), np.array([0.0, 1.0])).density == pytest.approx([0.5])


def test_every_disk_has_six_radical_neighbours_on_average_and_contacts_are_among_them(packing):
    pairs = radical_neighbours(packing)
    assert pairs.mean_number == 6.0
    c = contacts_of(packing)
    neighbours = set((pairs.first * packing.count + pairs.second).tolist())
    assert set(c.key.tolist()) <= neighbours
    # same geometry as the list of near pairs
    assert np.count_nonzero(pairs.gap < 0) == c.count


def test_radical_sides_are_where_no_other_disk_is_nearer(packing):
    """At the radical centre of a neighbour pair's circles some point of equal power is owned by the two."""
    sample = packing
    pairs = radical_neighbours(sample)
    position = sample.position[pairs.second] + pairs.image @ sample.cell
    touching = pairs.gap < 0
    i, j, xj = pairs.first[touching], pairs.second[touching], position[touching]
    xi = sample.position[i]
    d = xj - xi
    length = np.hypot(d[:, 0], d[:, 1])
    along = (length**2 + sample.radius[i] ** 2 - sample.radius[j] ** 2) / (2 * length)
    point = xi + d * (along / length)[:, None]
    power = along**2 - sample.radius[i] ** 2
    inverse = np.linalg.inv(sample.cell)
    for k in range(0, len(i), 25):
        apart = (sample.position - point[k]) @ inverse
        apart = (apart - np.round(apart)) @ sample.cell
        others = np.sum(apart**2, axis=1) - sample.radius**2
        assert others.min() > power[k] - 1e-9


def test_equal_disks_have_delaunay_neighbours():
    random = np.random.default_rng(4)
    n = 150
    points = random.random((n, 2)) * 15.0
    sample = new_sample(points, np.full(n, 0.05), 15.0 * np.eye(2))
    shifts = np.array([[a, b] for a in (-1, 0, 1) for b in (-1, 0, 1)])
    triangles = Delaunay(np.concatenate([points + 15.0 * s for s in shifts])).simplices
    expected = set()
    for t in triangles:
        for a, b in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0])):
            if a // n == 4 or b // n == 4:
                expected.add((min(a % n, b % n), max(a % n, b % n)))
    pairs = radical_neighbours(sample)
    assert set(zip(pairs.first.tolist(), pairs.second.tolist())) == expected


def test_gap_density_counts_the_pairs_that_do_not_touch(packing):
    pairs = radical_neighbours(packing)
    gaps = gap_distribution(packing, pairs)
    assert gaps.density.count == 3 * packing.count - contacts_of(packing).count
    assert gaps.neighbours == 6.0
    # marginal packings have a weak divergence at small gaps, exponent about 0.4
    assert 0.2 < gaps.small_gap_exponent < 0.6
    assert gaps.at_zero.value > 3.0


def test_too_few_disks_for_a_tessellation_are_refused():
    with pytest.raises(SampleError, match="does not close"):
        radical_neighbours(new_sample(np.array([[1.0, 1.0], [8.0, 8.0], [3.0, 9.0]]), np.full(3, 0.5), 30 * np.eye(2)))


def test_fields_show_every_contact_once_and_every_particle_inside(packing):
    particles, contacts = particle_fields(packing), contact_fields(packing)
    reduced = particles["position"] @ np.linalg.inv(packing.cell)
    assert reduced.min() >= 0.0 and reduced.max() <= 1.0
    assert particles["contacts"].sum() == 2 * len(contacts["start"])
    lengths = np.hypot(*(contacts["end"] - contacts["start"]).T)
    assert lengths.max() < 2 * packing.radius.max()
    # mean particle pressure weighted by particle area is p times the cell's area (branch = sum of radii here)
    area = np.pi * packing.radius**2
    assert particles["pressure"] @ area / packing.area == pytest.approx(1e5, rel=1e-3)
