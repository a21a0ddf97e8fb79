"""The model side of the comparison: every closure of the point law, fed with the inputs of one packing."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.scene.material_file import law_tables
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Material
from granfabric.constitutive.path import Leg, drive

Array = NDArray[np.float64]

SOURCE = "mean_field"
SOURCE_CLOSED = "mean_field, self-consistent"
BEST = "shifted_distribution, frictional"


@dataclass(frozen=True)
class Curve:
    """One closure along one loading.

    Attributes
    ----------
    columns : dict of str to ndarray, shape (nlevels,)
        The quantities compared, at the stress ratios asked for; NaN where the point law could not go on.
    message : str
        Why not, if so.
    seconds : float
    """

    columns: dict[str, Array]
    message: str
    seconds: float


def closures(inputs: Mapping[str, float]) -> dict[str, Closure]:
    """Every closure that the point law offers, by the name under which it is compared.

    The source's neglects the change of a_t, and comes once more with the self-consistent relation, as do the others,
    but that shifted weak forces go with friction (and once without). Measured parameters of a closure go to those that
    use them.
    """
    found = {SOURCE: Closure(), SOURCE_CLOSED: Closure(tangential="self_consistent")}
    measured: dict[str, Any] = law_tables(inputs).get("closure", {})
    tables = law_tables(inputs)["material"]
    if tables.get("isostatic_coordination", np.inf) < tables["coordination"]:
        measured = {**measured, "shear_stiffness": "isostatic"}
    found["fluctuating"] = Closure(force_change="fluctuating", tangential="self_consistent", **measured)
    shifted = {"force_change": "shifted_distribution", **measured}
    found["shifted_distribution, self-consistent"] = Closure(tangential="self_consistent", **shifted)
    found[BEST] = Closure(tangential="frictional", **shifted)
    return found


def material(inputs: Mapping[str, float]) -> Material:
    """The material that was measured."""
    return Material(**law_tables(inputs)["material"])


def targets(loading: str, pressure: float, levels: Sequence[float]) -> list[tuple[float, float, float]]:
    """Stresses xx, yy, xy [Pa] (tension positive) of a compression along y at the given q/p."""
    points = []
    for ratio in levels:
        if loading == "constant_pressure":
            points.append((-pressure * (1.0 - ratio), -pressure * (1.0 + ratio), 0.0))
        else:
            points.append((-pressure, -pressure * (1.0 + ratio) / (1.0 - ratio), 0.0))
    return points


def follow(closure: Closure, inputs: Mapping[str, float], loading: str, pressure: float, levels: Array) -> Curve:
    """Drive the point law from isotropic stress along a loading.

    Parameters
    ----------
    closure : Closure
    inputs : mapping
        Measured on the packing.
    loading : str
        One of `verify_dem.LOADINGS`.
    pressure : float
        Initial mean pressure [Pa].
    levels : ndarray, shape (nlevels,)
        Stress ratios q/p, ascending from 0.
    """
    law = ContactLaw([material(inputs)], closure=closure, effects=Effects())
    legs = [Leg(target=target) for target in targets(loading, pressure, levels[1:].tolist())]
    since = time.perf_counter()
    history = drive(law, (-pressure, -pressure, 0.0), legs)
    seconds = time.perf_counter() - since
    found = history.columns
    columns = {
        "coordination": found["coordination"],
        # The major compression is along y: components along it, as the DEM reports them.
        "fabric_anisotropy": -found["fabric_anisotropy_1"],
        "normal_force_anisotropy": -found["normal_force_anisotropy_1"],
        "tangential_force_anisotropy": -found["tangential_force_anisotropy_1"],
        "mean_normal_force": found["mean_normal_force"],
    }
    for name, values in columns.items():
        columns[name] = np.full(len(levels), np.nan)
        columns[name][: len(values)] = values
    return Curve(columns, "" if history.finished else history.message, seconds)
