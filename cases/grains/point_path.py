"""A packing driven along a path of stress, strain or both, as a point of a scene is."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.contract import Status
from granfabric.constitutive.path import Leg, PathHistory, PathRecorder, ends_of

from .failures import TEXT
from .law import GrainsLaw

Array = NDArray[np.float64]

ERROR = 1e-5
"""Of the pressure: what is left of the error of a prescribed stress; packings answer with jumps of a fifth of it."""
ITERATIONS = 25
OF_STATE = ("sliding_fraction", "motion_steps")
"""Columns of a point with grains beside those of all points."""


def drive_point(
    law: GrainsLaw,
    initial_stress: Sequence[float],
    legs: Sequence[Leg],
    state: Array,
    on_step: Callable[[int, int], None] | None = None,
    stop: Callable[[], bool] | None = None,
) -> PathHistory:
    """Drive one point along a path; strains in directions under stress are found by Broyden's method.

    Parameters
    ----------
    law : GrainsLaw
    initial_stress : sequence of 3 floats
        xx, yy, xy [Pa], tension positive.
    legs : sequence of Leg
    state : ndarray, shape (1, nstate)
    on_step, stop : callable, optional
        See `granfabric.constitutive.path.drive`.

    Returns
    -------
    PathHistory
        Its `substeps` are the trials that an increment took.
    """
    stress, now, strain = np.array(initial_stress, dtype=np.float64)[None, :], state.copy(), np.zeros((1, 3))
    recorder = PathRecorder(law.description, stress, now, OF_STATE)
    recorder.add(stress, now, strain, 0, 0, False)
    total, done = sum(leg.increments for leg in legs), 0
    for number, leg in enumerate(legs):
        control, ends = ends_of(leg, stress, strain)
        for end in ends:
            if stop is not None and stop():
                return PathHistory(
                    recorder.columns(), False, f"stopped after {done} of {total} increments", stress, now, strain
                )
            found = _increment(law, control == 1, end, stress, now, strain)
            if isinstance(found, str):
                message = f"leg {number + 1}, increment {done + 1} of {total}: {found}"
                return PathHistory(recorder.columns(), False, message, stress, now, strain)
            increment, stress, now, trials = found
            strain = strain + increment
            done += 1
            recorder.add(stress, now, strain, trials, 0, False)
            if on_step is not None:
                on_step(done, total)
    return PathHistory(recorder.columns(), True, f"followed to its end in {done} increments", stress, now, strain)


def _increment(
    law: GrainsLaw, held: NDArray[np.bool_], end: Array, stress: Array, state: Array, strain: Array
) -> tuple[Array, Array, Array, int] | str:
    """Strain increment, stress, state and trials of one increment; a sentence if it cannot be followed."""
    increment = np.where(held, 0.0, end - strain[0])
    stress_end, state_end, tangent = np.empty_like(stress), np.empty_like(state), np.empty((1, 3, 3))
    report = law.update(np.zeros((1, 3)), stress, state, stress_end, state_end, tangent)
    stiffness = tangent[0].copy()
    free = np.flatnonzero(held)
    pressure = -0.5 * float(stress[0, :2].sum())
    last: tuple[Array, Array] | None = None
    missing = np.where(held, end - stress[0] - stiffness @ increment, 0.0)
    for trial in range(1, ITERATIONS + 1):
        if len(free):
            try:
                increment[free] += np.linalg.solve(stiffness[np.ix_(free, free)], missing[free])
            except np.linalg.LinAlgError:
                return TEXT[Status.STIFFNESS_LOST]
        report = law.update(increment[None, :], stress, state, stress_end, state_end, None)
        if report.failed:
            return TEXT[Status(int(report.status[0]))]
        missing = np.where(held, end - stress_end[0], 0.0)
        if np.abs(missing).max() <= ERROR * pressure:
            return increment[None, :], stress_end, state_end, trial
        before = (np.zeros(3), stress[0]) if last is None else last
        moved, answered = increment - before[0], stress_end[0] - before[1]
        if moved.any():
            stiffness += np.outer(answered - stiffness @ moved, moved) / (moved @ moved)
        last = (increment.copy(), stress_end[0].copy())
    return f"the prescribed stress was not found in {ITERATIONS} trials; a packing under it may flow: prescribe strain"
