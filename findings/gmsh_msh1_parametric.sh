#!/bin/bash
# library: Gmsh
# version: 4.15.2
# expected: MSH 1 knows no parametric nodes, so Mesh.SaveParametric changes nothing
# seen: Gmsh writes further numbers of each node into $NOD and cannot read its own file: "Wrong node index"
# MSH 2.2 and 4.x mark such nodes ($ParametricNodes, a flag) and are read.
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
gmsh.model.occ.addRectangle(0, 0, 0, 2, 1)
gmsh.model.occ.synchronize()
gmsh.option.setNumber("Mesh.SaveParametric", 1)
gmsh.model.mesh.generate(2)
for version in (1, 2.2):
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.write(f"model_{version}.msh")
lines = open("model_1.msh").read().splitlines()
print("Gmsh", gmsh.option.getString("General.Version"), "- numbers of nodes in MSH 1:", sorted({len(l.split()) for l in lines[2 : 2 + int(lines[1])]}))
seen = {}
for version in (2.2, 1):
    gmsh.clear()
    try:
        gmsh.open(f"model_{version}.msh")
        seen[version] = f"{len(gmsh.model.mesh.getNodes()[0])} nodes"
    except Exception as error:
        seen[version] = str(error)
    print(f"MSH {version} read by Gmsh: {seen[version]}")
gmsh.finalize()
assert "Wrong node index" in seen[1] and "nodes" in seen[2.2], "the behaviour has changed"
PY
"$work/venv/bin/python" look.py
