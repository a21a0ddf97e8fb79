"""Estimated error of the mesh of a finished field run: in its record, as a field for ParaView, and in one line."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np

from granfabric.cases.records import files
from granfabric.cases.records.record import Record
from granfabric.cases.terminal.screen import Screen
from granfabric.fem.discretisation.mesh_error import stress_error
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.loads.problem import Problem


def estimate(folder: Path, record: Record, problem: Problem, last: StepResult) -> None:
    """Estimate the error of the stress change at the end of a run.

    Writes `mesh_error.vtu`: for each cell `stress_error`, its fraction of the error (the squares add up to that of the
    whole). The record gets `mesh_error`: `stress`, the relative error, and `place`, the centre of the worst cell [m].
    """
    space = problem.space
    index = problem.material_index
    region = None if index is None else index.reshape(space.nelements, -1)[:, 0]
    change = last.stress - problem.initial_stress
    there = np.ones(space.nelements, dtype=bool)
    if last.active is not None:  # what is not there is a material of its own, without stress and so without error
        there = last.active
        change[~there[space.point_cell]] = 0.0
        own = np.zeros(space.nelements, dtype=np.int32) if region is None else region.copy()
        own[~there] = own.max() + 1
        region = own
    found = stress_error(space, change, region)
    worst = int(found.of_cells.argmax())
    corners = space.host_mesh.mesh.t.T
    place = space.host_mesh.mesh.p.T[corners[worst]].mean(axis=0)
    record.details["mesh_error"] = {"stress": found.relative, "place": place.tolist()}
    points = np.pad(space.host_mesh.mesh.p.T, ((0, 0), (0, 1)))
    fractions = {"stress_error": [found.of_cells[there]]}
    mesh = meshio.Mesh(points, [(space.host_mesh.cell, corners[there])], cell_data=fractions)
    files.write_whole(folder / files.MESH_ERROR, lambda path: mesh.write(path, file_format="vtu"))


def report(record: Record, screen: Screen) -> None:
    """Say the estimated error of the mesh, if there is one."""
    found = record.details.get("mesh_error")
    if found is not None:
        x, y = found["place"]
        screen.say(
            f"mesh: estimated error of the stress changes {100 * found['stress']:.2g} % of their norm, largest near "
            f"({x:.3g}, {y:.3g}) m: {files.MESH_ERROR}"
        )
