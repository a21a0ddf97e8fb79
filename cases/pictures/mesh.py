"""Picture of a mesh: its cells, its boundaries and regions with their names, and places where it is wrong."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from granfabric.cases.field.mesh_table import row
from granfabric.fem.mesh.host_mesh import HostMesh
from granfabric.fem.mesh.summary import Group

from .style import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, SKY, picture

Array = NDArray[np.float64]

LINES = (BLUE, ORANGE, GREEN, PURPLE, RED, SKY)
FILLS = ("#f3e3c3", "#d7e6d5", "#d9e2ef", "#efd9e2", "#e8e8d0", "#dcd6ea", "#d3ebea", "#eed8c8")
STYLES = ("solid", (0, (4, 1.5)), (0, (1.5, 1)))
EDGES_UP_TO = 60_000
"""Cells beyond which their edges would only blacken the picture."""
LISTED = 24
"""Groups that the list beside the picture has room for."""
ROOM = 0.12
"""Distance of names, relative to the size of the mesh."""
CHOICES = 9
"""Places that are tried for a name."""
ALONG_A_CURVE = 7
"""Points of the line that shows a curved side."""


@dataclass(frozen=True)
class Shown:
    """How a group is shown: colour, style of line, place of its name [m] and the way from there out of the body."""

    group: Group
    colour: str
    style: Any
    place: Array
    outward: Array


def side_lines(host: HostMesh, facets: NDArray[np.int64]) -> Array:
    """Points along sides [m], shape (n, npoints, 2)."""
    mesh = host.mesh
    start, end = mesh.p.T[mesh.facets[0, facets]], mesh.p.T[mesh.facets[1, facets]]
    if host.curved is None:
        return np.stack([start, end], axis=1)
    middle = host.curved.p.T[mesh.p.shape[1] + facets]
    s = np.linspace(-1.0, 1.0, ALONG_A_CURVE)[None, :, None]
    first, second, third = s * (s - 1) / 2, 1 - s**2, s * (s + 1) / 2
    return start[:, None] * first + middle[:, None] * second + end[:, None] * third


def shown_groups(host: HostMesh, groups: list[Group]) -> list[Shown]:
    """Colour and place of the name of each named group; names keep away from each other where they can."""
    shown: list[Shown] = []
    number = {"boundary": 0, "region": 0}
    room = ROOM * float(np.ptp(host.mesh.p, axis=1).max())
    taken: list[Array] = []
    for group in groups:
        if not group.name:
            continue
        n = number[group.kind]
        number[group.kind] += 1
        of_line = group.kind == "boundary"
        places, outward = _along(host, group.index) if of_line else _within(host, group.index)
        free = [min([float(np.linalg.norm(place - other)) for other in taken], default=np.inf) for place in places]
        best = next((k for k, distance in enumerate(free) if distance > room), int(np.argmax(free)))
        taken.append(places[best])
        colour = LINES[n % len(LINES)] if of_line else FILLS[n % len(FILLS)]
        style = STYLES[n // len(LINES) % len(STYLES)] if of_line else "solid"
        shown.append(Shown(group, colour, style, places[best], outward[best]))
    return shown


def _along(host: HostMesh, facets: NDArray[np.int64]) -> tuple[Array, Array]:
    """Places on a boundary for its name, the best first, and the ways out of the body there."""
    lines = side_lines(host, facets)
    middles = lines[:, lines.shape[1] // 2] if host.curved is not None else lines.mean(axis=1)
    order = np.linalg.norm(middles - middles.mean(axis=0), axis=1).argsort(kind="stable")
    chosen = order[np.unique(np.linspace(0, len(order) - 1, CHOICES).astype(np.int64))]
    centres = host.mesh.p.T[host.mesh.t[:, host.mesh.f2t[0, facets[chosen]]]].mean(axis=0)
    along = lines[chosen, -1] - lines[chosen, 0]
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    normal /= np.maximum(np.linalg.norm(along, axis=1), np.finfo(float).tiny)[:, None]
    inwards = np.einsum("ni,ni->n", normal, middles[chosen] - centres) < 0
    return middles[chosen], np.where(inwards[:, None], -normal, normal)


def _within(host: HostMesh, cells: NDArray[np.int64]) -> tuple[Array, Array]:
    """Places in a region for its name, deep inside first."""
    mesh = host.mesh
    centres = mesh.p.T[mesh.t[:, cells]].mean(axis=0)
    times = np.bincount(mesh.t2f[:, cells].ravel(), minlength=mesh.facets.shape[1])
    border = mesh.p[:, mesh.facets[:, times == 1]].mean(axis=1).T
    order = (-cKDTree(border).query(centres)[0]).argsort(kind="stable")
    chosen = order[np.unique(np.linspace(0, max(len(order) // 2 - 1, 0), CHOICES).astype(np.int64))]
    return centres[chosen], np.zeros((len(chosen), 2))


def draw_mesh(path: Path, host: HostMesh, groups: list[Group], title: str, wrong: Array | None = None) -> None:
    """Draw a mesh with its groups.

    Parameters
    ----------
    path : Path
        PNG file.
    host : HostMesh
    groups : list of Group
    title : str
    wrong : ndarray, shape (n, 2), optional
        Places that are marked [m].
    """
    size = np.ptp(host.mesh.p, axis=1)
    height = float(np.clip(7.5 * size[1] / max(size[0], 1e-300), 3.2, 9.0))
    width = float(np.clip(height * size[0] / max(size[1], 1e-300), 3.0, 9.0)) + 4.2
    shown = shown_groups(host, groups)
    with picture(path, width, height + 0.6) as figure:
        axes = figure.add_subplot()
        _cells(axes, host, shown)
        handles = _boundaries(axes, host, groups, shown)
        for one in shown:
            _name(axes, one)
        if wrong is not None and len(wrong):
            axes.plot(*wrong.T, "o", ms=11, mfc="none", mec=RED, mew=2.2, zorder=9)
            axes.plot(*wrong.T, "x", ms=5, color=RED, mew=1.4, zorder=9)
            handles.insert(0, Line2D([], [], marker="o", ls="none", mfc="none", mec=RED, mew=2.2, label="refused here"))
        axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
        axes.set_title(title, parse_math=False)
        axes.grid(False)
        axes.margins(0.14)
        legend = figure.legend(handles=handles[:LISTED], loc="outside right upper", fontsize=8.5, handlelength=2.2)
        for text in legend.get_texts():
            text.set_parse_math(False)


def _cells(axes: Any, host: HostMesh, shown: list[Shown]) -> None:
    colours = np.full(host.mesh.t.shape[1], "#f6f6f6", dtype="U7")
    for one in reversed(shown):  # of several regions the first shows
        if one.group.kind == "region":
            colours[one.group.index] = one.colour
    edges = len(colours) <= EDGES_UP_TO
    width = 0.5 if len(colours) < 2000 else 0.25
    corners = host.mesh.p.T[host.mesh.t.T]
    axes.add_collection(
        PolyCollection(
            corners, facecolors=colours, edgecolors="#9a9a9a" if edges else "face", linewidths=width, rasterized=True
        )
    )


def _boundaries(axes: Any, host: HostMesh, groups: list[Group], shown: list[Shown]) -> list[Any]:
    """Draw the boundaries, long ones below and wider than short ones, and list all groups."""
    outline = np.flatnonzero(host.mesh.f2t[1] < 0)
    dotted = LineCollection(list(side_lines(host, outline)), colors=BLACK, linewidths=1.0, linestyles="dotted")
    axes.add_collection(dotted)
    curves = sorted((one for one in shown if one.group.kind == "boundary"), key=lambda one: -one.group.size)
    width = {id(one): 5.0 - 2.8 * rank / max(len(curves) - 1, 1) for rank, one in enumerate(curves)}
    for one in curves:
        lines = list(side_lines(host, one.group.index))
        axes.add_collection(
            LineCollection(
                lines, colors=one.colour, linewidths=width[id(one)], linestyles=[one.style], capstyle="butt", zorder=4
            )
        )
    axes.autoscale_view()
    handles: list[Any] = []
    for one in shown:
        name, _, count, size = row(one.group)
        label = f"{name}: {count}, {size}"
        if one.group.kind == "boundary":
            handles.append(Line2D([], [], color=one.colour, ls=one.style, lw=width[id(one)], label=label))
        else:
            handles.append(Patch(facecolor=one.colour, edgecolor="#9a9a9a", label=label))
    for group in groups:
        if not group.name:
            name, _, count, size = row(group)
            look: dict[str, Any] = {"color": BLACK, "ls": "dotted", "lw": 1.0}
            label = f"{name}: {count}, {size}"
            handles.append(
                Line2D([], [], label=label, **look)
                if group.kind == "boundary"
                else Patch(facecolor="#f6f6f6", edgecolor="#9a9a9a", label=label)
            )
    return handles


def _name(axes: Any, one: Shown) -> None:
    boundary = one.group.kind == "boundary"
    axes.annotate(
        one.group.name if len(one.group.name) <= 30 else f"{one.group.name[:27]}...",
        one.place,
        xytext=15 * one.outward,
        textcoords="offset points",
        ha="center" if abs(one.outward[0]) < 0.7 else ("left" if one.outward[0] > 0 else "right"),
        va="center" if abs(one.outward[1]) < 0.7 else ("bottom" if one.outward[1] > 0 else "top"),
        fontsize=9.5,
        fontstyle="normal" if boundary else "italic",
        color=one.colour if boundary else BLACK,
        fontweight="bold" if boundary else "normal",
        bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8},
        zorder=8,
        parse_math=False,
    )
