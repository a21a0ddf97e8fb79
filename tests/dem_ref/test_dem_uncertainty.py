"""Standard errors of measured inputs: closed forms, made-up data of known scatter, and packings against each other."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from dem_samples import triangular_lattice

from granfabric.dem_ref.dynamics.packing import make_packing
from granfabric.dem_ref.inputs.material import (
    CLOSURE_KEYS,
    MATERIAL_KEYS,
    _slip_delay,
    measure_fabric,
    measure_material,
    measure_material_with_errors,
)
from granfabric.dem_ref.inputs.probes import moduli_errors
from granfabric.dem_ref.measures.contacts import contacts_of
from granfabric.dem_ref.measures.distribution import edge_density, edge_errors
from granfabric.dem_ref.measures.tessellation import (
    _triangulation,
    closing_gap_density,
    gap_distribution,
    radical_neighbours,
    solid_fraction_error,
)
from granfabric.dem_ref.measures.uncertainty import BLOCKS, blocks_of, blocks_of_contacts, jackknife

CHOSEN = ("normal_stiffness", "stiffness_ratio", "neighbours")
NUMBER = 8


def test_the_jackknife_of_a_mean_is_its_standard_error():
    data = np.random.default_rng(1).normal(size=BLOCKS)
    error = jackknife(lambda block: np.delete(data, block).mean())
    assert error == pytest.approx(data.std(ddof=1) / np.sqrt(BLOCKS), rel=1e-12)
    both = jackknife(lambda block: [np.delete(data, block).mean(), 3.0])
    assert both == pytest.approx([float(error), 0.0])
    assert np.isnan(jackknife(lambda block: np.nan if block == 3 else 1.0))


def test_blocks_are_equal_parts_of_the_cell_and_of_its_images():
    cell = np.array([[8.0, 0.0], [1.0, 6.0]])
    points = np.random.default_rng(2).random((4000, 2)) @ cell
    block = blocks_of(points, cell)
    assert np.bincount(block, minlength=BLOCKS) == pytest.approx(4000 / BLOCKS, abs=70)
    assert np.array_equal(block, blocks_of(points + 3 * cell[0] - 2 * cell[1], cell))


def test_contacts_lie_in_the_block_of_their_middle(packing):
    contacts = contacts_of(packing)
    number = np.bincount(blocks_of_contacts(packing, contacts), minlength=BLOCKS)
    assert number.sum() == contacts.count and number.min() > 0.5 * contacts.count / BLOCKS


def test_neighbours_that_go_together_make_a_larger_error():
    """Blocks of copies: eight contacts say as little as one; single contacts would promise a third of the error."""
    random = np.random.default_rng(5)
    values, errors, alone = [], [], []
    for _ in range(150):
        data = np.repeat(random.exponential(size=(BLOCKS, 12)), 8, axis=1)
        block = np.repeat(np.arange(BLOCKS), data.shape[1])
        flat = data.ravel()
        values.append(edge_density(flat / flat.mean(), 0.5).value)
        errors.append(edge_errors(flat, block, 0.5)[0])
        alone.append(edge_density(flat / flat.mean(), 0.5).value_error)
    scatter = np.std(values)
    assert np.mean(errors) == pytest.approx(scatter, rel=0.15)
    assert np.mean(alone) < 0.45 * scatter


def test_nothing_counted_is_no_certainty():
    """No force below half the mean: P0 = 0, and one such contact more would have made 2/w over the number."""
    data = np.linspace(0.9, 1.1, 160)
    block = np.arange(160) % BLOCKS
    assert edge_density(data / data.mean(), 0.5).value == 0.0
    assert edge_errors(data, block, 0.5) == pytest.approx((2.0 / 0.5 / 160, np.sqrt(12.0) / 0.5**2 / 160))
    lattice = triangular_lattice(10, 10, -1e-2)
    pairs = radical_neighbours(lattice)
    window = 1e-3
    assert gap_distribution(lattice, pairs, window).mean_density == 0.0
    found = closing_gap_density(lattice, pairs, window, np.ones(lattice.count, bool))
    assert (found.value, found.error) == (0.0, pytest.approx(1.0 / (window * len(pairs.gap))))


def test_triangles_hold_all_of_the_cell_and_of_the_disks(packing):
    made = _triangulation(packing)
    corners = made.point[made.triangles]
    centre = corners.mean(axis=1) @ np.linalg.inv(made.cell) + 0.5
    own = np.all((centre >= 0.0) & (centre < 1.0), axis=1)
    one, other = corners[own, 1] - corners[own, 0], corners[own, 2] - corners[own, 0]
    area = 0.5 * np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
    assert own.sum() == 2 * packing.count
    assert area.sum() * packing.mean_diameter**2 == pytest.approx(packing.area, rel=1e-12)
    # a lattice is alike everywhere, whatever the cut
    assert solid_fraction_error(triangular_lattice(12, 12, 1e-4)) < 1e-9
    assert 1e-3 < solid_fraction_error(packing) < 6e-3


def probe(strain, stress):
    """Change of strain and stress as a probe gives them; shear as (xx - yy, 2 xy) and ((xx - yy)/2, xy)."""
    (volume, shear, cross), (p, q, t) = strain, stress
    return SimpleNamespace(
        strain_change=np.array([(volume + shear) / 2, (volume - shear) / 2, cross / 2]),
        stress_change=np.array([p + q, p - q, t]),
    )


def test_errors_of_the_moduli_follow_from_a_known_stiffness():
    mean, apart, coupled = 100.0, 6.0, 8.0
    stiffness = np.array([[mean + apart, coupled], [coupled, mean - apart]])
    shear = []
    for stress in ([1.0, 0.0], [0.3, 0.9]):
        strain = np.linalg.solve(stiffness, stress)
        shear.append(probe((0.0, *strain), (0.0, *stress)))
    isotropic = [probe((sign * 2.0, sign * 0.03, sign * 0.04), (sign, 0.0, 0.0)) for sign in (1.0, -1.0)]
    bulk_error, shear_error = moduli_errors(isotropic, shear)
    assert shear_error == pytest.approx(np.hypot(apart, coupled) / mean / np.sqrt(2))
    assert bulk_error == pytest.approx(0.05 / 2.0 / np.sqrt(2))


@pytest.fixture(scope="module")
def many():
    """Inputs of some small packings."""
    found = []
    for seed in range(1, NUMBER + 1):
        sample = make_packing(200, seed)
        entries = measure_material_with_errors(sample)
        entries["initial_fabric_xx"], entries["initial_fabric_xy"] = measure_fabric(sample)
        found.append(entries)
    return found


def test_every_input_has_an_error_and_the_same_value_as_before(many):
    assert set(many[0]) == {*MATERIAL_KEYS, *CLOSURE_KEYS, "initial_fabric_xx", "initial_fabric_xy"}
    for entries in many:
        for name, entry in entries.items():
            assert (entry.error == 0.0) == (name in CHOSEN), name
    values = measure_material(make_packing(200, 1))
    assert values == {name: many[0][name].value for name in values}


def test_errors_are_honest(many):
    """Root mean square of the errors of eight packings against their scatter, which itself is known to a quarter.

    Upper bounds where all of a packing shares something (see `uncertainty`), and z_iso divides by a small difference.
    """
    for name in many[0]:
        if name in CHOSEN:
            continue
        values = np.array([entries[name].value for entries in many])
        errors = np.array([entries[name].error for entries in many])
        scatter = values.std(ddof=1)
        if name == "gap_density_at_zero" and not values.any():
            # none of so few disks has such a gap: the error is that of one, whatever a scatter of nothing says
            assert errors.min() > 0.0
            continue
        assert 0.4 * scatter < np.sqrt(np.mean(errors**2)) < 5.0 * scatter, name
        # no value lies further from the middle than its error, and the scatter, allow
        apart = np.abs(values - np.median(values)) / np.hypot(errors, scatter / 2)
        assert np.median(apart) < 1.5 and apart.max() < 5.0, name


def test_errors_fall_with_the_number_of_disks(many, large_packing):
    large = measure_material_with_errors(large_packing)
    falls = [
        large[name].error / np.median([entries[name].error for entries in many])
        for name in large
        if name not in CHOSEN
    ]
    # ten times the disks: 0.32 for independent parts
    assert 0.15 < np.median(falls) < 0.55
    assert large["isostatic_coordination"].error < large["isostatic_coordination"].value


def test_rattlers_excluded_have_an_error_too(packing):
    entry = measure_material_with_errors(packing, rattlers="excluded")["coordination"]
    assert entry.value == measure_material(packing, rattlers="excluded")["coordination"]
    assert 0.0 < entry.error < 0.1


def test_a_packing_without_friction_has_no_slip_delay():
    """No tangential force answers a probe there: nothing is divided by it."""
    delay = _slip_delay(0.5, 0.8, 0.08)
    assert (delay.value, delay.error) == pytest.approx((0.625, 0.0625))
    for friction, response in ((0.0, 0.0), (0.5, float("nan"))):
        none = _slip_delay(friction, response, 0.0)
        assert np.isnan(none.value) and np.isnan(none.error)
