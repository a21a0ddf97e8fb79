"""Nodal forces of the stages: what acts at the start of each, and how it changes over it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from granfabric.fem.discretisation.space import Space

from .amplitude import RAMP, Amplitude
from .checks import Array
from .kinds import Stage

Key = tuple[Any, ...]

BODY = "rigid body"
"""First part of the key of a rigid body's force."""


@dataclass(frozen=True)
class NodalForce:
    """Nodal forces of one load, at its value in the stage that names it.

    Parameters
    ----------
    vector : ndarray, shape (ndofs,)
        On the body of that stage [N/m].
    amplitude : Amplitude
    on : callable
        The same on the space of another body.
    """

    vector: Array
    amplitude: Amplitude
    on: Callable[[Space], Array]


@dataclass(frozen=True)
class _Value:
    """Forces that a key has come to at the end of a stage: those before, and a part of the way to those of a load."""

    stage: int
    force: NodalForce
    reached: float
    before: _Value | None


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


_Where = tuple[int, bool]
"""Body on which forces act: number of the stage that changed it last, and whether it is meant before that change."""


class ForceProgram:
    """Forces by key through the stages; what a control comes to is known only when its stage has been run.

    Where a stage changes the body, its forces at the start are what earlier loads exert on what stays, and those at the
    end act on the new body.

    Parameters
    ----------
    ndofs : int
    """

    def __init__(self, ndofs: int) -> None:
        self._ndofs = ndofs
        self._stages: list[tuple[Stage, dict[Key, NodalForce]]] = []
        self._found: dict[tuple[int, tuple[float, ...]], StageForces] = {}
        self._spaces: dict[int, tuple[Space, Space]] = {}
        self._last_change: list[int] = []
        self._again: dict[tuple[int, int, bool, int], Array] = {}

    def add(self, stage: Stage, named: dict[Key, NodalForce], spaces: tuple[Space, Space] | None = None) -> None:
        """Append a stage with the forces that it names.

        `spaces` are given if it changes the body: on which earlier loads act at its start, and all at its end.
        """
        number = len(self._stages)
        self._stages.append((stage, named))
        if spaces is not None:
            self._spaces[number] = spaces
        self._last_change.append(number if spaces is not None or number == 0 else self._last_change[-1])

    def of(self, index: int, factors: Sequence[float]) -> StageForces:
        """Forces of a stage; `factors` are the load factors that the controls of the stages before ended with."""
        key = (index, tuple(factors[:index]))
        if key not in self._found:
            if len(self._found) > 2 * len(self._stages):
                self._found.clear()
            self._found[key] = self._compute(index, key[1])
        return self._found[key]

    def _vector(self, value: _Value, where: _Where) -> Array:
        """Forces of a load on the body of another stage than its own, made once."""
        changed, at_start = where
        if self._last_change[value.stage] == changed and not at_start:
            return value.force.vector
        key = (value.stage, id(value.force), at_start, changed)
        if key not in self._again:
            self._again[key] = value.force.on(self._spaces[changed][0 if at_start else 1])
        return self._again[key]

    def _at(self, value: _Value | None, where: _Where) -> Array:
        if value is None:
            return np.zeros(self._ndofs)
        vector = self._vector(value, where)
        if value.reached == 1.0:
            return vector
        here = self._at(value.before, where)
        return np.asarray(here + value.reached * (vector - here))

    def _sum(self, values: dict[Key, _Value], where: _Where) -> Array:
        if not values:
            return np.zeros(self._ndofs)
        return np.asarray(np.sum([self._at(value, where) for value in values.values()], axis=0))

    def _compute(self, index: int, factors: tuple[float, ...]) -> StageForces:
        values: dict[Key, _Value] = {}
        for number, (stage, named) in enumerate(self._stages[: index + 1]):
            before = values
            values = dict(before) if stage.keep else {}
            for key, force in named.items():
                reached = force.amplitude.factor(1.0, stage.increments)
                if stage.control is not None and number < index:
                    reached = factors[number] if number < len(factors) else 1.0
                values[key] = _Value(number, force, reached, before.get(key))
        stage, named = self._stages[index]
        there: _Where = (self._last_change[index], False)
        at_start: _Where = (index, True) if index in self._spaces else there
        start, end = self._sum(before, at_start), self._sum(values, there)
        changes: dict[Amplitude, Array] = {}
        linear = dict(values)
        for key, force in named.items():
            if force.amplitude == RAMP and stage.control is None:
                continue
            here = self._at(before.get(key), there)
            changes[force.amplitude] = changes.get(force.amplitude, np.zeros(self._ndofs)) + (force.vector - here)
            if key in before:
                linear[key] = before[key]
            else:
                del linear[key]
        bodies = {}
        for key in dict.fromkeys([*before, *named]):
            if key[0] == BODY:
                given = named.get(key)
                last = self._at(values.get(key), there) if given is None else given.vector
                amplitude = RAMP if given is None else given.amplitude
                follows = given is not None and stage.control is not None
                bodies[key[1]] = (self._at(before.get(key), at_start), last, amplitude, follows)
        if not changes:
            return StageForces(start, end, end, bodies=bodies)
        ramp_end = self._sum(linear, there)
        if stage.control is not None:
            return StageForces(start, end, ramp_end, (), changes[RAMP], bodies)
        return StageForces(start, end, ramp_end, tuple(changes.items()), None, bodies)
