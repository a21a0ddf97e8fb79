"""Rigid bodies and springs on what an earlier stage has filled: increments are those of the ground without stages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from changing_meshes import column
from fem_meshes import ELASTIC, PLASTIC, run

from granfabric.fem.discretisation.space import Space
from granfabric.fem.loads.kinds import BodyForce, Fixed, LoadError, Pressure, RigidBody, Spring, Stage
from granfabric.fem.loads.problem import Problem

HELD = [Fixed("bottom"), Fixed("left", ("x",))]


@pytest.fixture(scope="module")
def tower():
    return Space(column(3, across=2), "P2")


LOADS = {
    "rough": RigidBody("top_3", force=(0.0, -4e-3), moment=-3e-4),
    "smooth": RigidBody("top_3", rough=False, force=(0.0, -4e-3), moment=-3e-4),
    "springs": Spring("top_3", normal=500.0, tangential=200.0),
}


@pytest.mark.parametrize("name", LOADS)
@pytest.mark.parametrize("law", [ELASTIC, PLASTIC], ids=["one solve a stage", "newton"])
def test_what_follows_a_fill_is_that_of_the_same_ground(tower, law, name):
    last = [Stage("load", [LOADS[name]], increments=2), Stage("side", [Pressure("right", "1e-3*y")], increments=2)]
    crooked = BodyForce(("4e-4*x", "-1e-3*x"), "layer_3")  # the top is not straight when the footing comes
    filled = [
        Stage("ground", [*HELD, Pressure("top_2", 2e-3)]),
        Stage("fill", [Pressure("top_2", 0.0), crooked], activate=["layer_3"]),
    ]
    steps, _ = run(tower, law, [*filled, *last])
    alone, _ = run(tower, law, [Stage("ground", HELD), *last])
    before = next(step for step in reversed(steps) if step.stage == "fill")
    top = before.displacement.reshape(-1, 2)[tower.boundary_nodes("top_3"), 1]
    scale = np.abs(alone[-1].displacement).max()
    assert np.ptp(top) > 0.01 * scale
    assert np.abs(steps[-1].displacement - before.displacement - alone[-1].displacement).max() < 1e-7 * scale


@pytest.mark.parametrize("load", LOADS.values(), ids=LOADS)
@pytest.mark.parametrize(
    ("stages", "changing"),
    [
        ([Stage("fill", activate=["layer_3"]), Stage("dig", deactivate=["layer_3"])], "dig"),  # with it
        ([Stage("fill", activate=["layer_3"])], "fill"),  # in the same stage
        ([Stage("dig", deactivate=["layer_3"])], "dig"),
    ],
)
def test_the_ground_below_stays_as_it_is(tower, stages, changing, load):
    first, one, *others = Stage("ground", HELD), *stages
    stages = [one, Stage("load", [load]), *others] if others else [replace(one, loads=[load])]
    with pytest.raises(LoadError, match=f"boundary 'top_3', and stage '{changing}' activates or deactivates elements"):
        Problem(tower, ELASTIC, [first, *stages])
