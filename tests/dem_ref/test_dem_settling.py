"""Settling under a pressure: closed forms of a lattice, energy that only falls, the same state as steepest descent."""

from __future__ import annotations

import numpy as np
import pytest
from dem_samples import triangular_lattice

from granfabric.dem_ref.dynamics.relaxation import relax
from granfabric.dem_ref.dynamics.settling import settle
from granfabric.dem_ref.sample.disks import SampleError
from granfabric.dem_ref.sample.neighbours import find_near_pairs


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
