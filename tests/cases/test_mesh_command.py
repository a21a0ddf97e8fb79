"""Meshes on their way into a run: what is printed and drawn, what is refused, and right forces whatever the file."""

from __future__ import annotations

import csv
import itertools
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from msh_files import GROUPS, expected, write_msh

from granfabric.cases.pictures.mesh import shown_groups, side_lines
from granfabric.fem.mesh.host_mesh import MeshError, TopologyError, read_mesh, rectangle
from granfabric.fem.mesh.summary import groups

MESHES = Path(__file__).parent.parent / "fem" / "meshes"

SCENE = """
title = "t"
kind = "field"
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
force_density_at_zero = 0.5
bulk_reduction = 0.88
shear_reduction = 0.69
[initial]
stress = [-100e3, -100e3, 0.0]
[mesh]
file = "m.msh"
element = "P1"
[output]
pictures = false
[effects]
contact_loss = false
contact_gain = false
[[stage]]
name = "initial"
increments = 1
fixed = [{ boundary = "bottom" }]
pressure = [
    { boundary = "top", value = 100e3 }, { boundary = "left", value = 100e3 }, { boundary = "right", value = 100e3 }
]
[[stage]]
name = "more"
increments = 1
pressure = [{ boundary = "top", value = 120e3 }]
"""

REVERSED = tuple(
    (dimension, tag, name, tuple(-entity for entity in entities)) for dimension, tag, name, entities in GROUPS
)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    file = tmp_path / "scene.toml"
    file.write_text(SCENE)
    return file


def last(folder: Path) -> dict[str, str]:
    with (folder / "history.csv").open() as file:
        return list(csv.DictReader(file))[-1]


@pytest.mark.parametrize("version", ["2.2", "4.1"])
def test_reversed_curves_carry_their_load(version: str, granfabric: Callable, scene: Path, tmp_path: Path) -> None:
    """120 kPa on the 2 m of the top: with any member left out the reaction is smaller."""
    write_msh(tmp_path / "m.msh", version=version, groups=REVERSED)
    result = granfabric("run", scene, "-o", tmp_path / "out")
    assert result.code == 0, result.err
    assert float(last(tmp_path / "out")["reaction_bottom_y"]) == pytest.approx(240e3, rel=1e-6)
    groups_told = json.loads((tmp_path / "out" / "run.json").read_text())["mesh_groups"]
    told = {group["name"]: group["size"] for group in groups_told if group["kind"] == "boundary"}
    assert told == pytest.approx(expected()[0])
    lines = [line.split() for line in result.out.splitlines()]
    assert ["top", "boundary", "4", "sides", "2", "m"] in lines
    assert ["upper", "region", "16", "cells", "0.8", "m^2"] in lines


def test_a_curve_and_a_surface_of_one_name(granfabric: Callable, scene: Path, tmp_path: Path) -> None:
    of = tuple((d, tag, "lower" if name == "bottom" else name, members) for d, tag, name, members in GROUPS)
    write_msh(tmp_path / "m.msh", groups=of)
    scene.write_text(SCENE.replace('"bottom"', '"lower"'))
    result = granfabric("run", scene, "-o", tmp_path / "out")
    assert result.code == 0, result.err
    assert float(last(tmp_path / "out")["reaction_lower_y"]) == pytest.approx(240e3, rel=1e-6)


