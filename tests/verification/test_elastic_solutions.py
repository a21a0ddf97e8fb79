"""Closed-form elasticity: thick cylinder and plate with a hole, with the order of convergence of each element.

Sources: Lame's thick cylinder in plane strain, Timoshenko & Goodier, Theory of Elasticity, 3rd ed. (1970), section 28;
Kirsch's plate with a hole, ibid. section 35. Boundaries are straight between nodes; the exact tractions and
displacements are applied where the boundary of the mesh is, so that the exact solution solves the discrete domain's
problem and the error is that of the element alone: order p + 1 in the L2 norm.
"""

from __future__ import annotations

import numpy as np
import pytest

from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.stepping import StepControl, solve
from granfabric.fem.loads.kinds import Displacement, Fixed, Stage, Traction
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import build_mesh

E, NU = 1000.0, 0.3
G = E / (2 * (1 + NU))
INNER, OUTER = 1.0, 2.0
SIZES = {"P1": (8, 16, 32), "P2": (4, 8, 16), "Q1": (8, 16, 32), "Q2": (4, 8, 16)}


def quarter_ring(element, n):
    """Quarter of a ring, n cells by n, inner radius 1, outer 2."""
    radius, angle = np.meshgrid(np.linspace(INNER, OUTER, n + 1), np.linspace(0, np.pi / 2, n + 1))
    points = np.stack([(radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()], axis=1)
    points[np.abs(points) < 1e-14] = 0.0
    node = np.arange(len(points)).reshape(n + 1, n + 1)
    a, b, c, d = (part.ravel() for part in (node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]))
    cells = np.stack([a, b, c, d], axis=1)
    if element.startswith("P"):
        cells = np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)
    sides = {"inner": node[:, 0], "outer": node[:, -1], "below": node[0], "left": node[-1]}
    return build_mesh(points, cells, {name: np.stack([s[:-1], s[1:]], axis=1) for name, s in sides.items()})


def lame(x, y, pressure=10.0):
    """Displacement and stress under internal pressure."""
    r2 = x**2 + y**2
    c = pressure * INNER**2 / (OUTER**2 - INNER**2)
    ratio = OUTER**2 / r2
    radial, hoop = c * (1 - ratio), c * (1 + ratio)
    u = c / (2 * G) * ((1 - 2 * NU) + ratio)  # radial displacement over r
    n = np.stack([x, y]) / np.sqrt(r2)
    stress = np.stack(
        [
            radial * n[0] ** 2 + hoop * n[1] ** 2,
            radial * n[1] ** 2 + hoop * n[0] ** 2,
            (radial - hoop) * n[0] * n[1],
        ],
        axis=1,
    )
    return np.stack([u * x, u * y], axis=1), stress


def kirsch(x, y, tension=10.0):
    """Displacement and stress around a hole of radius 1 under remote tension along x, plane strain."""
    a = INNER
    r, t = np.hypot(x, y), np.arctan2(y, x)
    q = a**2 / r**2
    kappa = 3 - 4 * NU
    factor = tension * a / (8 * G)
    ux = factor * (
        r / a * (kappa + 1) * np.cos(t)
        + 2 * a / r * ((1 + kappa) * np.cos(t) + np.cos(3 * t))
        - 2 * a**3 / r**3 * np.cos(3 * t)
    )
    uy = factor * (
        r / a * (kappa - 3) * np.sin(t)
        + 2 * a / r * ((1 - kappa) * np.sin(t) + np.sin(3 * t))
        - 2 * a**3 / r**3 * np.sin(3 * t)
    )
    c2, c4, s2, s4 = np.cos(2 * t), np.cos(4 * t), np.sin(2 * t), np.sin(4 * t)
    stress = tension * np.stack(
        [
            1 - q * (1.5 * c2 + c4) + 1.5 * q**2 * c4,
            -q * (0.5 * c2 - c4) - 1.5 * q**2 * c4,
            -q * (0.5 * s2 + s4) + 1.5 * q**2 * s4,
        ],
        axis=1,
    )
    return np.stack([ux, uy], axis=1), stress


