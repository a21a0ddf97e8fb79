"""Paths of points through stages that change the body: no jumps, whatever is placed, taken away or counted anew."""

from __future__ import annotations

import numpy as np
import pytest

from granfabric.cases.effects.carried import Carried
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Material
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.loads.kinds import Fixed, Pressure, Stage
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import HostMesh, rectangle

LAW = ContactLaw([Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)])


def steps_of(reset: bool) -> tuple[Problem, list]:
    made = rectangle(1.0, 2.0, 1, 2)
    low = made.mesh.p[1][made.mesh.t].mean(axis=0) < 1.0
    middle = np.flatnonzero(np.abs(made.mesh.p[1][made.mesh.facets] - 1.0).max(axis=0) < 1e-9)
    regions = {"low": np.flatnonzero(low), "high": np.flatnonzero(~low)}
    host = HostMesh(made.mesh, {**made.boundaries, "middle": middle}, regions)
    sides = [Fixed("bottom"), Fixed("left", ("x",)), Fixed("right", ("x",))]
    stages = [
        Stage("initial", [*sides, Pressure("top", 1e5)]),
        Stage("press", [Pressure("top", 1.2e5)], 2),
        Stage("dig", [Pressure("middle", 0.6e5), Pressure("top", 0.0)], 2, deactivate=["high"]),
        Stage(
            "fill",
            [Pressure("middle", 0.0), Pressure("top", 0.8e5)],
            2,
            activate=["high"],
            fill_pressure=0.6e5,
            reset_displacements=reset,
        ),
    ]
    problem = Problem(Space(host, "P1"), LAW, stages, initial_stress=(-1e5, -1e5, 0.0))
    steps: list = []
    assert solve(problem, on_step=steps.append).finished
    return problem, steps


@pytest.mark.parametrize("reset", [False, True])
def test_nothing_jumps(reset: bool) -> None:
    problem, steps = steps_of(reset)
    carried = Carried(problem)
    paths = [carried(step) for step in steps]
    high = np.isin(problem.space.point_cell, problem.space.host_mesh.regions["high"])
    strain = np.array([strain for strain, _, _ in paths])
    dug = [step.stage == "dig" for step in steps].index(True)
    # what is taken away stays as it was, with pressure and contacts
    for step in (dug, dug + 1):
        for now, before in zip(paths[step], paths[dug - 1]):
            assert np.array_equal(now[high], before[high])
    assert np.abs(np.diff(strain, axis=0)).max() < 5e-4
    assert all((stress[:, 1] < -1e3).all() and (state[:, 0] > 0).all() for _, stress, state in paths)
    # strains count from the beginning: those of the last step are the sums of all increments
    same = steps_of(False)[1]
    assert strain[-1][~high] == pytest.approx(same[-1].strain[~high], abs=1e-12)
