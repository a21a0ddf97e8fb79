"""Packings shared by the tests of the DEM; small, made once a session."""

from __future__ import annotations

import pytest

from granfabric.dem_ref.dynamics.packing import make_packing
from granfabric.dem_ref.sample.disks import Sample


@pytest.fixture(scope="session")
def packing() -> Sample:
    """600 disks, seed 1; tests must copy it before they change it."""
    return make_packing(600, 1)


@pytest.fixture(scope="session")
def large_packing() -> Sample:
    """2,000 disks, seed 1."""
    return make_packing(2000, 1)
