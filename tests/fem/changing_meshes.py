"""Bodies that stages change: a plate with a core that is taken out, a column in layers."""

from __future__ import annotations

import numpy as np

from granfabric.fem.mesh.host_mesh import HostMesh, build_mesh, rectangle
from granfabric.fem.mesh.shapes import plate_with_hole


def plate_and_core(n: int, radius: float = 1.0, size: float = 4.0) -> tuple[HostMesh, HostMesh]:
    """Quarter of a plate with a hole, alone and with its core of triangles from the centre; regions plate, core.

    Boundaries hole, right, top, and of the symmetry lines bottom, left (with those of the core).
    """
    alone = plate_with_hole(radius, size, size, n, 2 * n, "triangle")
    mesh, hole = alone.mesh, alone.boundaries["hole"]
    points, cells = mesh.p.T, mesh.t.T
    centre = len(points)
    ends = mesh.facets[:, hole].T
    fan = np.column_stack([np.full(len(ends), centre), ends])
    lines = {name: mesh.facets[:, facets].T for name, facets in alone.boundaries.items()}
    on_hole = np.unique(ends)
    for name, axis in (("bottom", 1), ("left", 0)):
        near = on_hole[np.abs(points[on_hole, axis]) < 1e-12]
        lines[name] = np.concatenate([lines[name], [[centre, near[0]]]])
    sides = (mesh.facets.T, alone.curved.p.T[len(points) : len(points) + mesh.facets.shape[1]])
    regions = {"plate": np.arange(len(cells)), "core": len(cells) + np.arange(len(fan))}
    whole = build_mesh(np.concatenate([points, [[0.0, 0.0]]]), np.concatenate([cells, fan]), lines, regions, sides)
    return alone, whole


def column(layers: int, each: int = 2, width: float = 1.0, height: float = 1.0, across: int = 1) -> HostMesh:
    """Layers of the same height on each other, regions layer_1 ...; boundaries top_1 ... between and above them."""
    host = rectangle(width, layers * height, across, layers * each)
    points = host.mesh.p.T
    middle = points[host.mesh.t.T].mean(axis=1)[:, 1]
    number = (middle / height).astype(int)
    lines = {name: host.mesh.facets[:, facets].T for name, facets in host.boundaries.items()}
    ends = host.mesh.facets
    for layer in range(1, layers + 1):
        level = np.abs(points[ends][:, :, 1] - layer * height).max(axis=0) < 1e-9
        lines[f"top_{layer}"] = ends[:, level].T
    regions = {f"layer_{layer + 1}": np.flatnonzero(number == layer) for layer in range(layers)}
    return build_mesh(points, host.mesh.t.T, lines, {"all": np.arange(len(number)), **regions})
