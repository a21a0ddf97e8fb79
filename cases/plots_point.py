"""Pictures of a point run, from its `history.csv`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .plot_style import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, SKY, picture

Columns = dict[str, NDArray[np.float64]]

MICROVARIABLES = (
    ("coordination", "coordination number $z$", BLUE),
    ("fabric_anisotropy", "fabric anisotropy $a_c$", RED),
    ("normal_force_anisotropy", "normal-force anisotropy $a_n$", GREEN),
    ("tangential_force_anisotropy", "tangential-force anisotropy $a_t$", PURPLE),
    ("mean_normal_force", "mean normal force $f/f_0$", ORANGE),
)


def horizontal(columns: Columns, scene: dict[str, Any]) -> tuple[NDArray[np.float64], str]:
    """Values and label of the horizontal axis that tells most about a path."""
    path = scene.get("path", [])
    if any("rotation_degrees" in leg for leg in path):
        return columns["step"], "step"
    if any("strain" in leg.get("control", ()) for leg in path):
        ranges = {name: np.ptp(columns[name]) for name in ("strain_xx", "strain_yy", "strain_xy")}
        name = max(ranges, key=lambda key: ranges[key])
        symbol = {"strain_xx": r"\varepsilon_{xx}", "strain_yy": r"\varepsilon_{yy}", "strain_xy": r"\gamma_{xy}"}[name]
        return columns[name] * 1e6, f"strain ${symbol}$ [$10^{{-6}}$]"
    ratio = columns["q"] / columns["p"]
    if np.ptp(ratio) > 1e-3:
        return ratio, "stress ratio $q/p$ [-]"
    return columns["p"] / 1e3, "mean pressure $p$ [kPa]"


def draw_point(folder: Path, columns: Columns, scene: dict[str, Any]) -> list[Path]:
    """Draw `microvariables.png` and `fabric_decomposition.png`.

    Parameters
    ----------
    folder : Path
    columns : dict of str to ndarray, shape (nsteps + 1,)
        Columns of `history.csv`.
    scene : dict
        The scene as resolved.

    Returns
    -------
    list of Path
    """
    return [_microvariables(folder, columns, scene), _decomposition(folder, columns, scene)]


def _microvariables(folder: Path, columns: Columns, scene: dict[str, Any]) -> Path:
    x, label = horizontal(columns, scene)
    path = folder / "microvariables.png"
    with picture(path, 11.0, 6.2) as figure:
        axes = figure.subplots(2, 3, sharex=False).ravel()
        for place, (name, text, colour) in enumerate(MICROVARIABLES):
            _line(axes[place], x, columns[name], colour)
            axes[place].set(title=f"({'abcdef'[place]})", xlabel=label, ylabel=f"{text} [-]")
        _stress_path(axes[5], columns)
        figure.suptitle(scene["title"], x=0.01, ha="left", fontsize=13)
    return path


def _line(axes: Any, x: NDArray[np.float64], y: NDArray[np.float64], colour: str, **options: Any) -> None:
    axes.plot(x, y, color=colour, **options)
    axes.plot(x[0], y[0], "o", color=colour, markersize=5, markerfacecolor="white", clip_on=False, zorder=3)
    if len(x) > 1:
        axes.plot(x[-1], y[-1], "o", color=colour, markersize=5, clip_on=False, zorder=3)
    middle, span = float(np.mean(y)), float(np.ptp(y))
    if span < 1e-9 * max(1.0, abs(middle)):  # a constant is a flat line, not magnified rounding
        axes.set_ylim(middle - 0.05, middle + 0.05)
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.margins(y=0.08)


def _stress_path(axes: Any, columns: Columns) -> None:
    """Stress path in the plane of deviator components, where a turn of the axes is a turn."""
    x = -(columns["stress_xx"] - columns["stress_yy"]) / 2 / columns["p"]
    y = -columns["stress_xy"] / columns["p"]
    axes.plot(x, y, color=BLACK)
    axes.plot(x[0], y[0], "o", color=BLACK, markersize=5, markerfacecolor="white")
    axes.plot(x[-1], y[-1], "o", color=BLACK, markersize=5)
    reach = 1.15 * max(0.05, float(np.max(np.hypot(x, y))))
    axes.set(
        title="(f)",
        xlabel=r"$(\sigma_{xx}-\sigma_{yy})/2p$ [-]",
        ylabel=r"$\sigma_{xy}/p$ [-], compression positive",
        xlim=(-reach, reach),
        ylim=(-reach, reach),
        aspect="equal",
    )


def _decomposition(folder: Path, columns: Columns, scene: dict[str, Any]) -> Path:
    x, label = horizontal(columns, scene)
    path = folder / "fabric_decomposition.png"
    with picture(path, 10.0, 4.4) as figure:
        left, right = figure.subplots(1, 2)
        for axes, total, part, text in (
            (left, "fabric_anisotropy", "fabric", "change of fabric anisotropy $a_c$"),
            (right, "coordination", "coordination", "change of coordination number $z$"),
        ):
            gained, lost = columns[f"{part}_gained"], columns[f"{part}_lost"]
            axes.axhline(0.0, color=BLACK, linewidth=0.8)
            axes.plot(x, gained, color=SKY, label="by contacts gained")
            axes.plot(x, -lost, color=ORANGE, linestyle="--", label="by contacts lost")
            axes.plot(x, columns[total] - columns[total][0], color=BLACK, linestyle="-.", label="net")
            axes.set(xlabel=label, ylabel=f"{text} [-]")
            axes.ticklabel_format(axis="y", useOffset=False)
        left.set_title("Fabric anisotropy")
        right.set_title("Coordination number")
        left.legend()
        figure.suptitle(scene["title"], x=0.01, ha="left", fontsize=13)
    return path
