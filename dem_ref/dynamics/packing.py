"""Packings: random disks, relaxed without friction to an isotropic stress, friction switched on afterwards.

Recipe: disks at random in a cell at a solid fraction above random close packing; relaxed at fixed cell; relaxed loosely
under ten times, three times and once the target pressure with the cell free in all three strains (`relaxation`);
settled tightly at the target pressure (`settling`). Coming from above spares the long creep of a packing that is
compressed through the onset of rigidity, and ends at the same coordination. What settles with so little drag must begin
near its pressure: one that springs back from ten times the pressure shakes the disks, and is denser afterwards.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import is_whole, number, numbers, whole
from granfabric.dem_ref.sample.disks import Sample, SampleError
from granfabric.dem_ref.sample.neighbours import find_near_pairs, spatial_order

from .relaxation import relax
from .settling import settle

INITIAL_SOLID_FRACTION = 0.86
PRESSURES = (10.0, 3.0, 1.0)
"""Over that of the packing: what it is relaxed to before it settles."""
LOOSE_TOLERANCE = 1.0e-2
TIGHT_TOLERANCE = 2.0e-5
MOST_STEPS_ABOVE, MOST_STEPS = 20_000, 2_000_000
BEFORE_SETTLING = 0.2
"""Fraction of a packing's progress."""
MOST_DISKS = 10_000_000
DISTRIBUTIONS = ("uniform", "uniform_area", "bidisperse", "monodisperse", "lognormal", "given")
LARGEST_RATIO = 5.0


class PackingError(RuntimeError):
    """The relaxation did not reach its tolerance within its steps."""


@dataclass(frozen=True)
class PackingOptions:
    """What defines a packing besides its number of disks and seed.

    Attributes
    ----------
    stiffness_to_pressure : float
        kn/p at the end.
    normal_stiffness : float
        kn, Pa.
    stiffness_ratio, friction : float
        kt/kn and mu after the packing has been made.
    diameter_ratio : float
        Largest over smallest diameter.
    distribution : str
        ``uniform`` by number, ``uniform_area`` (each diameter class has the same area), ``bidisperse`` (half and half
        by number), ``monodisperse``, ``lognormal`` by number, cut off at both ends by `diameter_ratio`, or ``given``.
    mean_diameter : float
        Mean diameter by number, m.
    size_deviation : float, optional
        Of ``lognormal``: standard deviation of ln(diameter) before it is cut off; a quarter of ln(diameter_ratio) if
        not given.
    grading : tuple of (float, float), optional
        Of ``given``: diameters [m] and passing fractions by number, ascending, from 0 to 1 (`read_grading`); takes the
        place of `diameter_ratio` and `mean_diameter`.
    preparation_friction : float, optional
        During compaction; without any if not given, at most `friction`.
    coordination, solid_fraction : float, optional
        Wanted: the friction during compaction that gives it is searched.
    counted : str, optional
        Whether rattlers count in `coordination`: ``"included"`` (if not given) or ``"excluded"``.
    """

    stiffness_to_pressure: float = 1.0e4
    normal_stiffness: float = 1.0e9
    stiffness_ratio: float = 1.0
    friction: float = 0.5
    diameter_ratio: float = 1.25
    distribution: str = "uniform"
    mean_diameter: float = 1.0
    size_deviation: float | None = None
    grading: tuple[tuple[float, float], ...] | None = None
    preparation_friction: float | None = None
    coordination: float | None = None
    solid_fraction: float | None = None
    counted: str | None = None

    def check(self) -> None:
        """Raise `SampleError` on the first value out of bounds."""
        if not isinstance(self.distribution, str) or self.distribution not in DISTRIBUTIONS:
            raise SampleError(f"distribution is '{self.distribution}', legal are {', '.join(DISTRIBUTIONS)}")
        bounds = {
            "stiffness_to_pressure": (50.0, 1.0e6), "normal_stiffness": (1e-300, 1e300), "stiffness_ratio": (1e-6, 1.0),
            "friction": (0.0, 1e3), "diameter_ratio": (1.0, LARGEST_RATIO), "mean_diameter": (1e-300, 1e300),
        }  # fmt: skip
        for name, (low, high) in bounds.items():
            number(name, getattr(self, name), low, high)
        wanted = {
            "size_deviation": (1e-6, 10.0), "preparation_friction": (0.0, 1e3), "coordination": (2.0, 6.0),
            "solid_fraction": (0.5, 1.0),
        }  # fmt: skip
        for name, (low, high) in wanted.items():
            if getattr(self, name) is not None:
                number(name, getattr(self, name), low, high)
        given = [name for name in PREPARATION if getattr(self, name) is not None]
        if len(given) > 1:
            raise SampleError(f"{' and '.join(given)} are given; one of them decides the friction during compaction")
        if self.preparation_friction is not None and self.preparation_friction > self.friction:
            raise SampleError(
                f"preparation_friction is {self.preparation_friction:g}, above the friction of {self.friction:g} "
                "afterwards: a packing falls together when its friction falls"
            )
        if self.counted is not None and str(self.counted) not in ("included", "excluded"):
            raise SampleError(f"counted is {self.counted!r}, legal are 'included' and 'excluded'")
        if (self.distribution == "given") != (self.grading is not None):
            raise SampleError("distribution = 'given' and a grading go together")
        if self.size_deviation is not None and self.distribution != "lognormal":
            raise SampleError(f"size_deviation goes with distribution = 'lognormal', not with {self.distribution!r}")
        _check_grading(self.grading)


