"""What a curve prescribes and what it is compared with: legs from row to row, and the columns left to the law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import InputError
from granfabric.constitutive.path import Control, Leg

from .columns import BY_NAME, INVARIANTS, STRAIN, STRESS, VECTORS
from .reading import Curve

Array = NDArray[np.float64]
Preferred = Literal["stress", "strain"]

CONSISTENT = 0.02
"""Of the mean pressure: a p or q that differs more from the stress components beside it is a mistake."""
LARGEST_TURN = 5.0
"""[degrees] of the principal axes in one leg between rows that are given by p, q and their direction."""
ENOUGH_TURN = 0.03
"""Part of the stress deviator across its first direction, over the largest deviator, from which principal axes turn:
what simulated or measured stresses have there otherwise is noise."""
ENOUGH_DEVIATOR = 1e-3
"""Deviator over the pressure from which it has a direction."""
NOTHING = 1e-9
"""Shear component over the largest one below which it is rounding."""
STRAIN_OF_NOTHING = 1e-6
"""Scale of a column of strains that are all zero."""


@dataclass(frozen=True)
class Followed:
    """A curve as the law follows and is compared with it.

    Attributes
    ----------
    curve : Curve
    initial_stress : ndarray, shape (3,)
        Of the first row, or as given where that does not tell it; tension positive [Pa].
    legs : list of Leg
    row_steps : ndarray of int, shape (nrows,)
        Step of the path at which each row is reached.
    driven : list of str
        Columns that prescribe the path.
    compared : dict of str to ndarray, shape (nrows,)
        Columns that the law is compared with; NaN where nothing was measured.
    scales : dict of str to ndarray, shape (nrows,)
        Deviation that counts as one: the file's standard error, or a stated scale.
    known_errors : set of str
        Columns whose scale is the file's standard error.
    pressure, stress_ratio : ndarray, shape (nrows,)
        As prescribed; NaN where strain is.
    axis : ndarray, shape (2,)
        Direction along which signed anisotropies count, in the double-angle plane.
    turns : bool
        Whether principal axes leave the line on which they began; then they count by magnitude.
    """

    curve: Curve
    initial_stress: Array
    legs: list[Leg]
    row_steps: NDArray[np.int64]
    driven: list[str]
    compared: dict[str, Array]
    scales: dict[str, Array]
    known_errors: frozenset[str]
    pressure: Array
    stress_ratio: Array
    axis: Array
    turns: bool


def follow(
    curve: Curve,
    control: Preferred | Sequence[Preferred],
    initial_stress: Array | None = None,
    scales: dict[str, float] | None = None,
) -> Followed:
    """How a curve is followed.

    A component of stress is prescribed where it is given, else that of strain; with ``control = "strain"`` the other
    way round. A component of which neither is given keeps its stress.

    Parameters
    ----------
    curve : Curve
    control : {"stress", "strain"}, or three of them for xx, yy, xy
        What is prescribed where both are given.
    initial_stress : ndarray, shape (3,), optional
        Of components that the first row does not tell.
    scales : dict of str to float, optional
        Deviation that counts as one, by column, instead of the usual one; as in `Column.scale`.

    Raises
    ------
    InputError
        If the columns do not tell a path, contradict each other, or pull.
    """
    strains = _strains(curve)
    stresses, used = _stresses(curve, initial_stress)
    if not any(name in strains for name in STRAIN) and all(values is None for values in stresses):
        raise InputError(
            f"{curve.place}: no column tells the path; it takes stress_xx, stress_yy, stress_xy, or p with q or "
            "stress_ratio, or strain_xx, strain_yy, strain_xy"
        )
    start = _initial(curve, stresses, initial_stress)
    kinds: list[Control] = []
    preferred = [control] * 3 if isinstance(control, str) else list(control)
    for number, strain in enumerate(STRAIN):
        by_strain = strain in strains and (preferred[number] == "strain" or stresses[number] is None)
        kinds.append("strain" if by_strain else "stress")
    given = [kinds[n] == "strain" or stresses[n] is not None for n in range(3)]
    table = np.empty((curve.rows, 3))
    for number in range(3):
        column = strains.get(STRAIN[number]) if kinds[number] == "strain" else stresses[number]
        table[:, number] = start[number] if column is None else column
    wanted = {STRESS[n] if kinds[n] == "stress" else STRAIN[n] for n in range(3) if given[n]}
    driven = [name for name in curve.columns if name in wanted]
    if kinds[0] == kinds[1] == "stress" and any(given[:2]):
        driven += [name for name in used if name not in driven]
    legs, row_steps = _legs(curve, tuple(kinds), table, used)
    pressure = ratio = np.full(curve.rows, np.nan)
    if kinds[0] == kinds[1] == "stress":
        pressure = -0.5 * (table[:, 0] + table[:, 1])
        shear = table[:, 2] if kinds[2] == "stress" else np.zeros(curve.rows)
        ratio = np.hypot(0.5 * (table[:, 0] - table[:, 1]), shear) / pressure
        _see_that_it_pushes(curve, pressure, ratio)
    compared = _compared(curve, strains, set(driven), kinds, table)
    if not compared:
        raise InputError(
            f"{curve.place}: every column is needed to tell the path; there is none to compare the law with, such as "
            "coordination (z), fabric_anisotropy (a_c) or, under stress, strain_yy"
        )
    weights = {name: _scale(curve, name, values, start, scales or {}) for name, values in compared.items()}
    known = frozenset(name for name in compared if name in curve.errors)
    axis = _axis(table if kinds == ["stress"] * 3 else np.array([start]))
    turns = _turns(curve, table, kinds)
    return Followed(curve, start, legs, row_steps, driven, compared, weights, known, pressure, ratio, axis, turns)


def _complete(curve: Curve, name: str) -> Array:
    """A column that prescribes something: without gaps."""
    values = curve.columns[name]
    if np.isnan(values).any():
        row = int(np.argmax(np.isnan(values)))
        raise InputError(f"{curve.where(row, name)}: an empty cell, but this column prescribes the path")
    return values


def _strains(curve: Curve) -> dict[str, Array]:
    """Strain counted from the first row."""
    found = {}
    for name in (*STRAIN, "volumetric_strain", "shear_strain"):
        if name in curve.columns:
            values = curve.columns[name]
            if np.isnan(values[0]):
                raise InputError(f"{curve.where(0, name)}: an empty cell in the first row, from which strain counts")
            found[name] = values - values[0]
    return found


def _stresses(curve: Curve, initial: Array | None) -> tuple[list[Array | None], list[str]]:
    """Components of stress as far as they are given, and the columns that were used for them."""
    have = curve.columns
    components: list[Array | None] = [_complete(curve, name) if name in have else None for name in STRESS]
    if components[0] is not None or components[1] is not None or components[2] is not None:
        _see_that_it_agrees(curve, components)
        return components, []
    if not any(name in have for name in INVARIANTS):
        return components, []
    ratio = "stress_ratio" in have
    if "p" in have:
        pressure = _complete(curve, "p")
        if not ratio and "q" not in have:
            raise InputError(f"{curve.place}: p without q or stress_ratio (q/p); write q = 0 for isotropic loading")
    elif ratio and "q" not in have:
        if initial is None:
            raise InputError(
                f"{curve.place}: stress_ratio (q/p) without p: give a column p, or for a constant mean pressure its "
                "value by --set initial.stress=[-100e3, -100e3, 0.0]"
            )
        pressure = np.full(curve.rows, -0.5 * float(initial[0] + initial[1]))
    elif ratio:
        with np.errstate(all="ignore"):
            pressure = _complete(curve, "q") / _complete(curve, "stress_ratio")
        if not np.isfinite(pressure).all():
            row = int(np.argmax(~np.isfinite(pressure)))
            raise InputError(f"{curve.where(row, 'stress_ratio')}: q and q/p do not tell p where they are zero")
    else:
        raise InputError(f"{curve.place}: q without p or stress_ratio (q/p), which tell the mean pressure")
    deviator = _complete(curve, "q") if "q" in have else pressure * _complete(curve, "stress_ratio")
    used = [name for name in INVARIANTS if name in have]
    angle = _complete(curve, "major_stress_angle") if "major_stress_angle" in have else np.full(curve.rows, 90.0)
    _see_that_it_pushes(curve, pressure, np.abs(deviator) / np.where(pressure == 0.0, 1.0, pressure))
    return list(_components(pressure, deviator, angle)), used


def _components(pressure: Array, deviator: Array, degrees: Array) -> tuple[Array, Array, Array]:
    """Stresses, tension positive, of a pressure, half difference of principal stresses and direction of the major."""
    twice = 2.0 * np.deg2rad(degrees)
    half = deviator * np.cos(twice)
    shear = -deviator * np.sin(twice)
    shear[np.abs(shear) < 1e-15 * np.abs(pressure)] = 0.0
    return -(pressure + half), -(pressure - half), shear


def _see_that_it_agrees(curve: Curve, components: list[Array | None]) -> None:
    """Refuse p, q or q/p that contradict the stress components beside them."""
    xx, yy, xy = components
    if xx is None or yy is None:
        return
    pressure = -0.5 * (xx + yy)
    deviator = np.hypot(0.5 * (xx - yy), 0.0 if xy is None else xy)
    _see_that_it_pushes(curve, pressure, deviator / np.where(pressure == 0.0, 1.0, pressure))
    for name, values, size in (
        ("p", pressure, pressure), ("q", deviator, pressure), ("stress_ratio", deviator / pressure, 1.0)
    ):  # fmt: skip
        if name not in curve.columns or (name != "p" and xy is None):
            continue
        off = np.abs(np.abs(curve.columns[name]) - values) > CONSISTENT * size
        if off.any():
            row = int(np.argmax(off))
            raise InputError(
                f"{curve.where(row, name)}: {curve.shown(row, name)} contradicts the stress components beside it, "
                f"from which it is {values[row]:g} (p = -(stress_xx + stress_yy)/2, q half the difference of the "
                "principal stresses)"
            )


def _see_that_it_pushes(curve: Curve, pressure: Array, ratio: Array) -> None:
    """Refuse a mean pressure at or below zero, and a principal stress that pulls."""
    for wrong, text in (
        (~(pressure > 0.0), "the mean pressure is {0:g} Pa, but grains need one above zero: tension is positive in "
         "stress_xx and stress_yy, compression in p"),
        (~(ratio <= 1.0), "q is {1:g} times p, so that a principal stress pulls, which grains do not bear"),
    ):  # fmt: skip
        if wrong.any():
            row = int(np.argmax(wrong))
            raise InputError(f"{curve.place}, line {curve.lines[row]}: " + text.format(pressure[row], ratio[row]))


def _initial(curve: Curve, stresses: list[Array | None], given: Array | None) -> Array:
    """Stress at the start: of the first row, or as given; a shear stress that nobody tells is zero."""
    missing = [STRESS[n] for n in (0, 1) if stresses[n] is None]
    if missing and given is None:
        raise InputError(
            f"{curve.place}: the first row does not tell {' and '.join(missing)}: give the stress at the start by "
            "--set initial.stress=[-100e3, -100e3, 0.0]"
        )
    known = np.zeros(3) if given is None else np.asarray(given, dtype=float)
    return np.array([known[n] if values is None else values[0] for n, values in enumerate(stresses)])


def _legs(
    curve: Curve, control: tuple[Control, ...], table: Array, used: list[str]
) -> tuple[list[Leg], NDArray[np.int64]]:
    """A straight leg from row to row; more where the direction of the major stress is given and turns."""
    kinds = (control[0], control[1], control[2])
    legs: list[Leg] = []
    steps = [0]
    for row in range(1, curve.rows):
        for target in _between(curve, table, row, "major_stress_angle" in used and kinds == ("stress",) * 3):
            legs.append(Leg(control=kinds, target=(float(target[0]), float(target[1]), float(target[2]))))
        steps.append(len(legs))
    return legs, np.array(steps)


def _between(curve: Curve, table: Array, row: int, turns: bool) -> Array:
    """Ends of the legs that lead to a row."""
    end = table[row : row + 1]
    if not turns:
        return end
    angles = curve.columns["major_stress_angle"][row - 1 : row + 1]
    parts = int(np.ceil(abs(angles[1] - angles[0]) / LARGEST_TURN))
    if parts <= 1:
        return end
    along = np.arange(1, parts) / parts
    pair = table[row - 1 : row + 1]
    pressure = -0.5 * (pair[:, 0] + pair[:, 1])
    deviator = np.hypot(0.5 * (pair[:, 0] - pair[:, 1]), pair[:, 2])
    mixed = [values[0] + along * (values[1] - values[0]) for values in (pressure, deviator, angles)]
    return np.vstack([np.column_stack(_components(*mixed)), end])


def _compared(
    curve: Curve, strains: dict[str, Array], driven: set[str], kinds: list[Control], table: Array
) -> dict[str, Array]:
    """Columns that the law is compared with, each quantity once."""
    have = curve.columns
    components = any(name in have for name in STRESS)
    found: dict[str, Array] = {}
    for column in BY_NAME.values():
        name = column.name
        if name not in have or name in driven or column.scale == 0.0:
            continue
        if name in STRESS and kinds[STRESS.index(name)] == "stress":
            continue
        if name in INVARIANTS and (components or kinds[0] == kinds[1] == "stress"):
            continue  # told by the components
        if name in ("p", "stress_ratio") and "stress" in kinds[:2]:
            continue  # one normal stress is prescribed: q tells the other
        if name == "q" and "stress_ratio" in have and "p" in have:
            continue
        values = strains.get(name, have[name])
        if name in ("strain_xy", "stress_xy") and _is_nothing(curve, name, values):
            continue  # coaxial: zero by symmetry, not by measurement
        if name in ("volumetric_strain", "shear_strain") and {"strain_xx", "strain_yy"} <= set(have):
            continue
        found[name] = values
    turns, axis = _turns(curve, table, kinds), _axis(table)
    for name in VECTORS:
        parts = [f"{name}_1", f"{name}_2"]
        if not all(part in found for part in parts):
            continue
        if turns or any(part in curve.errors for part in parts):
            found.pop(name, None)
        else:
            found[name] = axis[0] * found.pop(parts[0]) + axis[1] * found.pop(parts[1])
    return {name: values for name, values in found.items() if np.isfinite(values[1:]).any()}


def _is_nothing(curve: Curve, name: str, values: Array) -> bool:
    """Whether a shear component is zero but for rounding."""
    family = [curve.columns[other] for other in (STRAIN if name in STRAIN else STRESS) if other in curve.columns]
    return bool(np.nanmax(np.abs(values)) <= NOTHING * max(np.nanmax(np.abs(other)) for other in family))


def _turns(curve: Curve, table: Array, kinds: list[Control]) -> bool:
    """Whether the principal axes leave the line on which they began."""
    if kinds != ["stress"] * 3:
        return "strain_xy" in curve.columns and bool(np.ptp(curve.columns["strain_xy"]) > 0.0)
    vectors = np.column_stack([0.5 * (table[:, 0] - table[:, 1]), table[:, 2]])
    first = _axis(table)
    across = np.abs(vectors @ np.array([-first[1], first[0]])).max()
    largest = max(np.hypot(vectors[:, 0], vectors[:, 1]).max(), ENOUGH_DEVIATOR * np.abs(table[:, :2]).max())
    return bool(across > ENOUGH_TURN * largest)


def _axis(table: Array) -> Array:
    """Direction of the first deviator that matters, in the double-angle plane; along y if there is none."""
    vectors = np.column_stack([-0.5 * (table[:, 0] - table[:, 1]), -table[:, 2]])
    sizes = np.hypot(vectors[:, 0], vectors[:, 1])
    there = sizes > ENOUGH_DEVIATOR * np.abs(table[:, :2]).max()
    if not there.any():
        return np.array([-1.0, 0.0])
    row = int(np.argmax(there))
    return np.asarray(vectors[row] / sizes[row])


def _scale(curve: Curve, name: str, values: Array, start: Array, given: dict[str, float]) -> Array:
    """Deviation that counts as one, by row."""
    if name in curve.errors:
        return np.where(np.isnan(values), 1.0, curve.errors[name])
    size = given.get(name, BY_NAME[name].scale)
    if BY_NAME[name].unit == "Pa":
        size *= -0.5 * float(start[0] + start[1])
    elif name.endswith("_strain") or name.startswith("strain_"):
        size *= _largest_strain(curve) if name in STRAIN else float(np.nanmax(np.abs(values)))
    return np.full(curve.rows, size if size > 0.0 else STRAIN_OF_NOTHING)


def _largest_strain(curve: Curve) -> float:
    """Largest component of strain of a curve, counted from its first row."""
    found = [curve.columns[name] - curve.columns[name][0] for name in STRAIN if name in curve.columns]
    return float(max(np.nanmax(np.abs(values)) for values in found))
