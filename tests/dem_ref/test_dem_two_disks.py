"""Two disks against closed forms: collision, sliding, sticking, conservation."""

from __future__ import annotations

import numpy as np
import pytest
from dem_samples import triangular_lattice, two_disks

from granfabric.dem_ref.dynamics.motion import Motion, contact_elongations
from granfabric.dem_ref.dynamics.stepping import CONTACTS
from granfabric.dem_ref.sample.disks import new_sample


def colliding(speed: float, across: float = 0.0, friction: float = 0.0, step: float = 0.01) -> Motion:
    """Just before contact, approaching with relative speed `speed` (per step), sliding across with `across`."""
    sample = two_disks(0.25 * speed, friction=friction)
    sample.velocity[:] = [[speed / 2, -across / 2], [-speed / 2, across / 2]]
    return Motion(sample, step=step, damping=0.0, refresh=1e-6)


def test_head_on_collision_reverses_velocity_after_half_a_period():
    """Spring of stiffness kn between two masses m: omega = sqrt(2 kn/m), the contact lasts pi/(step sqrt 2) steps."""
    step, speed = 0.01, 1e-6
    motion = colliding(speed, step=step)
    lasted, deepest = 0, 0.0
    for _ in range(400):
        motion.run(1)
        lasted += int(motion.measures[CONTACTS])
        deepest = max(deepest, float(contact_elongations(motion.sample)[0].max()))
    assert motion.sample.velocity[0] == pytest.approx([-speed / 2, 0.0], rel=2e-3, abs=1e-12)
    assert motion.sample.velocity[1] == pytest.approx([speed / 2, 0.0], rel=2e-3, abs=1e-12)
    assert abs(lasted - np.pi / (step * np.sqrt(2))) <= 2
    # deepest overlap v/omega; the scheme is of second order in omega dt
    assert deepest == pytest.approx(speed / (step * np.sqrt(2)), rel=(step * np.sqrt(2)) ** 2 + 2e-4)


def test_sliding_collision_transfers_coulomb_impulse():
    """While the contact slides throughout, the tangential impulse is mu times the normal one; inertia is m r^2."""
    speed, across, friction = 1e-7, 1e-6, 0.3
    motion = colliding(speed, across, friction)
    motion.run(400)
    impulse = friction * speed  # change of normal velocity of each disk is `speed`
    v = motion.sample.velocity
    # the branch turns by 222 steps x 1e-6 rad, which mixes components that differ tenfold
    assert v[0] == pytest.approx([-speed / 2, -across / 2 + impulse], rel=5e-3)
    assert v[1] == pytest.approx([speed / 2, across / 2 - impulse], rel=5e-3)
    assert motion.sample.spin == pytest.approx([impulse, impulse], rel=5e-3)


def test_sticking_pair_oscillates_with_its_tangential_frequency():
    """Spins of two touching disks: 2 kt against m each and the relative slip twofold: omega = 2 sqrt(kt/m)."""
    step, spin = 0.01, 1e-9
    sample = two_disks(-1e-3, friction=1e3)
    sample.spin[:] = spin
    # the overlap, far larger than the slip, opens only after a quarter of its own period
    motion = Motion(sample, step=step, damping=0.0)
    motion.run(1)
    slip = []
    for _ in range(60):
        motion.run(1)
        slip.append(float(motion.sample.spin.sum()))
    # relative slip s'' = -(4 kt/m) s: two translations and two rotations, each with weight kt/m
    t = step * (np.arange(60) + 1.5)
    assert np.allclose(np.array(slip), spin * (1.0 + np.cos(2.0 * t)), rtol=0.0, atol=2e-2 * spin)


def test_momentum_and_moment_of_momentum_are_conserved():
    motion = colliding(1e-6, 3e-6, 0.4)
    sample = motion.sample

    def moment() -> float:
        x, v = sample.position - 6.0, sample.velocity
        return float(np.sum(x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0]) + np.sum(sample.radius * sample.spin))

    before = moment()
    motion.run(400)
    assert np.abs(sample.velocity.sum(axis=0)).max() < 1e-15 * 1e-6 * 400
    assert np.abs(sample.spin).min() > 1e-7  # the collision did exchange moment
    # lever arms are radii: an error of the order of overlap over radius of what is exchanged; the leapfrog adds step^2
    assert moment() == pytest.approx(before, rel=2e-3)


def test_drag_slows_what_has_three_contacts_by_its_number():
    """A lattice that moves as a whole: no contact changes, six contacts a disk."""
    sample = triangular_lattice(6, 6, 1e-4)
    sample.velocity[:] = [1e-9, 2e-9]
    motion = Motion(sample, damping=0.06)
    before = motion.energies()["kinetic"]
    motion.run(10)
    factor = (0.94 / 1.06) ** 10
    assert motion.sample.velocity == pytest.approx(np.tile([factor * 1e-9, factor * 2e-9], (36, 1)), rel=1e-4)
    energies = motion.energies()
    assert energies["drag"] == pytest.approx(before - energies["kinetic"], rel=1e-4)


@pytest.mark.parametrize("neighbours", [0, 1, 2])
def test_a_disk_with_fewer_than_three_contacts_is_not_dragged(neighbours):
    """Between neighbours that move with it, so that nothing but drag could slow it."""
    theta = 2.0 * np.pi * np.arange(neighbours) / 3.0
    around = 6.0 + (1.0 - 1e-4) * np.column_stack([np.cos(theta), np.sin(theta)])
    sample = new_sample(np.vstack([[6.0, 6.0], around]), np.full(neighbours + 1, 0.5), 12.0 * np.eye(2))
    sample.velocity[:] = [1e-9, 2e-9]
    sample.spin[0] = 3e-5 if neighbours == 0 else 0.0
    motion = Motion(sample, damping=0.06)
    motion.run(4)  # while those contacts last
    total = motion.sample.velocity.sum(axis=0)
    assert total == pytest.approx(len(sample.radius) * np.array([1e-9, 2e-9]), abs=1e-15)
    assert motion.energies()["drag"] == 0.0
    if neighbours == 0:
        assert motion.sample.spin[0] == 3e-5


def test_no_attraction_between_separating_disks():
    sample = two_disks(1e-9)
    sample.velocity[:] = [[-1e-8, 0.0], [1e-8, 0.0]]
    motion = Motion(sample, damping=0.0)
    motion.run(50)
    assert motion.sample.velocity[:, 0] == pytest.approx([-1e-8, 1e-8], rel=1e-15)
    assert not motion.sample.pairs.tangential.any()
