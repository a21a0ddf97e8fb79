"""Physical groups of Gmsh files: one plain model, written in all ways, has the same lengths and areas."""

from __future__ import annotations

import itertools
import re

import meshio
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msh_files import GROUPS, Model, expected, msh_bytes, write_msh

from granfabric.fem.mesh.host_mesh import HostMesh, MeshError, read_mesh
from granfabric.fem.mesh.summary import groups, remarks

NEW = ("4.0", "4.1")
FORMS = [("1", False), ("2.2", False), ("2.2", True), ("4.0", False), ("4.0", True), ("4.1", False), ("4.1", True)]
SHAPES = [(cell, order) for cell in ("triangle", "quad") for order in (1, 2)]


def sizes(host: HostMesh) -> tuple[dict[str, float], dict[str, float]]:
    found = groups(host)
    by_kind = {
        kind: {group.name: group.size for group in found if group.kind == kind and group.name}
        for kind in ("boundary", "region")
    }
    return by_kind["boundary"], by_kind["region"]


def check(host: HostMesh, wanted: tuple[dict[str, float], dict[str, float]]) -> None:
    for have, want in zip(sizes(host), wanted):
        assert have == pytest.approx(want, rel=1e-12)


def numbered(of: tuple) -> tuple:
    """Groups without their names, as version 1 writes them."""
    return tuple((dimension, tag, None, entities) for dimension, tag, _, entities in of)


REVERSED = (
    *((1, 1, "bottom", (-1,)), (1, 2, "right", (-2, 5)), (1, 3, "top", (-6,)), (1, 4, "left", (4, -7))),
    *((2, 5, "lower", (-1,)), (2, 6, "upper", (2,))),
)
OVERLAPPING = (*GROUPS, (1, 7, "outline", (1, 2, 5, -6, 4, 7)), (1, 9, "top twice", (6, 6)), (2, 8, "all", (1, 2)))
SAME_NAME = (*GROUPS, (1, 5, "lower", (3,)), (0, 1, "bottom", (1,)))
UNNAMED = (*GROUPS, (1, 17, None, (3,)), (2, 23, None, (1, -2)))
EMPTY_NAME = (*GROUPS, (1, 17, "", (3,)))
ONE_NAME_TWICE = (*GROUPS, (1, 17, "top", (3,)))
STRANGE = (
    *((1, 1, 'bot "x" tom', (1,)), (1, 2, " right side ", (2, 5)), (1, 3, "Oberfläche µ", (6,))),
    *((1, 4, "[red]left[/red]", (4, 7)), (2, 5, "lower 'a' $x$", (1,)), (2, 6, "upper\\n", (2,))),
)
POINTS = (*GROUPS, (0, 30, "corners", (1, 2)), (0, 31, None, (2,)))
FEW = ((1, 1, "bottom", (1,)), (2, 5, "lower", (1, 2)))
KINDS = {
    "plain": GROUPS,
    "reversed": REVERSED,
    "overlapping": OVERLAPPING,
    "one name for curve and surface": SAME_NAME,
    "unnamed": UNNAMED,
    "empty name": EMPTY_NAME,
    "one name for two groups": ONE_NAME_TWICE,
    "strange names": STRANGE,
    "points": POINTS,
    "few": FEW,
}


@pytest.mark.parametrize(("version", "binary"), FORMS)
@pytest.mark.parametrize("kind", KINDS)
def test_groups_have_their_lengths_and_areas(tmp_path, kind, version, binary):
    of = KINDS[kind]
    for cell, order in SHAPES if kind in ("reversed", "overlapping") else SHAPES[:1]:
        path = write_msh(tmp_path / "a.msh", groups=of, version=version, binary=binary, cell=cell, order=order)
        host = read_mesh(path)
        check(host, expected(numbered(of) if version == "1" else of))
        assert sum(group.size for group in groups(host) if group.name == "" and group.kind == "region") == 0.0
        assert host.cell == cell


@pytest.mark.parametrize(("version", "binary"), [form for form in FORMS if form[0] in NEW])
@pytest.mark.parametrize("kind", KINDS)
def test_elements_in_no_group_do_no_harm(tmp_path, kind, version, binary):
    """`Mesh.SaveAll` writes those of all curves and surfaces; version 4 keeps the groups."""
    for parts in (1, 2):
        path = write_msh(
            tmp_path / "a.msh", groups=KINDS[kind], version=version, binary=binary, save_all=True, parts=parts
        )
        check(read_mesh(path), expected(KINDS[kind]))


