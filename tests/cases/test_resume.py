"""`granfabric run --resume`: the same bits after being killed at any moment, and only with the same input."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import pytest

from granfabric.cases.records import resumption
from granfabric.cases.terminal.screen import Screen

SCENE = """
title = "Rough platens, small"
kind = "field"
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
[mesh]
rectangle = { width = 0.05, height = 0.1, nx = 2, ny = 4 }
element = "P2"
[initial]
stress = [-100e3, -100e3, 0.0]
[[stage]]
name = "initial"
increments = 2
fixed = [{ boundary = "bottom" }, { boundary = "top" }]
pressure = [{ boundary = "left", value = 100e3 }, { boundary = "right", value = 100e3 }]
[[stage]]
name = "compression"
increments = 3
displacement = [{ boundary = "top", component = "y", value = -6e-6 }]
[[stage]]
name = "shear"
increments = 2
displacement = [{ boundary = "top", component = "x", value = 4e-6 }]
[[stage]]
name = "unload"
increments = 2
displacement = [{ boundary = "top", component = "y", value = -2e-6 }]
pressure = [{ boundary = "left", value = 40e3 }, { boundary = "right", value = 40e3 }]
[output]
pictures = false
every = 2
[solver]
first_factor = 0.5
"""

KILLED_AT = """
import os, signal, sys
moment, calls, replace = int(sys.argv.pop(1)), 0, os.replace
def counted(*arguments):
    global calls
    calls += 1
    if calls == moment:
        os.kill(os.getpid(), signal.SIGKILL)
    replace(*arguments)
