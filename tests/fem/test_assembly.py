"""Assembly against scikit-fem's own forms, and independence of the number of threads."""

from __future__ import annotations

import numba
import numpy as np
import pytest
import skfem
from fem_meshes import ELEMENTS, distorted

from granfabric.fem.discretisation.assembly import ForceAssembler, TangentAssembler
from granfabric.fem.discretisation.space import Space

SKFEM_ELEMENTS = {
    "P1": skfem.ElementTriP1,
    "P2": skfem.ElementTriP2,
    "Q1": skfem.ElementQuad1,
    "Q2": skfem.ElementQuad2,
}


def reference_basis(space):
    """scikit-fem's vector basis with the quadrature of the space."""
    element = skfem.ElementVector(SKFEM_ELEMENTS[space.element]())
    scalar = skfem.CellBasis(space.host_mesh.mesh, SKFEM_ELEMENTS[space.element](), intorder=space.quadrature_degree)
    quadrature = (scalar.X, scalar.W)
    if space.points_per_cell == 1:
        quadrature = (np.full((2, 1), 1 / 3), np.array([0.5]))
    return skfem.CellBasis(space.host_mesh.mesh, element, quadrature=quadrature)


def engineering(gradient):
    return np.stack([gradient[0, 0], gradient[1, 1], gradient[0, 1] + gradient[1, 0]])


@pytest.mark.parametrize("element", ELEMENTS)
def test_tangent_equals_scikit_fem_for_an_unsymmetric_law(element):
    space = Space(distorted(element), element)
    tangent = np.random.default_rng(2).standard_normal((space.npoints, 3, 3))
    basis = reference_basis(space)

    @skfem.BilinearForm
    def form(u, v, w):
        return np.einsum("i...,ij...,j...->...", engineering(v.grad), w.D, engineering(u.grad))

    turned = tangent.reshape(space.nelements, space.points_per_cell, 3, 3).transpose(2, 3, 0, 1)
    expected = form.assemble(basis, D=turned).toarray()
    matrix = TangentAssembler(space, np.arange(space.ndofs)).assemble(tangent).toarray()
    np.testing.assert_allclose(matrix, expected, rtol=0, atol=1e-14 * np.abs(expected).max())
    # Some degrees of freedom only: the same entries.
    free = np.arange(space.ndofs)[::3]
    part = TangentAssembler(space, free).assemble(tangent).toarray()
    np.testing.assert_array_equal(part, matrix[np.ix_(free, free)])


@pytest.mark.parametrize("element", ELEMENTS)
def test_internal_force_equals_scikit_fem(element):
    space = Space(distorted(element), element)
    stress = np.random.default_rng(3).standard_normal((space.npoints, 3))

    @skfem.LinearForm
    def form(v, w):
        return np.einsum("i...,i...->...", engineering(v.grad), w.s)

    turned = stress.reshape(space.nelements, space.points_per_cell, 3).transpose(2, 0, 1)
    expected = form.assemble(reference_basis(space), s=turned)
    assembler = ForceAssembler(space)
    force = assembler.internal_force(stress, np.empty(space.ndofs))
    np.testing.assert_allclose(force, expected, rtol=0, atol=1e-14 * np.abs(expected).max())
    assert (assembler.magnitude >= np.abs(force)).all()


@pytest.mark.parametrize("element", ELEMENTS)
def test_product_without_matrix_equals_product_with_it(element):
    space = Space(distorted(element), element)
    rng = np.random.default_rng(4)
    tangent, vector = rng.standard_normal((space.npoints, 3, 3)), rng.standard_normal(space.ndofs)
    matrix = TangentAssembler(space, np.arange(space.ndofs)).assemble(tangent)
    product = ForceAssembler(space).tangent_times(tangent, vector, np.empty(space.ndofs))
    np.testing.assert_allclose(product, matrix @ vector, rtol=0, atol=1e-13 * np.abs(product).max())


def test_pattern_is_symmetric_and_reused():
    space = Space(distorted("P2"), "P2")
    assembler = TangentAssembler(space, np.arange(5, space.ndofs))
    first = assembler.assemble(np.ones((space.npoints, 3, 3)))
    pattern = (first.indptr, first.indices, first.data)
    second = assembler.assemble(np.zeros((space.npoints, 3, 3)))
    assert second is first and all(a is b for a, b in zip(pattern, (second.indptr, second.indices, second.data)))
    shape = (np.ones(first.nnz), first.indices, first.indptr)
    dense = type(first)(shape, shape=first.shape).toarray()
    np.testing.assert_array_equal(dense, dense.T)


def test_one_and_two_threads_agree_to_the_bit():
    space = Space(distorted("Q2", 12), "Q2")
    rng = np.random.default_rng(6)
    stress, tangent = rng.standard_normal((space.npoints, 3)), rng.standard_normal((space.npoints, 3, 3))
    displacement = rng.standard_normal(space.ndofs)
    before = numba.get_num_threads()
    results = []
    try:
        for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(threads)
            forces = ForceAssembler(space)
            matrix = TangentAssembler(space, np.arange(space.ndofs)).assemble(tangent)
            results.append(
                (
                    forces.internal_force(stress, np.empty(space.ndofs)),
                    forces.strain(displacement, np.empty((space.npoints, 3))),
                    matrix.data.copy(),
                )
            )
    finally:
        numba.set_num_threads(before)
    for one, two in zip(*results):
        np.testing.assert_array_equal(one, two)
