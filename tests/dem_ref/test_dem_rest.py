"""Inputs are measured on a packing at rest, whatever is handed in."""

from __future__ import annotations

import numpy as np
import pytest

from granfabric.dem_ref.dynamics.motion import Motion
from granfabric.dem_ref.dynamics.packing import make_packing
from granfabric.dem_ref.ensemble import stored_packing
from granfabric.dem_ref.inputs.material import measure_material
from granfabric.dem_ref.inputs.probes import (
    AT_REST,
    at_rest,
    elastic_moduli,
    elastic_probes,
    is_at_rest,
    shear_modulus,
    stress_probe,
)
from granfabric.dem_ref.inputs.weak_contacts import measure_slip, measure_weak_contacts
from granfabric.dem_ref.loading.legs import invariant_leg
from granfabric.dem_ref.loading.servo import Loading, RateLimits
from granfabric.dem_ref.measures.contacts import unbalanced_force
from granfabric.dem_ref.sample.disks import Sample, SampleError, save_sample


def shaken(sample: Sample, size: float) -> Sample:
    """Every disk moved by this much."""
    moved = sample.copy()
    moved.position += size * np.random.default_rng(3).normal(size=moved.position.shape)
    return moved


@pytest.fixture(scope="module")
def quiet() -> Sample:
    return make_packing(300, 1)


@pytest.fixture(scope="module")
def measured(quiet) -> dict[str, float]:
    return measure_material(quiet)


def test_a_packing_as_it_is_made_is_at_rest_and_stays_what_it_is(quiet):
    assert is_at_rest(quiet) and at_rest(quiet) is quiet


@pytest.mark.parametrize("size", [5e-8, 2e-7, 3e-6])
def test_a_restless_packing_gives_what_it_gives_at_rest(quiet, measured, size):
    """Measured as it is, an unbalanced force of 0.1 turns c_t from 0.77 into 1.2 and chi from 0.7 into -8."""
    restless = shaken(quiet, size)
    assert unbalanced_force(restless) > 10 * AT_REST
    before = restless.position.copy()
    found = measure_material(restless)
    assert np.array_equal(restless.position, before)
    assert found["tangential_force_ratio"] == pytest.approx(measured["tangential_force_ratio"], abs=0.015)
    assert found["weak_contact_ratio"] == pytest.approx(measured["weak_contact_ratio"], abs=0.1)
    assert found["shear_reduction"] == pytest.approx(measured["shear_reduction"], rel=0.02)
    assert found["coordination"] == pytest.approx(measured["coordination"], abs=0.03)


def test_every_entry_that_measures_waits_for_rest(quiet):
    restless = shaken(quiet, 1e-6)
    assert unbalanced_force(restless) > 0.01
    isotropic, shear = elastic_probes(restless)
    calm = elastic_probes(quiet)
    moduli, wanted = elastic_moduli(restless, isotropic, shear), elastic_moduli(quiet, *calm)
    assert moduli.shear_reduction == pytest.approx(wanted.shear_reduction, rel=0.02)
    assert moduli.bulk_reduction == pytest.approx(wanted.bulk_reduction, rel=0.02)
    weak, other = measure_weak_contacts(restless, isotropic, shear), measure_weak_contacts(quiet, *calm)
    assert weak.tangential_ratio == pytest.approx(other.tangential_ratio, abs=0.015)
    one, two = stress_probe(restless, 0.0, 200.0), stress_probe(quiet, 0.0, 200.0)
    assert one.strain_change[:2] == pytest.approx(two.strain_change[:2], rel=0.05)
    # in the direction of what deviator there is left, which is any: directions of so few disks differ by that
    assert shear_modulus(restless) == pytest.approx(shear_modulus(quiet), rel=0.15)
    assert measure_slip(restless).slip == pytest.approx(measure_slip(quiet).slip, rel=0.3)


def test_a_sample_in_the_middle_of_a_loading_is_not_measured_as_isotropic(quiet):
    motion = Motion(quiet.copy())
    Loading(motion, invariant_leg(1e5, 0.15e5, 0.0), RateLimits(1e-4, 1e-2)).run(2_000_000)
    with pytest.raises(SampleError, match=r"carries q/p = 0\.15.*isotropic"):
        measure_material(motion.sample)


def test_a_stored_packing_that_is_not_at_rest_is_made_anew(tmp_path):
    first = stored_packing(tmp_path, 100, 5)
    (file,) = tmp_path.iterdir()
    save_sample(file, shaken(first, 1e-6))
    assert np.array_equal(stored_packing(tmp_path, 100, 5).position, first.position)
