"""Files that ranks write in pieces, against those that are written in one."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from ranks import command, environment, on_ranks

import granfabric as gf
from granfabric.cases.errors import InputError
from granfabric.cases.records import series

HERE = Path(__file__).parent
NAMES = ("excavation:plastic", "fill:elastic", "springs:plastic", "few_points:plastic", "tiny:plastic", "joint:contact")
SERIES = ("result", "points")
FEW = ["--set", "stage.compression.increments=4"]
SCENE = "biaxial_inclusion"


def differences(one: Any, other: Any) -> float:
    """Of two files that have the same mesh, in the same order; relative to the largest value of each field."""
    np.testing.assert_array_equal(one.points, other.points)
    assert [block.type for block in one.cells] == [block.type for block in other.cells]
    for ours, theirs in zip(one.cells, other.cells):
        np.testing.assert_array_equal(ours.data, theirs.data)
    assert one.point_data.keys() == other.point_data.keys()
    assert one.cell_data.keys() == other.cell_data.keys()
    pairs = [(one.point_data[name], other.point_data[name]) for name in one.point_data]
    pairs += [pair for name in one.cell_data for pair in zip(one.cell_data[name], other.cell_data[name])]
    largest = 0.0
    for ours, theirs in pairs:
        assert ours.dtype == theirs.dtype
        assert ours.shape == theirs.shape
        np.testing.assert_array_equal(np.isnan(ours), np.isnan(theirs))
        size = float(np.nanmax(np.abs(ours), initial=0.0)) or 1.0
        largest = max(largest, float(np.nanmax(np.abs(ours - theirs), initial=0.0)) / size)
    return largest


def read_by_vtk(file: Path) -> Any:
    vtk = pytest.importorskip("vtkmodules.vtkIOXML")
    parallel = file.suffix == ".pvtu"
    reader = (vtk.vtkXMLPUnstructuredGridReader if parallel else vtk.vtkXMLUnstructuredGridReader)()
    reader.SetFileName(str(file))
    reader.Update()
    assert reader.GetErrorCode() == 0
    return reader.GetOutput()


def rows(grid: Any, names: list[str]) -> np.ndarray:
    """Places and values of all points, by place; of points at the same place one for each of their values."""
    numpy = pytest.importorskip("vtkmodules.util.numpy_support")
    place = np.round(numpy.vtk_to_numpy(grid.GetPoints().GetData())[:, :2], 9)
    fields = [numpy.vtk_to_numpy(grid.GetPointData().GetArray(name)).reshape(len(place), -1) for name in names]
    table = np.column_stack([place, *fields])
    return table[np.lexsort(np.round(table[:, :5], 6).T[::-1])]


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [2, 3])
def test_pieces_hold_what_one_file_holds(tmp_path: Path, ranks: int) -> None:
    done = on_ranks(ranks, str(HERE / "write_pieces.py"), str(tmp_path), *NAMES, timeout=600.0)
    assert done.returncode == 0, done.stderr
    assert "told: output folder" in done.stdout
    assert "Is a directory" in done.stdout
    assert not (tmp_path / "blocked" / "points_0001.pvtu").exists()
    for name in NAMES:
        folder = tmp_path / name.replace(":", "_")
        for kind in SERIES:
            pieces, whole = (series.steps(folder / each, kind) for each in ("pieces", "whole"))
            assert list(pieces) == list(whole)
            assert {file.suffix for file in pieces.values()} == {".pvtu"}
            entries = [list(ElementTree.parse(folder / each / f"{kind}.pvd").iter("DataSet")) for each in
                       ("pieces", "whole")]  # fmt: skip
            times = [[entry.attrib["timestep"] for entry in each] for each in entries]
            assert times[0] == times[1]
            for step, file in pieces.items():
                assert differences(series.read(whole[step], ()), series.read(file, ())) < 1e-12, (name, kind, step)


@pytest.mark.slow
def test_vtk_reads_pieces(tmp_path: Path) -> None:
    numpy = pytest.importorskip("vtkmodules.util.numpy_support")
    done = on_ranks(3, str(HERE / "write_pieces.py"), str(tmp_path), "excavation:plastic", "joint:contact")
    assert done.returncode == 0, done.stderr
    size = pytest.importorskip("vtkmodules.vtkFiltersVerdict").vtkCellSizeFilter()
    for name in ("excavation_plastic", "joint_contact"):
        whole, pieces = (series.steps(tmp_path / name / each, "result") for each in ("whole", "pieces"))
        for step, file in whole.items():
            one, several = read_by_vtk(file), read_by_vtk(pieces[step])
            assert one.GetNumberOfCells() == several.GetNumberOfCells()
            areas = []
            for grid in (one, several):
                size.SetInputData(grid)
                size.Update()
                areas.append(numpy.vtk_to_numpy(size.GetOutput().GetCellData().GetArray("Area")).sum())
            assert areas[0] == pytest.approx(areas[1], rel=1e-12)
            names = ["displacement", "stress", "strain"]
            ours, theirs = rows(one, names), rows(several, names)
            # a node on the edge of a piece is in each of them, with the same values
            scale = np.abs(ours).max(axis=0) + 1e-300
            for row in theirs:
                assert np.abs((ours - row) / scale).max(axis=1).min() < 1e-9
            for row in ours:
                assert np.abs((theirs - row) / scale).max(axis=1).min() < 1e-9
        whole, pieces = (series.steps(tmp_path / name / each, "points") for each in ("whole", "pieces"))
        one, several = (rows(read_by_vtk(each[max(each)]), ["stress"]) for each in (whole, pieces))
        np.testing.assert_allclose(one, several, atol=1e-12 * np.abs(one).max())


@pytest.mark.slow
def test_a_run_that_goes_on_with_other_ranks_has_files_of_both_kinds(tmp_path: Path) -> None:
    folder, whole = tmp_path / "stopped", tmp_path / "whole"
    done = on_ranks(3, str(HERE / "stop_after.py"), SCENE, str(folder), "3")
    assert done.returncode == 1, done.stderr
    assert sorted(series.steps(folder, "result")) == [0, 1, 2, 3]
    done = on_ranks(1, "granfabric", "run", SCENE, "--host", "fenicsx", "-o", str(folder), "--resume", "-q")
    assert done.returncode == 0, done.stderr
    own = [str(Path(sys.executable).parent / "granfabric"), "run", SCENE, "-o", str(whole), "-q"]
    assert subprocess.run(own, env=environment(), check=False).returncode == 0
    for kind in SERIES:
        ours, theirs = series.steps(folder, kind), series.steps(whole, kind)
        assert list(ours) == list(theirs)
        assert [file.suffix for file in ours.values()] == [".pvtu"] * 4 + [".vtu"] * (len(ours) - 4)
        for step, file in ours.items():
            assert differences(series.read(theirs[step], ()), series.read(file, ())) < 1e-5
    results, wanted = gf.read_results(folder), gf.read_results(whole)
    np.testing.assert_array_equal(results.nodes_at(2), wanted.nodes_at(2))
    place = 0.021, 0.043
    np.testing.assert_allclose(results.at(*place, step=2)["stress_yy"], wanted.at(*place, step=2)["stress_yy"], 1e-6)
    # what is not whole any more is told
    file = series.steps(folder, "result")[2]
    file.with_name("result_0002_1.vtu").unlink()
    with pytest.raises(InputError, match=r"result_0002\.pvtu cannot be read"):
        series.read(file)
    text = file.read_text()
    file.write_text(text.replace("result_0002_1.vtu", "../result_0002_1.vtu"))
    with pytest.raises(InputError, match="it names"):
        series.read(file)
    # and a run anew leaves nothing of it behind
    done = subprocess.run([*command(1, "granfabric", "run", SCENE, "--host", "fenicsx", "-o", str(folder), "-q"), *FEW],
                          env=environment(), check=False, capture_output=True, text=True)  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert not list(folder.glob("*.pvtu"))
    assert not list(folder.glob("result_*_*.vtu"))
