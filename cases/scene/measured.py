"""Inputs of the point law measured on disks: values, standard errors, and what is to be said about them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from granfabric.constitutive.parameters import CLOSURE_NUMBERS, Material
from granfabric.dem_ref.inputs.material import measure_fabric, measure_material_with_errors
from granfabric.dem_ref.inputs.probes import at_rest
from granfabric.dem_ref.inputs.weak_contacts import LOOP_STRESS_RATIO
from granfabric.dem_ref.measures.uncertainty import Measured
from granfabric.dem_ref.sample.disks import Sample

ABOUT_ZERO = ("initial_fabric_xx", "initial_fabric_xy", "force_density_slope")
"""Of either sign and often near zero: an error larger than the value is what is to be expected."""

NO_GAP = (
    "none of its gaps is small enough to be counted, and the error is that of one gap: the law gains no contacts with "
    "it; a packing of more disks tells"
)


@dataclass(frozen=True)
class Inputs:
    """What was measured, by the names of scene keys.

    Attributes
    ----------
    values : dict of str to float
    errors : dict of str to float
        Standard errors of one packing against the mean of many made alike; 0 for what was chosen, NaN if not known.
    missing : tuple of str
        What the packing does not give.
    """

    values: dict[str, float] = field(default_factory=dict)
    errors: dict[str, float] = field(default_factory=dict)
    missing: tuple[str, ...] = ()

    def joined(self, other: Inputs) -> Inputs:
        """Both together."""
        return Inputs(self.values | other.values, self.errors | other.errors, (*self.missing, *other.missing))


def inputs_of(measured: Mapping[str, Measured]) -> Inputs:
    """Values that are numbers, and the names of those that are not."""
    found = {name: entry for name, entry in measured.items() if math.isfinite(entry.value)}
    return Inputs(
        {name: float(entry.value) for name, entry in found.items()},
        {name: float(entry.error) if math.isfinite(entry.error) else math.nan for name, entry in found.items()},
        tuple(name for name in measured if name not in found),
    )


def measure_inputs(
    sample: Sample, rattlers: str = "included", loop_stress_ratio: float = LOOP_STRESS_RATIO
) -> Inputs:
    """Everything measured on a packing that the point law may take.

    Besides `dem_ref.material.measure_material_with_errors` the fabric of the packing itself, which is isotropic only on
    average. A packing that is not at rest is held at its stress first.

    Raises
    ------
    SampleError, ProbeError
        If the packing does not come to rest, is not isotropic, or does not carry the probes.
    """
    sample = at_rest(sample)
    measured = measure_material_with_errors(sample, rattlers, loop_stress_ratio)
    xx, xy = measure_fabric(sample)
    return inputs_of(measured | {"initial_fabric_xx": xx, "initial_fabric_xy": xy})


def mean_of(found: Iterable[Inputs]) -> Inputs:
    """Mean over packings; its error from their scatter, or from that of the one packing there is."""
    every = list(found)
    values, errors = {}, {}
    for name in dict.fromkeys(name for inputs in every for name in inputs.values):
        numbers = [inputs.values[name] for inputs in every if name in inputs.values]
        count = len(numbers)
        values[name] = float(np.mean(numbers))
        if count > 1:
            errors[name] = float(np.std(numbers, ddof=1)) / math.sqrt(count)
        else:
            errors[name] = next(inputs.errors.get(name, math.nan) for inputs in every if name in inputs.values)
    gone = dict.fromkeys(name for inputs in every for name in inputs.missing if name not in values)
    return Inputs(values, errors, tuple(gone))


def bounds() -> dict[str, tuple[float, float]]:
    """Bounds of the law for each of its numbers, as the law declares them."""
    return {
        **{variable.name: (variable.lower, variable.upper) for variable in Material.variables()},
        **CLOSURE_NUMBERS,
    }


def remarks(inputs: Inputs) -> dict[str, list[str]]:
    """What is doubtful about which value; nothing for the others."""
    limits, illegal = bounds(), refused(inputs)
    found: dict[str, list[str]] = {}
    for name, value in inputs.values.items():
        said = []
        if name in illegal:
            low, high = limits[name]
            said.append(f"outside the bounds [{low:g}, {high:g}] of the law, which will refuse it")
        error = inputs.errors.get(name, 0.0)
        if math.isnan(error):
            said.append("its error is not known: too few contacts or records")
        elif name == "gap_density_at_zero" and value == 0.0:
            said.append(NO_GAP)
        elif error > abs(value) and name not in ABOUT_ZERO:
            said.append("its error is larger than itself")
        if said:
            found[name] = said
    for name in inputs.missing:
        found[name] = ["this packing does not give it"]
    return found


def refused(inputs: Inputs) -> list[str]:
    """Names of the values that the law will not take."""
    limits = bounds()
    return [
        name
        for name, value in inputs.values.items()
        if name in limits and not limits[name][0] <= value <= limits[name][1]
    ]


def with_error(inputs: Inputs, name: str) -> str:
    """The value with its error, for the screen."""
    if name in inputs.missing:
        return f"{name} is not measured"
    error = inputs.errors.get(name, math.nan)
    shown = f" +- {error:.2g}" if math.isfinite(error) else ""
    return f"{name} = {inputs.values[name]:.4g}{shown}"


def warnings(inputs: Inputs) -> list[str]:
    """One line for each doubtful value; those that the law refuses come last, where they are seen."""
    illegal = refused(inputs)
    said = sorted(remarks(inputs).items(), key=lambda entry: entry[0] in illegal)
    return [f"{with_error(inputs, name)}: {'; '.join(texts)}" for name, texts in said]


def as_data(inputs: Inputs) -> dict[str, dict[str, Any]]:
    """For `run.json`: value, standard error (null if not known) and remarks by name."""
    doubtful = remarks(inputs)
    table: dict[str, dict[str, Any]] = {}
    for name, value in inputs.values.items():
        error = inputs.errors.get(name, math.nan)
        table[name] = {"value": value, "standard_error": error if math.isfinite(error) else None}
    table |= {name: {"value": None, "standard_error": None} for name in inputs.missing}
    for name, said in doubtful.items():
        table[name]["remarks"] = said
    return table


def from_data(table: Any) -> Inputs:
    """Inverse of `as_data`, of a record of whatever origin; what is not such a table gives nothing."""
    values, errors, missing = {}, {}, []
    for name, entry in (table if isinstance(table, dict) else {}).items():
        if not isinstance(entry, dict):
            continue
        value, error = entry.get("value"), entry.get("standard_error")
        if isinstance(value, int | float):
            values[name] = float(value)
            errors[name] = float(error) if isinstance(error, int | float) else math.nan
        else:
            missing.append(name)
    return Inputs(values, errors, tuple(missing))
