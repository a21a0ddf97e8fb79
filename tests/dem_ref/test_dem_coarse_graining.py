"""Fields on a grid: sums are those of the packing, homogeneous states are found exactly, bad input is refused."""

from __future__ import annotations

import numpy as np
import pytest
from dem_samples import triangular_lattice

from granfabric.dem_ref.measures.coarse_graining import KERNELS, coarse_grained, kernel_values
from granfabric.dem_ref.measures.contacts import contacts_of, coordination_number, fabric_anisotropy, love_weber_stress
from granfabric.dem_ref.sample.disks import SampleError


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize(("cells", "scale"), [((1, 1), 3.0), ((8, 8), 3.5), ((5, 9), 3.9)])
def test_sums_over_the_grid_are_those_of_the_packing(packing, kernel, cells, scale):
    """Whatever the kernel, its scale and the grid: also one point for all, and disks at the border of the cell."""
    scale = 12.0 if cells == (1, 1) else scale
    scale = scale / 3.0 if kernel == "gaussian" else scale
    if cells == (1, 1):
        packing = triangular_lattice(6, 6, 1e-3)
        with pytest.raises(SampleError, match="half of the height"):
            coarse_grained(packing, cells, scale, kernel)
        return
    found = coarse_grained(packing, cells, scale, kernel)
    assert found.stress.mean(axis=0) == pytest.approx(love_weber_stress(packing), rel=1e-12, abs=1e-7)
    assert found.disks.sum() == pytest.approx(packing.count, rel=1e-12)
    assert found.solid_fraction.mean() == pytest.approx(packing.solid_fraction, rel=1e-12)
    z = float(found.disks @ found.coordination) / packing.count
    assert z == pytest.approx(coordination_number(packing).all_particles, rel=1e-12)


def test_fabric_of_parts_adds_up_to_that_of_all(packing):
    """Weighted with the contacts, two of which count for each disk's mean number."""
    found = coarse_grained(packing, (4, 4), 6.0, "lucy")
    assert np.abs(found.fabric).max() < 0.6
    whole = fabric_anisotropy(contacts_of(packing))
    assert found.fabric.mean(axis=0) == pytest.approx(whole, abs=0.03)


def test_a_kernel_is_turned_with_the_packing(packing):
    """A cell turned by a right angle: the same numbers, axes exchanged."""
    found, turned = (coarse_grained(s, (6, 6), 4.0) for s in (packing, packing.rotated(np.pi / 2)))
    assert turned.stress[:, [1, 0]] == pytest.approx(found.stress[:, [0, 1]], rel=1e-9)
    assert turned.fabric == pytest.approx(-found.fabric, abs=1e-9)


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_homogeneous_strain_is_found_exactly_across_the_border(packing, kernel):
    """Positions not wrapped, the cell deformed with them."""
    gradient = np.array([[1.002, 0.001], [-0.0005, 0.997]])
    moved = packing.copy()
    moved.position = (packing.position + 2 * packing.cell[0]) @ gradient.T
    moved.cell = packing.cell @ gradient.T
    start = (packing.position + 2 * packing.cell[0], packing.cell)
    strain = coarse_grained(moved, (7, 6), 1.3 if kernel == "gaussian" else 4.0, kernel, start).strain
    assert strain == pytest.approx(np.tile([0.002, -0.003, 0.0005], (42, 1)), abs=1e-12)


def test_one_zone_of_more_strain_is_seen_where_it_is(packing):
    """u_x = A sin(2 pi x/L): strain A k cos(k x), smeared out by the kernel but with its mean zero and its place."""
    length = packing.cell[0, 0]
    k, size = 2 * np.pi / length, 1e-3
    moved = packing.copy()
    moved.position[:, 0] += size * np.sin(k * packing.position[:, 0])
    found = coarse_grained(moved, (12, 12), 4.0, "lucy", (packing.position, packing.cell))
    middle = (found.corner[:-1, :-1] + found.corner[1:, 1:]).reshape(-1, 2) / 2
    wanted = size * k * np.cos(k * middle[:, 0])
    assert np.corrcoef(found.strain[:, 0], wanted)[0, 1] > 0.99
    assert np.abs(found.strain[:, 1:]).max() < 0.2 * size * k


def test_kernels_have_their_values():
    ratio = np.array([0.0, 0.5, 0.999999, 1.0, 2.0, 3.1])
    assert kernel_values("lucy", ratio)[:2] == pytest.approx([1.0, 2.5 * 0.125])
    assert kernel_values("lucy", ratio)[3:].tolist() == [0.0] * 3
    assert kernel_values("heaviside", ratio).tolist() == [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    assert kernel_values("gaussian", ratio)[[0, 3, 5]] == pytest.approx([1.0, np.exp(-0.5), 0.0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kernel": "box"}, "legal are gaussian, lucy, heaviside"),
        ({"scale": 0.0}, "scale is 0.0"),
        ({"scale": 1.0}, "too small for the distance of the points"),
        ({"scale": 30.0}, "half of the height of the cell"),
        ({"cells": (0, 4)}, "cells is 0"),
    ],
)
def test_what_cannot_be_averaged_is_told(packing, change, words):
    with pytest.raises(SampleError, match=words):
        coarse_grained(packing, **{"cells": (4, 4), "scale": 5.0, **change})
