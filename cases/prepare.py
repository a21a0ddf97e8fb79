"""From a checked field scene to a problem that the host can solve."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from fem.control import ControlError, StepControl
from fem.linear_solver import LinearSolverError, make_solver
from fem.loads import (
    BodyForce,
    Displacement,
    Fixed,
    FixedPoint,
    LoadError,
    Pressure,
    Stage,
    Traction,
)
from fem.mesh import HostMesh, MeshError, read_mesh, rectangle
from fem.problem import Problem
from fem.space import Space

from . import build, memory
from .effects_choice import resolve_effects
from .groups import check_groups, material_index, named_boundaries
from .scene import LoadedScene

POINTS = {"P1": 1, "P2": 3, "Q1": 4, "Q2": 9}
"""Integration points of an element."""
BYTES_PER_POINT = 600
"""Stress, strain, state and tangent of a point at the start and the end of a step; the matrix comes on top."""


def stages(scene: Any) -> list[Stage]:
    """Stages of a field scene with their loads."""
    made = []
    for part in scene.stage:
        loads: list[Any] = [Fixed(load.boundary, tuple(load.components)) for load in part.fixed]
        loads += [FixedPoint((load.point[0], load.point[1]), tuple(load.components)) for load in part.fixed_point]
        loads += [Displacement(load.boundary, load.component, load.value) for load in part.displacement]
        loads += [Pressure(load.boundary, load.value) for load in part.pressure]
        loads += [Traction(load.boundary, (load.value[0], load.value[1])) for load in part.traction]
        loads += [BodyForce((load.value[0], load.value[1]), load.region) for load in part.body_force]
        made.append(Stage(part.name, loads, part.increments, part.keep))
    return made


def read_or_make_mesh(loaded: LoadedScene) -> HostMesh:
    """Mesh of a field scene.

    Raises
    ------
    InputError
        If the mesh file is not usable.
    """
    mesh = loaded.scene.mesh
    if mesh.rectangle is not None:
        shape = mesh.rectangle
        cells = shape.nx * shape.ny * (2 if shape.cell == "triangle" else 1)
        needed = BYTES_PER_POINT * cells * POINTS[mesh.element]
        memory.refuse_beyond(needed, f"{loaded.file}: mesh.rectangle, {shape.nx} x {shape.ny} cells,")
        return rectangle(shape.width, shape.height, shape.nx, shape.ny, shape.cell)
    try:
        return read_mesh(loaded.file.parent / mesh.file)
    except MeshError as error:
        raise loaded.error(["mesh", "file"], f"mesh.file: {error}") from error


@dataclass(frozen=True)
class Prepared:
    """A field scene turned into a problem; nothing has been computed or written."""

    problem: Problem
    control: StepControl
    boundaries: list[str]
    supported: list[str]
    effects: Any


def prepare(loaded: LoadedScene) -> Prepared:
    """Check everything about a field scene that can be checked before computing.

    Raises
    ------
    InputError
    """
    scene = loaded.scene
    loaded.require("field")
    mesh = read_or_make_mesh(loaded)
    check_groups(loaded, mesh)
    index = material_index(loaded, mesh)
    effects = resolve_effects(scene)
    law = build.law(loaded, effects)
    try:
        space = Space(mesh, scene.mesh.element, scene.mesh.quadrature_degree)
    except MeshError as error:
        raise loaded.error(["mesh"], f"mesh: {error}") from error
    try:
        problem = Problem(
            space,
            law,
            stages(scene),
            initial_stress=scene.initial.stress,
            material_index=None if index is None else index[space.point_cell],
            balance_initial_stress=scene.initial.balance,
        )
    except (LoadError, MeshError) as error:
        raise loaded.error(["stage"], f"stage: {error}") from error
    try:
        control = StepControl(**scene.solver.model_dump())
    except ControlError as error:
        raise loaded.error(["solver"], f"solver: {error}") from error
    try:
        make_solver(control.linear_solver)
    except LinearSolverError as error:
        raise loaded.error(["solver"], f"solver.linear_solver: {error}") from error
    return Prepared(problem, control, *named_boundaries(scene), effects)
