"""Numbers of a path of stress that tell which effects can matter, and first-order bounds of what they do.

With ``s`` the stress-ratio vector and ``d = dp/p``, the change of the mean force in a direction is at most
``|d| + |w|`` with ``|w| <= 2 |ds| + |a_n d|``; a path that goes on straight at constant p loses ``(2 P0/pi) |ds|`` of
its contacts and gains ``a_c = P0 |ds|`` [first order of eqs 10-12]. Everything here is an area-weighted quantile over
the points, so that a singular corner does not speak for the scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.parameters import Material
from granfabric.constitutive.pore_fluid import fluid_stiffness

from .probe import Paths

Array = NDArray[np.float64]

FRACTION = 0.99
"""Fraction of the area on which a number is not exceeded."""
LOW_PRESSURE = 0.02
"""Fraction of its initial value below which the pressure of a point counts as nearly gone."""
TURNING = 0.02
"""Least stress ratio with which a direction of principal stress means something."""
DIRECTIONS = 12
"""Directions of the double-angle plane, over half of it, in which is looked for what turns back."""


def quantile(values: Array, weights: Array, fraction: float = FRACTION) -> float:
    """Value that is exceeded on less than ``1 - fraction`` of the area."""
    if not len(values):
        return 0.0
    order = np.argsort(values, kind="stable")
    place = np.searchsorted(np.cumsum(weights[order]), fraction * weights.sum() * (1.0 - 1e-12))
    return float(values[order][min(place, len(values) - 1)])


@dataclass(frozen=True)
class Numbers:
    """What a path of stress does, each exceeded on less than 1 % of the area; fractions are of the area.

    Parameters
    ----------
    stress_ratio : float
        Largest q/p.
    stress_ratio_way : float
        Length of the way of the stress-ratio vector.
    off_axis : float
        Largest component of the stress-ratio vector off the x-y axes, or of the initial fabric.
    turn_degrees : float
        Turn of the principal axes of stress, where q/p means something.
    pressure_rise, pressure_fall : float
        Largest rise and fall of ln p from the start.
    turning_back : float
        Largest amount by which the stress ratio lies back, in some direction, of its largest size there so far.
    reversal : float
        Fall of q/p from its largest value so far, or way of ln p downwards, whichever is larger.
    gain_bound : float
        beta P_xi0 f/(2 kn r) times the largest possible rise of the mean force.
    loss : float
        (2 P0/pi) times the way of the stress ratio plus P0 times the fall of ln p.
    stiffness_change : float
        First-order relative change of the stiffness: of moduli by that loss, of the coupling by a_c = P0 |ds|.
    low_pressure_fraction : float
        Where the pressure falls nearly to zero.
    excess_pressure : float
        K_f/n times the largest volumetric strain, over the initial p; zero without a fluid.
    """

    stress_ratio: float
    stress_ratio_way: float
    off_axis: float
    turn_degrees: float
    pressure_rise: float
    pressure_fall: float
    turning_back: float
    reversal: float
    gain_bound: float
    loss: float
    stiffness_change: float
    low_pressure_fraction: float
    excess_pressure: float


def numbers(paths: Paths, materials: list[Material], closure: Any) -> Numbers:
    """Numbers of the points' paths."""
    stress = paths.stress
    start = -0.5 * (stress[0, :, 0] + stress[0, :, 1])
    pressure = -0.5 * (stress[..., 0] + stress[..., 1])
    low = (pressure < LOW_PRESSURE * start).any(axis=0)
    pressure = np.maximum(pressure, LOW_PRESSURE * start)
    s = np.stack([-0.5 * (stress[..., 0] - stress[..., 1]), -stress[..., 2]], axis=-1) / pressure[..., None]
    ratio = np.hypot(s[..., 0], s[..., 1])
    log_p = np.log(pressure / start)
    ds = np.hypot(*np.moveaxis(np.diff(s, axis=0), -1, 0))
    way = ds.sum(axis=0)
    steps = np.diff(log_p, axis=0)
    down, up = np.maximum(-steps, 0.0).sum(axis=0), np.maximum(steps, 0.0).sum(axis=0)
    reversal = (np.maximum.accumulate(ratio, axis=0) - ratio).max(axis=0)
    off_axis = np.maximum(np.abs(s[..., 1]).max(axis=0), np.abs(paths.fabric[:, 1]))

    def of(name: str) -> Array:
        return np.array([getattr(material, name) for material in materials])[paths.material_index]

    p0, z = of("force_density_at_zero"), paths.coordination
    room = np.maximum(of("neighbours") - z, 0.0) / z
    force = 2.0 * np.pi * pressure.max(axis=0) / (z * of("solid_fraction") * of("normal_stiffness"))
    rise = up + 2.0 * way + of("force_anisotropy_ratio") * ratio.max(axis=0) * (up + down)
    gain = room * of("gap_density_at_zero") * 0.5 * force * rise
    loss = p0 * (2.0 / np.pi * way + down)
    isostatic = of("isostatic_coordination")
    # d ln G/d ln z of G = z (z - z_iso)
    slope = (2.0 * z - isostatic) / (z - isostatic) if closure.shear_stiffness == "isostatic" else 1.0
    # B/sqrt(K G) of the uniform-strain estimate
    coupling = np.sqrt(0.5 / (1.0 + of("stiffness_ratio")) / (of("bulk_reduction") * of("shear_reduction")))
    change = loss * slope + coupling * p0 * way
    weights = paths.weights
    return Numbers(
        quantile(ratio.max(axis=0), weights),
        quantile(way, weights),
        quantile(off_axis, weights),
        quantile(_turn(s, ratio), weights),
        quantile(log_p.max(axis=0), weights),
        quantile(-log_p.min(axis=0), weights),
        quantile(_turning_back(s), weights),
        quantile(np.maximum(reversal, down), weights),
        quantile(gain, weights),
        quantile(loss, weights),
        quantile(change, weights),
        float(weights[low].sum()),
        quantile(_excess_pressure(paths, materials, start), weights),
    )


