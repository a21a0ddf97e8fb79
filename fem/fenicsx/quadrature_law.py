"""A law in a FEniCSx program of one's own: stress and tangent as functions that its forms take.

A user has a displacement `u` in a vector space of dolfinx and writes

    material = QuadratureLaw(law, u, degree=2, initial_stress=(-1e5, -1e5, 0.0))
    residual = ufl.inner(material.stress, material.strain(v)) * material.dx
    tangent = ufl.inner(material.tangent * material.strain(du), material.strain(v)) * material.dx

and calls `material.update()` before assembling, `material.commit()` once a step has converged.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from granfabric.constitutive.arrays import finite
from granfabric.constitutive.contract import Law, TangentKind, UpdateReport

from .engine import dolfinx
from .fields import QuadratureFields

Array = NDArray[np.float64]


class QuadratureLaw:
    """A law at the integration points of the cells that this rank owns.

    Every call is made by all ranks together, and all get the same verdict.

    Parameters
    ----------
    law : Law
    displacement : dolfinx.fem.Function
        In a vector space of a plane mesh; its values at the time of `update` are the trial [m].
    degree : int
        Polynomial degree that the integration points are exact for.
    initial_stress : array_like, shape (3,) or (npoints, 3)
        xx, yy, xy, tension positive [Pa].
    material_index : array_like of int, shape (npoints,), optional
        Row of the law's parameters for each point.

    Attributes
    ----------
    stress : dolfinx.fem.Function
        xx, yy, xy of the last update [Pa].
    tangent : dolfinx.fem.Function
        3 by 3, of the last update [Pa]; that of a zero increment before the first.
    state : ndarray, shape (npoints, nstate)
        Of the last commit, in the order of cells and points.
    points : ndarray, shape (npoints, 2)
        [m].
    dx : ufl.Measure

    Raises
    ------
    ValueError
        If an array has another shape or is not finite.
    """

    def __init__(self, law: Law, displacement: Any, degree: int, initial_stress: ArrayLike,
                 material_index: ArrayLike | None = None) -> None:  # fmt: skip
        self._law = law
        self._displacement = displacement
        space = displacement.function_space
        self._comm = space.mesh.comm
        self._committed = np.array(displacement.x.array)
        self._increment = dolfinx().fem.Function(space)
        self._fields = QuadratureFields(space.mesh, degree)
        self.dx, self.stress, self.tangent = self._fields.dx, self._fields.stress, self._fields.tangent
        self.points = self._fields.places()
        npoints = len(self.points)
        given = np.asarray(initial_stress, dtype=np.float64)
        given = np.tile(given, (npoints, 1)) if given.shape == (3,) else given
        self._stress_start = finite("the initial stress", given, (npoints, 3)).copy()
        self._index = None if material_index is None else np.asarray(material_index, dtype=np.int32)
        self.state = law.initial_state(self._stress_start, self._index)
        self._stress_end, self._state_end = self._stress_start.copy(), self.state.copy()
        self._tangent = np.zeros((npoints, 3, 3))
        self._strain = self._fields.expression(self.strain(self._increment))
        self.report: UpdateReport | None = None
        self.update()

    @staticmethod
    def strain(field: Any) -> Any:
        """xx, yy, engineering xy of a displacement, as a UFL vector; tension positive."""
        ufl = importlib.import_module("ufl")
        return ufl.as_vector([field[0].dx(0), field[1].dx(1), field[0].dx(1) + field[1].dx(0)])

    def update(self, kind: TangentKind = "propagated") -> bool:
        """Stress and tangent under the displacement as it is now, from the state of the last commit.

        Returns
        -------
        bool
            Whether all points of all ranks could follow; if not, take a smaller step. `report` tells of this rank's.
        """
        ours, theirs = self._increment.x, self._displacement.x
        own = len(ours.array) - 2 * self._increment.function_space.dofmap.index_map.num_ghosts
        ours.array[:own] = theirs.array[:own] - self._committed[:own]
        ours.scatter_forward()
        increment = self._fields.evaluate(self._strain, 3)
        self.report = self._law.update(
            increment, self._stress_start, self.state, self._stress_end, self._state_end, self._tangent, kind,
            self._index,
        )  # fmt: skip
        self._fields.set(self.stress, self._stress_end)
        self._fields.set(self.tangent, self._tangent)
        return not self._comm.allreduce(self.report.failed)

    def commit(self) -> None:
        """Make the last update the start of the next step."""
        self._stress_start, self._stress_end = self._stress_end, self._stress_start
        self.state, self._state_end = self._state_end, self.state
        self._committed = np.array(self._displacement.x.array)

    def mean(self, values: Array) -> Array:
        """Mean over the body of values at the points, shape (npoints, k), for instance of the state."""
        weights = self._fields.weights()
        sums = self._comm.allreduce(np.append(weights @ values, weights.sum()))
        return np.asarray(sums[:-1] / sums[-1])
