"""Packings: random disks, relaxed without friction to an isotropic stress, friction switched on afterwards.

Recipe: disks at random in a cell at a solid fraction above random close packing; relaxed at fixed cell; relaxed to ten
times the target pressure with the cell free in all three strains; pressure lowered in steps of 0.7 to the target, each
step relaxed loosely, the last one tightly. Coming from above spares the long creep of a packing that is compressed
through the onset of rigidity, and ends at the same coordination.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import is_whole, number, whole
from granfabric.dem_ref.sample.disks import Sample, SampleError
from granfabric.dem_ref.sample.neighbours import find_near_pairs, spatial_order

from .relaxation import relax

INITIAL_SOLID_FRACTION = 0.86
OVERPRESSURE = 10.0
PRESSURE_FACTOR = 0.7
LOOSE_TOLERANCE = 1.0e-2
TIGHT_TOLERANCE = 2.0e-5
MOST_DISKS = 10_000_000
DISTRIBUTIONS = ("uniform", "uniform_area", "bidisperse", "monodisperse")


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
        by number), ``monodisperse``.
    mean_diameter : float
        Mean diameter by number, m.
    """

    stiffness_to_pressure: float = 1.0e4
    normal_stiffness: float = 1.0e9
    stiffness_ratio: float = 1.0
    friction: float = 0.5
    diameter_ratio: float = 1.25
    distribution: str = "uniform"
    mean_diameter: float = 1.0

    def check(self) -> None:
        """Raise `SampleError` on the first value out of bounds."""
        if not isinstance(self.distribution, str) or self.distribution not in DISTRIBUTIONS:
            raise SampleError(f"distribution is '{self.distribution}', legal are {', '.join(DISTRIBUTIONS)}")
        bounds = {
            "stiffness_to_pressure": (50.0, 1.0e6), "normal_stiffness": (1e-300, 1e300), "stiffness_ratio": (1e-6, 1.0),
            "friction": (0.0, 1e3), "diameter_ratio": (1.0, 5.0), "mean_diameter": (1e-300, 1e300),
        }  # fmt: skip
        for name, (low, high) in bounds.items():
            number(name, getattr(self, name), low, high)


def random_diameters(count: int, options: PackingOptions, random: np.random.Generator) -> NDArray[np.float64]:
    """Diameters with mean 1 from the chosen distribution (inverse of its cumulative function, stratified)."""
    ratio = options.diameter_ratio
    level = (np.arange(count) + 0.5) / count  # stratified: every sample has the same grading
    if options.distribution == "uniform":
        diameter = 1.0 + (ratio - 1.0) * level
    elif options.distribution == "uniform_area":
        # number density ~ 1/D^2
        diameter = 1.0 / (1.0 - level * (1.0 - 1.0 / ratio))
    elif options.distribution == "bidisperse":
        diameter = np.where(level < 0.5, 1.0, ratio)
    else:
        diameter = np.ones(count)
    return random.permutation(diameter / diameter.mean())


def make_packing(
    count: int,
    seed: int,
    options: PackingOptions | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Sample:
    """A dense isotropic packing of `count` disks, reproducible from `seed`, with friction switched on.

    Parameters
    ----------
    count : int
        Number of disks, at least 50.
    progress : callable, optional
        Called with a short text and a fraction between 0 and 1.

    Raises
    ------
    SampleError
        On options out of bounds.
    PackingError
        If the last relaxation does not reach its tolerance.
    """
    options = options or PackingOptions()
    options.check()
    if not (is_whole(count) and count >= 50):
        raise SampleError(f"the number of disks is {count}, legal are whole numbers >= 50")
    count = whole("the number of disks", count, 50, MOST_DISKS)
    seed = whole("seed", seed, 0, 2**63 - 1)
    report = progress or (lambda text, fraction: None)
    random = np.random.default_rng(seed)
    radius = 0.5 * random_diameters(int(count), options, random)
    solid = float(np.pi * np.sum(radius**2))
    width = np.sqrt(solid / INITIAL_SOLID_FRACTION)
    cell = width * np.eye(2)
    position = random.random((int(count), 2)) * width
    position, radius = _sorted(position, radius, cell)
    report("relaxing random disks", 0.0)
    relax(position, radius, cell, 0.0, tolerance=LOOSE_TOLERANCE, steps=2000, fixed_cell=True)
    final = 1.0 / options.stiffness_to_pressure
    pressure = OVERPRESSURE * final
    stages = int(np.ceil(np.log(OVERPRESSURE) / -np.log(PRESSURE_FACTOR)))
    for stage in range(stages + 1):
        position, radius = _sorted(position, radius, cell)
        last = stage == stages
        report("lowering the pressure" if not last else "relaxing at the target pressure", (stage + 1) / (stages + 2))
        relaxed = relax(
            position, radius, cell, final if last else pressure, tolerance=TIGHT_TOLERANCE if last else LOOSE_TOLERANCE,
            steps=400_000 if last else 20_000,
        )  # fmt: skip
        pressure *= PRESSURE_FACTOR
    if not relaxed.converged:
        raise PackingError(
            f"the packing of {count} disks, seed {seed}, is not at rest: unbalanced force {relaxed.unbalanced:.2g}"
        )
    report("packed", 1.0)
    scale = options.mean_diameter
    position, radius = _sorted(position, radius, cell)
    pairs = find_near_pairs(scale * position, scale * radius, scale * cell, 0.03 * scale)
    zero = np.zeros((int(count), 2))
    return Sample(
        scale * position, scale * radius, scale * cell, options.normal_stiffness, options.stiffness_ratio,
        options.friction, zero, np.zeros(int(count)), pairs, seed=int(seed),
    )  # fmt: skip


def _sorted(
    position: NDArray[np.float64], radius: NDArray[np.float64], cell: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    order = spatial_order(position, cell, 1.2)
    return np.ascontiguousarray(position[order]), np.ascontiguousarray(radius[order])
