"""The same run on one, two and three ranks; what ends one of them."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from ranks import command, environment, on_ranks

from granfabric.fem.fenicsx.team import Team

HERE = Path(__file__).parent
SCENE = "biaxial_inclusion"
LONG = ["strip_footing", "--host", "fenicsx", "--set", "mesh.refine=4", "--set", "stage.footing.increments=400"]


COUNTS = {"iterations", "factorisations", "cuts", "substeps", "limited_points"}


def history(folder: Path) -> dict[str, np.ndarray]:
    rows = list(csv.reader((folder / "history.csv").open()))
    columns = dict(zip(rows[0], zip(*rows[1:])))
    return {name: np.array(column, dtype=float) for name, column in columns.items() if name != "stage"}


def difference(found: dict[str, np.ndarray], wanted: dict[str, np.ndarray]) -> float:
    """Largest difference of two histories, each column relative to its kind."""
    assert found.keys() == wanted.keys()

    def kind(name: str) -> str:
        first = name.split("_")[0]
        if first == "region":
            _, region, what = name.split("_", 2)
            return f"region_{region}_{kind(what)}"
        if first == "rigid":
            return name.removesuffix("_x").removesuffix("_y")
        return first if first in ("strain", "displacement", "reaction") or name.startswith("stress_") else name

    largest: dict[str, float] = {}
    for name, column in wanted.items():
        largest[kind(name)] = max(largest.get(kind(name), 0.0), float(np.abs(column).max()))
    return max(
        float(np.abs(found[name] - column).max()) / (largest[kind(name)] or 1.0)
        for name, column in wanted.items()
        if name not in COUNTS
    )


def own(folder: Path, *more: str, scene: str = SCENE) -> dict[str, np.ndarray]:
    done = subprocess.run(
        [str(Path(sys.executable).parent / "granfabric"), "run", scene, "-o", str(folder), "-q", *more],
        env=environment(), check=False, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return history(folder)


@pytest.mark.slow
@pytest.mark.parametrize("scene", [SCENE, "rigid_footing", "tunnel"])
def test_numbers_of_ranks_do_not_matter(tmp_path: Path, scene: str) -> None:
    tight = [] if scene == SCENE else ["--set", "solver.tolerance=1e-10"]
    wanted = own(tmp_path / "own", *tight, scene=scene)
    found = {}
    for ranks in (1, 2, 3):
        folder = tmp_path / str(ranks)
        done = on_ranks(ranks, "granfabric", "run", scene, "--host", "fenicsx", "-o", str(folder), "-q", *tight)
        assert done.returncode == 0, done.stderr
        record = json.loads((folder / "run.json").read_text())
        assert record["host"]["name"] == "fenicsx"
        assert record["host"]["ranks"] == ranks
        assert {"overview.png", "result.pvd", "points.pvd", "mesh_error.vtu"} <= set(os.listdir(folder))
        found[ranks] = history(folder)
        assert difference(found[ranks], wanted) < 1e-6
    assert difference(found[2], found[1]) < 1e-9
    assert difference(found[3], found[1]) < 1e-9


@pytest.mark.slow
def test_a_stopped_run_goes_on_with_other_ranks(tmp_path: Path) -> None:
    wanted = own(tmp_path / "own")
    folder = tmp_path / "stopped"
    done = on_ranks(3, str(HERE / "stop_after.py"), SCENE, str(folder), "4")
    assert done.returncode == 1, done.stderr
    assert history(folder)["step"].tolist() == [0, 1, 2, 3, 4]
    done = on_ranks(2, "granfabric", "run", SCENE, "--host", "fenicsx", "-o", str(folder), "--resume", "-q")
    assert done.returncode == 0, done.stderr
    assert difference(history(folder), wanted) < 1e-6
    # and the own host goes on with what ranks began
    folder = tmp_path / "begun"
    assert on_ranks(2, str(HERE / "stop_after.py"), SCENE, str(folder), "4").returncode == 1
    assert difference(own(folder, "--resume"), wanted) < 1e-6


@pytest.mark.slow
def test_a_point_that_fails_on_one_rank_ends_all_alike(tmp_path: Path) -> None:
    much = ["--set", "stage.compression.displacement.0.value=-5e-3", "--set", "solver.smallest_factor=0.25"]
    folders = {1: tmp_path / "one", 2: tmp_path / "two"}
    messages = {}
    for ranks, folder in folders.items():
        done = on_ranks(ranks, "granfabric", "run", SCENE, "--host", "fenicsx", "-o", str(folder), *much)
        assert done.returncode == 1
        messages[ranks] = json.loads((folder / "run.json").read_text())["message"]
        assert (folder / "failed_point.toml").exists()
    assert messages[1] == messages[2]
    assert re.search(r"point \d+ at", messages[1])


@pytest.mark.slow
def test_a_killed_rank_loses_nothing_that_was_computed(tmp_path: Path) -> None:
    process = subprocess.Popen(
        command(2, "granfabric", "run", *LONG, "-o", str(tmp_path / "run"), "-q"), env=environment(),
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    try:
        wait_for(tmp_path / "run" / "checkpoint_000005.npz", process)
        ranks = children(process.pid, "granfabric")
        assert len(ranks) == 2
        os.kill(ranks[-1], signal.SIGKILL)
        assert process.wait(timeout=60) != 0
    finally:
        end(process)
    assert history(tmp_path / "run")["step"][-1] >= 5
    done = on_ranks(
        1, "granfabric", "run", *LONG, "--set", "stage.footing.increments=401", "-o", str(tmp_path / "run"), "--resume"
    )
    assert done.returncode == 2
    assert "increments was 400 and is 401" in done.stderr


@pytest.mark.slow
def test_an_interrupt_stops_after_the_step(tmp_path: Path) -> None:
    log = (tmp_path / "log").open("w")
    process = subprocess.Popen(
        command(2, "granfabric", "run", *LONG, "-o", str(tmp_path / "run")), env=environment(), stdout=log, stderr=log,
        start_new_session=True,
    )  # fmt: skip
    try:
        wait_for(tmp_path / "run" / "checkpoint_000003.npz", process)
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=60) != 0
    finally:
        end(process)
        log.close()
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    assert record["outcome"] == "stopped"
    assert "stopping after this step" in (tmp_path / "log").read_text()


def test_an_own_host_on_ranks_is_refused(tmp_path: Path) -> None:
    done = on_ranks(2, "granfabric", "run", SCENE, "-o", str(tmp_path / "run"))
    assert done.returncode == 2
    assert "the own host computes in one process, not on 2 ranks; try --host fenicsx" in done.stderr
    assert not (tmp_path / "run").exists()


def test_bad_input_ends_all_ranks(tmp_path: Path) -> None:
    folder = str(tmp_path / "run")
    done = on_ranks(2, "granfabric", "run", SCENE, "--host", "fenicsx", "--set", "solver.tolerance=-1", "-o", folder)
    assert done.returncode == 2
    assert "tolerance" in done.stderr
    done = on_ranks(
        2, "granfabric", "run", SCENE, "--host", "fenicsx", "--set", "solver.linear_solver=superlu", "-o", folder
    )
    assert done.returncode == 2
    assert "uses the direct solver of its PETSc" in done.stderr
    done = on_ranks(2, "granfabric", "run", "grains_biaxial", "--host", "fenicsx", "-o", folder)
    assert done.returncode == 2
    assert "law.kind = 'grains' runs on the own host only" in done.stderr
    assert not Path(folder).exists()


def test_an_error_of_a_callback_reaches_the_caller_and_the_team_goes_on() -> None:
    from granfabric.cases.field.prepare import prepare
    from granfabric.cases.scene.reader import load

    prepared = prepare(load("hole_in_plate", []))

    def fails(step: object) -> None:
        raise OSError("no space left")

    with Team() as team:
        with pytest.raises(OSError, match="no space left"):
            team.solve(prepared.problem, prepared.control, on_step=fails)
        assert team.solve(prepared.problem, prepared.control, stop=lambda: True).message == "stopped on request"


def wait_for(file: Path, process: subprocess.Popen[bytes], seconds: float = 120.0) -> None:
    since = time.monotonic()
    while not file.exists():
        assert process.poll() is None, "the run ended too early"
        assert time.monotonic() - since < seconds, "the run takes too long"
        time.sleep(0.02)


def children(parent: int, word: str) -> list[int]:
    """Processes below one, whose command line has a word."""
    found, ask = [], [parent]
    while ask:
        number = ask.pop()
        for task in Path(f"/proc/{number}/task").glob("*/children"):
            ask += [int(child) for child in task.read_text().split()]
        arguments = Path(f"/proc/{number}/cmdline").read_bytes().decode().split("\0")
        if number != parent and any(argument.endswith(word) for argument in arguments[:2]):
            found.append(number)
    return sorted(found)


def end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
