"""One point driven along a path of stress, strain or both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from .arrays import finite
from .contract import STATUS_TEXT, Array, LawDescription, Status
from .effective_stress import effective_stress, with_pressure
from .law import ContactLaw
from .parameters import ParameterError, is_integer, is_within

Control = Literal["stress", "strain"]

LARGEST = 1e300
"""Size beyond which a stress or a strain counts as infinite."""

MOST_INCREMENTS = 10_000_000

POINT_COLUMNS = (
    "step",
    "strain_xx",
    "strain_yy",
    "strain_xy",
    "stress_xx",
    "stress_yy",
    "stress_xy",
    "p",
    "q",
    "coordination",
    "fabric_anisotropy",
    "normal_force_anisotropy",
    "tangential_force_anisotropy",
    "mean_normal_force",
    "coordination_gained",
    "coordination_lost",
    "fabric_gained",
    "fabric_lost",
    "substeps",
    "rejected_substeps",
    "limited",
    "fabric_anisotropy_1",
    "fabric_anisotropy_2",
    "normal_force_anisotropy_1",
    "normal_force_anisotropy_2",
    "tangential_force_anisotropy_1",
    "tangential_force_anisotropy_2",
)
"""Columns of a point's history. Stress and p, q in Pa, tension positive but p; `strain_xy` is the engineering shear."""


SLIDING_COLUMNS = ("plastic_shear_strain", "plastic_volumetric_strain", "plastic_dissipation")
"""Further columns of a law with sliding; volumetric strain tension positive, dissipation in Pa."""

PORE_COLUMNS = ("pore_pressure", "effective_p", "effective_stress_xx", "effective_stress_yy")
"""Further columns of a law with pore fluid, in Pa, u and p' compression positive; stress, p and q are total."""


def _is_finite(value: object) -> bool:
    return is_within(value, -LARGEST, LARGEST)


def _is_three(value: object) -> bool:
    return isinstance(value, (tuple, list, np.ndarray)) and np.ndim(value) == 1 and len(value) == 3


@dataclass(frozen=True)
class Leg:
    """A piece of a path: straight in the controlled components, or a rotation of the stress deviator.

    Parameters
    ----------
    control : tuple of three of {"stress", "strain"}
        What is prescribed of xx, yy, xy.
    target : tuple of 3 floats
        Stress [Pa] or total strain [-] (engineering shear) at the end of the leg, tension positive.
    increments : int
        Equal increments.
    rotation_degrees : float, optional
        Instead of control and target: turn the principal axes of stress by this angle (counter-clockwise) at constant
        p and q, under stress control.
    drained : bool
        Pore water can leave: its pressure stays. Without pore fluid nothing else happens anyway.
    relative : bool
        The target counts from stress and strain at the start of the leg, not from zero, each controlled component from
        its own: zero keeps it as it is.
    """

    control: tuple[Control, Control, Control] = ("stress", "stress", "stress")
    target: tuple[float, float, float] | None = None
    increments: int = 1
    rotation_degrees: float | None = None
    relative: bool = False
    drained: bool = False

    def __post_init__(self) -> None:
        if not is_integer(self.increments) or not 1 <= self.increments <= MOST_INCREMENTS:
            raise ParameterError(
                f"path.increments = {self.increments!r} is not a positive integer up to {MOST_INCREMENTS}"
            )
        if (self.target is None) == (self.rotation_degrees is None):
            raise ParameterError("a leg of a path needs either target (with control) or rotation_degrees, not both")
        if not _is_three(self.control) or any(str(entry) not in ("stress", "strain") for entry in self.control):
            raise ParameterError(f"path.control = {self.control!r} is not three of 'stress', 'strain'")
        if self.target is not None and not (_is_three(self.target) and all(_is_finite(v) for v in self.target)):
            raise ParameterError(f"path.target = {self.target!r} is not three finite numbers")
        if self.rotation_degrees is not None and not _is_finite(self.rotation_degrees):
            raise ParameterError(f"path.rotation_degrees = {self.rotation_degrees!r} is not finite")
        if not isinstance(self.relative, bool | np.bool_):
            raise ParameterError(f"path.relative = {self.relative!r} is not one of True, False")
        if not isinstance(self.drained, bool | np.bool_):
            raise ParameterError(f"path.drained = {self.drained!r} is not one of True, False")
        if self.relative and self.target is None:
            raise ParameterError("path.relative goes with a target; a rotation always turns from the start of its leg")


