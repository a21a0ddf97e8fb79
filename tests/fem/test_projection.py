"""Projection from integration points to nodes."""

from __future__ import annotations

import numpy as np
import pytest
from fem_meshes import ELEMENTS, cell_of, distorted
from fem_patches import fit, graded

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


@pytest.mark.parametrize("element", ELEMENTS)
def test_values_at_vertices_are_linear_fits_weighted_by_area(element):
    """Any values on a graded mesh, vertex by vertex; a point of a large cell counts as much as its area."""
    space = Space(graded(element), element)
    values = np.random.default_rng(8).normal(size=(space.npoints, 2))
    nodal = Projection(space)(values)
    corners = space.host_mesh.mesh.t.T
    difference, checked = 0.0, 0
    for vertex, place in enumerate(space.host_mesh.mesh.p.T):
        cells = np.flatnonzero((corners == vertex).any(axis=1))
        line, determined = fit(space, cells, values, 1)
        if not determined or (element == "P1" and len(cells) < 4):
            continue  # a patch that is enlarged
        checked += 1
        np.testing.assert_allclose(nodal[vertex], line(place[None])[0], rtol=0, atol=1e-8, err_msg=str(place))
        plain = fit(space, cells, values, 1, weighted=False)[0](place[None])[0]
        difference = max(difference, float(np.abs(plain - nodal[vertex]).max()))
    assert checked > 15
    # and without the weights it would be something else
    assert difference > 0.05


@pytest.mark.parametrize("element", ["P2", "Q2"])
def test_nodes_between_vertices_take_their_mean(element):
    space = Space(graded(element), element)
    nodal = Projection(space)(np.random.default_rng(4).normal(size=space.npoints))
    vertices = space.host_mesh.mesh.p.shape[1]
    places = space.host_mesh.mesh.p.T
    for a, b in space.host_mesh.mesh.facets.T:
        node = np.argmin(np.linalg.norm(space.nodes - (places[a] + places[b]) / 2, axis=1))
        assert node >= vertices
        assert nodal[node] == pytest.approx((nodal[a] + nodal[b]) / 2, abs=1e-12)
    if element == "Q2":
        for cell, corners in enumerate(space.host_mesh.mesh.t.T):
            node = space.element_nodes[cell][-1]
            assert nodal[node] == pytest.approx(nodal[corners].mean(), abs=1e-12)


@pytest.mark.parametrize("element", ELEMENTS)
def test_linear_fields_are_reproduced_on_graded_meshes(element):
    space = Space(graded(element, 6, 2.5), element)
    field = np.array([[2.0, -3.0], [0.0, 0.0]])
    nodal = Projection(space)(space.points @ field.T + [1.0, 7.0])
    np.testing.assert_allclose(nodal, space.nodes @ field.T + [1.0, 7.0], rtol=0, atol=1e-10)


def test_a_corner_whose_cells_do_not_determine_a_line_takes_in_its_neighbours_by_area():
    """P1: a corner with one cell of one point. Constant fields come out, and the cells further away count by area."""
    space = Space(graded("P1"), "P1")
    recover = Projection(space)
    weights = recover(np.eye(space.npoints))
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-9)
    corners = space.host_mesh.mesh.t.T
    place = space.host_mesh.mesh.p.T
    found = False
    for vertex in range(len(place)):
        cells = np.flatnonzero((corners == vertex).any(axis=1))
        if len(cells) > 1:
            continue
        around = np.unique(corners[cells])
        cells = np.flatnonzero(np.isin(corners, around).any(axis=1))
        line, determined = fit(space, cells, np.eye(space.npoints), 1)
        assert determined
        np.testing.assert_allclose(weights[vertex], line(place[[vertex]])[0], atol=1e-6)
        found = True
    assert found