def test_a_built_in_shape_prints_its_groups_too(granfabric: Callable, scene: Path, tmp_path: Path) -> None:
    scene.write_text(SCENE.replace('file = "m.msh"', "rectangle = { width = 3.0, height = 1.0, nx = 3, ny = 1 }"))
    result = granfabric("run", scene, "-o", tmp_path / "out")
    assert result.code == 0 and ["top", "boundary", "3", "sides", "3", "m"] in [
        line.split() for line in result.out.splitlines()
    ]


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_a_hanging_node_is_refused_with_any_element(
    element: str, granfabric: Callable, scene: Path, tmp_path: Path
) -> None:
    """Two layers of squares, two below and four above, that share the nodes of the lower."""
    rows = {0.0: 3, 0.5: 3, 1.0: 5, 1.5: 5, 2.0: 5}
    points = [(x, y) for y, n in rows.items() for x in np.linspace(0, 2, n)]
    number = {point: k for k, point in enumerate(points, start=1)}
    cells, elements = [], []
    for y, n in ((0.0, 3), (0.5, 3), (1.0, 5), (1.5, 5)):
        xs = np.linspace(0, 2, n)
        for a, b in itertools.pairwise(xs):
            corners = [number[a, y], number[b, y], number[b, y + 0.5], number[a, y + 0.5]]
            cells += [(*corners[:3], y), (corners[0], *corners[2:], y)]
    for tag, y, n in ((1, 0.0, 3), (3, 2.0, 5)):
        xs = np.linspace(0, 2, n)
        elements += [f"1 2 {tag} {tag} {number[a, y]} {number[b, y]}" for a, b in itertools.pairwise(xs)]
    for tag, x in ((2, 2.0), (4, 0.0)):
        ys = list(rows)
        elements += [f"1 2 {tag} {tag} {number[x, a]} {number[x, b]}" for a, b in itertools.pairwise(ys)]
    for a, b, c, y in cells:
        tag = 5 if y < 1.0 else 6
        elements.append(f"2 2 {tag} {tag} {a} {b} {c}")
    names = ['1 1 "bottom"', '1 2 "right"', '1 3 "top"', '1 4 "left"', '2 5 "lower"', '2 6 "upper"']
    sections = {
        "MeshFormat": ["2.2 0 8"],
        "PhysicalNames": ["6", *names],
        "Nodes": [str(len(points)), *(f"{k} {x} {y} 0" for k, (x, y) in enumerate(points, start=1))],
        "Elements": [str(len(elements)), *(f"{k} {text}" for k, text in enumerate(elements, start=1))],
    }
    text = "".join(f"${name}\n" + "\n".join(lines) + f"\n$End{name}\n" for name, lines in sections.items())
    (tmp_path / "m.msh").write_text(text)
    result = granfabric("run", scene, "--set", f"mesh.element={element}", "-o", tmp_path / "out")
    assert result.code == 2 and not (tmp_path / "out").exists()
    assert "mesh.file: mesh" in result.err and "has hanging nodes: the node at (0.5, 1)" in result.err
    assert "between region 'lower' and region 'upper'; 2 such nodes in all" in result.err


@pytest.mark.parametrize("name", ["unmerged_4.1", "overlap_4.1", "crack_4.1"])
def test_what_is_not_one_body_is_refused_and_shown(
    name: str, granfabric: Callable, scene: Path, tmp_path: Path, is_drawn: Callable
) -> None:
    (tmp_path / "m.msh").write_bytes((MESHES / f"{name}.msh").read_bytes())
    with pytest.raises(TopologyError) as refusal:
        read_mesh(tmp_path / "m.msh")
    result = granfabric("run", scene, "-o", tmp_path / "out")
    assert result.code == 2 and str(refusal.value) in result.err and not (tmp_path / "out").exists()
    picture = tmp_path / "m.png"
    for target in (scene, tmp_path / "m.msh"):
        result = granfabric("mesh", target, "-o", picture)
        assert result.code == 2 and f"(marked in {picture})" in result.err and str(refusal.value) in result.err
        assert "bottom" in result.out and is_drawn(picture)
        picture.unlink()


def test_separate_bodies_have_to_be_held(granfabric: Callable, scene: Path, tmp_path: Path) -> None:
    (tmp_path / "m.msh").write_bytes((MESHES / "unmerged_4.1.msh").read_bytes())
    scene.write_text(SCENE.partition("pressure")[0] + "pressure = []\n")
    separate = ("--set", "mesh.parts=separate", "-o", tmp_path / "out")
    result = granfabric("run", scene, *separate)
    assert result.code == 2 and "region 'upper'" in result.err and "is free to move along x" in result.err
    held = "--set", 'stage.0.fixed=[{boundary="bottom"},{boundary="top"}]'
    result = granfabric("run", scene, *held, *separate)
    assert result.code == 0, result.err
    assert "note: the sides of the boundary 'interface' lie on one of two faces" in result.out
    result = granfabric("run", scene, "--set", "mesh.parts=apart", "-o", tmp_path / "out2")
    assert result.code == 2 and "mesh.parts = 'apart' is not one of joined, separate" in result.err