@pytest.mark.parametrize(("version", "binary"), [("2.2", False), ("2.2", True), ("1", False)])
def test_old_files_with_all_elements_have_lost_their_groups_and_say_so(tmp_path, version, binary):
    path = write_msh(tmp_path / "a.msh", version=version, binary=binary, save_all=True)
    if version == "1":  # no names in the file: nothing tells that there were groups
        host = read_mesh(path)
        assert not host.boundaries and not host.regions
        assert "no element of the file belongs to a physical group" in remarks(host)[0]
        return
    with pytest.raises(MeshError, match=r"names 6 physical groups .*SaveAll = 1 loses them.*SaveAll = 0.*MSH 4\.1"):
        read_mesh(path)


@pytest.mark.parametrize(("version", "binary"), FORMS)
@pytest.mark.parametrize("ghosts", [False, True])
@pytest.mark.parametrize("kind", ["reversed", "overlapping"])
def test_partitioned_files(tmp_path, kind, version, binary, ghosts):
    of = KINDS[kind]
    for order in (1, 2):
        path = write_msh(
            tmp_path / "a.msh", groups=of, version=version, binary=binary, parts=3, ghosts=ghosts, order=order
        )
        check(read_mesh(path), expected(numbered(of) if version == "1" else of))


@pytest.mark.parametrize(("version", "binary"), FORMS[1:])
def test_parametric_nodes(tmp_path, version, binary):
    for order in (1, 2):
        path = write_msh(tmp_path / "a.msh", version=version, binary=binary, parametric=True, order=order)
        check(read_mesh(path), expected())


@pytest.mark.parametrize("version", ["2.2", "4.0", "4.1"])
def test_big_end_first_is_read(tmp_path, version):
    path = write_msh(tmp_path / "a.msh", groups=OVERLAPPING, version=version, binary=True, big_end=True)
    check(read_mesh(path), expected(OVERLAPPING))


@pytest.mark.parametrize("version", ["1", "2.2", "4.0", "4.1"])
def test_line_ends_of_other_systems(tmp_path, version):
    path = write_msh(tmp_path / "a.msh", version=version, line_end=b"\r\n")
    check(read_mesh(path), expected(numbered(GROUPS) if version == "1" else GROUPS))


FIELD = b'1\n"T"\n1\n0.0\n3\n%d\n1\n2\n1 0.5\n2 0.25\n'
EXTRA = (
    ("Comments", b"made by hand\n"),
    ("NodeData", FIELD % 0),
    ("NodeData", FIELD % 1),
    ("ElementData", FIELD % 0),
    ("ElementData", FIELD % 1),
    ("ElementNodeData", FIELD % 0),
    ("InterpolationScheme", b'"s"\n0\n'),
    ("Periodic", b"1\n1 2 4\nAffine 1 0 0 2 0 1 0 0 0 0 1 0 0 0 0 1\n1\n1 2\n"),
    ("GhostElements", b"1\n1 1 1 2\n"),
    ("Parametrizations", b"0 0\n"),
    ("Whatever", b"\x00\x01\xff$Nod\n"),
)


@pytest.mark.parametrize(("version", "binary"), FORMS)
def test_sections_that_say_nothing_about_the_mesh(tmp_path, version, binary):
    path = write_msh(tmp_path / "a.msh", version=version, binary=binary, extra=EXTRA)
    check(read_mesh(path), expected(numbered(GROUPS) if version == "1" else GROUPS))
    # also before the first section
    path.write_bytes(b"$Comments\nhello\n$EndComments\n" + path.read_bytes())
    check(read_mesh(path), expected(numbered(GROUPS) if version == "1" else GROUPS))


def test_a_mesh_that_is_there_twice_counts_once(tmp_path):
    """Gmsh repeats the whole mesh where it appends results."""
    path = write_msh(tmp_path / "a.msh", version="4.1")
    path.write_bytes(2 * path.read_bytes())
    check(read_mesh(path), expected())
    other = msh_bytes(Model(seed=1))
    path.write_bytes(msh_bytes(Model()) + other)
    with pytest.raises(MeshError, match=r"section \$Nodes twice, and the two differ"):
        read_mesh(path)


