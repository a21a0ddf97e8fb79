"""Each of several bodies has to be held against moving and turning, in every stage."""

from __future__ import annotations

import numpy as np
import pytest
from fem_meshes import ELASTIC

from granfabric.fem.discretisation.space import Space
from granfabric.fem.loads.kinds import Fixed, FixedPoint, LoadError, Pressure, Stage
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import build_mesh, rectangle


@pytest.fixture(scope="module")
def space():
    """Two squares, the second 2 m to the right; boundaries bottom_0, bottom_1, top_0, top_1."""
    one = rectangle(1.0, 1.0, 2, 2)
    points, cells, n = one.mesh.p.T, one.mesh.t.T, one.mesh.p.shape[1]
    lines = {
        f"{name}_{k}": one.mesh.facets[:, one.boundaries[name]].T + k * n for name in ("bottom", "top") for k in (0, 1)
    }
    regions = {"west": np.arange(8), "east": np.arange(8, 16)}
    host = build_mesh(
        np.concatenate([points, points + [3, 0]]), np.concatenate([cells, cells + n]), lines, regions, parts="separate"
    )
    return Space(host, "P2")


def test_both_held(space):
    Problem(space, ELASTIC, [Stage("a", [Fixed("bottom_0"), Fixed("bottom_1"), Pressure("top_1", 1.0)])])
    # three components that leave no motion free
    Problem(space, ELASTIC, [Stage("a", [Fixed("bottom_0"), FixedPoint((3, 0)), FixedPoint((4, 0), ("y",))])])


@pytest.mark.parametrize(
    ("loads", "motion"),
    [
        ([], "move along x and to move along y and to turn"),
        ([Fixed("bottom_1", ("y",))], "move along x"),
        ([Fixed("bottom_1", ("x",))], "move along y"),
        ([FixedPoint((3.5, 0.5))], "turn"),
        ([FixedPoint((3, 0)), FixedPoint((4, 0), ("x",))], "turn"),
        ([FixedPoint((3.5, 0.5), ("y",))], "move along x and to turn"),
    ],
)
def test_a_body_that_is_not_held_is_named(space, loads, motion):
    with pytest.raises(LoadError, match=rf"stage 'a': of the 2 bodies .* region 'east' .* is free to ({motion});"):
        Problem(space, ELASTIC, [Stage("a", [Fixed("bottom_0"), *loads])])


def test_every_stage_counts(space):
    held = Stage("a", [Fixed("bottom_0"), Fixed("bottom_1")])
    Problem(space, ELASTIC, [held, Stage("b", [Pressure("top_1", 1.0)])])
    with pytest.raises(LoadError, match="stage 'b': of the 2 bodies"):
        Problem(space, ELASTIC, [held, Stage("b", [Fixed("bottom_0")], keep=False)])


def test_one_body_is_left_to_the_solver():
    """As ever: a single body without support may be in balance."""
    Problem(Space(rectangle(1.0, 1.0, 1, 1), "P1"), ELASTIC, [Stage("a", [Pressure("top", 1.0)])])
