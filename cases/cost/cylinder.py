"""Thick cylinder under internal pressure: closed form, mesh of a quarter, and the error of a finite element solution.

Source: Lame's solution in plane strain, Timoshenko & Goodier, Theory of Elasticity, 3rd ed. (1970), section 28.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.control import StepControl
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.loads.kinds import Displacement, Fixed, Load, Stage, Traction
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import HostMesh, build_mesh

from .study import StudyError

Array = NDArray[np.float64]

YOUNGS_MODULUS, POISSONS_RATIO = 1000.0, 0.3
INNER, OUTER, PRESSURE = 1.0, 2.0, 10.0


@dataclass(frozen=True)
class Solution:
    """A finite element solution with its errors.

    Parameters
    ----------
    displacement_error, stress_error : float
        Norms over the body of the error, relative to the norm of the closed form.
    degrees_of_freedom, elements, points : int
    nonzeros : int
        Entries of the stiffness matrix of all degrees of freedom.
    factorisations, law_calls : int
    """

    displacement_error: float
    stress_error: float
    degrees_of_freedom: int
    elements: int
    points: int
    nonzeros: int
    factorisations: int
    law_calls: int


def lame(x: Array, y: Array) -> tuple[Array, Array]:
    """Displacement (n, 2) [m] and stress (n, 3; tension positive) [Pa] under internal pressure, plane strain."""
    squared = x**2 + y**2
    c = PRESSURE * INNER**2 / (OUTER**2 - INNER**2)
    ratio = OUTER**2 / squared
    radial, hoop = c * (1 - ratio), c * (1 + ratio)
    over_radius = c * (1 + POISSONS_RATIO) / YOUNGS_MODULUS * ((1 - 2 * POISSONS_RATIO) + ratio)
    nx, ny = x / np.sqrt(squared), y / np.sqrt(squared)
    stress = [radial * nx**2 + hoop * ny**2, radial * ny**2 + hoop * nx**2, (radial - hoop) * nx * ny]
    return np.stack([over_radius * x, over_radius * y], axis=1), np.stack(stress, axis=1)


def quarter_ring(cell: str, cells: int) -> HostMesh:
    """Quarter of the ring in `cells` by `cells` quadrilaterals, or each of them halved into triangles."""
    radius, angle = np.meshgrid(np.linspace(INNER, OUTER, cells + 1), np.linspace(0.0, np.pi / 2, cells + 1))
    points = np.stack([(radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()], axis=1)
    points[np.abs(points) < 1e-14] = 0.0
    node = np.arange(len(points)).reshape(cells + 1, cells + 1)
    a, b, c, d = (part.ravel() for part in (node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]))
    corners = np.stack([a, b, c, d], axis=1)
    if cell == "triangle":
        corners = np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)
    sides = {"inner": node[:, 0], "outer": node[:, -1], "below": node[0], "left": node[-1]}
    return build_mesh(points, corners, {name: np.stack([s[:-1], s[1:]], axis=1) for name, s in sides.items()})


def _traction(x: Array, y: Array, nx: Array, ny: Array) -> Array:
    stress = lame(x, y)[1]
    return np.stack([stress[:, 0] * nx + stress[:, 2] * ny, stress[:, 2] * nx + stress[:, 1] * ny], axis=1)


def compute(mesh: HostMesh, element: str) -> tuple[Space, StepResult, dict[str, int]]:
    """Solve the problem from the mesh on: space, pattern, factorisation, solution.

    The sides are straight between nodes; the closed form's traction (inside) and displacement (outside) act where the
    boundary of the mesh is, so that the closed form solves the problem on the meshed domain too and the error is that
    of the element alone.

    Raises
    ------
    StudyError
        If the solver does not finish.
    """
    space = Space(mesh, element)
    loads: list[Load] = [
        Traction("inner", _traction),
        Displacement("outer", "x", lambda x, y: lame(x, y)[0][:, 0]),
        Displacement("outer", "y", lambda x, y: lame(x, y)[0][:, 1]),
        Fixed("below", ("y",)),
        Fixed("left", ("x",)),
    ]
    law = LinearElasticLaw(ElasticMaterial(YOUNGS_MODULUS, POISSONS_RATIO))
    steps: list[StepResult] = []
    stage = Stage("pressure", loads, 1)
    summary = solve(Problem(space, law, [stage]), StepControl(tolerance=1e-11), on_step=steps.append)
    if not summary.finished:
        raise StudyError(f"the cylinder with {element} elements was not solved: {summary.message}")
    return space, steps[-1], summary.counters


def measure(mesh: HostMesh, element: str) -> Solution:
    """Solve and compare with the closed form by a quadrature of higher degree."""
    space, step, counters = compute(mesh, element)
    fine = Space(mesh, element, quadrature_degree=2 * space.order + 2)
    wanted = lame(fine.points[:, 0], fine.points[:, 1])[0]
    wrong = fine.interpolate(step.displacement.reshape(-1, 2)) - wanted
    exact = lame(space.points[:, 0], space.points[:, 1])[1]
    nodes = space.element_nodes
    pairs = np.unique(np.repeat(nodes, nodes.shape[1], axis=1).astype(np.int64).ravel() * len(space.nodes)
                      + np.tile(nodes, (1, nodes.shape[1])).ravel())  # fmt: skip
    return Solution(
        _norm(fine.weights, wrong) / _norm(fine.weights, wanted),
        _norm(space.weights, step.stress - exact) / _norm(space.weights, exact),
        space.ndofs,
        space.nelements,
        space.npoints,
        4 * len(pairs),
        counters["factorisations"],
        counters["law_calls"],
    )


def _norm(weights: Array, values: Array) -> float:
    return float(np.sqrt(weights @ np.sum(values**2, axis=1)))
