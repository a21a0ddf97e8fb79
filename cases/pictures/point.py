"""Pictures of a point run, from its `history.csv`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .style import BLACK, BLUE, GREEN, ORANGE, PURPLE, RED, SKY, picture

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
    ratio = columns["q"] / columns.get("effective_p", columns["p"])
    if np.ptp(ratio) > 1e-3:
        return ratio, "stress ratio $q/p$ [-]"
    return columns["p"] / 1e3, "mean pressure $p$ [kPa]"


def draw_point(folder: Path, columns: Columns, scene: dict[str, Any]) -> list[Path]:
    """Draw `stress_strain.png`, `microvariables.png` and `fabric_decomposition.png`.

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
    first = [_stress_strain(folder, columns, scene)]
    return [*first, _microvariables(folder, columns, scene), _decomposition(folder, columns, scene)]


STRAINS = {"strain_xx": r"\varepsilon_{xx}", "strain_yy": r"\varepsilon_{yy}", "strain_xy": r"\gamma_{xy}"}


def _stress_strain(folder: Path, columns: Columns, scene: dict[str, Any]) -> Path:
    """Stress and change of volume over the strain that changes most, positive where it grew first."""
    path = folder / "stress_strain.png"
    name = max(STRAINS, key=lambda key: float(np.ptp(columns[key])))
    strain = columns[name] - columns[name][0]
    grown = np.abs(strain) > 0.05 * np.abs(strain).max(initial=0.0)
    sign = -1.0 if grown.any() and strain[int(np.argmax(grown))] < 0.0 else 1.0
    label = f"strain ${'-' if sign < 0 else ''}{STRAINS[name]}$ [$10^{{-6}}$]"
    x = sign * columns[name] * 1e6
    with picture(path, 10.0, 4.4) as figure:
        left, right = figure.subplots(1, 2)
        for quantity, text, colour, style in (("q", "deviator $q$", BLACK, "-"), ("p", "pressure $p$", BLUE, "--")):
            _line(left, x, columns[quantity] / 1e3, colour, label=text, linestyle=style)
        low, high = left.get_ylim()
        left.set_ylim(min(low, 0.0), high)
        left.set(title="Stress", xlabel=label, ylabel="stress [kPa]")
        left.legend()
        _line(right, x, -(columns["strain_xx"] + columns["strain_yy"]) * 1e6, RED)
        right.set(title="Volume", xlabel=label, ylabel="volumetric strain, compression positive [$10^{-6}$]")
        figure.suptitle(scene["title"], x=0.01, ha="left", fontsize=13, parse_math=False)
    return path


def _microvariables(folder: Path, columns: Columns, scene: dict[str, Any]) -> Path:
    x, label = horizontal(columns, scene)
    path = folder / "microvariables.png"
    with picture(path, 11.0, 6.2) as figure:
        axes = figure.subplots(2, 3, sharex=False).ravel()
        for place, (name, text, colour) in enumerate(MICROVARIABLES):
            if _turns(columns, name):
                _components(axes[place], x, columns, name, colour)
            else:
                _line(axes[place], x, columns[name], colour)
            axes[place].set(title=f"({'abcdef'[place]})", xlabel=label, ylabel=f"{text} [-]")
        _stress_path(axes[5], columns)
        figure.suptitle(scene["title"], x=0.01, ha="left", fontsize=13, parse_math=False)
    return path


def _turns(columns: Columns, name: str) -> bool:
    """Whether a vector of the double-angle plane leaves the line on which it began to grow."""
    if f"{name}_1" not in columns:
        return False
    vector = np.column_stack([columns[f"{name}_1"], columns[f"{name}_2"]])
    size = np.linalg.norm(vector, axis=1)
    if not size.max() > 0:
        return False
    first = vector[int(np.argmax(size > 1e-6 * size.max()))]
    across = np.abs(vector @ np.array([-first[1], first[0]])) / np.linalg.norm(first)
    return bool(across.max() > 1e-3 * size.max())


def _components(axes: Any, x: NDArray[np.float64], columns: Columns, name: str, colour: str) -> None:
    """A vector that turns: its magnitude and both components."""
    one, two = columns[f"{name}_1"], columns[f"{name}_2"]
    axes.plot(x, np.hypot(one, two), color=colour, label="magnitude")
    axes.plot(x, one, color=colour, linestyle="--", linewidth=1.2, label=r"along $\cos 2\theta$")
    axes.plot(x, two, color=colour, linestyle=":", linewidth=1.4, label=r"along $\sin 2\theta$")
    axes.margins(y=0.25)
    axes.legend(fontsize=7, ncols=3, loc="lower center", handlelength=1.6, columnspacing=0.8)


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
    """Stress path in the plane of deviator components, where principal stress rotation is a turn."""
    carried = columns.get("effective_p", columns["p"])
    x = -(columns["stress_xx"] - columns["stress_yy"]) / 2 / carried
    y = -columns["stress_xy"] / carried
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
    turns = _turns(columns, "fabric_anisotropy")
    with picture(path, 10.0, 4.4) as figure:
        left, right = figure.subplots(1, 2)
        if turns:  # only magnitudes can be told in one line each
            gained, lost = np.abs(columns["fabric_gained"]), np.abs(columns["fabric_lost"])
            parts = [columns[f"fabric_anisotropy_{part}"] for part in (1, 2)]
            net = np.hypot(*(values - values[0] for values in parts))
            left.set_ylabel("magnitude of the change of fabric anisotropy $a_c$ [-]")
        else:
            gained, lost = columns["fabric_gained"], -columns["fabric_lost"]
            net = columns["fabric_anisotropy"] - columns["fabric_anisotropy"][0]
            left.set_ylabel("change of fabric anisotropy $a_c$ [-]")
        _contributions(left, x, gained, lost, net)
        z = columns["coordination"]
        _contributions(right, x, columns["coordination_gained"], -columns["coordination_lost"], z - z[0])
        right.set_ylabel("change of coordination number $z$ [-]")
        left.set(title="Fabric anisotropy", xlabel=label)
        right.set(title="Coordination number", xlabel=label)
        left.legend()
        figure.suptitle(scene["title"], x=0.01, ha="left", fontsize=13, parse_math=False)
    return path


def _contributions(
    axes: Any, x: NDArray[np.float64], gained: NDArray[np.float64], lost: NDArray[np.float64], net: NDArray[np.float64]
) -> None:
    axes.axhline(0.0, color=BLACK, linewidth=0.8)
    axes.plot(x, lost, color=ORANGE, linewidth=4.5, alpha=0.75, solid_capstyle="butt", label="by contacts lost")
    axes.plot(x, gained, color=SKY, linewidth=2.4, label="by contacts gained")
    axes.plot(x, net, color=BLACK, linestyle=(0, (5, 3)), label="net")
    axes.ticklabel_format(axis="y", useOffset=False)
