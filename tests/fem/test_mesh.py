"""Reading meshes: groups by name, and one clear sentence for each kind of bad mesh."""

from __future__ import annotations

import re

import meshio
import numpy as np
import pytest

from granfabric.fem.discretisation.space import Space
from granfabric.fem.mesh.host_mesh import MeshError, build_mesh, read_mesh, rectangle

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def write(path, points, cells, groups, version="2.2"):
    """MSH file with physical groups: cells and groups are lists of (type, connectivity, tag), {name: (tag, dim)}."""
    points = np.column_stack([points, np.zeros(len(points))]) if np.shape(points)[1] == 2 else np.asarray(points)
    tags = [np.full(len(data), tag) for _, data, tag in cells]
    mesh = meshio.Mesh(
        points,
        [(kind, np.array(data)) for kind, data, _ in cells],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={name: np.array(value) for name, value in groups.items()},
    )
    meshio.gmsh.write(str(path), mesh, fmt_version=version, binary=False)
    return path


def square_file(path, version="2.2"):
    return write(
        path,
        SQUARE,
        [("line", [[0, 1]], 1), ("line", [[2, 3]], 2), ("triangle", [[0, 1, 2], [0, 2, 3]], 3)],
        {"bottom": (1, 1), "top": (2, 1), "body": (3, 2)},
        version,
    )


def test_physical_groups_by_name(tmp_path):
    host = read_mesh(square_file(tmp_path / "square.msh"))
    assert sorted(host.boundaries) == ["bottom", "top"]
    np.testing.assert_array_equal(host.regions["body"], [0, 1])
    space = Space(host, "P2")
    assert (space.nodes[space.boundary_nodes("bottom"), 1] == 0.0).all()
    assert len(space.boundary_nodes("top")) == 3


def test_gmsh_41_file_of_the_biaxial_case():
    import granfabric.cases as cases

    path = next(iter(cases.__path__)) + "/scenes/biaxial/biaxial.msh"
    host = read_mesh(path)
    assert sorted(host.boundaries) == ["bottom", "left", "right", "top"]
    assert len(host.regions["specimen"]) == host.mesh.t.shape[1]
    space = Space(host, "P2")
    assert space.weights.sum() == pytest.approx(0.05 * 0.1, rel=1e-12)
    assert (space.nodes[space.boundary_nodes("top"), 1] == 0.1).all()


def test_missing_group_names_the_nearest():
    host = rectangle(1.0, 1.0, 2, 2)
    with pytest.raises(MeshError, match=r"no boundary 'topp'.*nearest is 'top'"):
        host.facets("topp")
    with pytest.raises(MeshError, match=r"no region 'al'.*nearest is 'all'"):
        host.cells("al")


def test_clockwise_elements_are_turned(tmp_path):
    points, cells = SQUARE, np.array([[0, 2, 1], [0, 3, 2]])
    assert Space(build_mesh(points, cells), "P1").weights.sum() == pytest.approx(1.0)
    # Also one of two only: the sense of rotation alone is no error.
    assert Space(build_mesh(points, np.array([[0, 1, 2], [0, 3, 2]])), "P1").weights.sum() == pytest.approx(1.0)
    assert Space(build_mesh(points, np.array([[0, 3, 2, 1]])), "Q1").weights.sum() == pytest.approx(1.0)


def test_unused_points_are_dropped():
    points = np.vstack([[[9.0, 9.0]], SQUARE])
    host = build_mesh(points, np.array([[1, 2, 3], [1, 3, 4]]), {"bottom": np.array([[1, 2]])})
    assert host.mesh.p.shape[1] == 4
    np.testing.assert_array_equal(host.mesh.p[:, host.mesh.facets[:, host.boundaries["bottom"][0]]][1], [0, 0])


