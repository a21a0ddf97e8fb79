"""A series whose steps are written in pieces: read as if in one, gone on with, and removed with all its files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from granfabric.cases.errors import InputError
from granfabric.cases.records import files, series
from granfabric.constitutive.plain_laws.von_mises import VonMisesLaw, VonMisesMaterial
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.loads.kinds import Fixed, Pressure, Stage
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import HostMesh, rectangle
from granfabric.fem.mesh.shapes import quarter_ring
from granfabric.fem.output.fields import FieldWriter, Grids, Piece
from granfabric.fem.output.series_files import FIELDS, POINTS, SeriesFiles, file_name, piece_name, pieces_of
from granfabric.fem.output.vtu import write_pieces

LAW = VonMisesLaw([VonMisesMaterial(1000.0, 0.3, 1.0, 10.0), VonMisesMaterial(2000.0, 0.2, 1.5, 10.0)])
PIECES = 3


def computed(mesh: HostMesh, element: str, held: str, pushed: str) -> tuple[Problem, list[StepResult]]:
    space = Space(mesh, element)
    index = (space.points[:, 0] > space.points[:, 0].mean()).astype(np.int32)
    problem = Problem(space, LAW, [Stage("a", [Fixed(held), Pressure(pushed, 0.5)], 3)], material_index=index)
    steps: list[StepResult] = []
    assert solve(problem, on_step=steps.append).finished
    return problem, steps


def write_in_pieces(folder: Path, problem: Problem, steps: list[StepResult], seed: int = 0) -> None:
    """Cells belong to pieces at random; each is recovered with the whole around it."""
    space = problem.space
    owner = np.random.default_rng(seed).integers(0, PIECES, space.nelements)
    grids = [
        Grids(space, LAW.description, problem.material_index, "fast",
              Piece(owner == piece, np.arange(space.nelements), np.arange(space.nnodes)))
        for piece in range(PIECES)
    ]  # fmt: skip
    written = SeriesFiles(folder)
    for step in steps:
        for piece, grid in enumerate(grids):
            names = {name: piece_name(name, step.step, piece) for name in (FIELDS, POINTS)}
            described = grid.write_files(folder, names, step)
        for name in (FIELDS, POINTS):
            whole = file_name(name, step.step, ".pvtu")
            pieces = [piece_name(name, step.step, piece) for piece in range(PIECES)]
            write_pieces(folder / whole, described[name], pieces, "fast")
            written.add(name, step.fraction, whole)


MESHES = {
    "P1": (rectangle(2.0, 1.0, 6, 4), "bottom", "top"),
    "P2": (quarter_ring(1.0, 2.0, 3, 4, "triangle"), "outer", "inner"),
    "Q2": (rectangle(2.0, 1.0, 4, 3, "quad"), "bottom", "top"),
}


@pytest.mark.parametrize("element", list(MESHES))
def test_read_as_if_written_in_one(element: str, tmp_path: Path) -> None:
    problem, steps = computed(MESHES[element][0], element, *MESHES[element][1:])
    write_in_pieces(tmp_path / "pieces", problem, steps)
    writer = FieldWriter(tmp_path / "whole", problem.space, LAW.description, None, problem.material_index)
    for step in steps:
        writer.write(step, step.fraction)
    for name in (FIELDS, POINTS):
        ours, theirs = (series.steps(tmp_path / folder, name) for folder in ("whole", "pieces"))
        assert list(ours) == list(theirs) == [1, 2, 3]
        for number, file in ours.items():
            one, other = series.read(file, ()), series.read(theirs[number], ())
            np.testing.assert_array_equal(one.points, other.points)
            assert [block.type for block in one.cells] == [block.type for block in other.cells]
            for block, again in zip(one.cells, other.cells):
                np.testing.assert_array_equal(block.data, again.data)
            assert one.point_data.keys() == other.point_data.keys()
            for key, values in one.point_data.items():
                np.testing.assert_array_equal(values, other.point_data[key], err_msg=key)
            assert one.cell_data.keys() == other.cell_data.keys()
            for key, blocks in one.cell_data.items():
                for values, again in zip(blocks, other.cell_data[key]):
                    np.testing.assert_array_equal(values, again, err_msg=key)


def test_gone_on_with_and_removed(tmp_path: Path) -> None:
    problem, steps = computed(*MESHES["P1"][:1], "P1", *MESHES["P1"][1:])
    write_in_pieces(tmp_path, problem, steps)
    assert len(list(tmp_path.glob("*.vtu"))) == 2 * 3 * PIECES
    # steps after the first are computed again, now in one piece
    writer = FieldWriter(tmp_path, problem.space, LAW.description, lambda step: step <= 1, problem.material_index)
    assert sorted(file.name for file in tmp_path.glob("*.pvtu")) == ["points_0001.pvtu", "result_0001.pvtu"]
    assert len(list(tmp_path.glob("*.vtu"))) == 2 * PIECES
    writer.write(steps[1], steps[1].fraction)
    assert [file.name for file in series.steps(tmp_path, FIELDS).values()] == ["result_0001.pvtu", "result_0002.vtu"]
    # a run anew in the same folder
    files.write_json(tmp_path / files.RECORD, {"program": files.PROGRAM})
    files.prepare_output(tmp_path, overwrite=True)
    assert not [file for file in tmp_path.iterdir() if "vtu" in file.suffix or file.suffix == ".pvd"]


def test_damaged_files_are_told(tmp_path: Path) -> None:
    problem, steps = computed(*MESHES["P1"][:1], "P1", *MESHES["P1"][1:])
    write_in_pieces(tmp_path, problem, steps[:1])
    file = series.steps(tmp_path, FIELDS)[1]
    whole = file.read_text()
    assert [piece.name for piece in pieces_of(file)] == [f"result_0001_{piece}.vtu" for piece in range(PIECES)]
    for text, message in (
        (whole.replace("result_0001_1", "../result_0001_1"), "it names"),
        (whole.replace("result_0001_1", "result_0002_1"), "it names"),
        (whole.replace("result_0001_1", "result_0001_7"), "cannot be read"),
        (whole.replace("Piece Source", "Piece Sauce"), "is damaged"),
        (whole[:-40], "is damaged"),
        (whole.replace("<Piece", "<Part"), "names no pieces"),
        (whole.replace("result_0001", "points_0001"), "it names"),
    ):
        file.write_text(text)
        with pytest.raises(InputError, match=message):
            series.read(file, ())
    file.write_text(whole)
    piece = tmp_path / "result_0001_1.vtu"
    piece.write_bytes((tmp_path / "points_0001_1.vtu").read_bytes())
    with pytest.raises(InputError, match="pieces"):
        series.read(file, ())
