"""The law in a FEniCSx program of one's own, as the guide shows it."""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from ranks import on_ranks

import granfabric as gf

EXAMPLE = Path(__file__).resolve().parents[2] / "docs" / "examples" / "fenicsx_biaxial.py"


def told(text: str) -> np.ndarray:
    found = re.findall(r"stress_yy (\S+) kPa, coordination (\S+)", text)
    return np.array(found, dtype=float)


@pytest.mark.slow
@pytest.mark.skipif(find_spec("dolfinx_solver") is None, reason="the example is written for the package of PyPI")
def test_the_example_finds_what_the_own_host_finds_on_any_ranks() -> None:
    one, two = (on_ranks(ranks, str(EXAMPLE)) for ranks in (1, 2))
    assert one.returncode == two.returncode == 0, one.stderr + two.stderr
    assert one.stdout == two.stdout
    pressure = 100e3
    mesh = gf.rectangle(0.05, 0.1, 12, 24)
    law = gf.ContactLaw([gf.Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)])
    sides = [gf.Pressure("left", pressure), gf.Pressure("right", pressure)]
    ends = [gf.Fixed("bottom"), gf.Fixed("top", ("x",))]
    start = gf.Stage("initial", [*ends, gf.Fixed("top", ("y",)), *sides])
    press = gf.Stage("compression", [*ends, *sides, gf.Displacement("top", "y", -5e-6)], increments=10)
    space = gf.Space(mesh, "P2")
    problem = gf.Problem(space, law, [start, press], initial_stress=(-pressure, -pressure, 0.0))
    steps: list[gf.StepResult] = []
    gf.solve(problem, gf.StepControl(tolerance=1e-9), on_step=steps.append)
    weights = space.weights / space.weights.sum()
    coordination = law.description.columns("coordination")
    wanted = [[weights @ s.stress[:, 1] / 1e3, (weights @ s.state[:, coordination])[0]] for s in steps[-10:]]
    # the diagonals of the cells lean the other way
    np.testing.assert_allclose(told(one.stdout), wanted, rtol=2e-4)


def test_points_that_fail_are_told_and_nothing_is_committed() -> None:
    from dolfinx import fem, mesh
    from mpi4py import MPI

    from granfabric.fem.fenicsx import dialect
    from granfabric.fem.fenicsx.quadrature_law import QuadratureLaw

    body = mesh.create_unit_square(MPI.COMM_SELF, 2, 2)
    u = fem.Function(dialect.vector_space(body, 1))
    law = gf.ContactLaw([gf.Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)])
    material = QuadratureLaw(law, u, 1, (-1e5, -1e5, 0.0))
    before = material.state.copy()
    tangent = material.tangent.x.array.copy()
    u.interpolate(lambda x: np.vstack([1e-6 * x[0], -3e-6 * x[1]]))
    assert material.update()
    single = law.initial_state(np.array([[-1e5, -1e5, 0.0]]))
    stress, state = np.empty((1, 3)), np.empty_like(single)
    law.update(np.array([[1e-6, -3e-6, 0.0]]), np.array([[-1e5, -1e5, 0.0]]), single, stress, state, None)
    np.testing.assert_allclose(material.stress.x.array.reshape(-1, 3), np.tile(stress, (8, 1)), rtol=1e-12, atol=1e-9)
    np.testing.assert_array_equal(material.state, before)
    u.interpolate(lambda x: np.vstack([1e-2 * x[0], 1e-2 * x[1]]))
    assert not material.update()
    np.testing.assert_array_equal(material.state, before)
    u.x.array[:] = 0.0
    assert material.update()
    np.testing.assert_array_equal(material.tangent.x.array, tangent)
    with pytest.raises(ValueError, match="initial stress"):
        QuadratureLaw(law, u, 1, np.zeros((3, 3)))
