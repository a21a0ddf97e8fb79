"""Probes of a field run: their places, their values over the steps, what is refused, and going on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from test_nothing_lost import largest_file

from granfabric.cases.records.background import BackgroundWriter
from granfabric.cases.records.files import read_csv
from granfabric.cases.scene.catalogue import find

PROBES = """
[[output.probe]]
name = "wall"
point = [0.014142136, 0.014142136]

[[output.probe]]
name = "radial"
from = [0.02, 0.0]
to = [0.08, 0.0]
count = 4
"""
SMALL = ("mesh.ring.n_radial=4", "mesh.ring.n_around=4", "stage.1.increments=3", "output.pictures=false")


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    file = tmp_path / "cavity.toml"
    file.write_text(find("pressurised_cavity").read_text() + PROBES)
    return file


def run(granfabric: Callable, scene: Path, *more: str):
    return granfabric("run", scene, *(word for text in SMALL for word in ("--set", text)), *more)


def test_values_at_places_of_a_curved_mesh(granfabric: Callable, scene: Path, tmp_path: Path) -> None:
    import granfabric as gf

    out = tmp_path / "out"
    assert run(granfabric, scene, "-o", out).code == 0
    results, wall, line = gf.read_results(out), read_csv(out / "probe_wall.csv"), read_csv(out / "probe_radial.csv")
    steps = results.history["step"].tolist()
    assert wall["step [-]"] == steps and line["step [-]"] == [step for step in steps for _ in range(4)]
    np.testing.assert_allclose(line["x [m]"][:4], [0.02, 0.04, 0.06, 0.08])
    # the wall lies on a curved side: what the nodes there do, and what the fields say at the last step
    there = results.at(0.014142136 * 1.00001, 0.014142136 * 1.00001)
    for name, unit in (("displacement_x", "m"), ("stress_yy", "Pa"), ("coordination", "-"), ("q", "Pa")):
        assert wall[f"{name} [{unit}]"][-1] == pytest.approx(there[name], rel=2e-4)
    at = results.along((0.02, 0.0), (0.08, 0.0), number=4)
    np.testing.assert_allclose(line["stress_xx [Pa]"][-4:], at["stress_xx"], rtol=1e-9)
    assert {head.rpartition(" ")[2] for head in wall} == {"[-]", "[m]", "[Pa]"}


def test_going_on_appends_right(granfabric: Callable, scene: Path, tmp_path: Path, monkeypatch) -> None:
    from granfabric.cases.terminal.interruption import InterruptRequest

    whole, out = tmp_path / "whole", tmp_path / "out"
    assert run(granfabric, scene, "-o", whole).code == 0
    with monkeypatch.context() as patch:
        rows = out / "history.csv"
        patch.setattr(InterruptRequest, "__call__", lambda self: rows.is_file() and rows.read_text().count("\n") > 3)
        assert run(granfabric, scene, "-o", out).code == 1
    for name in ("wall", "radial"):  # what a kill leaves of rows that no checkpoint vouches for
        with (out / f"probe_{name}.csv").open("a") as file:
            file.write("9,inflation,0.3,0,0.0,0.0")
    assert run(granfabric, scene, "-o", out, "--resume").code == 0
    for name in ("wall", "radial"):
        assert (out / f"probe_{name}.csv").read_bytes() == (whole / f"probe_{name}.csv").read_bytes()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("point = [0.014142136, 0.014142136]", "point = [0.0, 0.01]", "the nearest place of the mesh is (3.55"),
        ("to = [0.08, 0.0]", "to = [0.2, 0.0]", "2 of 4 places of the line, first (0.14, 0) m lies outside"),
        ('name = "wall"', 'name = "radial"', "two probes have the name 'radial'"),
        ("point =", "count = 3\npoint =", "count goes with from and to"),
        ("to = [0.08, 0.0]", "", "needs both ends of its line"),
        ("to = [0.08, 0.0]", "to = [0.02, 0.0]", "the two ends of its line coincide"),
        ('name = "wall"', 'name = "a/b"', "name = 'a/b'"),
    ],
)
def test_what_is_refused(granfabric: Callable, scene: Path, tmp_path: Path, old: str, new: str, said: str) -> None:
    scene.write_text(scene.read_text().replace(old, new))
    result = run(granfabric, scene, "-o", tmp_path / "out")
    assert result.code == 2 and said in result.err and not (tmp_path / "out").exists()


def test_nothing_is_written_after_an_error_and_it_is_told() -> None:
    done: list[int] = []

    def full() -> None:
        raise OSError(28, "No space left on device")

    writer = BackgroundWriter()
    with pytest.raises(OSError, match="No space left"), writer:
        writer.submit(lambda: done.append(1))
        writer.submit(full)
        writer.submit(lambda: done.append(2))
        writer.finish()
    assert done == [1]
    with BackgroundWriter() as writer:
        for number in range(20):
            writer.submit(lambda number=number: done.append(number))
    assert done == [1, *range(20)]


def test_a_full_disk_leaves_whole_rows(granfabric: Callable, scene: Path, tmp_path: Path) -> None:
    with largest_file(2500):
        result = run(granfabric, scene, "-o", tmp_path / "out")
    assert result.code in (1, 2)
    for file in (tmp_path / "out").glob("probe_*.csv"):
        lines = file.read_text().splitlines(keepends=True)
        assert all(line.endswith("\n") and line.count(",") == lines[0].count(",") for line in lines)
