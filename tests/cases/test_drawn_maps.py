"""Maps of fields: values and units at the nodes, colour bars, limits, directions of the fabric."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import meshio
import numpy as np
import pytest
from drawn import heading, words
from matplotlib.collections import LineCollection

from granfabric.cases.pictures.field import draw_field
from granfabric.cases.pictures.maps import MAPS, chosen_maps, draw_map, is_wide
from granfabric.cases.pictures.style import picture
from granfabric.cases.records import series


def mesh(seed: int, width: float = 1.0, height: float = 2.0, n: int = 6) -> Any:
    """A made-up result on a rectangle of triangles; every component of every field is different."""
    random = np.random.default_rng(seed)
    x, y = (part.ravel() for part in np.meshgrid(np.linspace(0, width, n), np.linspace(0, height, n)))
    node = np.arange(n * n).reshape(n, n)
    a, b, c, d = (part.ravel() for part in (node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]))
    cells = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    stress = np.zeros((len(x), 9))
    stress[:, 0], stress[:, 4] = -1e5 + 1e4 * random.normal(size=len(x)), -2e5 + 1e4 * random.normal(size=len(x))
    stress[:, 1] = stress[:, 3] = 3e4 * random.normal(size=len(x))
    data = {
        "coordination": 4 + 0.1 * random.normal(size=len(x)),
        "fabric_anisotropy": np.column_stack([0.1 * random.normal(size=(len(x), 2)), np.zeros(len(x))]),
        "stress": stress,
        "displacement": np.column_stack([1e-6 * random.normal(size=(len(x), 2)), np.zeros(len(x))]),
    }
    return meshio.Mesh(np.column_stack([x, y, 0 * x]), [("triangle", cells)], point_data=data)


LAST, FIRST, WET = mesh(1), mesh(2), mesh(1)
"""`WET` has a pore pressure as well, so that q/p is that of the effective stress."""
WET.point_data["pore_pressure"] = 2e4 + 1e4 * np.random.default_rng(3).normal(size=len(WET.points))
WET.point_data["effective_stress"] = WET.point_data["stress"].copy()
WET.point_data["effective_stress"][:, [0, 4]] += WET.point_data["pore_pressure"][:, None]


def expected() -> dict[str, tuple[str, str, np.ndarray]]:
    """Title, label and values of each map, written out."""
    data = WET.point_data
    xx, yy, xy = (data["stress"][:, place] for place in (0, 4, 1))
    p, q = -(xx + yy) / 2, np.sqrt(((xx - yy) / 2) ** 2 + xy**2)
    fabric = np.sqrt(data["fabric_anisotropy"][:, 0] ** 2 + data["fabric_anisotropy"][:, 1] ** 2)
    change = data["coordination"] - FIRST.point_data["coordination"]
    u = data["displacement"] * 1e6
    return {
        "coordination": ("Coordination number", "coordination number $z$ [-]", data["coordination"]),
        "coordination_change": ("Change of coordination", "$z - z(0)$ [-]", change),
        "fabric_anisotropy": ("Fabric and its direction", "fabric anisotropy $a_c$ [-]", fabric),
        "mean_pressure": ("Mean pressure", "mean pressure $p$ [kPa]", p / 1e3),
        "stress_ratio": ("Stress ratio", "stress ratio $q/p$ [-]", q / (p - data["pore_pressure"])),
        "stress_xx": ("Stress xx", r"$\sigma_{xx}$ [kPa]", xx / 1e3),
        "stress_yy": ("Stress yy", r"$\sigma_{yy}$ [kPa]", yy / 1e3),
        "stress_xy": ("Shear stress xy", r"$\sigma_{xy}$ [kPa]", xy / 1e3),
        "pore_pressure": ("Pore pressure", "pore pressure $u$ [kPa]", data["pore_pressure"] / 1e3),
        "displacement_x": ("Displacement x", r"$u_x$ [$10^{-6}$ m]", u[:, 0]),
        "displacement_y": ("Displacement y", r"$u_y$ [$10^{-6}$ m]", u[:, 1]),
    }


def cloud() -> Any:
    """Four points, one in each quarter, with known fabric."""
    points = np.array([[0.25, 0.5, 0], [0.75, 0.5, 0], [0.25, 1.5, 0], [0.75, 1.5, 0]])
    fabric = np.array([[0.2, 0.0, 0], [-0.2, 0.0, 0], [0.0, 0.1, 0], [0.0, -0.1, 0]])
    return SimpleNamespace(points=points, point_data={"fabric_anisotropy": fabric})


def drawn_map(name: str, last: Any, first: Any, points: Any, pictures: dict[str, Any]) -> tuple[Any, Any]:
    """Axes of the map and of its colour bar."""
    with picture(Path(f"{name}.png"), 4.0, 6.0) as figure:
        axes = figure.add_subplot()
        draw_map(figure, axes, name, last, first, points)
    bar = next(one for one in pictures[f"{name}.png"].axes + axes.child_axes if one is not axes)
    return axes, bar


def shading(axes: Any) -> Any:
    return next(one for one in axes.collections if type(one).__name__ == "TriMesh")


def test_every_map_is_tested() -> None:
    assert set(MAPS) == set(expected())


@pytest.mark.parametrize("name", MAPS)
def test_values_units_and_colour_bar_of_a_map(name: str, pictures: dict[str, Any]) -> None:
    title, label, values = expected()[name]
    axes, bar = drawn_map(name, WET, FIRST, cloud(), pictures)
    assert words(axes) == (title, "x [m]", "y [m]")
    assert bar.get_ylabel() == label
    coloured = shading(axes)
    np.testing.assert_allclose(coloured.get_array(), values, rtol=1e-12)
    triangulation = coloured._triangulation
    np.testing.assert_allclose(triangulation.x, LAST.points[:, 0])
    np.testing.assert_allclose(triangulation.y, LAST.points[:, 1])
    # colours end where half a per cent of the nodes lies beyond on either side; of both signs they are centred on zero
    low, high = np.quantile(values, [0.005, 0.995])
    reach = max(abs(low), abs(high))
    signed = name in ("stress_xy", "displacement_x", "displacement_y") or min(-low, high) > 0.02 * reach
    np.testing.assert_allclose(coloured.get_clim(), (-reach, reach) if signed else (low, high), rtol=1e-12)
    assert (coloured.get_cmap().name == "RdBu_r") == signed
    np.testing.assert_allclose(bar.get_ylim(), (low, high), rtol=1e-12)


def test_without_pore_fluid_the_stress_ratio_is_that_of_the_stress(pictures: dict[str, Any]) -> None:
    stress = LAST.point_data["stress"]
    q = np.hypot((stress[:, 0] - stress[:, 4]) / 2, stress[:, 1])
    axes, _ = drawn_map("stress_ratio", LAST, FIRST, cloud(), pictures)
    np.testing.assert_allclose(shading(axes).get_array(), -2 * q / (stress[:, 0] + stress[:, 4]), rtol=1e-12)
    axes, _ = drawn_map("pore_pressure", LAST, FIRST, cloud(), pictures)
    assert not np.asarray(shading(axes).get_array()).any()


def test_a_homogeneous_field_has_one_colour_and_no_contours(pictures: dict[str, Any]) -> None:
    same = mesh(1)
    same.point_data["coordination"] = np.full(36, 4.0)
    axes, _ = drawn_map("coordination", same, same, cloud(), pictures)
    assert shading(axes).get_clim() == pytest.approx((3.98, 4.02))
    assert len(axes.collections) == 1


def test_short_lines_lie_along_most_contacts(pictures: dict[str, Any]) -> None:
    """Angle half of that in the double-angle plane, length in proportion to the anisotropy."""
    axes, _ = drawn_map("fabric_anisotropy", LAST, FIRST, cloud(), pictures)
    lines = [one for one in axes.collections if type(one) is LineCollection]
    assert len(lines) == 2  # a white one on a black one
    for found in lines:
        segments = np.array(found.get_segments())
        middle, along = segments.mean(axis=1), segments[:, 1] - segments[:, 0]
        order = np.lexsort(np.round(middle.T, 6))
        middle, along = middle[order], along[order]
        np.testing.assert_allclose(middle, [[0.25, 0.5], [0.75, 0.5], [0.25, 1.5], [0.75, 1.5]], atol=1e-12)
        angle = np.degrees(np.arctan2(along[:, 1], along[:, 0])) % 180
        np.testing.assert_allclose(angle, [0, 90, 45, 135], atol=1e-9)
        length = np.hypot(*along.T)
        np.testing.assert_allclose(length[2:] / length[:2], 0.5, rtol=1e-9)


def test_points_of_one_square_of_the_raster_are_averaged(pictures: dict[str, Any]) -> None:
    points = SimpleNamespace(
        points=np.array([[0.0, 0.0, 0], [0.001, 0.0, 0], [1.0, 2.0, 0]]),
        point_data={"fabric_anisotropy": np.array([[0.2, 0.0, 0], [-0.1, 0.0, 0], [0.0, 0.1, 0]])},
    )
    axes, _ = drawn_map("fabric_anisotropy", LAST, FIRST, points, pictures)
    segments = np.array(next(one for one in axes.collections if type(one) is LineCollection).get_segments())
    middle = segments.mean(axis=1)
    np.testing.assert_allclose(middle[np.argsort(middle[:, 0])], [[0.0005, 0.0], [1.0, 2.0]], atol=1e-12)
    length = np.hypot(*(segments[:, 1] - segments[:, 0]).T)[np.argsort(middle[:, 0])]
    assert length[0] / length[1] == pytest.approx(0.05 / 0.1)


def test_maps_that_are_chosen_for_a_run() -> None:
    """What the scene names; else the network where it varies, else the stress."""
    assert chosen_maps(["stress_xx"], LAST) == ["stress_xx"]
    assert chosen_maps([], LAST) == ["coordination", "fabric_anisotropy"]
    still = mesh(1)
    still.point_data["coordination"], still.point_data["fabric_anisotropy"] = np.full(36, 4.0), np.zeros((36, 3))
    assert chosen_maps([], still) == ["mean_pressure", "stress_ratio"]
    still.point_data["fabric_anisotropy"] = np.full((36, 3), 0.1)
    assert chosen_maps([], still) == ["coordination", "fabric_anisotropy"]
    assert is_wide(mesh(1, 1.0, 1.0)) and not is_wide(mesh(1, 0.7, 1.0))


@pytest.mark.parametrize("width", [1.0, 4.0])
def test_maps_of_a_run_are_of_its_last_step_and_its_change_from_the_first(
    width: float, pictures: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside each other or above each other; the files are those that the two series name first and last."""
    last, first = mesh(1, width), mesh(2, width)
    content = {"first": first, "last": last, "points": cloud()}
    monkeypatch.setattr(series, "last_file", lambda folder, name: Path("last" if name == "result" else "points"))
    monkeypatch.setattr(series, "first_file", lambda folder, name: Path("first"))
    monkeypatch.setattr(series, "read", lambda path: content[path.name])
    columns = {name: np.arange(3.0) + place for place, name in enumerate((
        "strain_xx", "strain_yy", "strain_xy", "p", "q", "stress_ratio_largest", "coordination",
        "coordination_smallest", "coordination_largest",
    ))}  # fmt: skip
    columns |= {"p": np.ones(3), "step": np.array([0.0, 1.0, 17.0]), "fraction": np.array([0, 0.5, 1.0])}
    table: dict[str, Any] = {**columns, "stage": np.array(["a", "a", "press"])}
    scene = {
        "title": "Made up", "stage": [{"name": "a", "displacement": [1]}],
        "output": {"maps": ["coordination_change", "displacement_y"]},
    }  # fmt: skip
    draw_field(tmp_path, table, scene)
    figure = pictures["overview.png"]
    assert heading(figure) == "Made up (step 17, stage press)"
    found = {words(axes)[0]: axes for axes in figure.axes}
    change, moved = found["Change of coordination"], found["Displacement y"]
    np.testing.assert_allclose(
        shading(change).get_array(), last.point_data["coordination"] - first.point_data["coordination"], rtol=1e-12
    )
    np.testing.assert_allclose(shading(moved).get_array(), 1e6 * last.point_data["displacement"][:, 1], rtol=1e-12)
