"""From the legs of a DEM scene to the segments of a DEM run."""

from __future__ import annotations

from math import atan2, ceil, cos, degrees, hypot, radians, sin
from pathlib import Path
from typing import Any

from granfabric.dem_ref.dynamics.packing import PackingOptions
from granfabric.dem_ref.loading.path import Segment
from granfabric.dem_ref.loading.run import RunOptions
from granfabric.dem_ref.loading.servo import RateLimits
from granfabric.dem_ref.preparation.grading import read_grading
from granfabric.dem_ref.sample.disks import SampleError

from .schema_dem import DemLeg

LARGEST_STRAIN = 0.02
LARGEST_TURN = 45.0
"""Degrees; a turn is cut into pieces that have only one shorter way round."""

DRIVEN = ("constant_pressure", "constant_lateral_stress")


class PathError(ValueError):
    """A leg does not follow from the one before; the text says which and why."""


class _Stress:
    """The stress that the legs so far have asked for: pressure over the initial one, and the stress ratio vector.

    The vector lies in the double-angle plane; None where a leg by strain leaves the stress unknown.
    """

    def __init__(self, initial_pressure: float) -> None:
        self.initial_pressure = initial_pressure
        self.pressure = 1.0
        self.ratio: tuple[float, float] | None = (0.0, 0.0)
        self.direction = 90.0

    def along(self, direction: float) -> tuple[float, float]:
        """Components of the stress ratio vector along and across a direction [degree]."""
        if self.ratio is None:
            raise PathError("the stress at the start of this leg is not known beforehand; use loading = 'components'")
        c, s = cos(2 * radians(direction)), sin(2 * radians(direction))
        return self.ratio[0] * c + self.ratio[1] * s, self.ratio[1] * c - self.ratio[0] * s

    def set(self, pressure: float, along: float, across: float, direction: float) -> None:
        """Take over the stress at the end of a leg."""
        c, s = cos(2 * radians(direction)), sin(2 * radians(direction))
        self.pressure, self.direction = pressure, direction
        self.ratio = (along * c - across * s, along * s + across * c)

    def components(self) -> tuple[float, float, float] | None:
        """Stress xx, yy, xy [Pa], tension positive; None where it is not known beforehand."""
        if self.ratio is None:
            return None
        p = self.pressure * self.initial_pressure
        return -p * (1.0 + self.ratio[0]), -p * (1.0 - self.ratio[0]), -p * self.ratio[1]

    def known(self) -> tuple[float, float]:
        """Magnitude of the stress ratio and its direction [degree]; without a deviator that of the leg before."""
        self.along(0.0)
        assert self.ratio is not None
        size = hypot(*self.ratio)
        if size < 1e-9:
            return 0.0, self.direction
        return size, 0.5 * degrees(atan2(self.ratio[1], self.ratio[0])) % 180.0


def _driven(leg: DemLeg, stress: _Stress) -> list[Segment]:
    direction = stress.direction if leg.direction_degrees is None else leg.direction_degrees
    along, across = stress.along(direction)
    assert leg.stress_ratio is not None
    if abs(leg.stress_ratio - along) < 1e-6:
        raise PathError(f"stress_ratio = {leg.stress_ratio:g} is where the leg begins; the loading has no sense")
    sense = 1.0 if leg.stress_ratio > along else -1.0
    strain = LARGEST_STRAIN if leg.largest_strain is None else leg.largest_strain
    pressure = stress.pressure
    if leg.loading == "constant_lateral_stress":
        pressure *= (1.0 - along) / (1.0 - leg.stress_ratio)
    stress.set(pressure, leg.stress_ratio, across * stress.pressure / pressure, direction)
    return [Segment("biaxial", leg.loading, sense * strain, leg.stress_ratio, angle=radians(direction))]


def _invariants(leg: DemLeg, stress: _Stress) -> list[Segment]:
    if leg.loading == "isotropic":
        pressure, ratio, direction = leg.pressure_ratio, 0.0, stress.direction
    elif None in (leg.pressure_ratio, leg.stress_ratio, leg.direction_degrees):
        size, at = stress.known()
        pressure = stress.pressure if leg.pressure_ratio is None else leg.pressure_ratio
        ratio = size if leg.stress_ratio is None else leg.stress_ratio
        direction = at if leg.direction_degrees is None else leg.direction_degrees
    else:
        assert leg.stress_ratio is not None and leg.direction_degrees is not None
        pressure, ratio, direction = leg.pressure_ratio, leg.stress_ratio, leg.direction_degrees
    assert pressure is not None
    stress.set(pressure, ratio, 0.0, direction)
    angle = radians(direction if ratio >= 0.0 else direction + 90.0)
    return [Segment("invariants", pressure=pressure, stress_ratio=abs(ratio), angle=angle)]