@dataclass
class PathHistory:
    """What a point went through.

    Parameters
    ----------
    columns : dict of ndarray
        One entry for each of `POINT_COLUMNS`, with sliding also of `SLIDING_COLUMNS`, with pore fluid of
        `PORE_COLUMNS`; one row a step, the start included.
    finished : bool
        Whether the path was followed to its end.
    message : str
        Why not, if so.
    stress, state, strain : ndarray
        At the last step reached.
    """

    columns: dict[str, np.ndarray]
    finished: bool
    message: str
    stress: Array
    state: Array
    strain: Array


class PathRecorder:
    """Rows of the history of one point.

    Parameters
    ----------
    description : LawDescription
        Of a law with a mean normal force.
    stress, state : ndarray, shapes (1, 3), (1, nstate)
        At the start.
    of_state : tuple of str
        Scalar state variables that are recorded beside `POINT_COLUMNS`.
    """

    def __init__(
        self, description: LawDescription, stress: Array, state: Array, of_state: tuple[str, ...] = ()
    ) -> None:
        self.description = description
        self.rows: list[list[float]] = []
        self.of_state = of_state
        self.wet = description.has_state("pore_pressure")
        self.names = POINT_COLUMNS + self.of_state + (PORE_COLUMNS if self.wet else ())
        self.force0 = float(state[0, description.columns("mean_normal_force")][0])
        # magnitudes carry the sign of their component along the initial major stress, or along x without one
        deviator = -0.5 * (stress[0, 0] - stress[0, 1]), -stress[0, 2]
        size = float(np.hypot(*deviator))
        effective = effective_stress(stress, state, description)
        pressure = -0.5 * (effective[0, 0] + effective[0, 1])
        self.axis = np.array(deviator) / size if size > 1e-12 * abs(pressure) else None

    def _vector(self, state: Array, name: str) -> Array:
        value = np.zeros(2)
        if self.description.has_state(name):
            columns = self.description.columns(name)
            part = state[0, columns]
            value[: part.size] = part
        return value

    def _scalar(self, state: Array, name: str) -> float:
        if not self.description.has_state(name):
            return 0.0
        return float(state[0, self.description.columns(name)][0])

    def _signed(self, vector: Array) -> float:
        along = vector[0] if self.axis is None else float(vector @ self.axis)
        # adding zero turns -0.0 into 0.0
        return float(np.copysign(np.hypot(*vector), along)) + 0.0

    def add(self, stress: Array, state: Array, strain: Array, substeps: int, rejected: int, limited: bool) -> None:
        """Append one row."""
        s = stress[0]
        p = -0.5 * (s[0] + s[1])
        q = float(np.hypot(0.5 * (s[0] - s[1]), s[2]))
        effective = effective_stress(stress, state, self.description)[0]
        carried = -0.5 * (effective[0] + effective[1])
        if self.axis is None and q > 1e-9 * abs(carried):
            # an isotropic start has no major direction: the first deviator that appears takes its place
            self.axis = np.array([-0.5 * (s[0] - s[1]), -s[2]]) / q
        names = ("fabric_anisotropy", "normal_force_anisotropy", "tangential_force_anisotropy")
        vectors = [self._vector(state, name) for name in names]
        self.rows.append(
            [
                float(len(self.rows)),
                *strain[0],
                *s,
                p,
                q,
                self._scalar(state, "coordination"),
                *(self._signed(vector) for vector in vectors),
                self._scalar(state, "mean_normal_force") / self.force0,
                self._scalar(state, "coordination_gained"),
                self._scalar(state, "coordination_lost"),
                self._signed(self._vector(state, "fabric_gained")),
                self._signed(self._vector(state, "fabric_lost")),
                float(substeps),
                float(rejected),
                float(limited),
                *(component for vector in vectors for component in vector),
                *(self._scalar(state, name) for name in self.of_state),
            ]
        )
        if self.wet:
            self.rows[-1] += [self._scalar(state, "pore_pressure"), carried, *effective[:2]]

    def columns(self) -> dict[str, np.ndarray]:
        """The history by column."""
        table = np.array(self.rows)
        integers = {"step", "substeps", "rejected_substeps", "limited"}
        return {
            name: table[:, index].astype(np.int64) if name in integers else table[:, index]
            for index, name in enumerate(self.names)
        }


def ends_of(leg: Leg, stress: Array, strain: Array) -> tuple[np.ndarray, Array]:
    """Control codes (3,) and the end values (increments, 3) of the controlled components of each increment."""
    fractions = np.arange(1, leg.increments + 1)[:, None] / leg.increments
    if leg.rotation_degrees is not None:
        mean = 0.5 * (stress[0, 0] + stress[0, 1])
        half, shear = 0.5 * (stress[0, 0] - stress[0, 1]), stress[0, 2]
        angle = 2.0 * np.deg2rad(leg.rotation_degrees) * fractions[:, 0]
        turned_half = half * np.cos(angle) - shear * np.sin(angle)
        turned_shear = half * np.sin(angle) + shear * np.cos(angle)
        return np.ones(3, dtype=np.uint8), np.stack([mean + turned_half, mean - turned_half, turned_shear], axis=1)
    control = np.array([entry == "stress" for entry in leg.control], dtype=np.uint8)
    start = np.where(control == 1, stress[0], strain[0])
    change = np.array(leg.target) if leg.relative else np.array(leg.target) - start
    return control, start + fractions * change


