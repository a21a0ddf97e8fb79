"""Packings compacted with friction: the more of it, the looser, and the fewer contacts.

Recipe: disks at random in a wide cell, moved apart; the cell shrinks, friction on, until the disks carry half of
`OVERPRESSURE` times the target pressure; isotropic loading to that pressure, back to the target, and rest. Coming from
above spares the slow creep through the onset of rigidity, where nothing but drag decides how long it takes. Until the
disks carry, their motion beyond that of the cell is stopped every `STOP` steps.

Contacts keep their tangential forces, without which a loose packing would not hold; a friction that falls afterwards is
refused, because such packings fall together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import exp, log, sqrt

import numpy as np

from granfabric.dem_ref.dynamics.motion import Control, Motion
from granfabric.dem_ref.dynamics.packing import (
    PackingError,
    PackingOptions,
    in_spatial_order,
    mean_diameter_of,
    random_diameters,
)
from granfabric.dem_ref.dynamics.packing import make_packing as make_frictionless_packing
from granfabric.dem_ref.dynamics.relaxation import relax
from granfabric.dem_ref.loading.legs import stress_leg
from granfabric.dem_ref.loading.servo import Loading, RateLimits, mean_pressure
from granfabric.dem_ref.measures.contacts import coordination_number
from granfabric.dem_ref.sample.disks import Sample, new_sample
from granfabric.dem_ref.sample.neighbours import find_near_pairs

START = 0.72
"""Solid fraction of the disks that are moved apart at first: looser than any packing that carries."""
OVERPRESSURE = 5.0
FASTEST, SLOWER, SLOWEST = 1.0e-3, 1.0e-4, 1.0e-5
"""Inertial numbers of the compaction, of the way back and of the rest."""
DRAG = 0.005
STOP = 200
LARGEST_STRAIN = 0.3
"""Of a packing that is pressed together, or collapses under a smaller friction."""
MOST_CLOSINGS = 20
LONGEST = 2_000_000
"""Steps in which a packing has to come to rest."""
SMALLEST_FRICTION, LARGEST_FRICTION = 0.005, 10.0
"""Of a search; below, packings come to rest too slowly, and above hardly anything changes."""
MOST_TRIALS = 12
TOLERANCES = {"coordination": (0.01, 0.7), "solid_fraction": (5e-4, 0.03)}
"""Of a wanted quantity: the least, and over the square root of the number of disks; a packing varies by as much from
one friction to the next."""
FAR = 5.0
"""Times the tolerance by which the best of all trials may be off."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Prepared:
    """A packing and how it was made.

    Attributes
    ----------
    sample : Sample
    friction : float
        During compaction.
    trials : tuple of (float, float)
        Friction and what it gave of the wanted quantity, in the order in which they were tried; empty if there was
        nothing to search.
    """

    sample: Sample
    friction: float
    trials: tuple[tuple[float, float], ...] = ()


def prepare_packing(
    count: int,
    seed: int,
    options: PackingOptions | None = None,
    progress: Progress | None = None,
    threads: int | None = None,
) -> Prepared:
    """A packing with the preparation that the options ask for; see `make_packing`.

    Raises
    ------
    SampleError
        On options out of bounds.
    PackingError
        If the packing does not come to rest, or no friction gives what is wanted.
    """
    options = options or PackingOptions()
    options.check()
    report = progress or (lambda text, fraction: None)
    name = "coordination" if options.coordination is not None else "solid_fraction"
    if options.coordination is None and options.solid_fraction is None:
        friction = options.preparation_friction or 0.0
        return Prepared(_compacted(count, seed, options, friction, report, threads), friction)
    return _searched(count, seed, options, name, report, threads)


def make_packing(
    count: int,
    seed: int,
    options: PackingOptions | None = None,
    progress: Progress | None = None,
    threads: int | None = None,
) -> Sample:
    """An isotropic packing of `count` disks, reproducible from `seed`, with friction switched on.

    It is compacted without friction unless the options ask for a `preparation_friction`, a `coordination` or a
    `solid_fraction`; for the latter two the friction during compaction is searched.

    Parameters
    ----------
    count : int
        Number of disks, at least 50.
    seed : int
    options : PackingOptions, optional
    progress : callable, optional
        Called with a short text and a fraction between 0 and 1.
    threads : int, optional
        1 or 2; does not change the packing. Whichever is faster if not given.

    Raises
    ------
    SampleError
        On options out of bounds.
    PackingError
        If the packing does not come to rest, or no friction gives what is wanted.
    """
    return prepare_packing(count, seed, options, progress, threads).sample


def _wanted(sample: Sample, options: PackingOptions, name: str) -> float:
    if name == "solid_fraction":
        return sample.solid_fraction
    z = coordination_number(sample)
    return z.without_rattlers if options.counted == "excluded" else z.all_particles


