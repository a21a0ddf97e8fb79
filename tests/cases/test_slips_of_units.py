"""Numbers in kPa, kN/m3, MPa, percent or millimetres, and `drained` without pore fluid: told, not refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from granfabric.cases.field.initial_balance import doubtful_units
from granfabric.cases.field.prepare import prepare
from granfabric.cases.scene import magnitudes
from granfabric.cases.scene.catalogue import shipped
from granfabric.cases.scene.drainage import without_fluid
from granfabric.cases.scene.reader import LoadedScene, load

POINT = """
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
[initial]
stress = [-100e3, -100e3, 0.0]
[[path]]
control = ["stress", "stress", "strain"]
target = [-130e3, -70e3, 0.0]
increments = 3
"""
FIELD = """
[mesh]
rectangle = { width = 2.0, height = 1.0, nx = 2, ny = 2 }
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
[effects]
sliding = false
[initial]
stress = [-100e3, -100e3, 0.0]
[[stage]]
name = "initial"
increments = 1
fixed = [{ boundary = "bottom" }, { boundary = "right", components = ["y"] }]
pressure = [{ boundary = "top", value = 100e3 }, { boundary = "left", value = 100e3 }]
[[stage]]
name = "shear"
increments = 1
displacement = [{ boundary = "top", component = "x", value = 1e-5 }]
"""
WATER = "material.fluid_bulk_stiffness=2.2e9"


def loaded(folder: Path, text: str, *assignments: str) -> LoadedScene:
    (folder / "own.toml").write_text(text)
    return load(str(folder / "own.toml"), assignments)


def said(folder: Path, text: str, *assignments: str) -> list[str]:
    scene = loaded(folder, text, *assignments)
    if scene.scene.kind == "field":
        return doubtful_units(scene, prepare(scene).problem)
    stress = scene.scene.initial.stress
    return magnitudes.hints(scene, -0.5 * (stress[0] + stress[1]))


@pytest.mark.parametrize(
    ("assignment", "text"),
    [
        ("initial.stress=[-100.0, -100.0, 0.0]", "stresses are in Pa, not kPa (100 kPa is 100e3)"),
        ("material.normal_stiffness=1.0", "normal_stiffness = 1 Pa, kn/p = 1e-05 under the mean initial pressure of"),
        ("material.normal_stiffness=1000.0", "stiffnesses are in Pa, not MPa or GPa (1 GPa is 1e9)"),
        ("material.fluid_bulk_stiffness=2.2", "material.fluid_bulk_stiffness: 2.2 Pa is that of no fluid"),
        ("path.0.target=[-130.0, -70.0, 0.0]", "path 1: target: 130 Pa next to an initial pressure of 1e+05 Pa"),
        ("path.0.target=[-130e3, -70e3, 1.0]", "path 1: target: a strain of 1: strains are ratios, not percent"),
        ("initial.pore_pressure=50.0", "initial.pore_pressure: 50 Pa next to an initial pressure of 1e+05 Pa"),
    ],
)
def test_of_a_point(tmp_path: Path, assignment: str, text: str) -> None:
    assert said(tmp_path, POINT) == []
    found = said(tmp_path, POINT, assignment)
    assert len(found) == 1 and text in found[0] and found[0].startswith("warning: ")


@pytest.mark.parametrize(
    ("assignments", "text"),
    [
        (["initial.water_unit_weight=9.81", "initial.water_level=0.5", WATER],
         "initial.water_unit_weight: 9.81 N/m3: unit weights are in N/m3, not kN/m3 (water has 9810)"),
        (["initial.pore_pressure_gradient=[0.0,-9.81]", WATER], "initial.pore_pressure_gradient: -9.81 Pa/m along y"),
        (["initial.stress_gradient_y=[0.0,20.0,0.0]"], "initial.stress_gradient_y: yy rises by 20 Pa/m"),
        (["stage.0.body_force=[{value=[0.0,-20.0]}]"], 'stage 1 "initial": body_force 1: 20 N/m3: unit weights are in'),
        (["stage.0.pressure.0.value=100.0"], 'stage 1 "initial": pressure 1: 100 Pa next to an initial pressure'),
        (["stage.1.traction=[{boundary=\"top\",value=[5.0,0.0]}]"], 'stage 2 "shear": traction 1: 5 Pa next to'),
        (["stage.1.displacement.0.value=-5.0"], 'stage 2 "shear": displacement 1: -5 m on a body of 2 m: lengths are'),
        (["stage.1.rigid=[{boundary=\"top\",displacement_y=-5.0}]", "stage.1.displacement=[]"],
         'stage 2 "shear": rigid 1: 5 m on a body of 2 m'),
        (["mesh.rectangle.width=5e3", "mesh.rectangle.height=5e3"], "mesh: it is 5000 m long: coordinates are in m"),
    ],
)  # fmt: skip
def test_of_a_field(tmp_path: Path, assignments: list[str], text: str) -> None:
    assert said(tmp_path, FIELD) == []
    found = said(tmp_path, FIELD, *assignments)
    assert len(found) == 1 and text in found[0] and found[0].startswith("warning: ")


@pytest.mark.parametrize(
    "assignments",
    [
        ["stage.0.pressure.0.value=0.0"],
        ["stage.0.pressure.0.value=1e3"],
        ['stage.0.pressure.0.value="5*x"'],
        ['stage.0.body_force=[{value=[0.0,"-5*x"]}]'],
        ["stage.0.body_force=[{value=[500.0,0.0]}]"],
        ['stage.1.body_force=[{value=[0.0,-500.0],amplitude="sine"}]'],
        ["stage.1.pressure=[{boundary='top',value=100.0}]", 'stage.1.amplitude="haversine"'],
        ["initial.pore_pressure_gradient=[1.0,-9810.0]", WATER],
        ["initial.water_unit_weight=1e4", "initial.water_level=0.5", WATER],
    ],
)
def test_what_may_be_meant_is_not_told(tmp_path: Path, assignments: list[str]) -> None:
    assert said(tmp_path, FIELD, *assignments) == []


@pytest.mark.parametrize("scene", [entry.name for entry in shipped().values() if entry.kind not in ("dem", "specimen")])
def test_shipped_scenes_have_neither(scene: str) -> None:
    made = load(scene)
    assert without_fluid(made) == []
    if made.scene.kind == "field":
        assert doubtful_units(made, prepare(made).problem) == []
    else:
        stress = made.scene.initial.stress
        assert magnitudes.hints(made, -0.5 * (stress[0] + stress[1])) == []


def test_drained_without_fluid(tmp_path: Path) -> None:
    needs = (
        "there is no pore fluid; it comes with its bulk modulus, material.fluid_bulk_stiffness [Pa] (2.2e9 for water)"
    )
    assert without_fluid(loaded(tmp_path, POINT)) == without_fluid(loaded(tmp_path, FIELD)) == []
    assert without_fluid(loaded(tmp_path, POINT, "path.0.drained=true")) == [
        f"note: path 1: drained = true changes nothing: {needs}"
    ]
    assert without_fluid(loaded(tmp_path, FIELD, "stage.1.drained=false")) == [
        f'warning: stage 2 "shear": drained = false has no effect, the response is drained: {needs}'
    ]
    both = ["stage.0.drained=true", "stage.1.drained=true"]
    assert without_fluid(loaded(tmp_path, FIELD, *both)) == [
        f'note: stage 1 "initial" (and 1 more): drained = true changes nothing: {needs}'
    ]
    assert without_fluid(loaded(tmp_path, FIELD, *both, WATER)) == []
    off = "effects.pore_fluid=false"
    assert without_fluid(loaded(tmp_path, FIELD, "stage.1.drained=true", WATER, off)) == [
        f'note: stage 2 "shear": drained = true changes nothing: {off.replace("=", " = ")}'
    ]
    assert without_fluid(loaded(tmp_path, FIELD, "stage.1.drained=false", off)) == []


def test_both_commands_tell_and_a_resolved_scene_does_not(granfabric: Callable, tmp_path: Path) -> None:
    """What a run wrote out says `drained = false` of every leg; nobody asked for that."""
    (tmp_path / "own.toml").write_text(POINT)
    quiet = ("--set", "output.pictures=false")
    result = granfabric("point", tmp_path / "own.toml", "-o", tmp_path / "a", "--set", "path.0.drained=false", *quiet)
    assert result.code == 0 and "warning: path 1: drained = false has no effect" in result.out
    assert "drained = false has no effect" in (tmp_path / "a" / "run.log").read_text()
    assert "drained = false" in (tmp_path / "a" / "scene.toml").read_text()
    again = granfabric("point", tmp_path / "a" / "scene.toml", "-o", tmp_path / "b")
    assert again.code == 0 and "drained" not in again.out
