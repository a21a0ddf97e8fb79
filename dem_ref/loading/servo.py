"""Loading of a periodic sample along the legs of a path by a servo on the cell's three strain components.

Quasi-static by measure: the progress along a leg is slowed down or speeded up so that the inertial number and the
unbalanced force stay at or below their limits; both are recorded.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.dynamics.motion import Control, Motion
from granfabric.dem_ref.dynamics.stepping import CONTACTS
from granfabric.dem_ref.measures.contacts import love_weber_stress
from granfabric.dem_ref.sample.disks import SampleError

from .legs import ISOTROPIC, ROOT2, Leg, from_vector, to_vector


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


def elastic_estimate(motion: Motion) -> NDArray[np.float64]:
    """Stiffness for the servo in the space (xx, yy, sqrt(2) xy): uniform-strain moduli, shear softened by a quarter."""
    sample = motion.sample
    z = 2.0 * max(float(motion.measures[CONTACTS]), 0.5 * sample.count) / sample.count
    kn, kt = sample.normal_stiffness, sample.normal_stiffness * sample.stiffness_ratio
    bulk = z * sample.solid_fraction * kn / (2.0 * pi)
    shear = 0.75 * z * sample.solid_fraction * (kn + kt) / (4.0 * pi)
    return 2.0 * bulk * np.outer(ISOTROPIC, ISOTROPIC) + 2.0 * shear * (np.eye(3) - np.outer(ISOTROPIC, ISOTROPIC))


@dataclass
class LegState:
    """Where a loading is within its leg; with the sample all that is needed to go on.

    `softening` is what the stress-controlled directions were found to need in strain beyond the elastic estimate, per
    strain asked for; it is learnt on the way, so that a softening sample does not lag behind its path.
    """

    progress: float = 0.0
    pace: float = 0.0
    settled: float = 0.0
    start_stress: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    start_strain: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    target: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    softening: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    inertial_number: float = 0.0
    unbalanced_force: float = 0.0

    def to_array(self) -> NDArray[np.float64]:
        """All numbers in one array, for a checkpoint."""
        head = [self.progress, self.pace, self.settled, self.inertial_number, self.unbalanced_force]
        return np.concatenate([head, self.start_stress, self.start_strain, self.target, self.softening])

    @staticmethod
    def from_array(a: NDArray[np.float64]) -> LegState:
        """Inverse of `to_array`."""
        if a.shape != (17,):
            raise SampleError(f"a stored state of a leg has 17 numbers, not {a.shape}")
        progress, pace, settled, inertial_number, unbalanced = (float(v) for v in a[:5])
        vectors = (a[5:8].copy(), a[8:11].copy(), a[11:14].copy(), a[14:17].copy())
        return LegState(progress, pace, settled, *vectors, inertial_number, unbalanced)


GROWTH, CUT = 1.25, 0.5
SETTLED_CHUNKS = 5.0
LEARNING, LARGEST_SOFTENING = 0.2, 20.0


class Loading:
    """Moves a sample along one leg, chunk by chunk."""

    def __init__(
        self, motion: Motion, leg: Leg, limits: RateLimits | None = None, state: LegState | None = None
    ) -> None:
        self.motion = motion
        self.leg = leg
        self.limits = limits or RateLimits()
        self.limits.check()
        self.exhausted = False
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
        asked = 0.0  # size of the strain per step that the path asks for
        if ahead < 1.0 and error <= limits.lag * pressure:
            probe = min(ahead + 1e-4, 1.0)
            per_progress = self._strain_of(self._values(probe, state) - state.target, compliance) / (probe - ahead)
            if state.pace == 0.0:
                state.pace = 0.1 * unit_rate
            ahead = min(1.0, ahead + limits.chunk * min(state.pace, unit_rate) / max(per_progress, 1e-300))
            asked = (ahead - state.progress) * per_progress / limits.chunk
        goal = self._values(ahead, state)
        rate = (goal - state.target) / limits.chunk
        drive = np.where(controlled, rate, 0.0)
        coupled = stiffness[np.ix_(free, controlled)] @ drive[controlled]
        drive[free] = compliance[np.ix_(free, free)] @ (rate[free] - coupled) + asked * state.softening[free]
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
        if asked > 0.0:
            missed = (q @ to_vector(mean_rate) - drive)[free] / asked
            state.softening[free] = np.clip(
                state.softening[free] + LEARNING * missed, -LARGEST_SOFTENING, LARGEST_SOFTENING
            )
        state.inertial_number = motion.inertial_number(mean_rate, pressure)
        state.unbalanced_force = motion.unbalanced_force
        worst = max(
            state.unbalanced_force / limits.unbalanced_force, state.inertial_number / limits.inertial_number, 1e-3
        )
        # aim at 0.8 of the limit; grow gently, cut at once
        state.pace = min(unit_rate, state.pace * min(GROWTH, max(CUT, 0.8 / worst)))
        if leg.stop is not None and leg.stop(motion.stress, motion.sample.strain):
            return False
        if free.all() and np.abs(motion.sample.strain - state.start_strain).max() > leg.largest_strain:
            self.exhausted = True
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
        """Advance to the end of the leg, or until `observe` returns True.

        Returns False when the steps were not enough or the sample could not carry the stress (`exhausted`).
        """
        last = self.motion.steps_done + steps
        while self.motion.steps_done < last:
            if not self.advance():
                return not self.exhausted
            if observe is not None and observe(self):
                return True
        return False


def measure_stress(motion: Motion) -> NDArray[np.float64]:
    """Set `motion.stress` from the sample as it is, without moving anything."""
    motion.stress[:] = love_weber_stress(motion.sample)
    return motion.stress
