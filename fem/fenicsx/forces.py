"""Strains, internal forces and tangent in dolfinx's forms, in the arrays of the law and of the load steps."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .distribution import Distribution, DistributionError
from .engine import dolfinx

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
    space : Distribution
    """

    def __init__(self, distribution: Distribution) -> None:
        self.space = distribution
        module, ufl, basix_ufl = dolfinx(), importlib.import_module("ufl"), importlib.import_module("basix.ufl")
        mesh, shape = distribution.mesh, distribution.outline
        degree = shape.quadrature_degree

        def quadrature(*columns: int) -> Any:
            element = basix_ufl.quadrature_element(shape.cell, value_shape=columns, scheme="default", degree=degree)
            return module.fem.functionspace(mesh, element)

        space = distribution.displacements
        self._stress = module.fem.Function(quadrature(3))
        self._tangent = module.fem.Function(quadrature(3, 3))
        self._size = module.fem.Function(quadrature(1))
        self.moved = module.fem.Function(space)
        test, trial = ufl.TestFunction(space), ufl.TrialFunction(space)
        dx = ufl.Measure("dx", domain=mesh, metadata={"quadrature_degree": degree, "quadrature_scheme": "default"})

        def strain(field: Any) -> Any:
            return ufl.as_vector([field[0].dx(0), field[1].dx(1), field[0].dx(1) + field[1].dx(0)])

        form = module.fem.form
        self._force_form = form(ufl.inner(self._stress, strain(test)) * dx)
        self._action_form = form(ufl.inner(ufl.dot(self._tangent, strain(self.moved)), strain(test)) * dx)
        self.tangent_form = form(ufl.inner(ufl.dot(self._tangent, strain(trial)), strain(test)) * dx)
        self._strain = module.fem.Expression(strain(self.moved), distribution.reference_points)
        self._vector = module.fem.Function(space)
        self._reverse = importlib.import_module("dolfinx.la").InsertMode.add
        self._assemble = importlib.import_module("dolfinx.fem").assemble_vector
        self.magnitude = np.zeros(distribution.ndofs)
        self._check_order()

    def _check_order(self) -> None:
        """The array of a quadrature space is in the order of cells and points: checked, not assumed."""
        for field in (self._stress, self._tangent):
            dofs = np.asarray(field.function_space.dofmap.list)[: len(self.space.cells)]
            if not np.array_equal(dofs.ravel(), np.arange(self.space.npoints)):
                raise DistributionError("this version of dolfinx orders integration points in another way")

    def strain(self, displacement: Array, out: Array) -> Array:
        """Strain at the points; see `ForceAssembler.strain`."""
        self._move(displacement)
        values = self._strain.eval(self.space.mesh, self.space.cells)
        out[:] = np.asarray(values).reshape(out.shape)
        return out

    def internal_force(self, stress: Array, out: Array) -> Array:
        """``int B^T sigma dV``; see `ForceAssembler.internal_force`."""
        self._stress.x.array[: stress.size] = stress.ravel()
        out[:] = self._assembled(self._force_form)
        # Every cell's force is at most its stress times a side: the sums of the nodes are no larger than this.
        self.magnitude[:] = np.abs(out).max(initial=0.0)
        return out

    def tangent_times(self, tangent: Array, displacement: Array, out: Array) -> Array:
        """``int B^T D B u dV``; see `ForceAssembler.tangent_times`."""
        self.set_tangent(tangent)
        out[:] = self.action(displacement)
        return out

    def set_tangent(self, tangent: Array) -> None:
        """The tangent, shape (npoints, 3, 3) [Pa], of the next actions and matrices."""
        self._tangent.x.array[: tangent.size] = tangent.ravel()

    def action(self, displacement: Array) -> Array:
        """``int B^T D B u dV`` with the tangent that was set."""
        self._move(displacement)
        return self._assembled(self._action_form)

    def _move(self, displacement: Array) -> None:
        self.moved.x.array[: len(displacement)] = displacement
        self.moved.x.scatter_forward()

    def _assembled(self, form: Any) -> Array:
        vector = self._vector.x
        vector.array[:] = 0.0
        self._assemble(vector.array, form)
        vector.scatter_reverse(self._reverse)
        return np.array(vector.array[: self.space.ndofs])
