"""The command line itself: commands, codes, quick start."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from granfabric.cases.scene.catalogue import shipped


def test_help_lists_the_commands(granfabric: Callable) -> None:
    result = granfabric("--help")
    assert result.code == 0
    for command in ("run", "point", "dem", "verify", "scenes", "plot"):
        assert f"  {command} " in result.out


@pytest.mark.parametrize("arguments", [("rnu",), ("run",), ("run", "biaxial", "--nonsense"), ("plot",)])
def test_wrong_usage_gives_code_2(granfabric: Callable, arguments: tuple) -> None:
    result = granfabric(*arguments)
    assert result.code == 2 and result.err


def test_scenes_lists_all_with_their_titles(granfabric: Callable) -> None:
    result = granfabric("scenes")
    assert result.code == 0
    assert len(shipped()) >= 7
    for entry in shipped().values():
        assert entry.name in result.out and entry.title in result.out


def test_scenes_shows_the_text_of_one(granfabric: Callable) -> None:
    result = granfabric("scenes", "p_constant")
    assert result.code == 0 and "3.9303" in result.out
    assert granfabric("scenes", "p_constnat").code == 2


def test_a_scene_is_copied_with_its_mesh(granfabric: Callable, tmp_path: Path) -> None:
    result = granfabric("scenes", "--copy", "biaxial", "-o", tmp_path / "mine")
    assert result.code == 0
    names = {"biaxial.toml", "biaxial.msh", "biaxial.geo", "schema.json"}
    assert {file.name for file in (tmp_path / "mine").iterdir()} == names
    assert granfabric("scenes", "--copy", "biaxial", "-o", tmp_path / "mine").code == 2


@pytest.mark.parametrize("arguments", [["--help"], ["scenes"]])
def test_help_and_scenes_load_nothing_heavy(arguments: list[str]) -> None:
    heavy = ["numpy", "numba", "scipy", "matplotlib", "skfem", "meshio"]
    program = (
        "import sys\nfrom granfabric.cases.commands.cli import app\n"
        f"app({arguments!r}, standalone_mode=False)\n"
        f"print([name for name in {heavy!r} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"
