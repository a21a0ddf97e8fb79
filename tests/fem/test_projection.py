"""Projection from integration points to nodes."""

from __future__ import annotations

import numpy as np
import pytest
from fem_meshes import ELEMENTS, cell_of, distorted

from granfabric.fem.discretisation.projection import Projection
from granfabric.fem.discretisation.space import Space
from granfabric.fem.mesh.host_mesh import rectangle


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("n", [2, 5])
def test_linear_fields_are_reproduced_on_distorted_meshes(element, n):
    space = Space(distorted(element, n), element)

    def field(x):
        return np.column_stack([1.0 + 2.0 * x[:, 0] - 3.0 * x[:, 1], x[:, 0], np.full(len(x), 7.0)])

    nodal = Projection(space)(field(space.points))
    np.testing.assert_allclose(nodal, field(space.nodes), rtol=0, atol=1e-11)


@pytest.mark.parametrize("element", ELEMENTS)
def test_error_of_a_smooth_field_falls_with_order_two(element):
    errors, sizes = [], (8, 16, 32)
    for n in sizes:
        space = Space(rectangle(1.0, 1.0, n, n, cell_of(element)), element)
        nodal = Projection(space)(np.sin(3 * space.points[:, 0]) * np.cos(2 * space.points[:, 1]))
        exact = np.sin(3 * space.nodes[:, 0]) * np.cos(2 * space.nodes[:, 1])
        errors.append(np.sqrt(np.mean((nodal - exact) ** 2)))
    slope = -np.diff(np.log(errors)) / np.diff(np.log(sizes))
    assert (slope > 1.8).all()


def test_one_triangle_with_one_point_gives_its_constant():
    space = Space(rectangle(1.0, 1.0, 1, 1), "P1")
    assert space.npoints == 2
    nodal = Projection(space)(np.full((2, 1), 4.0))
    np.testing.assert_allclose(nodal, 4.0, rtol=1e-12)
