"""Stages on a space: which degrees of freedom each stage prescribes, their end values, and its nodal forces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from granfabric.fem.discretisation.space import Space
from granfabric.fem.mesh.checks import MeshError

from .amplitude import Amplitude, merged_corners
from .bodies import Body, SpaceOfBody, bodies_of_stages, space_at
from .checks import COMPONENTS, Array, LoadError
from .control import LoadControl
from .kinds import Spring, Stage, check_stages
from .resolved import (
    Constraint,
    Key,
    Named,
    held_body,
    kept_supports,
    merged,
    nearest,
    present,
    refuse_absent,
    refuse_supports_on_tied,
    refuse_touched,
    resolve,
)
from .rigid import MOTIONS, Contact
from .stage_forces import ForceProgram, StageForces
from .ties import Tie, Ties, check_motions


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
    moving: tuple[tuple[Amplitude, NDArray[np.int64]], ...] = ()
    corners: tuple[float, ...] = (1.0,)
    ties: Ties | None = None
    springs: tuple[tuple[Spring, csr_matrix], ...] = ()
    led: Led | None = None
    body: Body | None = None

    def lead(self, displacement: Array) -> tuple[Array, float]:
        """How displacements, shape (ndofs,), move when what the control leads grows by one, and where it is [m]."""
        assert self.led is not None
        if self.led.dof >= 0:
            direction = np.zeros_like(displacement)
            direction[self.led.dof] = 1.0
            return direction, float(displacement[self.led.dof])
        assert self.ties is not None
        tie = self.ties.ties[self.led.tie]
        return self.ties.lead(self.led.tie), float(tie.contact.at_point(displacement)[tie.led])

    def moved(self, fraction: float, here: Array, target: Array) -> Array:
        """Displacements of the constrained degrees of freedom at a position within the stage [m]."""
        moved = here + fraction * (target - here)
        for amplitude, places in self.moving:
            factor = amplitude.factor(fraction, self.stage.increments)
            moved[places] = here[places] + factor * (target[places] - here[places])
        return moved


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
        Boundaries that are tied to a rigid body in some stage, with their first one.

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
        self._bodies: dict[str, list[tuple[int, Contact]]] = {}
        constraints: dict[Key, Constraint] = {}
        ties: dict[str, Tie] = {}
        springs: dict[str, tuple[Spring, csr_matrix]] = {}
        # Displacement of each degree of freedom at the end of the stage, as far as it is known beforehand.
        known = np.zeros(space.ndofs)
        previous = np.empty(0, dtype=np.int64)
        self._forces = ForceProgram(space.ndofs)
        bodies = bodies_of_stages(space, stages)
        refuse_touched(space, stages, bodies)
        body: Body | None = None
        for stage, following in zip(stages, bodies):
            before, body = body, following
            here, spaces = space_at(space, body), None
            if stage.reset_displacements:
                known = np.zeros(space.ndofs)
            if before is not None and body is not None and body.changes:
                known[body.dofs & ~before.dofs] = 0.0
                spaces = SpaceOfBody(space, before.active, body.active), here
            named = Named()
            for load in stage.loads:
                try:
                    resolve(here, load, stage, named)
                except MeshError as error:
                    raise MeshError(f"stage {stage.name!r}: {error}") from None
                if body is not None:
                    refuse_absent(here, load, body, stage.name, named.constraints)
            if stage.keep:
                constraints = {**kept_supports(constraints, named), **named.constraints}
                held = {name: held_body(tie) for name, tie in ties.items()}
                refuse_supports_on_tied(stage, held, named)
                ties, springs = {**held, **named.ties}, {**springs, **named.springs}
            else:
                constraints, ties, springs = named.constraints, named.ties, named.springs
            for name, tie in named.ties.items():
                self.contacts.setdefault(name, tie.contact)
                self._bodies.setdefault(name, []).append((len(self.terms), tie.contact))
            self._forces.add(stage, named.forces, spaces)
            constrained, target, moving = merged(space, stage, present(body, constraints), known)
            corners = merged_corners([stage.amplitude_of(load) for load in stage.loads], stage.increments)
            try:
                forces = self._forces.of(len(self.terms), ())
            except MeshError as error:  # of a load that an earlier stage left on what is no longer a boundary
                raise MeshError(f"stage {stage.name!r}: {error}") from None
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
                body=body,
            )
            terms = self._with_ties(space, terms, list(ties.values()), known)
            now = terms.constrained if terms.ties is None else np.union1d(terms.constrained, terms.ties.dofs)
            released = np.setdiff1d(previous, now)
            if body is not None:
                released = released[body.dofs[released]]
            self.terms.append(replace(terms, released=released))
            moved = np.full(space.ndofs, np.nan)
            start = known[constrained]
            end = np.where(np.isnan(target), start, target)
            for amplitude, places in moving:
                reached = amplitude.factor(1.0, stage.increments)
                if reached != 1.0:
                    end[places] = start[places] + reached * (end[places] - start[places])
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
            made = Ties(space.ndofs, terms.constrained, ties, None if terms.body is None else terms.body.dofs)
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
        node = nearest(space, control.point)
        dof = 2 * node + COMPONENTS.index(control.component)
        x, y = space.nodes[node]
        if terms.body is not None and not terms.body.dofs[dof]:
            raise LoadError(f"the control leads the node at ({x:.6g}, {y:.6g}), which is not active in this stage")
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

    def contact(self, name: str, index: int) -> Contact:
        """Body of a boundary in a stage; where it is not tied then the one to come, or else the one that was last."""
        bodies = self._bodies[name]
        now = [contact for stage, contact in bodies if stage <= index]
        return now[-1] if now else bodies[0][1]

    @property
    def spring_boundaries(self) -> list[str]:
        """Boundaries that have springs in some stage."""
        return list(dict.fromkeys(spring.boundary for terms in self.terms for spring, _ in terms.springs))
