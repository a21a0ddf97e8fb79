"""Estimate of the discretisation error from the stresses."""

from __future__ import annotations

import numpy as np
import pytest
from fem_meshes import ELEMENTS, cell_of, distorted
from fem_patches import corner_fractions, fit, graded

from granfabric.fem.discretisation import mesh_error
from granfabric.fem.discretisation.mesh_error import stress_error
from granfabric.fem.discretisation.space import Space
from granfabric.fem.mesh.host_mesh import rectangle


def polynomial(x: np.ndarray, order: int, sign: float = 1.0) -> np.ndarray:
    """Stress of the given order in x and y."""
    square = (order - 1) * np.column_stack([x[:, 0] ** 2, x[:, 0] * x[:, 1], -2.0 * x[:, 1] ** 2])
    return sign * (np.column_stack([1.0 + 2.0 * x[:, 0] - 3.0 * x[:, 1], x[:, 0], np.full(len(x), 7.0)]) + square)


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("n", [3, 6])
def test_polynomials_of_the_order_of_the_element_have_no_error(element, n):
    """On distorted meshes, corners and sides included."""
    space = Space(distorted(element, n), element)
    found = stress_error(space, polynomial(space.points, space.order))
    assert found.relative < 1e-11 and found.of_cells.shape == (space.nelements,)


@pytest.mark.parametrize("element", ELEMENTS)
def test_materials_have_patches_of_their_own(element):
    """A jump between two materials is no error; without being told of them it is a large one."""
    space = Space(distorted(element, 6), element)
    upper = (space.points[:, 1] > 0.5).reshape(space.nelements, -1).mean(axis=1) > 0.5
    sign = np.where(np.repeat(upper, space.points_per_cell), 1.0, -10.0)
    stress = polynomial(space.points, space.order) * sign[:, None]
    assert stress_error(space, stress, upper.astype(int)).relative < 1e-10
    whole = stress_error(space, stress)
    assert whole.relative > 0.05
    assert np.sum(whole.of_cells**2) == pytest.approx(whole.relative**2)
    # what is far from the jump has no part in it
    centre = space.points[:, 1].reshape(space.nelements, -1).mean(axis=1)
    assert whole.of_cells[np.abs(centre - 0.5) > 0.4].max() < 1e-10


@pytest.mark.parametrize("element", ELEMENTS)
def test_a_single_cell_and_no_stress(element):
    space = Space(rectangle(1.0, 1.0, 1, 1, cell_of(element)), element)
    assert stress_error(space, np.zeros((space.npoints, 3))).relative == 0.0
    assert stress_error(space, np.full((space.npoints, 3), 3.0)).relative < 1e-12


@pytest.mark.parametrize("element", ELEMENTS)
def test_smooth_stresses_are_recovered_with_one_order_more(element):
    """What is added to a smooth field at random, cell by cell, is found; the field itself falls with order + 1."""
    errors, sizes = [], (8, 16, 32)
    for n in sizes:
        space = Space(rectangle(1.0, 1.0, n, n, cell_of(element)), element)
        x, y = 3.0 * space.points.T
        smooth = np.column_stack([np.sin(x) * np.cos(y), np.cos(x + y), np.sin(2 * x)])
        errors.append(stress_error(space, smooth).relative)
        rough = np.repeat(np.random.default_rng(n).normal(size=(space.nelements, 3)), space.points_per_cell, axis=0)
    slope = -np.diff(np.log(errors)) / np.diff(np.log(sizes))
    assert (slope > space.order + 0.6).all()
    # noise of a tenth is mostly seen: a patch of six cells keeps a part of it
    added = 0.1 * np.linalg.norm(rough) / np.linalg.norm(smooth)
    assert 0.5 * added < stress_error(space, smooth + 0.1 * rough).relative < added


def blended(space: Space, stress: np.ndarray) -> np.ndarray:
    """Recovered stress, vertex by vertex and point by point."""
    corners, fractions = space.host_mesh.mesh.t.T, corner_fractions(space)
    recovered = np.zeros_like(stress)
    for vertex in range(space.host_mesh.mesh.p.shape[1]):
        cells = np.flatnonzero((corners == vertex).any(axis=1))
        polynomial, determined = fit(space, cells, stress, space.order, least=1e-4)
        while not determined:
            around = np.unique(corners[cells])
            cells = np.flatnonzero(np.isin(corners, around).any(axis=1))
            polynomial, determined = fit(space, cells, stress, space.order, least=1e-4)
        for place in range(corners.shape[1]):
            own = corners[space.point_cell, place] == vertex
            recovered[own] += fractions[own, place, None] * polynomial(space.points[own])
    return recovered


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("mesh", [distorted, graded])
def test_the_estimate_against_patches_written_out(element, mesh):
    """Any stress, so that the patches differ and every blending function, weight and term tells."""
    space = Space(mesh(element, 4), element)
    x, y = space.points.T
    smooth = np.stack([x**2, x * y**2, np.sin(4 * x)], axis=1)
    stress = smooth + np.random.default_rng(3).normal(size=(space.npoints, 3))
    found = stress_error(space, stress)
    recovered = blended(space, stress)
    whole = _norm(space, recovered)
    assert found.relative == pytest.approx(_norm(space, recovered - stress) / whole, rel=1e-8)
    for cell in range(space.nelements):
        own = space.point_cell == cell
        fraction = np.sqrt(space.weights[own] @ np.sum((recovered - stress)[own] ** 2, axis=1)) / whole
        assert found.of_cells[cell] == pytest.approx(fraction, rel=1e-8)


def _norm(space: Space, values: np.ndarray) -> float:
    return float(np.sqrt(space.weights @ np.sum(values**2, axis=1)))


@pytest.mark.parametrize("element", ELEMENTS)
def test_blending_functions_belong_to_their_corners(element):
    """They add up to one, and corners weighted with them give the integration points back."""
    space = Space(rectangle(2.0, 1.0, 3, 2, cell_of(element)), element)
    hats = mesh_error._Patches(space, None)._hats()
    corners = space.host_mesh.mesh.p.T[space.host_mesh.mesh.t.T]
    places = np.einsum("qc,eci->eqi", hats, corners).reshape(-1, 2)
    np.testing.assert_allclose(places, space.points, atol=1e-14)
    np.testing.assert_allclose(hats.sum(axis=1), 1.0, atol=1e-14)
