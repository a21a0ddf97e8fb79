"""Lengths and areas of groups against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from granfabric.fem.discretisation.space import Space
from granfabric.fem.mesh.host_mesh import rectangle
from granfabric.fem.mesh.shapes import mapped_grid, quarter_ring
from granfabric.fem.mesh.summary import cell_areas, groups, side_lengths


@pytest.mark.parametrize("cell", ["triangle", "quad"])
def test_a_rectangle(cell):
    found = {group.name: group for group in groups(rectangle(3.0, 2.0, 4, 5, cell))}
    assert {name: group.size for name, group in found.items()} == pytest.approx(
        {"bottom": 3.0, "right": 2.0, "top": 3.0, "left": 2.0, "all": 6.0}
    )
    assert len(found["bottom"].index) == 4 and len(found["all"].index) == (40 if cell == "triangle" else 20)


@pytest.mark.parametrize("cell", ["triangle", "quad"])
def test_a_ring_with_curved_and_with_straight_sides(cell):
    host = quarter_ring(1.0, 2.0, 3, 4, cell)
    curved, straight = ({group.name: group.size for group in groups(host, kind)} for kind in (True, False))
    # parabolas through three points of an arc of 22.5 degrees
    assert curved["inner"] == pytest.approx(np.pi / 2, rel=5e-5) and curved["outer"] == pytest.approx(np.pi, rel=5e-5)
    assert curved["all"] == pytest.approx(0.75 * np.pi, rel=5e-5)
    assert straight["inner"] == pytest.approx(8 * np.sin(np.pi / 16), rel=1e-12)
    assert straight["all"] == pytest.approx(4 * 0.5 * np.sin(np.pi / 8) * 3.0, rel=1e-12)
    assert curved["bottom"] == straight["bottom"] == pytest.approx(1.0)


@pytest.mark.parametrize("cell", ["triangle", "quad"])
def test_areas_and_lengths_are_those_that_the_host_integrates(cell):
    """Bent sides inside and outside, either way round."""
    host = mapped_grid(
        lambda s, t: (s + 0.1 * np.sin(3 * t), 2 * t + 0.15 * np.sin(4 * s + t)), 4, 3, cell, ("w", "e", "s", "n")
    )
    space = Space(host, "P2" if cell == "triangle" else "Q2", 8)
    integrated = space.weights.reshape(space.nelements, -1).sum(axis=1)
    np.testing.assert_allclose(cell_areas(host), integrated, rtol=1e-12)
    for name in ("w", "e", "s", "n"):
        force = space.traction_vector(name, lambda x, y, nx, ny: np.stack([np.ones_like(x), 0 * x], axis=1))
        assert force[0::2].sum() == pytest.approx(side_lengths(host)[host.boundaries[name]].sum(), rel=1e-5)
    flat = Space(host, "P1" if cell == "triangle" else "Q1")
    np.testing.assert_allclose(
        cell_areas(host, curved=False), flat.weights.reshape(flat.nelements, -1).sum(axis=1), rtol=1e-12
    )
