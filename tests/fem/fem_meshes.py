"""Meshes and small drivers shared by the tests of the host."""

from __future__ import annotations

import numpy as np

from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.constitutive.plain_laws.von_mises import VonMisesLaw, VonMisesMaterial
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.stepping import StepControl, solve
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import HostMesh, build_mesh, rectangle

ELEMENTS = ("P1", "P2", "Q1", "Q2")
ELASTIC = LinearElasticLaw(ElasticMaterial(1000.0, 0.3))
PLASTIC = VonMisesLaw(VonMisesMaterial(1000.0, 0.3, 1.0, 10.0))


def cell_of(element: str) -> str:
    return "triangle" if element.startswith("P") else "quad"


def distorted(element: str, n: int = 4, amount: float = 0.25, seed: int = 5) -> HostMesh:
    """Rectangle 2 x 1 whose inner nodes are moved at random by up to `amount` of a cell."""
    host = rectangle(2.0, 1.0, n, n, cell_of(element))
    points = host.mesh.p.T.copy()
    inner = (points[:, 0] > 0) & (points[:, 0] < 2) & (points[:, 1] > 0) & (points[:, 1] < 1)
    move = np.random.default_rng(seed).uniform(-amount, amount, points.shape) * np.array([2.0 / n, 1.0 / n])
    points[inner] += move[inner]
    lines = {name: host.mesh.facets[:, facets].T for name, facets in host.boundaries.items()}
    return build_mesh(points, host.mesh.t.T, lines, host.regions)


def run(space: Space, law, stages, control: StepControl | None = None, **options):
    """Steps and summary of a problem."""
    steps = []
    summary = solve(Problem(space, law, stages, **options), control or StepControl(), on_step=steps.append)
    return steps, summary


def nodal(step) -> np.ndarray:
    return step.displacement.reshape(-1, 2)
