"""Kills, full disks, interruptions: what was finished stays, what is broken does not look whole, the rest goes on."""

from __future__ import annotations

import errno
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import meshio
import numpy as np
import pytest
from mutations import one_sentence
from test_fuzz_results import DEM_SET, Killed, content
from test_resume import SCENE

from granfabric.cases.scene.toml_text import to_toml
from granfabric.fem.equilibrium.stored_arrays import read_stored_arrays

COMPARED = (".csv", ".vtu", ".pvd")


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    file = tmp_path / "small.toml"
    file.write_text(SCENE)
    return file


def commands(scene: Path) -> dict[str, list[str]]:
    return {"field": ["run", str(scene)], "dem": ["dem", "dem_biaxial", *DEM_SET]}


def same(out: Path, whole: dict[str, bytes], what: object) -> None:
    """The files of a run in one go, to the last bit."""
    found = content(out)
    for name, data in whole.items():
        if name.endswith(COMPARED):
            assert found[name] == data, f"{what}: {name}"
    assert json.loads((out / "run.json").read_text())["outcome"] == "finished"


def check_whole(out: Path) -> None:
    """Every file under its final name can be read to its end; half a file has another name."""
    for file in out.iterdir():
        if file.name.startswith(".") or file.suffix == ".part":
            continue
        if file.suffix == ".vtu":
            meshio.read(file)
        elif file.suffix == ".npz":
            read_stored_arrays(file)
        elif file.suffix == ".json":
            json.loads(file.read_text())
        elif file.suffix == ".toml":
            tomllib.loads(file.read_text())
        elif file.suffix == ".csv":
            rows = file.read_text().splitlines()
            assert file.read_text().endswith("\n") and len({row.count(",") for row in rows}) == 1
        elif file.suffix == ".pvd":
            assert file.read_text().rstrip().endswith("</VTKFile>")


@pytest.mark.parametrize("kind", ["field", "dem"])
@pytest.mark.parametrize("trouble", ["full disk", "kill"])
@pytest.mark.parametrize(
    "moments",
    [
        pytest.param(3, id="few"),
        pytest.param(12, id="many", marks=pytest.mark.slow),
        pytest.param(10_000, id="all", marks=pytest.mark.long),
    ],
)
def test_trouble_at_any_file(
    kind: str, trouble: str, moments: int, granfabric: Callable, scene: Path, tmp_path: Path, monkeypatch
) -> None:
    """The disk is full, or the process is killed, when the k-th file is put in place."""
    arguments, whole, out = commands(scene)[kind], tmp_path / "whole", tmp_path / "out"
    replace, calls = os.replace, 0

    def run(moment: int | None, folder: Path, *options: str) -> int | None:
        nonlocal calls
        calls = 0

        def counted(*paths: Path) -> None:
            nonlocal calls
            calls += 1
            if moment is not None and calls >= moment:
                if trouble == "kill":
                    raise Killed
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            replace(*paths)

        with monkeypatch.context() as patch:
            patch.setattr(os, "replace", counted)
            try:
                result = granfabric(*arguments, "-o", folder, *options)
            except Killed:
                return None
        if result.code:
            assert result.code == 1 and one_sentence(result.err) and "No space left" in result.err, result.err
        return result.code

    assert run(None, whole) == 0
    total, reference = calls, content(whole)
    # the first two are the record and the scene: before, there is no run to go on with
    for moment in sorted({*np.linspace(3, total, min(moments, total - 2)).astype(int).tolist()}):
        shutil.rmtree(out, ignore_errors=True)
        run(moment, out)
        check_whole(out)
        assert run(None, out, "--resume") == 0, moment
        same(out, reference, moment)


