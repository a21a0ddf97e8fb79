"""From a checked field scene to a problem that the host can solve."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.scene import build
from granfabric.cases.scene.effects_choice import resolve_effects
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.scene.schema_law_kind import is_grains
from granfabric.cases.scene.schema_mesh import SHAPES
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.control import ControlError, StepControl
from granfabric.fem.linear_solvers.direct import LinearSolverError, make_solver
from granfabric.fem.loads.checks import LoadError
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import HostMesh, MeshError, read_mesh, rectangle
from granfabric.fem.mesh.shapes import plate_with_hole, quarter_ring

from . import initial_state, memory
from .groups import check_groups, material_index, named_boundaries
from .probes import probe_places
from .stage_loads import stages

POINTS = {"P1": 1, "P2": 3, "Q1": 4, "Q2": 9}
"""Integration points of an element."""
STAND_IN = LinearElasticLaw(ElasticMaterial(1.0, 0.0))
BYTES_PER_POINT = 600
"""Stress, strain, state and tangent of a point at the start and the end of a step; the matrix comes on top."""


def read_or_make_mesh(loaded: LoadedScene) -> HostMesh:
    """Mesh of a field scene, with the parts of boundaries that it names.

    Raises
    ------
    InputError
        If the mesh file is not usable.
    """
    mesh = loaded.scene.mesh
    if mesh.file is None:
        _refuse_too_many_cells(loaded)
    try:
        made = read_mesh(loaded.file.parent / mesh.file, mesh.parts) if mesh.file is not None else _shape(mesh)
    except MeshError as error:
        key = "file" if mesh.file is not None else next(name for name in SHAPES if getattr(mesh, name) is not None)
        raise loaded.error(["mesh", key], f"mesh.{key}: {error}") from error
    for place, part in enumerate(mesh.part):
        keys = ["mesh", "part", place]
        if part.name in made.boundaries:
            raise loaded.error(keys, f"{loaded.label(keys)}: the mesh has a boundary {part.name!r} already")
        try:
            if part.snap:
                made.boundaries[part.name] = made.facets_near(part.boundary, part.x, part.y)[0]
            else:
                made.boundaries[part.name] = made.facets_between(part.boundary, part.x, part.y)
        except MeshError as error:
            raise loaded.error(keys, f"{loaded.label(keys)}: {error}") from error
    return made


def _refuse_too_many_cells(loaded: LoadedScene) -> None:
    mesh = loaded.scene.mesh
    name = next(name for name in SHAPES if getattr(mesh, name) is not None)
    shape = getattr(mesh, name)
    across, along = (shape.nx, shape.ny) if name == "rectangle" else (shape.n_radial, shape.n_around)
    across, along = mesh.refine * across, mesh.refine * along
    needed = BYTES_PER_POINT * across * along * (2 if shape.cell == "triangle" else 1) * POINTS[mesh.element]
    memory.refuse_beyond(needed, f"{loaded.file}: mesh.{name}, {across} x {along} cells,")


def _shape(mesh: Any) -> HostMesh:
    """Parametric mesh with refined numbers of cells."""
    times = mesh.refine
    if (shape := mesh.rectangle) is not None:
        return rectangle(shape.width, shape.height, times * shape.nx, times * shape.ny, shape.cell)
    if (ring := mesh.ring) is not None:
        cells = times * ring.n_radial, times * ring.n_around
        return quarter_ring(ring.inner_radius, ring.outer_radius, *cells, ring.cell)
    plate = mesh.plate_with_hole
    cells = times * plate.n_radial, times * plate.n_around
    return plate_with_hole(plate.radius, plate.width, plate.height, *cells, plate.cell)


@dataclass(frozen=True)
class Prepared:
    """A field scene turned into a problem; nothing has been computed or written."""

    problem: Problem
    control: StepControl
    boundaries: list[str]
    supported: list[str]
    effects: Any
    probes: dict[str, NDArray[np.float64]]


def _of_stage(loaded: LoadedScene, text: str) -> str:
    """What the host says about a stage, with the stage as a user counts it."""
    for number, stage in enumerate(loaded.scene.stage):
        begin = f"stage {stage.name!r}"
        if text.startswith((f"{begin}: ", f"{begin} ")):
            return loaded.label(["stage", number]) + text[len(begin) :]
    return f"stage: {text}"


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
    effects = None if is_grains(scene) else resolve_effects(scene)
    # grains take the place of the elastic law once all else has been checked, because packings take time to make
    law = STAND_IN if effects is None else build.law(loaded, effects)
    try:
        space = Space(mesh, scene.mesh.element, scene.mesh.quadrature_degree)
    except MeshError as error:
        raise loaded.error(["mesh"], f"mesh: {error}") from error
    point_index = None if index is None else index[space.point_cell]
    try:
        program = stages(scene)
        wet = isinstance(law, ContactLaw) and law.effects.pore_fluid
        stress, state = initial_state.stress(loaded, space, program, wet), None
        if isinstance(law, ContactLaw):
            initial_state.refuse_beyond_law(loaded, law, stress, point_index)
            stress, state = initial_state.with_water(loaded, law, space, program, stress, point_index)
        problem = Problem(
            space,
            law,
            program,
            initial_stress=stress,
            material_index=point_index,
            initial_state=state,
            balance_initial_stress=scene.initial.balance,
        )
    except (LoadError, MeshError) as error:
        raise loaded.error(["stage"], _of_stage(loaded, str(error))) from error
    try:
        control = StepControl(**scene.solver.model_dump())
    except ControlError as error:
        raise loaded.error(["solver"], f"solver: {error}") from error
    try:
        make_solver(control.linear_solver)
    except LinearSolverError as error:
        raise loaded.error(["solver"], f"solver.linear_solver: {error}") from error
    return Prepared(problem, control, *named_boundaries(scene), effects, probe_places(loaded, space))
