"""Rigid bodies on a boundary: its nodes move together, pushed by a force or moved as a whole."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.discretisation.space import Space
from granfabric.fem.vectors import Array

from .amplitude import amplitude
from .checks import LoadError, check_finite, pair

MOTIONS = ("displacement along x", "displacement along y", "rotation")
# Directions closer to an axis than this are along it.
SAME = 1e-9
# A motion of a smooth body whose part across the boundary is below this fraction of it is one that the boundary does
# not feel: along a straight one, around a circle (whose normals at the nodes err by the size of elements squared).
UNFELT = 1e-2


@dataclass(frozen=True)
class RigidBody:
    """A rigid body joined to a boundary: a footing, a platen, a wall.

    Its motion is a displacement of its point and a small rotation about it. A rough one moves all nodes of the
    boundary; a smooth one only across the boundary, so that they slide along it. What is neither displaced nor held
    follows from the force and the moment. From stage to stage it stays, as other supports do, until it is named
    again or a stage with ``keep=False`` does not name it.

    Parameters
    ----------
    boundary : str
    rough : bool
    force : (float, float)
        At the end of the stage, per length out of plane [N/m].
    moment : float
        At the end of the stage, about `point`, anticlockwise, per length out of plane [N m/m].
    point : (float, float), optional
        Where the force acts and the displacement is that of [m]; the middle of the boundary if not given.
    displacement : (float or None, float or None)
        Of the point, total at the end of the stage [m]; None leaves the component to the force.
    rotation : "free", "fixed" or float
        "fixed" holds it as it is at the start of the stage; a number is the total at the end of the stage,
        anticlockwise [rad].
    amplitude : str, Amplitude or table, optional
    """

    boundary: str
    rough: bool = True
    force: tuple[float, float] = (0.0, 0.0)
    moment: float = 0.0
    point: tuple[float, float] | None = None
    displacement: tuple[float | None, float | None] = (None, None)
    rotation: Any = "free"
    amplitude: Any = None

    def __post_init__(self) -> None:
        owner = f"rigid body on boundary {self.boundary!r}"
        object.__setattr__(self, "force", pair(f"force of the {owner}", self.force))
        check_finite(f"moment of the {owner}", self.moment)
        if not isinstance(self.rough, (bool, np.bool_)):
            raise LoadError(f"{owner}: rough = {self.rough!r} is neither true nor false")
        if self.point is not None:
            object.__setattr__(self, "point", pair(f"point of the {owner}", self.point))
        if not isinstance(self.displacement, (tuple, list)) or len(self.displacement) != 2:
            raise LoadError(f"displacement of the {owner} = {self.displacement!r} is not a pair, x and y")
        object.__setattr__(self, "displacement", tuple(self.displacement))
        for component, moved, force in zip("xy", self.displacement, self.force):
            if moved is not None:
                check_finite(f"displacement {component} of the {owner}", moved)
                if force:
                    raise LoadError(
                        f"{owner}: it has a displacement and a force along {component}; one follows from the other"
                    )
        if self.rotation not in ("free", "fixed") and isinstance(self.rotation, str):
            raise LoadError(f"{owner}: rotation = {self.rotation!r} is not 'free', 'fixed' or a number")
        if self.rotation not in ("free", "fixed"):
            check_finite(f"rotation of the {owner}", self.rotation)
        if self.rotation != "free" and self.moment:
            raise LoadError(f"{owner}: its rotation is prescribed, so that the moment {self.moment:g} has no effect")
        if self.amplitude is not None:
            object.__setattr__(self, "amplitude", amplitude(self.amplitude))

    @property
    def moves(self) -> bool:
        """Whether a motion is prescribed that is not a hold."""
        return any(moved is not None for moved in self.displacement) or not isinstance(self.rotation, str)


class Contact:
    """The boundary of a rigid body: how its nodes follow the body's motion.

    A motion has three coordinates: displacement of the middle of the nodes along x and y, and the rotation times `arm`,
    all in metres. Forces that belong to them: two components and the moment about the middle over the arm. The body's
    point, where its force acts, may be anywhere: ``point_coordinates @ motion`` is the motion in its terms.

    Parameters
    ----------
    space : Space
    body : RigidBody

    Attributes
    ----------
    nodes : ndarray of int
    point : ndarray, shape (2,)
    point_coordinates : ndarray, shape (3, 3)
    arm : float
        Root mean square distance of the nodes from their middle [m].
    modes : ndarray, shape (n, 2, 3)
        Displacement of each node in each coordinate.
    normal : ndarray, shape (n, 2), or None
        Across the boundary at the nodes of a smooth one.

    Raises
    ------
    LoadError
    MeshError
    """

    def __init__(self, space: Space, body: RigidBody) -> None:
        self.body = body
        self.nodes: NDArray[np.int64] = space.boundary_nodes(body.boundary)
        places = space.nodes[self.nodes]
        mesh = space.host_mesh.mesh
        ends = mesh.p[:, mesh.facets[:, space.host_mesh.facets(body.boundary)]]
        lengths = np.hypot(*(ends[:, 1] - ends[:, 0]))
        middle = (ends.mean(axis=1) @ lengths) / lengths.sum()
        self.point = middle if body.point is None else np.asarray(body.point, dtype=np.float64)
        self.arm = float(np.sqrt(np.mean(np.sum((places - places.mean(axis=0)) ** 2, axis=1))))
        centre = places.mean(axis=0)
        away = (places - centre) / self.arm
        shift = (self.point - centre) / self.arm
        self.point_coordinates: Array = np.eye(3)
        self.point_coordinates[0, 2], self.point_coordinates[1, 2] = -shift[1], shift[0]
        self.modes: Array = np.zeros((len(self.nodes), 2, 3))
        self.modes[:, 0, 0] = self.modes[:, 1, 1] = 1.0
        self.modes[:, 0, 2], self.modes[:, 1, 2] = -away[:, 1], away[:, 0]
        self.normal: Array | None = None
        if not body.rough:
            across = space.traction_vector(body.boundary, lambda x, y, nx, ny: np.stack([nx, ny], axis=1))
            across = across.reshape(-1, 2)[self.nodes]
            size = np.hypot(across[:, 0], across[:, 1])
            if (size <= SAME * size.max()).any():
                raise LoadError(
                    f"rigid body on boundary {body.boundary!r}: a smooth one needs a boundary with two sides"
                )
            self.normal = across / size[:, None]
        self.space_ndofs = space.ndofs

    @property
    def felt(self) -> Array:
        """How each tied displacement follows the coordinates: both components, or the one across, shape (m, 3)."""
        if self.normal is None:
            return self.modes.reshape(-1, 3)
        return np.einsum("ni,nik->nk", self.normal, self.modes)

    def generalised(self, nodal: Array) -> Array:
        """Forces, shape (ndofs,), in the body's coordinates, shape (3,): two components [N/m] and moment over arm."""
        forces = nodal.reshape(-1, 2)[self.nodes]
        if self.normal is not None:
            forces = self.normal * np.sum(self.normal * forces, axis=1)[:, None]
        return np.einsum("ni,nik->k", forces, self.modes)

    def motion(self, displacement: Array) -> Array:
        """Coordinates that fit displacements, shape (ndofs,), best: of a tied boundary its motion."""
        moved = displacement.reshape(-1, 2)[self.nodes]
        seen = moved.ravel() if self.normal is None else np.sum(self.normal * moved, axis=1)
        return np.asarray(np.linalg.lstsq(self.felt, seen, rcond=UNFELT)[0])

    def at_point(self, displacement: Array) -> Array:
        """That motion in terms of the body's point, shape (3,): displacement, and rotation times the arm [m]."""
        return self.point_coordinates @ self.motion(displacement)

    def resultant(self, nodal: Array) -> Array:
        """Forces, shape (ndofs,), as the body feels them at its point: two components, and the moment over the arm."""
        return np.asarray(np.linalg.solve(self.point_coordinates.T, self.generalised(nodal)))

    def nodal_force(self) -> Array:
        """Nodal forces, shape (ndofs,), of the body's force and moment: as it carries them, one of many ways.

        Raises
        ------
        LoadError
            If the boundary cannot bear them: a smooth one bears no force along it.
        """
        wanted = self.point_coordinates.T @ np.array([*self.body.force, self.body.moment / self.arm])
        vector = self.spread(wanted)
        if np.abs(self.generalised(vector) - wanted).max() > 1e-6 * np.abs(wanted).max():
            raise LoadError(
                f"rigid body on boundary {self.body.boundary!r}: a smooth one bears no force along its boundary and no "
                f"moment that it does not feel (force {self.body.force[0]:g}, {self.body.force[1]:g} N/m, moment "
                f"{self.body.moment:g} N m/m about ({self.point[0]:.6g}, {self.point[1]:.6g}) m)"
            )
        return vector

    def spread(self, generalised: Array) -> Array:
        """Nodal forces, shape (ndofs,), with these resultants, as far as the boundary feels them."""
        felt = self.felt
        carried = felt @ np.linalg.lstsq(felt.T @ felt, generalised, rcond=UNFELT**2)[0]
        forces = carried.reshape(-1, 2) if self.normal is None else self.normal * carried[:, None]
        vector = np.zeros((self.space_ndofs // 2, 2))
        vector[self.nodes] = forces
        return vector.ravel()

    def displaced(self, motion: Array) -> Array:
        """Displacements, shape (n, 2), that a motion gives to the nodes: all of it, or what is across."""
        moved: Array = self.modes @ motion
        if self.normal is not None:
            moved = self.normal * np.sum(self.normal * moved, axis=1)[:, None]
        return moved

    def take_out(self, forces: Array) -> None:
        """Set to zero what the body bears of forces, shape (ndofs,): all at its nodes, or what is across."""
        at_nodes = forces.reshape(-1, 2)
        if self.normal is None:
            at_nodes[self.nodes] = 0.0
        else:
            at_nodes[self.nodes] -= self.normal * np.sum(self.normal * at_nodes[self.nodes], axis=1)[:, None]

    @property
    def tied_dofs(self) -> NDArray[np.int64]:
        """Degrees of freedom that follow the body: x and y of each node, of a smooth one those not along it."""
        if self.normal is None:
            return self.dofs
        return self.dofs[np.abs(self.normal).ravel() > SAME]

    @property
    def dofs(self) -> NDArray[np.int64]:
        """Degrees of freedom of the nodes, x and y of each."""
        return np.stack([2 * self.nodes, 2 * self.nodes + 1], axis=1).ravel()
