"""
3. From a mesh of your own to ParaView
======================================

A boundary-value problem on a Gmsh mesh: how boundaries and regions are named, how the scene refers to them, and how the
results are read again, in ParaView or in Python.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import meshio
import numpy as np

import granfabric as gf

folder = Path(tempfile.mkdtemp(prefix="granfabric_"))

# %%
# The mesh
# --------
# Gmsh itself would make it from a ``.geo`` file, with ``gmsh -2 -format msh41 embankment.geo``. Names are those of its
# physical groups::
#
#     Physical Curve("bottom") = {1};
#     Physical Curve("crest") = {3};
#     Physical Surface("ground") = {1};
#
# Any program that writes Gmsh's format will do. Here meshio writes an embankment of quadrilaterals, so that the script
# runs without Gmsh: numbers of cells along x and y, and nodes on a grid whose top is narrower than its bottom.

nx, ny = 12, 8
s, t = np.meshgrid(np.linspace(-1.0, 1.0, nx + 1), np.linspace(0.0, 1.0, ny + 1))
nodes = np.column_stack([(s * (4.0 - 2.0 * t)).ravel(), (2.0 * t).ravel(), np.zeros(s.size)])
number = np.arange(s.size).reshape(s.shape)
quads = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)


def sides(line):
    """Pairs of neighbouring nodes."""
    return np.column_stack([line[:-1], line[1:]])


boundaries = {"bottom": sides(number[0]), "crest": sides(number[-1])}
groups = {"ground": (1, 2), "bottom": (2, 1), "crest": (3, 1)}  # name: tag, dimension
cells = [("quad", quads), *(("line", line) for line in boundaries.values())]
tags = [np.full(len(quads), 1), *(np.full(len(line), groups[name][0]) for name, line in boundaries.items())]
meshio.write(
    folder / "embankment.msh",
    meshio.Mesh(
        nodes,
        cells,
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={name: np.array(group) for name, group in groups.items()},
    ),
    file_format="gmsh22",
    binary=False,
)

# %%
# The scene
# ---------
# A scene file names the mesh, the material, the initial stress and the stages of loading. The material here is the
# shipped ``dense_disks``: inputs measured on packings of disks. The embankment starts under an isotropic stress, which
# constant reference forces balance, and gets a load of 20 kPa on its crest.

scene = folder / "embankment.toml"
scene.write_text("""\
title = "Embankment with a load on its crest"
kind = "field"
material_file = "dense_disks"

[mesh]
file = "embankment.msh"
element = "Q2"

[initial]
stress = [-100e3, -100e3, 0.0]
balance = true                  # constant forces hold the initial stress

[[stage]]
name = "load"
increments = 4
fixed = [{ boundary = "bottom" }]
pressure = [{ boundary = "crest", value = 20e3 }]

[output]
pictures = false
""")

# %%
# The run
# -------
# On a terminal: ``granfabric mesh embankment.toml`` to look at the mesh, ``granfabric run embankment.toml -o results``
# to compute. From Python the same files are written. A name that the mesh lacks is told before anything runs.

results = gf.run_scene(scene, output=folder / "results")
print((results.folder / "run.log").read_text())
for file in sorted(results.folder.iterdir()):
    print(file.name)

# %%
# In ParaView
# -----------
# Open ``result.pvd``, apply *Warp By Vector* with ``displacement`` (a scale of some thousands) and colour by
# ``coordination``. ``points.pvd`` holds the integration points with their whole state: *Point Gaussian* shows them.
# ``mesh_error.vtu`` shows where a finer mesh would help.
#
# In Python
# ---------
# ``run_scene`` returns the results, ``gf.read_results(folder)`` opens those of any run. The history is a table of
# pandas, fields are arrays at the nodes, and ``at`` and ``along`` give values at places.

print(results.history[["step", "stage", "p", "q", "coordination"]])
print(results.at(0.0, 1.0))
moved = results.nodes + 2000.0 * results.field("displacement")

figure, axes = plt.subplots(figsize=(8.0, 3.2), layout="constrained")
colours = axes.tricontourf(moved[:, 0], moved[:, 1], results.field("coordination"), levels=12)
figure.colorbar(colours, ax=axes, label="coordination number $z$ [-]")
axes.set(xlabel="$x$ [m]", ylabel="$y$ [m]", aspect="equal", title="Deformed 2000 times")
plt.show()