def error_and_solution(element, n, exact):
    """L2 norm of the displacement error over that of the displacement, and the step."""
    space = Space(quarter_ring(element, n), element)

    def traction(x, y, nx, ny):
        stress = exact(x, y)[1]
        return np.stack([stress[:, 0] * nx + stress[:, 2] * ny, stress[:, 2] * nx + stress[:, 1] * ny], axis=1)

    loads = [
        Traction("inner", traction),
        Displacement("outer", "x", lambda x, y: exact(x, y)[0][:, 0]),
        Displacement("outer", "y", lambda x, y: exact(x, y)[0][:, 1]),
        Fixed("below", ("y",)),
        Fixed("left", ("x",)),
    ]
    steps = []
    law = LinearElasticLaw(ElasticMaterial(E, NU))
    summary = solve(Problem(space, law, [Stage("load", loads)]), StepControl(tolerance=1e-12), on_step=steps.append)
    assert summary.finished, summary.message
    fine = Space(space.host_mesh, element, quadrature_degree=2 * space.order + 2)
    computed = fine.interpolate(steps[-1].displacement.reshape(-1, 2))
    wanted = exact(fine.points[:, 0], fine.points[:, 1])[0]
    norm = np.sqrt(fine.weights @ np.sum(wanted**2, axis=1))
    return np.sqrt(fine.weights @ np.sum((computed - wanted) ** 2, axis=1)) / norm, steps[-1], space


@pytest.mark.parametrize("exact", [lame, kirsch])
@pytest.mark.parametrize("element", ["P1", "P2", "Q1", "Q2"])
def test_order_of_convergence_in_l2(element, exact):
    sizes = SIZES[element]
    errors = [error_and_solution(element, n, exact)[0] for n in sizes]
    order = int(element[1]) + 1
    slopes = -np.diff(np.log(errors)) / np.diff(np.log(sizes))
    assert slopes[-1] == pytest.approx(order, abs=0.15), (errors, slopes)
    assert errors[-1] < 2e-3


def test_closed_forms_are_in_equilibrium_and_fit_hookes_law():
    # The formulas themselves: strains by differences give the stress, whose divergence vanishes.
    rng = np.random.default_rng(0)
    radius, angle = rng.uniform(1.1, 1.9, 20), rng.uniform(0.1, 1.4, 20)
    x, y, h = radius * np.cos(angle), radius * np.sin(angle), 1e-5
    lam = E * NU / ((1 + NU) * (1 - 2 * NU))
    for exact in (lame, kirsch):
        dx = (exact(x + h, y)[0] - exact(x - h, y)[0]) / (2 * h)
        dy = (exact(x, y + h)[0] - exact(x, y - h)[0]) / (2 * h)
        trace = dx[:, 0] + dy[:, 1]
        hooke = np.stack([lam * trace + 2 * G * dx[:, 0], lam * trace + 2 * G * dy[:, 1], G * (dy[:, 0] + dx[:, 1])], 1)
        np.testing.assert_allclose(exact(x, y)[1], hooke, atol=1e-6)
        sx = (exact(x + h, y)[1] - exact(x - h, y)[1]) / (2 * h)
        sy = (exact(x, y + h)[1] - exact(x, y - h)[1]) / (2 * h)
        np.testing.assert_allclose(sx[:, 0] + sy[:, 2], 0.0, atol=1e-5)
        np.testing.assert_allclose(sx[:, 2] + sy[:, 1], 0.0, atol=1e-5)


def test_stress_concentration_of_three_at_the_hole():
    # sigma_xx at the top of the hole is three times the remote tension; from the fine mesh, by projection.
    from granfabric.fem.discretisation.projection import Projection

    _, step, space = error_and_solution("P2", 32, kirsch)
    stress = Projection(space)(step.stress)
    top = np.argmin(np.hypot(space.nodes[:, 0], space.nodes[:, 1] - 1.0))
    assert stress[top, 0] == pytest.approx(30.0, rel=0.01)
