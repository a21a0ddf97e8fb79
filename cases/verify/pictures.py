"""The four figures of the comparison."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.pictures.closures import line_of
from granfabric.cases.pictures.distribution import draw_force_density, draw_gap_density, draw_small_gaps, outline
from granfabric.cases.pictures.style import BLACK, BLUE, GREEN, ORANGE, RED, SKY, picture
from granfabric.dem_ref.measures.contacts import contacts_of
from granfabric.dem_ref.measures.distribution import Density, EdgeFit, ForceDistribution, force_distribution
from granfabric.dem_ref.measures.tessellation import GapDistribution, gap_distribution, radical_neighbours

from .dem_side import LOADINGS, SeedResult
from .pictures_paths import draw_cycles, draw_rotation

if TYPE_CHECKING:
    from .study import Study

Array = NDArray[np.float64]

SYMBOLS = {
    "coordination": "$z$",
    "fabric_anisotropy": "$a_c$",
    "normal_force_anisotropy": "$a_n$",
    "tangential_force_anisotropy": "$a_t$",
    "mean_normal_force": "$f/f_0$",
}


def draw_verify(folder: Path, study: Study) -> list[Path]:
    """Draw `figure_1.png` to `figure_6.png`."""
    return [
        _decomposition(folder / "figure_1.png", study),
        _forces(folder / "figure_2.png", study),
        _gaps(folder / "figure_3.png", study),
        _comparison(folder / "figure_4.png", study),
        draw_cycles(folder / "figure_5.png", study, _title("Model against DEM on two cycles and a reversal", study)),
        draw_rotation(
            folder / "figure_6.png", study, _title("Model against DEM under principal stress rotation", study)
        ),
    ]


def _mean(values: Array) -> tuple[Array, Array]:
    """Mean and standard deviation over packings; the deviation is zero for a single one."""
    return values.mean(axis=0), values.std(axis=0, ddof=1) if len(values) > 1 else np.zeros(values.shape[1])


def _decomposition(path: Path, study: Study) -> Path:
    x = study.levels
    with picture(path, 10.5, 4.5) as figure:
        for axes, (loading, text) in zip(figure.subplots(1, 2, sharey=True), LOADINGS.items()):
            columns = study.dem[loading]
            net = columns["fabric_anisotropy"] - columns["fabric_anisotropy"][:, :1]
            axes.axhline(0.0, color=BLACK, linewidth=0.8)
            for values, label, options in (
                (columns["fabric_lost"], "contacts lost", {"color": ORANGE, "linewidth": 4.0, "alpha": 0.8}),
                (columns["fabric_gained"], "contacts gained", {"color": SKY}),
                (columns["fabric_persisting"], "contacts that persist and turn", {"color": GREEN}),
                (net, "net", {"color": BLACK, "linestyle": (0, (5, 3))}),
            ):
                mean, scatter = _mean(values)
                axes.plot(x, mean, label=label, **options)
                if len(values) > 1:
                    colour = options["color"]
                    axes.fill_between(x, mean - scatter, mean + scatter, color=colour, alpha=0.18, linewidth=0)
            axes.set(title=text[0].upper() + text[1:], xlabel="stress ratio $q/p$ [-]", xlim=(0.0, 1.02 * float(x[-1])))
        figure.axes[0].set_ylabel("change of fabric anisotropy $a_c$ [-]")
        figure.axes[0].legend()
        figure.suptitle(_title("DEM: who changes the fabric anisotropy", study), x=0.01, ha="left", fontsize=13)
    return path


def pooled(densities: Sequence[Density]) -> Density:
    """Mean of densities on the same bins."""
    mean = np.mean([density.density for density in densities], axis=0)
    return Density(densities[0].value, mean, sum(density.count for density in densities))


def pooled_fit(fits: Sequence[EdgeFit]) -> EdgeFit:
    """Mean of edge fits, with the standard error of the mean."""
    root = np.sqrt(len(fits))
    return EdgeFit(
        *(float(np.mean([getattr(fit, name) for fit in fits])) for name in ("value", "slope")),
        *(float(np.mean([getattr(fit, name) for fit in fits]) / root) for name in ("value_error", "slope_error")),
    )


def pooled_forces(parts: Sequence[ForceDistribution]) -> ForceDistribution:
    """Force distributions of several packings as one."""
    sectors = range(len(parts[0].angle))
    return ForceDistribution(
        pooled([part.overall for part in parts]),
        pooled_fit([part.at_zero for part in parts]),
        parts[0].angle,
        [pooled([part.by_direction[sector] for part in parts]) for sector in sectors],
        [pooled_fit([part.at_zero_by_direction[sector] for part in parts]) for sector in sectors],
    )


def _forces(path: Path, study: Study) -> Path:
    start = pooled_forces([force_distribution(contacts_of(result.packing)) for result in study.results])
    with picture(path, 15.0, 4.5) as figure:
        axes = figure.subplots(1, 3)
        draw_force_density(axes[0], start)
        axes[0].set_title("The packing")
        for one, (loading, text) in zip(axes[1:], LOADINGS.items()):
            ends = [force_distribution(contacts_of(result.runs[loading].sample)) for result in study.results]
            end = pooled_forces(ends)
            minor, major = 0, len(end.angle) // 2
            outline(one, start.overall, fill=True, color="#cccccc", label="the packing")
            for sector, name, colour in ((major, "major", RED), (minor, "minor", BLUE)):
                label = f"{name} direction, at zero {end.at_zero_by_direction[sector].value:.2f}"
                outline(one, end.by_direction[sector], color=colour, linewidth=1.5, label=label)
            outline(one, end.overall, color=BLACK, linewidth=1.2, label=f"all, at zero {end.at_zero.value:.2f}")
            one.set(
                title=f"At $q/p$ = 0.3, {text}", xlabel="force over the mean of its direction [-]",
                ylabel="density [-]", xlim=(0.0, 4.0), ylim=(0.0, None),
            )  # fmt: skip
            one.legend()
        figure.suptitle(_title("DEM: normal forces", study), x=0.01, ha="left", fontsize=13)
    return path


def _gaps(path: Path, study: Study) -> Path:
    parts, small = [], []
    for result in study.results:
        pairs = radical_neighbours(result.packing)
        parts.append(gap_distribution(result.packing, pairs))
        small.append(pairs.gap[pairs.gap > 0.0] / result.packing.mean_diameter)
    whole = GapDistribution(
        pooled([part.density for part in parts]),
        pooled_fit([part.at_zero for part in parts]),
        float(np.mean([part.small_gap_exponent for part in parts])),
        parts[0].window,
        float(np.mean([part.mean_density for part in parts])),
        float(np.mean([part.neighbours for part in parts])),
    )
    with picture(path, 10.5, 4.5) as figure:
        left, right = figure.subplots(1, 2)
        draw_gap_density(left, whole)
        draw_small_gaps(right, np.concatenate(small), whole)
        figure.suptitle(_title("DEM: gaps between neighbours", study), x=0.01, ha="left", fontsize=13)
    return path


def _comparison(path: Path, study: Study) -> Path:
    x = study.levels
    with picture(path, 17.0, 7.2) as figure:
        rows = figure.subplots(2, len(SYMBOLS), sharex=True)
        for axes, (loading, text) in zip(rows, LOADINGS.items()):
            for one, (quantity, symbol) in zip(axes, SYMBOLS.items()):
                _dem_with_scatter(one, x, study.dem[loading][quantity])
                for place, closure in enumerate(study.closures):
                    colour, style = line_of(place)
                    curve = study.model[loading][closure][quantity].mean(axis=0)
                    one.plot(x, curve, color=colour, linestyle=style, label=closure)
                one.set(title=f"{symbol}, {text}", xlim=(0.0, 1.02 * float(x[-1])))
                one.title.set_fontsize(9.5)
                one.margins(y=0.08)
        for one in rows[-1]:
            one.set_xlabel("stress ratio $q/p$ [-]")
        handles, labels = rows[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
        figure.suptitle(_title("Model against DEM", study), x=0.01, ha="left", fontsize=13)
    return path


def _dem_with_scatter(axes: Any, x: Array, values: Array) -> None:
    mean, scatter = _mean(values)
    label = "DEM" if len(values) == 1 else f"DEM, {len(values)} packings $\\pm$ standard deviation"
    axes.plot(x[::3], mean[::3], "o", color=BLACK, markersize=3.5, label=label, zorder=3)
    if len(values) > 1:
        axes.fill_between(x, mean - scatter, mean + scatter, color=BLACK, alpha=0.15, linewidth=0)


def _title(text: str, study: Study) -> str:
    results: list[SeedResult] = study.results
    packings = "one packing" if len(results) == 1 else f"{len(results)} packings"
    return f"{text} ({packings} of {results[0].packing.count} disks)"
