"""Small packings for tests of grains at integration points."""

from __future__ import annotations

from functools import cache

import numpy as np

from granfabric.cases.grains.law import GrainsLaw
from granfabric.dem_ref.dynamics.packing import PackingOptions
from granfabric.dem_ref.inputs.probes import settled
from granfabric.dem_ref.measures.contacts import love_weber_stress
from granfabric.dem_ref.preparation.compaction import make_packing

PRESSURE = 1e5
SHEAR = np.array([3e-6, -1e-5, 4e-6])
"""A strain increment: xx, yy, engineering xy."""


@cache
def packings(disks=60, count=3):
    """At rest under `PRESSURE`; not to be changed."""
    return tuple(settled(make_packing(disks, seed, PackingOptions())) for seed in range(count))


def law(**options):
    return GrainsLaw(list(packings()), **options)


def start(law, points=3):
    """Stress and state of points before any loading, read only as a host's may be."""
    stress = np.array([love_weber_stress(packings()[point % 3]) for point in range(points)])
    state = law.initial_state(stress)
    stress.flags.writeable = state.flags.writeable = False
    return stress, state


def call(law, increment, stress, state, tangent=True, kind="propagated"):
    """End stress, end state, tangent and report of one call."""
    increment = np.broadcast_to(increment, stress.shape)
    stress_end, state_end = np.full_like(stress, np.nan), np.full_like(state, np.nan)
    derivative = np.full((len(stress), 3, 3), np.nan) if tangent else None
    report = law.update(increment, stress, state, stress_end, state_end, derivative, kind)
    return stress_end, state_end, derivative, report
