"""Stages on a space: which degrees of freedom each stage prescribes, their end values, and its nodal forces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from granfabric.fem.discretisation.space import Space
from granfabric.fem.mesh.checks import MeshError

from .amplitude import RAMP, Amplitude, merged_corners
from .checks import COMPONENTS, Array, LoadError, values_at
from .control import LoadControl
from .kinds import (
    BodyForce,
    Displacement,
    Fixed,
    FixedPoint,
    Load,
    Pressure,
    RigidBody,
    Spring,
    Stage,
    Traction,
    check_stages,
)
from .rigid import MOTIONS, Contact
from .stage_forces import BODY, ForceProgram, StageForces
from .ties import Tie, Ties, check_motions

Key = tuple[Any, ...]

# Two prescribed displacements of one node are the same if they differ by less than this fraction of the largest one.
SAME_DISPLACEMENT = 1e-9


@dataclass(frozen=True)
class Led:
    """What the control of a stage leads.

    Parameters
    ----------
    target : float
        At the end of the stage, of a coordinate of a rigid body in its own unit [m].
    dof : int
        Degree of freedom; -1 if it is a coordinate of a rigid body.
    tie : int
        Number of the rigid body among those of the stage; -1 if there is none.
    """

    target: float
    dof: int = -1
    tie: int = -1


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
        Degrees of freedom that the stage before prescribed or tied and this one does not.
    force_start, force_end : ndarray, shape (ndofs,)
        Nodal forces of tractions, pressures, body forces and rigid bodies [N/m]; as far as they follow from the
        stages, without what a control found.
    moving : tuple of (Amplitude, ndarray of int)
        Places among the constrained ones whose displacement does not go linearly.
    corners : tuple of float
        Fractions at which a step ends, ascending, the last is 1.
    ties : Ties, optional
        Rigid bodies.
    springs : tuple of (Spring, csr_matrix)
    led : Led, optional
    """

    stage: Stage
    constrained: NDArray[np.int64]
    target: Array
    released: NDArray[np.int64]
    force_start: Array
    force_end: Array
    moving: tuple[tuple[Amplitude, NDArray[np.int64]], ...] = ()
    corners: tuple[float, ...] = (1.0,)
    ties: Ties | None = None
    springs: tuple[tuple[Spring, csr_matrix], ...] = ()
    led: Led | None = None

    def moved(self, fraction: float, here: Array, target: Array) -> Array:
        """Displacements of the constrained degrees of freedom at a position within the stage [m]."""
        moved = here + fraction * (target - here)
        for amplitude, places in self.moving:
            factor = amplitude.factor(fraction, self.stage.increments)
            moved[places] = here[places] + factor * (target[places] - here[places])
        return moved


@dataclass(frozen=True)
class _Constraint:
    dofs: NDArray[np.int64]
    values: Array  # nan: stay
    label: str
    amplitude: Amplitude = RAMP


class _Named:
    """What one stage names, by the key under which a later stage replaces it."""

    def __init__(self) -> None:
        self.constraints: dict[Key, _Constraint] = {}
        self.forces: dict[Key, tuple[Array, Amplitude]] = {}
        self.ties: dict[str, Tie] = {}
        self.springs: dict[str, tuple[Spring, csr_matrix]] = {}


