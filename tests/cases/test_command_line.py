"""The command line itself: commands, codes, quick start."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from granfabric.cases.errors import InputError, RunError
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


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (InputError("this is not legal"), 2, "granfabric: this is not legal\n"),
        (RunError("the disk is full"), 1, "granfabric: the disk is full\n"),
        (OSError("gone"), 1, "granfabric: gone\n"),
        (MemoryError(), 1, "granfabric: there is not enough memory for this\n"),
        (KeyboardInterrupt(), 1, "granfabric: interrupted\n"),
        (SystemExit(130), 1, "granfabric: interrupted\n"),
        (SystemExit(2), 2, ""),
        (SystemExit(0), 0, ""),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, BaseException) else "",
)
def test_codes_of_the_ways_in_which_a_command_ends(
    granfabric: Callable, monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int, said: str
) -> None:
    def ends() -> None:
        raise error

    monkeypatch.setattr("granfabric.cases.commands.cli.app", ends)
    result = granfabric()
    assert (result.code, result.err) == (code, said)


@pytest.mark.parametrize(("outcome", "code"), [("finished", 0), ("stopped", 1), ("failed", 1)])
@pytest.mark.parametrize("command", ["run", "point", "dem", "verify", "cost"])
def test_only_what_was_finished_ends_with_code_0(
    granfabric: Callable, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: str, outcome: str, code: int
) -> None:
    scenes = {"run": ("run.run_field", "biaxial_smooth"), "point": ("point.run_point", "p_constant"),
              "dem": ("dem.run_dem", "dem_biaxial"), "verify": ("verify.run_verify", None),
              "cost": ("cost.run_cost", None)}  # fmt: skip
    place, scene = scenes[command]
    record = SimpleNamespace(outcome=outcome, details={}, timing={}, folder=tmp_path)
    monkeypatch.setattr(f"granfabric.cases.commands.{place}", lambda *arguments, **options: record)
    assert granfabric(command, *([scene] if scene else []), "-o", tmp_path / "out").code == code


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
