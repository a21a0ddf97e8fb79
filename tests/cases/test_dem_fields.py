"""Averages on a grid as files of a DEM scene."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
import pytest

SCENE = """title = "t"
kind = "dem"
[packing]
particles = 200
[[path]]
loading = "constant_pressure"
stress_ratio = 0.1
[measure]
material = false
[rates]
inertial_number = 1e-4
unbalanced_force = 3e-3
[output]
pictures = false
every = 4
"""


def written(folder: Path, keys: str) -> Path:
    file = folder / "scene.toml"
    file.write_text(SCENE + keys)
    return file


def test_fields_are_a_series_whose_means_are_the_history(granfabric: Callable, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = granfabric("dem", written(tmp_path, "field_cells = 5\n"), "-o", out)
    assert result.code == 0, result.err
    table = np.genfromtxt(out / "history.csv", delimiter=",", names=True)
    assert "fields_00000.vtu" in (out / "fields.pvd").read_text()
    stored = sorted(out.glob("fields_*.vtu"))
    assert len(stored) == len(list(out.glob("particles_*.vtu"))) > 2
    for file in stored:
        row = table[int(file.stem.split("_")[1])]
        mesh = meshio.read(file)
        data = {name: values[0] for name, values in mesh.cell_data.items()}
        assert len(mesh.cells[0].data) == 25
        for place, name in enumerate(("stress_xx", "stress_yy", "stress_xy")):
            assert data["stress"][:, place].mean() == pytest.approx(row[name], abs=1e-6 * row["p"])
        z = data["disks"] @ data["coordination"] / 200
        assert z == pytest.approx(row["coordination"], rel=1e-9)
        # cells of the grid are the periodic cell
        x, y = mesh.points[mesh.cells[0].data][:, :, :2].transpose(2, 0, 1)
        area = 0.5 * np.abs((x[:, 2] - x[:, 0]) * (y[:, 3] - y[:, 1]) - (x[:, 3] - x[:, 1]) * (y[:, 2] - y[:, 0]))
        solid = 1.0 / (1.0 + row["void_ratio"])
        assert data["solid_fraction"] @ area == pytest.approx(solid * area.sum(), rel=1e-6)
        assert data["strain"][:, 1].mean() == pytest.approx(row["strain_yy"], abs=0.3 * abs(row["strain_yy"]) + 1e-7)


def test_without_the_key_there_are_no_such_files(granfabric: Callable, tmp_path: Path) -> None:
    assert granfabric("dem", written(tmp_path, ""), "-o", tmp_path / "out").code == 0
    assert not list((tmp_path / "out").glob("fields*"))


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("field_cells = 1\n", "is no grid; legal are 0 for none, and 2 to 1000"),
        ("field_cells = 2\nfield_scale = 2.0\n", "some disks would belong to no cell"),
        ("field_cells = 8\nfield_scale = 40.0\n", "beyond half of the packing"),
        ('field_cells = 8\nfield_kernel = "box"\n', "field_kernel"),
        ("field_cells = -1\n", "field_cells"),
    ],
)
def test_a_kernel_that_does_not_fit_is_refused_beforehand(
    granfabric: Callable, tmp_path: Path, keys: str, words: str
) -> None:
    result = granfabric("dem", written(tmp_path, keys), "-o", tmp_path / "out")
    assert result.code == 2 and words in result.err and not (tmp_path / "out").exists()
