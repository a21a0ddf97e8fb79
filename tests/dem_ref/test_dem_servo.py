"""The servo: paths are followed, limits are kept, targets are reached, bad input is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from granfabric.dem_ref.dynamics.motion import Motion
from granfabric.dem_ref.loading.legs import (
    axial_stress_ratio,
    biaxial_leg,
    from_vector,
    invariant_leg,
    mixed_leg,
    stress_from_invariants,
    stress_invariants,
    stress_leg,
    to_vector,
)
from granfabric.dem_ref.loading.servo import Loading, RateLimits
from granfabric.dem_ref.measures.contacts import love_weber_stress
from granfabric.dem_ref.sample.disks import Sample, SampleError

P = 1e5


def follow(sample: Sample, legs, limits: RateLimits | None = None):
    """Stress, strain, inertial number and unbalanced force after every chunk."""
    motion = Motion(sample.copy())
    motion.stress[:] = love_weber_stress(motion.sample)
    rows = []

    def note(loading: Loading) -> None:
        state = loading.state
        rows.append([*motion.stress, *motion.sample.strain, state.inertial_number, state.unbalanced_force])

    for leg in legs:
        assert Loading(motion, leg, limits).run(500_000, note)
    return motion, np.array(rows)


@given(st.floats(0.1, 10), st.floats(0, 0.99), st.floats(-1.5, 1.5))
@settings(max_examples=100, deadline=None)
def test_invariants_and_back(p, ratio, angle):
    stress = stress_from_invariants(p, ratio * p, angle)
    back = stress_invariants(stress)
    assert back[:2] == pytest.approx((p, ratio * p), abs=1e-12 * p)
    if ratio > 1e-3:
        assert np.exp(2j * back[2]) == pytest.approx(np.exp(2j * angle), abs=1e-9)
        assert axial_stress_ratio(stress, angle) == pytest.approx(ratio, abs=1e-12)
    assert from_vector(to_vector(stress)) == pytest.approx(stress)


@pytest.mark.parametrize("path", ["constant_pressure", "constant_lateral_stress"])
@pytest.mark.parametrize("angle", [np.pi / 2, 0.3])
def test_biaxial_path_keeps_what_it_promises(packing, path, angle):
    limits = RateLimits()
    motion, rows = follow(packing, [biaxial_leg(path, 5e-3, 0.2, angle)], limits)
    c, s = np.cos(2 * angle), np.sin(2 * angle)
    mean = 0.5 * (rows[:, 0] + rows[:, 1])
    deviator = 0.5 * (rows[:, 0] - rows[:, 1]) * c + rows[:, 2] * s
    across = -0.5 * (rows[:, 0] - rows[:, 1]) * s + rows[:, 2] * c
    kept = mean if path == "constant_pressure" else mean - deviator
    assert np.abs(kept + P).max() < 1e-3 * P
    assert np.abs(across).max() < 1e-3 * P
    assert 0.2 <= axial_stress_ratio(motion.stress, angle) < 0.21
    assert rows[:, 6].max() <= 1.05 * limits.inertial_number
    # the rate reacts one chunk late
    assert rows[:, 7].max() <= 1.5 * limits.unbalanced_force


def test_limits_slow_the_loading_down(packing):
    leg = biaxial_leg("constant_pressure", 5e-3, 0.1)
    fast, _ = follow(packing, [leg])
    slow, rows = follow(packing, [leg], RateLimits(inertial_number=1e-6))
    assert rows[:, 6].max() <= 1.05e-6
    assert slow.steps_done > 5 * fast.steps_done
    calm, rows = follow(packing, [leg], RateLimits(unbalanced_force=5e-5))
    assert rows[:, 7].max() <= 1.5 * 5e-5
    assert calm.steps_done > fast.steps_done


def test_stress_path_is_straight_and_reaches_its_target(packing):
    target = [-1.05e5, -1.15e5, 0.04e5]
    motion, rows = follow(packing, [stress_leg(target)])
    assert motion.stress == pytest.approx(target, abs=1e-3 * P)
    start = love_weber_stress(packing)
    way = np.asarray(target) - start
    along = (rows[:, :3] - start) @ way / (way @ way)
    apart = rows[:, :3] - start - along[:, None] * way
    assert np.abs(apart).max() < 5e-3 * P
    assert np.all(np.diff(along) > -2e-2)


def test_isotropic_compression_has_no_deviator(packing):
    motion, rows = follow(packing, [invariant_leg(1.3 * P, 0.0, 0.0)])
    assert motion.stress == pytest.approx([-1.3e5, -1.3e5, 0.0], abs=1e-3 * P)
    assert np.abs(rows[:, 0] - rows[:, 1]).max() < 5e-3 * P
    assert motion.sample.strain[:2].sum() < 0.0


def test_principal_axes_turn_at_constant_stress_ratio(packing):
    load = invariant_leg(P, 0.15 * P, np.pi / 2)
    turn = [invariant_leg(P, 0.15 * P, np.pi / 2 + a) for a in (np.pi / 4, np.pi / 2)]
    _, before = follow(packing, [load])
    motion, rows = follow(packing, [load, *turn])
    assert axial_stress_ratio(motion.stress, np.pi) == pytest.approx(0.15, abs=2e-3)
    turning = rows[len(before) :]
    ratio = np.array([stress_invariants(r[:3])[1] / stress_invariants(r[:3])[0] for r in turning])
    assert np.abs(ratio - 0.15).max() < 6e-3
    angles = np.unwrap([2 * stress_invariants(r[:3])[2] for r in turning]) / 2
    assert angles[-1] - angles[0] == pytest.approx(np.pi / 2, abs=0.05)


def test_mixed_control_reaches_strain_and_stress(packing):
    motion, _ = follow(packing, [mixed_leg(("stress", "strain", "strain"), (-P, -2e-5, 1e-5))])
    assert motion.stress[0] == pytest.approx(-P, rel=1e-3)
    assert motion.sample.strain[1] == pytest.approx(-2e-5, rel=1e-6)
    assert motion.sample.strain[2] == pytest.approx(0.5e-5, rel=1e-6)  # engineering shear strain asked for


def test_pure_strain_path_follows_the_homogeneous_deformation(packing):
    motion, _ = follow(packing, [mixed_leg(("strain", "strain", "strain"), (1e-5, -2e-5, 3e-5))])
    sample = motion.sample
    assert sample.strain == pytest.approx([1e-5, -2e-5, 1.5e-5], rel=1e-6)
    deformation = np.linalg.inv(packing.cell) @ sample.cell - np.eye(2)
    assert deformation == pytest.approx(np.array([[1e-5, 1.5e-5], [1.5e-5, -2e-5]]), abs=1e-9)


def test_a_weak_sample_stops_short_instead_of_flowing_for_ever(packing):
    """q/p = 0.9 is beyond any packing with mu = 0.5: the strain limit ends the leg."""
    motion, _ = follow(packing.copy(), [biaxial_leg("constant_pressure", 3e-4, 0.9)])
    assert axial_stress_ratio(motion.stress, np.pi / 2) < 0.6
    assert motion.sample.strain[0] - motion.sample.strain[1] == pytest.approx(3e-4, rel=1e-3)


def test_bad_legs_and_limits_are_refused(packing):
    with pytest.raises(SampleError, match="constant_presure"):
        biaxial_leg("constant_presure", 1e-3)
    with pytest.raises(SampleError, match="p > q"):
        invariant_leg(1.0, 2.0, 0.0)
    with pytest.raises(SampleError, match="three of 'stress', 'strain'"):
        mixed_leg(("stress", "strain", "force"), (0, 0, 0))
    with pytest.raises(SampleError, match="three finite numbers"):
        stress_leg([1.0, np.nan, 0.0])
    with pytest.raises(SampleError, match="inertial_number"):
        Loading(Motion(packing.copy()), stress_leg([-P, -P, 0.0]), RateLimits(inertial_number=0.0))
