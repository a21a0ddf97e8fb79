"""A point's result is its own: to the last bit the same alone, in any order, batch, block of lanes or thread."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from contact_law_cases import ALL_CLOSURES, PRESSURE, anisotropic_stress, closure_name, material

from granfabric.constitutive.contract import Status
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.integration.runge_kutta import TABLEAUS
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Integration

NUMBER = 41
MATERIALS = [
    material(),
    material(initial_fabric_xx=0.12, initial_fabric_xy=-0.2, gap_density_at_zero=60.0, force_density_slope=-2.0),
]
"""The line of forces of the second ends at a quarter of the mean force: some of its points reach that, some do not."""


class Batch:
    """Points of two materials, some at rest, some refused at once, some that fail on the way, some that go far."""

    def __init__(self, law: ContactLaw, control: np.ndarray, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.law, self.control = law, control
        self.material = rng.integers(0, 2, NUMBER).astype(np.int32)
        self.stress = anisotropic_stress(rng, NUMBER, 0.25)
        self.state = law.initial_state(self.stress, self.material)
        size = 10.0 ** rng.uniform(-8, -4.5, (NUMBER, 1))
        self.given = rng.uniform(-1, 1, (NUMBER, 3)) * size * np.where(control == 1, 2e8, 1.0)
        self.given[[4, 19]] = 0.0
        self.stress[7], self.state[11, 0], self.given[23, 1] = 0.0, -1.0, np.nan
        self.given[30] = np.where(control[30] == 1, 3 * PRESSURE, 4e-3)  # lets go of the grains

    def update(self, points: np.ndarray) -> tuple[np.ndarray, ...]:
        """End values of some of them, in that order."""
        stress, state = self.stress[points], self.state[points]
        end, after = np.full_like(stress, np.nan), np.full_like(state, np.nan)
        more, given, material = np.full((len(points), 3, 3), np.nan), self.given[points], self.material[points]
        if self.control.any():
            more = np.full_like(stress, np.nan)
            report = self.law.update_mixed(self.control[points], given, stress, state, end, after, more, material)
        else:
            report = self.law.update(given, stress, state, end, after, more, "propagated", material)
        return end, after, more, report.status, report.substeps, report.rejected, report.evaluations


@pytest.mark.parametrize("kind", ["strain", "mixed"])
@pytest.mark.parametrize("sliding", [False, True], ids=["", "sliding"])
@pytest.mark.parametrize("closure", ALL_CLOSURES, ids=closure_name)
@pytest.mark.parametrize("integrator", ["bogacki_shampine", "kennedy_carpenter"])
def test_alone_and_in_any_company(closure, sliding, kind, integrator):
    law = ContactLaw(
        MATERIALS, closure, Effects(sliding=sliding), Integration(integrator=integrator, maximum_substeps=300)
    )
    rng = np.random.default_rng(3)
    control = rng.integers(0, 2, (NUMBER, 3)).astype(np.uint8) * np.uint8(kind == "mixed")
    batch = Batch(law, control, seed=8)
    everyone = np.arange(NUMBER)
    whole = batch.update(everyone)
    assert {Status.OK, Status.NO_PRESSURE, Status.NOT_ADMISSIBLE, Status.NOT_FINITE} <= set(whole[3])
    assert (whole[3] <= Status.LIMITED).sum() > NUMBER / 2 and whole[4].max() > 3
    order = rng.permutation(NUMBER)
    for part in (order, everyone[::-1], everyone[5:23], everyone[7:8], *everyone[:, None][::4]):
        for one, other in zip(batch.update(part), whole, strict=True):
            np.testing.assert_array_equal(one, other[part])


@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one thread only")
@pytest.mark.parametrize("closure", [ALL_CLOSURES[1], ALL_CLOSURES[6]], ids=closure_name)
def test_in_threads(closure):
    """Many copies of the batch: threads share them out by blocks, which then hold others."""
    law = ContactLaw(MATERIALS, closure, Effects(sliding=True), Integration(maximum_substeps=300))
    batch = Batch(law, np.zeros((NUMBER, 3), dtype=np.uint8), seed=8)
    once, copies = batch.update(np.arange(NUMBER)), 30
    before = numba.get_num_threads()
    try:
        for threads in (1, 2):
            numba.set_num_threads(threads)
            many = batch.update(np.tile(np.arange(NUMBER), copies))
            for one, other in zip(many, once, strict=True):
                np.testing.assert_array_equal(one, np.concatenate([other] * copies))
    finally:
        numba.set_num_threads(before)


@pytest.mark.parametrize("integrator", TABLEAUS)
def test_with_fixed_substeps(integrator):
    """Failures end a point's substeps, not those of others."""
    law = ContactLaw(MATERIALS, ALL_CLOSURES[6], None, Integration(integrator=integrator, substeps=3))
    batch = Batch(law, np.zeros((NUMBER, 3), dtype=np.uint8), seed=2)
    whole = batch.update(np.arange(NUMBER))
    for i in range(0, NUMBER, 5):
        for one, other in zip(batch.update(np.array([i])), whole, strict=True):
            np.testing.assert_array_equal(one, other[i : i + 1])
