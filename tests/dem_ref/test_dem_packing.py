"""Packings: the state that frictionless compaction gives, reproducibility, storage, bad input."""

from __future__ import annotations

import numpy as np
import pytest

from granfabric.dem_ref.dynamics.motion import Motion
from granfabric.dem_ref.dynamics.packing import DISTRIBUTIONS, PackingOptions, make_packing, random_diameters
from granfabric.dem_ref.measures.contacts import contacts_of, coordination_number, love_weber_stress, unbalanced_force
from granfabric.dem_ref.sample.disks import SampleError, load_sample, new_sample, sample_arrays, save_sample
from granfabric.dem_ref.sample.neighbours import CellTooSmallError, find_near_pairs, most_neighbours


def test_packing_is_isotropic_balanced_and_isostatic(large_packing):
    """kn/p = 1e4, no friction: just above isostatic (4), z 4.04-4.06 and void ratio about 0.182."""
    sample = large_packing
    assert love_weber_stress(sample) == pytest.approx([-1e5, -1e5, 0.0], rel=1e-4, abs=10.0)
    assert unbalanced_force(sample) < 1e-4
    z = coordination_number(sample, minimum=3)
    assert z.without_rattlers == pytest.approx(4.045, abs=0.02)
    assert 0.02 < z.rattler_fraction < 0.06
    assert z.all_particles == pytest.approx(z.without_rattlers * (1 - z.rattler_fraction), abs=0.02)
    assert sample.void_ratio == pytest.approx(0.182, abs=0.005)


def test_switching_friction_on_moves_nothing(packing):
    motion = Motion(packing.copy())
    motion.run(500)
    assert motion.stress == pytest.approx(love_weber_stress(packing), rel=1e-4, abs=10.0)
    moved = np.abs(motion.sample.position - packing.position).max(axis=1)
    contacts = contacts_of(packing)
    number = np.bincount(np.concatenate([contacts.first, contacts.second]), minlength=packing.count)
    assert moved[number >= 3].max() < 1e-7
    # what the relaxation left of a force makes a disk without neighbours drift: nothing stops it
    assert moved.max() < 1e-6
    assert packing.friction == 0.5 and not packing.pairs.tangential.any()


def test_packing_is_reproducible_from_its_seed():
    a, b, c = make_packing(200, 7), make_packing(200, 7), make_packing(200, 8)
    assert np.array_equal(a.position, b.position) and np.array_equal(a.cell, b.cell)
    assert not np.array_equal(a.radius, c.radius)


def test_threads_are_one_or_two():
    for threads in (0, 3, 1.5, True):
        with pytest.raises(SampleError, match="threads is"):
            make_packing(100, 1, threads=threads)


def test_stiffness_to_pressure_is_reached():
    options = PackingOptions(
        stiffness_to_pressure=1e3, normal_stiffness=2e8, stiffness_ratio=0.5, friction=0.3, mean_diameter=2e-3
    )
    sample = make_packing(300, 3, options)
    assert love_weber_stress(sample) == pytest.approx([-2e5, -2e5, 0.0], rel=1e-4, abs=20.0)
    assert sample.mean_diameter == pytest.approx(2e-3)
    assert (sample.friction, sample.stiffness_ratio) == (0.3, 0.5)


@pytest.mark.parametrize("distribution", [name for name in DISTRIBUTIONS if name not in ("lognormal", "given")])
def test_diameters_follow_their_distribution(distribution):
    options = PackingOptions(distribution=distribution, diameter_ratio=1.5)
    d = random_diameters(20_000, options, np.random.default_rng(0))
    assert d.mean() == pytest.approx(1.0, rel=1e-12)
    ratio = 1.0 if distribution == "monodisperse" else 1.5
    assert d.max() / d.min() == pytest.approx(ratio, rel=1e-3)
    u = d / d.min()
    mean = {"uniform": 1.25, "uniform_area": np.log(1.5) / (1 - 1 / 1.5), "bidisperse": 1.25, "monodisperse": 1.0}
    assert u.mean() == pytest.approx(mean[distribution], rel=1e-3)
    if distribution == "uniform_area":
        area = u**2
        assert area[u < 1.25].sum() / area.sum() == pytest.approx(0.5, abs=1e-3)


def test_stored_packing_comes_back_to_the_last_bit(tmp_path, packing):
    path = tmp_path / "packing.npz"
    save_sample(path, packing)
    back = load_sample(path)
    for name, array in sample_arrays(packing).items():
        assert np.array_equal(array, sample_arrays(back)[name]), name
    assert not list(tmp_path.glob("*.part"))


