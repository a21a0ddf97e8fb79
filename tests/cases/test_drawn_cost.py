"""Pictures and pages of `granfabric cost`: abscissae, errors, fronts, bars and numbers of made-up studies."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn import check_in_sight, curves, heading, legend, words
from matplotlib.colors import to_hex

from granfabric.cases.cost import (
    arcs,
    closures,
    decisions,
    dem,
    distributions,
    effects,
    footing,
    integrators,
    load_steps,
    mesh,
    output,
    tangents,
)
from granfabric.cases.cost import draw as work_precision_module
from granfabric.cases.cost import page as cost_page
from granfabric.cases.cost.catalogue import STUDIES
from granfabric.cases.cost.draw import FRONT, LOOKS, work_precision
from granfabric.cases.cost.front import mark_fronts
from granfabric.cases.cost.study import Axes

Row = dict[str, Any]


def rows_of(facets: Any, series: Any, **more: Any) -> list[Row]:
    """Three rows a series and facet, every number different; fronts by time and by count differ."""
    table: list[Row] = []
    for facet_place, facet in enumerate(facets):
        for place, name in enumerate(series):
            for step in range(3):
                table.append({
                    "facet": facet, "series": name, "setting": f"{name} {step}",
                    "error": 10.0 ** -(1 + step + 0.3 * place + 0.07 * facet_place),
                    "seconds": 2.0**step * (1 + place) * 1.1**facet_place,
                    "count": 3.0**step * (10 - place) + facet_place, **{key: f(step) for key, f in more.items()},
                })  # fmt: skip
    mark_fronts(table)
    return table


def check_panel(
    axes: Any, members: list[Row], cost: str, mark: str, series: list[str], competing: bool = True
) -> None:
    """A hollow line a series with the members of its front filled, and the common front as a staircase."""
    lines = axes.get_lines()
    found = {}
    for line in lines:
        found.setdefault((to_hex(line.get_color()), line.get_marker()), []).append(line)
    front = [line for line in lines if line.get_drawstyle() == "steps-post"]
    on_front = sorted({(row[cost], row["error"]) for row in members if row[mark]})
    assert bool(front) == (competing and len(on_front) > 1)
    if front:
        np.testing.assert_allclose(np.array(front[0].get_data()).T, on_front)
    for place, name in enumerate(series):
        colour, marker = LOOKS[place]
        line, filled = found[to_hex(colour), marker]
        own = [row for row in members if row["series"] == name]
        np.testing.assert_allclose(line.get_xdata(), [row[cost] for row in own])
        np.testing.assert_allclose(line.get_ydata(), [row["error"] for row in own])
        assert line.get_markerfacecolor() == "white" and filled.get_markerfacecolor() != "white"
        np.testing.assert_allclose(filled.get_xdata(), [row[cost] for row in own if row[mark]])
        np.testing.assert_allclose(filled.get_ydata(), [row["error"] for row in own if row[mark]])


def check_work_precision(
    figure: Any, labels: Axes, table: list[Row], names: dict[str, str] | None = None, competing: bool = True
) -> None:
    """Error over time on the left, over the count on the right, a row of panels each facet."""
    series = list(dict.fromkeys(row["series"] for row in table))
    grid = np.array(figure.axes).reshape(-1, 2)
    assert len(grid) == len(labels.facet_titles)
    for place, (facet, title) in enumerate(labels.facet_titles.items()):
        members = [row for row in table if row["facet"] == facet]
        left, right = grid[place]
        assert words(left) == (f"({'abcdefgh'[2 * place]}) {title}", labels.seconds, labels.error)
        assert words(right)[:2] == (f"({'abcdefgh'[2 * place + 1]}) the same, by count", labels.count)
        check_panel(left, members, "seconds", "on_front", series, competing)
        check_panel(right, members, "count", "on_front_by_count", series, competing)
        assert left.get_xscale() == left.get_yscale() == right.get_xscale() == "log"
        for axes in (left, right):
            check_in_sight(axes)
    texts = [text for text in legend(figure) if text != FRONT]
    assert texts == [(names or {}).get(name, name) for name in series]
    for handle, name in zip(figure.legends[0].legend_handles, series):
        place = series.index(name)
        assert (to_hex(handle.get_color()), handle.get_marker()) == (to_hex(LOOKS[place][0]), LOOKS[place][1])


def test_work_precision(pictures: dict[str, Any], tmp_path: Path) -> None:
    labels = Axes("error [-]", "time [s]", "evaluations", {"one": "the first", "two": "the second"})
    table = rows_of(("one", "two"), ("a", "b", "c"))
    assert any(row["on_front"] != row["on_front_by_count"] for row in table)
    work_precision(tmp_path / "w.png", "Made up", labels, table, legend={"b": "the b"})
    assert heading(pictures["w.png"]) == "Made up"
    check_work_precision(pictures["w.png"], labels, table, {"b": "the b"})
    assert FRONT in legend(pictures["w.png"])
    work_precision(tmp_path / "w.png", "Made up", labels, table, front=False)
    assert FRONT not in legend(pictures["w.png"])
    broken = [{**row, "error": float("nan")} if row["setting"] == "a 1" else row for row in table]
    work_precision(tmp_path / "w.png", "Made up", labels, broken, front=False)
    line = pictures["w.png"].axes[0].get_lines()[0]
    assert len(line.get_xdata()) == 2  # a setting that failed is left out


LABELS = {
    "integrators": (integrators, "largest error of $\\sigma/p$, $z$, $a_c$ [-]",
                    "processor time per point and path [s]", "evaluations of the rates per point and path"),
    "arcs": (arcs, "largest error of $\\sigma/p$, $z$, $a_c$ [-]", "processor time per point and path [s]",
             "evaluations of the integrand per point and path"),
    "mesh": (mesh, "relative error of the displacement, $L_2$ norm [-]",
             "processor time, from the mesh to the solution [s]", "degrees of freedom"),
    "footing": (footing, "relative error of the mean pressure [-]",
                "processor time, from the mesh to the solution [s]", "degrees of freedom"),
    "load_steps": (load_steps, "error of the mean $q/p$, $z$, $a_c$ [-]", "processor time of the run [s]",
                   "calls of the law, each for all points"),
    "output": (output, "error of $z$ between what is written [-]", "processor time of the files [s]",
               "size of the files [bytes]"),
    "dem": (dem, "largest distance in $z$ (relative) and $a_c$ [-]", "processor time [s]",
            "steps times disks of the loading"),
}  # fmt: skip


@pytest.mark.parametrize("name", LABELS)
def test_studies_of_work_and_precision(name: str, pictures: dict[str, Any], tmp_path: Path) -> None:
    """Each study's own axes; legends that tell an order tell that of their series."""
    module, error, seconds, count = LABELS[name]
    labels = module.AXES
    assert (labels.error, labels.seconds, labels.count) == (error, seconds, count)
    names: dict[str, str] = {}
    if name in ("mesh", "footing"):
        table = rows_of(labels.facet_titles, ("P1", "Q1", "P2", "Q2"), cells=lambda step: 4 * 2**step)
        for place, row in enumerate(table):
            row["error"] = 0.1 * (place // 3 + 1) * row["cells"] ** -(1.0 + 0.5 * (place // 3))
        mark_fronts(table)
        names = {element: f"{element}, observed order {1 + 0.5 * place:.2f}" for place, element in
                 enumerate(("P1", "Q1", "P2", "Q2"))}  # fmt: skip
    elif name == "load_steps":
        table = rows_of(labels.facet_titles, load_steps.QUANTITIES, load_steps=lambda step: 2**step)
        names = dict(zip(load_steps.QUANTITIES, (
            "stress ratio $q/p$", "coordination number $z$ (relative)", "fabric anisotropy $a_c$"
        )))  # fmt: skip
    elif name == "output":
        table = rows_of(labels.facet_titles, output.KINDS, every=lambda step: 2**step)
        names = {kind: f"compression: {kind}" for kind in output.KINDS}
    else:
        table = rows_of(labels.facet_titles, ("a", "b"))
    STUDIES[name].draw(tmp_path / "s.png", table)
    # errors of different quantities do not compete
    check_work_precision(pictures["s.png"], labels, table, names, competing=name != "load_steps")
    if name == "load_steps":
        assert heading(pictures["s.png"]) == "Number of load steps of the biaxial test, 1 ... 4"


def bars(axes: Any) -> list[tuple[float, float]]:
    """Middle and length of horizontal bars."""
    return [(patch.get_y() + patch.get_height() / 2, patch.get_width()) for patch in axes.patches]


def named_bars(axes: Any, names: Any, named: Any = None) -> dict[str, float]:
    """Length of the bar beside each tick label (of `named`, whose ordinate is shared)."""
    owner = named or axes
    at = dict(zip(np.round(owner.get_yticks(), 6), (text.get_text() for text in owner.get_yticklabels())))
    found = {at[round(middle, 6)]: length for middle, length in bars(axes)}
    assert set(found) == set(names)
    return found


def test_bars_of_the_effects(pictures: dict[str, Any], tmp_path: Path) -> None:
    settings = ("everything", "without contact_gain", "no effect")
    table = [
        {"facet": facet, "setting": name, "relative_time": 1.0 - 0.1 * place - 0.03 * other,
         "error": 10.0 ** -(1 + place + other)}
        for other, facet in enumerate(effects.FACETS) for place, name in enumerate(settings)
    ]  # fmt: skip
    effects.draw(tmp_path / "e.png", table)
    titles = ("biaxial test", "biaxial, then shear", "biaxial test and back")
    for place, (left, right) in enumerate(np.array(pictures["e.png"].axes).reshape(3, 2)):
        members = {row["setting"]: row for row in table[3 * place : 3 * place + 3]}
        assert left.get_title("left") == f"({'ace'[place]}) {titles[place]}: time / everything"
        assert right.get_title("left") == f"({'bdf'[place]}) error (99 % of the area)"
        assert named_bars(left, settings) == pytest.approx({n: row["relative_time"] for n, row in members.items()})
        assert named_bars(right, settings, left) == pytest.approx({name: row["error"] for name, row in members.items()})
        assert right.get_lines()[0].get_xdata()[0] == 1e-2


def test_bars_of_the_decisions(pictures: dict[str, Any], tmp_path: Path) -> None:
    table = [
        {"setting": name, "speedup": 1.5 + place, "error": 10.0 ** -(2 + place), "estimate": 3 * 10.0 ** -(2 + place),
         "tolerance": 0.01 / (1 + place)}
        for place, name in enumerate(("one", "two", "three"))
    ]  # fmt: skip
    decisions.draw(tmp_path / "d.png", table)
    left, right = pictures["d.png"].axes
    names = [row["setting"] for row in table]
    assert named_bars(left, names) == pytest.approx({row["setting"]: row["speedup"] for row in table})
    assert named_bars(right, names, left) == pytest.approx({row["setting"]: row["error"] for row in table})
    assert left.get_xlabel() == "time with everything over time as decided"
    assert left.get_title("left") == "(a) time saved"
    assert right.get_xlabel() == "error (bar), estimate beforehand (|), tolerance (diamond)"
    assert right.get_title("left") == "(b) error against everything, 99 % of the area"
    marks = {line.get_marker(): line for line in right.get_lines()}
    heights = [3 - 1 - place for place in range(3)]  # the first row on top
    by_height = dict(zip(marks["|"].get_ydata(), marks["|"].get_xdata()))
    assert [by_height[height] for height in heights] == pytest.approx([row["estimate"] for row in table])
    by_height = dict(zip(marks["d"].get_ydata(), marks["d"].get_xdata()))
    assert [by_height[height] for height in heights] == pytest.approx([row["tolerance"] for row in table])


def test_bars_of_the_tangents(pictures: dict[str, Any], tmp_path: Path) -> None:
    columns = ("newton_iterations", "factorisations", "krylov_iterations", "law_calls", "seconds")
    kinds = ("propagated", "continuum", "elastic")
    table = [
        {"tangent_kind": kind, "keep_factor": keep,
         **{name: 10.0 * (column + 1) + 3 * place + keep for column, name in enumerate(columns)}}
        for place, kind in enumerate(kinds) for keep in (0, 1)
    ]  # fmt: skip
    tangents.draw(tmp_path / "t.png", table)
    panels = pictures["t.png"].axes
    titles = ("Newton iterations", "factorisations", "Krylov iterations", "calls of the law, all points",
              "processor time [s]")  # fmt: skip
    assert legend(panels[5]) == ["factor renewed at each solve", "factor kept as preconditioner"]
    renewed, kept = (to_hex(handle.get_facecolor()) for handle in panels[5].get_legend().legend_handles)
    for axes, column, title, letter in zip(panels, columns, titles, "abcde"):
        assert axes.get_title("left") == f"({letter}) {title}"
        assert [text.get_text() for text in axes.get_yticklabels()] == list(kinds)
        found = {}
        for patch in axes.patches:
            middle = patch.get_y() + patch.get_height() / 2
            keep = {renewed: 0, kept: 1}[to_hex(patch.get_facecolor())]
            found[kinds[round(middle)], keep] = patch.get_width()
        assert found == {(row["tangent_kind"], row["keep_factor"]): row[column] for row in table}
        shown = sorted(float(text.get_text()) for text in axes.texts)
        assert shown == sorted(row[column] for row in table)


def test_distributions_over_the_anisotropy(pictures: dict[str, Any], tmp_path: Path) -> None:
    """Both distributions: differences and errors over |a_c|, time in microseconds."""
    table: list[Row] = []
    series = {distributions.CLOSED: "harmonic", distributions.GAUSS: "harmonic"}
    series[distributions.ENTROPY] = "maximum_entropy"
    for place, fabric in enumerate((0.3, 0.9)):
        for number, (name, distribution) in enumerate(series.items()):
            for directions in (0,) if name == distributions.CLOSED else (8, 16, 32):
                table.append({
                    "facet": f"{fabric}", "series": name, "fabric": fabric,
                    "distribution": distribution, "directions": directions,
                    "error": 10.0 ** -(1 + number + directions / 8 + 0.1 * place), "difference": 0.01 * (1 + place),
                    "difference_median": 0.003 * (1 + place), "count": 10.0 + directions,
                    "seconds": 1e-6 * (1 + number + directions + place), "setting": "", "failed_points": 0,
                })  # fmt: skip
    mark_fronts(table)
    distributions.draw(tmp_path / "d.png", table)
    figure = pictures["d.png"]
    over = next(axes for axes in figure.axes if axes.get_title("left").startswith("(c)"))
    time = next(axes for axes in figure.axes if axes.get_title("left").startswith("(d)"))
    assert words(over)[1:] == ("$|a_c|$ at the start [-]", "$\\sigma/p$, $z$, $a_c$ at the end [-]")
    found = curves(over)
    np.testing.assert_allclose(found["difference, largest"], [[0.3, 0.9], [0.01, 0.02]])
    np.testing.assert_allclose(found["difference, median"], [[0.3, 0.9], [0.003, 0.006]])
    for number in (8, 16):
        expected = [r["error"] for r in table if r["series"] == distributions.ENTROPY and r["directions"] == number]
        np.testing.assert_allclose(found[f"error of {number} directions"], [[0.3, 0.9], expected])
    assert words(time) == (
        "(d) time, quadrature with 32 directions", "$|a_c|$ at the start [-]", "processor time per point and path [µs]"
    )  # fmt: skip
    drawn = sorted(tuple(np.round(line.get_ydata(), 9)) for line in time.get_lines())
    expected_times = [
        tuple(np.round([1e6 * row["seconds"] for row in table
                        if row["series"] == name and row["directions"] in (0, 32)], 9))
        for name in series
    ]  # fmt: skip
    assert drawn == sorted(expected_times)


def test_closures_against_grains(pictures: dict[str, Any], tmp_path: Path) -> None:
    names = ("one", "two")
    table = [
        {"facet": facet, "series": name, "setting": f"tolerance {tolerance:g}", "tolerance": tolerance,
         "error": 0.1 * (1 + place) + tolerance + 0.01 * other, "seconds": (1 + place) * 1e-4 / tolerance**0.3,
         "count": 100.0 * (1 + place), "error_coordination": 0.02 * (1 + place) + 0.1 * tolerance + 0.001 * other,
         "error_fabric": 0.05 * (1 + place) + 0.001 * other, "scatter_of_packings": 0.004 + 0.001 * other,
         "failed_packings": 0}
        for other, facet in enumerate(closures.TESTS) for place, name in enumerate(names) for tolerance in (1e-2, 1e-4)
    ]  # fmt: skip
    mark_fronts(table)
    closures.draw(tmp_path / "c.png", table)
    figure = pictures["c.png"]
    grid = np.array(figure.axes).reshape(2, 3)
    titles = ("constant mean pressure to $q/p = 0.2$", "constant lateral stress to $q/p = 0.2$",
              "loop of $q/p$: 0, 0.2, 0, 0.2")  # fmt: skip
    for place, (facet, title) in enumerate(zip(closures.TESTS, titles, strict=True)):
        members = [row for row in table if row["facet"] == facet]
        above, below = grid[:, place]
        assert above.get_title("left") == f"({'abc'[place]}) {title}"
        assert above.get_xlabel() == "processor time per point and path [s]"
        check_panel(above, members, "seconds", "on_front", list(names))
        assert [text.get_text() for text in below.get_xticklabels()] == ["$z$ (relative)", "$a_c$"]
        finest = {row["series"]: row for row in members if row["tolerance"] == 1e-4}
        found = {}
        for patch in below.patches:
            name = names[[to_hex(look[0]) for look in LOOKS].index(to_hex(patch.get_facecolor()))]
            found[name, round(patch.get_x() + patch.get_width() / 2)] = patch.get_height()
        for name in names:
            assert found[name, 0] == finest[name]["error_coordination"]
            assert found[name, 1] == finest[name]["error_fabric"]
        assert below.get_lines()[-1].get_ydata()[0] == members[0]["scatter_of_packings"]
    assert grid[0, 0].get_ylabel() == grid[1, 0].get_ylabel() == "largest distance from grains [-]"
    assert set(legend(figure)) == {*names, FRONT, closures.SCATTER}


# tables and findings


def test_page_of_a_study() -> None:
    """Heads with units, numbers in their columns, "yes" on the front, "failed" without an error."""
    study = STUDIES["tangents"]
    table = [
        {column.name: 100 * place + number for number, column in enumerate(study.columns)} for place in range(2)
    ]
    for place, row in enumerate(table):
        row |= {"facet": "biaxial", "series": f"s{place}", "setting": f"w{place}", "on_front": place,
                "error": float("nan") if place else 0.0123, "seconds": 0.5 + place, "count": 7.5 + place}  # fmt: skip
    entry = {"quick": False, "findings": ["one thing", "another"], "finished": "now", "duration": 12.4}
    text = cost_page.page(
        {"studies": {"tangents": entry}, "versions": {"numpy": "1"}, "machine": "this"}, [(study, table)]
    )
    lines = text.splitlines()
    assert f"## {study.title}" in lines and study.question in lines and "- one thing" in lines
    head = next(line for line in lines if line.startswith("| series"))
    assert head == (
        "| series | setting | error | seconds [s] | count | on front | newton iterations | factorisations | "
        "krylov iterations |"
    )
    place = {column.name: number for number, column in enumerate(study.columns)}
    extra = [place[name] for name in ("newton_iterations", "factorisations", "krylov_iterations")]
    assert f"| s0 | w0 | 1.23e-02 | 5.00e-01 | 7.5 |  | {extra[0]} | {extra[1]} | {extra[2]} |" in lines
    counts = " | ".join(str(100 + number) for number in extra)
    assert f"| s1 | w1 | failed | 1.50e+00 | 8.5 | yes | {counts} |" in lines
    assert "numpy 1; this." in lines and any("Computed now in 12 s" in line for line in lines)
    assert not any("a first look" in line for line in lines)


def test_findings_on_effects_and_decisions() -> None:
    table = [
        {"facet": "biaxial", "setting": name, "relative_time": time, "error": error, "quantity": quantity}
        for name, time, error, quantity in (
            ("everything", 1.0, 0.0, "stress"), ("without contact_gain", 0.9, 2e-4, "fabric"),
            ("without stiffness_feedback", 0.5, 4e-3, "strain"), ("contact_loss alone", 0.3, 0.02, "coordination"),
            ("no effect", 0.1, 0.3, "fabric"),
        )
    ]  # fmt: skip
    assert effects.findings(table) == [
        "biaxial test: without stiffness_feedback has an error of 4.0e-03 and takes 50% of the time of everything.",
        "biaxial test: gravest is contact_loss alone, 2.0e-02 (coordination).",
    ]
    decided = [
        {"setting": "a", "facet": "point", "within": 1, "uncoupled": 0, "speedup": 9.0},
        {"setting": "b", "facet": "field", "within": 0, "uncoupled": 1, "speedup": 2.0},
        {"setting": "c", "facet": "field", "within": 1, "uncoupled": 0, "speedup": 3.24},
    ]
    assert decisions.findings(decided) == [
        "2 of 3 scenes stay within their tolerance; not b.", "Displacements by one linear solve a stage: b.",
        "Most is saved in c: 3.2 times faster.",
    ]  # fmt: skip


def test_findings_on_meshes_and_steps() -> None:
    made = [
        {"facet": "f", "series": element, "setting": f"{cells} x {cells} cells", "cells": cells,
         "count": 10 * cells + k, "error": cells ** -(1.0 + k), "stress_error": cells ** -(0.5 + k),
         "seconds": 1e-3 * cells * (1 + k),
         "reference_uncertainty": 3e-4, "factorisations": 5 + k}
        for k, element in enumerate(("P1", "Q1", "P2", "Q2")) for cells in (2, 4, 8)
    ]  # fmt: skip
    told = mesh.findings(made)
    assert told[0] == (
        "Observed orders in the cell size, displacement (stress): P1 1.00 (0.50), Q1 2.00 (1.50), P2 3.00 (2.50), "
        "Q2 4.00 (3.50)."
    )
    # P2 on 8 cells (2e-3) and Q2 on 4 (4e-3) and 8; the least time of these: Q2, 4 cells, 16 ms
    assert told[1] == "An error of 0.01 costs least with Q2, 4 x 4 cells: 43 degrees of freedom, 16 ms."
    assert told[-1] == (
        "The most accurate linear mesh (Q1, 8 x 8 cells, error 1.6e-02) takes 1.33 times the time of P2, 4 x 4 cells, "
        "which is as accurate."
    )
    told = footing.findings(made)
    assert told[0].startswith("Observed orders in the cell size: P1 1.00, Q1 2.00, P2 3.00, Q2 4.00;")
    assert told[1] == "The reference is known to 3.0e-04 (difference of the extrapolations of P2 and Q2)."
    assert told[-1] == (
        "With the finest mesh of each: P1 1.2e-01 in 0.008 s, Q1 1.6e-02 in 0.016 s, P2 2.0e-03 in 0.024 s, "
        "Q2 2.4e-04 in 0.032 s."
    )
    steps = [
        {"facet": "biaxial", "series": name, "setting": f"{number} load steps", "load_steps": number,
         "error": 1e-6 * (1 + k) / number**2, "count": 5 * number + k, "seconds": 0.1 * number,
         "cuts": int(number == 1)}
        for k, name in enumerate(load_steps.QUANTITIES) for number in (1, 2, 4, 8)
    ]  # fmt: skip
    told = load_steps.findings(steps)
    assert told == [
        "Observed orders in the size of the step: stress ratio q/p 2.00, coordination number z (relative) 2.00, fabric "
        "anisotropy a_c 2.00.",
        "All means within 1e-05 take 1 load steps: 7 calls of the law, 0.1 s.",
        "All means within 1e-07 take 8 load steps: 42 calls of the law, 0.8 s.",
        "Steps had to be cut with 1 load steps.",
    ]


def test_findings_on_closures() -> None:
    table = [
        {"facet": facet, "series": name, "setting": "tolerance 1e-4", "tolerance": 1e-4, "error": 0.03 + 0.1 * k,
         "error_coordination": 0.0123 + 0.1 * k, "error_fabric": 0.03 + 0.1 * k, "seconds": 2e-6, "count": 12.0,
         "failed_packings": int(k and facet == "loop")}
        for facet in closures.TESTS for k, name in enumerate(("best", "worst"))
    ]  # fmt: skip
    told = closures.findings(table)
    assert told[0] == (
        "Constant mean pressure to q/p = 0.2, largest distance from grains: best z 1.2 %, a_c 0.03; worst z 11 %, "
        "a_c 0.13."
    )
    assert "Loop of q/p: 0, 0.2, 0, 0.2: refused by worst." in told
    assert told[-2] == (
        "best: a tolerance 1e-4 brings it as near to grains as it gets, with 2 µs and 12 evaluations a point and path; "
        "what is left is the model."
    )


def test_grains_at_the_points(pictures: dict[str, Any], tmp_path: Path) -> None:
    """Each row of the table at its place: errors over milliseconds, scatters over disks, a bar for each tangent."""
    pace = [
        {"facet": "pace", "series": name, "setting": place, "error": 1e-4 * (place + 1), "seconds": 0.01 * (3 - place)}
        for name in ("strain step", "rest tolerance", "increments")
        for place in range(3)
    ]
    sizes = [
        {"facet": "disks", "setting": disks, "scatter_ratio": 1.0 / disks, "scatter_coordination": 2.0 / disks,
         "scatter_fabric": 3.0 / disks} for disks in (100, 400)
    ]  # fmt: skip
    tangents = [
        {"facet": "tangents", "series": name, "seconds": seconds, "newton_iterations": count}
        for name, seconds, count in (("secant", 1.5, 29), ("network", 2.0, 40))
    ]
    STUDIES["grains"].draw(tmp_path / "g.png", [*pace, *sizes, *tangents])
    first, second, third = pictures["g.png"].axes
    for line, name in zip(first.get_lines(), ("strain step", "rest tolerance", "increments"), strict=True):
        assert line.get_label() == name
        np.testing.assert_allclose(line.get_xydata(), [[30.0, 1e-4], [20.0, 2e-4], [10.0, 3e-4]])
    for line, factor, label in zip(second.get_lines(), (1.0, 2.0, 3.0), ("q/p", "z", "$a_c$"), strict=True):
        assert line.get_label() == label
        np.testing.assert_allclose(line.get_xydata(), [[100.0, factor / 100.0], [400.0, factor / 400.0]])
    assert named_bars(third, ("secant", "network")) == {"secant": 1.5, "network": 2.0}
    assert [text.get_text() for text in third.texts] == ["1.5 s, 29 it.", "2 s, 40 it."]


def test_every_picture_of_a_study_is_tested_here() -> None:
    assert set(STUDIES) == {*LABELS, "effects", "decisions", "tangents", "distributions", "closures", "grains"}
    assert work_precision_module.FRONT == FRONT


def test_findings_on_integrators_and_arcs() -> None:
    facet = "mean field, 1e-4"
    table = [
        {"facet": facet, "series": name, "setting": f"{n:.0f} substeps", "integrator": key, "error": 2.0 * n**-order,
         "error_biaxial": n**-order, "substeps": 10.0 * n, "seconds": 1e-6 * n * stages, "count": stages * n,
         "reference_uncertainty": 2e-14}
        for key, name, order, stages in (
            ("forward_euler", "Euler", 1.0, 1.0), ("bogacki_shampine", "Bogacki", 3.0, 4.0),
        )
        for n in (10.0, 100.0, 1000.0)
    ]  # fmt: skip
    told = integrators.findings(table)
    # 1e-3: Bogacki with 100 (2e-6); Euler never (2e-3 with 1,000)
    assert told[0] == (
        "Mean field, one strain increment of 1e-4: an error of 0.001 costs least with Bogacki, 100 substeps (400 µs "
        "and 400 evaluations of the rates a point and path)."
    )
    assert "The references are known to 2.0e-14." in told
    names = integrators.NAMES
    assert told[-1] == (
        f"Observed orders in the number of substeps, biaxial path: {names['forward_euler']} 1.0, "
        f"{names['bogacki_shampine']} 3.0."
    )
    made = [
        {"facet": name, "directions": directions, "error": error, "seconds": seconds, "count": float(directions),
         "distance_from_harmonic": 0.123}
        for name, factor in (("harmonic", 1.0), ("maximum_entropy", 2.0), ("shifted_distribution", 3.0))
        for directions, error, seconds in (
            (8, 1e-3, 2e-6 * factor), (16, 3e-8, 4e-6 * factor), (arcs.DEFAULT_DIRECTIONS, 1e-12, 8e-6 * factor),
        )
    ]  # fmt: skip
    made.append({"facet": "harmonic", "directions": 0, "error": 0.0, "seconds": 1e-6, "count": 0.0,
                 "distance_from_harmonic": 0.0})  # fmt: skip
    told = arcs.findings(made)
    number = arcs.DEFAULT_DIRECTIONS
    assert (
        f"Mean field, harmonic distribution: {number} directions (the default) take 8 times the time of the harmonic "
        "closed form."
    ) in told
    assert (
        f"Shifted distribution of weak forces: {number} directions (the default) take 24 times the time of the "
        "harmonic closed form."
    ) in told
    assert told[-1].startswith("At the end of the paths shifted distribution of weak forces is up to 0.12 from the ")


def test_findings_on_distributions_tangents_and_disks() -> None:
    table = [
        {"facet": "0.9", "fabric": 0.9, "distribution": "harmonic", "directions": 0, "error": 0.0, "seconds": 1e-6,
         "difference": 0.034, "difference_median": 0.0056, "failed_points": 0},
        {"facet": "0.9", "fabric": 0.9, "distribution": "maximum_entropy", "directions": 32, "error": 1e-9,
         "seconds": 5e-6, "difference": 0.034, "difference_median": 0.0056, "failed_points": 2},
    ]  # fmt: skip
    assert distributions.findings(table) == [
        "|a_c| = 0.9: at the end of the paths the distributions differ by up to 0.034 (median 0.0056); maximum entropy "
        "is within 1e-6 of its own limit with 32 directions, at 5 times the time of the harmonic closed form.",
        "Points were refused in 1 settings: 0.9 and others.",
    ]
    made = [
        {"series": f"{kind} tangent", "setting": "kept" if keep else "renewed", "tangent_kind": kind,
         "keep_factor": keep, "seconds": 2.0 + place - 0.5 * keep, "newton_iterations": 10 + place,
         "factorisations": 8 + place - 6 * keep,
         "krylov_iterations": 3 * keep, "error": 1e-9 * (1 + place)}
        for place, kind in enumerate(("propagated", "continuum", "elastic")) for keep in (0, 1)
    ]  # fmt: skip
    told = tangents.findings(made)
    assert told[0] == (
        "Least time: propagated tangent, kept (1.5 s, 10 Newton iterations, 2 factorisations, 3 Krylov iterations)."
    )
    assert (
        "Continuum tangent: 11 Newton iterations; keeping the factor saves 6 of 9 factorisations and takes 0.83 of the "
        "time."
    ) in told
    assert told[-1] == "All ways lead to the same end: means differ from the reference by at most 3.0e-09."
    disks = [
        {"facet": "disks", "disks": number, "packings": 1, "series": "one", "setting": f"{number} disks",
         "error": number**-0.5, "error_coordination": 0.5 * number**-0.5, "error_fabric": 0.25,
         "seconds": 0.01 * number, "packing_seconds": 0.004 * number, "reference_uncertainty": 0.0031}
        for number in (100, 400, 1600)
    ]  # fmt: skip
    disks.append({"facet": "rate", "setting": "inertial number up to 1e-04", "error": 0.002, "seconds": 1.5})
    told = dem.findings(disks)
    assert told[0] == (
        "One packing of 100 disks is 0.1 from the mean of 1600 disks (z 5 %, a_c 0.25) and takes 1 s, 40 % of it for "
        "packing."
    )
    assert told[2] == (
        "The distance falls with the number of disks to the power -0.50 (independent contacts: -0.5); the mean of 1600 "
        "disks itself is known to 0.0031."
    )
    assert told[-1] == "Inertial number up to 1e-04: 2.0e-03 from the slowest run in 1.5 s of loading."
