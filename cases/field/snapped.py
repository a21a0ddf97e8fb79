"""What moved to the nodes of the mesh: ends of parts of boundaries, points of supports and controls."""

from __future__ import annotations

import numpy as np

from granfabric.cases.scene.reader import LoadedScene
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import HostMesh
from granfabric.fem.mesh.summary import side_lengths

NOTICED = 1e-9
"""Distance, relative to the size of the mesh, that is told."""


def snapped(loaded: LoadedScene, problem: Problem) -> list[str]:
    """A note for each part of a boundary, support of a point and led point that is not where the scene puts it.

    Parameters
    ----------
    loaded : LoadedScene
        Of kind "field".
    problem : Problem
    """
    mesh = problem.space.host_mesh
    least = NOTICED * float(np.ptp(mesh.mesh.p, axis=1).max())
    told = (_part(loaded, mesh, place, part, least) for place, part in enumerate(loaded.scene.mesh.part))
    said = [text for text in told if text]
    for place, stage in enumerate(loaded.scene.stage):
        for number, load in enumerate(stage.fixed_point):
            away, (x, y) = _nearest(problem, load.point)
            if away > least:
                where = loaded.label(["stage", place, "fixed_point", number])
                said.append(f"note: {where}: the nearest node is at ({x:.6g}, {y:.6g}) m, {away:.3g} m away")
        if stage.control is not None and stage.control.point is not None:
            away, (x, y) = _nearest(problem, stage.control.point)
            if away > least:
                where = loaded.label(["stage", place, "control"])
                said.append(f"note: {where}: it leads the node at ({x:.6g}, {y:.6g}) m, {away:.3g} m away")
    return said


def _part(loaded: LoadedScene, mesh: HostMesh, place: int, part: object, least: float) -> str:
    if not part.snap:  # type: ignore[attr-defined]
        return ""
    facets, moved = mesh.facets_near(part.boundary, part.x, part.y)  # type: ignore[attr-defined]
    if moved <= least:
        return ""
    ends = mesh.mesh.p[:, mesh.mesh.facets[:, facets]].reshape(2, -1)
    span = " and ".join(
        f"{axis} = [{ends[number].min():.6g}, {ends[number].max():.6g}]"
        for number, axis in enumerate("xy")
        if getattr(part, axis) is not None
    )
    where, length = loaded.label(["mesh", "part", place]), float(side_lengths(mesh)[facets].sum())
    return f"note: {where}: its ends moved by up to {moved:.3g} m to nodes: {span}, {length:.6g} m long"


def _nearest(problem: Problem, point: list[float]) -> tuple[float, tuple[float, float]]:
    away = np.hypot(*(problem.space.nodes - np.asarray(point)).T)
    node = int(np.argmin(away))
    x, y = problem.space.nodes[node].tolist()
    return float(away[node]), (x, y)
