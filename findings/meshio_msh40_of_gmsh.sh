#!/bin/bash
# library: meshio (and Gmsh)
# version: 5.3.5 (4.15.2)
# expected: a file of `gmsh -format msh40` is read
# seen: the format line says "4", which meshio takes for 4.1: an error about unmatched data; with "4.0" in that line it is read
# meshio has a reader of 4.0 and chooses it for "4.0" only.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q gmsh==4.15.2 meshio==5.3.5 numpy==2.4.6
cd "$work"
cat > look.py <<'PY'
import gmsh, meshio
gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
gmsh.model.geo.addPoint(0, 0, 0, 1)
gmsh.model.occ.addRectangle(0, 0, 0, 2, 1)
gmsh.model.occ.synchronize()
gmsh.model.addPhysicalGroup(2, [1], name="body")
gmsh.model.mesh.generate(2)
gmsh.option.setNumber("Mesh.MshFileVersion", 4.0)
gmsh.write("model.msh")
gmsh.finalize()
text = open("model.msh").read()
print("meshio", meshio.__version__, "- format line of Gmsh 4.15.2:", text.splitlines()[1])
try:
    meshio.read("model.msh")
    seen = "read"
except BaseException as error:
    seen = f"{type(error).__name__}: {error}"
print("as it is:", seen)
open("changed.msh", "w").write(text.replace("\n4 0 8\n", "\n4.0 0 8\n"))
mesh = meshio.read("changed.msh")
print("with 4.0:", sum(len(block.data) for block in mesh.cells if block.type == "triangle"), "triangles")
assert text.splitlines()[1] == "4 0 8" and seen != "read", "the behaviour has changed"
PY
"$work/venv/bin/python" look.py