@pytest.mark.parametrize("kind", ["field", "dem"])
@pytest.mark.parametrize(
    "count", [pytest.param(6, id="some", marks=pytest.mark.slow), pytest.param(60, id="many", marks=pytest.mark.long)]
)
def test_killed_at_any_time(kind: str, count: int, granfabric: Callable, scene: Path, tmp_path: Path) -> None:
    """kill -9 from outside at random times of a process of its own, again and again until it comes to its end."""
    arguments, whole, out = commands(scene)[kind], tmp_path / "whole", tmp_path / "out"
    command = [sys.executable, "-m", "granfabric", *arguments, "-o"]
    since = time.monotonic()
    assert subprocess.run([*command, str(whole)], capture_output=True, check=False).returncode == 0
    duration, reference, rng = time.monotonic() - since, content(whole), np.random.default_rng(7)
    killed = 0
    for attempt in range(count):
        shutil.rmtree(out, ignore_errors=True)
        resume: list[str] = []
        for _ in range(3):
            process = subprocess.Popen(
                [*command, str(out), *resume], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
            try:
                # most of a short run is the start of the interpreter; what matters comes at its end
                process.wait(timeout=duration * float(rng.uniform(0.5, 1.05)))
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
                killed += process.wait() == -signal.SIGKILL
            if (out / "run.json").is_file():
                check_whole(out)
                resume = ["--resume"]
        result = granfabric(*arguments, "-o", out, *resume)
        assert result.code == 0, result.err
        same(out, reference, attempt)
    assert killed > 0


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """No file of this process may grow beyond that many bytes: the write comes back short, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("kind", ["field", "dem", "point"])
@pytest.mark.parametrize("size", [0, 2_000, 6_000, 20_000])
def test_a_file_that_cannot_grow(kind: str, size: int, granfabric: Callable, scene: Path, tmp_path: Path) -> None:
    """Whatever was being written does not look whole; with room again the run goes on."""
    point = ["point", "unload_reload", "--set", "output.pictures=false"]
    arguments, out = {**commands(scene), "point": point}[kind], tmp_path / "out"
    with largest_file(size):
        result = granfabric(*arguments, "-o", out)
    if result.code:  # a point may be small enough
        assert result.code in (1, 2) and one_sentence(result.err), result.err
    check_whole(out)
    if kind != "point" and (out / "run.json").is_file():
        whole = tmp_path / "whole"
        assert granfabric(*arguments, "-o", whole).code == 0
        assert granfabric(*arguments, "-o", out, "--resume").code == 0
        same(out, content(whole), size)


@pytest.mark.parametrize("kind", ["field", "dem", "point"])
def test_a_folder_that_cannot_be_written(kind: str, granfabric: Callable, scene: Path) -> None:
    """/proc refuses new folders to everybody, root included."""
    point = ["point", "p_constant"]
    result = granfabric(*{**commands(scene), "point": point}[kind], "-o", "/proc/granfabric")
    assert result.code == 2 and one_sentence(result.err) and "cannot be written" in result.err


@pytest.mark.parametrize("where", ["scene.reader.load", "records.files.prepare_output", "scene.catalogue.shipped"])
def test_ctrl_c_outside_a_run(where: str, granfabric: Callable, tmp_path: Path, monkeypatch) -> None:
    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(f"granfabric.cases.{where}", interrupted)
    result = granfabric("point", "p_constant", "-o", tmp_path / "out")
    assert (result.code, result.err) == (1, "granfabric: interrupted\n")


def test_ctrl_c_while_modules_are_imported() -> None:
    program = (
        "import sys\n"
        "class Interrupting:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'typer': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Interrupting())\n"
        "from granfabric.cases.__main__ import main\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, "granfabric: interrupted\n")


REPLAYED = [
    {"integration": {"tolerance": 1e-9, "maximum_substeps": 45}, "closure": {"force_change": "mean_field"}},
    {"integration": {"maximum_substeps": 8}, "closure": {"force_change": "shifted_distribution"}},
    {"effects": {"stiffness_feedback": False}, "closure": {"force_change": "mean_field"}},
    {"closure": {"force_change": "shifted_distribution", "shear_stiffness": "isostatic"}},
]


@pytest.mark.parametrize("tables", REPLAYED, ids=["mean_field", "shifted", "frozen", "isostatic"])
def test_a_failed_point_replays_from_its_whole_state(
    tables: dict, granfabric: Callable, scene: Path, tmp_path: Path
) -> None:
    """The replay starts from the stress and every state variable that the point had, and fails for the same reason."""
    table = tomllib.loads(scene.read_text()) | tables
    # sheared far beyond what the packing carries, in steps that may not be cut
    table["stage"][2]["displacement"][0]["value"] = 6e-5
    table["solver"] |= {"smallest_factor": 0.5, "first_factor": 0.5}
    scene.write_text(to_toml(table))
    out = tmp_path / "out"
    result = granfabric("run", scene, "-o", out)
    assert result.code == 1
    failed = tomllib.loads((out / "failed_point.toml").read_text())
    steps = (out / "history.csv").read_text().count("\n") - 2
    # where displacements come first ("frozen"), steps are not halved by first_factor
    assert steps >= 4 and failed["initial"]["state"]["coordination"] != 4.06
    replay = granfabric("point", out / "failed_point.toml", "-o", tmp_path / "replay", "--set", "output.pictures=false")
    assert replay.code == 1, replay.err
    told = json.loads((tmp_path / "replay/run.json").read_text())
    assert told["message"].split(": ", 1)[1] in failed["description"]
    for change, part in (
        ({"coordination": float(-1)}, "outside its bounds"),
        ({"coordnation": 4.0}, "the nearest is 'coordination'"),
        ({"fabric_anisotropy": 0.0}, "needs 2 numbers"),
    ):
        state = {**failed["initial"]["state"], **change}
        (tmp_path / "bad.toml").write_text(to_toml({**failed, "initial": {**failed["initial"], "state": state}}))
        bad = granfabric("point", tmp_path / "bad.toml", "-o", tmp_path / "bad")
        assert bad.code == 2 and part in bad.err and not (tmp_path / "bad").exists()
