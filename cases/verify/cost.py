"""What one update of a point costs, closure by closure."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np

from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure

from .model_side import material

POINTS = 2000
REPEATS = 5
STRAIN = 2e-6


def microseconds_per_update(closure: Closure, inputs: Mapping[str, float]) -> float:
    """Processor time of a strain-driven update with its tangent, at q/p of about 0.1; least of several batches."""
    law = ContactLaw([material(inputs)], closure=closure)
    rng = np.random.default_rng(1)
    stress = np.tile([-0.9e5, -1.1e5, 0.0], (POINTS, 1))
    state = law.initial_state(stress)
    increment = rng.uniform(-STRAIN, STRAIN, (POINTS, 3))
    stress_end, state_end, tangent = np.empty_like(stress), np.empty_like(state), np.empty((POINTS, 3, 3))
    best = np.inf
    for _ in range(REPEATS):
        since = time.process_time()
        law.update(increment, stress, state, stress_end, state_end, tangent)
        best = min(best, time.process_time() - since)
    return best / POINTS * 1e6
