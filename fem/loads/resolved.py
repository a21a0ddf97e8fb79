"""Loads on a space: the degrees of freedom that a support prescribes, the nodal forces of a load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from granfabric.fem.discretisation.space import Space

from .amplitude import RAMP, Amplitude
from .bodies import Body, SpaceOfBody
from .checks import COMPONENTS, Array, LoadError, values_at
from .kinds import BodyForce, Displacement, Fixed, FixedPoint, Load, Pressure, RigidBody, Spring, Stage, Traction
from .rigid import Contact
from .stage_forces import BODY, NodalForce
from .ties import Tie

Key = tuple[Any, ...]

# Two prescribed displacements of one node are the same if they differ by less than this fraction of the largest one.
SAME_DISPLACEMENT = 1e-9


@dataclass(frozen=True)
class Constraint:
    """Displacements that a support prescribes."""

    dofs: NDArray[np.int64]
    values: Array  # nan: stay
    label: str
    amplitude: Amplitude = RAMP


class Named:
    """What one stage names, by the key under which a later stage replaces it."""

    def __init__(self) -> None:
        self.constraints: dict[Key, Constraint] = {}
        self.forces: dict[Key, NodalForce] = {}
        self.ties: dict[str, Tie] = {}
        self.springs: dict[str, tuple[Spring, csr_matrix]] = {}


def kept_supports(constraints: dict[Key, Constraint], named: Named) -> dict[Key, Constraint]:
    """Supports of an earlier stage that stay; a rigid body takes the place of those of its own boundary."""
    places = {f"boundary {name!r}" for name in named.ties}
    return {
        key: Constraint(held.dofs, np.full(len(held.dofs), np.nan), held.label.removesuffix(" (kept)") + " (kept)")
        for key, held in constraints.items()
        if key[0] not in places
    }


def held_body(tie: Tie) -> Tie:
    """A rigid body that a stage does not name: what was prescribed stays, its force as well."""
    return replace(tie, target=np.full(3, np.nan), amplitude=RAMP, led=-1)


def refuse_supports_on_tied(stage: Stage, held: dict[str, Tie], named: Named) -> None:
    """Refuse to prescribe displacements of a boundary that an earlier stage has tied."""
    for place, _ in named.constraints:
        for name in held:
            if place == f"boundary {name!r}" and name not in named.ties:
                raise LoadError(
                    f"stage {stage.name!r}: boundary {name!r} is tied to a rigid body; move or hold that one (rigid), "
                    "or take keep = false"
                )


def present(body: Body | None, constraints: dict[Key, Constraint]) -> dict[Key, Constraint]:
    """Constraints as far as their degrees of freedom are there."""
    if body is None:
        return constraints
    found = {}
    for key, held in constraints.items():
        there = body.dofs[held.dofs]
        found[key] = replace(held, dofs=held.dofs[there], values=held.values[there])
    return found


def refuse_absent(space: Space, load: Load, body: Body, stage: str, constraints: dict[Key, Constraint]) -> None:
    """Refuse a load or a support of which nothing is there."""
    if isinstance(load, (RigidBody, Spring)):
        return  # on what no stage changes, see `refuse_touched`
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


def refuse_touched(space: Space, stages: Sequence[Stage], bodies: Sequence[Body | None]) -> None:
    """Refuse springs and rigid bodies on what stages take away or add: there a boundary would change its shape.

    What has changed before the first stage that names a boundary does no harm, if all of the boundary is there then and
    it is an outer one of the mesh: a footing on a fill, for instance.

    Raises
    ------
    LoadError
        Naming the load and the stage that changes what it acts on.
    """
    first: dict[tuple[type, str], int] = {}
    for place, stage in enumerate(stages):
        for load in stage.loads:
            if isinstance(load, (RigidBody, Spring)) and load.boundary in space.host_mesh.boundaries:
                first.setdefault((type(load), load.boundary), place)
    for (kind, name), begins in first.items():
        beside = space.host_mesh.mesh.f2t[:, space.host_mesh.facets(name)]
        outer = bool((beside[1] < 0).all())
        body = bodies[begins]
        late = begins if outer and body is not None and body.active[beside[0]].all() else 0
        for changing, body in zip(stages[late:], bodies[late:]):
            if body is None or not body.changes:
                continue
            cells = np.zeros(space.nelements, dtype=bool)
            cells[body.removed] = cells[body.placed] = True
            if kind is Spring:
                touched, what = bool(((beside >= 0) & cells[beside]).any()), "springs"
            else:
                nodes = np.zeros(space.nnodes, dtype=bool)
                nodes[space.element_nodes[cells]] = True
                touched, what = bool(nodes[space.boundary_nodes(name)].any()), "a rigid body"
            if touched:
                raise LoadError(
                    f"stage {stages[begins].name!r} has {what} on boundary {name!r}, and stage {changing.name!r} "
                    "activates or deactivates elements there; springs and rigid bodies need a boundary whose "
                    "elements stay as they are, on a fill from the stage after its placement on"
                )


def nearest(space: Space, point: Sequence[float]) -> int:
    """Node nearest to a point."""
    return int(np.argmin(np.sum((space.nodes - np.asarray(point)) ** 2, axis=1)))


def resolve(space: Space, load: Load, stage: Stage, named: Named) -> None:
    """Enter one load under the key by which a later stage replaces it."""
    amplitude = stage.amplitude_of(load)
    if isinstance(load, (Fixed, FixedPoint, Displacement)):
        if isinstance(load, FixedPoint):
            nodes = np.array([nearest(space, load.point)])
            place, components = f"point {load.point}", load.components
        else:
            nodes, place = space.boundary_nodes(load.boundary), f"boundary {load.boundary!r}"
            components = load.components if isinstance(load, Fixed) else (load.component,)
        for component in components:
            values = np.full(len(nodes), np.nan)
            if isinstance(load, Displacement):
                owner = f"stage {stage.name!r}: the displacement of {place}"
                values[:] = values_at(owner, load.value, (), *space.nodes[nodes].T)
            if (place, component) in named.constraints:
                raise LoadError(f"stage {stage.name!r} prescribes component {component} of {place} twice")
            dofs = 2 * nodes + COMPONENTS.index(component)
            named.constraints[place, component] = Constraint(dofs, values, place, amplitude)
        return
    if isinstance(load, Spring):
        if load.boundary in named.springs:
            raise LoadError(f"stage {stage.name!r} has springs on boundary {load.boundary!r} twice")
        try:
            named.springs[load.boundary] = (load, load.matrix(space))
        except LoadError as error:
            raise _of_stage(stage, error) from None
        return
    if isinstance(load, RigidBody):
        key, vector = _tied(space, load, stage, named, amplitude)
        force = NodalForce(vector, amplitude, lambda other: vector)
    else:
        try:
            key, vector = _force(space, load)
        except LoadError as error:
            raise _of_stage(stage, error) from None
        force = NodalForce(vector, amplitude, lambda other: _force(other, load)[1])
    if key in named.forces:
        raise LoadError(f"stage {stage.name!r} prescribes the {key[0]} on {key[1]!r} twice")
    named.forces[key] = force


def _tied(space: Space, load: RigidBody, stage: Stage, named: Named, amplitude: Amplitude) -> tuple[Key, Array]:
    """Enter a rigid body; the nodal forces of its force and moment."""
    if any(place == f"boundary {load.boundary!r}" for place, _ in named.constraints):
        raise LoadError(
            f"stage {stage.name!r}: boundary {load.boundary!r} has a support and a rigid body; hold the body itself "
            '(displacement_x, displacement_y, rotation = "fixed")'
        )
    try:
        contact = Contact(space, load)
        vector = contact.nodal_force()
    except LoadError as error:
        raise LoadError(f"stage {stage.name!r}: {error}") from None
    turn = None if isinstance(load.rotation, str) else load.rotation * contact.arm
    target = np.array([np.nan if value is None else value for value in (*load.displacement, turn)])
    prescribed = (load.displacement[0] is not None, load.displacement[1] is not None, load.rotation != "free")
    named.ties[load.boundary] = Tie(contact, prescribed, target, amplitude)
    return (BODY, load.boundary), vector


def _of_stage(stage: Stage, error: LoadError) -> LoadError:
    """The same with the stage before it, unless it names the stage itself."""
    text = str(error)
    return LoadError(text if text.startswith("stage ") else f"stage {stage.name!r}: {text}")


def _force(space: Space, load: Traction | Pressure | BodyForce) -> tuple[Key, Array]:
    """Key and nodal forces of a traction, a pressure or a body force."""
    if isinstance(load, BodyForce):
        cells = None if load.region is None else space.host_mesh.cells(load.region)
        vector = space.body_vector(lambda x, y: values_at("the body force", load.value, (2,), x, y), cells)
        return ("body force", load.region), vector
    if isinstance(load, Pressure):
        pressure = load.value

        def pressing(x: Array, y: Array, nx: Array, ny: Array) -> Array:
            size = values_at(f"the pressure on boundary {load.boundary!r}", pressure, (), x, y)
            return np.stack([-size * nx, -size * ny], axis=1)

        return ("pressure", load.boundary), space.traction_vector(load.boundary, pressing)
    owner = f"the traction on boundary {load.boundary!r}"
    vector = space.traction_vector(load.boundary, lambda x, y, nx, ny: values_at(owner, load.value, (2,), x, y, nx, ny))
    return (load.name, load.boundary), vector


def merged(
    space: Space, stage: Stage, constraints: dict[Key, Constraint], known: Array
) -> tuple[NDArray[np.int64], Array, tuple[tuple[Amplitude, NDArray[np.int64]], ...]]:
    """One target for each prescribed degree of freedom, and which go there otherwise than linearly.

    Contradictions are refused.

    A degree of freedom of unknown position (free until now) may not be both held and displaced.
    """
    size = max([0.0, *(np.nanmax(np.abs(held.values), initial=0.0) for held in constraints.values())])
    allowed = SAME_DISPLACEMENT * max(size, float(np.nanmax(np.abs(known), initial=0.0)))
    owner: dict[int, tuple[float, float, str]] = {}
    ways: dict[int, Amplitude] = {}
    for constraint in constraints.values():
        for dof, value in zip(constraint.dofs.tolist(), constraint.values.tolist()):
            end = known[dof] if np.isnan(value) else value
            if dof not in owner:
                owner[dof] = (value, end, constraint.label)
                ways[dof] = constraint.amplitude
                continue
            other_value, other_end, label = owner[dof]
            same_hold = np.isnan(value) and np.isnan(other_value)
            if not same_hold and not abs(end - other_end) <= allowed:
                x, y = space.nodes[dof // 2]
                raise LoadError(
                    f"stage {stage.name!r}: the node at ({x:.6g}, {y:.6g}) is told two displacements of component "
                    f"{COMPONENTS[dof % 2]}, by {label} ({other_end:.6g} m) and by {constraint.label} ({end:.6g} m)"
                )
            if ways[dof] != constraint.amplitude and not abs(end - known[dof]) <= allowed:
                x, y = space.nodes[dof // 2]
                raise LoadError(
                    f"stage {stage.name!r}: the node at ({x:.6g}, {y:.6g}) is told two amplitudes of component "
                    f"{COMPONENTS[dof % 2]}, by {label} and by {constraint.label}"
                )
            if np.isnan(other_value):
                owner[dof] = (value, end, constraint.label)
                ways[dof] = constraint.amplitude
    dofs = np.array(sorted(owner), dtype=np.int64)
    places: dict[Amplitude, list[int]] = {}
    for place, dof in enumerate(dofs.tolist()):
        if ways[dof] != RAMP:
            places.setdefault(ways[dof], []).append(place)
    moving = tuple((amplitude, np.array(found, dtype=np.int64)) for amplitude, found in places.items())
    return dofs, np.array([owner[dof][0] for dof in dofs.tolist()]), moving
