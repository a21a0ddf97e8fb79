"""Small problems that tie, change and lead what a mesh holds, for both hosts."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "fem"))

from changing_meshes import column, plate_and_core
from fem_meshes import ELASTIC, PLASTIC, distorted

from granfabric import ContactLaw, Effects, Material
from granfabric.fem.discretisation.space import Space
from granfabric.fem.loads.kinds import (
    BodyForce,
    Fixed,
    LoadControl,
    Pressure,
    RigidBody,
    Spring,
    Stage,
    Traction,
)
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import HostMesh, rectangle
from granfabric.fem.mesh.shapes import quarter_ring

CONTACT = ContactLaw(
    [Material(coordination=z, solid_fraction=0.846, normal_stiffness=1e9) for z in (4.06, 3.9)],
    effects=Effects(stiffness_feedback=True),
)
LAWS = {"elastic": ELASTIC, "plastic": PLASTIC, "contact": CONTACT}
HOLD = [Fixed("bottom"), Fixed("left", ("x",)), Fixed("right", ("x",))]


def _stiffer(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 50.0 + 20.0 * np.asarray(x)


def _ground() -> HostMesh:
    host = rectangle(4.0, 2.0, 8, 4)
    return replace(host, boundaries={**host.boundaries, "footing": host.facets_between("top", (1.0, 2.0))})


def excavation(law: Any) -> Problem:
    """A core is taken out in two shares under a pressure, with a support that is released on the way."""
    _, host = plate_and_core(4)
    sides = [Fixed("bottom", ("y",)), Fixed("left", ("x",))]
    stages = [
        Stage("initial", [*sides, Pressure("right", 0.5), Pressure("top", 0.5)]),
        Stage("half", [], 2, deactivate=["core"], release=0.4),
        Stage("more", [Pressure("top", 0.7)], 2, release=0.7, reset_displacements=True),
        Stage("rest", [], 2),
    ]
    return Problem(Space(host, "P2"), law, stages, initial_stress=(-0.5, -0.5, 0.0))


def fill(law: Any) -> Problem:
    """A column grows by two layers that are placed under pressure, one of which goes again."""
    host = column(3, each=2, across=3)
    sides = [Fixed("bottom"), Fixed("left", ("x",)), Fixed("right", ("x",))]
    stages = [
        Stage("initial", [*sides, BodyForce((0.0, -0.2))]),
        Stage("first", [Pressure("top_2", 0.1)], 2, activate=["layer_2"], fill_pressure=0.05),
        Stage(
            "second", [Pressure("top_2", 0.0), Pressure("top", 0.1)], 2, activate=["layer_3"], reset_displacements=True
        ),
        Stage("off", [Pressure("top", 0.0), Pressure("top_2", 0.1)], 2, deactivate=["layer_3"]),
    ]
    return Problem(Space(host, "P2"), law, stages)


def springs(law: Any) -> Problem:
    """A bed of springs under load, another one beside it, then one of them goes; displacements counted anew."""
    sides = [Fixed("left", ("x",))]
    bed, wall = Spring("bottom", normal=_stiffer, tangential=10.0), Spring("right", normal=30.0)
    stages = [
        Stage("press", [*sides, bed, Pressure("top", 0.4)], 2),
        Stage("wall", [wall, Pressure("top", 0.6)], 2, reset_displacements=True),
        Stage("without", [*sides, bed, Pressure("top", 0.6)], 2, keep=False),
    ]
    return Problem(Space(distorted("Q2"), "Q2"), law, stages)


def rigid(law: Any) -> Problem:
    """A footing that is pushed out of its middle, then turned; a smooth platen beside it."""
    host = _ground()
    host = replace(host, boundaries={**host.boundaries, "edge": host.facets_between("top", (3.0, 4.0))})
    stages = [
        Stage("push", [*HOLD, RigidBody("footing", force=(0.1, -0.5), moment=0.05)], 2),
        Stage(
            "turn",
            [
                RigidBody("footing", displacement=(None, -2e-3), rotation=1e-3, amplitude="haversine"),
                RigidBody("edge", rough=False, displacement=(None, -1e-3)),
                Spring("right", normal=5.0),
            ],
            4,
        ),
        Stage("off", [*HOLD, RigidBody("edge", rough=False, force=(0.0, -0.1))], 2, keep=False),
    ]
    return Problem(Space(host, "P2"), law, stages)


def displaced(law: Any) -> Problem:
    """A footing all of whose motions are prescribed, so that nothing on its boundary is unknown."""
    body = RigidBody("footing", displacement=(5e-4, -1e-3), rotation=2e-4)
    stages = [Stage("move", [*HOLD, body], 2), Stage("on", [RigidBody("footing", displacement=(0.0, -1e-3))], 2)]
    return Problem(Space(_ground(), "P2"), law, stages)


def smooth(law: Any) -> Problem:
    """A smooth punch in a hole, whose nodes slide along a slant, each another one."""
    host = quarter_ring(1.0, 3.0, 4, 6, "quad")
    inner, outer = _of_ring(host)
    punch = RigidBody(inner, rough=False, displacement=(2e-3, None), point=(0.0, 0.0), rotation="fixed")
    stages = [Stage("press", [Fixed(outer), punch], 2)]
    return Problem(Space(host, "Q2"), law, stages)


def _of_ring(host: HostMesh) -> tuple[str, str]:
    """Names of its inner and its outer side."""
    points, found = host.mesh.p.T, {}
    for name, facets in host.boundaries.items():
        radius = np.hypot(*points[host.mesh.facets[:, facets].ravel()].T)
        if np.ptp(radius) < 1e-9:
            found["inner" if radius[0] < 2.0 else "outer"] = name
    return found["inner"], found["outer"]


def led(law: Any) -> Problem:
    """A node leads a pressure, then the rotation of a footing its moment; the next stage goes on from there."""
    stages = [
        Stage("node", [*HOLD, Pressure("top", 0.3)], 3, control=LoadControl(-1e-3, "y", point=(3.0, 2.0))),
        Stage(
            "turn",
            [RigidBody("footing", moment=0.01)],
            2,
            control=LoadControl(2e-4, "rotation", rigid="footing"),
        ),
        Stage("on", [Traction("top", (0.02, -0.1))], 2),
    ]
    return Problem(Space(_ground(), "P2"), law, stages)


def few_points(law: Any) -> Problem:
    """One integration point a cell: at corners the recovery takes cells from further away."""
    stages = [Stage("press", [*HOLD, Pressure("top", 0.5), Traction("top", (0.2, 0.0))], 2)]
    return Problem(Space(distorted("P1", 6), "P1"), law, stages)


def tiny(law: Any) -> Problem:
    """Two cells: of three ranks one has none."""
    body = RigidBody("top", force=(0.0, -0.3), rotation="fixed")
    stages = [Stage("push", [Fixed("bottom", ("y",)), Fixed("left", ("x",)), Spring("right", 1.0, 1.0), body], 2)]
    return Problem(Space(rectangle(1.0, 1.0, 1, 1), "P1"), law, stages)


def joint(law: Any) -> Problem:
    """Two materials side by side."""
    space = Space(rectangle(2.0, 1.0, 6, 4, "quad"), "Q1")
    index = (space.points[:, 0] > 1.0).astype(np.int32)
    sides = [Fixed("bottom", ("y",)), Fixed("left", ("x",)), Pressure("right", 1e5)]
    stages = [Stage("initial", [*sides, Pressure("top", 1e5)]), Stage("press", [*sides, Pressure("top", 1.2e5)], 3)]
    return Problem(space, law, stages, initial_stress=(-1e5, -1e5, 0.0), material_index=index)


PROBLEMS: dict[str, Callable[[Any], Problem]] = {
    made.__name__: made for made in (excavation, fill, springs, rigid, displaced, smooth, led, few_points, tiny, joint)
}
