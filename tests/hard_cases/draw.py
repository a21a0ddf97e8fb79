"""Pictures of the hard cases for docs/hard_cases.md: ``python tests/hard_cases/draw.py``."""

from __future__ import annotations

import sys
from pathlib import Path

HOME = Path(__file__).resolve().parent
sys.path[:0] = [str(HOME), str(HOME.parent / "fem"), str(HOME.parent.parent)]

import numpy as np  # noqa: E402
from fem_meshes import ELEMENTS, distorted, nodal, run  # noqa: E402
from hard_laws import PRESSURE, closures, follow, make_law, material, steps_to, stress_of  # noqa: E402
from test_fields import obtuse  # noqa: E402

from granfabric.cases.pictures.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, SKY, picture  # noqa: E402
from granfabric.constitutive.contract import Status  # noqa: E402
from granfabric.constitutive.parameters import Closure, Integration  # noqa: E402
from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw  # noqa: E402
from granfabric.fem.discretisation.space import Space  # noqa: E402
from granfabric.fem.loads.kinds import BodyForce, Displacement, Fixed, Stage  # noqa: E402
from granfabric.fem.mesh.host_mesh import rectangle  # noqa: E402

FIGURES = HOME.parent.parent / "docs" / "figures"
COLOURS = (BLUE, RED, GREEN, ORANGE, PURPLE, SKY, BLACK)
START = stress_of(PRESSURE)


def shown() -> dict[str, Closure]:
    """One closure for each force change, the others at their defaults."""
    found: dict[str, Closure] = {}
    for closure in closures():
        if closure.shear_stiffness == Closure().shear_stiffness:
            found.setdefault(closure.force_change, closure)
    return found


def lines(axes, title: str, xlabel: str, ylabel: str, curve) -> None:
    """One line a closure; a cross where it was refused."""
    for (name, closure), colour in zip(shown().items(), COLOURS, strict=False):
        x, y, status = curve(make_law(closure, Integration(tolerance=1e-6, maximum_substeps=3000)))
        good = status <= Status.LIMITED
        axes.plot(x[good], y[good], color=colour, label=name)
        if not good.all():
            axes.plot(x[good][-1], y[good][-1], "x", color=colour, markersize=9)
    axes.set(title=title, xlabel=xlabel, ylabel=ylabel)


def unloading(law):
    p = PRESSURE * np.logspace(0, -6, 61)[1:]
    trail = follow(law, START[None], steps_to(stress_of(p)[:, None], START))
    return trail.pressure[:, 0] / PRESSURE, trail.get("coordination")[:, 0], trail.status[:, 0]


def cycles(law):
    way = steps_to(np.array([stress_of(PRESSURE, 0.05), START])[:, None], START)
    trail = follow(law, START[None], np.tile(way, (60, 1, 1)), every=2)
    return np.arange(61.0), trail.get("coordination")[:, 0], trail.status[:, 0]


def rotation(law):
    angle = np.linspace(0, 4 * np.pi, 73)
    start = stress_of(PRESSURE, 0.15)
    ends = stress_of(PRESSURE, 0.15 * np.cos(angle[1:]), 0.15 * np.sin(angle[1:]))
    trail = follow(law, start[None], steps_to(ends[:, None], start))
    return np.rad2deg(angle) / 2, trail.get("coordination")[:, 0], trail.status[:, 0]


def beyond_one(law):
    ratio = np.linspace(0, 1.5, 31)
    trail = follow(law, START[None], steps_to(stress_of(PRESSURE, ratio[1:])[:, None], START))
    return ratio, trail.get("coordination")[:, 0], trail.status[:, 0]


def reversals(law):
    sizes = 10.0 ** -np.arange(1.0, 13.0)
    there = stress_of(PRESSURE, sizes)[None]
    trail = follow(law, START[None], steps_to(np.concatenate([there, np.broadcast_to(START, there.shape)]), START))
    return sizes, np.abs(trail.get("coordination")[-1] / 4.06 - 1) + 1e-17, trail.status[-1]


def extension(law):
    bulk = 4.06 * 0.846 * 1e9 / (2 * np.pi)
    volume = 2 * PRESSURE / bulk * np.linspace(0, 1.2, 61)
    step = np.diff(np.stack([volume / 2, volume / 2, 0 * volume], axis=1), axis=0)
    trail = follow(law, START[None], step[:, None], (0, 0, 0))
    return volume * 1e6, trail.pressure[:, 0] / PRESSURE, trail.status[:, 0]


