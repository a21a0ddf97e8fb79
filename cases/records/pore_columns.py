"""Columns that a field run's history has more where there is pore fluid."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.terminal.screen import Screen
from granfabric.constitutive.contract import LawDescription

from .record import Record

Array = NDArray[np.float64]

PORE = ("pore_pressure", "pore_pressure_smallest", "pore_pressure_largest", "effective_p")
"""Mean and extremes of u, and p' of the means; compression positive [Pa]. Stress, p and q are the total ones."""
CAVITATION = -100e3
"""Pore pressure over that of the atmosphere below which water boils [Pa]."""


def has_pore_pressure(description: LawDescription) -> bool:
    """Whether a law carries a pore pressure."""
    return description.has_state(PORE[0])


def values(weights: Array, pressure: float, state: Array, description: LawDescription) -> list[float]:
    """Row of these columns.

    Parameters
    ----------
    weights : ndarray, shape (npt,)
        Fractions of the area.
    pressure : float
        Mean total pressure [Pa].
    state : ndarray, shape (npt, nstate)
    description : LawDescription
    """
    column = state[:, description.columns(PORE[0])][:, 0]
    mean = float(weights @ column)
    return [mean, float(column.min()), float(column.max()), pressure - mean]


def tell(columns: Mapping[str, Any], name: str, record: Record, screen: Screen) -> None:
    """How far the pore pressure went, and a warning if water cannot follow; nothing where there is no such column."""
    if name not in columns:
        return
    pressure = columns.get("pore_pressure_largest", columns["pore_pressure"])
    screen.say(
        f"pore pressure {float(np.min(columns[name])) / 1e3:.4g} to {float(np.max(pressure)) / 1e3:.4g} kPa, at the "
        f"end {columns['pore_pressure'][-1] / 1e3:.4g} kPa on the mean; stress, p and q are total in files, q/p is "
        "that of the effective stress"
    )
    text = boiling(columns[name], columns["step"], "" if name == PORE[0] else " at some points")
    if text:
        screen.say(text)
        record.details["boiling"] = text
        record.write()


def boiling(smallest: Any, steps: Any, points: str = "") -> str:
    """A warning for pore pressures that water cannot have; empty if there are none."""
    low = np.asarray(smallest, dtype=np.float64)
    beyond = np.flatnonzero(low < CAVITATION)
    if not beyond.size:
        return ""
    return (
        f"warning: from step {int(steps[int(beyond[0])])} on the pore pressure is below -100 kPa{points} (down to "
        f"{low.min() / 1e3:.4g} kPa): water boils there, if pressures count from that of the atmosphere, and no "
        "longer keeps the volume; the computed strength from there on is too high"
    )
