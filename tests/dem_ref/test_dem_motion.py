"""The motion of a packing: independence of choices that must not matter, energy, periodicity, rotation."""

from __future__ import annotations

import ast
from pathlib import Path

import numba
import numpy as np
import pytest

from granfabric.dem_ref.dynamics import motion as motion_module
from granfabric.dem_ref.dynamics.motion import DAMPING, STEP, Control, Motion
from granfabric.dem_ref.loading.legs import biaxial_leg
from granfabric.dem_ref.loading.path import Segment
from granfabric.dem_ref.loading.run import DemRun, RunOptions, at_stress_ratios
from granfabric.dem_ref.loading.servo import Loading, RateLimits
from granfabric.dem_ref.measures import contacts as contacts_module
from granfabric.dem_ref.measures import events as events_module
from granfabric.dem_ref.measures.contacts import contacts_of, fabric_anisotropy, force_harmonics, love_weber_stress
from granfabric.dem_ref.sample.disks import Sample, SampleError
from granfabric.dem_ref.threads import TRIED_AGAIN, TWO_PAY, Faster

PURE_SHEAR = Control(drive=np.array([2.0e-9, -2.0e-9, 0.5e-9]))


def sheared(sample: Sample, steps: int = 5000, control: Control = PURE_SHEAR, **choices) -> Motion:
    motion = Motion(sample.copy(), **choices)
    motion.run(steps, control)
    return motion


def test_result_does_not_depend_on_the_skin(packing):
    """Pairs beyond contact add nothing and the order of summation is fixed: equal to the last bit."""
    a = sheared(packing, 20_000, skin=1e-4, refresh=2e-5)
    b = sheared(packing, 20_000, skin=0.05, refresh=2e-5)
    assert a.rebuilds > b.rebuilds
    assert np.array_equal(a.sample.position, b.sample.position)
    assert np.array_equal(a.stress, b.stress)


def test_result_hardly_depends_on_the_refresh_of_directions(packing):
    """Directions are off by at most `refresh`, so forces by that fraction; stress changes follow within a few of it."""
    a = sheared(packing, refresh=2e-5)
    b = sheared(packing, refresh=1e-7)
    c = sheared(packing, refresh=2e-4)
    assert b.refreshes > 20 * a.refreshes
    change = np.abs(b.stress - love_weber_stress(packing)).max()
    assert np.abs(a.stress - b.stress).max() < 2e-3 * change
    assert np.abs(c.stress - b.stress).max() < 2e-2 * change


def test_runs_are_reproducible_to_the_last_bit(packing):
    a, b = sheared(packing), sheared(packing)
    assert np.array_equal(a.sample.position, b.sample.position)
    assert np.array_equal(a.sample.pairs.tangential, b.sample.pairs.tangential)


def test_one_and_two_threads_agree_to_the_last_bit(packing):
    a, b = sheared(packing, 3000), sheared(packing, 3000, threads=2)
    assert np.array_equal(a.sample.position, b.sample.position)
    assert np.array_equal(a.stress, b.stress) and np.array_equal(a.tally, b.tally)


def test_threads_are_as_many_as_have_been_faster_lately(monkeypatch):
    monkeypatch.setattr(numba, "get_num_threads", lambda: 2)
    assert Faster(TWO_PAY - 1).choose() == 1
    faster, seconds, taken = Faster(TWO_PAY), {1: 2.0, 2: 1.0}, []
    for call in range(3 * TRIED_AGAIN):
        if call == 2 * TRIED_AGAIN:  # somebody else takes a core
            seconds[2] = 5.0
        taken.append(faster.choose())
        faster.tell(taken[-1], 40, seconds[taken[-1]])
    assert taken[:2] == [2, 1] and taken[2 : 2 * TRIED_AGAIN].count(1) == 2 - 1
    assert taken[2 * TRIED_AGAIN + 3 :].count(2) <= 2
    monkeypatch.setattr(numba, "get_num_threads", lambda: 1)
    assert faster.choose() == 1


@pytest.mark.parametrize("module", [motion_module, contacts_module, events_module])
def test_what_a_loading_calls_again_and_again_has_no_products_for_blas(module):
    """Threads of BLAS spin on after a product of all contacts: with them, two threads of the motion were slower than
    one, and sums of stresses had bits that depended on the number of cores."""
    tree = ast.parse(Path(module.__file__).read_text())
    products = [node for node in ast.walk(tree) if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult)]
    assert not products
    names = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
    assert not names & {"dot", "vdot", "inner", "matmul", "einsum", "tensordot", "vecdot"}


def test_periodic_images_do_not_matter(packing):
    """The same packing with particles moved by whole cell vectors, shifted, and described by a sheared cell."""
    random = np.random.default_rng(3)
    other = packing.copy()
    images = random.integers(-1, 2, size=(packing.count, 2))
    other.position += images @ packing.cell
    first, second = other.pairs.first, other.pairs.second
    other.pairs.image += (images[first] - images[second]).astype(np.int8)
    other.cell[1] += other.cell[0]
    other.pairs.image[:, 0] -= other.pairs.image[:, 1]
    # images by whole cells are the same forces already before anything moves
    assert love_weber_stress(other) == pytest.approx(love_weber_stress(packing), rel=1e-9, abs=1e-5)
    a, b = sheared(packing, 2000), sheared(other, 2000)
    scale = np.abs(a.stress).max()
    # positions carry 1e-14 of the cell; over an overlap of 1e-4 that is 1e-9 of a force; contacts may open a step apart
    assert np.abs(a.stress - b.stress).max() < 1e-6 * scale
    shifted = packing.copy()
    shifted.position += (0.37, -0.11)
    assert np.abs(sheared(shifted, 2000).stress - a.stress).max() < 1e-6 * scale


