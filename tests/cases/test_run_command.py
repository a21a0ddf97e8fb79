"""`granfabric run`: files, history, agreement with the point driver, bad input, interruption, failure."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
from drawn import curves
from matplotlib.figure import Figure
from mutations import one_sentence

from granfabric.cases.records import files, series
from granfabric.cases.terminal.screen import Screen

SMOOTH = """
title = "Smooth biaxial compression"
kind = "field"
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
bulk_reduction = 0.88
shear_reduction = 0.69
[mesh]
rectangle = { width = 0.05, height = 0.1, nx = 2, ny = 4 }
element = "P2"
[initial]
stress = [-100e3, -100e3, 0.0]
[[stage]]
name = "initial"
increments = 1
fixed = [
    { boundary = "bottom", components = ["y"] },
    { boundary = "top", components = ["y"] },
]
fixed_point = [{ point = [0.0, 0.0], components = ["x"] }]
pressure = [{ boundary = "left", value = 100e3 }, { boundary = "right", value = 100e3 }]
[[stage]]
name = "compression"
increments = 4
displacement = [{ boundary = "top", component = "y", value = -6e-6 }]
[output]
pictures = false
"""

POINT = """
title = "The same at one point"
kind = "point"
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
bulk_reduction = 0.88
shear_reduction = 0.69
[initial]
stress = [-100e3, -100e3, 0.0]
[output]
pictures = false
"""


@pytest.fixture
def smooth(tmp_path: Path) -> Path:
    file = tmp_path / "smooth.toml"
    file.write_text(SMOOTH)
    return file


def history(folder: Path) -> dict[str, np.ndarray]:
    return {name: np.array(values) for name, values in files.read_csv(folder / "history.csv").items()}


def record(folder: Path) -> dict:
    return json.loads((folder / "run.json").read_text())


def test_files_of_a_run(granfabric: Callable, smooth: Path, tmp_path: Path, is_drawn: Callable) -> None:
    out = tmp_path / "out"
    result = granfabric("run", smooth, "-o", out, "--set", "output.pictures=true")
    assert result.code == 0, result.err
    steps = [f"{kind}_{step:04d}.vtu" for kind in ("result", "points") for step in range(6)]
    fixed = ["history.csv", "run.json", "scene.toml", "result.pvd", "points.pvd", "overview.png", "mesh_error.vtu"]
    fixed.append("run.log")
    assert {file.name for file in out.iterdir()} == {*steps, *fixed}
    data = record(out)
    assert data["outcome"] == "finished"
    assert data["size"] == {"elements": 16, "degrees_of_freedom": 90, "integration_points": 48}
    assert {"compilation", "law", "assembly", "factorise", "solve", "output", "total"} <= set(data["timing"])
    assert data["counters"]["steps"] == 5
    assert is_drawn(out / "overview.png")


def test_the_picture_of_a_run_is_made_again_from_its_files(
    granfabric: Callable, smooth: Path, tmp_path: Path, pictures: dict[str, Figure]
) -> None:
    """Curves of the history, maps of the files that the series name last: other files, another picture."""
    out = tmp_path / "out"
    maps = ("--set", 'output.maps=["displacement_y"]')
    assert granfabric("run", smooth, "-o", out, "--set", "output.pictures=true", *maps).code == 0
    pictures.clear()
    assert granfabric("plot", out).code == 0
    above, below, moved, *_ = pictures["overview.png"].axes
    columns = history(out)
    np.testing.assert_allclose(curves(above)["of the mean stress"][1], columns["q"] / columns["p"], rtol=1e-14)
    np.testing.assert_allclose(curves(below)["mean"][1], columns["coordination"], rtol=1e-14)

    def shown() -> np.ndarray:
        return np.asarray(pictures["overview.png"].axes[2].collections[0].get_array())

    last = meshio.read(out / "result_0005.vtu")
    np.testing.assert_allclose(shown(), 1e6 * last.point_data["displacement"][:, 1], rtol=1e-14)
    assert shown().min() == pytest.approx(-6.0) and moved.get_title("left") == "Displacement y"
    # a run that had got no further
    for name in ("result", "points"):
        series_file = out / f"{name}.pvd"
        lines = [line for line in series_file.read_text().splitlines() if "_0005" not in line]
        series_file.write_text("\n".join(lines) + "\n")
    assert granfabric("plot", out).code == 0
    assert shown().min() == pytest.approx(-4.5)


def test_history_of_a_run(granfabric: Callable, smooth: Path, tmp_path: Path) -> None:
    assert granfabric("run", smooth, "-o", tmp_path / "out").code == 0
    columns = history(tmp_path / "out")
    assert columns["stage"].tolist() == ["initial"] * 2 + ["compression"] * 4
    np.testing.assert_allclose(columns["fraction"], [0, 1, 0.25, 0.5, 0.75, 1], rtol=1e-14)
    np.testing.assert_allclose(columns["displacement_top_y"], [0, 0, -1.5e-6, -3e-6, -4.5e-6, -6e-6], rtol=1e-13)
    # Mean strain by Gauss's theorem, and the reaction over the width, belong to the prescribed displacement.
    np.testing.assert_allclose(columns["strain_yy"], columns["displacement_top_y"] / 0.1, rtol=1e-10, atol=1e-20)
    np.testing.assert_allclose(columns["reaction_top_y"] / 0.05, columns["stress_yy"], rtol=1e-7)
    np.testing.assert_allclose(columns["reaction_bottom_y"], -columns["reaction_top_y"], rtol=1e-7)
    assert "reaction_left_x" not in columns and "displacement_left_x" in columns
    np.testing.assert_allclose(columns["stress_xx"], -100e3, rtol=1e-7)


def test_a_homogeneous_run_equals_the_point_driver(granfabric: Callable, smooth: Path, tmp_path: Path) -> None:
    assert granfabric("run", smooth, "-o", tmp_path / "run").code == 0
    run = history(tmp_path / "run")
    # The point takes the strain increments of the run, one by one.
    legs = [
        f'[[path]]\ncontrol = ["strain", "strain", "strain"]\ntarget = [{xx!r}, {yy!r}, {xy!r}]\nincrements = 1\n'
        for xx, yy, xy in zip(*(run[f"strain_{part}"][2:].tolist() for part in ("xx", "yy", "xy")))
    ]
    point = tmp_path / "point.toml"
    point.write_text(POINT + "".join(legs))
    assert granfabric("point", point, "-o", tmp_path / "point").code == 0
    single = history(tmp_path / "point")
    for name in ("stress_xx", "stress_yy", "p", "q", "coordination"):
        np.testing.assert_allclose(run[name][1:], single[name], rtol=1e-10, atol=1e-5, err_msg=name)
    np.testing.assert_allclose(run["fabric_anisotropy"][1:], np.abs(single["fabric_anisotropy"]), atol=1e-10)
    for name in ("coordination_smallest", "coordination_largest"):
        np.testing.assert_allclose(run[name], run["coordination"], rtol=1e-10)


def test_fields_are_written_as_often_as_asked_and_at_the_end(
    granfabric: Callable, smooth: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert granfabric("run", smooth, "-o", out, "--set", "output.every=3").code == 0
    for name in ("result", "points"):
        entries = list(ElementTree.parse(out / f"{name}.pvd").getroot().iter("DataSet"))
        assert [entry.attrib["file"] for entry in entries] == [f"{name}_{step:04d}.vtu" for step in (0, 3, 5)]
        assert [float(entry.attrib["timestep"]) for entry in entries] == pytest.approx([0.0, 1.5, 2.0])
        assert series.last_file(out, name) == out / f"{name}_0005.vtu"
    mesh = meshio.read(out / "result_0005.vtu")
    area = 0.0
    for corners in series.triangles(mesh):
        (ax, ay), (bx, by), (cx, cy) = mesh.points[corners, :2]
        area += 0.5 * abs((bx - ax) * (cy - ay) - (cx - ax) * (by - ay))
    assert area == pytest.approx(0.05 * 0.1, rel=1e-12)


def test_quadrilaterals_are_drawn_whole(granfabric: Callable, smooth: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    quads = ("--set", "mesh.rectangle.cell=quad", "--set", "mesh.element=Q2")
    assert granfabric("run", smooth, "-o", out, *quads).code == 0
    mesh = meshio.read(out / "result_0005.vtu")
    points = mesh.points[series.triangles(mesh)][:, :, :2]
    sides = points[:, 1:] - points[:, :1]
    areas = 0.5 * (sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    assert (areas > 0).all() and areas.sum() == pytest.approx(0.05 * 0.1, rel=1e-12)


def test_two_materials_fill_their_regions(granfabric: Callable, tmp_path: Path) -> None:
    folder = tmp_path / "two"
    folder.mkdir()
    points = np.array([[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1]], dtype=float)
    triangles = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]])
    lines = {"bottom": [[0, 1], [1, 2]], "top": [[3, 4], [4, 5]], "left": [[0, 3]], "right": [[2, 5]]}
    _write_msh(folder / "two.msh", points, triangles, [5, 5, 6, 6], lines, {5: "weak", 6: "strong"})
    base = SMOOTH.replace("rectangle = { width = 0.05, height = 0.1, nx = 2, ny = 4 }", 'file = "two.msh"')
    weak = base[base.index("[material]") : base.index("[mesh]")]
    materials = weak.replace("[material]", '[materials.soft]\nregion = "weak"').replace("1e9", "0.5e9")
    materials += weak.replace("[material]", '[materials.stiff]\nregion = "strong"')
    scene = folder / "two.toml"
    scene.write_text(base.replace(weak, materials))
    result = granfabric("run", scene, "-o", tmp_path / "out")
    assert result.code == 0, result.err
    cloud = meshio.read(tmp_path / "out" / "points_0005.vtu")
    left = cloud.points[:, 0] < 1
    stress = cloud.point_data["stress"][:, 4]
    # Both halves are shortened alike, so that the soft one carries half of the increment.
    assert stress[left].mean() + 100e3 == pytest.approx((stress[~left].mean() + 100e3) / 2, rel=0.1)
    bad = scene.read_text().replace('region = "strong"', 'region = "strange"')
    (folder / "bad.toml").write_text(bad)
    result = granfabric("run", folder / "bad.toml", "-o", tmp_path / "bad")
    assert result.code == 2 and "materials.stiff.region" in result.err and "nearest is 'strong'" in result.err
    overlap = scene.read_text().replace('region = "strong"', 'region = "weak"')
    (folder / "bad.toml").write_text(overlap)
    result = granfabric("run", folder / "bad.toml", "-o", tmp_path / "bad")
    assert result.code == 2 and "'soft' and 'stiff' share elements" in result.err


def _write_msh(path: Path, points: np.ndarray, triangles: np.ndarray, tags: list, lines: dict, regions: dict) -> None:
    """Gmsh file of version 2.2 by hand."""
    names = [f'1 {place + 1} "{name}"' for place, name in enumerate(lines)]
    names += [f'2 {tag} "{name}"' for tag, name in regions.items()]
    elements = [
        f"1 2 {place + 1} {place + 1} {a + 1} {b + 1}" for place, pairs in enumerate(lines.values()) for a, b in pairs
    ]
    elements += [f"2 2 {tag} {tag} {a + 1} {b + 1} {c + 1}" for tag, (a, b, c) in zip(tags, triangles)]
    text = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(names)), *names, "$EndPhysicalNames"]
    text += ["$Nodes", str(len(points)), *(f"{n + 1} {x} {y} 0" for n, (x, y) in enumerate(points)), "$EndNodes"]
    text += ["$Elements", str(len(elements)), *(f"{n + 1} {line}" for n, line in enumerate(elements)), "$EndElements"]
    path.write_text("\n".join(text) + "\n")


BAD = [
    (
        'stage.1.displacement=[{boundary="tpo", component="y", value=0.0}]',
        ['stage 2 "compression": displacement 1: the boundary', "'top'"],
    ),
    (
        'stage.0.pressure=[{boundary="lft", value=1.0}]',
        ['stage 1 "initial": pressure 1: the boundary', "'lft'", "nearest is 'left'"],
    ),
    ('stage.1.body_force=[{value=[0.0, -1.0], region="al"}]', ["region 'al' is unknown", "nearest is 'all'"]),
    ("stage.1.name=initial", ["stage", "initial"]),
    ('mesh={file="nowhere.msh"}', ["mesh.file", "nowhere.msh"]),
    ('mesh={file="smooth.toml"}', ["mesh.file", "smooth.toml"]),
    ("kind=point", ["is unknown", "'mesh'"]),
]


@pytest.mark.parametrize(("assignment", "parts"), BAD, ids=[bad[0][:30] for bad in BAD])
def test_bad_input_gives_code_2_one_sentence_and_no_files(
    granfabric: Callable, smooth: Path, tmp_path: Path, assignment: str, parts: list[str]
) -> None:
    result = granfabric("run", smooth, "-o", tmp_path / "out", "--set", assignment)
    assert result.code == 2
    assert one_sentence(result.err)
    for part in parts:
        assert part in result.err
    assert not (tmp_path / "out").exists()


def test_a_point_scene_is_referred_to_its_command(granfabric: Callable, tmp_path: Path) -> None:
    result = granfabric("run", "p_constant", "-o", tmp_path / "out")
    assert result.code == 2 and "granfabric point" in result.err


@contextmanager
def _interrupting(text: str) -> Iterator[Callable[[float, str], None]]:
    def advance(completed: float, said: str) -> None:
        if text in said:
            signal.raise_signal(signal.SIGINT)

    yield advance


def test_interruption_leaves_what_was_computed(
    granfabric: Callable, smooth: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Screen, "progress", lambda self, what, total: _interrupting("step 3"))
    out = tmp_path / "out"
    # without the feedback there would be no step 3: steps between results are passed over
    settings = ["output.every=2", "output.pictures=true", "effects.stiffness_feedback=true"]
    result = granfabric("run", smooth, "-o", out, *(word for text in settings for word in ("--set", text)))
    assert result.code == 1 and "stopping after this step" in result.out
    data = record(out)
    assert data["outcome"] == "stopped"
    assert data["reached"]["stage"] == "compression" and data["reached"]["fraction"] == pytest.approx(0.5)
    assert history(out)["step"].tolist() == [0, 1, 2, 3]
    assert series.last_file(out, "result") == out / "result_0003.vtu"
    assert (out / "overview.png").is_file()


def test_a_full_disk_ends_the_run_with_code_1_and_whole_files(
    granfabric: Callable, smooth: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = files.write_text

    def full(path: Path, text: str) -> None:
        if path.name == "history.csv" and text.count("\n") > 3:
            raise OSError(28, "No space left on device")
        write(path, text)

    monkeypatch.setattr(files, "write_text", full)
    out = tmp_path / "out"
    result = granfabric("run", smooth, "-o", out)
    assert result.code == 1 and "No space left on device" in result.err
    assert record(out)["outcome"] == "stopped"
    assert history(out)["step"].tolist() == [0, 1]


def test_a_run_that_cannot_go_on_says_why_and_leaves_the_point_that_failed(
    granfabric: Callable, smooth: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    # One substep cannot meet this tolerance, and steps may not become small enough that it could.
    # The shifted distribution, without feedback, has no rates in which an error could be made.
    impossible = ["closure.force_change=mean_field", "integration.maximum_substeps=1", "integration.tolerance=1e-14"]
    impossible += ["solver.smallest_factor=0.5"]
    result = granfabric("run", smooth, "-o", out, *(part for text in impossible for part in ("--set", text)))
    assert result.code == 1
    data = record(out)
    assert data["outcome"] == "failed" and data["message"] and data["message"] in " ".join(result.out.split())
    assert history(out)["stage"].tolist() == ["initial", "initial"]
    replayed = granfabric("point", out / "failed_point.toml", "-o", tmp_path / "replay")
    assert replayed.code == 1
    assert record(tmp_path / "replay")["outcome"] == "failed"
    assert "substeps" in record(tmp_path / "replay")["message"]


@pytest.mark.slow
def test_the_shipped_biaxial_scene(granfabric: Callable, tmp_path: Path, is_drawn: Callable) -> None:
    result = granfabric("run", "biaxial", "-o", tmp_path)
    assert result.code == 0, result.err
    columns = history(tmp_path)
    # As the scene tells; effects that are left out change it by less than their tolerance.
    assert columns["q"][-1] / columns["p"][-1] == pytest.approx(0.270, abs=5e-4)
    assert columns["stress_ratio_largest"][-1] == pytest.approx(0.318, abs=5e-4)
    for name, value in (("", 3.9415), ("_smallest", 3.9215), ("_largest", 4.000)):
        assert columns[f"coordination{name}"][-1] == pytest.approx(value, abs=5e-4)
    assert columns["fabric_anisotropy"][-1] == pytest.approx(0.055, abs=5e-4)
    # Equilibrium of the specimen: what the upper platen presses, the lower one carries.
    np.testing.assert_allclose(columns["reaction_top_y"], -columns["reaction_bottom_y"], rtol=1e-6)
    assert is_drawn(tmp_path / "overview.png")
    data = record(tmp_path)
    assert data["counters"]["factorisations"] <= 2 * data["counters"]["steps"]
