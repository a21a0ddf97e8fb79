"""Sliding in a field: unsymmetric tangents, the point driver, a hand-written host, and a cavity with a closed form."""

from __future__ import annotations

import numpy as np
import pytest
from fem_meshes import distorted, run
from test_one_element_host import CORNERS, OneElement

from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Material
from granfabric.constitutive.path import Leg, drive
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.stepping import StepControl
from granfabric.fem.loads.kinds import Displacement, Fixed, FixedPoint, Pressure, Stage
from granfabric.fem.mesh.host_mesh import build_mesh, rectangle

PRESSURE = 1e5
PACKING = {
    "coordination": 4.06,
    "solid_fraction": 0.846,
    "normal_stiffness": 1e4 * PRESSURE,
    "bulk_reduction": 0.88,
    "shear_reduction": 0.69,
    "isostatic_coordination": 2.65,
    "peak_stress_ratio": 0.4,
}
LAW = ContactLaw(
    [Material(**PACKING)],
    Closure(force_change="shifted_distribution", shear_stiffness="isostatic"),
    Effects(sliding=True),
)
ISOTROPIC = (-PRESSURE, -PRESSURE, 0.0)


def test_smooth_platens_follow_the_point_driver_to_the_peak():
    """A homogeneous specimen between smooth platens at constant lateral stress, on distorted elements."""
    space = Space(distorted("P2", n=2), "P2")
    loads = [
        Fixed("bottom", ("y",)),
        Fixed("top", ("y",)),
        FixedPoint((0.0, 0.0)),
        Pressure("left", PRESSURE),
        Pressure("right", PRESSURE),
    ]
    # height 1: 0.05 % of axial strain
    stages = [Stage("initial", loads), Stage("compression", [Displacement("top", "y", -5e-4)], 10)]
    steps, summary = run(space, LAW, stages, StepControl(tolerance=1e-12), initial_stress=ISOTROPIC)
    assert summary.finished, summary.message
    history = drive(LAW, ISOTROPIC, [Leg(("stress", "strain", "stress"), (-PRESSURE, -5e-4, 0.0), 10)])
    last = steps[-1]
    # the host moves straight in strain within a step, the driver straight in lateral stress: a tenth of a per cent
    np.testing.assert_allclose(last.stress, np.tile(history.stress, (space.npoints, 1)), atol=1e-3 * PRESSURE)
    gamma = LAW.description.columns("plastic_shear_strain")
    np.testing.assert_allclose(last.state[:, gamma], history.state[0, gamma][0], rtol=2e-3)
    assert np.ptp(last.state[:, gamma]) < 1e-8 and history.state[0, gamma][0] > 5e-4


def test_both_hosts_agree():
    """Pressing, with a corner that may go sideways, and back, in the hand-written host and in the real one."""
    initial = np.array(ISOTROPIC)
    hand = OneElement(LAW, initial)
    space = Space(rectangle(1.0, 1.0, 1, 1, "quad"), "Q1")
    scale = 0.03
    press = [
        Fixed("bottom"),
        Displacement("top", "y", -0.006 * scale),
        Displacement("left", "x", lambda x, y: 0.004 * scale * y),
    ]
    stages = [Stage("press", press, 6), Stage("back", [Displacement("top", "y", 0.0)], 3)]
    steps, summary = run(
        space, LAW, stages, StepControl(tolerance=1e-13), initial_stress=initial, balance_initial_stress=True
    )
    assert summary.finished, summary.message
    order = np.array([np.argmin(np.sum((space.nodes - corner) ** 2, axis=1)) for corner in CORNERS])
    match = np.array([np.argmin(np.sum((hand.points - point) ** 2, axis=1)) for point in space.points])
    gamma = LAW.description.columns("plastic_shear_strain")
    for number, step in enumerate(steps):
        vertical = -0.006 * scale * ((number + 1) / 6 if number < 6 else (8 - number) / 3)
        sideways = 0.004 * scale * min((number + 1) / 6, 1.0)
        hand.step({0: 0.0, 1: 0.0, 2: 0.0, 3: 0.0, 5: vertical, 7: vertical, 6: sideways})
        u = step.displacement.reshape(-1, 2)[order].ravel()
        np.testing.assert_allclose(u, hand.u, rtol=0, atol=1e-10 * scale)
        np.testing.assert_allclose(step.stress, hand.stress[match], rtol=0, atol=1e-8 * PRESSURE)
        np.testing.assert_allclose(step.state, hand.state[match], rtol=1e-8, atol=1e-8)
    assert steps[5].state[:, gamma].min() > 2e-5


def test_newton_is_quadratic_across_the_cone():
    """Points that reach the cone within the step are differentiated across it; a first yield makes a front of them."""
    law = ContactLaw(
        [Material(**PACKING | {"first_yield_stress_ratio": 0.2, "hardening_exponent": 1.0})],
        Closure(),
        Effects(sliding=True),
    )
    space = Space(rectangle(1.0, 2.0, 6, 12), "P2")
    loads = [Fixed("bottom"), Fixed("top"), Pressure("left", PRESSURE), Pressure("right", PRESSURE)]
    stages = [Stage("initial", loads), Stage("compression", [Displacement("top", "y", -1.2e-4)], 1)]
    records, summary = run(space, law, stages, StepControl(tolerance=1e-10, forcing=1e-13), initial_stress=ISOTROPIC)
    assert summary.finished, summary.message
    gamma = records[-1].state[:, law.description.columns("plastic_shear_strain")]
    assert (gamma > 0.0).any() and (gamma == 0.0).any()
    older, old, new = records[1].residuals[:3]
    # in the basin, above rounding
    assert old < 1e-4 and new > 1e-13 and np.log(new / old) / np.log(old / older) > 1.8


