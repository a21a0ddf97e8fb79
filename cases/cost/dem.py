"""Study: how many disks, how many packings and how slow a loading the DEM needs to serve as a reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.loading.path import biaxial_test
from granfabric.dem_ref.loading.run import RunOptions, at_stress_ratios
from granfabric.dem_ref.loading.servo import RateLimits

from .draw import work_precision
from .front import cheapest, mark_fronts, slope
from .grains import Grains, GrainStore, Watch
from .study import COMMON_COLUMNS, Axes, Column, Effort, Row, Study, StudyError

Array = NDArray[np.float64]

LEVELS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
"""Stress ratios q/p at which runs are compared."""
SLOWER = (1000.0, 100.0, 10.0, 1.0, 0.1)
"""Limits of inertial number and unbalanced force over their usual ones; the last is the reference."""


@dataclass(frozen=True)
class Plan:
    """What is computed.

    Parameters
    ----------
    packings : dict of int to int
        Number of packings by number of disks; the largest disks are the reference.
    rate_disks, rate_packings : int
        Packings on which the loading rate is varied.
    """

    packings: dict[int, int]
    rate_disks: int
    rate_packings: int


FULL = Plan({250: 8, 500: 8, 1000: 8, 2500: 8, 5000: 4, 10_000: 4, 20_000: 4}, 5000, 2)
QUICK = Plan({200: 4, 400: 4, 800: 4}, 400, 1)

AXES = Axes(
    error="largest distance in $z$ (relative) and $a_c$ [-]",
    seconds="processor time [s]",
    count="steps times disks of the loading",
    facet_titles={
        "disks": "disks and packings (packing and loading)",
        "rate": "loading rate (loading alone), from the slowest run",
    },
)


def options(factor: float = 1.0) -> RunOptions:
    """Compression at constant mean pressure to just beyond q/p = 0.3, `factor` times as fast as usual."""
    usual = RateLimits()
    limits = RateLimits(factor * usual.inertial_number, factor * usual.unbalanced_force)
    return RunOptions(tuple(biaxial_test("constant_pressure", LEVELS[-1] + 0.002, 0.02)), limits=limits)


def curve(grains: Grains) -> Array:
    """Coordination number (rattlers counted) and fabric anisotropy along the loading axis, shape (nlevels, 2)."""
    table = at_stress_ratios(grains.history, LEVELS)
    return np.stack([table["coordination"], table["fabric_anisotropy"]], axis=1)


def distance(found: Array, reference: Array) -> Array:
    """Largest distances over the levels: z relative, a_c absolute; shape (2,).

    Raises
    ------
    StudyError
        If one of them did not reach all stress ratios.
    """
    if not (np.isfinite(found).all() and np.isfinite(reference).all()):
        raise StudyError(f"a run did not reach q/p = {LEVELS[-1]:g}")
    scale = np.stack([reference[:, 0], np.ones(len(reference))], axis=1)
    return np.asarray(np.abs((found - reference) / scale).max(axis=0))


def groups(curves: Array, size: int) -> list[tuple[Array, Array]]:
    """Means of disjoint groups of so many curves, each with the mean of all curves that are not in it."""
    found = []
    for first in range(0, len(curves) - size + 1, size):
        inside = np.zeros(len(curves), dtype=bool)
        inside[first : first + size] = True
        others = curves[~inside].mean(axis=0) if not inside.all() else curves.mean(axis=0)
        found.append((curves[inside].mean(axis=0), others))
    return found


def rows(effort: Effort) -> list[Row]:
    """All packings and rates; see `Study.rows`."""
    plan = QUICK if effort.quick else FULL
    store = GrainStore(effort.store)
    total = sum(plan.packings.values()) + plan.rate_packings * len(SLOWER)
    done = 0

    def watch(text: str) -> None:
        effort.advance(done, total, text)

    runs: dict[int, list[Grains]] = {}
    for disks, number in plan.packings.items():
        runs[disks] = []
        for seed in range(1, number + 1):
            runs[disks].append(store.run(disks, seed, "usual rate", options(), watch))
            done += 1
    table = _of_disks(runs)
    rates: list[tuple[float, list[Grains]]] = []
    for factor in SLOWER:
        rates.append((factor, []))
        for seed in range(1, plan.rate_packings + 1):
            rates[-1][1].append(_rate(store, plan.rate_disks, seed, factor, watch))
            done += 1
    table += _of_rates(rates, np.array([curve(run) for run in runs[max(runs)]]).mean(axis=0), plan.rate_disks)
    mark_fronts(table)
    return table


def _rate(store: GrainStore, disks: int, seed: int, factor: float, watch: Watch) -> Grains:
    name = "usual rate" if factor == 1.0 else f"rate times {factor:g}"
    return store.run(disks, seed, name, options(factor), watch)


def _of_disks(runs: dict[int, list[Grains]]) -> list[Row]:
    """Rows of one and of several packings of each number of disks."""
    largest = max(runs)
    curves = {disks: np.array([curve(run) for run in found]) for disks, found in runs.items()}
    reference = curves[largest].mean(axis=0)
    # what is left of the scatter between packings in their mean: how exactly the reference is known
    spread = curves[largest].std(axis=0, ddof=1) / np.sqrt(len(curves[largest])) / [reference[0, 0], 1.0]
    table = []
    for packings in (1, 2, 4):
        for disks, found in runs.items():
            if len(found) < packings or (disks == largest and len(found) == packings):
                continue
            pairs = groups(curves[disks], packings)
            # a part of the reference is compared with the rest of it
            errors = np.array([distance(mean, rest if disks == largest else reference) for mean, rest in pairs])
            table.append(
                {
                    "facet": "disks",
                    "series": "one packing" if packings == 1 else f"mean of {packings} packings",
                    "setting": f"{disks} disks",
                    "error": float(errors.max(axis=1).mean()),
                    "seconds": packings * float(np.mean([run.seconds + run.packing_seconds for run in found])),
                    "count": packings * float(np.mean([run.particle_steps for run in found])),
                    "disks": disks,
                    "packings": packings,
                    "groups": len(pairs),
                    "inertial_number": RateLimits().inertial_number,
                    "largest_inertial_number": max(float(run.history["inertial_number"].max()) for run in found),
                    "error_coordination": float(errors[:, 0].mean()),
                    "error_fabric": float(errors[:, 1].mean()),
                    "error_from_largest": float(errors.max(axis=1).mean()),
                    "reference_uncertainty": float(spread.max()),
                    "packing_seconds": packings * float(np.mean([run.packing_seconds for run in found])),
                }
            )
    return table


def _of_rates(rates: Sequence[tuple[float, list[Grains]]], largest: Array, disks: int) -> list[Row]:
    """Rows of the loading rate: each packing against its own slowest run, so that nothing else makes the difference."""
    slowest = [curve(run) for run in rates[-1][1]]
    table = []
    for factor, found in rates[:-1]:
        errors = np.array([distance(curve(run), goal) for run, goal in zip(found, slowest)])
        away = [distance(curve(run), largest).max() for run in found]
        limits = options(factor).limits
        table.append(
            {
                "facet": "rate",
                "series": "one packing",
                "setting": f"inertial number up to {limits.inertial_number:.0e}",
                "error": float(errors.max(axis=1).mean()),
                "seconds": float(np.mean([run.seconds for run in found])),
                "count": float(np.mean([run.particle_steps for run in found])),
                "disks": disks,
                "packings": 1,
                "groups": len(found),
                "inertial_number": limits.inertial_number,
                "largest_inertial_number": max(float(run.history["inertial_number"].max()) for run in found),
                "error_coordination": float(errors[:, 0].mean()),
                "error_fabric": float(errors[:, 1].mean()),
                "error_from_largest": float(np.mean(away)),
                "reference_uncertainty": 0.0,
                "packing_seconds": float(np.mean([run.packing_seconds for run in found])),
            }
        )
    return table


def draw(path: Path, table: Sequence[Row]) -> None:
    """The work-precision picture of the DEM."""
    work_precision(path, "DEM, compression at constant mean pressure to $q/p = 0.3$", AXES, table)


def findings(table: Sequence[Row]) -> list[str]:
    """What the numbers say."""
    disks = [row for row in table if row["facet"] == "disks"]
    single = [row for row in disks if row["packings"] == 1]
    largest = max(row["disks"] for row in single)
    below = [row for row in single if row["disks"] < largest]
    said = [
        f"One packing of {row['disks']} disks is {row['error']:.2g} from the mean of {largest} disks (z "
        f"{100 * row['error_coordination']:.2g} %, a_c {row['error_fabric']:.2g}) and takes {row['seconds']:.3g} s, "
        f"{100 * row['packing_seconds'] / row['seconds']:.0f} % of it for packing."
        for row in (below[0], below[-1])
    ]
    said.append(
        f"The distance falls with the number of disks to the power "
        f"{slope([row['disks'] for row in below], [row['error'] for row in below]):.2f} (independent contacts: -0.5); "
        f"the mean of {largest} disks itself is known to {disks[0]['reference_uncertainty']:.2g}."
    )
    for error in (0.02, 0.01):
        best = cheapest(disks, error)
        if best is not None:
            said.append(
                f"A distance of {error:g} costs least with {best['setting']}, {best['series']}: "
                f"{best['seconds']:.3g} s."
            )
    rates = [row for row in table if row["facet"] == "rate"]
    said += [
        f"{row['setting'][0].upper()}{row['setting'][1:]}: {row['error']:.1e} from the slowest run in "
        f"{row['seconds']:.2g} s of loading."
        for row in rates
    ]
    return said


def _words(packings: dict[int, int]) -> str:
    return ", ".join(f"{disks} ({number})" for disks, number in packings.items())


STUDY = Study(
    name="dem",
    title="Disks, packings and loading rate of the DEM",
    question="How many disks and how slow a loading does it take before the DEM can serve as a reference for a model?",
    knobs=(
        ("disks (packings)", f"{_words(FULL.packings)}; quick: {_words(QUICK.packings)}"),
        ("loading rate", "inertial number up to 1e-2 ... 1e-5 and unbalanced force in proportion; reference 1e-6"),
        ("test", "compression at constant mean pressure, kn/p = 1e4, kt = kn, friction 0.5"),
        (
            "reference",
            "disks: the mean curve of the packings of most disks (one of them: the mean of the others); rate: the same "
            "packing, slowest run",
        ),
        ("error", "largest over q/p = 0, 0.05, ..., 0.3 of z relative and a_c; mean over packings, or groups of them"),
        (
            "time",
            "processor time of packing and loading (loading rate: of loading alone), measured once; runs are kept and "
            "read again",
        ),
    ),
    columns=(
        *COMMON_COLUMNS,
        Column("disks", "disks of a packing"),
        Column("packings", "packings whose curves are averaged"),
        Column("groups", "groups of so many packings over which the error is averaged"),
        Column("inertial_number", "limit of the inertial number"),
        Column("largest_inertial_number", "largest inertial number met"),
        Column("error_coordination", "distance in z, relative"),
        Column("error_fabric", "distance in a_c"),
        Column("error_from_largest", "distance from the mean curve of most disks"),
        Column("reference_uncertainty", "standard error of that mean, 0 where it is not the reference"),
        Column("packing_seconds", "time that went into packing", "s"),
    ),
    rows=rows,
    draw=draw,
    findings=findings,
)