def test_rotating_the_sample_rotates_every_measure(packing):
    angle = 0.4
    turned = packing.rotated(angle)
    a, b = Motion(packing.copy()), Motion(turned)
    for motion, axis in ((a, np.pi / 2), (b, np.pi / 2 + angle)):
        assert Loading(motion, biaxial_leg("constant_pressure", 4e-5, angle=axis)).run(20_000)
    c, s = np.cos(2 * angle), np.sin(2 * angle)
    turn = np.array([[c, -s], [s, c]])  # double-angle vectors turn by twice the angle
    ca, cb = contacts_of(a.sample), contacts_of(b.sample)
    assert ca.count == cb.count
    assert fabric_anisotropy(cb) == pytest.approx(turn @ fabric_anisotropy(ca), abs=1e-6)
    fa, fb = force_harmonics(ca), force_harmonics(cb)
    assert fb.normal == pytest.approx(turn @ fa.normal, abs=1e-5)
    assert fb.tangential == pytest.approx(turn @ fa.tangential, abs=1e-5)
    assert fb.mean == pytest.approx(fa.mean, rel=1e-5)
    for measure in ("stress", "strain"):
        va = a.stress if measure == "stress" else a.sample.strain
        vb = b.stress if measure == "stress" else b.sample.strain
        deviator = turn @ np.array([(va[0] - va[1]) / 2, va[2]])
        assert np.array([(vb[0] - vb[1]) / 2, vb[2]]) == pytest.approx(deviator, abs=1e-5 * np.abs(va).max())


@pytest.mark.parametrize("path", ["constant_pressure", "constant_lateral_stress"])
def test_energy_balance_closes(packing, path):
    """Work done = elastic energy + friction + drag (kinetic energy is nothing here), to 0.1 per cent of the work."""
    run = DemRun(packing, RunOptions((Segment("biaxial", path, 5e-3, 0.25),)))
    assert run.execute()
    h = run.history()
    stored = h["elastic_energy"][-1] - h["elastic_energy"][0]
    rest = h["work"][-1] - stored - h["friction_heat"][-1] - h["drag_heat"][-1]
    assert abs(rest) < 1e-3 * h["work"][-1]
    # and every part is there: a balance of zeros proves nothing
    assert min(stored, h["friction_heat"][-1]) > 1e-2 * h["work"][-1]
    assert h["drag_heat"][-1] > 1e-4 * h["work"][-1]
    assert run.motion.energies()["kinetic"] < 1e-4 * h["work"][-1]


def test_momentum_of_a_packing_stays_zero(packing):
    """Exactly without drag; with it, which loose disks do not feel, it stays a small part of what is there."""
    for damping, allowed in ((0.0, 1e-10), (0.02, 2e-2)):
        motion = sheared(packing, 5000, damping=damping)
        total = np.abs(motion.sample.velocity.sum(axis=0)).max()
        assert total < allowed * np.abs(motion.sample.velocity).sum()


def curve(sample: Sample, rate: float = 1.0, **choices) -> dict[str, np.ndarray]:
    base = RateLimits()
    limits = RateLimits(rate * base.inertial_number, rate * base.unbalanced_force)
    run = DemRun(sample, RunOptions((Segment(stress_ratio=0.31),), limits, **choices))
    assert run.execute()
    return at_stress_ratios(run.history(), [0.1, 0.2, 0.3])


@pytest.fixture(scope="module")
def usual(large_packing) -> dict[str, np.ndarray]:
    return curve(large_packing)


@pytest.mark.parametrize(
    "choice",
    [
        {"damping": 10.0 * DAMPING},
        {"damping": 0.1 * DAMPING},
        {"rate": 0.5},
        {"step": 0.5 * STEP},
        pytest.param({"rate": 0.1}, marks=pytest.mark.slow),
        pytest.param({"rate": 0.1, "damping": 0.1 * DAMPING}, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_curves_do_not_depend_on_drag_rate_and_step(large_packing, usual, choice):
    """Other choices take other contact events, so that curves of 2,000 disks differ by a few contacts."""
    other = curve(large_packing, **choice)
    for name in ("coordination", "coordination_without_rattlers"):
        assert other[name] == pytest.approx(usual[name], rel=5e-3), name
    for name, allowed in (("fabric", 3e-3), ("normal_force", 4e-3), ("tangential_force", 2e-3)):
        name += "_anisotropy"
        assert other[name] == pytest.approx(usual[name], abs=allowed), name
    # a tenth of the drag leaves vibrations that move contacts off the limit for a while
    assert other["sliding_fraction"] == pytest.approx(usual["sliding_fraction"], abs=0.012)
    strain, reference = (c["strain_xx"] - c["strain_yy"] for c in (other, usual))
    assert strain == pytest.approx(reference, rel=0.02)


@pytest.mark.parametrize(
    "choice",
    [
        {"step": 0.6},
        {"step": 0.0},
        {"damping": 1.0},
        {"damping": -0.1},
        {"skin": 1e-5},
        {"skin": 0.2},
        {"refresh": 0.0},
        {"threads": 3},
    ],
)
def test_unstable_choices_are_refused(packing, choice):
    with pytest.raises(SampleError, match=next(iter(choice))):
        Motion(packing.copy(), **choice)
