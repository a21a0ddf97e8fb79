"""Study: the harmonic distribution of contacts over directions against the maximum-entropy one, over anisotropy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.pictures.style import picture
from granfabric.cases.terminal.clock import best_of
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Distribution, Integration, Integrator

from .batch import PATH_STRAIN, SEED, Batch, End, distance, follow, initial_state, law_of, make_batch
from .draw import FRONT, LOOKS, log_axes, panel
from .front import cheapest, mark_fronts
from .study import COMMON_COLUMNS, Column, Effort, Row, Study

INTEGRATOR: Integrator = "bogacki_shampine"
SUBSTEPS = 16
"""Fixed, so that every setting takes the same substeps and only the integrals differ."""
MAGNITUDES, QUICK_MAGNITUDES = (0.0, 0.3, 0.6, 0.9, 1.2), (0.3, 0.9)
"""|a_c| at the start of the paths; the harmonic density is negative somewhere beyond 1, and is clipped there."""
DIRECTIONS, QUICK_DIRECTIONS = (4, 8, 16, 32, 64), (8, 16)
REFERENCE_DIRECTIONS = 256
ROUNDING = 1e-14
SHOWN = (0.3, 0.9)
"""Magnitudes that have panels of their own."""
DISTRIBUTIONS: tuple[Distribution, ...] = ("harmonic", "maximum_entropy")
CLOSED, GAUSS, ENTROPY = "harmonic, closed form", "harmonic, Gauss points", "maximum entropy, Gauss points"


def batch_at(points: int, magnitude: float) -> Batch:
    """The paths of the other studies from a fabric of that magnitude, its axes in random directions."""
    batch = make_batch(points)
    angle = np.random.default_rng(SEED).uniform(0.0, 2.0 * np.pi, points)
    return replace(batch, fabric=magnitude * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def start_of(law: ContactLaw, batch: Batch) -> NDArray[np.float64]:
    """State at the start of the paths, with the batch's fabric also where no packing could begin with it.

    Loading takes a fabric beyond the limit of its distribution; there a_t closes the stress-force-fabric relation.
    """
    magnitude = np.linalg.norm(batch.fabric, axis=1, keepdims=True)
    within = batch.fabric * np.minimum(1.0, 0.9 / np.maximum(magnitude, 1e-300))
    state = initial_state(law, replace(batch, fabric=within))
    state[:, law.description.columns("fabric_anisotropy")] += batch.fabric - within
    state[:, law.description.columns("tangential_force_anisotropy")] -= batch.fabric - within
    return state


def _integration(directions: int) -> Integration:
    if directions == 0:
        return Integration(integrator=INTEGRATOR, substeps=SUBSTEPS)
    return Integration(integrator=INTEGRATOR, substeps=SUBSTEPS, arc_integration="gauss", directions=directions)


def _facet(magnitude: float) -> str:
    return f"|a_c| = {magnitude:g}"


def rows(effort: Effort) -> list[Row]:
    """Both distributions from all magnitudes with all numbers of directions; see `Study.rows`."""
    points = 16 if effort.quick else 64
    magnitudes, directions = (
        (QUICK_MAGNITUDES, QUICK_DIRECTIONS) if effort.quick else (MAGNITUDES, DIRECTIONS)
    )
    plan = [
        (magnitude, name, number)
        for magnitude in magnitudes
        for name in DISTRIBUTIONS
        for number in ((0,) if name == "harmonic" else ()) + directions
    ]
    total = len(plan) * (effort.rounds + 1)
    batches = {magnitude: batch_at(points, magnitude) for magnitude in magnitudes}

    def path(magnitude: float, name: Distribution, number: int) -> Callable[[], End]:
        law = law_of(_integration(number), Closure(distribution=name))
        return partial(follow, law, batches[magnitude], start_of(law, batches[magnitude]), 1)

    references = {
        (magnitude, name): path(magnitude, name, REFERENCE_DIRECTIONS)()
        for magnitude in magnitudes
        for name in DISTRIBUTIONS
    }
    calls = [path(*setting) for setting in plan]
    table: list[Row] = []
    for place, ((magnitude, name, number), call) in enumerate(zip(plan, calls)):
        effort.advance(place, total, f"{name}, |a_c| = {magnitude:g}, {number or 'no'} directions")
        end = call()
        # the closed form is exact where there is one; quadrature is measured against many more directions
        apart = distance(references[magnitude, "harmonic"], references[magnitude, "maximum_entropy"])
        errors = np.maximum(distance(end, references[magnitude, name]), ROUNDING)
        table.append(
            {
                "facet": _facet(magnitude),
                "series": ENTROPY if name == "maximum_entropy" else GAUSS if number else CLOSED,
                "setting": f"{number} directions" if number else "closed form",
                "error": float(errors.max()) if not end.failed else float("nan"),
                "seconds": 0.0,
                "count": end.evaluations / points * max(1, 2 * number),
                "fabric": magnitude,
                "distribution": name,
                "directions": number,
                "error_median": float(np.median(errors)),
                "difference": float(apart.max()),
                "difference_median": float(np.median(apart)),
                "failed_points": end.failed,
            }
        )
    times = best_of(calls, effort.rounds, lambda done: effort.advance(len(plan) + done, total, "timing"))
    for row, seconds in zip(table, times):
        row["seconds"] = seconds / points
    mark_fronts(table)
    return table


def draw(path: Path, table: Sequence[Row]) -> None:
    """Work-precision panels at two magnitudes; below, difference of the distributions and time over the magnitude."""
    looks = dict(zip((CLOSED, GAUSS, ENTROPY), LOOKS[1:4]))
    with picture(path, 11.0, 8.6) as figure:
        grid = figure.subplots(2, 2)
        handles: dict[str, Any] = {}
        for axes, magnitude, letter in zip(grid[0], SHOWN, "ab"):
            members = [row for row in table if row["fabric"] == magnitude]
            handles |= panel(axes, members, "seconds", "on_front", looks)
            axes.set(
                title=f"({letter}) error of the integrals, $|a_c| = {magnitude:g}$",
                xlabel="processor time per point and path [s]",
                ylabel="largest error of $\\sigma/p$, $z$, $a_c$ [-]",
            )
            log_axes(axes)
        _over_magnitude(grid[1, 0], table)
        for name, (colour, marker) in looks.items():
            line = _line(table, name)
            grid[1, 1].plot(
                [row["fabric"] for row in line],
                [1e6 * row["seconds"] for row in line],
                color=colour,
                marker=marker,
                markerfacecolor="white",
            )
        most = max(row["directions"] for row in table)
        grid[1, 1].set(
            title=f"(d) time, quadrature with {min(32, most)} directions",
            xlabel="$|a_c|$ at the start [-]",
            ylabel="processor time per point and path [µs]",
            yscale="log",
        )
        order = [name for name in (CLOSED, GAUSS, ENTROPY, FRONT) if name in handles]
        figure.legend([handles[name] for name in order], order, loc="outside lower center", ncols=4, fontsize=9)
        figure.suptitle("Distribution of contacts over directions, strain path of $10^{-4}$", x=0.01, ha="left",
                        fontsize=13)  # fmt: skip


def _line(table: Sequence[Row], series: str) -> list[Row]:
    """One row a magnitude: the closed form, or 32 directions (the most there are below)."""
    most = min(32, max(row["directions"] for row in table))
    return [row for row in table if row["series"] == series and row["directions"] in (0, most)]


def _over_magnitude(axes: Any, table: Sequence[Row]) -> None:
    line = _line(table, ENTROPY)
    at = [row["fabric"] for row in line]
    axes.plot(at, [row["difference"] for row in line], color="black", marker="o", label="difference, largest")
    axes.plot(at, [row["difference_median"] for row in line], color="black", marker="o", markerfacecolor="white",
              linestyle="--", label="difference, median")  # fmt: skip
    for number, style in ((8, ":"), (16, "-.")):
        found = [row for row in table if row["series"] == ENTROPY and row["directions"] == number]
        axes.plot([row["fabric"] for row in found], [row["error"] for row in found], color=LOOKS[3][0], linestyle=style,
                  label=f"error of {number} directions")  # fmt: skip
    axes.set(
        title="(c) harmonic against maximum entropy",
        xlabel="$|a_c|$ at the start [-]",
        ylabel="$\\sigma/p$, $z$, $a_c$ at the end [-]",
        yscale="log",
    )
    axes.legend(fontsize=8, loc="center right")


def findings(table: Sequence[Row]) -> list[str]:
    """What the numbers say."""
    said = []
    for magnitude in dict.fromkeys(row["fabric"] for row in table):
        members = [row for row in table if row["fabric"] == magnitude]
        entropy = [row for row in members if row["distribution"] == "maximum_entropy"]
        enough = cheapest(entropy, 1e-6)
        text = (
            f"|a_c| = {magnitude:g}: at the end of the paths the distributions differ by up to "
            f"{members[0]['difference']:.2g} (median {members[0]['difference_median']:.2g})"
        )
        closed = next((row for row in members if row["directions"] == 0), None)
        if enough is not None and closed is not None:
            text += (
                f"; maximum entropy is within 1e-6 of its own limit with {enough['directions']} directions, at "
                f"{enough['seconds'] / closed['seconds']:.3g} times the time of the harmonic closed form"
            )
        said.append(text + ".")
    refused = [row for row in table if row["failed_points"]]
    if refused:
        said.append(f"Points were refused in {len(refused)} settings: {refused[0]['facet']} and others.")
    return said


STUDY = Study(
    name="distributions",
    title="Harmonic against maximum-entropy distribution",
    question="How far apart are the two distributions over directions, and what does the positive one cost?",
    knobs=(
        (
            "distribution",
            "harmonic by closed form (beyond |a_c| = 1 clipped, by Gauss points) or Gauss points; maximum entropy by "
            "Gauss points",
        ),
        ("directions", ", ".join(str(number) for number in DIRECTIONS) + " on each arc"),
        ("fabric at the start", ", ".join(f"{magnitude:g}" for magnitude in MAGNITUDES) + ", axes at random"),
        ("path", f"strain of {PATH_STRAIN:g} in one increment, {SUBSTEPS} fixed Bogacki-Shampine substeps"),
        ("points", "64, paths as for the integrators"),
        ("reference", f"the same distribution with {REFERENCE_DIRECTIONS} directions"),
        ("error", "largest over all points of stress over p, z relative, a_c; the difference likewise"),
    ),
    columns=(
        *COMMON_COLUMNS,
        Column("fabric", "|a_c| at the start"),
        Column("distribution", "name in a scene"),
        Column("directions", "on each arc, 0 for the closed form"),
        Column("error_median", "median error of the points"),
        Column("difference", "largest difference between the references of both distributions: of the model"),
        Column("difference_median", "median of the same"),
        Column("failed_points", "points that the law refused"),
    ),
    rows=rows,
    draw=draw,
    findings=findings,
)