PREPARATION = ("preparation_friction", "coordination", "solid_fraction")
"""Options of which one may be given."""


def _check_grading(grading: tuple[tuple[float, float], ...] | None) -> None:
    if grading is None:
        return
    points = numbers("grading", grading)
    shaped = points.ndim == 2 and points.shape[1] == 2 and len(points) >= 2 and bool(np.isfinite(points).all())
    if not shaped or (np.diff(points, axis=0) < 0.0).any() or points[0, 0] <= 0.0:
        raise SampleError("grading must be pairs of diameter > 0 and passing fraction, both ascending")
    if points[0, 1] != 0.0 or abs(points[-1, 1] - 1.0) > 1e-9 or points[-1, 0] > LARGEST_RATIO * points[0, 0]:
        raise SampleError(
            f"grading must run from passing 0 to 1, with diameters up to {LARGEST_RATIO:g} times the smallest"
        )


def _cut_lognormal(level: NDArray[np.float64], ratio: float, deviation: float | None) -> NDArray[np.float64]:
    """Diameters at the levels of a lognormal distribution between 1/sqrt(ratio) and sqrt(ratio)."""
    half = 0.5 * np.log(ratio)
    if half == 0.0:
        return np.ones(len(level))
    spread = NormalDist(0.0, 0.5 * half if deviation is None else deviation)
    low, high = spread.cdf(-half), spread.cdf(half)
    return np.exp([spread.inv_cdf(low + (high - low) * float(at)) for at in level])


def _diameters(count: int, options: PackingOptions) -> NDArray[np.float64]:
    """Ascending diameters of a sample, those of a given grading in its own unit."""
    ratio = options.diameter_ratio
    level = (np.arange(count) + 0.5) / count  # stratified: every sample has the same grading
    if options.distribution == "uniform":
        return 1.0 + (ratio - 1.0) * level
    if options.distribution == "uniform_area":
        # number density ~ 1/D^2
        return 1.0 / (1.0 - level * (1.0 - 1.0 / ratio))
    if options.distribution == "bidisperse":
        return np.where(level < 0.5, 1.0, ratio)
    if options.distribution == "lognormal":
        return _cut_lognormal(level, ratio, options.size_deviation)
    if options.distribution == "given":
        points = np.array(options.grading)
        return np.interp(level, points[:, 1], points[:, 0])
    return np.ones(count)


def random_diameters(count: int, options: PackingOptions, random: np.random.Generator) -> NDArray[np.float64]:
    """Diameters with mean 1 from the chosen distribution (inverse of its cumulative function, stratified)."""
    diameter = _diameters(count, options)
    return random.permutation(diameter / diameter.mean())


