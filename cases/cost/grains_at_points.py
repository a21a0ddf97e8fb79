"""Study: grains at integration points, what decides their error and their time."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.grains.drive import Pace
from granfabric.cases.grains.law import MEASURES, GrainsLaw
from granfabric.cases.grains.store import PackingStore
from granfabric.cases.grains.tangents import IsotropicTangent, PerturbedTangent
from granfabric.cases.pictures.style import BLACK, BLUE, GREEN, ORANGE, picture
from granfabric.dem_ref.dynamics.packing import PackingOptions
from granfabric.dem_ref.measures.contacts import love_weber_stress
from granfabric.dem_ref.sample.disks import Sample
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.control import StepControl
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.loads.kinds import Displacement, Fixed, Pressure, Stage
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import rectangle

from .front import mark_fronts
from .study import COMMON_COLUMNS, Column, Effort, Row, Study

Array = NDArray[np.float64]

PRESSURE = 1e5
PATH = np.array([3e-5, -1e-4, 0.0])
"""Strain to which points are driven; q/p is a quarter there."""
CALLS = 10
DISKS, QUICK_DISKS = 400, 60
PACKINGS, QUICK_PACKINGS = 4, 2
FINE = Pace(strain_step=2e-9, rest=1e-7, longest_rest=2_000_000)
STRAIN_STEPS = (5e-9, 2e-8, 1e-7, 5e-7, 1e-5)
RESTS = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3)
INCREMENTS = (1, 2, 5, 10, 50)
SIZES, QUICK_SIZES = (100, 200, 400, 1000, 2000), (60, 120)
SEEDS, QUICK_SEEDS = 12, 3
FIELD_DISKS = 200
TOLERANCE, FINE_TOLERANCE = 1e-4, 1e-5
MOST_ITERATIONS = 60
"""So many that no tangent makes a step fail: what is compared is the way."""

FACETS = {
    "pace": "stress at the end of a path against a ten times slower one",
    "disks": "scatter of one packing",
    "tangents": "biaxial test, whole run",
}


def _driven(samples: Sequence[Sample], pace: Pace, calls: int) -> tuple[Array, Array, float, int]:
    """Stress and measures at the end of the path, processor time and steps a packing."""
    law = GrainsLaw(samples, pace, threads=1)
    stress = np.array([love_weber_stress(sample) for sample in samples])
    state = law.initial_state(stress)
    since = time.process_time()
    for _ in range(calls):
        stress_end, state_end = np.empty_like(stress), np.empty_like(state)
        report = law.update(np.tile(PATH / calls, (len(samples), 1)), stress, state, stress_end, state_end)
        if report.failed:
            raise RuntimeError(report.message)
        stress, state = stress_end, state_end
    seconds = time.process_time() - since
    return stress, state[:, :MEASURES], seconds / len(samples), law.work.steps // len(samples)


def _pace(samples: Sequence[Sample], tell: Any) -> list[Row]:
    tell("reference")
    reference = _driven(samples, FINE, CALLS)[0]
    base = Pace()
    settings: list[tuple[str, float, Pace, int]] = [
        *(("strain step", step, replace(base, strain_step=step), CALLS) for step in STRAIN_STEPS),
        *(("rest tolerance", rest, replace(base, rest=rest), CALLS) for rest in RESTS),
        *(("increments", calls, base, calls) for calls in INCREMENTS),
    ]
    table = []
    for series, setting, pace, calls in settings:
        tell(f"{series} {setting:g}")
        stress, _, seconds, steps = _driven(samples, pace, calls)
        table.append(
            _row("pace", series, setting, float(np.abs(stress - reference).max()) / PRESSURE, seconds, steps)
        )
    return table


def _sizes(sizes: Sequence[int], seeds: int, store: Path, tell: Any) -> list[Row]:
    """Scatter from packing to packing; of its mean over many points that much over the root of their number is left."""
    table = []
    for disks in sizes:
        tell(f"{disks} disks")
        kept = PackingStore(disks, PackingOptions(), store)
        samples = [kept.at_rest(seed) for seed in range(1, seeds + 1)]
        stress, measures, seconds, steps = _driven(samples, Pace(), CALLS)
        ratio = np.hypot(0.5 * (stress[:, 0] - stress[:, 1]), stress[:, 2]) / (-0.5 * stress[:, :2].sum(axis=1))
        fabric = np.hypot(measures[:, 1], measures[:, 2])
        values = {"ratio": ratio, "coordination": measures[:, 0], "fabric": fabric}
        row = _row("disks", "disks", disks, float(ratio.std(ddof=1)), seconds, steps)
        for name, value in values.items():
            row[f"mean_{name}"], row[f"scatter_{name}"] = float(value.mean()), float(value.std(ddof=1))
        table.append(row)
    return table


def _field(samples: Sequence[Sample], quick: bool) -> Any:
    space = Space(rectangle(0.05, 0.1, 1 if quick else 2, 2 if quick else 4), "P1" if quick else "P2")
    increments = 1 if quick else 6
    ends, sides = [Fixed("bottom"), Fixed("top", ("x",))], [Pressure("left", PRESSURE), Pressure("right", PRESSURE)]
    stages = [
        Stage("initial", [*ends, Fixed("top", ("y",)), *sides]),
        Stage("compression", [*ends, *sides, Displacement("top", "y", -2e-6 * increments)], increments=increments),
    ]

    def run(law: GrainsLaw, tolerance: float) -> tuple[float, float, dict[str, int], int]:
        problem = Problem(space, law, stages, initial_stress=(-PRESSURE, -PRESSURE, 0.0))
        control = StepControl(
            tolerance=tolerance,
            maximum_iterations=MOST_ITERATIONS,
            easy_iterations=MOST_ITERATIONS,
            smallest_factor=0.1,
        )
        steps: list[StepResult] = []
        since = time.process_time()
        summary = solve(problem, control, on_step=steps.append)
        seconds = time.process_time() - since
        reaction = -steps[-1].reactions["top"][1] / 0.05 / PRESSURE if summary.finished else np.nan
        return reaction, seconds, summary.counters, law.work.steps

    return run


def _tangents(samples: Sequence[Sample], quick: bool, tell: Any) -> list[Row]:
    run = _field(samples, quick)
    tell("tangents: reference")
    reference = run(GrainsLaw(samples, threads=1), FINE_TOLERANCE)[0]
    laws = {
        "secant": GrainsLaw(samples, threads=1),
        "network": GrainsLaw(samples, secant=False, threads=1),
        "isotropic elastic": IsotropicTangent(samples),
        "perturbed, symmetrised": PerturbedTangent(samples),
    }
    table = []
    for name, law in laws.items():
        tell(f"tangent: {name}")
        reaction, seconds, counters, steps = run(law, TOLERANCE)
        row = _row("tangents", name, TOLERANCE, abs(reaction - reference), seconds, steps)
        table.append({**row, **{key: counters[key] for key in COUNTERS}})
    return table


COUNTERS = ("newton_iterations", "law_calls", "cuts", "line_searches")
MEANS = tuple(f"{kind}_{name}" for name in ("ratio", "coordination", "fabric") for kind in ("mean", "scatter"))


def _row(facet: str, series: str, setting: float, error: float, seconds: float, steps: int) -> Row:
    row: Row = {"facet": facet, "series": series, "setting": setting, "error": error, "seconds": seconds}
    return {**row, "count": steps, **dict.fromkeys((*MEANS, *COUNTERS), "")}


def rows(effort: Effort) -> list[Row]:
    """All three parts; see `Study.rows`."""
    quick = effort.quick
    disks, packings = (QUICK_DISKS, QUICK_PACKINGS) if quick else (DISKS, PACKINGS)
    sizes, seeds = (QUICK_SIZES, QUICK_SEEDS) if quick else (SIZES, SEEDS)
    total = 1 + len(STRAIN_STEPS) + len(RESTS) + len(INCREMENTS) + len(sizes) + 5
    done = [0]

    def tell(text: str) -> None:
        effort.advance(done[0], total, text)
        done[0] += 1

    store = PackingStore(disks, PackingOptions(), effort.store)
    samples = [store.at_rest(seed) for seed in range(1, packings + 1)]
    _driven(samples[:1], Pace(strain_step=1e-6, rest=1e-3), 1)  # compiles before the clock runs
    table = _pace(samples, tell)
    table += _sizes(sizes, seeds, effort.store, tell)
    few = PackingStore(QUICK_DISKS if quick else FIELD_DISKS, PackingOptions(), effort.store)
    table += _tangents([few.at_rest(seed) for seed in range(1, 5)], quick, tell)
    mark_fronts(table)
    return table


def draw(path: Path, table: Sequence[Row]) -> None:
    """Error over time of the pace, scatter over disks, time of the tangents."""
    with picture(path, 11.0, 4.2) as figure:
        axes = figure.subplots(1, 3)
        looks = {"strain step": (BLUE, "o"), "rest tolerance": (ORANGE, "s"), "increments": (GREEN, "^")}
        for name, (colour, marker) in looks.items():
            part = [row for row in table if row["facet"] == "pace" and row["series"] == name]
            axes[0].loglog(
                [1e3 * row["seconds"] for row in part], [row["error"] for row in part], color=colour, marker=marker,
                linestyle="-", label=name,
            )  # fmt: skip
        axes[0].set(xlabel="processor time of the path [ms]", ylabel="error of the stress over p [-]", title="(a) pace")
        axes[0].legend()
        part = [row for row in table if row["facet"] == "disks"]
        sizes = [int(row["setting"]) for row in part]
        for name, label, colour in (
            ("ratio", "q/p", BLUE), ("coordination", "z", ORANGE), ("fabric", "$a_c$", GREEN)
        ):  # fmt: skip
            axes[1].loglog(sizes, [row[f"scatter_{name}"] for row in part], color=colour, marker="o", label=label)
        axes[1].set(xlabel="disks", ylabel="standard deviation of one packing [-]", title="(b) size of a packing")
        axes[1].set_xticks(sizes, [str(size) for size in sizes], minor=False)
        axes[1].minorticks_off()
        axes[1].legend()
        part = [row for row in table if row["facet"] == "tangents"]
        longest = max(row["seconds"] for row in part)
        for place, row in enumerate(part):
            axes[2].barh(-place, row["seconds"], color=BLUE)
            text = f"{row['seconds']:.3g} s, {row['newton_iterations']} it."
            axes[2].text(row["seconds"] + 0.02 * longest, -place, text, va="center", color=BLACK, fontsize=9)
        names = [row["series"].replace(", ", ",\n") for row in part]
        axes[2].set_yticks([-place for place in range(len(part))], names)
        axes[2].set(xlabel="processor time [s]", title="(c) tangents", xlim=(0.0, 1.6 * longest))
        axes[2].grid(axis="y", visible=False)


def findings(table: Sequence[Row]) -> list[str]:
    """What the numbers say."""
    pace = [row for row in table if row["facet"] == "pace"]
    base = next(row for row in pace if row["series"] == "strain step" and row["setting"] == Pace().strain_step)
    jump = next(row for row in pace if row["series"] == "strain step" and row["setting"] == STRAIN_STEPS[-1])
    single = next(row for row in pace if row["series"] == "increments" and row["setting"] == INCREMENTS[0])
    sizes = [row for row in table if row["facet"] == "disks"]
    tangents = [row for row in table if row["facet"] == "tangents"]
    fastest = min(tangents, key=lambda row: row["seconds"])
    said = [
        f"With the defaults the stress at the end of the path is off by {base['error']:.1e} p, in "
        f"{base['seconds']:.3g} s a point; strained in one go at each increment, by {jump['error']:.1e} p; "
        f"in a single increment, by {single['error']:.1e} p.",
        "Scatter of one packing, q/p, z and a_c: "
        + "; ".join(
            f"{row['setting']} disks {row['scatter_ratio']:.2g}, {row['scatter_coordination']:.2g}, "
            f"{row['scatter_fabric']:.2g}"
            for row in sizes
        )
        + ".",
        f"Least time in the biaxial test: {fastest['series']} ({fastest['seconds']:.3g} s).",
    ]
    said += [
        f"{row['series'].capitalize()}: {row['newton_iterations']} iterations, {row['law_calls']} calls of the law, "
        f"{row['seconds'] / fastest['seconds']:.2f} times the least time."
        for row in tangents
    ]
    return said


STUDY = Study(
    name="grains",
    title="Grains at integration points",
    question="How slowly, with how many disks and with which tangent should packings be driven at integration points?",
    knobs=(
        ("strain_step", f"{STRAIN_STEPS[0]:g} to {STRAIN_STEPS[-1]:g}, the last being the whole increment in one go"),
        ("rest", f"{RESTS[0]:g} to {RESTS[-1]:g}"),
        ("increments", f"{INCREMENTS[0]} to {INCREMENTS[-1]} of a path of {np.abs(PATH).max():g}"),
        ("particles", f"{SIZES[0]} to {SIZES[-1]}, {SEEDS} packings each"),
        ("tangent", "secant, network, isotropic elastic, perturbed and symmetrised"),
        ("scene", f"biaxial between rough platens, 48 points of {FIELD_DISKS} disks, 7 load steps"),
        ("reference", f"strain step {FINE.strain_step:g} and rest {FINE.rest:g}; residual {FINE_TOLERANCE:g}"),
        ("error", "pace: stress over p; disks: standard deviation of q/p; tangents: reaction over p"),
    ),
    columns=(
        *COMMON_COLUMNS,
        *(Column(name, f"{name.replace('_', ' ')} of the packings at the end of the path") for name in MEANS),
        Column("newton_iterations", "corrections by a linear solve, predictors included"),
        Column("law_calls", "calls of the law, each for all points"),
        Column("cuts", "abandoned attempts at a load step"),
        Column("line_searches", "shortened corrections"),
    ),
    rows=rows,
    draw=draw,
    findings=findings,
)
