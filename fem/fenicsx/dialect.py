"""What different versions of FEniCSx call by different names; nothing else here knows which one is at work.

Tested: 0.11 (PyPI) and 0.5 (Debian 12). What lies between mostly speaks like one of the two.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .engine import dolfinx, is_new

Array = NDArray[np.float64]


def lagrange_points(cell: str, order: int) -> Array:
    """Reference coordinates of the nodes of a Lagrange element, shape (nb, 2), in dolfinx's order."""
    if is_new():
        element = importlib.import_module("basix.ufl").element("Lagrange", cell, order)
        return np.asarray(element.basix_element.points)
    basix = importlib.import_module("basix")
    kind = getattr(basix.CellType, cell)
    variant = basix.LagrangeVariant.gll_warped
    return np.asarray(basix.create_element(basix.ElementFamily.P, kind, order, variant).points)


def quadrature_rule(cell: str, degree: int) -> tuple[Array, Array]:
    """Reference points, shape (nq, 2), and weights of the default rule of a degree."""
    basix = importlib.import_module("basix")
    kind = getattr(basix.CellType, cell)
    points, weights = basix.make_quadrature(kind, degree)
    return np.asarray(points), np.asarray(weights)


def create_mesh(comm: Any, cells: NDArray[np.int64], coordinates: Array, cell: str, order: int) -> Any:
    """A mesh whose cells are sides of polynomials of an order; each rank gives what it has."""
    module = dolfinx()
    if is_new():
        element = importlib.import_module("basix.ufl").element("Lagrange", cell, order, shape=(2,))
        return module.mesh.create_mesh(comm, cells, element, coordinates)
    ufl = importlib.import_module("ufl")
    domain = ufl.Mesh(ufl.VectorElement("Lagrange", ufl.Cell(cell, geometric_dimension=2), order))
    return module.mesh.create_mesh(comm, cells, coordinates, domain)


def vector_space(mesh: Any, order: int) -> Any:
    """Displacements."""
    fem = dolfinx().fem
    if is_new():
        return fem.functionspace(mesh, ("Lagrange", order, (2,)))
    return fem.VectorFunctionSpace(mesh, ("CG", order))


def quadrature_space(mesh: Any, degree: int, shape: tuple[int, ...]) -> Any:
    """Values of a shape at the integration points of a degree."""
    fem = dolfinx().fem
    if is_new():
        element = importlib.import_module("basix.ufl").quadrature_element(
            cell_name(mesh), value_shape=shape, scheme="default", degree=degree
        )
        return fem.functionspace(mesh, element)
    ufl = importlib.import_module("ufl")
    kind = ufl.VectorElement if len(shape) == 1 else ufl.TensorElement
    size = {"dim": shape[0]} if len(shape) == 1 else {"shape": shape}
    element = kind("Quadrature", mesh.ufl_cell(), degree=degree, quad_scheme="default", **size)
    return fem.FunctionSpace(mesh, element)


def cell_name(mesh: Any) -> str:
    """`triangle` or `quadrilateral`."""
    return str(mesh.basix_cell().name) if is_new() else str(mesh.ufl_cell().cellname())


def dof_table(space: Any) -> NDArray[np.int64]:
    """Degrees of freedom (of a vector space: its nodes) of each local cell, shape (ncells, nb)."""
    table = space.dofmap.list
    if not isinstance(table, np.ndarray):
        cells = table.num_nodes
        table = np.asarray(table.array).reshape(cells, -1)
    return np.asarray(table, dtype=np.int64)


def evaluate(expression: Any, mesh: Any, cells: NDArray[np.int32]) -> Array:
    """An expression at its points of some cells, one row a cell."""
    values = expression.eval(mesh, cells) if is_new() else expression.eval(cells)
    return np.asarray(values)


def add_from_ghosts(vector: Any) -> None:
    """Add to owned entries what was assembled into their ghosts on other ranks."""
    la = importlib.import_module("dolfinx.la")
    vector.scatter_reverse((la.InsertMode if is_new() else la.ScatterMode).add)


def assemble_vector(array: Array, form: Any) -> None:
    """Add a form to the local array of a vector."""
    fem = dolfinx().fem
    if is_new():
        fem.assemble_vector(array, form)
    else:
        cpp = dolfinx().cpp.fem
        cpp.assemble_vector(array, form, cpp.pack_constants(form), cpp.pack_coefficients(form))
