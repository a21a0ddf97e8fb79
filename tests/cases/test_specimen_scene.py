"""Scenes of a specimen of disks: `granfabric dem` with [specimen]."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import meshio
import numpy as np
import pytest
from PIL import Image

from granfabric.cases.commands import specimen
from granfabric.cases.records import files
from granfabric.cases.scene.reader import load
from granfabric.cases.terminal.screen import Screen
from granfabric.dem_ref.specimen.history import COLUMNS

SMALL = ("packing.particles=200", "rates.inertial_number=1e-4", "path.0.axial_strain=1e-4", "path.2.axial_strain=5e-5")
SMALL += ("rates.longest_rest=50000", "output.strain_step=2e-5", "output.every=3", "output.field_cells=3")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("specimen")
    record = specimen.run_specimen(load("dem_specimen", SMALL), folder, Screen(quiet=True))
    assert record.outcome == "finished", record.message
    return folder


def table(folder: Path) -> dict[str, np.ndarray]:
    return {name: np.array(values) for name, values in files.read_csv(folder / "history.csv").items()}


def test_it_writes_a_history_and_a_picture(finished: Path) -> None:
    h = table(finished)
    assert tuple(h) == (*COLUMNS, "leg")
    assert h["leg"].tolist() == [0, *[1] * 5, 2, *[3] * 3]
    assert h["axial_strain"][[5, -1]] == pytest.approx([1e-4, 5e-5], rel=1e-9)
    assert h["stress_ratio"][5] > 0.1 > h["stress_ratio"][0] and h["stress_ratio"][-1] < h["stress_ratio"][5]
    assert np.asarray(Image.open(finished / "overview.png")).std() > 5.0
    record = json.loads((finished / "run.json").read_text())
    assert record["kind"] == "specimen" and record["specimen"]["lateral_pressure"] == pytest.approx(1e5, rel=1e-3)


def test_series_hold_the_disks_where_they_are_and_fields_whose_sums_are_those_of_the_whole(finished: Path) -> None:
    h = table(finished)
    stored = sorted(finished.glob("fields_*.vtu"))
    assert [int(file.stem[-5:]) for file in stored] == [0, 3, 6, 9]
    assert len(list(finished.glob("particles_*.vtu"))) == len(list(finished.glob("contacts_*.vtu"))) == 4
    for file in stored:
        row = int(file.stem[-5:])
        mesh, disks = meshio.read(file), meshio.read(finished / file.name.replace("fields", "particles"))
        data = {name: values[0] for name, values in mesh.cell_data.items()}
        assert data["disks"].sum() == pytest.approx(len(disks.points), rel=1e-9)
        z = data["disks"] @ data["coordination"] / data["disks"].sum()
        assert z == pytest.approx(h["coordination"][row], rel=1e-6)
        low, high = disks.points[:, :2].min(axis=0), disks.points[:, :2].max(axis=0)
        assert low[0] < 0.0 < high[0] and low[1] >= 0.0 and high[1] <= h["height"][row]
        assert np.ptp(mesh.points[:, 1]) == pytest.approx(h["height"][row], rel=1e-9)
        assert np.ptp(mesh.points[:, 0]) == pytest.approx(h["width"][row], rel=1e-9)
    lines = meshio.read(finished / "contacts_00009.vtu")
    assert np.abs(np.diff(lines.points[lines.cells[0].data], axis=1)).max() < 2.0  # none across the whole cell


def test_a_stopped_run_goes_on_to_the_same_bits(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stop:
        requested = False

        def __call__(self) -> bool:
            return (tmp_path / "history.csv").is_file() and len(table(tmp_path)["leg"]) >= 4

    @contextmanager
    def asked(announce: Callable) -> Iterator[Stop]:
        yield Stop()

    loaded = load("dem_specimen", SMALL)
    with monkeypatch.context() as patch:
        patch.setattr(specimen, "interrupt_request", asked)
        record = specimen.run_specimen(loaded, tmp_path, Screen(quiet=True))
    assert (record.outcome, record.message) == ("stopped", "stopped; continue with --resume")
    assert specimen.run_specimen(loaded, tmp_path, Screen(quiet=True), resume=True).outcome == "finished"
    assert (tmp_path / "history.csv").read_bytes() == (finished / "history.csv").read_bytes()
    for name in ("particles", "fields"):
        assert (tmp_path / f"{name}.pvd").read_bytes() == (finished / f"{name}.pvd").read_bytes()


def test_one_that_does_not_come_to_rest_is_told(granfabric: Callable, tmp_path: Path) -> None:
    keys = [part for text in (*SMALL, "rates.longest_rest=1000") for part in ("--set", text)]
    result = granfabric("dem", "dem_specimen", *keys, "-o", tmp_path / "out")
    assert result.code == 1 and "consolidation: the specimen does not come to rest within 1000 steps" in result.out
    assert (tmp_path / "out" / "packing.npz").is_file()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('kind = "dem"\n[specimen]\n[[path]]\nloading = "rest"\n', "a scene with [specimen] is of the kind 'specimen'"),
        ('[specimen]\n[[path]]\nloading = "compression"\n', "needs axial_strain"),
        ('[specimen]\n[[path]]\nloading = "rest"\naxial_strain = 1e-3\n', "does not take axial_strain"),
        ('[specimen]\n[[path]]\nloading = "force"\naxial_stress = -1.0\n', "axial_stress"),
        ('[specimen]\n[[path]]\nloading = "isotropic"\n', "loading"),
        ('[specimen]\nplaten_friction = -1.0\n[[path]]\nloading = "rest"\n', "platen_friction"),
        ('[specimen]\nheight = 2.0\n[[path]]\nloading = "rest"\n', "height_to_width"),
        ('[specimen]\n[[path]]\nloading = "rest"\n[output]\nfield_cells = 1\n', "is no grid"),
        ('[specimen]\n[measure]\nmaterial = true\n[[path]]\nloading = "rest"\n', "[measure] belongs to 'dem'"),
    ],
)
def test_bad_scenes_are_refused_with_a_sentence(granfabric: Callable, tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(text)
    result = granfabric("dem", file, "-o", tmp_path / "out")
    assert result.code == 2 and words in result.err, result.err
    assert not (tmp_path / "out").exists()


def test_commands_of_other_scenes_name_this_one(granfabric: Callable, tmp_path: Path) -> None:
    result = granfabric("run", "dem_specimen", "-o", tmp_path / "out")
    assert result.code == 2 and "use `granfabric dem dem_specimen`" in result.err
    result = granfabric("dem", "dem_specimen", "--seeds", 2, "-o", tmp_path / "out")
    assert result.code == 2 and "granfabric sweep dem_specimen --set packing.seed=1,2,3" in result.err
    result = granfabric("dem", "dem_specimen", "-o", tmp_path / "new", "--resume")
    assert result.code == 2 and "holds no DEM run to resume" in result.err