@pytest.mark.parametrize(
    ("points", "cells", "sentence"),
    [
        # The third corner lies on the line through the others.
        ([[0, 0], [1, 0], [2, 0], [0, 1]], [[0, 1, 3], [0, 1, 2]], "element 2 .* is degenerate"),
        # The inner node was pushed across the lower side: its triangle there is inside out and overlaps the others.
        (
            [[0, 0], [1, 0], [1, 1], [0, 1], [0.5, -0.2]],
            [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
            "element 1 .* is inverted",
        ),
        # An arrowhead.
        ([[0, 0], [1, 0], [0.2, 0.2], [0, 1]], [[0, 1, 2, 3]], "element 1 .* is inverted: it is not convex"),
        # A bow tie.
        ([[0, 0], [1, 1], [1, 0], [0, 1]], [[0, 1, 2, 3]], "element 1 .* is inverted"),
        ([[0, 0], [1, 0], [1, np.nan]], [[0, 1, 2]], "not finite"),
    ],
)
def test_bad_elements_are_named(points, cells, sentence):
    with pytest.raises(MeshError, match=sentence):
        build_mesh(np.array(points, dtype=float), np.array(cells))


def test_curve_that_is_no_element_edge():
    with pytest.raises(MeshError, match=r"curve 'cut' has a segment from \(1, 0\) to \(0, 1\)"):
        build_mesh(SQUARE, np.array([[0, 1, 2], [0, 2, 3]]), {"cut": np.array([[1, 3]])})


def bad_files(folder):
    """(path, sentence) of files that must be refused."""
    body = {"body": (3, 2)}
    three = np.column_stack([SQUARE, [0.0, 0.0, 0.5, 0.0]])
    yield folder / "nowhere.msh", "there is no such file"
    (folder / "mesh.vtk").write_text("")
    yield folder / "mesh.vtk", "Gmsh file ending in .msh"
    (folder / "broken.msh").write_text("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n1 0 0\n")
    yield folder / "broken.msh", r"section \$Nodes does not end"
    (folder / "text.msh").write_text("hello\n")
    yield folder / "text.msh", "holds .* where a section should begin"
    yield write(folder / "bent.msh", three, [("triangle", [[0, 1, 2], [0, 2, 3]], 3)], body), "not plane: z runs from"
    solid = np.vstack([three, [[0.0, 0.0, 1.0]]])
    yield write(folder / "solid.msh", solid, [("tetra", [[0, 1, 2, 4]], 3)], {"body": (3, 3)}), "not a plane mesh"
    mixed = np.vstack([SQUARE, [[2.0, 0.0]]])
    cells = [("quad", [[0, 1, 2, 3]], 3), ("triangle", [[1, 4, 2]], 3)]
    yield write(folder / "mixed.msh", mixed, cells, body), "mixes 1 triangles and 1 quadrilaterals"
    yield write(folder / "lines.msh", SQUARE, [("line", [[0, 1]], 1)], {"bottom": (1, 1)}), "no triangles or quad"
    curved = np.vstack([SQUARE[:3], [[0.5, 0.1], [1.0, 0.5], [0.9, 0.9]]])
    cells = [("triangle6", [[0, 1, 2, 3, 4, 5]], 3)]
    yield write(folder / "curved.msh", curved, cells, body), "folds over"


def test_bad_files_give_one_sentence_with_the_path(tmp_path):
    count = 0
    for path, sentence in bad_files(tmp_path):
        with pytest.raises(MeshError, match=sentence) as caught:
            read_mesh(path)
        message = str(caught.value)
        assert str(path) in message and "\n" not in message
        count += 1
    assert count == 9


def test_second_order_file_with_straight_sides_keeps_its_corners(tmp_path):
    points = np.vstack([SQUARE[:3], [[0.5, 0.0], [1.0, 0.5], [0.5, 0.5]]])
    path = write(
        tmp_path / "six.msh",
        points,
        [("line3", [[0, 1, 3]], 1), ("triangle6", [[0, 1, 2, 3, 4, 5]], 3)],
        {"bottom": (1, 1), "body": (3, 2)},
    )
    host = read_mesh(path)
    assert host.mesh.p.shape[1] == 3 and len(host.boundaries["bottom"]) == 1


def test_element_that_does_not_fit_the_mesh():
    with pytest.raises(MeshError, match=re.escape("element Q2 needs a mesh of quads, this one consists of triangles")):
        Space(rectangle(1, 1, 1, 1), "Q2")
    with pytest.raises(MeshError, match="element = 'P3' is not one of P1, P2, Q1, Q2"):
        Space(rectangle(1, 1, 1, 1), "P3")


CORNERS = np.array([[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ({"points": np.c_[SQUARE, SQUARE[:, 0]]}, r"points must be .* of shape \(n, 2\), got float64 \(4, 3\)"),
        ({"points": SQUARE.T}, "points must be"),
        ({"points": SQUARE + 0j}, "points must be .* got complex128"),
        ({"points": SQUARE.astype(str)}, "points must be"),
        ({"cells": np.array([[0, 1, 2], [0, 2, -1]])}, r"cells must be .* in 0 \.\.\. 3 .* but holds -1"),
        ({"cells": CORNERS + 1}, "cells must be .* but holds 4"),
        ({"cells": CORNERS + 0.25}, "cells must be .* got float64"),
        ({"cells": CORNERS.T}, "cells must be"),
        ({"cells": np.array([[0, 1, 2, 0, 2, 3]])}, "cells must be"),
        ({"lines": {"a": np.array([[0, -3]])}}, "curve 'a' must be .* but holds -3"),
        ({"lines": {"a": np.array([[0, 7]])}}, "curve 'a' must be .* but holds 7"),
        ({"lines": {"a": np.array([0, 1])}}, r"curve 'a' must be .* of shape \(n, 2\)"),
        ({"lines": {"a": np.array([[0, 1.5]])}}, "curve 'a' must be"),
        ({"regions": {"r": np.array([False, True])}}, "region 'r' must be .* numbers of elements, got bool"),
        ({"regions": {"r": np.array([-1])}}, "region 'r' must be .* but holds -1"),
        ({"regions": {"r": np.array([0.5])}}, "region 'r' must be"),
        ({"sides": (np.array([[0, -3]]), np.array([[0.5, -0.1]]))}, "curved sides must be .* but holds -3"),
        ({"sides": (np.array([[0, 1]]), np.array([[0.5, -0.1], [0, 0]]))}, "1 curved sides and 2 middles"),
        ({"sides": (np.array([[0, 1]]), np.array([[0.5, np.nan]]))}, "not finite"),
    ],
)
def test_numbers_that_name_other_nodes_or_elements_are_refused(given, word):
    with pytest.raises(MeshError, match=word):
        build_mesh(**{"points": SQUARE, "cells": CORNERS, **given})


def test_lists_and_other_integers_are_taken():
    host = build_mesh(SQUARE.tolist(), CORNERS.astype(np.uint8), {"a": [[1, 0]], "b": []}, {"r": [1], "s": []})
    assert len(host.facets("a")) == 1 and host.cells("r").tolist() == [1]
    assert len(host.facets("b")) == len(host.cells("s")) == 0


@pytest.mark.parametrize("sizes", [(1.0, 1.0, 2.5, 2), (1.0, 1.0, True, 2), ("1", 1.0, 2, 2), (1.0, np.nan, 2, 2)])
def test_sizes_of_a_rectangle_are_numbers(sizes):
    with pytest.raises(MeshError):
        rectangle(*sizes)


@pytest.mark.parametrize("path", [None, 3, b"plate.msh"])
def test_a_mesh_file_has_a_name(path):
    with pytest.raises(MeshError, match="the name of a mesh file is wanted"):
        read_mesh(path)