def _turning_back(s: Array) -> Array:
    """Largest fall of |s.e| from its largest value so far, over directions e, shape (npt,)."""
    fall = np.zeros(s.shape[1])
    for angle in np.linspace(0.0, np.pi, DIRECTIONS, endpoint=False):
        along = np.abs(s[..., 0] * np.cos(angle) + s[..., 1] * np.sin(angle))
        fall = np.maximum(fall, (np.maximum.accumulate(along, axis=0) - along).max(axis=0))
    return fall


def _excess_pressure(paths: Paths, materials: list[Material], start: Array) -> Array:
    fluid = np.array([fluid_stiffness(material) for material in materials])[paths.material_index]
    volumetric = paths.strain[..., 0] + paths.strain[..., 1]
    if paths.drained is not None:
        volumetric = np.cumsum(np.diff(volumetric, axis=0, prepend=0.0) * ~paths.drained[:, None], axis=0)
    return np.asarray(fluid * np.abs(volumetric).max(axis=0) / start)


def _turn(s: Array, ratio: Array) -> Array:
    """Largest turn of the principal axes from where they first mean something [degrees], shape (npt,)."""
    nodes, npt = ratio.shape
    told = ratio > TURNING
    first = np.where(told.any(axis=0), told.argmax(axis=0), 0)
    reference = s[first, np.arange(npt)]
    cosine = s[..., 0] * reference[:, 0] + s[..., 1] * reference[:, 1]
    sine = s[..., 1] * reference[:, 0] - s[..., 0] * reference[:, 1]
    angle = np.where(told, np.degrees(np.abs(np.arctan2(sine, cosine))) / 2.0, 0.0)
    return np.asarray(angle.max(axis=0)) if nodes else np.zeros(npt)
