"""Hard meshes and materials in the host: soft on stiff, needles, obtuse angles, no change of volume, one element."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from fem_meshes import ELEMENTS, cell_of, nodal, run
from hard_laws import PRESSURE, each_closure, make_law, material

from granfabric.constitutive.parameters import Closure
from granfabric.constitutive.path import Leg, drive
from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.stepping import StepControl
from granfabric.fem.loads.kinds import BodyForce, Displacement, Fixed, Stage
from granfabric.fem.mesh.host_mesh import HostMesh, build_mesh, rectangle

SIDES = ("bottom", "right", "top", "left")


def linear_boundary(gradient: np.ndarray) -> list:
    return [
        Displacement(side, axis, lambda x, y, i=i: gradient[i, 0] * x + gradient[i, 1] * y)
        for side in SIDES
        for i, axis in enumerate("xy")
    ]


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("contrast", [1.0, 1e4, 1e-4])
def test_soft_on_stiff(element: str, contrast: float) -> None:
    """A column of two layers without Poisson's ratio, pressed by u: stress u/(h1/E1 + h2/E2) everywhere.

    The residual is asked to fall to 1e-9: rounding leaves eps times the contrast times some hundreds of summation.
    """
    host = rectangle(1.0, 2.0, 3, 6, cell_of(element))
    upper = host.mesh.p[1, host.mesh.t].mean(axis=0) > 1.0
    law = LinearElasticLaw([ElasticMaterial(1e3, 0.0), ElasticMaterial(1e3 * contrast, 0.0)])
    space = Space(host, element)
    loads = [Fixed("bottom"), Displacement("top", "y", -1e-3), Displacement("top", "x", 0.0)]
    index = upper.astype(np.int32)[space.point_cell]
    steps, summary = run(space, law, [Stage("press", loads, 1)], StepControl(tolerance=1e-9), material_index=index)
    assert summary.finished, summary.message
    expected = -1e-3 / (1 / 1e3 + 1 / (1e3 * contrast))
    assert steps[-1].stress[:, 1] == pytest.approx(expected, rel=1e-7)
    assert np.abs(steps[-1].stress[:, [0, 2]]).max() < 1e-7 * abs(expected)


@pytest.mark.parametrize("closure", each_closure())
def test_grains_soft_on_stiff(closure: Closure) -> None:
    """The same with grains, kn 1e4 times as large above: both ends balance, the soft layer gives way."""
    law = make_law(
        closure, materials=[material(bulk_reduction=0.88, shear_reduction=0.69), material(normal_stiffness=1e13)]
    )
    if law is None:
        pytest.skip("refused by name")
    host = rectangle(1.0, 2.0, 2, 4)
    space = Space(host, "P2")
    index = (host.mesh.p[1, host.mesh.t].mean(axis=0) > 1.0).astype(np.int32)[space.point_cell]
    loads = [Fixed("bottom", ("y",)), Fixed("left", ("x",)), Fixed("right", ("x",)), Displacement("top", "y", -3e-5)]
    steps, summary = run(
        space, law, [Stage("press", loads, 3)], initial_stress=(-PRESSURE, -PRESSURE, 0.0), material_index=index,
        balance_initial_stress=True,
    )  # fmt: skip
    assert summary.finished, summary.message
    last = steps[-1]
    axial = last.stress[:, 1]
    assert np.ptp(axial) < 1e-5 * np.abs(axial).max() and axial.mean() < -1.01 * PRESSURE
    assert np.abs(last.strain[index == 1]).max() < 1e-3 * np.abs(last.strain[index == 0]).max()


def needle(element: str) -> HostMesh:
    """Sides of 1 to 10,000."""
    return rectangle(1e4, 1.0, 3, 3, cell_of(element))


def obtuse(element: str) -> HostMesh:
    """A square of four triangles whose middle node is pushed towards the lower side until its angle there is 170
    degrees; quadrilaterals with corners of 170 degrees."""
    if element.startswith("P"):
        low = 0.5 * np.tan(np.deg2rad(5.0))
        points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, low]], dtype=float)
        cells = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    else:
        # the middle node of four, moved along the diagonal: two of the cells have 170 degrees at it
        shift = 0.5 - 0.5 * np.tan(np.deg2rad(40.0 + 2.5))
        middle = 0.5 + shift
        points = np.array([[x, y] for y in (0, 0.5, 1) for x in (0, 0.5, 1)], dtype=float)
        points[4] = middle + 0.15, middle + 0.15
        cells = np.array([[0, 1, 4, 3], [1, 2, 5, 4], [3, 4, 7, 6], [4, 5, 8, 7]])
    corner = {tuple(point): k for k, point in enumerate(points.tolist())}
    sides = {}
    for name, (axis, value) in {"bottom": (1, 0.0), "right": (0, 1.0), "top": (1, 1.0), "left": (0, 0.0)}.items():
        on = sorted((k for p, k in corner.items() if p[axis] == value), key=lambda k: points[k, 1 - axis])
        sides[name] = np.array(list(itertools.pairwise(on)))
    return build_mesh(points, cells, sides, {"all": np.arange(len(cells))})


@pytest.mark.parametrize("shape", [needle, obtuse])
@pytest.mark.parametrize("element", ELEMENTS)
def test_needles_and_obtuse_angles(element: str, shape) -> None:
    """A linear displacement of the boundary strains every point the same: exact for any shape but for rounding, which
    ten thousand to one in length magnify by its square in the matrix."""
    gradient = np.array([[2e-4, -1e-4], [3e-4, 5e-4]])
    space = Space(shape(element), element)
    law = LinearElasticLaw(ElasticMaterial(1e3, 0.3))
    steps, summary = run(space, law, [Stage("strain", linear_boundary(gradient), 1)], StepControl(tolerance=1e-8))
    assert summary.finished, summary.message
    expected = np.array([gradient[0, 0], gradient[1, 1], gradient[0, 1] + gradient[1, 0]])
    assert steps[-1].strain == pytest.approx(np.tile(expected, (space.npoints, 1)), abs=1e-6 * 5e-4)


@pytest.mark.parametrize("element", ["P2", "Q2"])
@pytest.mark.parametrize("poisson", [0.3, 0.49, 0.4999])
def test_nearly_incompressible(element: str, poisson: float) -> None:
    """u = (y^2, x^2)/1000 does not change the volume; shear stress G (2x + 2y)/1000 and a body force of -2 G/1000 in
    both directions. Elements of second order hold it exactly: no locking. Rounding of the volume
    strain is multiplied by K/G = 5e3 at most.
    """
    law, shear = LinearElasticLaw(ElasticMaterial(1e3, poisson)), 1e3 / (2 * (1 + poisson))
    space = Space(rectangle(1.0, 1.0, 3, 3, cell_of(element)), element)
    loads: list = []
    for side in SIDES:
        loads += [
            Displacement(side, "x", lambda x, y: 1e-3 * y * y),
            Displacement(side, "y", lambda x, y: 1e-3 * x * x),
        ]
    loads.append(BodyForce((-2e-3 * shear, -2e-3 * shear)))
    steps, summary = run(space, law, [Stage("bend", loads, 1)], StepControl(tolerance=1e-11))
    assert summary.finished, summary.message
    x, y = space.nodes.T
    assert nodal(steps[-1]) == pytest.approx(1e-3 * np.stack([y * y, x * x], axis=1), abs=1e-3 * 1e-8)
    px, py = space.points.T
    assert steps[-1].stress[:, 2] == pytest.approx(shear * 2e-3 * (px + py), abs=1e-6 * shear * 1e-3)


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("closure", each_closure())
def test_a_single_element(element: str, closure: Closure) -> None:
    """One element (triangles: the two halves of one square) strained through its boundary is the point driver."""
    law = make_law(closure)
    if law is None:
        pytest.skip("refused by name")
    gradient = np.array([[1e-5, 2e-5], [1e-5, -4e-5]])
    strain = (1e-5, -4e-5, 3e-5)
    space = Space(rectangle(1.0, 1.0, 1, 1, cell_of(element)), element)
    steps, summary = run(
        space, law, [Stage("strain", linear_boundary(gradient), 2)], StepControl(tolerance=1e-12),
        initial_stress=(-PRESSURE, -PRESSURE, 0.0), balance_initial_stress=True,
    )  # fmt: skip
    assert summary.finished, summary.message
    history = drive(law, (-PRESSURE, -PRESSURE, 0.0), [Leg(("strain",) * 3, strain, 2)])
    # both integrate to the law's tolerance, 1e-6 a substep, and need less than ten
    assert steps[-1].stress == pytest.approx(np.tile(history.stress, (space.npoints, 1)), abs=2e-5 * PRESSURE)
    assert steps[-1].state == pytest.approx(np.tile(history.state, (space.npoints, 1)), abs=1e-4)
