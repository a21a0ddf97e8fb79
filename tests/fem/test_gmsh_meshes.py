"""Files that Gmsh itself wrote (`meshes/make_meshes.py`): groups with lengths and areas, or the reason why not."""

from __future__ import annotations

from pathlib import Path

import pytest
from test_msh_groups import sizes

from granfabric.fem.mesh.host_mesh import MeshError, TopologyError, read_mesh
from granfabric.fem.mesh.summary import remarks

MESHES = Path(__file__).parent / "meshes"
PLAIN = ({"bottom": 2.0, "right": 1.0, "top": 2.0, "left": 1.0}, {"lower": 1.2, "upper": 0.8})
OVERLAPPING = (PLAIN[0] | {"outline": 6.0, "twice": 2.0}, PLAIN[1] | {"all": 2.0})
EXPECTED = {
    **dict.fromkeys([f"reversed_{version}" for version in ("2.2", "4.0", "4.1")], PLAIN),
    **dict.fromkeys([f"parametric_{version}" for version in ("2.2", "4.0", "4.1")], PLAIN),
    **dict.fromkeys([f"partitioned_{version}" for version in ("2.2", "4.0", "4.1")], PLAIN),
    **dict.fromkeys(["overlapping_binary_2.2", "overlapping_binary_4.1", "overlapping_quads_4.1"], OVERLAPPING),
    **dict.fromkeys(["save_all_4.1", "results_4.1"], PLAIN),
    "parametric_1.0": (
        {f"curve {k}": 2.0 if k % 2 else 1.0 for k in (1, 2, 3, 4)},
        {"surface 5": 1.2, "surface 6": 0.8},
    ),
    "names_4.1": ({'bot "x" tom': 2.0, " right side ": 1.0, "Oberfläche µ": 2.0, "lower": 1.0}, PLAIN[1]),
    "same_name_4.1": (PLAIN[0] | {"curve 17": 2.0}, PLAIN[1]),
}
REFUSED = {
    "save_all_2.2": r"names 6 physical groups .* Mesh.SaveAll = 1 loses them",
    "split_4.1_1": "holds 1 of 2 parts of a partitioned mesh",
    "split_4.1_2": "holds 1 of 2 parts of a partitioned mesh",
    "overlap_4.1": r"falls into 2 parts that overlap: .*between region 'lower' and region 'upper'.*BooleanFragments",
    "unmerged_4.1": r"falls into 2 parts that touch: .*region 'lower' and region 'upper'; 4 such places.*Coherence",
    "crack_4.1": r"has doubled nodes: two nodes at \(1, 0.5\) are not one \(in region 'body'.*parts = .separate",
}


def test_every_file_of_the_folder_is_tried():
    assert {file.stem for file in MESHES.glob("*.msh")} == {*EXPECTED, *REFUSED}


@pytest.mark.parametrize("name", EXPECTED)
def test_groups(name):
    for have, want in zip(sizes(read_mesh(MESHES / f"{name}.msh")), EXPECTED[name]):
        assert have == pytest.approx(want, rel=1e-12)


@pytest.mark.parametrize("name", REFUSED)
def test_refusals(name):
    with pytest.raises(MeshError, match=REFUSED[name]):
        read_mesh(MESHES / f"{name}.msh")


def test_cracks_and_touching_bodies_when_they_are_meant():
    crack = read_mesh(MESHES / "crack_4.1.msh", parts="separate")
    # the plugin puts both faces, 1 m each, into the group
    assert sizes(crack)[0]["crack"] == pytest.approx(2.0) and remarks(crack) == []
    layers = read_mesh(MESHES / "unmerged_4.1.msh", parts="separate")
    assert sizes(layers)[1] == pytest.approx({"lower": 2.0, "upper": 2.0})
    assert "the sides of the boundary 'interface' lie on one of two faces" in remarks(layers)[0]
    with pytest.raises(TopologyError, match="overlap"):
        read_mesh(MESHES / "overlap_4.1.msh", parts="separate")


def test_a_group_whose_name_was_lost_is_told():
    assert "called 'curve 17' here" in remarks(read_mesh(MESHES / "same_name_4.1.msh"))[0]