def law_picture() -> None:
    """Six panels: what each closure does."""
    with picture(FIGURES / "hard_cases_law.png", 13.0, 7.6) as figure:
        a, b, c, d, e, f = figure.subplots(2, 3).ravel()
        lines(a, "(a) pressure to a millionth", "$p/p_0$ [-]", "coordination number $z$ [-]", unloading)
        a.set(xscale="log", yscale="log")
        a.invert_xaxis()
        p = np.logspace(0, -6, 13)
        a.plot(p, 4.06 * p**0.5, "o", color=BLACK, markersize=3, label="$z_0 (p/p_0)^{P_0}$")
        lines(b, "(b) extension to zero pressure", "volume strain [$10^{-6}$]", "$p/p_0$ [-]", extension)
        lines(c, "(c) cycles of $q/p$ between 0 and 0.05", "cycle", "coordination number $z$ [-]", cycles)
        c.set(yscale="log")
        lines(d, "(d) axes turned through 360 degrees", "turn [degrees]", "coordination number $z$ [-]", rotation)
        lines(e, "(e) stress ratio beyond one", "$q/p$ [-]", "coordination number $z$ [-]", beyond_one)
        lines(f, "(f) one reversal of size $s$", "$s$ [-]", "|change of $z$|/$z$ [-]", reversals)
        f.set(xscale="log", yscale="log")
        for axes in (a, b, c, d, e, f):
            axes.legend(fontsize=8)


def locking(element: str, ratios: np.ndarray) -> np.ndarray:
    """Error of displacements of a field without change of volume, relative to the largest displacement."""
    errors = []
    for poisson in ratios:
        shear = 1e3 / (2 * (1 + poisson))
        space = Space(distorted(element, 8), element)
        loads: list = [BodyForce((-2e-3 * shear, -2e-3 * shear))]
        for side in ("bottom", "right", "top", "left"):
            loads += [
                Displacement(side, "x", lambda x, y: 1e-3 * y * y),
                Displacement(side, "y", lambda x, y: 1e-3 * x * x),
            ]
        steps, _ = run(space, LinearElasticLaw(ElasticMaterial(1e3, float(poisson))), [Stage("bend", loads, 1)])
        x, y = space.nodes.T
        off = nodal(steps[-1]) - 1e-3 * np.stack([y * y, x * x], axis=1)
        errors.append(np.abs(off).max() / 1e-3 + 1e-17)
    return np.array(errors)


def field_picture() -> None:
    """Soft on stiff, an obtuse mesh, locking."""
    with picture(FIGURES / "hard_cases_fields.png", 13.0, 4.2) as figure:
        left, middle, right = figure.subplots(1, 3)
        law = make_law(
            Closure(),
            None,
            None,
            [material(bulk_reduction=0.88, shear_reduction=0.69), material(normal_stiffness=1e13)],
        )
        host = rectangle(1.0, 2.0, 2, 8)
        space = Space(host, "P2")
        index = (host.mesh.p[1, host.mesh.t].mean(axis=0) > 1.0).astype(np.int32)[space.point_cell]
        loads = [
            Fixed("bottom", ("y",)),
            Fixed("left", ("x",)),
            Fixed("right", ("x",)),
            Displacement("top", "y", -3e-5),
        ]
        steps, _ = run(space, law, [Stage("press", loads, 3)], initial_stress=(-PRESSURE, -PRESSURE, 0.0),
                       material_index=index, balance_initial_stress=True)  # fmt: skip
        height, last = space.points[:, 1], steps[-1]
        left.plot(-last.stress[:, 1] / PRESSURE, height, ".", color=BLUE, label=r"$-\sigma_{yy}/p_0$")
        left.plot(-last.strain[:, 1] * 1e5, height, ".", color=RED, label=r"$-\varepsilon_{yy}$ [$10^{-5}$]")
        left.set(
            title="(a) grains 10,000 times as stiff above",
            xlabel="stress, strain in the units named",
            ylabel="height [m]",
        )
        left.legend(fontsize=8)
        for shift, element in ((0.0, "P1"), (1.2, "Q1")):
            mesh = obtuse(element).mesh
            for cell in mesh.t.T:
                ring = mesh.p[:, [*cell, cell[0]]]
                middle.plot(ring[0] + shift, ring[1], color=BLACK, linewidth=1)
        middle.set(title="(b) angles of 170 degrees: exact all the same", aspect="equal", xticks=[], yticks=[])
        middle.grid(False)
        ratios = np.array([0.3, 0.4, 0.45, 0.49, 0.499, 0.4999])
        for element, colour in zip(ELEMENTS, COLOURS, strict=False):
            right.loglog(0.5 - ratios, locking(element, ratios), "o-", color=colour, label=element, markersize=3)
        right.set(title="(c) nearly incompressible", xlabel=r"$1/2 - \nu$ [-]", ylabel="error of displacements [-]")
        right.invert_xaxis()
        right.legend(fontsize=8)


if __name__ == "__main__":
    law_picture()
    field_picture()
