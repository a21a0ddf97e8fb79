#!/bin/bash
# library: Gmsh
# version: 4.15.2
# expected: results written to the .msh file of their mesh with append=True add $NodeData to it
# seen: the whole mesh is written a second time, and Gmsh itself reads the file as twice the nodes and twice the triangles
# With PostProcessing.SaveMesh = 0 the results alone are appended.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q gmsh==4.15.2 numpy==2.4.6
cd "$work"
cat > look.py <<'PY'
import gmsh
gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
seen = {}
for save_mesh in (1, 0):
    gmsh.clear()
    gmsh.option.setNumber("PostProcessing.SaveMesh", save_mesh)
    gmsh.model.occ.addRectangle(0, 0, 0, 2, 1)
    gmsh.model.occ.synchronize()
    gmsh.model.mesh.generate(2)
    tags = gmsh.model.mesh.getNodes()[0]
    triangles = len(gmsh.model.mesh.getElementsByType(2)[0])
    gmsh.write("model.msh")
    view = gmsh.view.add("T")
    gmsh.view.addHomogeneousModelData(view, 0, "", "NodeData", tags, [1.0] * len(tags))
    gmsh.view.write(view, "model.msh", True)
    gmsh.clear()
    gmsh.open("model.msh")
    sections = open("model.msh").read().count("$Nodes\n")
    seen[save_mesh] = sections, len(gmsh.model.mesh.getElementsByType(2)[0]) / triangles
    print(f"Gmsh {gmsh.option.getString('General.Version')}, SaveMesh = {save_mesh}: $Nodes {sections} times; "
          f"{seen[save_mesh][1]:g} times the triangles when read")
gmsh.finalize()
assert seen == {1: (2, 2.0), 0: (1, 1.0)}, "the behaviour has changed"
PY
"$work/venv/bin/python" look.py
