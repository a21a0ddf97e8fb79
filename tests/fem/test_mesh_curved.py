"""Curved sides: areas, lengths and normals of circles, and the elements that need them."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest

from granfabric.fem.discretisation.projection import Projection
from granfabric.fem.discretisation.space import Space
from granfabric.fem.mesh.host_mesh import HostMesh, MeshError, build_mesh, read_mesh
from granfabric.fem.mesh.shapes import plate_with_hole, quarter_ring

ELEMENTS = [("triangle", "P1"), ("triangle", "P2"), ("quad", "Q1"), ("quad", "Q2")]


def ring(cell: str, cells: int) -> HostMesh:
    return quarter_ring(1.0, 2.0, cells, 2 * cells, cell)


def slope(errors: list[float]) -> float:
    """Last order of convergence when the cells are halved."""
    return float(np.log2(errors[-2] / errors[-1]))


@pytest.mark.parametrize(("cell", "element"), ELEMENTS)
def test_area_and_length_of_a_ring_converge(cell: str, element: str) -> None:
    """Chords err by h^2. Parabolas through three points of an arc err by h^4 in area and length."""
    area, length, moment = [], [], []
    for cells in (2, 4, 8):
        space = Space(ring(cell, cells), element, quadrature_degree=6)
        area.append(abs(space.weights.sum() - 3 * np.pi / 4))
        outward = space.traction_vector("outer", lambda x, y, nx, ny: np.stack([nx, ny], axis=1))
        along = space.traction_vector("inner", lambda x, y, nx, ny: np.stack([np.ones_like(x), 0 * x], axis=1))
        length.append(abs(along.sum() - np.pi / 2))
        # The integral of the normal is the chord turned by a right angle, whatever the curve between its ends.
        moment.append(np.abs(outward.reshape(-1, 2).sum(axis=0) - [2.0, 2.0]).max())
    wanted = 4.0 if element[1] == "2" else 2.0
    assert slope(area) == pytest.approx(wanted, abs=0.15)
    assert slope(length) == pytest.approx(wanted, abs=0.15)
    assert max(moment) < 1e-12


@pytest.mark.parametrize(("cell", "element"), ELEMENTS)
def test_linear_fields_pass_through_a_curved_mesh(cell: str, element: str) -> None:
    space = Space(ring(cell, 3), element)
    nodal = space.nodes @ np.array([[2.0], [-3.0]]) + 1.0
    exact = space.points @ np.array([[2.0], [-3.0]]) + 1.0
    np.testing.assert_allclose(space.interpolate(nodal), exact, rtol=1e-12)
    corners = space.host_mesh.mesh.p.shape[1]
    np.testing.assert_allclose(Projection(space)(exact)[:corners], nodal[:corners], rtol=1e-9)


@pytest.mark.parametrize("cell", ["triangle", "quad"])
def test_plate_with_hole(cell: str) -> None:
    mesh = plate_with_hole(1.0, 5.0, 4.0, 6, 8, cell)
    space = Space(mesh, "P2" if cell == "triangle" else "Q2", quadrature_degree=6)
    # Segment of a circle (a - sin a)/2 against that of the parabola, 2/3 chord times height: a^5/960 to leading order.
    arcs = np.repeat([np.arctan2(4.0, 5.0), np.arctan2(5.0, 4.0)], 4) / 4
    assert space.weights.sum() - (20.0 - np.pi / 4) == pytest.approx(np.sum(arcs**5) / 960, rel=0.01)
    assert set(mesh.boundaries) == {"hole", "right", "top", "bottom", "left"}
    for name, axis, value in (("right", 0, 5.0), ("top", 1, 4.0), ("bottom", 1, 0.0), ("left", 0, 0.0)):
        np.testing.assert_allclose(space.nodes[space.boundary_nodes(name), axis], value, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(space.nodes[space.boundary_nodes("hole")], axis=1), 1.0, rtol=1e-14)


def test_shapes_that_are_empty_are_refused() -> None:
    for make in (
        lambda: quarter_ring(2.0, 1.0, 2, 2, "quad"),
        lambda: plate_with_hole(2.0, 1.0, 3.0, 2, 2, "quad"),
        lambda: plate_with_hole(1.0, 3.0, 3.0, 2, 3, "quad"),
        lambda: quarter_ring(1.0, 2.0, 0, 2, "quad"),
        lambda: quarter_ring(1.0, 2.0, 2, 2, "hexagon"),
    ):
        with pytest.raises(MeshError):
            make()


def test_a_side_that_folds_its_element_is_refused() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    with pytest.raises(MeshError, match="folds over"):
        build_mesh(points, np.array([[0, 1, 2]]), sides=(np.array([[1, 0]]), np.array([[0.5, 0.6]])))


@pytest.mark.parametrize("kind", ["triangle6", "quad8"])
def test_curved_gmsh_file(kind: str, tmp_path: Path) -> None:
    """One element with one side bent by 0.1: the parabola takes 2/3 * 0.1 of the area of its strip."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])[: 3 if kind == "triangle6" else 4]
    middles = (corners + np.roll(corners, -1, axis=0)) / 2
    middles[0, 1] += 0.1
    points = np.concatenate([corners, middles])
    cells = [(kind, np.arange(len(points))[None, :])]
    file = tmp_path / "curved.msh"
    meshio.Mesh(np.column_stack([points, np.zeros(len(points))]), cells).write(file, file_format="gmsh", binary=False)
    mesh = read_mesh(file)
    second = Space(mesh, "P2" if kind == "triangle6" else "Q2", quadrature_degree=6)
    straight = 0.5 if kind == "triangle6" else 1.0
    assert second.weights.sum() == pytest.approx(straight - 0.2 / 3, rel=1e-12)
    first = Space(mesh, "P1" if kind == "triangle6" else "Q1")
    assert first.weights.sum() == pytest.approx(straight, rel=1e-12)