def test_damaged_files_are_refused_with_a_sentence(tmp_path, packing):
    path = tmp_path / "p.npz"
    with pytest.raises(SampleError, match="no such file"):
        load_sample(path)
    path.write_bytes(b"not an archive")
    with pytest.raises(SampleError, match="not a stored sample"):
        load_sample(path)
    good = sample_arrays(packing)
    damages = {
        "radius": np.where(np.arange(packing.count) == 3, -1.0, packing.radius),
        "position": packing.position[:-1],
        "second": good["second"][::-1].copy(),
        "cell": np.array([[1.0, 0.0], [np.nan, 1.0]]),
        "tangential": good["tangential"].astype(np.float32),
        "numbers": np.array([1e9, 2.0, 0.5]),
        "header": np.array([99, 1]),
        "spin": np.array([object()] * packing.count),
    }
    for name, damage in damages.items():
        np.savez(path, **{**good, name: damage})
        with pytest.raises(SampleError, match=r"p\.npz"):
            load_sample(path)
    # a wrong length of a name in the archive: the reader quotes the bytes in its place, the sentence does not
    np.savez(path, **good)
    raw = bytearray(path.read_bytes())
    raw[26:28] = (200).to_bytes(2, "little")
    path.write_bytes(raw)
    with pytest.raises(SampleError, match=r"not a stored sample \(damaged\)"):
        load_sample(path)
    np.savez(path, **{k: v for k, v in good.items() if k != "image"})
    with pytest.raises(SampleError, match="image"):
        load_sample(path)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("stiffness_to_pressure", 1.0),
        ("friction", -0.1),
        ("diameter_ratio", 0.9),
        ("distribution", "gauss"),
        ("stiffness_ratio", np.nan),
    ],
)
def test_bad_options_are_refused(name, value):
    with pytest.raises(SampleError, match=name):
        make_packing(100, 1, PackingOptions(**{name: value}))


def test_bad_samples_are_refused():
    with pytest.raises(SampleError, match="number of disks is 10"):
        make_packing(10, 1)
    x, r = np.zeros((2, 2)), np.ones(2)
    with pytest.raises(SampleError, match="right-handed"):
        new_sample(x, r, np.array([[0.0, 9.0], [9.0, 0.0]]))
    with pytest.raises(SampleError, match="smallest radius"):
        new_sample(x, np.array([1.0, 0.0]), 9 * np.eye(2))
    with pytest.raises(CellTooSmallError, match="three interaction distances"):
        new_sample(x, r, 4 * np.eye(2))


def test_wide_gradings_take_a_shorter_step_and_stay_stable():
    """Diameters 1 and 3: a large disk can have ten or more contacts, too stiff for the usual step."""
    sample = make_packing(300, 2, PackingOptions(distribution="bidisperse", diameter_ratio=3.0))
    assert love_weber_stress(sample) == pytest.approx([-1e5, -1e5, 0.0], rel=1e-4, abs=10.0)
    assert most_neighbours(sample.radius) == 12
    c = contacts_of(sample)
    assert np.bincount(np.concatenate([c.first, c.second])).max() > 6
    motion = Motion(sample.copy(), step=0.5, damping=0.0)
    assert motion.step == pytest.approx(0.5 * np.sqrt(0.5))
    motion.sample.velocity += 1e-9  # a free drift of everything together costs nothing
    motion.run(3000)
    assert np.abs(motion.sample.velocity).max() < 1e-6


def test_near_pairs_are_those_of_brute_force():
    """Random disks in a strongly sheared cell, against all pairs and images."""
    random = np.random.default_rng(5)
    n, skin = 40, 0.2
    cell = np.array([[9.0, 1.5], [4.0, 8.0]])
    position = random.random((n, 2)) @ cell + random.integers(-2, 3, (n, 2)) @ cell
    radius = random.uniform(0.3, 0.6, n)
    pairs = find_near_pairs(position, radius, cell, skin)
    found = {(int(i), int(j), int(a), int(b)) for i, j, (a, b) in zip(pairs.first, pairs.second, pairs.image)}
    expected = set()
    for i in range(n):
        for j in range(i + 1, n):
            for a in range(-7, 8):
                for b in range(-7, 8):
                    dx = position[j, 0] - position[i, 0] + a * cell[0, 0] + b * cell[1, 0]
                    dy = position[j, 1] - position[i, 1] + a * cell[0, 1] + b * cell[1, 1]
                    if dx * dx + dy * dy < (radius[i] + radius[j] + skin) ** 2:
                        expected.add((i, j, a, b))
    assert found == expected and len(found) > n / 2
    key = pairs.first.astype(int) * n + pairs.second
    assert np.all(np.diff(key) > 0)


def test_history_is_carried_over_to_a_new_list(packing):
    sample = packing.copy()
    sample.pairs.tangential[:] = np.arange(len(sample.pairs.first)) + 1.0
    wide = find_near_pairs(sample.position, sample.radius, sample.cell, 0.1, sample.pairs)
    before = dict(zip(zip(sample.pairs.first, sample.pairs.second), sample.pairs.tangential))
    after = dict(zip(zip(wide.first, wide.second), wide.tangential))
    assert len(after) > len(before)
    assert all(value == before.get(pair, 0.0) for pair, value in after.items())