def canonical(host: HostMesh) -> tuple:
    """The mesh by places instead of numbers."""
    points = [tuple(point) for point in host.mesh.p.T.round(9).tolist()]
    cells = [frozenset(points[node] for node in cell) for cell in host.mesh.t.T.tolist()]
    sides = [frozenset(points[node] for node in side) for side in host.mesh.facets.T.tolist()]
    return (
        frozenset(cells),
        {name: frozenset(sides[k] for k in index) for name, index in host.boundaries.items()},
        {name: frozenset(cells[k] for k in index) for name, index in host.regions.items()},
    )


@pytest.fixture(scope="module")
def scratch(tmp_path_factory):
    return tmp_path_factory.mktemp("msh") / "a.msh"


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_numbers_directions_and_sequence_mean_nothing(data, scratch):
    """Other numbers of nodes, elements and sections in another sequence, curves turned: the same mesh."""
    cell, order = data.draw(st.sampled_from(SHAPES))
    version, binary = data.draw(st.sampled_from(FORMS[1:]))
    of = tuple(
        (dimension, tag, name, tuple(data.draw(st.sampled_from([1, -1])) * entity for entity in entities))
        for dimension, tag, name, entities in data.draw(st.sampled_from([GROUPS, OVERLAPPING, UNNAMED]))
    )
    options = {
        "seed": data.draw(st.integers(0, 10_000)),
        "sequence": data.draw(st.permutations(range(4))),
        "parts": data.draw(st.sampled_from([1, 1, 2])),
        "parametric": data.draw(st.booleans()),
        "save_all": version in NEW and data.draw(st.booleans()),
    }
    host = read_mesh(write_msh(scratch, groups=of, version=version, binary=binary, cell=cell, order=order, **options))
    plain_groups = tuple((d, tag, name, tuple(map(abs, entities))) for d, tag, name, entities in of)
    plain = read_mesh(write_msh(scratch, groups=plain_groups, cell=cell, order=order))
    assert canonical(host) == canonical(plain)
    check(host, expected(of))


def test_what_is_told_about_groups(tmp_path):
    read = lambda **options: remarks(read_mesh(write_msh(tmp_path / "a.msh", **options)))  # noqa: E731
    assert read() == []
    told = read(groups=UNNAMED)
    assert len(told) == 2 and "'curve 17'" in told[0] and "'surface 23'" in told[1]
    empty = (*GROUPS, (1, 40, "nothing", ()), (2, 41, "nowhere", ()), (0, 42, "point", ()), (3, 43, "volume", ()))
    told = read(groups=empty)
    assert len(told) == 2 and "boundary 'nothing'" in told[0] and "region 'nowhere'" in told[1]
    assert "MSH 1 stores none" in read(version="1")[0]
    assert "go by numbers" in read(groups=numbered(GROUPS))[0]


def test_what_is_in_no_group_is_counted(tmp_path):
    host = read_mesh(
        write_msh(tmp_path / "a.msh", groups=((1, 1, "bottom", (1,)), (2, 5, "lower", (1,))), save_all=True)
    )
    rest = {group.kind: group for group in groups(host) if not group.name}
    assert rest["boundary"].size == pytest.approx(4.0) and len(rest["boundary"].index) == 12
    assert rest["region"].size == pytest.approx(0.8) and len(rest["region"].index) == 16


def test_a_taken_name_is_refused(tmp_path):
    of = (*GROUPS, (1, 17, None, (3,)), (1, 30, "curve 17", (1,)))
    with pytest.raises(
        MeshError, match=r"physical curve 17 has no name and another is named 'curve 17'.*give it a name"
    ):
        read_mesh(write_msh(tmp_path / "a.msh", groups=of))
    # a surface of that name is another thing
    assert (
        "curve 17"
        in read_mesh(
            write_msh(tmp_path / "a.msh", groups=(*GROUPS, (1, 17, None, (3,)), (2, 30, "curve 17", (1,))))
        ).boundaries
    )


