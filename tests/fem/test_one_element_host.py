"""A second host, written by hand in NumPy for one bilinear square, agrees with the real one for each law."""

from __future__ import annotations

import numpy as np
import pytest
from fem_meshes import ELASTIC, PLASTIC, run

from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Material
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.stepping import StepControl
from granfabric.fem.loads.kinds import Displacement, Fixed, Stage
from granfabric.fem.mesh.host_mesh import rectangle

CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def strain_matrices():
    """B at the 2 x 2 Gauss points of the unit square, each of weight 1/4."""
    points = 0.5 + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.5 / np.sqrt(3)
    matrices = []
    for x, y in points:
        gradient = np.array([[-(1 - y), -(1 - x)], [1 - y, -x], [y, x], [-y, 1 - x]])
        b = np.zeros((3, 8))
        b[0, 0::2], b[1, 1::2] = gradient[:, 0], gradient[:, 1]
        b[2, 0::2], b[2, 1::2] = gradient[:, 1], gradient[:, 0]
        matrices.append(b)
    return points, np.array(matrices)


class OneElement:
    """Plain Newton with dense matrices; knows the law only through its contract."""

    def __init__(self, law, stress):
        self.points, self.b = strain_matrices()
        self.law = law
        self.stress = np.tile(stress, (4, 1)).astype(float)
        self.state = law.initial_state(self.stress)
        self.u = np.zeros(8)
        # Constant forces that balance the initial stress.
        self.reference = 0.25 * np.einsum("pij,pi->j", self.b, self.stress)

    def step(self, prescribed):
        free = np.setdiff1d(np.arange(8), list(prescribed))
        trial = self.u.copy()
        for dof, value in prescribed.items():
            trial[dof] = value
        for _ in range(50):
            increment = np.ascontiguousarray(self.b @ (trial - self.u))
            stress, state = np.empty((4, 3)), np.empty_like(self.state)
            tangent = np.empty((4, 3, 3))
            report = self.law.update(increment, self.stress, self.state, stress, state, tangent)
            assert report.failed == 0
            force = 0.25 * np.einsum("pij,pi->j", self.b, stress)
            residual = (force - self.reference)[free]
            if np.linalg.norm(residual) <= 1e-13 * np.linalg.norm(force):
                self.u, self.stress, self.state = trial, stress, state
                return
            matrix = 0.25 * np.einsum("pij,pik,pkl->jl", self.b, tangent, self.b)
            trial[free] -= np.linalg.solve(matrix[np.ix_(free, free)], residual)
        raise AssertionError("no convergence")


CONTACT = ContactLaw([Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9, shear_reduction=0.7)])


@pytest.mark.parametrize(
    ("law", "stress", "scale"),
    [(ELASTIC, 0.0, 1.0), (PLASTIC, 0.0, 1.0), (CONTACT, -1e5, 0.02)],
    ids=["elastic", "von Mises", "contact gain and loss"],
)
def test_both_hosts_agree(law, stress, scale):
    initial = np.array([stress, stress, 0.0])
    hand = OneElement(law, initial)
    space = Space(rectangle(1.0, 1.0, 1, 1, "quad"), "Q1")
    # The upper right corner may go sideways so that there is something to iterate on.
    press = [
        Fixed("bottom"),
        Displacement("top", "y", -0.006 * scale),
        Displacement("left", "x", lambda x, y: 0.004 * scale * y),
    ]
    stages = [Stage("press", press, 3), Stage("back", [Displacement("top", "y", 0.0)], 3)]
    control = StepControl(tolerance=1e-13)
    steps, summary = run(space, law, stages, control, initial_stress=initial, balance_initial_stress=True)
    assert summary.finished, summary.message
    order = np.array([np.argmin(np.sum((space.nodes - corner) ** 2, axis=1)) for corner in CORNERS])
    match = np.array([np.argmin(np.sum((hand.points - point) ** 2, axis=1)) for point in space.points])
    for number, step in enumerate(steps):
        vertical = -0.006 * scale * ((number + 1) / 3 if number < 3 else (5 - number) / 3)
        sideways = 0.004 * scale * min((number + 1) / 3, 1.0)
        hand.step({0: 0.0, 1: 0.0, 2: 0.0, 3: 0.0, 5: vertical, 7: vertical, 6: sideways})
        u = step.displacement.reshape(-1, 2)[order].ravel()
        np.testing.assert_allclose(u, hand.u, rtol=0, atol=1e-11 * scale)
        size = np.abs(hand.stress).max()
        np.testing.assert_allclose(step.stress, hand.stress[match], rtol=0, atol=1e-9 * size)
        np.testing.assert_allclose(step.state, hand.state[match], rtol=1e-9, atol=1e-9)
    # The states have gone somewhere.
    if law is PLASTIC:
        assert (steps[-1].state[:, 1] > 1e-3).any()
    if law is CONTACT:
        assert np.abs(steps[-1].state[:, 0] - 4.06).max() > 0.01
