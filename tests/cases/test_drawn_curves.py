"""Curves of points, fields and closed forms: which columns go to which axes, in which unit, under which name."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from drawn import bands, check_curves, check_in_sight, check_legend, curves, heading, legend, same, unnamed, words

from granfabric.cases.commands import convergence
from granfabric.cases.commands.convergence import Level
from granfabric.cases.pictures import draw as plots
from granfabric.cases.pictures.comparison import draw_comparison
from granfabric.cases.pictures.field import draw_field
from granfabric.cases.pictures.point import draw_point, horizontal
from granfabric.cases.records import files
from granfabric.constitutive.path import POINT_COLUMNS

STEPS = 12


def point_columns(turning: bool = False) -> dict[str, np.ndarray]:
    """A history whose columns all differ; vectors stay on one line or turn."""
    random = np.random.default_rng(6)
    columns = {name: random.uniform(0.1, 1.0) + np.cumsum(random.uniform(0.01, 0.1, STEPS)) for name in POINT_COLUMNS}
    columns["step"] = np.arange(float(STEPS))
    for name, size in (("xx", -9e4), ("yy", -12e4), ("xy", 2e4)):
        columns[f"stress_{name}"] = size * (1 + random.uniform(0, 0.1, STEPS))
    for place, name in enumerate(("xx", "yy", "xy")):
        columns[f"strain_{name}"] = (place + 1) * 1e-5 * np.linspace(0, 1, STEPS) ** 2
    columns["p"], columns["q"] = 1e5 * (1 + 0.1 * random.uniform(size=STEPS)), 1e4 * np.arange(STEPS)
    columns["fabric_lost"] *= -1.0
    for name in ("fabric_anisotropy", "normal_force_anisotropy", "tangential_force_anisotropy"):
        angle = np.linspace(0, 1.5, STEPS) if turning else np.full(STEPS, 0.7)
        columns[f"{name}_1"], columns[f"{name}_2"] = columns[name] * np.cos(angle), columns[name] * np.sin(angle)
    return columns


STRESS_PATH = {"title": "Made up", "path": [{"control": ["stress"] * 3}]}


def strain_path(*moved: str) -> dict[str, Any]:
    return {"title": "Made up", "path": [{"control": ["strain", "stress", "stress"]}]}


def test_abscissa_of_a_point() -> None:
    columns = point_columns()
    ratio = columns["q"] / columns["p"]
    for scene, expected, label in (
        (STRESS_PATH, ratio, "stress ratio $q/p$ [-]"),
        ({"path": [{"rotation_degrees": 90}]}, columns["step"], "step"),
        (strain_path(), columns["strain_xy"] * 1e6, r"strain $\gamma_{xy}$ [$10^{-6}$]"),
    ):
        values, text = horizontal(columns, scene)
        np.testing.assert_allclose(values, expected, rtol=1e-12)
        assert text == label
    for name, symbol in (("strain_xx", r"\varepsilon_{xx}"), ("strain_yy", r"\varepsilon_{yy}")):
        moved = {**columns, name: columns[name] * 10}
        values, text = horizontal(moved, strain_path())
        np.testing.assert_allclose(values, moved[name] * 1e6, rtol=1e-12)
        assert text == f"strain ${symbol}$ [$10^{{-6}}$]"
    still = {**columns, "q": 0.2 * columns["p"]}
    values, text = horizontal(still, STRESS_PATH)
    np.testing.assert_allclose(values, columns["p"] / 1e3, rtol=1e-12)
    assert text == "mean pressure $p$ [kPa]"


MICRO = (
    ("coordination", "coordination number $z$ [-]"),
    ("fabric_anisotropy", "fabric anisotropy $a_c$ [-]"),
    ("normal_force_anisotropy", "normal-force anisotropy $a_n$ [-]"),
    ("tangential_force_anisotropy", "tangential-force anisotropy $a_t$ [-]"),
    ("mean_normal_force", "mean normal force $f/f_0$ [-]"),
)


@pytest.mark.parametrize("turning", [False, True])
def test_microvariables(turning: bool, pictures: dict[str, Any], tmp_path: Path) -> None:
    columns = point_columns(turning)
    assert {path.name for path in draw_point(tmp_path, columns, STRESS_PATH)} == set(pictures)
    figure = pictures["microvariables.png"]
    assert heading(figure) == "Made up"
    x, axes = columns["q"] / columns["p"], figure.axes
    assert len(axes) == 6
    for place, (name, label) in enumerate(MICRO):
        one = axes[place]
        assert words(one) == (f"({'abcdef'[place]})", "stress ratio $q/p$ [-]", label)
        if turning and "anisotropy" in name:
            first, second = columns[f"{name}_1"], columns[f"{name}_2"]
            expected = {
                "magnitude": np.hypot(first, second), r"along $\cos 2\theta$": first, r"along $\sin 2\theta$": second
            }  # fmt: skip
            check_curves(one, x, expected)
            check_legend(one)
            continue
        line, start, end = unnamed(one)
        check_in_sight(one)
        same(line, x, columns[name])
        # an open dot where the path begins, a full one where it ends
        same(start, x[:1], columns[name][:1])
        same(end, x[-1:], columns[name][-1:])
        assert one.get_lines()[1].get_markerfacecolor() == "white" != one.get_lines()[2].get_markerfacecolor()
    stress = axes[5]
    check_in_sight(stress)
    s1 = (columns["stress_yy"] - columns["stress_xx"]) / 2 / columns["p"]
    s2 = -columns["stress_xy"] / columns["p"]
    same(unnamed(stress)[0], s1, s2)
    same(unnamed(stress)[1], s1[:1], s2[:1])
    assert words(stress) == (
        "(f)", r"$(\sigma_{xx}-\sigma_{yy})/2p$ [-]", r"$\sigma_{xy}/p$ [-], compression positive"
    )  # fmt: skip


def test_decomposition_of_a_straight_path(pictures: dict[str, Any], tmp_path: Path) -> None:
    """What was gained counts up, what was lost down; of the fabric the signs are those of the columns."""
    columns = point_columns()
    draw_point(tmp_path, columns, STRESS_PATH)
    left, right = pictures["fabric_decomposition.png"].axes
    x = columns["q"] / columns["p"]
    fabric, z = columns["fabric_anisotropy"], columns["coordination"]
    check_curves(left, x, {
        "by contacts lost": -columns["fabric_lost"], "by contacts gained": columns["fabric_gained"],
        "net": fabric - fabric[0],
    })  # fmt: skip
    check_curves(right, x, {
        "by contacts lost": -columns["coordination_lost"], "by contacts gained": columns["coordination_gained"],
        "net": z - z[0],
    })  # fmt: skip
    assert words(left) == ("Fabric anisotropy", "stress ratio $q/p$ [-]", "change of fabric anisotropy $a_c$ [-]")
    assert words(right) == ("Coordination number", "stress ratio $q/p$ [-]", "change of coordination number $z$ [-]")
    check_legend(left)
    assert legend(left) == ["by contacts lost", "by contacts gained", "net"]


def test_decomposition_of_a_turning_path_is_of_magnitudes(pictures: dict[str, Any], tmp_path: Path) -> None:
    columns = point_columns(turning=True)
    draw_point(tmp_path, columns, STRESS_PATH)
    left, _ = pictures["fabric_decomposition.png"].axes
    first, second = columns["fabric_anisotropy_1"], columns["fabric_anisotropy_2"]
    check_curves(left, columns["q"] / columns["p"], {
        "by contacts lost": np.abs(columns["fabric_lost"]), "by contacts gained": np.abs(columns["fabric_gained"]),
        "net": np.hypot(first - first[0], second - second[0]),
    })  # fmt: skip
    assert left.get_ylabel() == "magnitude of the change of fabric anisotropy $a_c$ [-]"


# fields


def field_columns() -> dict[str, np.ndarray]:
    random = np.random.default_rng(9)
    names = [
        *("strain_xx", "strain_yy", "strain_xy", "stress_xx", "stress_yy", "stress_xy", "p", "q", "coordination"),
        *("coordination_smallest", "coordination_largest", "fabric_anisotropy", "fabric_anisotropy_largest"),
        *("stress_ratio_largest", "displacement_top_y", "reaction_top_y", "displacement_left_x"),
    ]
    columns: dict[str, Any] = {name: 1.0 + np.cumsum(random.uniform(0.01, 0.1, 7)) for name in names}
    columns["step"], columns["fraction"] = np.arange(7.0), np.array([0, 0.5, 1, 0.25, 0.5, 0.75, 1.0])
    columns["stage"] = np.array(["initial"] * 3 + ["press"] * 4)
    columns["strain_yy"] = -1e-4 * np.arange(7.0)
    columns["strain_xx"], columns["strain_xy"] = 2e-5 * np.arange(7.0), -3e-5 * np.arange(7.0)
    columns["coordination_smallest"] = columns["coordination"] - 0.3
    columns["coordination_largest"] = columns["coordination"] + 0.2
    columns["p"], columns["q"] = 1e5 * columns["p"], 2e4 * columns["q"]
    return columns


STAGES = [{"name": "initial"}, {"name": "press", "displacement": [{"boundary": "top"}]}]


def field_scene(**output: Any) -> dict[str, Any]:
    return {"title": "Made up", "stage": STAGES, "output": output}


def test_curves_of_a_field(pictures: dict[str, Any], tmp_path: Path) -> None:
    columns = field_columns()
    draw_field(tmp_path, columns, field_scene())
    above, below = pictures["overview.png"].axes
    x, label = 1e6 * -columns["strain_yy"], r"mean strain $-\varepsilon_{yy}$ [$10^{-6}$]"
    check_curves(above, x, {
        "of the mean stress": columns["q"] / columns["p"], "largest of all points": columns["stress_ratio_largest"],
    })  # fmt: skip
    assert words(above) == ("Stress ratio", label, "stress ratio $q/p$ [-]")
    check_curves(below, x, {"mean": columns["coordination"]})
    assert words(below) == ("Contact network", label, "coordination number $z$ [-]")
    ((name, at, low, high),) = bands(below)
    assert name == "all points" and set(legend(below)) == {"all points", "mean"}
    order = np.argsort(x)
    np.testing.assert_allclose(at, x[order])
    np.testing.assert_allclose(low, columns["coordination_smallest"][order])
    np.testing.assert_allclose(high, columns["coordination_largest"][order])
    check_legend(above)


def test_a_network_that_is_kept_is_a_flat_line(pictures: dict[str, Any], tmp_path: Path) -> None:
    """Rounding is not magnified."""
    columns = field_columns()
    for name in ("coordination", "coordination_smallest", "coordination_largest"):
        columns[name] = 4.0 + 1e-13 * np.arange(7.0)
    draw_field(tmp_path, columns, field_scene())
    assert pictures["overview.png"].axes[1].get_ylim() == pytest.approx((3.99, 4.01))
    columns = point_columns()
    columns["coordination"] = 4.0 + 1e-13 * np.arange(STEPS)
    draw_point(tmp_path, columns, STRESS_PATH)
    low, high = pictures["microvariables.png"].axes[0].get_ylim()
    assert low < 3.96 and high > 4.04


@pytest.mark.parametrize(
    ("name", "sign", "symbol"),
    [
        ("strain_xx", 1.0, r"\varepsilon_{xx}"), ("strain_xy", -1.0, r"-\gamma_{xy}"),
        ("strain_yy", -1.0, r"-\varepsilon_{yy}"),
    ],
)  # fmt: skip
def test_the_strain_that_moves_most_is_the_abscissa(
    name: str, sign: float, symbol: str, pictures: dict[str, Any], tmp_path: Path
) -> None:
    columns = field_columns()
    columns[name] = columns[name] * 100
    draw_field(tmp_path, columns, field_scene())
    above = pictures["overview.png"].axes[0]
    np.testing.assert_allclose(curves(above)["of the mean stress"][0], sign * 1e6 * columns[name], rtol=1e-12)
    assert above.get_xlabel() == f"mean strain ${symbol}$ [$10^{{-6}}$]"


def test_loads_alone_are_drawn_over_their_stages(pictures: dict[str, Any], tmp_path: Path) -> None:
    scene = {"title": "Made up", "stage": [{"name": "initial"}, {"name": "press", "pressure": []}], "output": {}}
    draw_field(tmp_path, field_columns(), scene)
    above = pictures["overview.png"].axes[0]
    np.testing.assert_allclose(curves(above)["of the mean stress"][0], [0, 0.5, 1, 1.25, 1.5, 1.75, 2])
    assert above.get_xlabel() == "stage: 0 to 1 initial, 1 to 2 press"


NAMED = {
    "displacement_top_y": (1e6, "displacement of top y [$10^{-6}$ m]"),
    "displacement_left_x": (1e6, "displacement of left x [$10^{-6}$ m]"),
    "reaction_top_y": (1e-3, "reaction of top y [kN/m]"),
    "stress_yy": (1e-3, "stress yy [kPa]"),
    "stress_ratio_largest": (1.0, "stress ratio largest [-]"),
    "p": (1e-3, "p [kPa]"),
    "q": (1e-3, "q [kPa]"),
    "strain_xy": (1e6, "strain xy [$10^{-6}$]"),
    "coordination": (1.0, "coordination [-]"),
    "fabric_anisotropy_largest": (1.0, "fabric anisotropy largest [-]"),
}


@pytest.mark.parametrize("name", NAMED)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_chosen_curve_has_the_units_that_it_names(
    name: str, sign: float, pictures: dict[str, Any], tmp_path: Path
) -> None:
    columns = field_columns()
    columns[name] = sign * np.abs(columns[name])
    draw_field(tmp_path, columns, field_scene(curve=[name, "coordination_largest"]))
    above = pictures["overview.png"].axes[0]
    factor, label = NAMED[name]
    minus = "minus " if sign < 0 else ""
    assert words(above) == ("Response", minus + label, "coordination largest [-]")
    # mostly positive, as its label says
    same(unnamed(above)[0], factor * sign * columns[name], columns["coordination_largest"])


# closed forms


def test_a_closed_form_beside_what_was_computed(pictures: dict[str, Any], tmp_path: Path) -> None:
    random = np.random.default_rng(2)
    names = ["x", "y", "distance", "stress_xx", "closed_form_xx", "stress_xy", "closed_form_xy"]
    table = {name: (1.0 + random.uniform(size=9)).tolist() for name in names}
    table["distance"] = np.linspace(0, 2, 9).tolist()
    files.write_text(tmp_path / files.COMPARISON, files.csv_text(names, list(zip(*table.values()))))
    scene = {"title": "A hole", "closed_form": {"hole_in_plate": {}}}
    draw_comparison(tmp_path, scene)
    (axes,) = pictures["closed_form.png"].axes
    check_curves(axes, table["distance"], {
        f"{kind}, {name}": np.array(table[f"{column}_{name}"]) / 1e3
        for kind, column in (("closed form", "closed_form"), ("computed", "stress")) for name in ("xx", "xy")
    })  # fmt: skip
    title, x_label, y_label = words(axes)
    assert title == "A hole: Kirsch's hole in a plate"
    first, last = ((table["x"][row], table["y"][row]) for row in (0, -1))
    assert x_label == f"distance from ({first[0]:g}, {first[1]:g}) towards ({last[0]:g}, {last[1]:g}) [m]"
    assert y_label == "stress, tension positive [kPa]"
    check_legend(axes)
    looks = {line.get_label(): (line.get_linestyle(), line.get_marker()) for line in axes.get_lines()}
    assert all(looks[name] == ("None", "o") for name in looks if name.startswith("computed"))
    assert all(looks[name] == ("-", "None") for name in looks if name.startswith("closed form"))


def test_orders_of_convergence_are_drawn_over_the_mesh_size(pictures: dict[str, Any], tmp_path: Path) -> None:
    levels = [Level(n, 0.4 / n, 10 * n, 0.1 / n**2, 0.03 / n**3) for n in (1, 2, 4)]
    convergence._draw(tmp_path / "convergence.png", levels, "Made up")
    (axes,) = pictures["convergence.png"].axes
    check_curves(axes, [0.4, 0.2, 0.1], {
        "stress, order 2.00": [0.1, 0.1 / 4, 0.1 / 16], "displacement, order 3.00": [0.03, 0.03 / 8, 0.03 / 64],
    })  # fmt: skip
    assert words(axes) == ("Made up", "mesh size $h$ [m]", "relative error [-]")
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert convergence.order(levels[0], levels[1], "displacement_error") == pytest.approx(3.0)


def test_each_kind_of_result_is_drawn_by_its_own_module(pictures: dict[str, Any], tmp_path: Path) -> None:
    """From the file alone: the columns of `history.csv` reach the pictures."""
    columns = point_columns()
    files.write_text(
        tmp_path / "history.csv", files.csv_text(list(columns), list(zip(*(c.tolist() for c in columns.values()))))
    )
    plots.draw(tmp_path, {**STRESS_PATH, "kind": "point"})
    assert set(pictures) == {"microvariables.png", "fabric_decomposition.png", "stress_strain.png"}
    same(unnamed(pictures["microvariables.png"].axes[0])[0], columns["q"] / columns["p"], columns["coordination"])
    pictures.clear()
    made = field_columns()
    rows = list(zip(*(column.tolist() for column in made.values())))
    files.write_text(tmp_path / "history.csv", files.csv_text(list(made), rows))
    plots.draw(tmp_path, {**field_scene(), "kind": "field"})
    assert set(pictures) == {"overview.png"}
    assert SimpleNamespace(**curves(pictures["overview.png"].axes[1]))
