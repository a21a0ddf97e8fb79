"""Curves made by the law itself with parameters that are known."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from granfabric.cases.fit.reading import Curve, curve_of
from granfabric.cases.fit.settings import given
from granfabric.cases.fit.study import Fitted, fit
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Integration, Material
from granfabric.constitutive.path import Leg, drive

TRUTH = {
    "coordination": 4.06, "solid_fraction": 0.846, "normal_stiffness": 1e9, "force_density_at_zero": 0.62,
    "force_anisotropy_ratio": 0.93, "bulk_reduction": 0.9, "shear_reduction": 0.7,
}  # fmt: skip
HELD = ("material.solid_fraction=0.846", "material.normal_stiffness=1e9")
SOURCE = (*HELD, "closure.force_change=mean_field")
KNOWN = (*SOURCE, "material.force_anisotropy_ratio=0.93")
START = (-1e5, -1e5, 0.0)
CONSTANT_P = [Leg(target=(-7e4, -13e4, 0.0), increments=15)]
CYCLE = [*CONSTANT_P, Leg(target=(-9e4, -11e4, 0.0), increments=10)]
LATERAL = [Leg(target=(-1e5, -1.7e5, 0.0), increments=15)]
COMPRESSION = [Leg(target=(-2e5, -2e5, 0.0), increments=10)]
SHORT = {
    "coordination": "z", "fabric_anisotropy": "a_c", "normal_force_anisotropy": "a_n", "stress_ratio": "q/p",
    "tangential_force_anisotropy": "a_t",
}  # fmt: skip


def columns(
    legs: Sequence[Leg], closure: dict[str, Any] | None = None, sliding: bool = False, **other: float
) -> dict[str, Any]:
    """Columns of the law along a path, with q/p; numerics as those of a fit, so that it can be met exactly."""
    law = ContactLaw(
        [Material(**{**TRUTH, **other})],
        closure=Closure(**(closure or {})),
        effects=Effects(sliding=sliding),
        integration=Integration(integrator="dormand_prince", tolerance=1e-8),
    )
    history = drive(law, START, legs)
    assert history.finished
    return {**history.columns, "stress_ratio": history.columns["q"] / history.columns["p"]}


def some(table: dict[str, Any], *names: str) -> Curve:
    """Some columns of a path as a curve."""
    return curve_of({name: table[name] for name in names})


def noisy(table: dict[str, Any], seed: int, **size: float) -> dict[str, Any]:
    """Columns with normal noise of known size."""
    random = np.random.default_rng(seed)
    return {
        name: values + size[name] * random.standard_normal(len(values)) if name in size else values
        for name, values in table.items()
    }


def fitted(curves: Curve | list[Curve], settings: Sequence[str] = SOURCE, *free: str) -> Fitted:
    """A fit without a command."""
    every = curves if isinstance(curves, list) else [curves]
    return fit(every, given(settings), free, lambda fraction, text: None, lambda: False)


def written(file: Path, table: dict[str, Any], *names: str) -> Path:
    """A CSV file with some columns, by their short names."""
    lines = [",".join(SHORT.get(name, name) for name in names)]
    lines += [",".join(repr(float(table[name][row])) for name in names) for row in range(len(table[names[0]]))]
    file.write_text("\n".join(lines) + "\n")
    return file
