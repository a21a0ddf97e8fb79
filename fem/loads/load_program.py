"""Stages on a space: which degrees of freedom each stage prescribes, their end values, and its nodal forces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.arrays import ArrayError, finite
from granfabric.fem.discretisation.space import Space
from granfabric.fem.mesh.checks import MeshError

from .bodies import Body, SpaceOfBody, bodies_of_stages, space_at
from .kinds import (
    COMPONENTS,
    BodyForce,
    Displacement,
    Fixed,
    FixedPoint,
    Load,
    LoadError,
    Pressure,
    Stage,
    Traction,
    check_stages,
)

Array = NDArray[np.float64]
Key = tuple[Any, ...]

# Two prescribed displacements of one node are the same if they differ by less than this fraction of the largest one.
SAME_DISPLACEMENT = 1e-9


@dataclass(frozen=True)
class StageTerms:
    """One stage in terms of the space.

    Parameters
    ----------
    stage : Stage
    constrained : ndarray of int, ascending
        Prescribed degrees of freedom.
    target : ndarray
        Their displacements at the end of the stage [m]; nan where the one at the start of the stage stays.
    released : ndarray of int
        Degrees of freedom that the stage before prescribed and this one does not.
    force_start, force_end : ndarray, shape (ndofs,)
        Nodal forces of tractions, pressures and body forces [N/m].
    body : Body, optional
        What is there in this stage, where stages change it; loads act on that alone, and `force_start` leaves out what
        the stage takes away.
    """

    stage: Stage
    constrained: NDArray[np.int64]
    target: Array
    released: NDArray[np.int64]
    force_start: Array
    force_end: Array
    body: Body | None = None


@dataclass(frozen=True)
class _Constraint:
    dofs: NDArray[np.int64]
    values: Array  # nan: stay
    label: str


class LoadProgram:
    """All stages, resolved and checked before anything runs.

    Parameters
    ----------
    space : Space
    stages : sequence of Stage

    Raises
    ------
    LoadError
        If stages or loads contradict each other.
    MeshError
        If a load names a boundary or region that the mesh does not have.
    """

    def __init__(self, space: Space, stages: Sequence[Stage]) -> None:
        check_stages(stages)
        self.terms: list[StageTerms] = []
        constraints: dict[Key, _Constraint] = {}
        forces: dict[Key, Array] = {}
        # Displacement of each degree of freedom at the end of the stage, as far as it is known beforehand.
        known = np.zeros(space.ndofs)
        previous = np.empty(0, dtype=np.int64)
        force_start = np.zeros(space.ndofs)
        acting: dict[Key, Load] = {}
        body: Body | None = None
        for stage, following in zip(stages, bodies_of_stages(space, stages)):
            before, body = body, following
            here = space_at(space, body)
            if stage.reset_displacements:
                known = np.zeros(space.ndofs)
            if before is not None and body is not None and body.changes:
                known[body.dofs & ~before.dofs] = 0.0
                left = SpaceOfBody(space, before.active, body.active)
                force_start = np.sum(list(_forces(left, acting, stage.name).values()), axis=0) + np.zeros(space.ndofs)
            named_constraints: dict[Key, _Constraint] = {}
            named_forces: dict[Key, Array] = {}
            named: dict[Key, Load] = {}
            for load in stage.loads:
                try:
                    _resolve(here, load, stage.name, named_constraints, named_forces)
                except MeshError as error:
                    raise MeshError(f"stage {stage.name!r}: {error}") from None
                named |= {key: load for key in named_forces if key not in named}
                if body is not None:
                    _refuse_absent(here, load, body, stage.name, named_constraints)
            if stage.keep:
                named = {**acting, **named}
            if before is not None and body is not None and body.changes:
                kept = {key: load for key, load in named.items() if key not in named_forces}
                forces = _forces(here, kept, stage.name)
            acting = named
            if stage.keep:
                held_on = {
                    key: _Constraint(held.dofs, np.full(len(held.dofs), np.nan), held.label + " (kept)")
                    for key, held in constraints.items()
                }
                constraints = {**held_on, **named_constraints}
                forces = {**forces, **named_forces}
            else:
                constraints, forces = named_constraints, named_forces
            constrained, target = _merge(space, stage, _present(body, constraints), known)
            force_end = np.sum(list(forces.values()), axis=0) if forces else np.zeros(space.ndofs)
            released = np.setdiff1d(previous, constrained)
            if body is not None:
                released = released[body.dofs[released]]
            self.terms.append(StageTerms(stage, constrained, target, released, force_start, force_end, body))
            moved = np.full(space.ndofs, np.nan)
            moved[constrained] = np.where(np.isnan(target), known[constrained], target)
            known, previous, force_start = moved, constrained, force_end


def _forces(space: Space, loads: dict[Key, Load], stage: str) -> dict[Key, Array]:
    """Nodal forces of loads that an earlier stage set, on another body than there."""
    forces: dict[Key, Array] = {}
    for load in loads.values():
        try:
            _resolve(space, load, stage, {}, forces)
        except MeshError as error:
            raise MeshError(f"stage {stage!r}: {error}") from None
    return forces


def _present(body: Body | None, constraints: dict[Key, _Constraint]) -> dict[Key, _Constraint]:
    """Constraints as far as their degrees of freedom are there."""
    if body is None:
        return constraints
    found = {}
    for key, held in constraints.items():
        there = body.dofs[held.dofs]
        found[key] = _Constraint(held.dofs[there], held.values[there], held.label)
    return found


def _refuse_absent(space: Space, load: Load, body: Body, stage: str, constraints: dict[Key, _Constraint]) -> None:
    """Refuse a load or a support of which nothing is there."""
    if isinstance(load, BodyForce):
        absent = load.region is not None and not body.active[space.host_mesh.cells(load.region)].any()
        what = f"the body force on region {load.region!r}"
    elif isinstance(load, (Fixed, FixedPoint, Displacement)):
        own = f"point {load.point}" if isinstance(load, FixedPoint) else f"boundary {load.boundary!r}"
        absent = any(not body.dofs[held.dofs].any() for (place, _), held in constraints.items() if place == own)
        what = f"the support at {own}"
    else:
        assert isinstance(space, SpaceOfBody)
        taken_back = not callable(load.value) and not np.any(load.value)  # of one that went with its part
        absent, what = not (taken_back or space.has_outside(load.boundary)), f"the load on boundary {load.boundary!r}"
    if absent:
        raise LoadError(f"stage {stage!r}: {what} has nothing to act on: that part is not active in this stage")


def _resolve(
    space: Space, load: Load, stage: str, constraints: dict[Key, _Constraint], forces: dict[Key, Array]
) -> None:
    """Enter one load under the key by which a later stage replaces it."""
    if isinstance(load, (Fixed, FixedPoint, Displacement)):
        if isinstance(load, FixedPoint):
            nodes = np.array([np.argmin(np.sum((space.nodes - np.asarray(load.point)) ** 2, axis=1))])
            place, components = f"point {load.point}", load.components
        else:
            nodes, place = space.boundary_nodes(load.boundary), f"boundary {load.boundary!r}"
            components = load.components if isinstance(load, Fixed) else (load.component,)
        for component in components:
            values = np.full(len(nodes), np.nan)
            if isinstance(load, Displacement):
                values[:] = _values(f"the displacement of {place}", load.value, (), *space.nodes[nodes].T)
            if (place, component) in constraints:
                raise LoadError(f"stage {stage!r} prescribes component {component} of {place} twice")
            constraints[place, component] = _Constraint(2 * nodes + COMPONENTS.index(component), values, place)
        return
    key: Key
    if isinstance(load, BodyForce):
        key = ("body force", load.region)
        cells = None if load.region is None else space.host_mesh.cells(load.region)
        vector = space.body_vector(lambda x, y: _values("the body force", load.value, (2,), x, y), cells)
    elif isinstance(load, Pressure):
        key = ("pressure", load.boundary)
        pressure = load.value

        def pressing(x: Array, y: Array, nx: Array, ny: Array) -> Array:
            size = _values(f"the pressure on boundary {load.boundary!r}", pressure, (), x, y)
            return np.stack([-size * nx, -size * ny], axis=1)

        vector = space.traction_vector(load.boundary, pressing)
    else:
        assert isinstance(load, Traction)
        key = (load.name, load.boundary)
        owner = f"the traction on boundary {load.boundary!r}"
        vector = space.traction_vector(
            load.boundary, lambda x, y, nx, ny: _values(owner, load.value, (2,), x, y, nx, ny)
        )
    if key in forces:
        raise LoadError(f"stage {stage!r} prescribes the {key[0]} on {key[1]!r} twice")
    forces[key] = vector


def _values(owner: str, value: Any, shape: tuple[int, ...], *places: Array) -> Array:
    """What a constant or a callable is at n places, shape (n, *shape); a constant may come out of a callable too.

    Raises
    ------
    LoadError
        If it is of another shape, which would be another load, or not finite.
    """
    came = value(*places) if callable(value) else value
    wanted = (len(places[0]), *shape)
    try:
        if np.shape(came) == shape:
            return np.broadcast_to(finite(owner, came, shape), wanted)
        return finite(owner, came, wanted)
    except ArrayError as error:
        raise LoadError(str(error)) from None


def _merge(
    space: Space, stage: Stage, constraints: dict[Key, _Constraint], known: Array
) -> tuple[NDArray[np.int64], Array]:
    """One target for each prescribed degree of freedom; contradictions are refused.

    A degree of freedom of unknown position (free until now) may not be both held and displaced.
    """
    size = max([0.0, *(np.nanmax(np.abs(held.values), initial=0.0) for held in constraints.values())])
    allowed = SAME_DISPLACEMENT * max(size, float(np.nanmax(np.abs(known), initial=0.0)))
    owner: dict[int, tuple[float, float, str]] = {}
    for constraint in constraints.values():
        for dof, value in zip(constraint.dofs.tolist(), constraint.values.tolist()):
            end = known[dof] if np.isnan(value) else value
            if dof not in owner:
                owner[dof] = (value, end, constraint.label)
                continue
            other_value, other_end, label = owner[dof]
            same_hold = np.isnan(value) and np.isnan(other_value)
            if not same_hold and not abs(end - other_end) <= allowed:
                x, y = space.nodes[dof // 2]
                raise LoadError(
                    f"stage {stage.name!r}: the node at ({x:.6g}, {y:.6g}) is told two displacements of component "
                    f"{COMPONENTS[dof % 2]}, by {label} ({other_end:.6g} m) and by {constraint.label} ({end:.6g} m)"
                )
            if np.isnan(other_value):
                owner[dof] = (value, end, constraint.label)
    dofs = np.array(sorted(owner), dtype=np.int64)
    return dofs, np.array([owner[dof][0] for dof in dofs.tolist()])
