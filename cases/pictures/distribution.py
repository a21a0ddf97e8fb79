"""Distributions of contact forces and of gaps, with what the point law takes from them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.measures.distribution import FORCE_WINDOW, Density, EdgeFit, ForceDistribution
from granfabric.dem_ref.measures.tessellation import GapDistribution

from .style import BLACK, BLUE, RED


def outline(axes: Any, density: Density, **options: Any) -> None:
    """Draw a histogram as steps."""
    width = float(density.value[1] - density.value[0])
    edges = np.append(density.value - width / 2, density.value[-1] + width / 2)
    axes.stairs(density.density, edges, **options)


def _line(axes: Any, fit: EdgeFit, window: float, symbol: str) -> None:
    x = np.array([0.0, window])
    text = f"line on [0, {window:g}]: {symbol} = {fit.value:.2f} $\\pm$ {fit.value_error:.2f}"
    axes.plot(x, fit.value + fit.slope * x, color=RED, linewidth=2.4, label=text)
    axes.plot(0.0, fit.value, "o", color=RED, clip_on=False, zorder=4)


def draw_force_density(axes: Any, forces: ForceDistribution, text: str = "DEM") -> None:
    """Density of normal forces over their mean, with the straight line at zero force."""
    outline(axes, forces.overall, fill=True, color=BLUE, alpha=0.3)
    outline(axes, forces.overall, color=BLUE, linewidth=1.2, label=f"{text}, {forces.overall.count} contacts")
    _line(axes, forces.at_zero, FORCE_WINDOW, "$P_0$")
    axes.set(
        title="Normal forces", xlabel=r"$\zeta = f_n/\langle f_n \rangle$ [-]", ylabel=r"density $P_n(\zeta)$ [-]",
        xlim=(0.0, 4.0), ylim=(0.0, None),
    )  # fmt: skip
    axes.legend()


def draw_gap_density(axes: Any, gaps: GapDistribution, text: str = "DEM", closing: float | None = None) -> None:
    """Density of the gaps between neighbours that do not touch, with the straight line at zero gap.

    `closing` is the density that the law takes, of the gaps that close under load (`gap_density_at_zero`): so narrow
    that the line says nothing of them, and between disks that bear forces.
    """
    outline(axes, gaps.density, fill=True, color=BLUE, alpha=0.3)
    outline(axes, gaps.density, color=BLUE, linewidth=1.2, label=f"{text}, {gaps.density.count} gaps")
    _line(axes, gaps.at_zero, gaps.window, r"$P_{\xi 0}$" if closing is None else "of all gaps, at 0")
    if closing is not None:
        text = "the law's $P_{\\xi 0}$ (material.toml), of gaps that close: " + f"{closing:.4g}"
        axes.plot([], [], linestyle="none", label=text)
    _power_law(axes, gaps, np.linspace(2e-3, gaps.window, 200))
    axes.set(
        title="Gaps to neighbours in the radical tessellation", xlabel=r"$\xi$ = gap$/2r$ [-]",
        ylabel=r"density $P_\xi(\xi)$ [-]", xlim=(0.0, 0.8), ylim=(0.0, None),
    )  # fmt: skip
    axes.legend()


def draw_small_gaps(axes: Any, xi: NDArray[np.float64], gaps: GapDistribution) -> None:
    """Density of small gaps on logarithmic axes: how far the straight line, and how far a power law, describes it.

    Parameters
    ----------
    axes : Axes
    xi : ndarray
        All positive gaps over the mean diameter.
    gaps : GapDistribution
    """
    edges = np.geomspace(1e-4, 0.8, 24)
    count, _ = np.histogram(xi, edges)
    density, middle = count / (np.diff(edges) * len(xi)), np.sqrt(edges[1:] * edges[:-1])
    seen = count > 0
    error = density[seen] / np.sqrt(count[seen])
    axes.errorbar(middle[seen], density[seen], error, fmt="o", color=BLUE, markersize=4, label="DEM")
    x = np.geomspace(edges[0], gaps.window, 200)
    line = gaps.at_zero.value + gaps.at_zero.slope * x
    axes.plot(x[line > 0.1], line[line > 0.1], color=RED, linewidth=2.4, label="straight line")
    _power_law(axes, gaps, x)
    axes.set(
        title="Small gaps", xscale="log", yscale="log", xlabel=r"$\xi$ = gap$/2r$ [-]",
        ylabel=r"density $P_\xi(\xi)$ [-]",
    )  # fmt: skip
    axes.legend()


def _power_law(axes: Any, gaps: GapDistribution, x: NDArray[np.float64]) -> None:
    """The power law of the small gaps, with the fraction of all gaps that lies in its window."""
    width = float(np.diff(gaps.density.value).mean())
    fraction = width * float(gaps.density.density[gaps.density.value < gaps.window].sum())
    b = gaps.small_gap_exponent
    density = fraction * (1.0 - b) / gaps.window ** (1.0 - b) * x**-b
    axes.plot(x, density, color=BLACK, linestyle=":", label=rf"power law $\xi^{{-{b:.2f}}}$ on the same range")
