"""Loading of a periodic sample along paths of stress and strain by a servo on the cell's three strain components.

A *leg* fixes in each of three directions of stress/strain space either the stress or the strain, and moves the fixed
values from where the sample is to a target. Strain increments are conjugate to stresses, so directions are orthonormal
in the six-vector sense: order xx, yy, xy with the shear component times sqrt(2).

Quasi-static by measure: the progress along a leg is slowed down or speeded up so that the inertial number and the
unbalanced force stay at or below their limits; both are recorded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import cos, hypot, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from dem_ref.motion import Control, Motion
from dem_ref.sample import SampleError

ROOT2 = sqrt(2.0)
ISOTROPIC = np.array([1.0, 1.0, 0.0]) / ROOT2
DEVIATORIC = np.array([1.0, -1.0, 0.0]) / ROOT2
SHEAR = np.array([0.0, 0.0, 1.0])
COMPONENTS = np.eye(3)


@dataclass(frozen=True)
class RateLimits:
    """How slow the loading is.

    Attributes
    ----------
    inertial_number : float
        Upper limit of ``sqrt(2 e:e) sqrt(m/p)``.
    unbalanced_force : float
        Limit of the root mean square resultant over the mean contact force; the rate is adapted to stay below.
    response : float
        Time in steps in which the servo corrects a stress error.
    lag : float
        Largest distance, over p, between the stress asked for and the stress reached; the path waits beyond it.
    chunk : int
        Steps between two adaptations.
    """

    inertial_number: float = 1.0e-5
    unbalanced_force: float = 3.0e-4
    response: float = 40.0
    lag: float = 5.0e-3
    chunk: int = 40

    def check(self) -> None:
        """Raise `SampleError` on the first value out of bounds."""
        bounds = {
            "inertial_number": (1e-12, 0.1), "unbalanced_force": (1e-8, 1.0), "response": (5.0, 1e5),
            "lag": (1e-6, 1.0), "chunk": (1, 100_000),
        }  # fmt: skip
        for name, (low, high) in bounds.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise SampleError(f"rate limit {name} is {value}, legal are {low:g} to {high:g}")


@dataclass
class Leg:
    """One leg of a path.

    Attributes
    ----------
    directions : (3, 3)
        Orthonormal rows in the space (xx, yy, sqrt(2) xy).
    strain_controlled : (3,) bool
        For each direction: strain (True) or stress (False) is prescribed.
    values : callable
        ``values(s, start_stress, start_strain)`` for s in [0, 1]: the prescribed values in the three directions, the
        strain-controlled ones as strain, the others as stress; starts at the start.
    stop : callable, optional
        Ends the leg early when true; called with the current stress and strain (xx, yy, xy).
    hold : bool
        At the end wait until stress and unbalanced force have settled.
    """

    directions: NDArray[np.float64]
    strain_controlled: Sequence[bool]
    values: Callable[[float, NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]
    stop: Callable[[NDArray[np.float64], NDArray[np.float64]], bool] | None = None
    hold: bool = True


def to_vector(tensor: NDArray[np.float64]) -> NDArray[np.float64]:
    """(xx, yy, xy) to (xx, yy, sqrt(2) xy)."""
    return np.array([tensor[0], tensor[1], ROOT2 * tensor[2]])


def from_vector(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """(xx, yy, sqrt(2) xy) to (xx, yy, xy)."""
    return np.array([vector[0], vector[1], vector[2] / ROOT2])


def stress_invariants(stress: NDArray[np.float64]) -> tuple[float, float, float]:
    """p, q (compression positive p, q >= 0) and the angle of the major compressive stress from the x axis."""
    p = -0.5 * (stress[0] + stress[1])
    dx, dy = -0.5 * (stress[0] - stress[1]), -stress[2]
    return float(p), float(hypot(dx, dy)), float(0.5 * np.arctan2(dy, dx))


def stress_from_invariants(p: float, q: float, angle: float) -> NDArray[np.float64]:
    """Tension-positive (xx, yy, xy) from p, q and the angle of the major compressive stress from the x axis."""
    return -np.array([p + q * cos(2 * angle), p - q * cos(2 * angle), q * sin(2 * angle)])


def stress_leg(target: Sequence[float], hold: bool = True) -> Leg:
    """Straight stress path to `target` (xx, yy, xy; Pa, tension positive)."""
    end = to_vector(_three(target, "target stress"))
    return Leg(
        COMPONENTS, (False, False, False), lambda s, stress, strain: (1 - s) * to_vector(stress) + s * end, None, hold
    )


def invariant_leg(p: float, q: float, angle: float, hold: bool = True) -> Leg:
    """Path linear in p, q and direction to the given values; turns the principal axes if `angle` differs.

    Parameters
    ----------
    p, q : float
        Pa; p > q >= 0.
    angle : float
        Direction of the major compressive stress from the x axis, radians. The axes turn the shorter way, so that one
        leg turns them by a right angle at most. From an isotropic state the path starts in the final direction.
    """
    if not (np.isfinite([p, q, angle]).all() and p > q >= 0.0):
        raise SampleError(f"the target p = {p}, q = {q} is not a compressive stress with p > q >= 0")

    def values(s: float, stress: NDArray[np.float64], strain: NDArray[np.float64]) -> NDArray[np.float64]:
        p0, q0, angle0 = stress_invariants(stress)
        if q0 < 1e-3 * p0 or q == 0.0:
            start = to_vector(stress)
            return (1 - s) * start + s * to_vector(stress_from_invariants(p, q, angle))
        turn = angle - angle0
        turn -= pi * round(turn / pi)
        at = stress_from_invariants(p0 + s * (p - p0), q0 + s * (q - q0), angle0 + s * turn)
        return to_vector(at)

    return Leg(COMPONENTS, (False, False, False), values, None, hold)


def mixed_leg(control: Sequence[str], target: Sequence[float], hold: bool = True) -> Leg:
    """Per component (xx, yy, xy) either ``"stress"`` or ``"strain"`` moved straight to its target.

    `target` is tension positive, shear strain as engineering strain, strains absolute (not increments).
    """
    if len(control) != 3 or any(c not in ("stress", "strain") for c in control):
        raise SampleError(f"control is {list(control)}, legal are three of 'stress', 'strain'")
    strain_controlled = tuple(c == "strain" for c in control)
    end = _three(target, "target")
    if strain_controlled[2]:
        end[2] *= 0.5
    end = to_vector(end)

    def values(s: float, stress: NDArray[np.float64], strain: NDArray[np.float64]) -> NDArray[np.float64]:
        start = np.where(strain_controlled, to_vector(strain), to_vector(stress))
        return (1 - s) * start + s * end

    return Leg(COMPONENTS, strain_controlled, values, None, hold)


def biaxial_leg(
    path: str, shear_strain: float, stress_ratio: float | None = None, angle: float = pi / 2, hold: bool = False
) -> Leg:
    """Biaxial loading driven by strain, so that it can pass a peak.

    Parameters
    ----------
    path : str
        ``"constant_pressure"``: p and the shear stress across the axes keep their values, the deviatoric strain is
        driven. ``"constant_lateral_stress"``: the stress across the axis keeps its value, the axial strain is driven.
    shear_strain : float
        Change of the driven strain at the end of the leg, positive for compression along the axis: of eps_1 - eps_2
        at constant pressure, of the axial strain at constant lateral stress. Negative unloads.
    stress_ratio : float, optional
        Stop when q/p, with the sign of loading along the axis, passes this value.
    angle : float
        Direction of the axis from the x axis, radians; pi/2 compresses along y.
    """
    c2, s2 = cos(2 * angle), sin(2 * angle)
    deviator = c2 * DEVIATORIC + s2 * SHEAR
    across = -s2 * DEVIATORIC + c2 * SHEAR
    if path == "constant_pressure":
        directions = np.array([deviator, ISOTROPIC, across])
        length = shear_strain / ROOT2  # deviatoric six-vector of a given eps_1 - eps_2
    elif path == "constant_lateral_stress":
        directions = np.array([(ISOTROPIC + deviator) / ROOT2, (ISOTROPIC - deviator) / ROOT2, across])
        length = shear_strain
    else:
        raise SampleError(f"path is '{path}', legal are 'constant_pressure' and 'constant_lateral_stress'")

    def values(s: float, stress: NDArray[np.float64], strain: NDArray[np.float64]) -> NDArray[np.float64]:
        at = directions @ to_vector(stress)
        at[0] = directions[0] @ to_vector(strain) - s * length
        return at

    stop = None
    if stress_ratio is not None:
        limit, sign = float(stress_ratio), 1.0 if shear_strain >= 0.0 else -1.0

        def stop(stress: NDArray[np.float64], strain: NDArray[np.float64]) -> bool:
            return sign * (axial_stress_ratio(stress, angle) - limit) >= 0.0

    return Leg(directions, (True, False, False), values, stop, hold)


def axial_stress_ratio(stress: NDArray[np.float64], angle: float) -> float:
    """q/p with the sign of loading along the axis at `angle`: ``(s_axial - s_lateral)/(2 p)``, compression positive."""
    p = -0.5 * (stress[0] + stress[1])
    return float((-0.5 * (stress[0] - stress[1]) * cos(2 * angle) - stress[2] * sin(2 * angle)) / p)


def _three(values: Sequence[float], what: str) -> NDArray[np.float64]:
    array = np.array(values, dtype=np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise SampleError(f"{what} must be three finite numbers xx, yy, xy; got {values}")
    return array


def elastic_estimate(motion: Motion) -> NDArray[np.float64]:
    """Stiffness for the servo in the space (xx, yy, sqrt(2) xy): uniform-strain moduli, shear softened by a quarter."""
    sample = motion.sample
    z = 2.0 * max(float(motion.measures[5]), 0.5 * sample.count) / sample.count
    kn, kt = sample.normal_stiffness, sample.normal_stiffness * sample.stiffness_ratio
    bulk = z * sample.solid_fraction * kn / (2.0 * pi)
    shear = 0.75 * z * sample.solid_fraction * (kn + kt) / (4.0 * pi)
    return 2.0 * bulk * np.outer(ISOTROPIC, ISOTROPIC) + 2.0 * shear * (np.eye(3) - np.outer(ISOTROPIC, ISOTROPIC))


@dataclass
class LegState:
    """Where a loading is within its leg; with the sample all that is needed to go on."""

    progress: float = 0.0
    pace: float = 0.0
    settled: float = 0.0
    start_stress: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    start_strain: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    target: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    inertial_number: float = 0.0
    unbalanced_force: float = 0.0

    def to_array(self) -> NDArray[np.float64]:
        """All numbers in one array, for a checkpoint."""
        head = [self.progress, self.pace, self.settled, self.inertial_number, self.unbalanced_force]
        return np.concatenate([head, self.start_stress, self.start_strain, self.target])

    @staticmethod
    def from_array(a: NDArray[np.float64]) -> LegState:
        """Inverse of `to_array`."""
        if a.shape != (14,):
            raise SampleError(f"a stored state of a leg has 14 numbers, not {a.shape}")
        progress, pace, settled, inertial_number, unbalanced = (float(v) for v in a[:5])
        vectors = (a[5:8].copy(), a[8:11].copy(), a[11:14].copy())
        return LegState(progress, pace, settled, *vectors, inertial_number, unbalanced)


GROWTH, CUT = 1.25, 0.5
SETTLED_CHUNKS = 5.0


class Loading:
    """Moves a sample along one leg, chunk by chunk."""

    def __init__(
        self, motion: Motion, leg: Leg, limits: RateLimits | None = None, state: LegState | None = None
    ) -> None:
        self.motion = motion
        self.leg = leg
        self.limits = limits or RateLimits()
        self.limits.check()
        if not np.any(motion.stress):
            measure_stress(motion)
        if state is None:
            state = LegState(start_stress=motion.stress.copy(), start_strain=motion.sample.strain.copy())
            state.target = self._values(0.0, state)
        self.state = state

    def _values(self, progress: float, state: LegState) -> NDArray[np.float64]:
        return np.asarray(self.leg.values(progress, state.start_stress, state.start_strain), dtype=np.float64)

    def _pressure(self) -> float:
        stress = self.motion.stress
        return max(-0.5 * (stress[0] + stress[1]), 1e-12 * self.motion.sample.normal_stiffness)

    def _strain_of(self, change: NDArray[np.float64], compliance: NDArray[np.float64]) -> float:
        """Size sqrt(2 e:e) of the strain that a change of the prescribed values asks for."""
        controlled = np.asarray(self.leg.strain_controlled)
        strain = np.where(controlled, change, 0.0)
        if not controlled.all():
            free = ~controlled
            strain[free] = compliance[free][:, free] @ change[free]
        return ROOT2 * float(np.linalg.norm(strain))

    def advance(self) -> bool:
        """One chunk of steps; False when the leg is at its end."""
        motion, leg, limits, state = self.motion, self.leg, self.limits, self.state
        q = np.asarray(leg.directions, dtype=np.float64)
        controlled = np.asarray(leg.strain_controlled, dtype=bool)
        free = ~controlled
        stiffness = q @ elastic_estimate(motion) @ q.T
        pressure = self._pressure()
        compliance = np.zeros((3, 3))
        if free.any():
            compliance[np.ix_(free, free)] = np.linalg.inv(stiffness[np.ix_(free, free)])
        now = q @ to_vector(motion.stress)
        error = float(np.linalg.norm((state.target - now)[free])) if free.any() else 0.0
        unit_rate = limits.inertial_number * motion.step * sqrt(pressure / motion.sample.normal_stiffness)
        ahead = state.progress
        if ahead < 1.0 and error <= limits.lag * pressure:
            probe = min(ahead + 1e-4, 1.0)
            per_progress = self._strain_of(self._values(probe, state) - state.target, compliance) / (probe - ahead)
            if state.pace == 0.0:
                state.pace = 0.1 * unit_rate
            ahead = min(1.0, ahead + limits.chunk * min(state.pace, unit_rate) / max(per_progress, 1e-300))
        goal = self._values(ahead, state)
        rate = (goal - state.target) / limits.chunk
        drive = np.where(controlled, rate, 0.0)
        coupled = stiffness[np.ix_(free, controlled)] @ drive[controlled]
        drive[free] = compliance[np.ix_(free, free)] @ (rate[free] - coupled)
        gain = compliance / limits.response
        # from directions to components: strain six-vector = q^T (.), stress in directions = q (six-vector)
        scale = np.array([1.0, 1.0, ROOT2])
        gain_components = (q.T @ gain @ q) / scale[:, None] * scale[None, :]
        target = np.where(free, state.target, 0.0)
        control = Control(
            drive=from_vector(q.T @ drive),
            gain=gain_components,
            target=from_vector(q.T @ target),
            target_rate=from_vector(q.T @ np.where(free, rate, 0.0)),
            fastest_rate=4.0 * unit_rate / ROOT2,
        )
        before = motion.sample.strain.copy()
        motion.run(limits.chunk, control)
        state.progress = ahead
        state.target = goal
        mean_rate = (motion.sample.strain - before) / limits.chunk
        state.inertial_number = motion.inertial_number(mean_rate, pressure)
        state.unbalanced_force = motion.unbalanced_force
        worst = max(
            state.unbalanced_force / limits.unbalanced_force, state.inertial_number / limits.inertial_number, 1e-3
        )
        # aim at 0.8 of the limit; grow gently, cut at once
        state.pace = min(unit_rate, state.pace * min(GROWTH, max(CUT, 0.8 / worst)))
        if leg.stop is not None and leg.stop(motion.stress, motion.sample.strain):
            return False
        if state.progress < 1.0:
            return True
        if not leg.hold:
            return False
        now = q @ to_vector(motion.stress)
        error = float(np.linalg.norm((goal - now)[free])) if free.any() else 0.0
        calm = error < 2e-4 * pressure and state.unbalanced_force < 0.2 * limits.unbalanced_force
        state.settled = state.settled + 1.0 if calm else 0.0
        return state.settled < SETTLED_CHUNKS

    def run(self, steps: int = 10_000_000, observe: Callable[[Loading], bool | None] | None = None) -> bool:
        """Advance to the end of the leg, or until `observe` returns True; False when the steps were not enough."""
        last = self.motion.steps_done + steps
        while self.motion.steps_done < last:
            if not self.advance():
                return True
            if observe is not None and observe(self):
                return True
        return False


def measure_stress(motion: Motion) -> NDArray[np.float64]:
    """Set `motion.stress` from the sample as it is, without moving anything."""
    from dem_ref.measure import love_weber_stress

    motion.stress[:] = love_weber_stress(motion.sample)
    return motion.stress
