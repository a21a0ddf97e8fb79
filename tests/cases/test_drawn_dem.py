"""Pictures of the DEM and of the comparison with it: columns, samples, names and signs."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from drawn import bands, check_curves, check_in_sight, check_legend, curves, heading, legend, same, unnamed, words
from matplotlib.collections import EllipseCollection, LineCollection

from granfabric.cases.pictures import dem as plots_dem
from granfabric.cases.pictures import distribution as plots_distribution
from granfabric.cases.pictures.closures import LINES, line_of
from granfabric.cases.pictures.style import BLACK, picture
from granfabric.cases.verify import pictures as plots_verify
from granfabric.cases.verify.dem_side import LOADINGS, SeedResult
from granfabric.cases.verify.pictures_paths import draw_cycles, draw_rotation
from granfabric.cases.verify.study import PathStudy, Study
from granfabric.dem_ref.dynamics.packing import make_packing
from granfabric.dem_ref.loading.run import HISTORY_COLUMNS
from granfabric.dem_ref.measures.contacts import contacts_of
from granfabric.dem_ref.measures.distribution import Density, EdgeFit, ForceDistribution, force_distribution
from granfabric.dem_ref.measures.fields import contact_fields, particle_fields
from granfabric.dem_ref.measures.tessellation import GapDistribution, gap_distribution, radical_neighbours

ROWS = 10
SCENE = {"title": "Disks", "rates": {"unbalanced_force": 3e-3, "inertial_number": 7e-5}}


def dem_columns() -> dict[str, np.ndarray]:
    random = np.random.default_rng(12)
    columns = {name: random.uniform(0.1, 1.0) + np.cumsum(random.uniform(0.01, 0.1, ROWS)) for name in HISTORY_COLUMNS}
    columns["p"] = 1e5 * (1 + 0.1 * np.arange(ROWS))
    columns["q"] = 1e4 * np.arange(ROWS)
    columns["strain_xx"], columns["strain_yy"] = 1e-5 * np.arange(ROWS), -2e-5 * np.arange(ROWS)
    columns["strain_xy"] = 1e-6 * np.arange(ROWS)
    return columns


def test_overview_of_a_dem_run(pictures: dict[str, Any], tmp_path: Path) -> None:
    columns = dem_columns()
    plots_dem._overview(tmp_path, columns, SCENE)
    figure = pictures["overview.png"]
    assert heading(figure) == "Disks"
    x = (columns["strain_xx"] - columns["strain_yy"]) * 1e6
    label = r"strain $\varepsilon_{xx} - \varepsilon_{yy}$ [$10^{-6}$]"
    fabric = columns["fabric_anisotropy"]
    expected: list[tuple[str, str, dict[str, Any]]] = [
        ("(a) stress", "stress ratio [-]", {"$q/p$": columns["q"] / columns["p"], "$p/p_0$": columns["p"] / 1e5}),
        ("(b) coordination number", "$z$ [-]", {
            "all particles": columns["coordination"], "without rattlers": columns["coordination_without_rattlers"],
        }),
        ("(c) anisotropies", "anisotropy [-]", {
            "$a_c$": fabric, "$a_n$": columns["normal_force_anisotropy"],
            "$a_t$": columns["tangential_force_anisotropy"],
        }),
        ("(d) mean force, sliding contacts", "[-]", {
            "mean force $f/f_0$": columns["mean_normal_force"], "1 + sliding fraction": 1 + columns["sliding_fraction"],
        }),
        ("(e) fabric change by contacts", "change of $a_c$ [-]", {
            "lost": columns["fabric_lost"], "gained": columns["fabric_gained"],
            "persisting (rotated)": columns["fabric_persisting"], "net": fabric - fabric[0],
        }),
    ]  # fmt: skip
    assert len(figure.axes) == 6
    for axes, (title, ordinate, found) in zip(figure.axes, expected):
        assert words(axes) == (title, label, ordinate)
        check_curves(axes, x, found)
        check_legend(axes)
    quality = figure.axes[5]
    assert words(quality) == ("(f) quasi-static limits (dotted)", label, "[-]")
    check_curves(quality, x[1:], {
        "unbalanced force": columns["unbalanced_force"][1:], "inertial number": columns["inertial_number"][1:],
    })  # fmt: skip
    assert quality.get_yscale() == "log"
    colours = {line.get_label(): line.get_color() for line in quality.get_lines()}
    limits = {line.get_color(): line.get_ydata()[0] for line in quality.get_lines() if line.get_linestyle() == ":"}
    assert limits == {colours["unbalanced force"]: 3e-3, colours["inertial number"]: 7e-5}


@pytest.mark.parametrize(
    ("strain", "label", "values"),
    [
        ((-1.0, 2.0, 0.1), r"\varepsilon_{yy} - \varepsilon_{xx}", 3.0),
        ((-1.0, -1.1, 0.1), r"-\varepsilon_{xx} - \varepsilon_{yy}", 2.1),
        ((1.0, 1.1, 0.1), r"\varepsilon_{xx} + \varepsilon_{yy}", 2.1),
        ((0.1, 0.2, 2.0), r"\gamma_{xy}", 2.0),
        ((0.1, 0.2, -2.0), r"-\gamma_{xy}", 2.0),
    ],
)
def test_abscissa_of_a_dem_run(strain: tuple[float, float, float], label: str, values: float) -> None:
    columns = dem_columns()
    for name, size in zip(("xx", "yy", "xy"), strain):
        columns[f"strain_{name}"] = size * 1e-5 * np.arange(ROWS)
    x, text = plots_dem._horizontal(columns)
    np.testing.assert_allclose(x, values * 10 * np.arange(ROWS), rtol=1e-9)
    assert text == f"strain ${label}$ [$10^{{-6}}$]"


@pytest.fixture(scope="module")
def packing() -> Any:
    return make_packing(120, 1)


def ellipses(axes: Any) -> list[Any]:
    return [one for one in axes.collections if isinstance(one, EllipseCollection)]


def test_disks_and_force_chains(packing: Any, pictures: dict[str, Any], tmp_path: Path) -> None:
    """Disks in their size where they are; lines between centres, as wide and as dark as the force over its mean."""
    loaded = packing.copy()
    loaded.position += 0.01
    plots_dem._networks(tmp_path, packing, loaded, dem_columns(), SCENE)
    figure = pictures["packing.png"]
    left, right, bar = figure.axes
    columns = dem_columns()
    ratio = columns["q"][-1] / columns["p"][-1]
    assert left.get_title("left") == "packing" and right.get_title("left") == f"at $q/p$ = {ratio:.3f}"
    assert bar.get_ylabel() == "normal force over its mean; disks without force blue"
    assert heading(figure) == "Disks: contact forces"
    for axes, sample in ((left, packing), (right, loaded)):
        particles, contacts = particle_fields(sample), contact_fields(sample)
        bearing = particles["bears_force"] > 0
        for disks, mask in zip(ellipses(axes), (bearing, ~bearing), strict=True):
            np.testing.assert_allclose(disks.get_offsets(), particles["position"][mask])
            np.testing.assert_allclose(2 * disks._widths, 2 * particles["radius"][mask])
        chains = next(one for one in axes.collections if type(one) is LineCollection)
        force = contacts["normal_force"] / contacts["normal_force"].mean()
        order = np.argsort(force)
        np.testing.assert_allclose(chains.get_array(), np.clip(force[order], 0, 4))
        segments = np.array(chains.get_segments())
        np.testing.assert_allclose(segments[:, 0], contacts["start"][order])
        np.testing.assert_allclose(segments[:, 1], contacts["end"][order])
        np.testing.assert_allclose(chains.get_linewidth() / force[order], chains.get_linewidth()[0] / force[order[0]])
    ticks = dict(zip(bar.get_yticks(), (text.get_text() for text in bar.get_yticklabels())))
    assert ticks == {0: "0", 1: "1", 2: "2", 3: "3", 4: r"$\geq$ 4"}


# distributions


def density(seed: int, last: float, count: int) -> Density:
    value = (np.arange(20) + 0.5) * last / 20
    return Density(value, np.random.default_rng(seed).uniform(0.1, 1.0, 20), count)


def steps(axes: Any) -> list[Any]:
    """Histograms in the order in which they were drawn."""
    return [patch for patch in axes.patches if type(patch).__name__ == "StepPatch"]


def check_steps(patch: Any, expected: Density) -> None:
    values, edges, _ = patch.get_data()
    width = expected.value[1] - expected.value[0]
    np.testing.assert_allclose(values, expected.density)
    np.testing.assert_allclose(edges, np.append(expected.value - width / 2, expected.value[-1] + width / 2))


FIT = EdgeFit(0.613, -0.21, 0.034, 0.2)
FORCES = ForceDistribution(
    density(1, 4.0, 777), FIT, np.arange(6) * np.pi / 6, [density(10 + s, 4.0, 100 + s) for s in range(6)],
    [EdgeFit(0.1 * s + 0.02, 0.0, 0.0, 0.0) for s in range(6)],
)  # fmt: skip
GAPS = GapDistribution(density(2, 0.8, 555), EdgeFit(4.21, -9.0, 0.37, 1.0), 0.42, 0.1, 5.0, 6.0)


def test_density_of_forces_with_its_line_at_zero(pictures: dict[str, Any]) -> None:
    with picture(Path("a.png"), 4, 4) as figure:
        axes = figure.add_subplot()
        plots_distribution.draw_force_density(axes, FORCES)
    for patch in steps(axes):
        check_steps(patch, FORCES.overall)
    assert axes.get_xlim() == (0.0, 4.0) and axes.get_ylim()[0] == 0.0
    assert axes.get_ylim()[1] > max(FORCES.overall.density.max(), FORCES.at_zero.value)
    assert words(axes) == (
        "Normal forces", r"$\zeta = f_n/\langle f_n \rangle$ [-]", r"density $P_n(\zeta)$ [-]"
    )  # fmt: skip
    line = r"line on [0, 0.5]: $P_0$ = 0.61 $\pm$ 0.03"
    assert set(legend(axes)) == {"DEM, 777 contacts", line}
    same(curves(axes)[line], [0.0, 0.5], [0.613, 0.613 - 0.105])
    same(unnamed(axes)[0], [0.0], [0.613])


def test_density_of_gaps_with_line_and_power_law(pictures: dict[str, Any]) -> None:
    with picture(Path("a.png"), 4, 4) as figure:
        axes = figure.add_subplot()
        plots_distribution.draw_gap_density(axes, GAPS)
    for patch in steps(axes):
        check_steps(patch, GAPS.density)
    assert axes.get_xlim() == (0.0, 0.8) and axes.get_ylim()[0] == 0.0
    assert axes.get_ylim()[1] > GAPS.at_zero.value
    line, law = r"line on [0, 0.1]: $P_{\xi 0}$ = 4.21 $\pm$ 0.37", r"power law $\xi^{-0.42}$ on the same range"
    assert set(legend(axes)) == {"DEM, 555 gaps", line, law}
    same(curves(axes)[line], [0.0, 0.1], [4.21, 4.21 - 0.9])
    x, y = curves(axes)[law]
    # the law holds the fraction of all gaps that lies in the window: integral of the histogram over it
    inside = GAPS.density.value < 0.1
    fraction = GAPS.density.density[inside].sum() * 0.04
    np.testing.assert_allclose(y, fraction * 0.58 / 0.1**0.58 * x**-0.42)
    assert x[0] == pytest.approx(2e-3) and x[-1] == pytest.approx(0.1)
    assert words(axes)[1:] == (r"$\xi$ = gap$/2r$ [-]", r"density $P_\xi(\xi)$ [-]")


def test_small_gaps_on_logarithmic_axes(pictures: dict[str, Any]) -> None:
    xi = 0.8 * np.random.default_rng(3).uniform(size=5000) ** 1.5
    with picture(Path("a.png"), 4, 4) as figure:
        axes = figure.add_subplot()
        plots_distribution.draw_small_gaps(axes, xi, GAPS)
    edges = np.geomspace(1e-4, 0.8, 24)
    count, _ = np.histogram(xi, edges)
    seen = count > 0
    container = axes.containers[0]
    np.testing.assert_allclose(container.lines[0].get_xdata(), np.sqrt(edges[1:] * edges[:-1])[seen])
    found = count[seen] / np.diff(edges)[seen] / 5000
    np.testing.assert_allclose(container.lines[0].get_ydata(), found)
    bars = np.array(container.lines[2][0].get_segments())
    np.testing.assert_allclose(bars[:, 1, 1] - bars[:, 0, 1], 2 * found / np.sqrt(count[seen]))
    x, y = curves(axes)["straight line"]
    np.testing.assert_allclose(y, 4.21 - 9.0 * x)
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert set(legend(axes)) == {"DEM", "straight line", r"power law $\xi^{-0.42}$ on the same range"}


def test_distributions_of_a_packing(packing: Any, pictures: dict[str, Any], tmp_path: Path) -> None:
    plots_dem._distributions(tmp_path, packing, SCENE)
    figure = pictures["distributions.png"]
    left, right = figure.axes
    check_steps(steps(left)[0], force_distribution(contacts_of(packing)).overall)
    check_steps(steps(right)[0], gap_distribution(packing).density)
    assert heading(figure) == "Disks: the packing"


# the comparison

LEVELS = np.linspace(0.0, 0.3, 61)
CLOSURES = ("source", "second", "best")


def study(packing: Any, seeds: int = 2) -> Study:
    """A made-up comparison, every number of it different."""
    random = np.random.default_rng(4)
    quantities = (*plots_verify.SYMBOLS, "fabric_gained", "fabric_lost", "fabric_persisting")

    def columns(names: Any) -> dict[str, np.ndarray]:
        return {name: random.normal(size=(seeds, 61)).cumsum(axis=1) for name in names}

    dem = {loading: columns(quantities) for loading in LOADINGS}
    model = {loading: {name: columns(plots_verify.SYMBOLS) for name in CLOSURES} for loading in LOADINGS}
    results = []
    for seed in range(seeds):
        one = packing.copy()
        one.radius *= 1.0 + 1e-5 * seed
        ends = {}
        for place, loading in enumerate(LOADINGS):
            end = packing.copy()
            # another overlap and so other forces in every run
            end.radius *= 1.0 + 2e-5 * (place + 1 + 3 * seed)
            end.position = end.position.copy()
            end.position[:, place] *= 1.0 + 1e-4 * (place + 1)
            ends[loading] = SimpleNamespace(sample=end)
        results.append(SeedResult(seed + 1, one, runs=ends))  # type: ignore[arg-type]
    paths = {}
    for name, segments in (("cycles", 5), ("rotation", 3)):
        places = 11 * segments
        sides = [f"{part}_{way}" for part in ("fabric", "normal", "tangential") for way in ("along", "across")]
        made = lambda: {key: random.normal(size=places) for key in ("coordination", *sides)}  # noqa: B023, E731
        paths[name] = PathStudy(
            np.repeat(np.arange(segments) + 1, 11), random.normal(size=places), 100 + random.normal(size=places),
            [made() for _ in range(seeds)], {closure: [made() for _ in range(seeds)] for closure in CLOSURES},
        )  # fmt: skip
    return Study(LEVELS, dem, model, results, [], {"model": 1.0}, paths, [], {}, {}, [])


LOADING_TITLES = {"constant_pressure": "mean pressure constant", "constant_lateral_stress": "lateral stress constant"}


def test_who_changes_the_fabric(packing: Any, pictures: dict[str, Any], tmp_path: Path) -> None:
    made = study(packing)
    plots_verify._decomposition(tmp_path / "figure_1.png", made)
    figure = pictures["figure_1.png"]
    assert heading(figure) == "DEM: who changes the fabric anisotropy (2 packings of 120 disks)"
    for axes, (loading, title) in zip(figure.axes, LOADING_TITLES.items(), strict=True):
        columns = made.dem[loading]
        net = columns["fabric_anisotropy"] - columns["fabric_anisotropy"][:, :1]
        expected = {
            "contacts lost": columns["fabric_lost"], "contacts gained": columns["fabric_gained"],
            "contacts that persist and turn": columns["fabric_persisting"], "net": net,
        }  # fmt: skip
        check_curves(axes, LEVELS, {name: values.mean(axis=0) for name, values in expected.items()})
        assert axes.get_title("left") == title[0].upper() + title[1:]
        assert axes.get_xlabel() == "stress ratio $q/p$ [-]"
        for (_, x, low, high), values in zip(bands(axes), expected.values(), strict=True):
            scatter = values.std(axis=0, ddof=1)
            np.testing.assert_allclose(x, LEVELS, atol=1e-12)
            np.testing.assert_allclose(low, values.mean(axis=0) - scatter, atol=1e-9)
            np.testing.assert_allclose(high, values.mean(axis=0) + scatter, atol=1e-9)
    assert figure.axes[0].get_ylabel() == "change of fabric anisotropy $a_c$ [-]"
    check_legend(figure.axes[0])


def test_forces_of_the_packing_and_of_both_loadings(packing: Any, pictures: dict[str, Any], tmp_path: Path) -> None:
    """The major direction is along y, the third sector of six; the minor along x, the first."""
    made = study(packing)
    plots_verify._forces(tmp_path / "figure_2.png", made)
    first, *others = pictures["figure_2.png"].axes
    starts = [force_distribution(contacts_of(result.packing)) for result in made.results]
    mean = np.mean([one.overall.density for one in starts], axis=0)
    np.testing.assert_allclose(steps(first)[0].get_data()[0], mean)
    count = sum(one.overall.count for one in starts)
    value = np.mean([one.at_zero.value for one in starts])
    error = np.mean([one.at_zero.value_error for one in starts]) / np.sqrt(2)
    line = f"line on [0, 0.5]: $P_0$ = {value:.2f} $\\pm$ {error:.2f}"
    assert set(legend(first)) == {f"DEM, {count} contacts", line}
    for axes, (loading, title) in zip(others, LOADING_TITLES.items(), strict=True):
        ends = [force_distribution(contacts_of(result.runs[loading].sample)) for result in made.results]
        assert axes.get_title("left") == f"At $q/p$ = 0.3, {title}"
        assert axes.get_xlabel() == "force over the mean of its direction [-]"

        def at_zero(sector: int, ends: Any = ends) -> float:
            return float(np.mean([end.at_zero_by_direction[sector].value for end in ends]))

        expected = {
            "the packing": mean,
            f"major direction, at zero {at_zero(3):.2f}": np.mean([e.by_direction[3].density for e in ends], axis=0),
            f"minor direction, at zero {at_zero(0):.2f}": np.mean([e.by_direction[0].density for e in ends], axis=0),
            f"all, at zero {np.mean([e.at_zero.value for e in ends]):.2f}": np.mean(
                [e.overall.density for e in ends], axis=0
            ),
        }
        found = {patch.get_label(): patch.get_data()[0] for patch in steps(axes)}
        assert list(found) == list(expected) and set(legend(axes)) == set(expected)
        for name, values in expected.items():
            np.testing.assert_allclose(found[name], values)


def test_gaps_of_all_packings(packing: Any, pictures: dict[str, Any], tmp_path: Path) -> None:
    made = study(packing)
    plots_verify._gaps(tmp_path / "figure_3.png", made)
    left, right = pictures["figure_3.png"].axes
    parts = [gap_distribution(result.packing) for result in made.results]
    np.testing.assert_allclose(steps(left)[0].get_data()[0], np.mean([part.density.density for part in parts], axis=0))
    value = np.mean([part.at_zero.value for part in parts])
    error = np.mean([part.at_zero.value_error for part in parts]) / np.sqrt(2)
    exponent = np.mean([part.small_gap_exponent for part in parts])
    assert set(legend(left)) == {
        f"DEM, {sum(part.density.count for part in parts)} gaps",
        rf"line on [0, 0.1]: $P_{{\xi 0}}$ = {value:.2f} $\pm$ {error:.2f}",
        rf"power law $\xi^{{-{exponent:.2f}}}$ on the same range",
    }
    xi = np.concatenate([
        pairs.gap[pairs.gap > 0] / result.packing.mean_diameter
        for result in made.results for pairs in [radical_neighbours(result.packing)]
    ])  # fmt: skip
    count, _ = np.histogram(xi, np.geomspace(1e-4, 0.8, 24))
    drawn = right.containers[0].lines[0].get_ydata()
    np.testing.assert_allclose(drawn, (count / np.diff(np.geomspace(1e-4, 0.8, 24)) / len(xi))[count > 0])


SYMBOLS = ("$z$", "$a_c$", "$a_n$", "$a_t$", "$f/f_0$")


@pytest.mark.parametrize("seeds", [1, 3])
def test_model_and_dem_are_told_apart(packing: Any, seeds: int, pictures: dict[str, Any], tmp_path: Path) -> None:
    made = study(packing, seeds)
    plots_verify._comparison(tmp_path / "figure_4.png", made)
    figure = pictures["figure_4.png"]
    rows = np.array(figure.axes).reshape(2, 5)
    grains = "DEM" if seeds == 1 else "DEM, 3 packings $\\pm$ standard deviation"
    packings = "one packing" if seeds == 1 else "3 packings"
    assert heading(figure) == f"Model against DEM ({packings} of 120 disks)"
    for axes, (loading, title) in zip(rows, LOADING_TITLES.items(), strict=True):
        for one, quantity, symbol in zip(axes, plots_verify.SYMBOLS, SYMBOLS, strict=True):
            assert one.get_title("left") == f"{symbol}, {title}"
            found = curves(one)
            check_in_sight(one)
            assert set(found) == {grains, *CLOSURES}
            same(found[grains], LEVELS[::3], made.dem[loading][quantity].mean(axis=0)[::3])
            for closure in CLOSURES:
                same(found[closure], LEVELS, made.model[loading][closure][quantity].mean(axis=0))
            if seeds > 1:
                ((_, _, low, high),) = bands(one)
                values = made.dem[loading][quantity]
                np.testing.assert_allclose(high - low, 2 * values.std(axis=0, ddof=1), atol=1e-9)
                np.testing.assert_allclose((high + low) / 2, values.mean(axis=0), atol=1e-9)
    assert [one.get_xlabel() for one in rows[-1]] == ["stress ratio $q/p$ [-]"] * 5
    assert legend(figure) == [grains, *CLOSURES]
    check_legend(figure, rows.ravel())
    lines = {line.get_label(): line for line in rows[0, 0].get_lines()}
    assert lines[grains].get_color() == BLACK
    assert [lines[name].get_color() for name in CLOSURES] == [line_of(place)[0] for place in range(3)]


PATHS = {
    "cycles": (draw_cycles, 1, "stress ratio $q/p$ [-]", {
        "coordination": "$z$ [-]", "fabric_along": "$a_c$ [-]", "normal_along": "$a_n$ [-]",
        "tangential_along": "$a_t$ [-]",
    }),
    "rotation": (draw_rotation, 2, "direction of the major compression from its start [degrees]", {
        "coordination": "$z$ [-]", "fabric_along": "$a_c$ along the major compression [-]",
        "fabric_across": "$a_c$ across it [-]",
    }),
}  # fmt: skip


@pytest.mark.parametrize("path", PATHS)
def test_paths_that_turn(path: str, packing: Any, pictures: dict[str, Any], tmp_path: Path) -> None:
    """The loading before the turn is left out; grains are dots, closures are lines."""
    made = study(packing)
    draw, first, label, quantities = PATHS[path]
    draw(tmp_path / "figure.png", made, "Made up")
    figure, along = pictures["figure.png"], made.paths[path]
    chosen = along.segment >= first
    x = (along.stress_ratio if path == "cycles" else along.angle)[chosen]
    assert heading(figure) == "Made up"
    for axes, (quantity, title) in zip(figure.axes, quantities.items(), strict=True):
        assert (axes.get_title("left"), axes.get_xlabel()) == (title, label)
        expected = {"DEM": np.mean([one[quantity] for one in along.dem], axis=0)[chosen]}
        for closure in CLOSURES:
            expected[closure] = np.mean([one[quantity] for one in along.model[closure]], axis=0)[chosen]
        check_curves(axes, x, expected)
    check_legend(figure, figure.axes)
    assert legend(figure) == ["DEM", *CLOSURES]


def test_all_figures_of_a_comparison_have_their_names(
    packing: Any, pictures: dict[str, Any], tmp_path: Path
) -> None:
    made = study(packing, 1)
    written = plots_verify.draw_verify(tmp_path, made)
    assert [file.name for file in written] == list(pictures) == [f"figure_{number}.png" for number in range(1, 7)]
    headings = [heading(figure) for figure in pictures.values()]
    assert [text.partition(" (")[0] for text in headings] == [
        "DEM: who changes the fabric anisotropy", "DEM: normal forces", "DEM: gaps between neighbours",
        "Model against DEM", "Model against DEM on two cycles and a reversal",
        "Model against DEM under principal stress rotation",
    ]  # fmt: skip


def test_closures_are_told_apart_by_colour_and_dashes() -> None:
    looks = [line_of(place) for place in range(len(LINES))]
    assert len(set(looks)) == len({colour for colour, _ in looks}) == len({str(dashes) for _, dashes in looks}) == 6
    assert line_of(6) == line_of(0)
