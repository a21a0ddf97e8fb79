"""Stages that change the body: which elements are there at each stage, and loads integrated over these alone.

A region that is named by `activate` before any `deactivate` names it is not there from the outset: it is a fill that
comes later. All others are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.discretisation.active_part import degrees_of_freedom, nodes_of
from granfabric.fem.discretisation.space import Space
from granfabric.fem.mesh.checks import MeshError
from granfabric.fem.mesh.host_mesh import HostMesh

from .kinds import LoadError, Stage

Array = NDArray[np.float64]
Cells = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Body:
    """The body of one stage of a program whose stages change it.

    Parameters
    ----------
    active : ndarray of bool, shape (nelem,)
        Elements that are there in this stage.
    dofs : ndarray of bool, shape (ndofs,)
        Degrees of freedom of these elements.
    beside : ndarray of bool, shape (ndofs,)
        Degrees of freedom of the elements that the stage takes away or adds.
    removed, placed : ndarray of int
        Elements that the stage takes away, and those that it adds.
    released_before, released : float
        Share of the forces of excavations that has been released at the start and at the end of the stage; 1 before
        there is any.
    """

    active: Mask
    dofs: Mask
    beside: Mask
    removed: Cells
    placed: Cells
    released_before: float
    released: float

    @property
    def changes(self) -> bool:
        """Whether the stage changes the body."""
        return bool(len(self.removed) or len(self.placed))


def inactive_at_outset(mesh: HostMesh, stages: Sequence[Stage]) -> Mask:
    """Elements that are not there from the outset, shape (nelem,).

    Raises
    ------
    MeshError
        If a stage names a region that the mesh does not have.
    LoadError
        If nothing is.
    """
    seen: set[str] = set()
    missing = np.zeros(mesh.mesh.t.shape[1], dtype=bool)
    for stage in stages:
        for name in (*stage.deactivate, *stage.activate):
            try:
                cells = mesh.cells(name)
            except MeshError as error:
                raise MeshError(f"stage {stage.name!r}: {error}") from None
            if name not in seen and name in stage.activate:
                missing[cells] = True
            seen.add(name)
    if missing.all():
        raise LoadError("every element is activated by a later stage, so that nothing is there at the outset")
    return missing


def bodies_of_stages(space: Space, stages: Sequence[Stage]) -> list[Body | None]:
    """The body of each stage; None for all of them if no stage changes it.

    Raises
    ------
    LoadError
        If a change is not possible.
    MeshError
        If a stage names a region that the mesh does not have.
    """
    if not any(stage.activate or stage.deactivate for stage in stages):
        for stage in stages:
            if stage.release != 1.0:
                raise LoadError(f"stage {stage.name!r}: release = {stage.release:g}, but no stage deactivates a region")
        return [None] * len(stages)
    mesh = space.host_mesh
    active = ~inactive_at_outset(mesh, stages)
    made: list[Body | None] = []
    reached = 1.0
    for number, stage in enumerate(stages):
        if number == 0 and (stage.activate or stage.deactivate):
            raise LoadError(
                f"stage {stage.name!r}: the first stage cannot change the body; begin with a stage named 'initial' "
                "that holds the loads of the outset"
            )
        removed, placed = _changes(mesh, stage, active)
        before, active = active, active.copy()
        active[removed], active[placed] = False, True
        if not active.any():
            raise LoadError(f"stage {stage.name!r} deactivates everything that is left")
        if len(removed) == 0 and reached == 1.0 and stage.release != 1.0:
            raise LoadError(
                f"stage {stage.name!r}: release = {stage.release:g}, but no forces of an excavation are held any more"
            )
        if reached < 1.0 and stage.release < reached:
            raise LoadError(
                f"stage {stage.name!r}: release = {stage.release:g} is below {reached:g}, the share that an earlier "
                "stage has released"
            )
        started = reached if reached < 1.0 else (0.0 if len(removed) else 1.0)
        reached = stage.release if len(removed) or reached < 1.0 else 1.0
        body = active if (removed.size or placed.size) else before
        changed = np.zeros_like(active)
        changed[removed] = changed[placed] = True
        dofs, beside = (degrees_of_freedom(nodes_of(space, cells)) for cells in (body, changed))
        made.append(Body(body, dofs, beside, removed, placed, started, reached))
    return made


def _changes(mesh: HostMesh, stage: Stage, active: Mask) -> tuple[Cells, Cells]:
    """Elements that a stage takes away, and those that it adds."""
    both = set(stage.activate) & set(stage.deactivate)
    if both:
        raise LoadError(f"stage {stage.name!r} activates and deactivates region {min(both)!r}")
    taken: list[Cells] = []
    for names, wanted, word, state in (
        (stage.deactivate, True, "deactivates", "is not active"),
        (stage.activate, False, "activates", "is active already"),
    ):
        chosen = np.zeros_like(active)
        for name in names:
            cells = mesh.cells(name)
            if chosen[cells].any():
                raise LoadError(f"stage {stage.name!r} {word} elements of region {name!r} twice")
            if (active[cells] != wanted).any():
                part = "" if (active[cells] != wanted).all() else "a part of "
                raise LoadError(f"stage {stage.name!r} {word} region {name!r}, but {part}it {state}")
            chosen[cells] = True
        taken.append(np.flatnonzero(chosen))
    return taken[0], taken[1]


class SpaceOfBody(Space):
    """A space whose loads act on some of its elements alone; nodes and degrees of freedom stay those of the whole.

    Parameters
    ----------
    space : Space
    shape : ndarray of bool, shape (nelem,)
        Elements that are there: tractions act on sides that have exactly one of them.
    loaded : ndarray of bool, shape (nelem,), optional
        Elements of these that carry the loads; all of them if not given.
    """

    def __init__(self, space: Space, shape: Mask, loaded: Mask | None = None) -> None:
        self.__dict__.update(space.__dict__)
        self._shape = shape
        self._loaded = shape if loaded is None else shape & loaded

    def body_vector(self, force: Callable[[Array, Array], Array], cells: Cells | None = None) -> Array:
        """See `Space.body_vector`; zero where nothing is active."""
        chosen = np.arange(self.nelements) if cells is None else cells
        return super().body_vector(force, chosen[self._loaded[chosen]])

    def traction_vector(self, name: str, traction: Callable[[Array, Array, Array, Array], Array]) -> Array:
        """See `Space.traction_vector`; on sides inside the domain it acts on the side that is active.

        Raises
        ------
        MeshError
            If there is no such curve, or a part of it that the traction loads has active elements on both sides.
        """
        facets = self.host_mesh.facets(name)
        there, carried = self._sides(facets, self._shape), self._sides(facets, self._loaded)
        inside = facets[there.all(axis=0)]
        if len(inside):
            middle = self.host_mesh.mesh.p[:, self.host_mesh.mesh.facets[:, inside]].mean(axis=1)
            out = np.ones(len(inside))
            if np.any(traction(middle[0], middle[1], out, 0.0 * out)):
                raise MeshError(
                    f"boundary {name!r} lies inside the body{self._between(inside)}, so that a load on it has no "
                    "outward side (one that an earlier stage left there has to be set to 0; a region is there from the "
                    "outset unless a stage activates it)"
                )
        outer = there[0] != there[1]
        acting = outer & carried.any(axis=0)
        if not acting.any():
            return np.zeros(self.ndofs)
        return self.facet_vector(facets[acting], traction, carried[1, acting].astype(np.int64))

    def has_outside(self, name: str) -> bool:
        """Whether a side on the named curve has an active element."""
        return bool(self._sides(self.host_mesh.facets(name), self._loaded).any())

    def _between(self, facets: Cells) -> str:
        """Regions that meet at sides inside the body; empty if it is one that is on both sides."""
        beside = np.unique(self.host_mesh.mesh.f2t[:, facets])
        regions = self.host_mesh.regions.items()
        names = [name for name, cells in regions if 0 < np.isin(beside, cells).sum() < len(beside)]
        return f" between regions {', '.join(map(repr, names[:4]))}" if len(names) > 1 else ""

    def _sides(self, facets: Cells, active: Mask) -> Mask:
        """Whether each of the two elements of the facets is active, shape (2, n)."""
        beside = self.host_mesh.mesh.f2t[:, facets]
        return np.asarray((beside >= 0) & active[beside])


def space_at(space: Space, body: Body | None) -> Space:
    """Space on which the loads of a stage act."""
    return space if body is None else SpaceOfBody(space, body.active)
