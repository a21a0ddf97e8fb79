"""`granfabric dem`: files, what ParaView reads, resumption to the last bit, the measured material in point scenes."""

from __future__ import annotations

import json
import signal
import tomllib
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from drawn import curves, legend, same
from matplotlib.figure import Figure
from vtk.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

from granfabric.cases.commands import dem
from granfabric.cases.records import dem_series, files
from granfabric.cases.scene.reader import load
from granfabric.cases.terminal.screen import Screen
from granfabric.dem_ref.loading.run import HISTORY_COLUMNS
from granfabric.dem_ref.measures.contacts import contacts_of
from granfabric.dem_ref.measures.fields import contact_fields, particle_fields
from granfabric.dem_ref.sample.disks import load_sample

SMALL = ("packing.particles=300", "path.0.stress_ratio=0.15", "output.every=4")
SET = [part for text in SMALL for part in ("--set", text)]
ANISOTROPIES = ("fabric_anisotropy", "normal_force_anisotropy", "tangential_force_anisotropy")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a small biaxial test at constant mean pressure."""
    folder = tmp_path_factory.mktemp("dem")
    assert dem.run_dem(load("dem_biaxial", SMALL), folder, Screen()).outcome == "finished"
    return folder


def history(folder: Path) -> dict[str, np.ndarray]:
    return {name: np.array(values) for name, values in files.read_csv(folder / "history.csv").items()}


def record(folder: Path) -> dict:
    return json.loads((folder / "run.json").read_text())


def series(folder: Path, name: str) -> list[tuple[float, Path]]:
    entries = ElementTree.parse(folder / f"{name}.pvd").getroot().iter("DataSet")
    return [(float(entry.attrib["timestep"]), folder / entry.attrib["file"]) for entry in entries]


def grid(file: Path):
    """A `.vtu` as ParaView reads it."""
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(file))
    reader.Update()
    return reader.GetOutput()


def arrays(data) -> dict[str, np.ndarray]:
    return {data.GetArrayName(place): vtk_to_numpy(data.GetArray(place)) for place in range(data.GetNumberOfArrays())}


def test_files_and_columns(finished: Path, is_drawn: Callable) -> None:
    names = {file.name for file in finished.iterdir() if file.suffix != ".vtu"}
    pictures = {"overview.png", "packing.png", "distributions.png"}
    assert names == pictures | {
        *("history.csv", "run.json", "run.log", "scene.toml", "material.toml", "packing.npz", "checkpoint.npz"),
        *("particles.pvd", "contacts.pvd"),
    }
    assert all(is_drawn(finished / name) for name in pictures)
    columns = history(finished)
    assert tuple(columns) == HISTORY_COLUMNS
    told = record(finished)
    assert told["outcome"] == "finished" and told["packing"]["particles"] == 300
    assert told["packing"]["coordination"] == columns["coordination"][0]
    assert {"packing", "measuring", "loading"} <= set(told["timing"])


def test_loading_goes_where_the_scene_says(finished: Path) -> None:
    columns = history(finished)
    ratio = columns["q"] / columns["p"]
    assert ratio[-1] == pytest.approx(0.15, abs=0.005)
    # the servo waits when the stress is more than 5e-3 p off its path
    assert np.abs(columns["p"] / columns["p"][0] - 1).max() < 5e-3
    assert columns["strain_yy"][-1] < columns["strain_xx"][-1]


def test_series_name_every_fourth_record_and_the_last(finished: Path) -> None:
    last = len(history(finished)["step"]) - 1
    wanted = sorted({*range(0, last + 1, 4), last})
    for name in ("particles", "contacts"):
        entries = series(finished, name)
        assert [time for time, _ in entries] == wanted
        assert {file for _, file in entries} == set(finished.glob(f"{name}_*.vtu"))


def test_particles_read_back_by_vtk(finished: Path) -> None:
    sample = load_sample(finished / "packing.npz")
    first, last = (grid(series(finished, "particles")[place][1]) for place in (0, -1))
    assert first.GetNumberOfPoints() == first.GetNumberOfCells() == 300
    fields = arrays(first.GetPointData())
    np.testing.assert_array_equal(fields["radius"], sample.radius)
    assert fields["displacement"].shape == (300, 3) and not fields["displacement"].any()
    assert 2 * grid(series(finished, "contacts")[0][1]).GetNumberOfCells() == fields["contacts"].sum()
    moved = arrays(last.GetPointData())["displacement"]
    assert moved[:, :2].any() and not moved[:, 2].any()


def test_contact_lines_carry_the_stress(finished: Path) -> None:
    """The forces and branches in the file give the stress of the history, sum of f l over the area."""
    sample = load_sample(finished / "packing.npz")
    columns = history(finished)
    for time, file in (series(finished, "contacts")[0], series(finished, "contacts")[-1]):
        lines = grid(file)
        points = vtk_to_numpy(lines.GetPoints().GetData())
        forces = arrays(lines.GetCellData())
        assert points.shape == (2 * lines.GetNumberOfCells(), 3) and not points[:, 2].any()
        np.testing.assert_array_equal(arrays(lines.GetPointData())["normal_force"][::2], forces["normal_force"])
        branch = points[1::2, :2] - points[::2, :2]
        normal = branch / np.linalg.norm(branch, axis=1)[:, None]
        across = np.column_stack([-normal[:, 1], normal[:, 0]])
        force = forces["normal_force"][:, None] * normal + forces["tangential_force"][:, None] * across
        row = int(time)
        # strains of 1e-4 change the area by their sum, to second order
        area = sample.area * np.exp(columns["strain_xx"][row] + columns["strain_yy"][row])
        stress = -force.T @ branch / area
        recorded = [columns[f"stress_{name}"][row] for name in ("xx", "yy")]
        np.testing.assert_allclose(np.diag(stress), recorded, rtol=1e-6)


def test_displacements_of_particles_that_leave_the_cell(finished: Path) -> None:
    """Points are shown within the cell; how far a particle has gone counts from where it was."""
    sample = load_sample(finished / "packing.npz")
    moved = sample.copy()
    shift = sample.cell[0] + 0.25 * sample.cell[1]
    moved.position = sample.position + shift
    mesh = dem_series.particle_mesh(moved, sample.position)
    np.testing.assert_allclose(mesh.point_data["displacement"][:, :2], np.tile(shift, (sample.count, 1)))
    assert not mesh.point_data["displacement"][:, 2].any()
    inside = mesh.points[:, :2] @ np.linalg.inv(sample.cell)
    assert inside.min() >= 0.0 and inside.max() <= 1.0


class Interrupting(dem_series.DemSeries):
    """Ctrl-C, once, when the sixth record is written."""

    sent = False

    def add(self, record: int, *arguments: object, **options: object) -> None:
        super().add(record, *arguments, **options)  # type: ignore[arg-type]
        if record == 5 and not self.sent:
            self.sent = True
            signal.raise_signal(signal.SIGINT)


def test_an_interrupted_run_resumes_to_the_same_bits(
    finished: Path, granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    undrawn = ("--set", "output.pictures=false")
    with monkeypatch.context() as patch:
        patch.setattr(dem, "DemSeries", Interrupting)
        result = granfabric("dem", "dem_biaxial", *SET, *undrawn, "-o", tmp_path)
    assert result.code == 1 and "--resume" in result.out
    assert record(tmp_path)["outcome"] == "stopped"
    assert len(history(tmp_path)["step"]) == 6
    result = granfabric("dem", "dem_biaxial", *SET, *undrawn, "-o", tmp_path, "--resume")
    assert result.code == 0, result.err
    assert record(tmp_path)["outcome"] == "finished"
    compared = [file.name for file in finished.iterdir() if file.suffix in (".csv", ".vtu", ".pvd")]
    assert len(compared) > 8
    compared.append("material.toml")
    for name in compared:
        assert (tmp_path / name).read_bytes() == (finished / name).read_bytes(), name
    # nothing is left to do: the same once more
    spent = record(tmp_path)["timing"]
    assert granfabric("dem", "dem_biaxial", *SET, *undrawn, "-o", tmp_path, "--resume").code == 0
    assert (tmp_path / "history.csv").read_bytes() == (finished / "history.csv").read_bytes()
    told = record(tmp_path)
    assert told["timing"]["packing"] == spent["packing"] and told["million_particle_steps_a_second"] > 0.0


def test_a_stop_while_packing_keeps_a_legal_folder(
    granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pack = dem.prepare_packing

    def interrupted(*arguments: object) -> object:
        signal.raise_signal(signal.SIGINT)
        return pack(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(dem, "prepare_packing", interrupted)
    result = granfabric("dem", "dem_biaxial", *SET, "-o", tmp_path)
    assert result.code == 1 and "stopped while packing" in result.out
    assert {file.name for file in tmp_path.iterdir()} == {"run.json", "run.log", "scene.toml"}


def test_an_interruption_while_drawing_keeps_the_finished_run(
    granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(folder: Path, scene: dict) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("granfabric.cases.pictures.draw.draw", interrupted)
    arguments = (
        "--set",
        "packing.particles=100",
        "--set",
        "path.0.stress_ratio=0.02",
        "--set",
        "measure.material=false",
    )
    result = granfabric("dem", "dem_biaxial", *arguments, "-o", tmp_path)
    assert result.code == 1 and "granfabric plot" in result.err
    assert record(tmp_path)["outcome"] == "finished"
    assert not (tmp_path / "material.toml").exists()


def test_resuming_something_else_is_refused(finished: Path, granfabric: Callable, tmp_path: Path) -> None:
    before = (finished / "run.json").read_bytes()
    result = granfabric("dem", "dem_biaxial", *SET, "--set", "packing.seed=2", "-o", finished, "--resume")
    assert result.code == 2 and "another [packing]" in result.err
    assert (finished / "run.json").read_bytes() == before
    result = granfabric("dem", "dem_biaxial", *SET, "-o", tmp_path, "--resume")
    assert result.code == 2 and "no DEM run to resume" in result.err
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("command", "scene", "right"),
    [("dem", "p_constant", "point"), ("point", "dem_loop", "dem"), ("run", "dem_loop", "dem")],
)
def test_a_scene_of_another_kind_names_its_command(
    granfabric: Callable, tmp_path: Path, command: str, scene: str, right: str
) -> None:
    result = granfabric(command, scene, "-o", tmp_path / "out")
    assert result.code == 2 and f"use `granfabric {right} {scene}`" in result.err
    assert not (tmp_path / "out").exists()


def test_pictures_are_made_anew_from_the_files(
    finished: Path, granfabric: Callable, pictures: dict[str, Figure]
) -> None:
    """History, packing and last checkpoint as they lie in the folder."""
    assert granfabric("plot", finished).code == 0
    assert set(pictures) == {"overview.png", "packing.png", "distributions.png"}
    columns = history(finished)
    stress, count, *_ = pictures["overview.png"].axes
    x = 1e6 * (columns["strain_xx"] - columns["strain_yy"])
    same(curves(stress)["$q/p$"], x, columns["q"] / columns["p"])
    same(curves(count)["all particles"], x, columns["coordination"])
    same(curves(count)["without rattlers"], x, columns["coordination_without_rattlers"])
    packing = load_sample(finished / "packing.npz")
    left, right = (axes.collections[0] for axes in pictures["packing.png"].axes[:2])
    disks = particle_fields(packing)
    np.testing.assert_allclose(left.get_offsets(), disks["position"][disks["bears_force"] > 0])
    # on the right the end of the loading: the particles that ParaView shows last
    last = grid(series(finished, "particles")[-1][1])
    place = vtk_to_numpy(last.GetPoints().GetData())[:, :2]
    bearing = arrays(last.GetPointData())["bears_force"] > 0
    np.testing.assert_allclose(right.get_offsets(), place[bearing])
    label = f"DEM, {contacts_of(packing).count} contacts"
    assert label in legend(pictures["distributions.png"].axes[0])


def test_fields_for_paraview_are_what_their_names_say(finished: Path) -> None:
    """Particles and contacts of the packing, array by array."""
    sample = load_sample(finished / "packing.npz")
    particles, contacts = particle_fields(sample), contact_fields(sample)
    first = grid(series(finished, "particles")[0][1])
    found = arrays(first.GetPointData())
    assert set(found) == {"radius", "contacts", "bears_force", "pressure", "displacement"}
    for name in ("radius", "contacts", "bears_force", "pressure"):
        np.testing.assert_array_equal(found[name], particles[name])
    np.testing.assert_array_equal(vtk_to_numpy(first.GetPoints().GetData())[:, :2], particles["position"])
    lines = grid(series(finished, "contacts")[0][1])
    for data, repeat in ((lines.GetCellData(), 1), (lines.GetPointData(), 2)):
        found = arrays(data)
        assert set(found) == {"normal_force", "tangential_force", "mobilisation"}
        for name, values in found.items():
            np.testing.assert_array_equal(values, np.repeat(contacts[name], repeat))
    ends = vtk_to_numpy(lines.GetPoints().GetData())[:, :2]
    np.testing.assert_array_equal(ends[0::2], contacts["start"])
    np.testing.assert_array_equal(ends[1::2], contacts["end"])
    # displacements at the end belong to the strain: mean motion is affine
    last = arrays(grid(series(finished, "particles")[-1][1]).GetPointData())["displacement"]
    columns = history(finished)
    gradient = np.linalg.lstsq(np.column_stack([sample.position, np.ones(sample.count)]), last[:, :2], rcond=None)[0]
    assert gradient[0, 0] == pytest.approx(columns["strain_xx"][-1], rel=0.1)
    assert gradient[1, 1] == pytest.approx(columns["strain_yy"][-1], rel=0.1)


def test_the_measured_material_feeds_a_point_scene(finished: Path, granfabric: Callable, tmp_path: Path) -> None:
    material = finished / "material.toml"
    measured = tomllib.loads(material.read_text())
    result = granfabric(
        *("point", "p_constant", "--set", f"material_file={material}", "--set", "material.force_density_at_zero=0.5"),
        *("--set", "output.pictures=false", "-o", tmp_path),
    )
    assert result.code == 0, result.err
    used = record(tmp_path)["scene"]
    assert "material_file" not in used
    for name, value in measured["material"].items():
        # the file wins over the scene, a later --set over the file
        assert used["material"][name] == (0.5 if name == "force_density_at_zero" else value)
    for name, value in measured.get("closure", {}).items():
        assert used["closure"][name] == value
    assert history(tmp_path)["coordination"][0] == measured["material"]["coordination"]


def test_a_scene_may_name_its_material_file(finished: Path, granfabric: Callable, tmp_path: Path) -> None:
    (tmp_path / "measured.toml").write_bytes((finished / "material.toml").read_bytes())
    scene = (
        'title = "own"\nkind = "point"\nmaterial_file = "measured.toml"\n[material]\nneighbours = 5.5\n'
        '[initial]\nstress = [-1e5, -1e5, 0.0]\n[[path]]\ncontrol = ["stress", "stress", "stress"]\n'
        "target = [-9e4, -11e4, 0.0]\nincrements = 2\n[output]\npictures = false\n"
    )
    (tmp_path / "own.toml").write_text(scene)
    assert granfabric("point", tmp_path / "own.toml", "-o", tmp_path / "out").code == 0
    used = record(tmp_path / "out")["scene"]["material"]
    assert used["neighbours"] == 5.5  # the scene's own keys stay
    assert used["solid_fraction"] == load_sample(finished / "packing.npz").solid_fraction


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("[material]\ncordination = 4.0", ["'material.cordination' is unknown", "'coordination'"]),
        ("[material]\ncoordination = 9.0", ["material.coordination = 9.0", "[0.001, 6]"]),
        ("[materail]\ncoordination = 4.0", ["'materail' is unknown", "'material'"]),
        ("[closure]", ["[material] is missing"]),
        ("material = 3", ["material = 3 is not a table"]),
    ],
)
def test_a_bad_material_file_is_named(tmp_path: Path, granfabric: Callable, text: str, parts: list[str]) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(text)
    result = granfabric("point", "p_constant", "--set", f"material_file={file}", "-o", tmp_path / "out")
    assert result.code == 2 and result.err.startswith(f"granfabric: {file}: ") and result.err.count("\n") == 1
    assert all(part in result.err for part in parts)
    assert granfabric("point", "p_constant", "--set", f"material_file={tmp_path / 'none.toml'}").code == 2
