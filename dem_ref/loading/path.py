"""Loading paths as plain data, and the standard ones."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from granfabric.dem_ref.arrays import is_within
from granfabric.dem_ref.sample.disks import SampleError

from .legs import Leg, biaxial_leg, invariant_leg, mixed_leg

KINDS = ("biaxial", "invariants", "mixed")


@dataclass(frozen=True)
class Segment:
    """One part of a loading path, as plain data.

    Attributes
    ----------
    kind : str
        ``"biaxial"`` driven by strain, ends at `stress_ratio` or `shear_strain`, whichever comes first;
        ``"invariants"`` moves p, q and the direction; ``"mixed"`` prescribes stress or strain per component.
    path : str
        biaxial: ``"constant_pressure"``, ``"constant_lateral_stress"`` or ``"constant_volume"``.
    shear_strain : float
        biaxial: change of eps_1 - eps_2 (constant pressure or volume) or of the axial strain (constant lateral stress),
        positive in compression along `angle`; negative unloads.
    stress_ratio : float or None
        biaxial: signed q/p along `angle` at which to stop; invariants: q over p at the end.
    pressure : float
        invariants: p at the end over p at the start of the run.
    angle : float
        Direction of the (major compressive) axis from the x axis, radians.
    control, target
        mixed: ``"stress"``/``"strain"`` and targets per component xx, yy, xy (tension positive, engineering shear
        strain).
    relative : bool
        mixed: targets count from stress and strain at the start of the segment.
    """

    kind: str = "biaxial"
    path: str = "constant_pressure"
    shear_strain: float = 5.0e-3
    stress_ratio: float | None = 0.3
    pressure: float = 1.0
    angle: float = np.pi / 2
    control: tuple[str, str, str] = ("stress", "stress", "stress")
    target: tuple[float, float, float] = (0.0, 0.0, 0.0)
    relative: bool = False

    def __post_init__(self) -> None:
        for name in ("shear_strain", "stress_ratio", "pressure", "angle"):
            value = getattr(self, name)
            # NaN is passed without being noticed: the leg would go on to its largest strain
            if not (name == "stress_ratio" and value is None) and not is_within(value, -1e300, 1e300):
                raise SampleError(f"{name} of a segment is {value!r}, not a finite number")
        for name in ("control", "target"):
            value = getattr(self, name)
            if not isinstance(value, str) and isinstance(value, Iterable):
                object.__setattr__(self, name, tuple(value))  # which may be read only once

    def leg(self, initial_pressure: float) -> Leg:
        """The leg that this segment describes."""
        if self.kind == "biaxial":
            return biaxial_leg(self.path, self.shear_strain, self.stress_ratio, self.angle)
        if self.kind == "invariants":
            p = self.pressure * initial_pressure
            return invariant_leg(p, (self.stress_ratio or 0.0) * p, self.angle)
        if self.kind == "mixed":
            return mixed_leg(self.control, self.target, relative=self.relative)
        raise SampleError(f"the kind of a segment is '{self.kind}', legal are {', '.join(KINDS)}")


def biaxial_test(
    path: str = "constant_pressure", stress_ratio: float = 0.3, shear_strain: float = 5.0e-3
) -> list[Segment]:
    """Biaxial compression along y to a stress ratio (or a strain, if that comes first)."""
    return [Segment("biaxial", path, shear_strain, stress_ratio)]


def loading_cycles(stress_ratio: float = 0.2, cycles: int = 1, path: str = "constant_pressure") -> list[Segment]:
    """0 -> stress_ratio -> 0, `cycles` times, then once more to stress_ratio."""
    up, down = Segment("biaxial", path, 0.02, stress_ratio), Segment("biaxial", path, -0.02, 0.0)
    return [up, down] * cycles + [up]


def principal_rotation(stress_ratio: float = 0.2, turns: float = 0.5, parts: int = 1) -> list[Segment]:
    """Loading at constant p to a stress ratio, then its axes turned by `turns` x 360 degrees at constant q/p."""
    start = np.pi / 2
    load = [Segment("invariants", stress_ratio=stress_ratio, angle=start)]
    steps = max(parts, int(np.ceil(abs(turns) * 8)))  # an eighth of a turn at most, so that the direction is unique
    return load + [
        Segment("invariants", stress_ratio=stress_ratio, angle=start + 2 * np.pi * turns * (k + 1) / steps)
        for k in range(steps)
    ]
