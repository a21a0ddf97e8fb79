"""What a field run says about the balance of its initial state, and about loads and supports that look like slips."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from granfabric.cases.records.record import Record
from granfabric.cases.scene import magnitudes
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.terminal.screen import Screen
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.imbalance import InitialImbalance, initial_imbalance
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.loads.bodies import space_at
from granfabric.fem.loads.problem import Problem
from granfabric.fem.loads.supports import free_motions
from granfabric.fem.vectors import Array

from .adding_loads import adding
from .snapped import snapped
from .stage_loads import place_function

WARNED = 1e-2
"""Fraction of the nodal forces out of balance from which a run warns."""
IN_BALANCE = 1e-9
"""Below this fraction only rounding and quadrature are out of balance."""
RELEASED = 1e-9
"""Reactions of released supports below this fraction of all nodal forces are not worth a line."""


class Balance:
    """The balance of the initial state of one run.

    Parameters
    ----------
    problem : Problem
    settles : bool
        The initial stress is an estimate which the first stage is to bring into equilibrium.

    Attributes
    ----------
    told : set of str
        Stages whose released supports have been told, or that have none.
    released : dict of str to float
        Forces that these supports had carried [N/m], by stage.
    """

    def __init__(self, problem: Problem, settles: bool = False) -> None:
        self._settles = settles
        self._problem = problem
        self.found: InitialImbalance = initial_imbalance(problem)
        self.stage = problem.stages[0].name
        self.starts_loaded = problem.starts_loaded
        self.referenced = problem.balance_initial_stress
        self.told = {self.stage}
        self.released: dict[str, float] = {}
        self._least = RELEASED * self.found.acting

    @property
    def warned(self) -> bool:
        """Whether it is so far from equilibrium that somebody should know.

        Loads of a first stage that is not named "initial" come up while the imbalance fades out; if they balance the
        initial stress in the end, nothing happens in between.
        """
        if self.referenced or self._settles:
            return False
        far = self.found.fraction > WARNED
        return far and (self.starts_loaded or self.found.fraction_at_end > WARNED)

    def amount(self) -> str:
        """How much is out of balance, and where."""
        x, y = self.found.place
        return f"out of balance by {percent(self.found.fraction)} of the nodal forces, most near ({x:.4g}, {y:.4g}) m"

    def fate(self) -> str:
        """What happens to the imbalance."""
        if self.referenced:
            return "constant reference forces balance it from the outset to the end (initial.balance = true)"
        if self.starts_loaded:
            after = ", from whose end displacements count" if self._settles else ""
            return f'it fades out over stage "{self.stage}"{after}'
        rest = self.found.fraction_at_end
        loads = "balance it" if rest <= WARNED else f"leave {percent(rest)} unbalanced"
        return (
            f'it fades out over stage "{self.stage}", at whose end the loads {loads} (none acts at the outset, because '
            'the first stage is not named "initial")'
        )

    def text(self) -> str:
        """The line that is said before the first step."""
        if self.found.fraction <= IN_BALANCE:
            return f"initial stress and loads are in balance (to {self.found.fraction:.0e} of the nodal forces)"
        warning = "warning: " if self.warned else ""
        return f"{warning}initial stress and loads are {self.amount()}; {self.fate()}"

    def reminder(self, stage: str) -> str:
        """What is added to the text of a failure in a stage; empty if it cannot be the reason."""
        said = f" (the initial stress and loads were {self.amount()}; {self.fate()})" if self.warned else ""
        if stage in self.released:
            said += f' (stage "{stage}" releases supports that carried {self.released[stage]:.4g} N/m)'
        return said

    def as_data(self) -> dict[str, Any]:
        """For `run.json`."""
        found = self.found
        return {
            "fraction": found.fraction,
            "fraction_at_end_of_first_stage": found.fraction_at_end,
            "place": list(found.place),
            "sum": found.total,
            "sum_of_acting": found.acting,
            "resultant": list(found.resultant),
            "warned": self.warned,
            "fate": self.fate() if found.fraction > IN_BALANCE else "in balance",
        }

    def release(self, step: StepResult) -> dict[str, Any] | None:
        """Supports that the stage of a step releases, told once with its first step; None if there are none."""
        if step.stage in self.told:
            return None
        self.told.add(step.stage)
        fading = step.stage_start.fading.reshape(-1, 2)
        if step.active is not None:  # forces of excavations fade as well
            places = [stage.name for stage in self._problem.stages]
            released = self._problem.program.terms[places.index(step.stage)].released
            carried = np.zeros(fading.size)
            carried[released] = fading.ravel()[released]
            fading = carried.reshape(-1, 2)
        size = float(np.hypot(fading[:, 0], fading[:, 1]).sum())
        if size <= self._least:
            return None
        self.released[step.stage] = size
        return {"stage": step.stage, "sum": size, "resultant": fading.sum(axis=0).tolist()}


def percent(fraction: float) -> str:
    """A fraction in percent, without more digits than it deserves."""
    value = 100.0 * fraction
    return f"{value:.0f} %" if value >= 9.95 else f"{value:.2g} %" if value >= 1e-2 else f"{value:.0e} %"


def announce(balance: Balance, loaded: LoadedScene, problem: Problem, record: Record, screen: Screen) -> None:
    """Say and record how the initial state is balanced; say which loads are tensile, and which add to others."""
    record.details["initial_imbalance"] = balance.as_data()
    screen.say(balance.text())
    units = doubtful_units(loaded, problem)
    slips = (*units, *unheld(loaded, problem), *unchanged(loaded, problem), *pulling(loaded, problem))
    for text in (*slips, *adding(loaded, problem.space.host_mesh), *snapped(loaded, problem)):
        screen.say(text)


def continue_from(balance: Balance, earlier: dict[str, Any], record: Record) -> None:
    """Go on with what the earlier part of a run told about released supports."""
    told = [entry for entry in earlier.get("released", []) if isinstance(entry, dict) and "stage" in entry]
    if told:
        record.details["released"] = told
        balance.told |= {str(entry["stage"]) for entry in told}
        balance.released |= {str(entry["stage"]): float(entry.get("sum", 0.0)) for entry in told}


def report_release(balance: Balance, step: StepResult, record: Record, screen: Screen) -> None:
    """Say and record which forces a stage takes away by releasing supports."""
    found = balance.release(step)
    if found is None:
        return
    record.details.setdefault("released", []).append(found)
    x, y = found["resultant"]
    screen.say(
        f'stage "{found["stage"]}" releases supports that carried {found["sum"]:.4g} N/m (resultant {x:.4g}, {y:.4g}); '
        "their reactions fade out over it"
    )


def unheld(loaded: LoadedScene, problem: Problem) -> list[str]:
    """A warning for the first stage in which a mesh of one body is free to move as a rigid body."""
    for place, free in enumerate(free_motions(problem.space, problem.program.terms)):
        if free:
            where = loaded.label(["stage", place])
            return [
                f"warning: {where}: the supports leave the body free to {free}; hold it by fixed, displacement or "
                "fixed_point"
            ]
    return []


def unchanged(loaded: LoadedScene, problem: Problem) -> list[str]:
    """A warning for each stage after the first in which nothing changes: no load, no support, not the body."""

    def moves(place: int) -> bool:
        stage, body = problem.stages[place], problem.program.terms[place].body
        of_body = body is not None and (body.changes or body.released != body.released_before)
        return of_body or stage.reset_displacements or not stage.keep

    kinds = (
        *("fixed", "fixed_point", "displacement", "pressure", "traction", "body_force", "closed_form"),
        *("rigid", "spring"),
    )
    return [
        f"warning: {loaded.label(['stage', place])}: the stage has no loads: nothing changes in it (it may have "
        f"{', '.join(kinds)})"
        for place, stage in enumerate(loaded.scene.stage)
        if place and not moves(place) and not any(getattr(stage, kind) for kind in kinds)
    ]


def doubtful_units(loaded: LoadedScene, problem: Problem) -> list[str]:
    """Warnings on what is hardly meant in the unit in which it is taken, see `magnitudes`."""
    body = problem.program.terms[0].body
    stress = problem.initial_stress if body is None else problem.initial_stress[body.active[problem.space.point_cell]]
    pressure = float(-0.5 * (stress[:, 0] + stress[:, 1]).mean())
    return magnitudes.hints(loaded, pressure, float(np.ptp(problem.space.nodes, axis=0).max()))


def pulling(loaded: LoadedScene, problem: Problem) -> list[str]:
    """A warning for each pressure or traction that is tensile somewhere on its boundary: grains carry no tension.

    A traction is assessed by itself, so only where no pressure acts as well.
    """
    said = []
    stages = loaded.scene.stage
    pressed = {load.boundary for stage in stages for load in (*stage.pressure, *stage.closed_form)}
    for place, stage in enumerate(stages):
        for number, load in enumerate(stage.pressure):
            x, y = problem.space.nodes[problem.space.boundary_nodes(load.boundary)].T
            values = _finite_values(place_function(load.value, load.gradient), x, y)
            if _is_below(values.min(initial=0.0), np.abs(values).max(initial=0.0)):
                where = loaded.label(["stage", place, "pressure", number])
                said.append(
                    f"warning: {where}: the pressure on {load.boundary!r} is {values.min():.4g} Pa, tension: "
                    "pressure is compression positive"
                )
        for number, load in enumerate(stage.traction):
            here = space_at(problem.space, problem.program.terms[place].body)
            outward, size = _outward(here, load.boundary, load.value)
            if load.boundary not in pressed and _is_below(-outward, size):
                where = loaded.label(["stage", place, "traction", number])
                said.append(f"warning: {where}: the traction on {load.boundary!r} is tensile, {outward:.4g} Pa")
    return said


def _is_below(value: float, size: float) -> bool:
    """Whether a value is negative by more than rounding."""
    return value < -1e-9 * size


def _finite_values(value: Any, x: Array, y: Array) -> Array:
    """A number or a function of place at places, shape (n,), those that are finite."""
    values = np.broadcast_to(value(x, y) if callable(value) else value, x.shape)
    return np.asarray(values[np.isfinite(values)])


def _outward(space: Space, boundary: str, value: list[float | str]) -> tuple[float, float]:
    """Largest component of a traction along the outward normal of a boundary, and its largest magnitude [Pa]."""
    along, size = [-math.inf], [0.0]
    parts = [place_function(part, [0.0, 0.0]) for part in value]

    def seen(x: Array, y: Array, nx: Array, ny: Array) -> Array:
        tx, ty = (np.broadcast_to(part(x, y) if callable(part) else part, x.shape) for part in parts)
        along.append(float((tx * nx + ty * ny).max()))
        size.append(float(np.hypot(tx, ty).max()))
        return np.zeros((len(x), 2))

    space.traction_vector(boundary, seen)
    return max(along), max(size)
