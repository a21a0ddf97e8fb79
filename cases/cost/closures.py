"""Study: what each closure of the point law costs, and how far it is from grains."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.pictures.style import picture
from granfabric.cases.records import files
from granfabric.cases.scene.measured import measure_inputs, refused, with_error
from granfabric.cases.terminal.clock import best_of
from granfabric.cases.verify.model_side import closures, material
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Integration
from granfabric.dem_ref.inputs.probes import ProbeError
from granfabric.dem_ref.loading.path import Segment, biaxial_test, loading_cycles
from granfabric.dem_ref.loading.run import RunOptions
from granfabric.dem_ref.sample.disks import SampleError

from .draw import FRONT, LOOKS, log_axes, panel
from .front import cheapest, mark_fronts
from .grains import GrainStore, Watch
from .study import COMMON_COLUMNS, Column, Effort, Row, Study, StudyError

Array = NDArray[np.float64]

DISKS, PACKINGS = 2500, 2
QUICK_DISKS, QUICK_PACKINGS = 400, 1
TOLERANCES, QUICK_TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8), (1e-2, 1e-4)
POINTS = 32
"""Equal points side by side, so that the time is that of the kernels and not of a call."""
STEP = 0.02
"""Increments of q/p."""
SCATTER = "difference between packings"
LEVELS = np.arange(0.0, 0.2001, 0.04)
"""Stress ratios q/p at which law and grains are compared, in loading and in unloading."""


@dataclass(frozen=True)
class Test:
    """A path at one packing.

    Parameters
    ----------
    title : str
    segments : tuple of Segment
        What the DEM does.
    turns : tuple of float
        q/p at the ends of the legs, from 0.
    lateral : bool
        Lateral stress constant instead of the mean pressure.
    """

    title: str
    segments: tuple[Segment, ...]
    turns: tuple[float, ...]
    lateral: bool = False

    @property
    def options(self) -> RunOptions:
        """Of the DEM run."""
        return RunOptions(self.segments)


TESTS = {
    "constant_pressure": Test(
        "constant mean pressure to $q/p = 0.2$",
        tuple(biaxial_test("constant_pressure", 0.202, 0.02)),
        (0.2,),
    ),
    "constant_lateral_stress": Test(
        "constant lateral stress to $q/p = 0.2$",
        tuple(biaxial_test("constant_lateral_stress", 0.202, 0.02)),
        (0.2,),
        lateral=True,
    ),
    "loop": Test("loop of $q/p$: 0, 0.2, 0, 0.2", tuple(loading_cycles(0.2, 1)), (0.2, 0.0, 0.2)),
}

def of_grains(history: dict[str, Array], test: Test) -> Array:
    """Coordination number and fabric anisotropy of a DEM run at the levels of each leg, shape (nlegs, nlevels, 2).

    Raises
    ------
    StudyError
        If a leg was not followed to its end.
    """
    ratio = (history["stress_xx"] - history["stress_yy"]) / 2.0 / history["p"]
    segment = history["segment"]
    legs, begin = [], 0
    for number in range(len(test.turns)):
        after = np.flatnonzero(segment > number)
        if not len(after):
            raise StudyError(f"the grains did not finish leg {number + 1} of {test.title}")
        leg = slice(begin, int(after[0]) + 1)
        begin = int(after[0])
        # the servo keeps the ratio within its lag: sorting removes what it wavers by
        order = np.argsort(ratio[leg], kind="stable")
        columns = (history["coordination"][leg], history["fabric_anisotropy"][leg])
        legs.append(np.stack([np.interp(LEVELS, ratio[leg][order], column[order]) for column in columns], axis=1))
    return np.array(legs)


def stresses(test: Test, pressure: float) -> list[tuple[Array, bool]]:
    """End stress (3,) of every increment, tension positive, and whether a leg ends there."""
    made: list[tuple[Array, bool]] = []
    ratio = 0.0
    for turn in test.turns:
        steps = round(abs(turn - ratio) / STEP)
        for step in range(1, steps + 1):
            q = ratio + (turn - ratio) * step / steps
            p = pressure / (1.0 - q) if test.lateral else pressure
            made.append((np.array([-p * (1.0 - q), -p * (1.0 + q), 0.0]), step == steps))
        ratio = turn
    return made


@dataclass(frozen=True)
class Answer:
    """The point law along a test.

    Parameters
    ----------
    values : ndarray, shape (nlegs, nlevels, 2)
        As `of_grains`.
    evaluations : float
        Of the rates, per point.
    failed : bool
    """

    values: Array
    evaluations: float
    failed: bool


def follow(law: ContactLaw, test: Test, pressure: float, points: int) -> Answer:
    """Drive equal points along a test by stress."""
    stress = np.tile([-pressure, -pressure, 0.0], (points, 1))
    state = law.initial_state(stress)
    stress_end, state_end, strain = np.empty_like(stress), np.empty_like(state), np.empty_like(stress)
    z, fabric = law.description.columns("coordination"), law.description.columns("fabric_anisotropy")

    def seen() -> list[float]:
        p = -0.5 * (stress[0, 0] + stress[0, 1])
        return [0.5 * (stress[0, 0] - stress[0, 1]) / p, float(state[0, z][0]), -float(state[0, fabric][0])]

    legs, leg, evaluations = [], [seen()], 0
    for target, turning in stresses(test, pressure):
        report = law.update_stress_driven(target - stress, stress, state, stress_end, state_end, strain)
        evaluations += 0 if report.evaluations is None else int(report.evaluations.sum())
        if report.failed:
            return Answer(np.full((len(test.turns), len(LEVELS), 2), np.nan), evaluations / points, True)
        stress, stress_end = stress_end, stress
        state, state_end = state_end, state
        leg.append(seen())
        if turning:
            table = np.array(sorted(leg))
            legs.append(np.stack([np.interp(LEVELS, table[:, 0], table[:, column]) for column in (1, 2)], axis=1))
            leg = [seen()]
    return Answer(np.array(legs), evaluations / points, False)


def _inputs(store: GrainStore, disks: int, seed: int, watch: Watch) -> dict[str, float]:
    """Measured inputs of the law, kept beside the packing."""
    path = store.path(disks, seed, "inputs").with_suffix(".json")
    with suppress(OSError, ValueError):
        return {name: float(value) for name, value in json.loads(path.read_text(encoding="utf-8")).items()}
    packing = store.packing(disks, seed, watch)[0]
    watch(f"{disks} disks, seed {seed}: inputs of the point law")
    try:
        measured = measure_inputs(packing)
    except (ProbeError, SampleError) as error:
        raise StudyError(f"{disks} disks, seed {seed}: the inputs of the law cannot be measured: {error}") from error
    if illegal := refused(measured):
        name = illegal[0]
        found_there = with_error(measured, name)
        raise StudyError(f"{disks} disks, seed {seed}: {found_there} is outside the bounds of the law; take more disks")
    found = measured.values
    files.write_json(path, found)
    return found


def rows(effort: Effort) -> list[Row]:
    """All closures on all tests under some tolerances; see `Study.rows`."""
    disks, packings = (QUICK_DISKS, QUICK_PACKINGS) if effort.quick else (DISKS, PACKINGS)
    tolerances = QUICK_TOLERANCES if effort.quick else TOLERANCES
    store = GrainStore(effort.store)
    seeds = range(1, packings + 1)
    total = packings * (1 + len(TESTS)) + 1
    done = 0

    def watch(text: str) -> None:
        effort.advance(done, total, text)

    inputs, grains = [], {}
    for seed in seeds:
        inputs.append(_inputs(store, disks, seed, watch))
        done += 1
        for name, test in TESTS.items():
            history = store.run(disks, seed, name, test.options, watch).history
            grains[name, seed] = (of_grains(history, test), float(history["p"][0]))
            done += 1
    scatter = {
        name: float(np.ptp([_scaled(grains[name, seed][0], grains[name, 1][0]) for seed in seeds], axis=0).max())
        for name in TESTS
    }
    table: list[Row] = []
    calls: list[Callable[[], object]] = []
    for name, test in TESTS.items():
        for closure_name, tolerance in ((key, value) for key in closures(inputs[0]) for value in tolerances):
            watch(f"{closure_name}, {name}")
            answers = []
            for seed in seeds:
                goal, pressure = grains[name, seed]
                law = _law(inputs[seed - 1], closures(inputs[seed - 1])[closure_name], tolerance)
                answers.append((follow(law, test, pressure, 1), goal))
            first = _law(inputs[0], closures(inputs[0])[closure_name], tolerance)
            calls.append(partial(follow, first, test, grains[name, 1][1], POINTS))
            table.append(_row(name, closure_name, tolerance, answers, scatter[name]))
    times = best_of(calls, effort.rounds, lambda count: watch("timing"))
    for row, seconds in zip(table, times):
        row["seconds"] = seconds / POINTS
    mark_fronts(table)
    return table


def _law(inputs: dict[str, float], closure: Closure, tolerance: float) -> ContactLaw:
    return ContactLaw([material(inputs)], closure, integration=Integration(tolerance=tolerance, directions=16))


def _scaled(values: Array, reference: Array) -> Array:
    """z over its reference, a_c as it is: what distances are taken of."""
    return np.stack([values[..., 0] / reference[..., 0], values[..., 1]], axis=-1)


def _row(test: str, closure: str, tolerance: float, answers: list[tuple[Answer, Array]], scatter: float) -> Row:
    """Distances, mean over the packings of the largest of each."""
    away = np.array([np.abs(_scaled(answer.values, goal) - _scaled(goal, goal)) for answer, goal in answers])
    largest = away.max(axis=(1, 2))
    return {
        "facet": test,
        "series": closure,
        "setting": f"tolerance 1e{round(np.log10(tolerance))}",
        "error": float(largest.max(axis=1).mean()),
        "seconds": 0.0,
        "count": float(np.mean([answer.evaluations for answer, _ in answers])),
        "closure": closure,
        "tolerance": tolerance,
        "error_coordination": float(largest[:, 0].mean()),
        "error_fabric": float(largest[:, 1].mean()),
        "error_at_end": float(away[:, -1, -1].max(axis=1).mean()),
        "scatter_of_packings": scatter,
        "failed_packings": sum(answer.failed for answer, _ in answers),
    }


def draw(path: Path, table: Sequence[Row]) -> None:
    """Error against time on each test; below, the distances in both quantities at the tightest tolerance."""
    names = list(dict.fromkeys(row["series"] for row in table))
    looks = {name: LOOKS[place % len(LOOKS)] for place, name in enumerate(names)}
    finest = min(row["tolerance"] for row in table)
    with picture(path, 13.0, 7.6) as figure:
        grid = figure.subplots(2, len(TESTS), squeeze=False, sharey="row")
        handles: dict[str, Any] = {}
        for place, (name, test) in enumerate(TESTS.items()):
            members = [row for row in table if row["facet"] == name]
            axes = grid[0, place]
            handles |= panel(axes, members, "seconds", "on_front", looks)
            log_axes(axes)
            axes.set(title=f"({'abc'[place]}) {test.title}", xlabel="processor time per point and path [s]")
            axes.title.set_fontsize(10)
            handles |= _bars(grid[1, place], [row for row in members if row["tolerance"] == finest], looks)
            grid[1, place].set_title(f"({'def'[place]}) the same, both quantities", fontsize=10)
        grid[0, 0].set_ylabel("largest distance from grains [-]")
        grid[1, 0].set_ylabel("largest distance from grains [-]")
        order = [name for name in (*names, FRONT, SCATTER) if name in handles]
        figure.legend([handles[name] for name in order], order, loc="outside lower center", ncols=4, fontsize=9)
        figure.suptitle("Closures of the point law against grains: $z$ (relative) and $a_c$", x=0.01, ha="left",
                        fontsize=13)  # fmt: skip


def _bars(axes: Any, members: Sequence[Row], looks: dict[str, tuple[str, str]]) -> dict[str, Any]:
    """Distances in z and a_c side by side, and how far the packings are from each other; its handle for the legend."""
    handles: dict[str, Any] = {}
    width = 0.8 / max(1, len(members))
    for place, row in enumerate(members):
        at = [quantity + (place - (len(members) - 1) / 2) * width for quantity in (0, 1)]
        axes.bar(at, [row["error_coordination"], row["error_fabric"]], 0.9 * width, color=looks[row["series"]][0])
    if members and members[0]["scatter_of_packings"] > 0.0:
        handles[SCATTER] = axes.axhline(members[0]["scatter_of_packings"], color="black", linestyle=":")
    axes.set_xticks((0, 1), ("$z$ (relative)", "$a_c$"))
    axes.set_yscale("log")
    axes.grid(axis="x", visible=False)
    return handles


def findings(table: Sequence[Row]) -> list[str]:
    """What the numbers say."""
    said = []
    finest = min(row["tolerance"] for row in table)
    for name, test in TESTS.items():
        members = [row for row in table if row["facet"] == name]
        plain = test.title.replace("$", "")
        parts = [
            f"{row['series']} z {100 * row['error_coordination']:.2g} %, a_c {row['error_fabric']:.2g}"
            for row in members
            if row["tolerance"] == finest and np.isfinite(row["error"])
        ]
        said.append(f"{plain[0].upper()}{plain[1:]}, largest distance from grains: {'; '.join(parts)}.")
        refused = {row["series"] for row in members if row["failed_packings"]}
        if refused:
            said.append(f"{plain[0].upper()}{plain[1:]}: refused by {', '.join(sorted(refused))}.")
    for closure in dict.fromkeys(row["series"] for row in table):
        members = [row for row in table if row["series"] == closure and row["facet"] == "constant_pressure"]
        best = min((row["error"] for row in members), default=float("nan"))
        enough = cheapest(members, 1.05 * best, "count")
        if enough is not None:
            said.append(
                f"{closure}: a {enough['setting']} brings it as near to grains as it gets, with "
                f"{enough['seconds'] * 1e6:.3g} µs and {enough['count']:.3g} evaluations a point and path; what is "
                "left is the model."
            )
    return said


STUDY = Study(
    name="closures",
    title="Closures against grains",
    question="Which closure comes nearest to grains, on loading and on a loop, and at what cost?",
    knobs=(
        ("closure", "every one that the law offers, with inputs measured on each packing"),
        ("tolerance", ", ".join(f"{tolerance:g}" for tolerance in TOLERANCES) + " of Bogacki-Shampine 3(2)"),
        ("test", f"stress-driven in increments of {STEP:g} in q/p: both loadings to 0.2, and a loop 0, 0.2, 0, 0.2"),
        ("reference", f"DEM of the same packing, {PACKINGS} packings of {DISKS} disks ({QUICK_DISKS} quick)"),
        ("error", "largest over q/p = 0, 0.04, ..., 0.2 of every leg of z relative and a_c; mean over packings"),
        ("time", f"{POINTS} equal points side by side, 16 directions where there is no closed form"),
    ),
    columns=(
        *COMMON_COLUMNS,
        Column("closure", "name of the closure"),
        Column("tolerance", "tolerance of error control"),
        Column("error_coordination", "largest distance in z, relative"),
        Column("error_fabric", "largest distance in a_c"),
        Column("error_at_end", "the larger of both at the end of the test"),
        Column("scatter_of_packings", "largest difference between the packings themselves, likewise"),
        Column("failed_packings", "packings on which the law refused to go on"),
    ),
    rows=rows,
    draw=draw,
    findings=findings,
)
