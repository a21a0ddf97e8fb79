"""Makes the meshes of this folder: `pip install gmsh==4.15.2 && python make_meshes.py` (the tests do not need Gmsh).

All but the last show a rectangle of two layers, 2 m by 0.6 m below and 2 m by 0.4 m above, with other groups or written
in other ways.
"""

from __future__ import annotations

from pathlib import Path

import gmsh

HERE = Path(__file__).parent
Group = tuple[int, int, str | None, list[int]]

PLAIN: list[Group] = [
    *((1, 1, "bottom", [1]), (1, 2, "right", [2, 5]), (1, 3, "top", [6]), (1, 4, "left", [4, 7])),
    *((2, 5, "lower", [1]), (2, 6, "upper", [2])),
]
REVERSED: list[Group] = [
    *((1, 1, "bottom", [-1]), (1, 2, "right", [-2, 5]), (1, 3, "top", [6]), (1, 4, "left", [4, -7])),
    *((2, 5, "lower", [-1]), (2, 6, "upper", [2])),
]
OVERLAPPING: list[Group] = [
    *PLAIN,
    (1, 7, "outline", [1, 2, 5, 6, 7, 4]),
    (1, 9, "twice", [6, 6]),
    (2, 8, "all", [1, 2]),
]
NAMES: list[Group] = [
    *((1, 1, 'bot "x" tom', [1]), (1, 2, " right side ", [2, 5]), (1, 3, "Oberfläche µ", [6]), (1, 4, "lower", [4, 7])),
    *((2, 5, "lower", [1]), (2, 6, "upper", [2]), (0, 7, "lower", [1])),
]
SAME_NAME_BY_API: list[Group] = [*PLAIN, (1, 17, "top", [3])]


def two_layers(groups: list[Group], **options: float) -> None:
    """Mesh the model."""
    gmsh.clear()
    defaults = {"Mesh.ElementOrder": 1, "Mesh.RecombineAll": 0, "Mesh.SaveAll": 0, "Mesh.SaveParametric": 0}
    defaults |= {"Mesh.PartitionCreateTopology": 0, "Mesh.PartitionCreateGhostCells": 0, "Mesh.Binary": 0}
    defaults |= {"Mesh.PartitionSplitMeshFiles": 0, "Mesh.Algorithm": 6, "Mesh.RecombinationAlgorithm": 1}
    for name, value in {**defaults, **options}.items():
        gmsh.option.setNumber(name, value)
    geo = gmsh.model.geo
    points = [geo.addPoint(x, y, 0, 0.5) for x, y in ((0, 0), (2, 0), (2, 0.6), (0, 0.6), (2, 1), (0, 1))]
    ends = ((0, 1), (1, 2), (2, 3), (3, 0), (2, 4), (4, 5), (5, 3))
    curves = [geo.addLine(points[a], points[b]) for a, b in ends]
    geo.addPlaneSurface([geo.addCurveLoop(curves[:4])])
    geo.addPlaneSurface([geo.addCurveLoop([-curves[2], *curves[4:]])])
    geo.synchronize()
    for dimension, tag, name, entities in groups:
        gmsh.model.addPhysicalGroup(dimension, entities, tag)
        if name is not None:
            gmsh.model.setPhysicalName(dimension, tag, name)
    gmsh.model.mesh.generate(2)


def write(name: str, version: float = 4.1) -> None:
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.write(str(HERE / f"{name}.msh"))


def from_text(name: str, text: str) -> None:
    """Mesh a script of the built-in kernel."""
    gmsh.clear()
    file = HERE / f"{name}.geo"
    file.write_text(text)
    gmsh.open(str(file))
    file.unlink()
    gmsh.model.mesh.generate(2)


BLOCK = """
Point({0}1) = {{0, {1}, 0, 0.7}}; Point({0}2) = {{2, {1}, 0, 0.7}};
Point({0}3) = {{2, {2}, 0, 0.7}}; Point({0}4) = {{0, {2}, 0, 0.7}};
Line({0}1) = {{{0}1, {0}2}}; Line({0}2) = {{{0}2, {0}3}}; Line({0}3) = {{{0}3, {0}4}}; Line({0}4) = {{{0}4, {0}1}};
Curve Loop({0}1) = {{{0}1, {0}2, {0}3, {0}4}}; Plane Surface({0}1) = {{{0}1}};
Physical Surface("{3}") = {{{0}1}};
"""
CRACK = BLOCK.format(1, 0, 1, "body") + (
    "Point(5) = {0.5, 0.5, 0, 0.5}; Point(6) = {1.5, 0.5, 0, 0.5}; Line(5) = {5, 6}; Curve{5} In Surface{11};\n"
    'Physical Curve("bottom") = {11}; Physical Curve("top") = {13}; Physical Curve("crack", 6) = {5};\n'
)
BOUNDS = 'Physical Curve("bottom") = {11}; Physical Curve("top") = {23}; Physical Curve("interface") = {13};\n'


def main() -> None:
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    two_layers(REVERSED)
    for version in (2.2, 4.0, 4.1):
        write(f"reversed_{version}", version)
    two_layers(OVERLAPPING, **{"Mesh.Binary": 1})
    for version in (2.2, 4.1):
        write(f"overlapping_binary_{version}", version)
    two_layers(OVERLAPPING, **{"Mesh.ElementOrder": 2, "Mesh.RecombineAll": 1, "Mesh.RecombinationAlgorithm": 3})
    write("overlapping_quads_4.1")
    two_layers(NAMES)
    write("names_4.1")
    two_layers(SAME_NAME_BY_API)
    write("same_name_4.1")
    two_layers(REVERSED, **{"Mesh.SaveAll": 1})
    for version in (2.2, 4.1):
        write(f"save_all_{version}", version)
    two_layers(PLAIN, **{"Mesh.SaveParametric": 1})
    for version in (1.0, 2.2, 4.0, 4.1):
        write(f"parametric_{version}", version)
    two_layers(PLAIN, **{"Mesh.PartitionCreateTopology": 1, "Mesh.PartitionCreateGhostCells": 1})
    gmsh.model.mesh.partition(2)
    for version in (2.2, 4.0, 4.1):
        write(f"partitioned_{version}", version)
    gmsh.option.setNumber("Mesh.PartitionSplitMeshFiles", 1)
    write("split_4.1")
    gmsh.option.setNumber("Mesh.PartitionSplitMeshFiles", 0)
    two_layers(PLAIN)
    view = gmsh.view.add("T")
    tags = gmsh.model.mesh.getNodes()[0]
    for step in (0, 1):
        gmsh.view.addHomogeneousModelData(view, step, "", "NodeData", tags, [float(step)] * len(tags))
    gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
    gmsh.write(str(HERE / "results_4.1.msh"))
    gmsh.view.write(view, str(HERE / "results_4.1.msh"), True)
    gmsh.view.remove(view)
    from_text("crack_4.1", CRACK)
    gmsh.plugin.setNumber("Crack", "PhysicalGroup", 6)
    gmsh.plugin.run("Crack")
    write("crack_4.1")
    gmsh.option.setNumber("Geometry.AutoCoherence", 0)
    from_text("unmerged_4.1", BLOCK.format(1, 0, 1, "lower") + BLOCK.format(2, 1, 2, "upper") + BOUNDS)
    write("unmerged_4.1")
    from_text("overlap_4.1", BLOCK.format(1, 0, 1, "lower") + BLOCK.format(2, 0.5, 1.5, "upper") + BOUNDS)
    write("overlap_4.1")
    gmsh.finalize()


if __name__ == "__main__":
    main()