os.replace = counted
from granfabric.cases.commands.cli import main
main()
"""


class Killed(BaseException):
    """Nobody catches it."""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    file = tmp_path / "small.toml"
    file.write_text(SCENE)
    return file


@pytest.fixture
def whole(granfabric: Callable, scene: Path, tmp_path: Path) -> dict[str, bytes]:
    """Files of a run in one go."""
    assert granfabric("run", scene, "-o", tmp_path / "whole").code == 0
    files = content(tmp_path / "whole")
    steps = files["history.csv"].count(b"\n") - 2
    assert steps >= 8 and sum(name.endswith(".vtu") for name in files) >= 2 * (1 + steps // 2)
    return files


def content(folder: Path) -> dict[str, bytes]:
    """Every file but the record and the log, which tell the time, and the lock of a run that was killed."""
    other = ("run.json", "run.log", ".granfabric.lock")
    return {file.name: file.read_bytes() for file in folder.iterdir() if file.name not in other}


def record(folder: Path) -> dict:
    return json.loads((folder / "run.json").read_text())


def test_killed_before_any_change_of_a_file(
    granfabric: Callable, scene: Path, tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    replace = os.replace
    calls = 0
    out = tmp_path / "out"

    def run(moment: int | None, *options: str) -> bool:
        """Whether the run came to its end before that many files had been put in place."""
        nonlocal calls
        calls = 0

        def counted(*arguments: Path) -> None:
            nonlocal calls
            calls += 1
            if calls == moment:
                raise Killed
            replace(*arguments)

        monkeypatch.setattr(os, "replace", counted)
        try:
            result = granfabric("run", scene, "-o", out, *options)
        except Killed:
            return False
        finally:
            monkeypatch.setattr(os, "replace", replace)
        assert result.code == 0, result.err
        return True

    assert run(None)
    total = calls
    assert total > 40
    # The first two belong to run.json and scene.toml: before there is a record, there is nothing to go on with.
    for moment in range(2, total + 1, 4):
        assert not run(moment)
        # Killed once more on the way.
        run(9, "--resume")
        assert run(None, "--resume"), moment
        assert content(out) == whole, moment
        assert record(out)["outcome"] == "finished"


@pytest.mark.parametrize("moment", [3, pytest.param(24, marks=pytest.mark.slow), 47])
def test_a_killed_process(
    granfabric: Callable, scene: Path, tmp_path: Path, whole: dict[str, bytes], moment: int
) -> None:
    out = tmp_path / "out"
    command = [sys.executable, "-c", KILLED_AT, str(moment), "run", str(scene), "-o", str(out)]
    assert subprocess.run(command, capture_output=True, check=False).returncode == -signal.SIGKILL
    assert record(out)["outcome"] == "running"
    result = granfabric("run", scene, "-o", out, "--resume")
    assert result.code == 0, result.err
    assert ("going on after step" in result.out) == (moment > 3)
    assert content(out) == whole


def test_stopped_and_gone_on_with(
    granfabric: Callable, scene: Path, tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    with monkeypatch.context() as patch:

        @contextmanager
        def interrupting(self, what, total):
            yield lambda done, text: signal.raise_signal(signal.SIGINT) if "step 5" in text else None

        patch.setattr(Screen, "progress", interrupting)
        assert granfabric("run", scene, "-o", out).code == 1
    assert record(out)["outcome"] == "stopped" and (out / "result_0005.vtu").is_file()
    result = granfabric("run", scene, "-o", out, "--resume")
    assert result.code == 0 and "going on after step 5" in result.out
    assert content(out) == whole
    before = record(out)
    result = granfabric("run", scene, "-o", out, "--resume")
    assert result.code == 0 and "nothing to do" in result.out
    assert content(out) == whole and record(out) == before


@pytest.fixture
def broken(granfabric: Callable, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of a run that was stopped in its sixth step."""
    replace = os.replace

    def until(source: Path, target: Path) -> None:
        if Path(target).name == "checkpoint_000006.npz":
            raise Killed
        replace(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", until)
        with pytest.raises(Killed):
            granfabric("run", scene, "-o", tmp_path / "out")
    assert sorted(file.name for file in (tmp_path / "out").glob("checkpoint*")) == [
        "checkpoint_000004.npz",
        "checkpoint_000005.npz",
    ]
    return tmp_path / "out"


def test_a_damaged_checkpoint_costs_one_step(
    granfabric: Callable, scene: Path, broken: Path, whole: dict[str, bytes]
) -> None:
    last = broken / "checkpoint_000005.npz"
    last.write_bytes(last.read_bytes()[:-100])
    result = granfabric("run", scene, "-o", broken, "--resume")
    assert result.code == 0 and "checkpoint_000005.npz is damaged" in result.out
    assert "going on after step 4" in result.out
    assert content(broken) == whole


def test_a_history_without_pressure_is_shown_as_it_is(granfabric: Callable, scene: Path, broken: Path) -> None:
    """Numbers of earlier rows are taken as they are; the table divides by none of them."""
    lines = (broken / "history.csv").read_text().splitlines()
    place = lines[0].split(",").index("p")
    first = lines[1].split(",")
    first[place] = "0.0"
    (broken / "history.csv").write_text("\n".join([lines[0], ",".join(first), *lines[2:]]) + "\n")
    result = granfabric("run", scene, "-o", broken, "--resume")
    assert result.code == 0 and " - " in result.out


def test_what_cannot_be_gone_on_with_is_left_as_it_is(granfabric: Callable, scene: Path, broken: Path) -> None:
    def refused(*parts: str) -> None:
        before = content(broken), record(broken)
        result = granfabric("run", scene, "-o", broken, "--resume")
        assert result.code == 2 and result.err.count("\n") == 1
        for part in parts:
            assert part in result.err
        assert (content(broken), record(broken)) == before

    history = (broken / "history.csv").read_text()
    (broken / "history.csv").write_text("".join(history.splitlines(keepends=True)[:4]))
    refused("history.csv", "does not hold the steps 0 to 5")
    (broken / "history.csv").write_text(history.replace("step,", "steps,", 1))
    refused("history.csv", "other columns")
    (broken / "history.csv").write_text(history)
    for file in broken.glob("checkpoint*"):
        file.write_bytes(b"PK")
    refused("checkpoint_000005.npz is damaged", "checkpoint_000004.npz is damaged", "start anew without --resume")


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (("material.coordination=3.9",), ["material.coordination was 4.06 and is 3.9"]),
        (("stage.1.increments=4",), ['stage 2 "compression": increments was 3 and is 4']),
        (("material.stiffness_ratio=0.5", "solver.grow=2.0"), ["material.stiffness_ratio was 1.0", "solver.grow was"]),
    ],
)
def test_another_input_is_refused_by_name(
    granfabric: Callable, scene: Path, broken: Path, change: tuple[str, ...], parts: list[str]
) -> None:
    options = [part for text in change for part in ("--set", text)]
    result = granfabric("run", scene, "-o", broken, "--resume", *options)
    assert result.code == 2
    for part in ("--resume: the input is not that of the run", *parts):
        assert part in result.err


def test_another_mesh_in_the_file_of_the_same_name_is_refused(
    granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, out = tmp_path / "mine", tmp_path / "out"
    assert granfabric("scenes", "--copy", "biaxial", "-o", folder).code == 0
    replace = os.replace

    def until(source: Path, target: Path) -> None:
        if Path(target).name == "history.csv":
            raise Killed
        replace(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", until)
        with pytest.raises(Killed):
            granfabric("run", folder, "-o", out)
    mesh = folder / "biaxial.msh"
    mesh.write_text(mesh.read_text() + "\n")
    result = granfabric("run", folder, "-o", out, "--resume")
    assert result.code == 2 and "content of the mesh file" in result.err


def test_nothing_to_go_on_with(granfabric: Callable, scene: Path, tmp_path: Path) -> None:
    result = granfabric("run", scene, "-o", tmp_path / "nowhere", "--resume")
    assert result.code == 2 and "holds no run to go on with" in result.err
    assert not (tmp_path / "nowhere").exists()


def test_differences_are_told_key_by_key() -> None:
    then = {"a": {"b": 1, "c": [1, 2]}, "mesh": {"file": "/here/mesh.msh"}, "old": True}
    now = {"a": {"b": 1, "c": [1, 3]}, "mesh": {"file": "/there/mesh.msh"}, "new": []}
    assert resumption.differences(then, now) == [
        "entry 2 of a.c was 2 and is 3",
        "old was true and is gone",
        "new is [] and was not given",
    ]
    assert resumption.differences(then, then) == []