def ring(n):
    """Quarter of a ring of inner radius 1 and outer radius 2, P2 triangles."""
    radius, angle = np.meshgrid(np.linspace(1.0, 2.0, n + 1), np.linspace(0, np.pi / 2, n + 1))
    points = np.stack([(radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()], axis=1)
    points[np.abs(points) < 1e-14] = 0.0
    node = np.arange(len(points)).reshape(n + 1, n + 1)
    a, b, c, d = (part.ravel() for part in (node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]))
    cells = np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)
    sides = {"inner": node[:, 0], "outer": node[:, -1], "below": node[0], "left": node[-1]}
    return build_mesh(points, cells, {name: np.stack([s[:-1], s[1:]], axis=1) for name, s in sides.items()})


def test_expanding_cavity():
    """Plastic zone around a cavity under growing pressure, elastic outside: stress is statically determinate.

    Compression positive, N = (1 - M)/(1 + M). Where grains slide s_theta = N s_r, so that s_r = P (r/a)^(N - 1);
    outside Lame, s = A +- B/r^2 with B = M A c^2 at the plastic radius c and A + B/b^2 the outer pressure.
    """
    peak, a, b, c = 0.3, 1.0, 2.0, 1.4
    law = ContactLaw(
        [
            Material(
                **PACKING
                | {
                    # hardens by 1e-4 over strains of 1e-8: as good as perfectly plastic
                    "peak_stress_ratio": peak,
                    "first_yield_stress_ratio": peak - 1e-4,
                    "reference_plastic_strain": 1e-8,
                    "hardening_exponent": 1.0,
                    "dilatancy": 0.5,
                }
            )
        ],
        None,
        Effects(contact_loss=False, contact_gain=False, sliding=True),
    )
    outer = PRESSURE / (1.0 + peak * c**2 / b**2)
    constant = (1.0 - peak) / (1.0 + peak)
    pressure = outer * (1.0 + peak) * (c / a) ** (1.0 - constant)
    space = Space(ring(8), "P2")
    supports = [Fixed("below", ("y",)), Fixed("left", ("x",)), Pressure("outer", PRESSURE)]
    stages = [
        Stage("initial", [*supports, Pressure("inner", PRESSURE)]),
        Stage("expansion", [Pressure("inner", pressure)], 6),
    ]
    steps, summary = run(space, law, stages, StepControl(tolerance=1e-9), initial_stress=ISOTROPIC)
    assert summary.finished, summary.message
    last = steps[-1]
    r = np.hypot(*space.points.T)
    p = -0.5 * (last.stress[:, 0] + last.stress[:, 1])
    q = np.hypot(0.5 * (last.stress[:, 0] - last.stress[:, 1]), last.stress[:, 2])
    sliding = last.state[:, law.description.columns("plastic_shear_strain")][:, 0] > 1e-9
    cell = 1.0 / 8
    # the front lies within an element of where it should
    assert sliding[r < c - cell].all() and not sliding[r > c + cell].any()
    radial = np.where(r < c, pressure * (r / a) ** (constant - 1.0), outer * (1.0 + peak * c**2 / r**2))
    hoop = np.where(r < c, constant * radial, outer * (1.0 - peak * c**2 / r**2))
    # straight sides of elements on the circle, a kink in the front: per cents at single points, less on average
    assert np.abs(p - 0.5 * (radial + hoop)).max() < 0.03 * PRESSURE
    assert np.abs(q - 0.5 * (radial - hoop)).max() < 0.03 * PRESSURE
    assert np.abs(p - 0.5 * (radial + hoop)).mean() < 0.005 * PRESSURE


@pytest.mark.slow
@pytest.mark.parametrize("element", ["P2", "Q2"])
def test_rough_platens_to_the_peak(element):
    """A non-uniform field to 0.15 % of strain: converges with the unsymmetric tangent, no point beyond the peak."""
    space = Space(rectangle(1.0, 2.0, 3, 6, "quad" if element == "Q2" else "triangle"), element)
    loads = [Fixed("bottom"), Fixed("top"), Pressure("left", PRESSURE), Pressure("right", PRESSURE)]
    stages = [Stage("initial", loads), Stage("compression", [Displacement("top", "y", -3e-3)], 10)]
    records, summary = run(space, LAW, stages, StepControl(tolerance=1e-8), initial_stress=ISOTROPIC)
    assert summary.finished, summary.message
    last = records[-1]
    p = -0.5 * (last.stress[:, 0] + last.stress[:, 1])
    q = np.hypot(0.5 * (last.stress[:, 0] - last.stress[:, 1]), last.stress[:, 2])
    assert (q / p).max() < 0.4 and (q / p).mean() > 0.3
    # rough ends raise the force over that of a free specimen at the peak, 1 + 2 M/(1 - M), but not by much
    force = -last.reactions["top"][1] / PRESSURE
    assert (1 + 0.4) / (1 - 0.4) * 0.9 < force < (1 + 0.4) / (1 - 0.4) * 1.2
    dissipation = law_column(last, "plastic_dissipation")
    assert (dissipation >= 0.0).all() and dissipation.max() > 0.0


def law_column(step, name):
    """One state column of all points."""
    return step.state[:, LAW.description.columns(name)][:, 0]
