#!/bin/bash
# library: meshio (and Gmsh)
# version: 5.3.5 (4.15.2)
# expected: a physical group with a reversed member, {-3, 4}, holds the elements of both curves
# seen: MSH 4.1 stores the number with a minus sign; meshio compares with the sign, and the elements of the reversed curve are in no set, without a word
# MSH 2.2 of the same model holds both curves. Also lost: a group of curves of which a group of surfaces has the name.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q gmsh==4.15.2 meshio==5.3.5 numpy==2.4.6
cat > "$work/model.geo" <<'GEO'
Point(1) = {0, 0, 0, 1}; Point(2) = {2, 0, 0, 1}; Point(3) = {2, 1, 0, 1}; Point(4) = {1, 1, 0, 1}; Point(5) = {0, 1, 0, 1};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 5}; Line(5) = {5, 1};
Curve Loop(1) = {1, 2, 3, 4, 5}; Plane Surface(1) = {1};
Physical Curve("ground") = {-3, 4}; Physical Curve("body") = {1}; Physical Surface("body") = {1};
GEO
cd "$work"
cat > look.py <<'PY'
import gmsh, meshio, numpy as np
gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
gmsh.open("model.geo")
gmsh.model.mesh.generate(2)
gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
gmsh.write("model.msh")
curves = sorted(abs(int(c)) for c in gmsh.model.getEntitiesForPhysicalGroup(1, 1))
gmsh.finalize()
mesh = meshio.read("model.msh")
def length(name):
    total = 0.0
    for block, index in zip(mesh.cells, mesh.cell_sets[name]):
        if block.type == "line" and index is not None:
            ends = mesh.points[block.data[np.asarray(index, dtype=int)]]
            total += float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum())
    return total
print("meshio", meshio.__version__, "with Gmsh 4.15.2")
print(f"'ground': curves {curves}, 2 m expected, {length('ground'):g} m seen")
print(f"curve group 'body': 2 m expected, {length('body'):g} m seen")
assert length("ground") == 1.0 and length("body") == 0.0, "the behaviour has changed"
PY
"$work/venv/bin/python" look.py
