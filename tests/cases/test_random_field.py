"""Random fields: moments and correlation over many seeds, the same function on every mesh."""

from __future__ import annotations

import numpy as np
import pytest

from granfabric.cases.field.local_fit import local_fit
from granfabric.cases.field.random_field import random_field

LENGTHS = (0.02, 0.005)
SEEDS = 400


@pytest.mark.parametrize("correlation", ["gaussian", "exponential"])
def test_moments_and_correlation(correlation: str) -> None:
    """Over N seeds a mean of unit variance scatters by 1/sqrt(N), a mean product by at most sqrt(2/N); 4 of them."""
    distance = np.array([0.0, 0.25, 0.5, 1.0, 2.0])
    points = np.concatenate([distance[:, None] * [LENGTHS[0], 0], distance[1:, None] * [0, LENGTHS[1]]])
    samples = np.array([random_field(points, seed, LENGTHS, correlation) for seed in range(SEEDS)])
    assert np.abs(samples.mean(axis=0)).max() < 4 / np.sqrt(SEEDS)
    found = (samples * samples[:, :1]).mean(axis=0)
    lag = np.concatenate([distance, distance[1:]])
    wanted = np.exp(-(lag**2)) if correlation == "gaussian" else np.exp(-lag)
    np.testing.assert_allclose(found, wanted, atol=4 * np.sqrt(2 / SEEDS))
    # Normal: kurtosis 3 within 4 sqrt(24/N), the values at one place being independent over seeds.
    assert abs((samples[:, 0] ** 4).mean() / (samples[:, 0] ** 2).mean() ** 2 - 3) < 4 * np.sqrt(24 / SEEDS)


def test_a_value_depends_on_seed_and_place_alone() -> None:
    points = np.random.default_rng(1).uniform(0, 0.1, (50, 2))
    whole = random_field(points, 7, LENGTHS, "gaussian")
    np.testing.assert_array_equal(whole, random_field(points, 7, LENGTHS, "gaussian"))
    np.testing.assert_allclose(random_field(points[20:23], 7, LENGTHS, "gaussian"), whole[20:23], rtol=1e-12)
    assert np.abs(random_field(points, 8, LENGTHS, "gaussian") - whole).max() > 0.5


def test_local_fit_is_exact_for_quadratic_fields_also_outside() -> None:
    generator = np.random.default_rng(2)
    known = generator.uniform(0, 1, (300, 2))

    def field(place: np.ndarray) -> np.ndarray:
        x, y = place.T
        return np.stack([1 + 2 * x - y + 3 * x * x - x * y + 0.5 * y * y, x - y], axis=1)

    wanted = np.array([[0.5, 0.5], [0.0, 0.3], [1.02, 0.98]])
    np.testing.assert_allclose(local_fit(known, field(known), wanted), field(wanted), rtol=1e-9, atol=1e-12)