class LoadProgram:
    """All stages, resolved and checked before anything runs.

    Parameters
    ----------
    space : Space
    stages : sequence of Stage

    Attributes
    ----------
    terms : list of StageTerms
    contacts : dict of str to Contact
        Boundaries that are tied to a rigid body in some stage.

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
        self.contacts: dict[str, Contact] = {}
        constraints: dict[Key, _Constraint] = {}
        ties: dict[str, Tie] = {}
        springs: dict[str, tuple[Spring, csr_matrix]] = {}
        # Displacement of each degree of freedom at the end of the stage, as far as it is known beforehand.
        known = np.zeros(space.ndofs)
        previous = np.empty(0, dtype=np.int64)
        self._forces = ForceProgram(space.ndofs)
        for stage in stages:
            named = _Named()
            for load in stage.loads:
                try:
                    _resolve(space, load, stage, named)
                except MeshError as error:
                    raise MeshError(f"stage {stage.name!r}: {error}") from None
            if stage.keep:
                constraints = {**_kept(constraints, named), **named.constraints}
                held = {name: _held(tie) for name, tie in ties.items()}
                _refuse_supports_on_tied(stage, held, named)
                ties, springs = {**held, **named.ties}, {**springs, **named.springs}
            else:
                constraints, ties, springs = named.constraints, named.ties, named.springs
            self.contacts |= {name: tie.contact for name, tie in named.ties.items()}
            self._forces.add(stage, named.forces)
            constrained, target, moving = _merge(space, stage, constraints, known)
            corners = merged_corners([stage.amplitude_of(load) for load in stage.loads], stage.increments)
            forces = self._forces.of(len(self.terms), ())
            terms = StageTerms(
                stage,
                constrained,
                target,
                np.empty(0, dtype=np.int64),
                forces.start,
                forces.end,
                moving,
                tuple(corners),
                springs=tuple(springs.values()),
            )
            terms = self._with_ties(space, terms, list(ties.values()), known)
            now = terms.constrained if terms.ties is None else np.union1d(terms.constrained, terms.ties.dofs)
            released = np.setdiff1d(previous, now)
            self.terms.append(replace(terms, released=released))
            moved = np.full(space.ndofs, np.nan)
            here = known[constrained]
            end = np.where(np.isnan(target), here, target)
            for amplitude, places in moving:
                reached = amplitude.factor(1.0, stage.increments)
                if reached != 1.0:
                    end[places] = here[places] + reached * (end[places] - here[places])
            moved[constrained] = end
            known, previous = moved, now

    def _with_ties(self, space: Space, terms: StageTerms, ties: list[Tie], known: Array) -> StageTerms:
        """Terms with rigid bodies and what is led."""
        stage = terms.stage
        try:
            led = None if stage.control is None else self._led(space, terms, ties, stage.control)
            if led is not None and led.tie >= 0:
                coordinate = (*COMPONENTS, "rotation").index(stage.control.component)  # type: ignore[union-attr]
                ties[led.tie] = replace(ties[led.tie], led=coordinate)
            if not ties:
                return replace(terms, led=led)
            made = Ties(space.ndofs, terms.constrained, ties)
        except LoadError as error:
            raise LoadError(f"stage {stage.name!r}: {error}") from None
        check_motions(made, terms.target - known[terms.constrained], known, f"stage {stage.name!r}")
        return replace(terms, ties=made, led=led)

    def _led(self, space: Space, terms: StageTerms, ties: list[Tie], control: LoadControl) -> Led:
        if control.rigid is not None:
            names = [tie.contact.body.boundary for tie in ties]
            if control.rigid not in names:
                raise LoadError(
                    f"the control leads a rigid body on boundary {control.rigid!r}, but there is none "
                    f"(there are: {', '.join(map(repr, names)) or 'none'})"
                )
            tie = ties[number := names.index(control.rigid)]
            coordinate = (*COMPONENTS, "rotation").index(control.component)
            if tie.prescribed[coordinate]:
                raise LoadError(
                    f"the control leads the {MOTIONS[coordinate]} of the rigid body on boundary {control.rigid!r}, "
                    "which is prescribed or held"
                )
            return Led(control.target * (tie.contact.arm if coordinate == 2 else 1.0), tie=number)
        assert control.point is not None
        node = _nearest(space, control.point)
        dof = 2 * node + COMPONENTS.index(control.component)
        x, y = space.nodes[node]
        if dof in terms.constrained:
            raise LoadError(
                f"the control leads component {control.component} of the node at ({x:.6g}, {y:.6g}), which is "
                "prescribed"
            )
        for tie in ties:
            if node in tie.contact.nodes:
                name = tie.contact.body.boundary
                raise LoadError(
                    f"the control leads the node at ({x:.6g}, {y:.6g}), which moves with the rigid body on boundary "
                    f"{name!r}; lead that one: rigid = {name!r}"
                )
        return Led(control.target, dof)

    def forces(self, index: int, factors: Sequence[float] = ()) -> StageForces:
        """Nodal forces of a stage.

        Parameters
        ----------
        index : int
        factors : sequence of float
            What the controls of the stages before have come to, 1 for those without; none if there is no control.
        """
        return self._forces.of(index, tuple(factors))

    @property
    def controlled(self) -> bool:
        """Whether a stage has a control."""
        return any(terms.led is not None for terms in self.terms)

    @property
    def spring_boundaries(self) -> list[str]:
        """Boundaries that have springs in some stage."""
        return list(dict.fromkeys(spring.boundary for terms in self.terms for spring, _ in terms.springs))


def _kept(constraints: dict[Key, _Constraint], named: _Named) -> dict[Key, _Constraint]:
    """Supports of an earlier stage that stay; a rigid body takes the place of those of its own boundary."""
    places = {f"boundary {name!r}" for name in named.ties}
    return {
        key: _Constraint(held.dofs, np.full(len(held.dofs), np.nan), held.label.removesuffix(" (kept)") + " (kept)")
        for key, held in constraints.items()
        if key[0] not in places
    }


def _held(tie: Tie) -> Tie:
    """A rigid body that a stage does not name: what was prescribed stays, its force as well."""
    return replace(tie, target=np.full(3, np.nan), amplitude=RAMP, led=-1)


def _refuse_supports_on_tied(stage: Stage, held: dict[str, Tie], named: _Named) -> None:
    for place, _ in named.constraints:
        for name in held:
            if place == f"boundary {name!r}" and name not in named.ties:
                raise LoadError(
                    f"stage {stage.name!r}: boundary {name!r} is tied to a rigid body; move or hold that one (rigid), "
                    "or take keep = false"
                )


def _nearest(space: Space, point: Sequence[float]) -> int:
    """Node nearest to a point."""
    return int(np.argmin(np.sum((space.nodes - np.asarray(point)) ** 2, axis=1)))


def _resolve(space: Space, load: Load, stage: Stage, named: _Named) -> None:
    """Enter one load under the key by which a later stage replaces it."""
    amplitude = stage.amplitude_of(load)
    if isinstance(load, (Fixed, FixedPoint, Displacement)):
        if isinstance(load, FixedPoint):
            nodes = np.array([_nearest(space, load.point)])
            place, components = f"point {load.point}", load.components
        else:
            nodes, place = space.boundary_nodes(load.boundary), f"boundary {load.boundary!r}"
            components = load.components if isinstance(load, Fixed) else (load.component,)
        for component in components:
            values = np.full(len(nodes), np.nan)
            if isinstance(load, Displacement):
                values[:] = values_at(f"the displacement of {place}", load.value, (), *space.nodes[nodes].T)
            if (place, component) in named.constraints:
                raise LoadError(f"stage {stage.name!r} prescribes component {component} of {place} twice")
            dofs = 2 * nodes + COMPONENTS.index(component)
            named.constraints[place, component] = _Constraint(dofs, values, place, amplitude)
        return
    if isinstance(load, Spring):
        if load.boundary in named.springs:
            raise LoadError(f"stage {stage.name!r} has springs on boundary {load.boundary!r} twice")
        named.springs[load.boundary] = (load, load.matrix(space))
        return
    key, vector = _tied(space, load, stage, named, amplitude) if isinstance(load, RigidBody) else _force(space, load)
    if key in named.forces:
        raise LoadError(f"stage {stage.name!r} prescribes the {key[0]} on {key[1]!r} twice")
    named.forces[key] = vector, amplitude


def _tied(space: Space, load: RigidBody, stage: Stage, named: _Named, amplitude: Amplitude) -> tuple[Key, Array]:
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


def _merge(
    space: Space, stage: Stage, constraints: dict[Key, _Constraint], known: Array
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