def drive(
    law: ContactLaw,
    initial_stress: Sequence[float],
    legs: Sequence[Leg],
    on_step: Callable[[int, int], None] | None = None,
    stop: Callable[[], bool] | None = None,
    state: Array | None = None,
    pore_pressure: float = 0.0,
) -> PathHistory:
    """Drive one point along a path.

    Parameters
    ----------
    law : ContactLaw
    initial_stress : sequence of 3 floats
        xx, yy, xy [Pa], tension positive; the effective stress, if there is pore fluid.
    legs : sequence of Leg
    on_step : callable, optional
        Called with the number of finished and of all increments.
    stop : callable, optional
        Asked before each increment; True ends the path there.
    state : ndarray, shape (1, nstate), optional
        Initial state, if not the law's own for this stress.
    pore_pressure : float
        Initial pore pressure of a law with pore fluid, if its state is not given [Pa]. What is prescribed of stress on
        the way is the total one.

    Returns
    -------
    PathHistory
        Also when a point fails on the way: then with what was reached and the reason.

    Raises
    ------
    ValueError
        If an array has another shape or kind, or holds a value that is not finite.
    ParameterError
        If the initial stress is not compressive, or the law has no initial state for it.
    """
    stress = finite("initial_stress", initial_stress, (3,))[None, :].copy()
    legs = tuple(legs)
    for leg in legs:
        if not isinstance(leg, Leg):
            raise ParameterError(f"a path consists of legs, of the class Leg, not of {leg!r}")
    strain = np.zeros((1, 3))
    if not -0.5 * (stress[0, 0] + stress[0, 1]) > 0.0:
        raise ParameterError(
            f"initial.stress = {list(initial_stress)!r} is not compressive: grains need a positive mean pressure "
            "p = -(s_xx + s_yy)/2 (tension is positive)"
        )
    if state is not None:
        now = finite("state", state, (1, law.description.nstate)).copy()
        if law.effects.pore_fluid:
            stress = with_pressure(stress, -now[:, law.description.columns("pore_pressure")][:, 0])
    elif law.effects.pore_fluid:
        stress = with_pressure(stress, -float(pore_pressure))
        now = law.initial_state(stress, pore_pressure=np.array([float(pore_pressure)]))
    elif pore_pressure == 0.0:
        now = law.initial_state(stress)
    else:
        raise ParameterError("pore_pressure means nothing to a law without effects.pore_fluid")
    if not now[0, law.description.columns("mean_normal_force")][0] > 0.0:
        raise ParameterError("the initial state has no mean normal force, by which the force is divided on the way")
    recorder = PathRecorder(
        law.description, stress, now, SLIDING_COLUMNS if law.effects.sliding else ()
    )
    recorder.add(stress, now, strain, 0, 0, False)
    stress_end, state_end, strain_increment = np.zeros_like(stress), np.zeros_like(now), np.zeros((1, 3))
    total, done = sum(leg.increments for leg in legs), 0

    def history(finished: bool, message: str) -> PathHistory:
        return PathHistory(recorder.columns(), finished, message, stress, now, strain)

    for number, leg in enumerate(legs):
        control, ends = ends_of(leg, stress, strain)
        going = law.drained() if leg.drained else law
        for end in ends:
            if stop is not None and stop():
                return history(False, f"stopped after {done} of {total} increments")
            increment = end - np.where(control == 1, stress[0], strain[0])
            report = going.update_mixed(
                control[None, :], increment[None, :], stress, now, stress_end, state_end, strain_increment
            )
            if report.failed:
                return history(
                    False,
                    f"leg {number + 1}, increment {done + 1} of {total}: {STATUS_TEXT[Status(int(report.status[0]))]}",
                )
            # prescribed components are set, so that rounding does not add up over the path
            strain = strain + strain_increment
            strain[0] = np.where(control == 1, strain[0], end)
            stress, stress_end = stress_end, stress
            stress[0] = np.where(control == 1, end, stress[0])
            now, state_end = state_end, now
            done += 1
            recorder.add(stress, now, strain, int(report.substeps[0]), int(report.rejected[0]), report.limited > 0)
            if on_step is not None:
                on_step(done, total)
    return history(True, f"followed to its end in {done} increments")
