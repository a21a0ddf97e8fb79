"""Radial return in plane strain: closed forms, tangent, contract."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from granfabric.constitutive.contract import Law, Status
from granfabric.constitutive.plain_laws.von_mises import VonMisesLaw, VonMisesMaterial

E, NU, YIELD, H = 1000.0, 0.3, 1.5, 10.0
G = E / (2 * (1 + NU))
LAW = VonMisesLaw(VonMisesMaterial(E, NU, YIELD, H))


def call(increment, stress, state, law=LAW, kind="propagated", index=None):
    n = len(increment)
    end, state_end = np.full((n, 3), np.nan), np.full((n, 2), np.nan)
    tangent = np.full((n, 3, 3), np.nan)
    report = law.update(increment, stress, state, end, state_end, tangent, kind, index)
    return end, state_end, tangent, report


def some_points(n, seed=3):
    """Points inside, near and beyond first yield, with a history behind them."""
    rng = np.random.default_rng(seed)
    stress, state = np.zeros((n, 3)), np.zeros((n, 2))
    stress, state, _, _ = call(2e-3 * rng.standard_normal((n, 3)), stress, state)
    return 2e-3 * rng.standard_normal((n, 3)), stress, state


def equivalent(stress, state):
    sxx, syy, sxy, szz = stress[:, 0], stress[:, 1], stress[:, 2], state[:, 0]
    mean = (sxx + syy + szz) / 3
    return np.sqrt(1.5 * ((sxx - mean) ** 2 + (syy - mean) ** 2 + (szz - mean) ** 2 + 2 * sxy**2))


def test_obeys_the_contract():
    assert isinstance(LAW, Law)
    assert LAW.description.columns("plastic_strain") == slice(1, 2)


def test_pure_shear_closed_form():
    # q = sqrt(3) G gamma in the trial; alpha = (q - yield)/(3 G + H); tau = (yield + H alpha)/sqrt(3).
    gamma = np.array([1e-4, 5e-3, 5e-2])
    increment = np.zeros((3, 3))
    increment[:, 2] = gamma
    stress, state, _, _ = call(increment, np.zeros((3, 3)), np.zeros((3, 2)))
    alpha = np.maximum(0.0, (np.sqrt(3) * G * gamma - YIELD) / (3 * G + H))
    tau = np.where(alpha > 0, (YIELD + H * alpha) / np.sqrt(3), G * gamma)
    np.testing.assert_allclose(stress[:, 2], tau, rtol=1e-13)
    np.testing.assert_allclose(state[:, 1], alpha, rtol=1e-13, atol=1e-18)
    assert alpha[0] == 0.0 < alpha[1]


def test_end_states_lie_within_the_yield_surface_and_plastic_ones_on_it():
    increment, stress, state = some_points(500)
    end, state_end, _, _ = call(increment, stress, state)
    strength = YIELD + H * state_end[:, 1]
    q = equivalent(end, state_end)
    plastic = state_end[:, 1] > state[:, 1]
    assert 50 < plastic.sum() < 500
    np.testing.assert_allclose(q[plastic], strength[plastic], rtol=1e-12)
    assert (q <= strength * (1 + 1e-12)).all()
    # Plastic flow keeps the volume: the mean stress is elastic.
    bulk = E / (3 * (1 - 2 * NU))
    mean = (end[:, 0] + end[:, 1] + state_end[:, 0]) / 3 - (stress[:, 0] + stress[:, 1] + state[:, 0]) / 3
    np.testing.assert_allclose(mean, bulk * (increment[:, 0] + increment[:, 1]), rtol=1e-9, atol=1e-12)


def test_tangent_taylor_remainder_has_slope_two():
    increment, stress, state = some_points(200)
    rng = np.random.default_rng(8)
    direction = rng.standard_normal((200, 3))
    end, state_end, tangent, _ = call(increment, stress, state)
    plastic = state_end[:, 1] > state[:, 1] + 1e-4
    assert plastic.sum() > 20
    sizes = 1e-4 * 0.5 ** np.arange(6)
    remainders = []
    for size in sizes:
        moved, _, _, _ = call(increment + size * direction, stress, state)
        linear = end + size * np.einsum("pij,pj->pi", tangent, direction)
        remainders.append(np.linalg.norm((moved - linear)[plastic]))
    slopes = np.diff(np.log(remainders)) / np.diff(np.log(sizes))
    assert slopes == pytest.approx(2.0, abs=0.1)


def test_elastic_tangent_on_request():
    increment, stress, state = some_points(20)
    tangent = call(increment, stress, state, kind="elastic")[2]
    assert tangent[:, 2, 2] == pytest.approx(G, rel=1e-14)
    assert tangent[:, 0, 0] - tangent[:, 0, 1] == pytest.approx(2 * G, rel=1e-13)


def test_batch_equals_singles_and_threads_do_not_matter():
    increment, stress, state = some_points(64)
    batch = call(increment, stress, state)
    for i in range(0, 64, 9):
        single = call(increment[i : i + 1], stress[i : i + 1], state[i : i + 1])
        for whole, one in zip(batch[:3], single[:3]):
            np.testing.assert_array_equal(whole[i], one[0])
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        alone = call(increment, stress, state)
    finally:
        numba.set_num_threads(before)
    for whole, one in zip(batch[:3], alone[:3]):
        np.testing.assert_array_equal(whole, one)


def test_zero_increment_changes_nothing_to_the_last_bit():
    _, stress, state = some_points(200)
    end, state_end, tangent, _ = call(np.zeros((200, 3)), stress, state)
    np.testing.assert_array_equal(end, stress)
    np.testing.assert_array_equal(state_end[:, 1], state[:, 1])
    assert np.isfinite(tangent).all()


def test_start_arrays_are_not_written_and_bad_input_is_a_status():
    increment, stress, state = some_points(10)
    increment[4, 1] = np.inf
    stress_before, state_before = stress.copy(), state.copy()
    end, state_end, _, report = call(increment, stress, state)
    np.testing.assert_array_equal(stress, stress_before)
    np.testing.assert_array_equal(state, state_before)
    np.testing.assert_array_equal(end[4], stress[4])
    np.testing.assert_array_equal(state_end[4], state[4])
    assert report.failed == 1 and report.worst_point == 4 and report.status[4] == Status.NOT_FINITE


def test_initial_state_is_plane_strain_elastic():
    state = LAW.initial_state(np.array([[-1.0, -2.0, 0.5]]))
    np.testing.assert_allclose(state, [[NU * -3.0, 0.0]])