def test_the_table_and_the_picture(
    granfabric: Callable, tmp_path: Path, is_drawn: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    of = (
        *(
            (1, 1, "bottom", (1,)),
            (1, 2, "[red]right[/red]", (2, 5)),
            (1, 3, "Oberfläche $x$", (6,)),
            (1, 4, None, (4, 7)),
        ),
        *((1, 9, "nothing", ()), (2, 5, "lower", (1,))),
    )
    file = write_msh(tmp_path / "m.msh", groups=of, save_all=True)
    monkeypatch.chdir(tmp_path)
    result = granfabric("mesh", "m.msh")
    assert result.code == 0, result.err
    assert "mesh: 32 triangles, 25 corners, x from 0 to 2 m, y from 0 to 1 m" in result.out
    lines = [" ".join(line.split()) for line in result.out.splitlines()]
    assert "bottom boundary 4 sides 2 m" in lines
    assert "[red]right[/red] boundary 4 sides 1 m" in lines
    assert "Oberfläche $x$ boundary 4 sides 2 m" in lines
    assert "curve 4 boundary 4 sides 1 m" in lines
    assert "lower region 16 cells 1.2 m^2" in lines
    assert "(cells in no region) - 16 cells 0.8 m^2" in lines
    assert any(line.startswith("note: ") and "'curve 4'" in line for line in lines)
    assert any(line.startswith("note: ") and "'nothing'" in line for line in lines)
    assert lines[-1] == "picture: m_mesh.png" and is_drawn(tmp_path / "m_mesh.png")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["m.msh", "m_mesh.png"]
    # with sides of the outline in no boundary
    write_msh(file, groups=(of[0], of[-1]))
    lines = [" ".join(line.split()) for line in granfabric("mesh", file).out.splitlines()]
    assert "(rest of the outline) - 8 sides 3.2 m" in lines


def test_a_scene_with_parts_of_boundaries(
    granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = granfabric("mesh", "strip_footing", "--set", "mesh.element=P1")
    assert result.code == 0, result.err
    assert (tmp_path / "strip_footing_mesh.png").is_file()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("nowhere.msh",), "mesh nowhere.msh: there is no such file"),
        (("m.msh", "-o", "m.pdf"), "does not end in .png"),
        (("m.msh", "-o", "no/m.png"), "lies in a folder that does not exist"),
        (("m.msh", "--set", "mesh.element=P1"), "--set changes keys of a scene"),
        (("m.msh", "--parts", "apart"), "parts = 'apart' is not one of 'joined', 'separate'"),
        (("biaxial", "--parts", "joined"), "--parts is for a .msh file"),
        (("p_constant",), "is not a boundary-value problem"),
        (("biaxail",), "the nearest is 'biaxial'"),
    ],
)
def test_wrong_use(
    arguments: tuple, sentence: str, granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_msh(tmp_path / "m.msh")
    monkeypatch.chdir(tmp_path)
    result = granfabric("mesh", *arguments)
    assert result.code == 2 and sentence in result.err and not list(tmp_path.glob("**/*.png"))


def test_an_unknown_boundary_is_explained_by_the_file(granfabric: Callable, scene: Path, tmp_path: Path) -> None:
    write_msh(tmp_path / "m.msh", version="1")
    result = granfabric("run", scene, "-o", tmp_path / "out")
    assert result.code == 2
    assert "the boundary 'bottom' is unknown (legal: curve 1, curve 2, curve 3, curve 4)" in result.err
    assert "MSH 1 stores none" in result.err


def test_names_stand_where_the_groups_are() -> None:
    """What goes into the picture: each boundary's name on it and outwards, each region's in it, colours apart."""
    host = rectangle(2.0, 1.0, 8, 4)
    shown = {one.group.name: one for one in shown_groups(host, groups(host))}
    assert set(shown) == {"bottom", "right", "top", "left", "all"}
    for name, axis, value, outward in (
        ("bottom", 1, 0, (0, -1)),
        ("top", 1, 1, (0, 1)),
        ("left", 0, 0, (-1, 0)),
        ("right", 0, 2, (1, 0)),
    ):
        assert shown[name].place[axis] == value
        np.testing.assert_allclose(shown[name].outward, outward, atol=1e-12)
    np.testing.assert_allclose(shown["bottom"].place[0], 1.0, atol=0.2)
    assert 0.3 < shown["all"].place[1] < 0.7
    assert len({one.colour for one in shown.values()}) == 5


def test_names_of_groups_on_one_line_keep_apart(tmp_path: Path) -> None:
    host = read_mesh(write_msh(tmp_path / "m.msh", groups=(*GROUPS, (1, 8, "again", (6,)), (1, 9, "more", (6,)))))
    places = [one.place for one in shown_groups(host, groups(host)) if one.group.name in ("top", "again", "more")]
    assert all(place[1] == 1.0 for place in places)
    assert len({round(float(place[0]), 6) for place in places}) == 3


def test_curved_sides_are_drawn_as_curves() -> None:
    from granfabric.fem.mesh.shapes import quarter_ring

    host = quarter_ring(1.0, 2.0, 2, 3, "quad")
    lines = side_lines(host, host.boundaries["inner"])
    assert lines.shape[1] > 2
    np.testing.assert_allclose(np.linalg.norm(lines, axis=2), 1.0, atol=1e-3)


def test_meshes_from_python_are_checked_too() -> None:
    with pytest.raises(MeshError, match="falls into 2 parts"):
        read_mesh(MESHES / "unmerged_4.1.msh")
    read_mesh(MESHES / "unmerged_4.1.msh", parts="separate")
