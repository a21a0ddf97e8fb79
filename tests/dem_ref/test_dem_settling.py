"""Settling under a pressure: closed forms of a lattice, energy that only falls, the same state as steepest descent."""

from __future__ import annotations

import numpy as np
import pytest
from dem_samples import triangular_lattice

from granfabric.dem_ref.dynamics import settling
from granfabric.dem_ref.dynamics.packing import make_packing
from granfabric.dem_ref.dynamics.relaxation import relax
from granfabric.dem_ref.dynamics.settling import settle
from granfabric.dem_ref.measures.contacts import contacts_of, unbalanced_force
from granfabric.dem_ref.sample.disks import SampleError
from granfabric.dem_ref.sample.neighbours import find_near_pairs
from granfabric.dem_ref.threads import two_threads


def enthalpy(position, radius, cell, pressure) -> float:
    pairs = find_near_pairs(position, radius, cell, 0.0)
    vector = position[pairs.second] - position[pairs.first] + pairs.image @ cell
    overlap = np.maximum(radius[pairs.first] + radius[pairs.second] - np.hypot(*vector.T), 0.0)
    return 0.5 * float(overlap @ overlap) + pressure * float(np.linalg.det(cell))


def disturbed():
    sample = triangular_lattice(10, 10, 2e-3)
    position = sample.position + 1e-4 * np.random.default_rng(1).normal(size=sample.position.shape)
    return position, sample.radius.copy(), sample.cell @ np.array([[1.001, 5e-4], [0.0, 0.9995]])


def test_a_lattice_settles_at_the_overlap_that_its_pressure_asks_for():
    """Six contacts a disk: p = sqrt(3) f/d with the distance d of the centres, here 1 - f for kn = 1."""
    position, radius, cell = disturbed()
    pressure = 1e-3
    settled = settle(position, radius, cell, pressure, tolerance=1e-10, drag=0.05)
    assert settled.converged and settled.contacts == 300
    assert settled.stress == pytest.approx([pressure, pressure, 0.0], abs=1e-9 * pressure)
    overlap = pressure / (np.sqrt(3.0) + pressure)
    pairs = find_near_pairs(position, radius, cell, 0.0)
    vector = position[pairs.second] - position[pairs.first] + pairs.image @ cell
    assert 1.0 - np.hypot(*vector.T) == pytest.approx(np.full(300, overlap), rel=1e-6)


def test_it_is_the_same_minimum_that_relaxation_finds_and_no_higher_than_the_start():
    ends = []
    for move in (relax, settle):
        position, radius, cell = disturbed()
        start = enthalpy(position, radius, cell, 1e-3)
        assert move(position, radius, cell, 1e-3, tolerance=1e-8).converged
        ends.append(enthalpy(position, radius, cell, 1e-3))
        assert ends[-1] < start
    assert ends[0] == pytest.approx(ends[1], rel=1e-12)


def test_what_does_not_come_to_rest_is_told():
    position, radius, cell = disturbed()
    settled = settle(position, radius, cell, 1e-3, tolerance=1e-12, steps=20)
    assert not settled.converged and settled.steps == 20 and settled.unbalanced > 1e-12


@pytest.mark.parametrize(
    ("name", "value"), [("pressure", 0.0), ("pressure", np.nan), ("tolerance", -1.0), ("steps", 0), ("drag", 1.0)]
)
def test_numbers_out_of_bounds_are_refused(name, value):
    position, radius, cell = disturbed()
    with pytest.raises(SampleError, match=name):
        settle(position, radius, cell, **{"pressure": 1e-3, name: value})


def random_disks(count: int):
    """Disks at random in a skewed cell, moved apart."""
    random = np.random.default_rng(7)
    radius = 0.5 * (0.9 + 0.2 * random.random(count))
    cell = np.sqrt(np.pi * np.sum(radius**2) / 0.86) * np.array([[1.0, 0.0], [0.1, 1.0]])
    position = random.random((count, 2)) @ cell
    relax(position, radius, cell, 0.0, tolerance=1e-2, steps=300, fixed_cell=True)
    return position, radius, cell


def test_one_and_two_threads_give_the_same_bits():
    ends = []
    for threads in (1, 2):
        position, radius, cell = random_disks(2000)
        settled = settle(position, radius, cell, 1e-3, steps=100, threads=threads)
        ends.append((position, cell, settled.stress, settled.unbalanced))
    assert all(np.array_equal(one, two) for one, two in zip(*ends))


def test_no_force_is_lost_between_the_two_halves_of_the_disks():
    """At rest under a pressure, forces that a sum over all pairs gives leave no disk out of balance."""
    sample = make_packing(300, 3)
    assert unbalanced_force(sample) < 1e-4
    contacts = contacts_of(sample)
    crossing = (contacts.first < 150) & (contacts.second >= 150)
    assert crossing.sum() > 10


def test_what_it_says_of_its_way_grows_to_one(monkeypatch):
    monkeypatch.setattr(settling, "REPORTED", 1)
    told = []
    position, radius, cell = random_disks(300)
    settle(position, radius, cell, 1e-2, 1e-3, progress=lambda way, unbalanced: told.append((way, unbalanced)))
    ways = [way for way, _ in told]
    assert len(told) > 1 and ways == sorted(ways) and ways[0] >= 0.0 and ways[-1] <= 1.0
    assert all(unbalanced > 0.0 for _, unbalanced in told)


def test_who_watches_can_stop_it_and_the_threads_are_free_again(monkeypatch):
    monkeypatch.setattr(settling, "REPORTED", 1)

    class Enough(Exception):
        pass

    def stop(way, unbalanced):
        raise Enough

    position, radius, cell = random_disks(2000)
    with pytest.raises(Enough):
        settle(position, radius, cell, 1e-3, threads=2, progress=stop)
    with two_threads(True) as both:
        assert both
