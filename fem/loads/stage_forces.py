"""Nodal forces of the stages: what acts at the start of each, and how it changes over it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .amplitude import RAMP, Amplitude
from .checks import Array
from .kinds import Stage

Key = tuple[Any, ...]

BODY = "rigid body"
"""First part of the key of a rigid body's force."""


@dataclass(frozen=True)
class StageForces:
    """Nodal forces over one stage, all of shape (ndofs,) [N/m].

    Parameters
    ----------
    start, end : ndarray
        At its start and at its end; with a control the end is that of a load factor of 1.
    ramp_end : ndarray
        What those that go linearly would come to alone.
    varying : tuple of (Amplitude, ndarray)
        Changes of those with another amplitude.
    following : ndarray, optional
        With a control: change of the loads that follow, at a load factor of 1; not in `ramp_end`.
    bodies : dict of str to (ndarray, ndarray, Amplitude, bool)
        Of each rigid body its force at the start and at a factor of 1, and whether it follows a control.
    """

    start: Array
    end: Array
    ramp_end: Array
    varying: tuple[tuple[Amplitude, Array], ...] = ()
    following: Array | None = None
    bodies: dict[str, tuple[Array, Array, Amplitude, bool]] = field(default_factory=dict)

    def of_body(self, boundary: str, fraction: float, increments: int, load_factor: float) -> Array:
        """Own nodal forces of a rigid body at a position within the stage, shape (ndofs,)."""
        if boundary not in self.bodies:
            return np.zeros_like(self.start)
        first, last, amplitude, follows = self.bodies[boundary]
        return first + (load_factor if follows else amplitude.factor(fraction, increments)) * (last - first)

    def at(self, fraction: float, increments: int, load_factor: float, reference: Array) -> Array:
        """At a position within the stage, on top of constant forces; the load factor matters with a control only."""
        force = reference + self.start + fraction * (self.ramp_end - self.start)
        for amplitude, change in self.varying:
            force += amplitude.factor(fraction, increments) * change
        if self.following is not None:
            force += load_factor * self.following
        return force


class ForceProgram:
    """Forces by key through the stages; what a control comes to is known only when its stage has been run.

    Parameters
    ----------
    ndofs : int
    """

    def __init__(self, ndofs: int) -> None:
        self._ndofs = ndofs
        self._stages: list[tuple[Stage, dict[Key, tuple[Array, Amplitude]]]] = []
        self._found: dict[tuple[int, tuple[float, ...]], StageForces] = {}

    def add(self, stage: Stage, named: dict[Key, tuple[Array, Amplitude]]) -> None:
        """Append a stage with the forces that it names."""
        self._stages.append((stage, named))

    def of(self, index: int, factors: Sequence[float]) -> StageForces:
        """Forces of a stage; `factors` are the load factors that the controls of the stages before ended with."""
        key = (index, tuple(factors[:index]))
        if key not in self._found:
            if len(self._found) > 2 * len(self._stages):
                self._found.clear()
            self._found[key] = self._compute(index, key[1])
        return self._found[key]

    def _compute(self, index: int, factors: tuple[float, ...]) -> StageForces:
        nothing = np.zeros(self._ndofs)
        values: dict[Key, Array] = {}
        for number, (stage, named) in enumerate(self._stages[: index + 1]):
            before = values
            values = dict(before) if stage.keep else {}
            for key, (vector, amplitude) in named.items():
                here = before.get(key, nothing)
                reached = amplitude.factor(1.0, stage.increments)
                if stage.control is not None and number < index:
                    reached = factors[number] if number < len(factors) else 1.0
                values[key] = vector if reached == 1.0 else here + reached * (vector - here)
        stage, named = self._stages[index]
        start, end = _sum(before, nothing), _sum(values, nothing)
        changes: dict[Amplitude, Array] = {}
        linear = dict(values)
        for key, (vector, amplitude) in named.items():
            if amplitude == RAMP and stage.control is None:
                continue
            here = before.get(key, nothing)
            changes[amplitude] = changes.get(amplitude, nothing) + (vector - here)
            linear[key] = here
        bodies = {}
        for key in dict.fromkeys([*before, *named]):
            if key[0] == BODY:
                given = named.get(key)
                last = values.get(key, nothing) if given is None else given[0]
                amplitude = RAMP if given is None else given[1]
                follows = given is not None and stage.control is not None
                bodies[key[1]] = (before.get(key, nothing), last, amplitude, follows)
        if not changes:
            return StageForces(start, end, end, bodies=bodies)
        ramp_end = _sum(linear, nothing)
        if stage.control is not None:
            return StageForces(start, end, ramp_end, (), changes[RAMP], bodies)
        return StageForces(start, end, ramp_end, tuple(changes.items()), None, bodies)


def _sum(forces: dict[Key, Array], nothing: Array) -> Array:
    return np.asarray(np.sum(list(forces.values()), axis=0)) if forces else nothing.copy()
