"""Initial stress from weight: integrals along verticals through layers, below openings, slopes and loads."""

from __future__ import annotations

import numpy as np
import pytest
from changing_meshes import column
from fem_meshes import ELEMENTS, cell_of, distorted

from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.imbalance import initial_imbalance
from granfabric.fem.loads.geostatic import geostatic_stress
from granfabric.fem.loads.kinds import BodyForce, Fixed, LoadError, Pressure, Stage, Traction
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.checks import MeshError
from granfabric.fem.mesh.host_mesh import build_mesh, rectangle

LAW = LinearElasticLaw(ElasticMaterial(1e8, 0.3))
WEIGHT = BodyForce((0.0, -18.0))
SIDES = [Fixed("bottom"), Fixed("left", ("x",)), Fixed("right", ("x",))]


def initial(*loads):
    return [Stage("initial", list(loads))]


@pytest.mark.parametrize("element", ELEMENTS)
def test_the_weight_of_what_lies_above(element):
    """On a mesh whose inner sides are anywhere."""
    space = Space(distorted(element), element)
    stress = geostatic_stress(space, initial(WEIGHT), 0.5)
    assert stress[:, 1] == pytest.approx(-18.0 * (1.0 - space.points[:, 1]), rel=1e-12)
    assert stress[:, 0] == pytest.approx(0.5 * stress[:, 1], rel=1e-15) and not stress[:, 2].any()


def layered(element="P2"):
    space = Space(column(3, across=2), element)
    weights = [BodyForce((0.0, -w), f"layer_{k}") for k, w in ((1, 20.0), (2, 18.0), (3, 16.0))]
    return space, weights


def test_layers_are_in_balance():
    space, weights = layered()
    loads = [*SIDES, *weights, Pressure("top", 5.0)]
    ratios = {"layer_1": 0.6, "layer_2": 0.5, "layer_3": 0.4}
    stress = geostatic_stress(space, initial(*loads), ratios)
    y = space.points[:, 1]
    exact = 5.0 + np.select([y > 2, y > 1], [16 * (3 - y), 16 + 18 * (2 - y)], 34 + 20 * (1 - y))
    assert stress[:, 1] == pytest.approx(-exact, rel=1e-12)
    assert sorted(set((stress[:, 0] / stress[:, 1]).round(9))) == [0.4, 0.5, 0.6]
    problem = Problem(space, LAW, initial(*loads), initial_stress=stress)
    assert initial_imbalance(problem).fraction < 1e-12


def test_weights_add_up_and_a_fill_that_comes_later_has_none():
    space, _ = layered()
    first = Stage("initial", [WEIGHT, BodyForce((0.0, -2.0), "layer_1")])
    stress = geostatic_stress(space, [first, Stage("fill", activate=["layer_3"])], 1.0)
    y = space.points[:, 1]
    exact = np.select([y > 2, y > 1], [0 * y, 18 * (2 - y)], 18 + 20 * (1 - y))
    assert stress[:, 1] == pytest.approx(-exact, rel=1e-12)


def test_an_opening_weighs_nothing():
    """A gap of one layer: what lies above it still counts, itself it does not."""
    space, _ = layered()
    stages = [Stage("initial", [WEIGHT]), Stage("prop", activate=["layer_2"])]
    stress = geostatic_stress(space, stages, 1.0)
    low = space.points[:, 1] < 1
    assert stress[low, 1] == pytest.approx(-18 * (1 + 1 - space.points[low, 1]), rel=1e-12)


def ramp(element="P2"):
    """Square whose upper side rises from 1 to 2."""
    host = rectangle(1.0, 1.0, 4, 4, cell_of(element))
    points = host.mesh.p.T.copy()
    points[:, 1] *= 1.0 + points[:, 0]
    lines = {name: host.mesh.facets[:, facets].T for name, facets in host.boundaries.items()}
    return Space(build_mesh(points, host.mesh.t.T, lines, host.regions), element)


@pytest.mark.parametrize("element", ["P2", "Q1"])
def test_below_a_slope(element):
    space = ramp(element)
    load = Pressure("top", lambda x, y: 3.0 * x)
    push = Traction("top", (7.0, -4.0))
    stress = geostatic_stress(space, initial(WEIGHT, load, push), 0.6, level=False)
    x, y = space.points.T
    # a pressure has its own value on the level, a force per length of the slope sqrt(2) times
    exact = 18.0 * (1 + x - y) + 3.0 * x + 4.0 * np.sqrt(2.0)
    assert stress[:, 1] == pytest.approx(-exact, rel=1e-12)
    with pytest.raises(LoadError, match=r"rises by 1 m from \(0, 1\) to \(1, 2\)"):
        geostatic_stress(space, initial(WEIGHT), 0.6)


@pytest.mark.parametrize(
    ("stages", "ratio", "text"),
    [
        ([Stage("first", [WEIGHT])], 0.5, "has to be named 'initial'"),
        (initial(), 0.5, "gives no weight .* to region 'all', 'layer_1', 'layer_2'"),
        (initial(BodyForce((0.0, -1.0), "layer_1")), 0.5, "gives no weight .* to region 'all', 'layer_2', 'layer_3'"),
        (initial(BodyForce((1.0, -1.0))), 0.5, "does not point straight down"),
        (initial(BodyForce((0.0, 1.0))), 0.5, "does not point straight down"),
        (initial(BodyForce(lambda x, y: np.zeros((len(x), 2)))), 0.5, "is not constant"),
        (initial(WEIGHT), {"layer_1": 0.5, "layer_2": 0.6}, "k0 leaves out region 'all', 'layer_3'"),
        (initial(WEIGHT), {"all": 0.5, "layer_2": 0.6}, "k0 of region 'layer_2': elements of it are in another region"),
    ],
)  # fmt: skip
def test_what_does_not_give_a_stress(stages, ratio, text):
    with pytest.raises(LoadError, match=text):
        geostatic_stress(layered()[0], stages, ratio)


def test_an_unknown_region_is_named():
    with pytest.raises(MeshError, match="k0: the mesh has no region 'layer_7'"):
        geostatic_stress(layered()[0], initial(WEIGHT), {"layer_7": 0.5})
