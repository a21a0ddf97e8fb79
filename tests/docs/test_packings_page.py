"""The page on packings: its examples run as they stand there, its tables name what the program knows."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from granfabric.dem_ref.exchange.files import load_packing, save_packing
from granfabric.dem_ref.exchange.raw import FORCE_COLUMNS
from granfabric.dem_ref.measures.contacts import contacts_of

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "guide" / "packings.md").read_text(encoding="utf-8")


def run(folder: Path, *arguments: str) -> str:
    environment = {**os.environ, "MPLBACKEND": "Agg", "COLUMNS": "120"}
    done = subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr + done.stdout
    return done.stdout


@pytest.mark.slow
def test_the_example_and_the_commands_of_the_page_run(tmp_path: Path) -> None:
    """The Python example leaves `packing.data`, which the command of the page measures."""
    said = run(tmp_path, str(DOCS / "examples" / "own_packing.py"))
    assert "disks: 400 400" in said
    assert 3.2 < float(re.findall(r"coordination: ([\d.]+)", said)[0]) < 3.7
    assert {"material", "closure"} <= set(tomllib.loads((tmp_path / "material.toml").read_text()))
    # the page's first command; without the tangential forces the packing is settled first
    line = next(line for line in PAGE.splitlines() if line.startswith("granfabric measure packing.data"))
    said = run(tmp_path, "-m", "granfabric", *line.split()[1:])
    assert "tangential forces are unknown and taken as zero" in said
    assert (tmp_path / "results" / "packing" / "material.toml").is_file()


@pytest.mark.slow
def test_the_scene_of_the_page_runs(tmp_path: Path) -> None:
    for name in ("loose.toml", "sizes.csv"):
        shutil.copy(DOCS / "examples" / name, tmp_path)
    run(tmp_path, "-m", "granfabric", "dem", "loose.toml", "-o", "out")
    told = json.loads((tmp_path / "out" / "run.json").read_text())
    assert told["packing"]["coordination_without_rattlers"] == pytest.approx(3.6, abs=0.7 / 300**0.5 + 1e-9)
    assert told["preparation"]["diameters"]["largest"] <= 1.6e-3


def test_the_table_of_the_page_is_read(tmp_path: Path) -> None:
    (text,) = re.findall(r"```text\n(# cell.*?)```", PAGE, re.DOTALL)
    (tmp_path / "a.csv").write_text(text)
    assert load_packing(tmp_path / "a.csv").cell.tolist() == [[8.1, 0.0], [0.4, 7.3]]


def test_every_column_of_contacts_is_told() -> None:
    for name in ("id1", "id2", *FORCE_COLUMNS):
        assert f"`{name}`" in PAGE, name


class _Body:
    """What the script for YADE on the page uses of a simulation, by YADE's own names."""

    def __init__(self, **values: object) -> None:
        self.__dict__.update(values)


def test_the_script_for_yade_writes_what_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Against a stand-in with YADE's names: forces of YADE act on the second body."""
    from granfabric.dem_ref.preparation.compaction import PackingOptions, make_packing

    sample = make_packing(60, 1, PackingOptions(preparation_friction=0.3))
    c = contacts_of(sample)
    cell = sample.cell.tolist()
    bodies = [
        _Body(id=number, state=_Body(pos=(*at, 0.0)), shape=_Body(radius=radius))
        for number, (at, radius) in enumerate(zip(sample.position.tolist(), sample.radius.tolist()))
    ]
    interactions = []
    for k in range(c.count):
        nx, ny = c.normal[k].tolist()
        fn, ft = float(c.normal_force[k]), float(c.tangential_force[k])
        phys = _Body(normalForce=(fn * nx, fn * ny, 0.0), shearForce=(-ft * ny, ft * nx, 0.0))
        interactions.append(_Body(id1=int(c.first[k]), id2=int(c.second[k]), phys=phys))
    size = _Body(col=lambda place: (*cell[place], 0.0))
    simulation = _Body(bodies=bodies, interactions=interactions, cell=_Body(hSize=size))
    (script,) = re.findall(r"```python\n(with open.*?)```", PAGE, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(script, {"O": simulation})
    back = load_packing("packing.csv", contacts="contacts.csv", stiffness_ratio=1.0, friction=0.5)
    assert contacts_of(back).tangential_force == pytest.approx(c.tangential_force, rel=1e-6, abs=1e-6)
    save_packing("again.csv", back)