@pytest.mark.parametrize("version", ["1", "2.2"])
def test_a_negative_number_of_a_group_in_an_old_file(tmp_path, version):
    """Gmsh turns the elements instead; other programs keep the sign."""
    path = write_msh(tmp_path / "a.msh", version=version)
    row = r"(\n\d+ 1) 1 (1 2 )" if version == "1" else r"(\n\d+ 1 2) 1 (1 )"
    text, changed = re.subn(row, r"\1 -1 \2", path.read_text(), count=2)
    assert changed == 2  # of the four elements of "bottom"
    path.write_text(text)
    check(read_mesh(path), expected(numbered(GROUPS) if version == "1" else GROUPS))


def test_of_two_names_of_one_group_the_first_counts(tmp_path):
    """As in Gmsh."""
    data = write_msh(tmp_path / "a.msh").read_bytes()
    (tmp_path / "a.msh").write_bytes(data.replace(b'6\n1 1 "bottom"', b'7\n1 1 "bottom"\n1 1 "second"'))
    check(read_mesh(tmp_path / "a.msh"), expected())


def test_one_of_several_files_of_a_mesh_is_refused(tmp_path):
    """`Mesh.PartitionSplitMeshFiles` writes each partition into a file of its own, all entities into each."""
    path = write_msh(tmp_path / "a.msh", parts=2)
    text = path.read_text()
    head, _, elements = text.partition("$Elements\n")
    rows = elements.splitlines()
    kept, k, total, blocks = [], 1, 0, 0
    while not rows[k].startswith("$"):
        dimension, tag, _, count = map(int, rows[k].split())
        part = next(line.split() for line in head.splitlines() if line.startswith(f"{tag} {dimension} "))[4]
        if part == "1":
            kept += rows[k : k + 1 + count]
            total, blocks = total + count, blocks + 1
        k += 1 + count
    path.write_text(f"{head}$Elements\n{blocks} {total} 1 {total}\n" + "\n".join(kept) + "\n$EndElements\n")
    with pytest.raises(MeshError, match=r"holds 1 of 2 parts of a partitioned mesh; .*PartitionSplitMeshFiles = 0"):
        read_mesh(path)


@pytest.mark.parametrize(("version", "binary"), [form for form in FORMS if form[0] != "1"])
def test_another_reader_finds_the_same_cells(tmp_path, version, binary):
    """Without what meshio stumbles over it reads the same mesh."""
    # in binary files of version 2 it wants nodes numbered from 1 in their sequence
    seed = None if (version, binary) == ("2.2", True) else 7
    path = write_msh(tmp_path / "a.msh", version=version, binary=binary, seed=seed)
    if version == "4.0":  # Gmsh writes 4 for this version, which meshio takes for 4.1
        path.write_bytes(path.read_bytes().replace(b"\n4 ", b"\n4.0 ", 1))
    raw = meshio.read(path)
    cells = np.concatenate([block.data for block in raw.cells if block.type == "triangle"])
    mine = canonical(read_mesh(path))[0]
    assert mine == {frozenset(map(tuple, raw.points[cell, :2].round(9).tolist())) for cell in cells}


