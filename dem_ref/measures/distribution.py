"""Distribution of normal forces, overall and by direction, and its behaviour at zero force."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .contacts import Contacts
from .uncertainty import jackknife

FORCE_WINDOW = 0.5


@dataclass(frozen=True)
class Density:
    """A histogram as probability density.

    Attributes
    ----------
    value : (bins,)
        Centres of the bins.
    density : (bins,)
        Probability density; integrates to the fraction of the data that lies within the bins.
    count : int
        Number of data.
    """

    value: NDArray[np.float64]
    density: NDArray[np.float64]
    count: int


@dataclass(frozen=True)
class EdgeFit:
    """Straight line ``value + slope x`` through a density near x = 0, with standard errors."""

    value: float
    slope: float
    value_error: float
    slope_error: float


def edge_density(data: NDArray[np.float64], window: float) -> EdgeFit:
    """Value and slope at zero of the density of non-negative data.

    The density is taken as a straight line on [0, window]. The fraction of the data in the window and their mean there
    fix its two coefficients (no bins): with ``w`` the window, the estimator is the mean over all data of
    ``h(x) = 4/w - 6 x/w^2`` for the value and ``12 x/w^3 - 6/w^2`` for the slope, zero outside the window.
    """
    n = len(data)
    if n < 2:
        return EdgeFit(0.0, 0.0, np.inf, np.inf)
    inside = (data >= 0.0) & (data < window)
    value = np.where(inside, 4.0 / window - 6.0 * data / window**2, 0.0)
    slope = np.where(inside, 12.0 * data / window**3 - 6.0 / window**2, 0.0)
    root = np.sqrt(n)
    return EdgeFit(float(value.mean()), float(slope.mean()), float(value.std() / root), float(slope.std() / root))


def edge_errors(data: NDArray[np.float64], block: NDArray[np.int64], window: float) -> tuple[float, float]:
    """Standard errors of value and slope of `edge_density` of data over their mean, where neighbours go together.

    Parameters
    ----------
    data : (n,)
    block : (n,)
        Block of the packing in which each lies.
    window : float
        In units of the mean.

    Returns
    -------
    value, slope : float
        From leaving out blocks, mean included; at least that of independent data with one more in the window.
    """

    def without(number: int) -> list[float]:
        kept = data[block != number]
        fit = edge_density(kept / kept.mean(), window)
        return [fit.value, fit.slope]

    inside = np.count_nonzero(data < window * data.mean())
    counted = np.sqrt(inside + 1.0) / len(data) * np.array([2.0 / window, np.sqrt(12.0) / window**2])
    value, slope = np.fmax(jackknife(without), counted)
    return float(value), float(slope)


def histogram(data: NDArray[np.float64], edges: NDArray[np.float64]) -> Density:
    """Probability density of `data` in bins."""
    count, _ = np.histogram(data, bins=edges)
    return Density(0.5 * (edges[1:] + edges[:-1]), count / (np.diff(edges) * max(len(data), 1)), len(data))


@dataclass(frozen=True)
class ForceDistribution:
    """Density of normal forces over their mean.

    Attributes
    ----------
    overall : Density
        Of ``f_n/<f_n>`` over all contacts.
    at_zero : EdgeFit
        Of the same: P0 and its slope.
    angle : (sectors,)
        Centres of direction sectors, radians in [0, pi).
    by_direction : list of Density
        Per sector, forces over the mean of that sector.
    at_zero_by_direction : list of EdgeFit
    """

    overall: Density
    at_zero: EdgeFit
    angle: NDArray[np.float64]
    by_direction: list[Density]
    at_zero_by_direction: list[EdgeFit]


def force_distribution(
    contacts: Contacts, sectors: int = 6, bins: int = 40, largest: float = 4.0, window: float = FORCE_WINDOW
) -> ForceDistribution:
    """Distribution of the normal forces, overall and in direction sectors (one centred on the x axis)."""
    edges = np.linspace(0.0, largest, bins + 1)
    force = contacts.normal_force
    scaled = force / force.mean()
    theta = np.arctan2(contacts.normal[:, 1], contacts.normal[:, 0])
    sector = np.floor(theta / np.pi * sectors + 0.5).astype(np.int64) % sectors
    parts = [force[sector == s] for s in range(sectors)]
    parts = [part / part.mean() if len(part) else part for part in parts]
    return ForceDistribution(
        histogram(scaled, edges),
        edge_density(scaled, window),
        np.arange(sectors) * np.pi / sectors,
        [histogram(part, edges) for part in parts],
        [edge_density(part, window) for part in parts],
    )
