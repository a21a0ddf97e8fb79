"""Strain, internal forces and tangent of both hosts on the same cells, on arrays that mean nothing."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from granfabric.fem.discretisation.assembly import ForceAssembler, TangentAssembler
from granfabric.fem.discretisation.space import Space
from granfabric.fem.fenicsx.distribution import Distribution, DistributionError, Outline, check_space, matching
from granfabric.fem.mesh.host_mesh import HostMesh, rectangle
from granfabric.fem.mesh.shapes import quarter_ring


def meshes() -> list[tuple[str, HostMesh]]:
    made = []
    for cell, elements in (("triangle", ("P1", "P2")), ("quad", ("Q1", "Q2"))):
        for element in elements:
            made.append((element, rectangle(2.0, 1.0, 4, 3, cell)))
            made.append((element, quarter_ring(1.0, 2.0, 3, 4, cell)))  # curved where the element can
    return made


@pytest.mark.parametrize("case", range(8))
def test_both_hosts_agree(case: int) -> None:
    from mpi4py import MPI

    from granfabric.fem.fenicsx.forces import DistributedForces

    element, mesh = meshes()[case]
    space = Space(mesh, element)
    assert space.is_curved == (case % 2 == 1 and element in ("P2", "Q2"))
    theirs = Distribution(MPI.COMM_SELF, space)
    ours, forces = ForceAssembler(space), DistributedForces(theirs)
    random = np.random.default_rng(case)
    moved = random.normal(size=space.ndofs)
    stress, tangent = random.normal(size=(space.npoints, 3)), random.normal(size=(space.npoints, 3, 3))

    def of_nodes(vector: np.ndarray) -> np.ndarray:
        return theirs.nodes.scatter(vector.reshape(-1, 2), (2,)).ravel()

    def back(vector: np.ndarray) -> np.ndarray:
        whole = theirs.nodes.gather(vector.reshape(-1, 2))
        assert whole is not None
        return whole.ravel()

    assert_allclose(theirs.places, space.points[theirs.point_numbers], atol=1e-13)
    strain = theirs.points.gather(forces.strain(of_nodes(moved), np.empty((theirs.npoints, 3))))
    wanted = ours.strain(moved, np.empty((space.npoints, 3)))
    assert_allclose(strain, wanted, atol=1e-12 * np.abs(wanted).max())
    force = back(forces.internal_force(theirs.points.scatter(stress, (3,)), np.empty(theirs.ndofs)))
    wanted = ours.internal_force(stress, np.empty(space.ndofs))
    assert_allclose(force, wanted, atol=1e-13 * np.abs(wanted).max())
    action = back(forces.tangent_times(theirs.points.scatter(tangent, (3, 3)), of_nodes(moved), np.empty(theirs.ndofs)))
    wanted = ours.tangent_times(tangent, moved, np.empty(space.ndofs))
    assert_allclose(action, wanted, atol=1e-12 * np.abs(wanted).max())
    matrix = TangentAssembler(space, np.arange(space.ndofs)).assemble(tangent)
    assert_allclose(action, matrix @ moved, atol=1e-12 * np.abs(wanted).max())


def test_numbers_are_found_by_place() -> None:
    random = np.random.default_rng(0)
    places = random.random((9, 2))
    order = random.permutation(9)
    found = matching(places, places[order])
    assert found is not None
    assert_allclose(places[order][found], places)
    assert matching(places, places[order] + 1e-6) is None
    assert matching(places, places[:8]) is None
    assert matching(places, places[[*range(8), 0]]) is None


def test_other_integration_points_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    space = Space(rectangle(1.0, 1.0, 2, 2, "triangle"), "P2")
    check_space(space)
    monkeypatch.setattr(space, "reference_points", space.reference_points * 0.9)
    with pytest.raises(DistributionError, match="3 integration points of quadrature_degree = 2 of P2 elsewhere"):
        check_space(space)
    monkeypatch.setattr(space, "reference_points", space.reference_points / 0.9)
    monkeypatch.setattr(space, "reference_weights", np.array([0.1, 0.2, 0.2]))
    with pytest.raises(DistributionError, match="weighs"):
        check_space(space)


def test_degrees_on_which_the_hosts_agree() -> None:
    """Where the rules differ the host refuses; where they agree, they agree in every point."""
    refused = []
    for cell, element in (("triangle", "P2"), ("quad", "Q2")):
        for degree in range(1, 7):
            space = Space(rectangle(1.0, 1.0, 1, 1, cell), element, degree)
            try:
                check_space(space)
            except DistributionError:
                refused.append((element, degree))
    assert {("P2", 1), ("P2", 2), ("Q2", 2), ("Q2", 4)}.isdisjoint(refused)
    assert Outline("Q2", 4, False, np.empty(0), np.empty(0), np.empty(0), 1.0).cell == "quadrilateral"
