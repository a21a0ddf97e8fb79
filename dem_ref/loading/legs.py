"""Legs of a loading path: what is prescribed in each direction of stress/strain space, and how it moves.

Strain increments are conjugate to stresses, so directions are orthonormal in the six-vector sense: order xx, yy, xy
with the shear component times sqrt(2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, hypot, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.sample.disks import SampleError

ROOT2 = sqrt(2.0)
ISOTROPIC = np.array([1.0, 1.0, 0.0]) / ROOT2
DEVIATORIC = np.array([1.0, -1.0, 0.0]) / ROOT2
SHEAR = np.array([0.0, 0.0, 1.0])
COMPONENTS = np.eye(3)


@dataclass
class Leg:
    """One leg of a path.

    Attributes
    ----------
    directions : (3, 3)
        Orthonormal rows in the space (xx, yy, sqrt(2) xy).
    strain_controlled : (3,) bool
        For each direction: strain (True) or stress (False) is prescribed.
    values : callable
        ``values(s, start_stress, start_strain)`` for s in [0, 1]: the prescribed values in the three directions, the
        strain-controlled ones as strain, the others as stress; starts at the start.
    stop : callable, optional
        Ends the leg early when true; called with the current stress and strain (xx, yy, xy).
    hold : bool
        At the end wait until stress and unbalanced force have settled.
    largest_strain : float
        A leg that prescribes stress in every direction gives up when the strain has changed by this much.
    """

    directions: NDArray[np.float64]
    strain_controlled: Sequence[bool]
    values: Callable[[float, NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]
    stop: Callable[[NDArray[np.float64], NDArray[np.float64]], bool] | None = None
    hold: bool = True
    largest_strain: float = 0.05


def to_vector(tensor: NDArray[np.float64]) -> NDArray[np.float64]:
    """(xx, yy, xy) to (xx, yy, sqrt(2) xy)."""
    return np.array([tensor[0], tensor[1], ROOT2 * tensor[2]])


def from_vector(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """(xx, yy, sqrt(2) xy) to (xx, yy, xy)."""
    return np.array([vector[0], vector[1], vector[2] / ROOT2])


def stress_invariants(stress: NDArray[np.float64]) -> tuple[float, float, float]:
    """p, q (compression positive p, q >= 0) and the angle of the major compressive stress from the x axis."""
    p = -0.5 * (stress[0] + stress[1])
    dx, dy = -0.5 * (stress[0] - stress[1]), -stress[2]
    return float(p), float(hypot(dx, dy)), float(0.5 * np.arctan2(dy, dx))


def stress_from_invariants(p: float, q: float, angle: float) -> NDArray[np.float64]:
    """Tension-positive (xx, yy, xy) from p, q and the angle of the major compressive stress from the x axis."""
    return -np.array([p + q * cos(2 * angle), p - q * cos(2 * angle), q * sin(2 * angle)])


def stress_leg(target: Sequence[float], hold: bool = True) -> Leg:
    """Straight stress path to `target` (xx, yy, xy; Pa, tension positive)."""
    end = to_vector(_three(target, "target stress"))
    return Leg(
        COMPONENTS, (False, False, False), lambda s, stress, strain: (1 - s) * to_vector(stress) + s * end, None, hold
    )


def invariant_leg(p: float, q: float, angle: float, hold: bool = True) -> Leg:
    """Path linear in p, q and direction to the given values; turns the principal axes if `angle` differs.

    Parameters
    ----------
    p, q : float
        Pa; p > q >= 0.
    angle : float
        Direction of the major compressive stress from the x axis, radians. The axes turn the shorter way, so that one
        leg turns them by a right angle at most. From an isotropic state the path starts in the final direction.
    """
    if not (np.isfinite([p, q, angle]).all() and p > q >= 0.0):
        raise SampleError(f"the target p = {p}, q = {q} is not a compressive stress with p > q >= 0")

    def values(s: float, stress: NDArray[np.float64], strain: NDArray[np.float64]) -> NDArray[np.float64]:
        p0, q0, angle0 = stress_invariants(stress)
        if q0 < 1e-3 * p0 or q == 0.0:
            start = to_vector(stress)
            return (1 - s) * start + s * to_vector(stress_from_invariants(p, q, angle))
        turn = angle - angle0
        turn -= pi * round(turn / pi)
        at = stress_from_invariants(p0 + s * (p - p0), q0 + s * (q - q0), angle0 + s * turn)
        return to_vector(at)

    return Leg(COMPONENTS, (False, False, False), values, None, hold)


def mixed_leg(
    control: Sequence[str], target: Sequence[float], hold: bool = True, relative: bool = False
) -> Leg:
    """Per component (xx, yy, xy) either ``"stress"`` or ``"strain"`` moved straight to its target.

    `target` is tension positive, shear strain as engineering strain; strains count from the packing and stresses from
    zero, or both from the state at the start of the leg if `relative`.
    """
    if len(control) != 3 or any(c not in ("stress", "strain") for c in control):
        raise SampleError(f"control is {list(control)}, legal are three of 'stress', 'strain'")
    strain_controlled = tuple(c == "strain" for c in control)
    end = _three(target, "target")
    if strain_controlled[2]:
        end[2] *= 0.5
    end = to_vector(end)

    def values(s: float, stress: NDArray[np.float64], strain: NDArray[np.float64]) -> NDArray[np.float64]:
        start = np.where(strain_controlled, to_vector(strain), to_vector(stress))
        if relative:
            return start + s * end
        return (1 - s) * start + s * end

    return Leg(COMPONENTS, strain_controlled, values, None, hold)


def biaxial_leg(
    path: str, shear_strain: float, stress_ratio: float | None = None, angle: float = pi / 2, hold: bool = False
) -> Leg:
    """Biaxial loading driven by strain, so that it can pass a peak.

    Parameters
    ----------
    path : str
        ``"constant_pressure"``: p and the shear stress across the axes keep their values, the deviatoric strain is
        driven. ``"constant_lateral_stress"``: the stress across the axis keeps its value, the axial strain is driven.
        ``"constant_volume"``: volume and the shear stress across the axes keep their values, the deviatoric strain is
        driven.
    shear_strain : float
        Change of the driven strain at the end of the leg, positive for compression along the axis: of eps_1 - eps_2
        at constant pressure or volume, of the axial strain at constant lateral stress. Negative unloads.
    stress_ratio : float, optional
        Stop when q/p, with the sign of loading along the axis, passes this value.
    angle : float
        Direction of the axis from the x axis, radians; pi/2 compresses along y.
    """
    c2, s2 = cos(2 * angle), sin(2 * angle)
    deviator = c2 * DEVIATORIC + s2 * SHEAR
    across = -s2 * DEVIATORIC + c2 * SHEAR
    if path in ("constant_pressure", "constant_volume"):
        directions = np.array([deviator, ISOTROPIC, across])
        length = shear_strain / ROOT2  # deviatoric six-vector of a given eps_1 - eps_2
    elif path == "constant_lateral_stress":
        directions = np.array([(ISOTROPIC + deviator) / ROOT2, (ISOTROPIC - deviator) / ROOT2, across])
        length = shear_strain
    else:
        raise SampleError(
            f"path is '{path}', legal are 'constant_pressure', 'constant_lateral_stress' and 'constant_volume'"
        )
    kept = path == "constant_volume"

    def values(s: float, stress: NDArray[np.float64], strain: NDArray[np.float64]) -> NDArray[np.float64]:
        at = directions @ to_vector(stress)
        along = directions @ to_vector(strain)
        at[0] = along[0] - s * length
        if kept:
            at[1] = along[1]
        return at

    stop = None
    if stress_ratio is not None:
        limit, sign = float(stress_ratio), 1.0 if shear_strain >= 0.0 else -1.0

        def stop(stress: NDArray[np.float64], strain: NDArray[np.float64]) -> bool:
            return sign * (axial_stress_ratio(stress, angle) - limit) >= 0.0

    return Leg(directions, (True, kept, False), values, stop, hold)


def axial_stress_ratio(stress: NDArray[np.float64], angle: float) -> float:
    """q/p with the sign of loading along the axis at `angle`: ``(s_axial - s_lateral)/(2 p)``, compression positive."""
    p = -0.5 * (stress[0] + stress[1])
    return float((-0.5 * (stress[0] - stress[1]) * cos(2 * angle) - stress[2] * sin(2 * angle)) / p)


def _three(values: Sequence[float], what: str) -> NDArray[np.float64]:
    array = np.array(values, dtype=np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise SampleError(f"{what} must be three finite numbers xx, yy, xy; got {values}")
    return array
