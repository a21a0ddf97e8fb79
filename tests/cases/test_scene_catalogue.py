"""The catalogue as a user meets it: listed, copied, run from the copy, drawn, opened by VTK."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from vtk import vtkXMLUnstructuredGridReader
from vtk.util.numpy_support import vtk_to_numpy

from granfabric.cases.records import series
from granfabric.cases.scene.catalogue import HOME, shipped
from granfabric.cases.scene.reader import load

FIELDS = [name for name, entry in shipped().items() if entry.kind == "field"]
GMSH = [name for name in FIELDS if load(name).scene.mesh.file is not None]


def opened(file: Path):
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(file))
    reader.Update()
    return reader.GetOutput()


def test_scenes_are_listed_in_groups(granfabric: Callable) -> None:
    lines = granfabric("scenes").out.splitlines()
    for name in FIELDS:
        (line,) = [line for line in lines if line.split()[:1] == [name]]
        assert line.strip().endswith(load(name).scene.title)
    assert {load(name).scene.group for name in FIELDS} <= {line.strip() for line in lines}
    assert "Question:" in granfabric("scenes", "strip_footing").out


@pytest.mark.parametrize("name", GMSH)
def test_meshes_come_with_their_geometry(name: str) -> None:
    mesh = load(name).scene.mesh.file
    assert (shipped()[name].file.parent / mesh).with_suffix(".geo").is_file()


def test_a_copy_runs_and_vtk_reads_it(
    granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_drawn: Callable
) -> None:
    monkeypatch.chdir(tmp_path)
    assert granfabric("scenes", "--copy", "hole_in_plate").code == 0
    coarse = [f"mesh.plate_with_hole.{key}=4" for key in ("n_radial", "n_around")]
    settings = [part for text in (*coarse, "stage.1.increments=2") for part in ("--set", text)]
    result = granfabric("run", "./hole_in_plate", "-o", "out", *settings)
    assert result.code == 0, result.err
    assert is_drawn(tmp_path / "out" / "overview.png") and is_drawn(tmp_path / "out" / "closed_form.png")
    grid = opened(series.last_file(tmp_path / "out", "result"))
    # quadratic triangles, those with a side on the hole written as four
    kinds = [grid.GetCell(number).GetCellType() for number in range(grid.GetNumberOfCells())]
    elements = vtk_to_numpy(grid.GetCellData().GetArray("element"))
    assert set(kinds) <= {5, 22} and len(np.unique(elements)) == 32
    points = vtk_to_numpy(grid.GetPoints().GetData())
    radius = np.hypot(points[:, 0], points[:, 1])
    # The hole stays a hole, its midside nodes on the circle: 4 sides of three nodes.
    assert radius.min() == pytest.approx(0.02, rel=1e-12) and np.sum(np.isclose(radius, 0.02, rtol=1e-12)) == 9
    for name in ("coordination", "fabric_anisotropy", "stress", "displacement"):
        assert grid.GetPointData().HasArray(name)
    cloud = opened(series.last_file(tmp_path / "out", "points"))
    assert cloud.GetNumberOfPoints() == 3 * 32


def test_a_mesh_of_ones_own(granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The copied Gmsh scene runs from its folder; a name that the mesh lacks is told first."""
    monkeypatch.chdir(tmp_path)
    assert granfabric("scenes", "--copy", "layered_oedometer", "-o", "mine").code == 0
    assert sorted(os.listdir("mine")) == [
        *("layered_oedometer.geo", "layered_oedometer.msh", "layered_oedometer.toml", "schema.json")
    ]
    settings = ("--set", "stage.1.increments=1", "--set", "output.pictures=false")
    wrong = granfabric("run", "mine", "-o", "out", *settings, "--set", "materials.loose.region=losse")
    assert wrong.code == 2 and "nearest is 'loose'" in wrong.err and not Path("out").exists()
    assert granfabric("run", "mine", "-o", "out", *settings).code == 0


@pytest.mark.skipif(shutil.which("gmsh") is None, reason="Gmsh is not installed")
@pytest.mark.parametrize("name", GMSH)
def test_gmsh_makes_the_shipped_mesh(name: str, tmp_path: Path) -> None:
    import subprocess

    from granfabric.fem.mesh.host_mesh import read_mesh

    source = (shipped()[name].file.parent / load(name).scene.mesh.file).with_suffix(".geo")
    made = tmp_path / f"{name}.msh"
    subprocess.run(["gmsh", "-2", "-format", "msh41", str(source), "-o", str(made)], check=True, capture_output=True)
    new, old = read_mesh(made), read_mesh(source.with_suffix(".msh"))
    assert set(new.boundaries) == set(old.boundaries) and set(new.regions) == set(old.regions)
    assert new.mesh.t.shape[1] == pytest.approx(old.mesh.t.shape[1], rel=0.1)  # versions of Gmsh differ a little


@pytest.mark.slow
@pytest.mark.parametrize("name", FIELDS)
def test_every_scene_runs_and_is_drawn(name: str, granfabric: Callable, tmp_path: Path, is_drawn: Callable) -> None:
    stages = load(name).scene.stage
    settings = [part for i, _ in enumerate(stages) for part in ("--set", f"stage.{i}.increments=3")]
    result = granfabric("run", name, "-o", tmp_path / "out", *settings)
    assert result.code == 0, result.err
    for picture in (tmp_path / "out").glob("*.png"):
        assert is_drawn(picture)
    for kind in ("result", "points"):
        fewest = 40 if name == "grains_biaxial" else 100  # a packing at each point keeps that mesh coarse
        assert opened(series.last_file(tmp_path / "out", kind)).GetNumberOfPoints() > fewest


def test_schema_directives_point_at_the_schema() -> None:
    for entry in shipped().values():
        first = entry.file.read_text().splitlines()[0]
        assert first == "#:schema ../schema.json", entry.file
        assert (entry.file.parent / "../schema.json").resolve() == HOME / "schema.json"
