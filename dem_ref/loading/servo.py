"""Loading of a periodic sample along the legs of a path by a servo on the cell's three strain components.

Quasi-static by measure: the progress along a leg is slowed down or speeded up so that the inertial number and the
unbalanced force stay at or below their limits; both are recorded.

Every leg ends. Where it cannot be followed to its end, `Loading.ending` says why: the sample flows under a stress that
it cannot carry, its pressure is gone (rates scale with the pressure, so that the loading would slow down for ever, and
disks without contacts are in perfect balance), or nothing moves any more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import is_whole, is_within
from granfabric.dem_ref.dynamics.motion import Control, Motion
from granfabric.dem_ref.dynamics.stepping import CONTACTS
from granfabric.dem_ref.measures.contacts import love_weber_stress
from granfabric.dem_ref.sample.disks import SampleError

from .endings import Ending
from .leg_state import LegState
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
            if not is_within(value, low, high) or (name == "chunk" and not is_whole(value)):
                raise SampleError(f"rate limit {name} is {value}, legal are {low:g} to {high:g}")


def elastic_estimate(motion: Motion) -> NDArray[np.float64]:
    """Stiffness for the servo in the space (xx, yy, sqrt(2) xy): uniform-strain moduli, shear softened by a quarter."""
    sample = motion.sample
    z = 2.0 * max(float(motion.measures[CONTACTS]), 0.5 * sample.count) / sample.count
    kn, kt = sample.normal_stiffness, sample.normal_stiffness * sample.stiffness_ratio
    bulk = z * sample.solid_fraction * kn / (2.0 * pi)
    shear = 0.75 * z * sample.solid_fraction * (kn + kt) / (4.0 * pi)
    return 2.0 * bulk * np.outer(ISOTROPIC, ISOTROPIC) + 2.0 * shear * (np.eye(3) - np.outer(ISOTROPIC, ISOTROPIC))


GROWTH, CUT = 1.25, 0.5
SETTLED_CHUNKS = 5.0
LEARNING, LARGEST_SOFTENING = 0.2, 20.0
CALM_ERROR, CALM_FORCE = 2e-4, 0.2
"""At rest at the end of a leg: error of the stress over p, unbalanced force over its limit."""
SLOWEST_PACE = 1e-100
"""Of the rate that the inertial number allows; below, a pace could not grow again for want of digits."""

LOST_PRESSURE = 1e-3
"""Fraction of the reference pressure below which a sample has lost it."""
SMALLEST_PRESSURE = 1e-6
"""The same where stress is prescribed in every direction and the path itself goes that low."""
DILATION = 3.0
"""Strain that directions under stress may take for each unit of the strain prescribed in the others, over all."""


class Loading:
    """Moves a sample along one leg, chunk by chunk.

    Parameters
    ----------
    motion : Motion
    leg : Leg
    limits : RateLimits, optional
    state : LegState, optional
        To go on from; at the start of the leg if not given.
    reference_pressure : float, optional
        Pa; the pressure that counts as lost at a thousandth of it. That at the start of the leg if not given.

    Attributes
    ----------
    ending : Ending
        Why the leg was given up before its end, once `advance` has returned False.
    """

    def __init__(
        self,
        motion: Motion,
        leg: Leg,
        limits: RateLimits | None = None,
        state: LegState | None = None,
        reference_pressure: float | None = None,
    ) -> None:
        self.motion = motion
        self.leg = leg
        self.limits = limits or RateLimits()
        self.limits.check()
        self.ending = Ending.ON_ITS_WAY
        if not np.any(motion.stress):
            measure_stress(motion)
        if state is None:
            state = LegState(start_stress=motion.stress.copy(), start_strain=motion.sample.strain.copy())
            state.target = self._values(0.0, state)
            state.seen_strain = state.start_strain.copy()
        self.state = state
        reference = mean_pressure(state.start_stress) if reference_pressure is None else reference_pressure
        if not reference > 0.0:
            raise SampleError(f"the mean pressure is {reference:.4g} Pa, a loading needs a compressed sample")
        self.reference_pressure = reference

    @property
    def given_up(self) -> bool:
        """Whether the leg ended before its end."""
        return self.ending != Ending.ON_ITS_WAY

    def _values(self, progress: float, state: LegState) -> NDArray[np.float64]:
        return np.asarray(self.leg.values(progress, state.start_stress, state.start_strain), dtype=np.float64)

    def _pressure(self) -> float:
        return max(mean_pressure(self.motion.stress), 1e-12 * self.motion.sample.normal_stiffness)

    def _has_lost_its_pressure(self) -> bool:
        least = LOST_PRESSURE * self.reference_pressure
        if not any(self.leg.strain_controlled):
            asked = mean_pressure(from_vector(np.asarray(self.leg.directions).T @ self.state.target))
            least = max(min(least, 0.5 * asked), SMALLEST_PRESSURE * self.reference_pressure)
        return mean_pressure(self.motion.stress) < least

    def _flows(self, directions: NDArray[np.float64], free: NDArray[np.bool_]) -> bool:
        """Whether directions under stress have gone so far that the sample does not carry what is asked for."""
        strain = self.motion.sample.strain - self.state.start_strain
        if free.all():
            return bool(np.abs(strain).max() > self.leg.largest_strain)
        moved = directions @ to_vector(strain)
        return float(np.linalg.norm(moved[free])) > self.leg.largest_strain + DILATION * float(
            np.linalg.norm(moved[~free])
        )

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
        elastic = elastic_estimate(motion)
        stiffness = q @ elastic @ q.T
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
        state.pace = min(unit_rate, max(state.pace * min(GROWTH, max(CUT, 0.8 / worst)), SLOWEST_PACE * unit_rate))
        if self._has_lost_its_pressure():
            self.ending = Ending.LOST_PRESSURE
            return False
        if leg.stop is not None and leg.stop(motion.stress, motion.sample.strain):
            return False
        if free.any() and self._flows(q, free):
            self.ending = Ending.TOO_STRONG
            return False
        if state.progress >= 1.0 and not leg.hold:
            return False
        now = q @ to_vector(motion.stress)
        error = float(np.linalg.norm((goal - now)[free])) if free.any() else 0.0
        if state.progress >= 1.0:
            calm = error < CALM_ERROR * pressure and state.unbalanced_force < CALM_FORCE * limits.unbalanced_force
            state.settled = state.settled + 1.0 if calm else 0.0
            if state.settled >= SETTLED_CHUNKS:
                return False
        unrest = max(error / (CALM_ERROR * pressure), state.unbalanced_force / (CALM_FORCE * limits.unbalanced_force))
        if state.stands_still(motion.sample.strain, unrest, 4.0 * pressure / float(np.sum(elastic[:2, :2]))):
            self.ending = Ending.STOOD_STILL
            return False
        return True

    def run(self, steps: int = 10_000_000, observe: Callable[[Loading], bool | None] | None = None) -> bool:
        """Advance to the end of the leg, or until `observe` returns True.

        Returns False when the steps were not enough or the leg was given up (`ending` says why).
        """
        last = self.motion.steps_done + steps
        while self.motion.steps_done < last:
            if not self.advance():
                return not self.given_up
            if observe is not None and observe(self):
                return True
        return False


def mean_pressure(stress: NDArray[np.float64]) -> float:
    """Compression positive p of a stress (xx, yy, xy), tension positive; Pa."""
    return float(-0.5 * (stress[0] + stress[1]))


def measure_stress(motion: Motion) -> NDArray[np.float64]:
    """Set `motion.stress` from the sample as it is, without moving anything."""
    motion.stress[:] = love_weber_stress(motion.sample)
    return motion.stress