def _rotation(leg: DemLeg, stress: _Stress) -> list[Segment]:
    size, start = stress.known()
    if size == 0.0:
        raise PathError("there is no deviator to rotate: the stress at the start of this leg is isotropic")
    assert leg.rotation_degrees is not None
    parts = ceil(abs(leg.rotation_degrees) / LARGEST_TURN)
    angles = [start + leg.rotation_degrees * (part + 1) / parts for part in range(parts)]
    stress.set(stress.pressure, size, 0.0, angles[-1])
    return [
        Segment("invariants", pressure=stress.pressure, stress_ratio=size, angle=radians(angle)) for angle in angles
    ]


def _components(leg: DemLeg, stress: _Stress) -> list[Segment]:
    assert leg.control is not None and leg.target is not None
    control, target = leg.control, leg.target
    start = stress.components() if leg.relative else (0.0, 0.0, 0.0)
    whole = all(entry == "stress" for entry in control)
    if start is not None and whole:
        xx, yy, xy = (before + change for before, change in zip(start, target))
        p = -(xx + yy) / 2
        q = hypot((xx - yy) / 2, xy)
        if p > q:
            stress.set(p / stress.initial_pressure, -(xx - yy) / 2 / p, -xy / p, 0.0)
            stress.direction = stress.known()[1]
        elif leg.relative:  # a leg before may end elsewhere than asked for, so that only the run can tell
            stress.ratio = None
        else:
            raise PathError(
                f"the target stress must be compressive in every direction: p = {p:g} Pa is not above q = {q:g} Pa"
            )
    else:
        for axis, entry, value in zip("xy", control, target):
            if entry == "stress" and not leg.relative and not value < 0.0:
                raise PathError(
                    f"a stress of {value:g} Pa along {axis} is not compressive: the sample would lose its pressure "
                    "(tension is positive)"
                )
        stress.ratio = None
    made = (target[0], target[1], target[2])
    return [Segment("mixed", control=(control[0], control[1], control[2]), target=made, relative=leg.relative)]


def segments(scene: Any) -> tuple[Segment, ...]:
    """Segments of a checked DEM scene.

    Raises
    ------
    PathError
        If a leg does not follow from the one before.
    """
    return tuple(segment for _, segment in _numbered(scene))


def leg_numbers(scene: Any) -> list[int]:
    """Number, from 1, of the leg that each segment belongs to; a rotation has several."""
    return [number for number, _ in _numbered(scene)]


def _numbered(scene: Any) -> list[tuple[int, Segment]]:
    stress = _Stress(scene.packing.normal_stiffness / scene.packing.stiffness_to_pressure)
    made: list[tuple[int, Segment]] = []
    for place, leg in enumerate(scene.path):
        build = {"isotropic": _invariants, "invariants": _invariants, "rotation": _rotation, "components": _components}
        try:
            made += [(place + 1, segment) for segment in build.get(leg.loading, _driven)(leg, stress)]
        except PathError as error:
            raise PathError(f"path {place + 1}: {error}") from None
    return made


def run_options(scene: Any) -> RunOptions:
    """Options of the DEM run of a scene; two equal sets continue each other's checkpoints."""
    return RunOptions(
        segments(scene),
        RateLimits(scene.rates.inertial_number, scene.rates.unbalanced_force),
        scene.output.stress_step,
        scene.output.strain_step,
    )


def packing_options(scene: Any, folder: Path = Path()) -> PackingOptions:
    """Options of the packing of a scene, besides its number of disks and seed; a grading is read from its file.

    Parameters
    ----------
    scene : DemScene
    folder : Path
        Of the scene, to which the file of a grading is relative.

    Raises
    ------
    PathError
        If that file holds no grading.
    """
    options = scene.packing.model_dump(exclude={"particles", "seed", "grading_file"})
    if scene.packing.coordination is not None:
        options["counted"] = scene.measure.rattlers if hasattr(scene, "measure") else "included"
    if scene.packing.grading_file is not None:
        try:
            options["grading"] = read_grading(folder / Path(scene.packing.grading_file).expanduser())
        except SampleError as error:
            raise PathError(str(error)) from error
    return PackingOptions(**options)
