"""The law along a user's curves, for any values of its parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import ParameterError
from granfabric.constitutive.path import PathHistory, drive

from .columns import VECTORS
from .following import Followed
from .settings import Base

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Answer:
    """The law's columns along one curve.

    Attributes
    ----------
    columns : dict of str to ndarray, shape (nrows,)
        As the curve's; NaN beyond the row where the law refused.
    reached : int
        Rows that were reached.
    message : str
        Why not all, if so.
    pressure, stress_ratio : ndarray, shape (nrows,)
        p [Pa] and q/p on the way.
    """

    columns: dict[str, Array]
    reached: int
    message: str
    pressure: Array
    stress_ratio: Array


class LawSide:
    """The law along all curves.

    Parameters
    ----------
    base : Base
    curves : sequence of Followed
    start : {"material", "row"}
        Whether each curve starts from the material's coordination number and fabric or from those of its first row.
    """

    def __init__(self, base: Base, curves: Sequence[Followed], start: str = "material") -> None:
        self.base, self.curves, self.start = base, list(curves), start
        self.drives = 0

    def answers(self, values: Mapping[str, float], stop: Callable[[], bool] | None = None) -> list[Answer]:
        """Columns of the law along each curve; `stop` ends it between two rows."""
        try:
            law = ContactLaw(
                [self.base.material_of(values)],
                closure=self.base.closure_of(values),
                effects=self.base.effects,
                integration=self.base.integration,
            )
        except ParameterError as error:
            return [self._refused(curve, str(error)) for curve in self.curves]
        return [self._along(law, curve, stop) for curve in self.curves]

    def _along(self, law: ContactLaw, curve: Followed, stop: Callable[[], bool] | None) -> Answer:
        self.drives += 1
        try:
            state = self._state(law, curve)
            history = drive(law, tuple(curve.initial_stress), curve.legs, stop=stop, state=state)
        except ParameterError as error:
            return self._refused(curve, str(error))
        reached = int(np.count_nonzero(curve.row_steps < len(history.columns["step"])))
        columns = {}
        for name in (*curve.compared, "p", "stress_ratio"):
            values = np.full(curve.curve.rows, np.nan)
            values[:reached] = _column(name, history, curve)[curve.row_steps[:reached]]
            columns[name] = values
        path = [np.where(np.isnan(told), columns[name], told) for name, told in _path(curve)]
        message = "" if history.finished else history.message.partition(": ")[2]
        return Answer({name: columns[name] for name in curve.compared}, reached, message, path[0], path[1])

    def _state(self, law: ContactLaw, curve: Followed) -> Array | None:
        """State at the start from the first row, as far as that tells it; None for the material's."""
        if self.start != "row":
            return None
        first = first_row(curve)
        coordination = np.array([first["coordination"]]) if "coordination" in first else None
        own = law.materials[0]
        fabric = [
            first.get(name, getattr(own, name)) for name in ("initial_fabric_xx", "initial_fabric_xy")
        ]
        return law.initial_state(
            curve.initial_stress[None, :], coordination=coordination, fabric_anisotropy=np.array([fabric])
        )

    @staticmethod
    def _refused(curve: Followed, message: str) -> Answer:
        nothing = {name: np.full(curve.curve.rows, np.nan) for name in curve.compared}
        return Answer(nothing, 0, message, curve.pressure, curve.stress_ratio)


def _path(curve: Followed) -> list[tuple[str, Array]]:
    return [("p", curve.pressure), ("stress_ratio", curve.stress_ratio)]


def first_row(curve: Followed) -> dict[str, float]:
    """Coordination number and fabric of the first row by the names of the material's parameters."""
    found: dict[str, float] = {}
    columns = curve.curve.columns

    def first(name: str) -> float | None:
        value = columns[name][0] if name in columns else np.nan
        return float(value) if np.isfinite(value) else None

    if (z := first("coordination")) is not None:
        found["coordination"] = z
    along = first("fabric_anisotropy")
    parts = (first("fabric_anisotropy_1"), first("fabric_anisotropy_2"))
    if parts[0] is not None and parts[1] is not None:
        found["initial_fabric_xx"], found["initial_fabric_xy"] = parts[0], parts[1]
    elif along is not None:
        vector = along * curve.axis
        found["initial_fabric_xx"], found["initial_fabric_xy"] = float(vector[0]) + 0.0, float(vector[1]) + 0.0
    return found


def _column(name: str, history: PathHistory, curve: Followed) -> Array:
    """A column of a history by the name that a user's curve has for it."""
    columns = history.columns
    if name == "stress_ratio":
        return np.asarray(columns["q"] / columns["p"])
    if name == "volumetric_strain":
        return np.asarray(columns["strain_xx"] + columns["strain_yy"])
    if name == "shear_strain":
        return np.hypot(columns["strain_xx"] - columns["strain_yy"], columns["strain_xy"])
    if name in VECTORS:
        return _signed(columns, name, curve)
    return np.asarray(columns[name], dtype=float)


def _signed(columns: Mapping[str, Array], name: str, curve: Followed) -> Array:
    """A vector of the double-angle plane as one number: its part along the axis, or its magnitude with that sign."""
    one, two = columns[f"{name}_1"], columns[f"{name}_2"]
    along = one * curve.axis[0] + two * curve.axis[1]
    return np.asarray(np.copysign(np.hypot(one, two), along) if curve.turns else along)
