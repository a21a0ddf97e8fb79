"""Strains, internal forces and tangent in dolfinx's forms, in the arrays of the law and of the load steps."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import dialect
from .distribution import Distribution
from .engine import dolfinx
from .fields import QuadratureFields
from .part import LocalPart
from .quadrature_law import QuadratureLaw

Array = NDArray[np.float64]


class DistributedForces:
    """What `granfabric.fem.discretisation.assembly.ForceAssembler` is for the own host.

    Vectors of degrees of freedom hold those that this rank owns, arrays of points those of the cells that it owns.
    Every call is made by all ranks together.

    Parameters
    ----------
    distribution : Distribution

    Attributes
    ----------
    magnitude : ndarray, shape (ndofs,)
        After `internal_force`: an estimate of the nodal sums of the cells' absolute forces, for their rounding.
    space : Distribution or LocalPart
        What of the body is there.
    """

    def __init__(self, distribution: Distribution) -> None:
        self.space: Distribution | LocalPart = distribution
        self._part: LocalPart | None = None
        self._ndofs = distribution.ndofs
        module, ufl = dolfinx(), importlib.import_module("ufl")
        space = distribution.displacements
        fields = QuadratureFields(distribution.mesh, distribution.outline.quadrature_degree)
        self._fields = fields
        self._moved = module.fem.Function(space)
        test, trial = ufl.TestFunction(space), ufl.TrialFunction(space)
        strain, form = QuadratureLaw.strain, module.fem.form
        self._force_form = form(ufl.inner(fields.stress, strain(test)) * fields.dx)
        self._action_form = form(ufl.inner(ufl.dot(fields.tangent, strain(self._moved)), strain(test)) * fields.dx)
        self.tangent_form = form(ufl.inner(ufl.dot(fields.tangent, strain(trial)), strain(test)) * fields.dx)
        self._strain = fields.expression(strain(self._moved))
        self._vector = module.fem.Function(space)
        self.magnitude = np.zeros(distribution.ndofs)

    def enter(self, part: LocalPart | None, distribution: Distribution) -> None:
        """From now on arrays of points are those of a part, and what is not there exerts nothing; None: the whole."""
        self._part = part
        self.space = distribution if part is None else part

    def strain(self, displacement: Array, out: Array) -> Array:
        """Strain at the points; see `ForceAssembler.strain`."""
        self._move(displacement)
        out[:] = self._fields.evaluate(self._strain, 3, None if self._part is None else self._part.cells)
        return out

    def internal_force(self, stress: Array, out: Array) -> Array:
        """``int B^T sigma dV``; see `ForceAssembler.internal_force`."""
        self._set(self._fields.stress, stress)
        out[:] = self._assembled(self._force_form)
        # of the same size as the largest sum: where nodal forces balance nothing but rounding is left of them
        self.magnitude[:] = np.abs(out).max(initial=0.0)
        return out

    def tangent_times(self, tangent: Array, displacement: Array, out: Array) -> Array:
        """``int B^T D B u dV``; see `ForceAssembler.tangent_times`."""
        self.set_tangent(tangent)
        out[:] = self.action(displacement)
        return out

    def set_tangent(self, tangent: Array) -> None:
        """The tangent, shape (npoints, 3, 3) [Pa], of the next actions and matrices."""
        self._set(self._fields.tangent, tangent)

    def _set(self, field: Any, values: Array) -> None:
        self._fields.set(field, values, None if self._part is None else self._part.points)

    def action(self, displacement: Array) -> Array:
        """``int B^T D B u dV`` with the tangent that was set."""
        self._move(displacement)
        return self._assembled(self._action_form)

    def _move(self, displacement: Array) -> None:
        self._moved.x.array[: len(displacement)] = displacement
        self._moved.x.scatter_forward()

    def _assembled(self, form: Any) -> Array:
        vector = self._vector.x
        vector.array[:] = 0.0
        dialect.assemble_vector(vector.array, form)
        dialect.add_from_ghosts(vector)
        return np.array(vector.array[: self._ndofs])