def mean_diameter_of(count: int, options: PackingOptions) -> float:
    """Mean diameter by number [m]: the option, or that of the given grading as a sample of `count` disks has it."""
    return options.mean_diameter if options.grading is None else float(_diameters(count, options).mean())


def make_packing(
    count: int,
    seed: int,
    options: PackingOptions | None = None,
    progress: Callable[[str, float], None] | None = None,
    threads: int | None = None,
) -> Sample:
    """A dense isotropic packing of `count` disks, compacted without friction, friction switched on afterwards.

    The same from the same `seed`; `preparation.compaction` has packings that are compacted with friction.

    Parameters
    ----------
    count : int
        Number of disks, at least 50.
    progress : callable, optional
        Called with a short text and a fraction between 0 and 1.
    threads : int, optional
        1 or 2; does not change the packing. Whichever is faster if not given.

    Raises
    ------
    SampleError
        On options out of bounds.
    PackingError
        If it does not come to rest within its steps.
    """
    options = options or PackingOptions()
    options.check()
    for name in PREPARATION:
        if getattr(options, name):
            raise SampleError(f"{name} needs a compaction with friction, which this recipe does not have")
    if not (is_whole(count) and count >= 50):
        raise SampleError(f"the number of disks is {count}, legal are whole numbers >= 50")
    count = whole("the number of disks", count, 50, MOST_DISKS)
    seed = whole("seed", seed, 0, 2**63 - 1)
    threads = None if threads is None else whole("threads", threads, 1, 2)
    report = progress or (lambda text, fraction: None)
    random = np.random.default_rng(seed)
    radius = 0.5 * random_diameters(int(count), options, random)
    solid = float(np.pi * np.sum(radius**2))
    width = np.sqrt(solid / INITIAL_SOLID_FRACTION)
    cell = width * np.eye(2)
    position = random.random((int(count), 2)) * width
    position, radius = in_spatial_order(position, radius, cell)
    report("relaxing random disks", 0.0)
    relax(position, radius, cell, 0.0, tolerance=LOOSE_TOLERANCE, steps=2000, fixed_cell=True)
    pressure = 1.0 / options.stiffness_to_pressure
    for stage, factor in enumerate(PRESSURES):
        position, radius = in_spatial_order(position, radius, cell)
        report("lowering the pressure", 0.05 * (stage + 1))
        relax(position, radius, cell, factor * pressure, LOOSE_TOLERANCE, MOST_STEPS_ABOVE)
    position, radius = in_spatial_order(position, radius, cell)
    report("settling at the target pressure", BEFORE_SETTLING)

    def watched(way: float, unbalanced: float) -> None:
        report(f"settling, unbalanced force {unbalanced:.0e}", BEFORE_SETTLING + (1.0 - BEFORE_SETTLING) * way)

    settled = settle(position, radius, cell, pressure, TIGHT_TOLERANCE, MOST_STEPS, threads=threads, progress=watched)
    if not settled.converged:
        raise PackingError(
            f"the packing of {count} disks, seed {seed}, is not at rest: unbalanced force {settled.unbalanced:.2g}"
        )
    report("packed", 1.0)
    scale = mean_diameter_of(count, options)
    position, radius = in_spatial_order(position, radius, cell)
    pairs = find_near_pairs(scale * position, scale * radius, scale * cell, 0.03 * scale)
    zero = np.zeros((int(count), 2))
    return Sample(
        scale * position, scale * radius, scale * cell, options.normal_stiffness, options.stiffness_ratio,
        options.friction, zero, np.zeros(int(count)), pairs, seed=int(seed),
    )  # fmt: skip


def in_spatial_order(
    position: NDArray[np.float64], radius: NDArray[np.float64], cell: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions, shape (n, 2), and radii, shape (n,) [m], in an order in which neighbours lie near in memory."""
    order = spatial_order(position, cell, 1.2)
    return np.ascontiguousarray(position[order]), np.ascontiguousarray(radius[order])