@pytest.mark.parametrize("version", ["1", "2.2", "4.0", "4.1"])
def test_what_is_not_held_is_counted_and_has_a_remedy(tmp_path, version, monkeypatch):
    import msh_files

    meshed = msh_files._meshed

    def write(change) -> str:
        def changed(model):
            made = meshed(model)
            change(made.elements)
            return made

        monkeypatch.setattr(msh_files, "_meshed", changed)
        with pytest.raises(MeshError) as caught:
            read_mesh(write_msh(tmp_path / "a.msh", version=version))
        return str(caught.value)

    def quads(elements):
        rows = elements[2, 2][1]
        elements[2, 2] = (3, np.stack([rows[::2, 0], rows[::2, 1], rows[::2, 2], rows[1::2, 2]], axis=1))

    told = write(quads)
    assert "it mixes 16 triangles and 8 quadrilaterals" in told and "Mesh.RecombineAll" in told

    def tetrahedra(elements):
        elements[2, 2] = (4, elements[2, 2][1][:, [0, 1, 2, 0]])

    monkeypatch.setitem(msh_files.NODES, 4, 4)
    assert "it holds tetrahedra; mesh the surfaces only (gmsh -2)" in write(tetrahedra)

    def cubic(elements):
        elements[1, 1] = (26, elements[1, 1][1][:, [0, 1, 0, 1]])

    assert "an order above the second (Gmsh's type 26); set Mesh.ElementOrder to 1 or 2" in write(cubic)

    def half_second_order(elements):
        rows = elements[2, 2][1]
        elements[2, 2] = (9, np.concatenate([rows, rows], axis=1))

    assert "it mixes 16 triangles of first and 16 of second order; set Mesh.ElementOrder" in write(half_second_order)

    def doubled(elements):
        elements[2, 2] = (2, np.concatenate([elements[2, 2][1], elements[2, 1][1][:3]]))

    if version in NEW:
        told = write(doubled)
        assert "is there twice, again as element" in told and "3 such elements" in told and "BooleanFragments" in told
    else:  # a cell that is in two groups is there twice, and some programs write the group in place of the surface
        monkeypatch.setattr(
            msh_files, "_meshed", lambda model: (lambda made: (doubled(made.elements), made)[1])(meshed(model))
        )
        host = read_mesh(write_msh(tmp_path / "a.msh", version=version))
        assert host.mesh.t.shape[1] == 32
        assert sorted(map(len, host.regions.values())) == [16, 19]


def test_versions_that_are_not_read(tmp_path):
    path = write_msh(tmp_path / "a.msh")
    for version in ("3", "5.0", "4.2", "x"):
        path.write_bytes(msh_bytes(Model()).replace(b"4.1", version.encode(), 1))
        with pytest.raises(MeshError, match=rf"its version is '{version}'; save it as MSH 4.1"):
            read_mesh(path)


def test_a_mesh_in_another_plane(tmp_path):
    data = write_msh(tmp_path / "a.msh", version="2.2").read_text()
    head, _, rest = data.partition("$Nodes\n")
    nodes, _, rest = rest.partition("$EndNodes")
    count, *lines = nodes.splitlines()
    turned = "\n".join(f"{tag} {x} {z} {y}" for tag, x, y, z in (line.split() for line in lines))
    (tmp_path / "a.msh").write_text(f"{head}$Nodes\n{count}\n{turned}\n$EndNodes{rest}")
    with pytest.raises(MeshError, match="not plane: z runs from 0 to 1; all y are equal: turn it into the x-y plane"):
        read_mesh(tmp_path / "a.msh")
    # a node that no cell uses may lie anywhere
    lines.append("999 0 0 5")
    (tmp_path / "a.msh").write_text(f"{head}$Nodes\n{len(lines)}\n" + "\n".join(lines) + f"\n$EndNodes{rest}")
    check(read_mesh(tmp_path / "a.msh"), expected())


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (b'6\n1 1 "bottom"', b'7\n1 1 "bottom"', "PhysicalNames does not hold the number of names"),
        (b'1 1 "bottom"', b"1 1 bottom", "PhysicalNames holds the line '1 1 bottom', which names no group"),
        (b'"bottom"', b'"bot\x1btom"', "cannot be printed"),
        (b"$Elements\n8 ", b"$Elements\n9 ", "section .Elements"),
        (b"$Nodes\n3 25 ", b"$Nodes\n3 26 ", "section .Nodes does not hold the number of nodes"),
        (b"\n0 1 0 1\n1\n", b"\n0 1 0 1\n2\n", "defines the node 2 twice"),
        (b"\n2 1 2 16\n", b"\n1 1 2 16\n", "holds triangles in an entity of the dimension 1"),
    ],
)
def test_damage_is_named(tmp_path, old, new, sentence):
    data = msh_bytes(Model())
    assert old in data
    (tmp_path / "a.msh").write_bytes(data.replace(old, new, 1))
    with pytest.raises(MeshError, match=sentence):
        read_mesh(tmp_path / "a.msh")


def test_every_way_of_writing_is_another_file():
    """The variants above do differ."""
    files = {
        msh_bytes(Model(version=version, binary=binary, **more))
        for (version, binary), more in itertools.product(
            FORMS[1:], ({}, {"save_all": True}, {"parametric": True}, {"parts": 2}, {"order": 2}, {"groups": REVERSED})
        )
    }
    # version 2.2 writes groups without signs
    assert len(files) == 6 * 6 - 2
