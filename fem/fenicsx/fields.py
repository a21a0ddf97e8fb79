"""Functions of dolfinx at integration points, as the arrays of a law."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import dialect
from .distribution import DistributionError
from .engine import dolfinx

Array = NDArray[np.float64]


class QuadratureFields:
    """Stress and tangent at the integration points of the cells that this rank owns.

    Parameters
    ----------
    mesh : dolfinx.mesh.Mesh
        Of triangles or quadrilaterals.
    degree : int
        Polynomial degree that the points are exact for.

    Attributes
    ----------
    stress, tangent : dolfinx.fem.Function
        Values of shapes (3,) and (3, 3).
    dx : ufl.Measure
    npoints : int

    Raises
    ------
    DistributionError
        If this version of dolfinx orders points in another way than cell by cell.
    """

    def __init__(self, mesh: Any, degree: int) -> None:
        module, ufl = dolfinx(), importlib.import_module("ufl")
        self._module, self._mesh = module, mesh
        self.stress = module.fem.Function(dialect.quadrature_space(mesh, degree, (3,)))
        self.tangent = module.fem.Function(dialect.quadrature_space(mesh, degree, (3, 3)))
        self._reference, self._weights = dialect.quadrature_rule(dialect.cell_name(mesh), degree)
        self.dx = ufl.Measure("dx", domain=mesh, metadata={"quadrature_degree": degree, "quadrature_scheme": "default"})
        self._cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
        self.npoints = len(self._cells) * len(self._reference)
        for field in (self.stress, self.tangent):
            dofs = dialect.dof_table(field.function_space)[: len(self._cells)]
            if not np.array_equal(dofs.ravel(), np.arange(self.npoints)):
                raise DistributionError("this version of dolfinx orders integration points in another way")

    def expression(self, expression: Any) -> Any:
        """Something of UFL to be evaluated at the points."""
        return self._module.fem.Expression(expression, self._reference)

    def evaluate(self, expression: Any, columns: int, cells: NDArray[np.integer] | None = None) -> Array:
        """Its values, shape (npoints, columns), or those at the points of some cells."""
        chosen = self._cells if cells is None else cells.astype(np.int32)
        if not len(chosen):
            return np.empty((0, columns))
        values = dialect.evaluate(expression, self._mesh, chosen)
        return np.ascontiguousarray(values.reshape(-1, columns), dtype=np.float64)

    def set(self, field: Any, values: Array, points: NDArray[np.integer] | None = None) -> None:
        """Give a function the values of the points, or of some and zero at the others; ghosts are never read."""
        if points is None:
            field.x.array[: values.size] = values.ravel()
            return
        field.x.array[:] = 0.0
        if len(points):
            rows = values.reshape(len(points), -1)
            field.x.array[: self.npoints * rows.shape[1]].reshape(self.npoints, -1)[points] = rows

    def places(self) -> Array:
        """Coordinates of the points, shape (npoints, 2) [m]."""
        ufl = importlib.import_module("ufl")
        return self.evaluate(self.expression(ufl.SpatialCoordinate(self._mesh)), 2)

    def weights(self) -> Array:
        """Integration weight times Jacobian, shape (npoints,) [m^2]."""
        ufl = importlib.import_module("ufl")
        jacobian = self.evaluate(self.expression(ufl.JacobianDeterminant(self._mesh)), 1)
        return np.abs(jacobian[:, 0]) * np.tile(self._weights, len(self._cells))
