"""Finite element space: everything that is taken from scikit-fem, turned once into the host's array order.

scikit-fem keeps (component, element, quadrature point); laws and kernels here are point-major. The turn happens in
this file and nowhere else. Point number = element * points per cell + quadrature point; degree of freedom number =
2 * node + component (which is also how scikit-fem numbers a vector element).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from skfem.generic_utils import OrientedBoundary

from granfabric.constitutive.arrays import ANY, read
from granfabric.fem.mesh.host_mesh import HostMesh, MeshError

Array = NDArray[np.float64]
_Sides = tuple[Any, Array, Array, Array]

# Element, cell, and the polynomial degree integrated exactly by default: enough for the stiffness of undistorted
# elements (1, 3, 4, 9 points a cell).
_ELEMENTS: dict[str, tuple[type, str, int]] = {
    "P1": (skfem.ElementTriP1, "triangle", 1),
    "P2": (skfem.ElementTriP2, "triangle", 2),
    "Q1": (skfem.ElementQuad1, "quad", 2),
    "Q2": (skfem.ElementQuad2, "quad", 4),
}

# scikit-fem's table of triangle rules starts with three points; degree one needs only the centroid.
_CENTROID = (np.array([[1.0 / 3.0], [1.0 / 3.0]]), np.array([0.5]))


class Space:
    """Displacement space with its integration points.

    Parameters
    ----------
    host_mesh : HostMesh
        Mesh of triangles (P1, P2) or quadrilaterals (Q1, Q2).
    element : {"P1", "P2", "Q1", "Q2"}
        Lagrange element.
    quadrature_degree : int, optional
        Polynomial degree integrated exactly; 1, 2, 2, 4 if not given.

    Attributes
    ----------
    nodes : ndarray, shape (nnodes, 2)
        Coordinates of all nodes [m].
    element_nodes : ndarray of int32, shape (nelem, nb)
        Nodes of each element in scikit-fem's local order.
    points : ndarray, shape (npt, 2)
        Coordinates of the integration points [m].
    weights : ndarray, shape (npt,)
        Integration weight times Jacobian [m^2].
    point_cell : ndarray of int32, shape (npt,)
        Element of each point.
    gradients : ndarray, shape (npt, nb, 2)
        Gradients of the shape functions [1/m].
    shape_values : ndarray, shape (nq, nb)
        Shape functions at the points of a cell; the same in every cell.
    reference_points, reference_nodes : ndarray, shapes (nq, 2), (nb, 2)
        Points and nodes of a cell in reference coordinates.
    reference_weights : ndarray, shape (nq,)
    is_curved : bool
        Whether cells are as curved as the element can represent.

    Raises
    ------
    MeshError
        If the element is unknown or does not fit the mesh.
    """

    def __init__(self, host_mesh: HostMesh, element: str, quadrature_degree: int | None = None) -> None:
        if element not in _ELEMENTS:
            raise MeshError(f"element = {element!r} is not one of {', '.join(_ELEMENTS)}")
        kind, cell, degree = _ELEMENTS[element]
        if cell != host_mesh.cell:
            raise MeshError(f"element {element} needs a mesh of {cell}s, this one consists of {host_mesh.cell}s")
        self.host_mesh = host_mesh
        self.element = element
        self.order = int(element[1])
        # Isoparametric: sides are as curved as the element can represent.
        self._geometry = host_mesh.mesh if self.order == 1 or host_mesh.curved is None else host_mesh.curved
        self.quadrature_degree = degree if quadrature_degree is None else int(quadrature_degree)
        self._scalar_element = kind()
        quadrature = _CENTROID if cell == "triangle" and self.quadrature_degree <= 1 else None
        basis = skfem.CellBasis(
            self._geometry, self._scalar_element, intorder=self.quadrature_degree, quadrature=quadrature
        )
        self._scalar_dofs = basis.dofs
        self.nodes = np.ascontiguousarray(basis.doflocs.T)
        self.element_nodes = np.ascontiguousarray(basis.element_dofs.T.astype(np.int32))
        fields = [basis.basis[i][0] for i in range(basis.Nbfun)]
        self.points_per_cell = int(basis.X.shape[1])
        self.reference_points = np.ascontiguousarray(basis.X.T)
        self.reference_weights = np.array(basis.W)
        self.reference_nodes = np.array(self._scalar_element.doflocs)
        self.is_curved = self._geometry is not host_mesh.mesh
        self.points = _point_major(np.asarray(basis.global_coordinates()))
        self.weights = np.ascontiguousarray(basis.dx.reshape(-1))
        gradients = np.stack([_point_major(field.grad) for field in fields], axis=1)
        self.gradients = np.ascontiguousarray(gradients)
        self.shape_values = np.stack(
            [np.broadcast_to(np.asarray(field), basis.dx.shape)[0] for field in fields], axis=1
        )
        self.point_cell = np.repeat(np.arange(self.nelements, dtype=np.int32), self.points_per_cell)

    @property
    def nelements(self) -> int:
        """Number of elements."""
        return len(self.element_nodes)

    @property
    def nnodes(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    @property
    def ndofs(self) -> int:
        """Number of degrees of freedom, two a node."""
        return 2 * len(self.nodes)

    @property
    def npoints(self) -> int:
        """Number of integration points."""
        return len(self.weights)

    def boundary_nodes(self, name: str) -> NDArray[np.int64]:
        """Nodes on the named curve, ascending.

        Raises
        ------
        MeshError
            If there is no such curve.
        """
        facets = self.host_mesh.facets(name)
        return np.unique(self._scalar_dofs.get_facet_dofs(facets).flatten()).astype(np.int64)

    def interpolate(self, nodal: Array) -> Array:
        """Values at the integration points of a nodal field.

        Parameters
        ----------
        nodal : ndarray, shape (nnodes, k)

        Returns
        -------
        ndarray, shape (npt, k)
        """
        nodal = read("nodal", nodal, (self.nnodes, ANY))
        values = np.einsum("qb,ebk->eqk", self.shape_values, nodal[self.element_nodes])
        return values.reshape(self.npoints, -1)

    def body_vector(self, force: Callable[[Array, Array], Array], cells: NDArray[np.int64] | None = None) -> Array:
        """Nodal forces ``int N . b dV`` of a body force.

        Parameters
        ----------
        force : callable
            ``force(x, y)`` with arrays of shape (n,) returns (n, 2), [N/m^3].
        cells : ndarray of int, optional
            Elements that carry it; all if not given.

        Returns
        -------
        ndarray, shape (ndofs,)
            [N/m].
        """
        density = force(self.points[:, 0], self.points[:, 1]) * self.weights[:, None]
        density = density.reshape(self.nelements, self.points_per_cell, 2)
        chosen = np.arange(self.nelements) if cells is None else cells
        local = np.einsum("qb,eqk->ebk", self.shape_values, density[chosen])
        return self._scatter(self.element_nodes[chosen], local)

    def traction_vector(self, name: str, traction: Callable[[Array, Array, Array, Array], Array]) -> Array:
        """Nodal forces ``int N . t ds`` of a traction on the named curve.

        Parameters
        ----------
        name : str
            Curve on the boundary of the domain.
        traction : callable
            ``traction(x, y, nx, ny)`` with arrays of shape (n,), outward normal, returns (n, 2), [Pa].

        Returns
        -------
        ndarray, shape (ndofs,)
            [N/m].

        Raises
        ------
        MeshError
            If there is no such curve or it lies inside the domain, where it has no outward side.
        """
        return self._nodal(self._boundary(name, "a traction on it"), traction)

    def facet_vector(
        self,
        facets: NDArray[np.int64],
        traction: Callable[[Array, Array, Array, Array], Array],
        side: NDArray[np.int64] | None = None,
    ) -> Array:
        """The same on given facets, each of which loads one of its two elements.

        Parameters
        ----------
        facets : ndarray of int
            At least one.
        traction : callable
        side : ndarray of int, same shape, optional
            0 or 1: row of scikit-fem's ``f2t`` that holds the element, 0 if not given; the normal points out of it.
        """
        return self._nodal(self._facets(facets, side), traction)

    def _nodal(self, sides: _Sides, traction: Callable[[Array, Array, Array, Array], Array]) -> Array:
        basis, place, normal, shapes = sides
        value = np.asarray(traction(place[:, 0], place[:, 1], normal[:, 0], normal[:, 1]), dtype=np.float64)
        value = value.reshape(*basis.dx.shape, 2) * basis.dx[:, :, None]
        local = np.einsum("bfq,fqk->fbk", shapes, value)
        return self._scatter(basis.element_dofs.T, local)

    def boundary_matrix(self, name: str, stiffness: Callable[[Array, Array, Array, Array], Array]) -> csr_matrix:
        """Matrix ``int N^T k N ds`` of a stiffness per area on the named curve.

        Parameters
        ----------
        name : str
            Curve on the boundary of the domain.
        stiffness : callable
            ``stiffness(x, y, nx, ny)`` with arrays of shape (n,), outward normal, returns (n, 2, 2) [Pa/m].

        Returns
        -------
        scipy.sparse.csr_matrix, shape (ndofs, ndofs)

        Raises
        ------
        MeshError
            If there is no such curve or it lies inside the domain.
        """
        basis, place, normal, shapes = self._boundary(name, "a spring on it")
        value = np.asarray(stiffness(place[:, 0], place[:, 1], normal[:, 0], normal[:, 1]), dtype=np.float64)
        value = value.reshape(*basis.dx.shape, 2, 2) * basis.dx[:, :, None, None]
        local = np.einsum("bfq,fqij,cfq->fbicj", shapes, value, shapes)
        nodes = basis.element_dofs.T
        # the shapes of nodes off the side vanish on it, but for rounding
        local[np.abs(local) <= 1e-13 * np.abs(local).max(initial=0.0)] = 0.0
        dofs = np.stack([2 * nodes, 2 * nodes + 1], axis=2).reshape(len(nodes), -1)
        width = dofs.shape[1]
        rows, columns = np.repeat(dofs, width, axis=1).ravel(), np.tile(dofs, (1, width)).ravel()
        matrix = csr_matrix((local.reshape(-1), (rows, columns)), shape=(self.ndofs, self.ndofs))
        matrix.eliminate_zeros()
        return matrix

    def _boundary(self, name: str, what: str) -> _Sides:
        """Basis of scikit-fem on a named curve, places and outward normals (n, 2), shape functions (nb, nf, nq)."""
        facets = self.host_mesh.facets(name)
        if (self.host_mesh.mesh.f2t[1, facets] != -1).any():
            raise MeshError(f"boundary {name!r} lies inside the domain, so that {what} has no outward side")
        return self._facets(facets)

    def _facets(self, facets: NDArray[np.int64], side: NDArray[np.int64] | None = None) -> _Sides:
        """The same on given facets; for `side` see `facet_vector`."""
        where = facets if side is None else OrientedBoundary(facets, side)
        basis = skfem.FacetBasis(self._geometry, self._scalar_element, facets=where, intorder=2 * self.order + 1)
        place = _point_major(np.asarray(basis.global_coordinates()))
        normal = _point_major(np.broadcast_to(np.asarray(basis.normals), (2, *basis.dx.shape)))
        shapes = np.stack([np.broadcast_to(np.asarray(basis.basis[i][0]), basis.dx.shape) for i in range(basis.Nbfun)])
        return basis, place, normal, shapes

    def _scatter(self, nodes: NDArray[np.int64], local: Array) -> Array:
        vector = np.empty((self.nnodes, 2))
        for component in range(2):
            vector[:, component] = np.bincount(
                nodes.ravel(), weights=local[:, :, component].ravel(), minlength=self.nnodes
            )
        return vector.ravel()


def _point_major(field: Array) -> Array:
    """(component, element, point) -> (element * point, component)."""
    return np.ascontiguousarray(np.moveaxis(field, 0, -1).reshape(-1, field.shape[0]))