def _searched(
    count: int, seed: int, options: PackingOptions, name: str, report: Progress, threads: int | None
) -> Prepared:
    """Halve the interval of the logarithm of the friction; what is wanted falls with it."""
    least, scatter = TOLERANCES[name]
    goal, tolerance = float(getattr(options, name)), max(least, scatter / sqrt(count))
    trials: list[tuple[float, float]] = []
    best: tuple[float, Sample] | None = None

    def attempt(friction: float) -> float:
        nonlocal best
        begun = len(trials) / MOST_TRIALS

        def part(text: str, fraction: float) -> None:
            report(f"friction {friction:.3g}: {text}", begun + fraction / MOST_TRIALS)

        sample = _compacted(count, seed, options, friction, part, threads)
        found = _wanted(sample, options, name)
        trials.append((friction, found))
        if best is None or abs(found - goal) < abs(_wanted(best[1], options, name) - goal):
            best = (friction, sample)
        return found - goal

    densest = attempt(0.0)
    if densest < -tolerance:
        raise PackingError(
            f"{name} = {goal:g} is above the {goal + densest:.4g} that this packing has without friction during "
            "compaction"
        )
    if densest > tolerance:
        # with more friction than afterwards a packing would fall together again
        most = min(LARGEST_FRICTION, options.friction)
        loosest = attempt(most) if most > SMALLEST_FRICTION else densest
        if loosest > tolerance:
            raise PackingError(
                f"{name} = {goal:g} is below the {goal + loosest:.4g} that this packing has with friction {most:g} "
                "during compaction, the largest that holds afterwards"
            )
        low, high = log(SMALLEST_FRICTION), log(most)
        off = loosest
        while abs(off) > tolerance and len(trials) < MOST_TRIALS:
            middle = 0.5 * (low + high)
            off = attempt(exp(middle))
            low, high = (middle, high) if off > 0.0 else (low, middle)
    assert best is not None
    found = _wanted(best[1], options, name)
    if abs(found - goal) > FAR * tolerance:
        raise PackingError(f"{name} = {goal:g} was not found in {len(trials)} compactions; the nearest is {found:.4g}")
    report("packed", 1.0)
    return Prepared(best[1], best[0], tuple(trials))


def _compacted(
    count: int, seed: int, options: PackingOptions, friction: float, report: Progress, threads: int | None
) -> Sample:
    plain = replace(options, preparation_friction=None, coordination=None, solid_fraction=None)
    if friction == 0.0:
        return make_frictionless_packing(count, seed, plain, report, threads)
    random = np.random.default_rng(seed)
    radius = 0.5 * random_diameters(count, options, random)
    width = float(np.sqrt(np.pi * np.sum(radius**2) / START))
    cell = width * np.eye(2)
    position, radius = in_spatial_order(random.random((count, 2)) * width, radius, cell)
    report("moving disks apart", 0.0)
    relax(position, radius, cell, 0.0, tolerance=1e-2, steps=4000, fixed_cell=True)
    position, radius = in_spatial_order(position, radius, cell)
    # mean diameter and normal stiffness are 1 here
    sample = new_sample(
        position, radius, cell, normal_stiffness=1.0, stiffness_ratio=options.stiffness_ratio, friction=friction,
        seed=seed,
    )  # fmt: skip
    pressure = 1.0 / options.stiffness_to_pressure
    for attempt in range(MOST_CLOSINGS):
        _close(sample, 0.5 * OVERPRESSURE * pressure, report)
        motion = Motion(sample, damping=DRAG)
        motion.run(1)
        # what carries for a moment only, or is unloaded too fast, falls apart: then it is closed once more
        if (
            _load(motion, OVERPRESSURE * pressure, FASTEST, False, report, 0.5)
            and _load(motion, pressure, SLOWER / 2.0 ** min(attempt, 6), False, report, 0.6)
            and _load(motion, pressure, SLOWEST, True, report, 0.7)
        ):
            break
        if mean_pressure(motion.stress) > 0.5 * pressure:
            raise PackingError(
                f"the packing of {count} disks, seed {seed}, compacted with friction {friction:g}, is not at rest: "
                f"unbalanced force {motion.unbalanced_force:.2g}"
            )
    else:
        raise PackingError(
            f"the packing of {count} disks, seed {seed}, compacted with friction {friction:g}, fell apart "
            f"{MOST_CLOSINGS} times when it was unloaded"
        )
    report("packed", 1.0)
    return _scaled(sample, options)


def _close(sample: Sample, pressure: float, report: Progress) -> None:
    """Shrink the cell until the disks carry a pressure, whatever moves on its own stopped now and then."""
    start = sample.area
    motion = Motion(sample, damping=DRAG)
    rate = 0.5 * FASTEST * motion.step * np.sqrt(pressure)
    control = Control(drive=np.array([-rate, -rate, 0.0]), fastest_rate=1.0)
    while mean_pressure(motion.stress) < pressure:
        sample.velocity[:] = 0.0
        sample.spin[:] = 0.0
        motion = Motion(sample, damping=DRAG)
        motion.run(STOP, control)
        report("compacting", min(0.4, 2.0 * (1.0 - sample.area / start)))
    sample.strain_rate[:] = 0.0


def _load(motion: Motion, pressure: float, speed: float, hold: bool, report: Progress, at: float) -> bool:
    limits = RateLimits(inertial_number=speed, unbalanced_force=1e-4 if hold else 1e-2)
    leg = replace(stress_leg((-pressure, -pressure, 0.0), hold), largest_strain=LARGEST_STRAIN)
    loading = Loading(motion, leg, limits)

    def observe(state: Loading) -> bool:
        report("compacting" if not hold else "coming to rest", at)
        return False

    done = loading.run(LONGEST, observe)
    return done and mean_pressure(motion.stress) > 0.5 * pressure


def _scaled(sample: Sample, options: PackingOptions) -> Sample:
    """The sample at rest in its own units, friction that of the loading."""
    scale = mean_diameter_of(sample.count, options)
    reduced = np.floor(sample.position @ np.linalg.inv(sample.cell))
    position = scale * (sample.position - reduced @ sample.cell)
    cell = scale * sample.cell
    kept = sample.pairs
    kept.tangential *= scale
    pairs = find_near_pairs(position, scale * sample.radius, cell, 0.03 * scale, kept)
    return Sample(
        position, scale * sample.radius, cell, options.normal_stiffness, options.stiffness_ratio, options.friction,
        np.zeros((sample.count, 2)), np.zeros(sample.count), pairs, seed=sample.seed,
    )  # fmt: skip
