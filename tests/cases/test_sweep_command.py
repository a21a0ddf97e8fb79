"""`granfabric sweep` and `granfabric dem --seeds`: folders, tables, pictures, going on, failures, interruption."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from granfabric.cases.field.prepare import prepare
from granfabric.cases.records import files
from granfabric.cases.records.field_history import FieldHistory
from granfabric.cases.scene.reader import load
from granfabric.cases.sweep import pictures as sweep_pictures
from granfabric.cases.sweep.field_columns import field_columns
from granfabric.cases.sweep.results import FIELD_FAMILIES, LOAD_FACTOR

SCENE = "p_constant"
ASKED = ("sweep", SCENE, "--set", "material.coordination=3.9,4.0", "--set", "path.0.increments=5,10", "--result",
         "coordination:at:q/p=0.2", "--result", "coordination", "--result", "q:max")  # fmt: skip
NAMES = [f"coordination={z}_increments={n}" for z in ("3.9", "4.0") for n in (5, 10)]
DEM = ("--set", "packing.particles=200", "--set", "path.0.stress_ratio=0.1")


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a sweep by two processes, from the command line of another process."""
    folder = tmp_path_factory.mktemp("sweep") / "out"
    command = [sys.executable, "-m", "granfabric.cases", *ASKED, "-o", folder, "--workers", "2"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


def histories(folder: Path) -> dict[str, bytes]:
    return {file.parent.name: file.read_bytes() for file in folder.glob("*/history.csv")}


def test_a_folder_a_run_and_two_tables(swept: Path, is_drawn: Callable) -> None:
    assert {entry.name for entry in swept.iterdir()} == {
        *NAMES, "run.json", "run.log", "index.csv", "results.csv", "results.png",
    }  # fmt: skip
    assert is_drawn(swept / "results.png")
    index, table = files.read_csv(swept / "index.csv"), files.read_csv(swept / "results.csv")
    assert list(index) == ["run", "material.coordination", "path.0.increments", "outcome", "seconds", "message"]
    assert index["run"] == NAMES and index["outcome"] == ["finished"] * 4 and min(index["seconds"]) > 0.0
    assert list(table) == ["run", "material.coordination", "path.0.increments", "coordination:at:q/p=0.2",
                           "coordination", "q:max"]  # fmt: skip
    for row, name in enumerate(NAMES):
        history = {key: np.array(values) for key, values in files.read_csv(swept / name / "history.csv").items()}
        assert len(history["step"]) == 1 + table["path.0.increments"][row]
        assert history["coordination"][0] == table["material.coordination"][row]
        assert table["coordination"][row] == history["coordination"][-1] and table["q:max"][row] == max(history["q"])
        at = np.interp(0.2, history["q"] / history["p"], history["coordination"])
        assert table["coordination:at:q/p=0.2"][row] == pytest.approx(at, rel=1e-12)


def test_each_run_is_one_of_the_single_command(swept: Path, granfabric: Callable, tmp_path: Path) -> None:
    """The same files to the last bit, and its log says how to make it alone."""
    line = (swept / NAMES[1] / "run.log").read_text().split("\n")[0]
    words = line.partition("granfabric ")[2].split()
    assert words[:2] == ["point", SCENE]
    words[words.index("-o") + 1] = str(tmp_path / "alone")
    assert granfabric(*words).code == 0
    assert (tmp_path / "alone" / "history.csv").read_bytes() == (swept / NAMES[1] / "history.csv").read_bytes()
    ours, theirs = ({f.name for f in folder.iterdir()} for folder in (tmp_path / "alone", swept / NAMES[1]))
    assert ours == theirs
    log = (swept / "run.log").read_text()
    assert "granfabric sweep p_constant --set" in log and "numba" in log and "4 of 4 runs finished" in log


@pytest.mark.parametrize("workers", [1, 3])
def test_results_do_not_depend_on_the_number_of_workers(
    swept: Path, granfabric: Callable, tmp_path: Path, workers: int
) -> None:
    assert granfabric(*ASKED, "-o", tmp_path / "out", "--workers", workers).code == 0
    assert histories(tmp_path / "out") == histories(swept)
    assert (tmp_path / "out" / "results.csv").read_bytes() == (swept / "results.csv").read_bytes()


def test_what_has_finished_is_taken_from_its_folder(swept: Path, granfabric: Callable, tmp_path: Path) -> None:
    """With further runs and other results; a run that is missing, or was killed, is computed."""
    out = tmp_path / "out"
    shutil.copytree(swept, out)
    stamps = {name: (out / name / "history.csv").stat().st_mtime_ns for name in NAMES}
    shutil.rmtree(out / NAMES[0])
    killed = json.loads((out / NAMES[2] / "run.json").read_text())
    (out / NAMES[2] / "run.json").write_text(json.dumps({**killed, "outcome": "running"}))
    wider = [word.replace("=5,10", "=5,10,20") for word in ASKED[:6]]
    done = granfabric(*wider, "--result", "q/p:max", "-o", out, "--resume", "--workers", 1)
    assert done.code == 0 and "6 runs of p_constant, 2 of them there already" in done.out, done.err
    assert {name: (out / name / "history.csv").stat().st_mtime_ns == stamp for name, stamp in stamps.items()} == {
        NAMES[0]: False, NAMES[1]: True, NAMES[2]: False, NAMES[3]: True,
    }  # fmt: skip
    kept = histories(out)
    assert {name: kept[name] for name in NAMES} == histories(swept) and len(kept) == 6
    table = files.read_csv(out / "results.csv")
    assert table["q/p:max"] == pytest.approx([0.3] * 6) and "q:max" not in table
    again = granfabric(*wider, "-o", out, "--resume")
    assert again.code == 0 and "6 of them there already; nothing to do" in again.out


def test_another_sweep_is_refused(swept: Path, granfabric: Callable, tmp_path: Path) -> None:
    """Nothing is changed; the sentence names what is another."""
    before = {file: file.stat().st_mtime_ns for file in swept.rglob("*")}
    other = [word.replace("3.9,4.0", "3.9,4.1") for word in ASKED]
    for arguments, said in (
        ((*ASKED,), "holds a sweep (4 of 4 runs finished); go on with it by --resume"),
        ((*other, "--resume"), "the run coordination=4.0_increments=5 is not asked for any more"),
        ((*ASKED, "--resume", "--set", "material.solid_fraction=0.8"), "material.solid_fraction was 0.846 and is 0.8"),
        (("point", SCENE), "another scene, sweep 'p_constant'"),
        ((*ASKED[:1], "undrained", "--set", "material.coordination=3.9,4.0", "--resume"), "this is not the sweep"),
    ):
        result = granfabric(*arguments, "-o", swept)
        assert result.code == 2 and said in result.err, (arguments, result.err)
    assert {file: file.stat().st_mtime_ns for file in swept.rglob("*")} == before
    result = granfabric(*ASKED, "-o", tmp_path, "--resume")
    assert result.code == 2 and "holds no run to go on with" in result.err
    assert granfabric("point", SCENE, "-o", tmp_path / "point").code == 0
    result = granfabric(*ASKED, "-o", tmp_path / "point", "--resume")
    assert result.code == 2 and "holds no sweep to go on with, but a 'point'" in result.err
    result = granfabric(*ASKED, "-o", tmp_path / "point")
    assert result.code == 2 and "another scene" in result.err


def test_a_sweep_is_replaced_if_asked_for(swept: Path, granfabric: Callable, tmp_path: Path) -> None:
    """Folders of runs that are no more go, with what others put there kept."""
    out = tmp_path / "out"
    shutil.copytree(swept, out)
    (out / NAMES[0] / "thesis.txt").write_text("mine")
    done = granfabric("sweep", SCENE, "--set", "path.0.increments=4,5", "-o", out, "--overwrite", "--workers", 1)
    assert done.code == 0, done.err
    assert {entry.name for entry in out.iterdir() if entry.is_dir()} == {"increments=4", "increments=5", NAMES[0]}
    assert [entry.name for entry in (out / NAMES[0]).iterdir()] == ["thesis.txt"]


def test_a_failing_run_does_not_stop_the_others(granfabric: Callable, tmp_path: Path) -> None:
    """Its sentence in table, log and on screen, and exit code 1; it is not computed again."""
    table = tmp_path / "runs.csv"
    rows = ['fine,"[-1.1e5, -0.9e5, 0.0]"', 'beyond,"[-1.2e5, 3e5, 0.0]"', 'last,"[-1e5,-1e5,0]"']
    table.write_text("\n".join(["name,path.0.target", *rows]))
    arguments = ("sweep", SCENE, "--table", table, "-o", tmp_path / "out", "--workers", 1)
    result = granfabric(*arguments)
    index = files.read_csv(tmp_path / "out" / "index.csv")
    assert result.code == 1, result.out
    assert index["outcome"] == ["finished", "failed", "finished"], index
    message = index["message"][1]
    assert message and f"failed: beyond: {message}" in result.out and f"beyond: {message}" in (
        tmp_path / "out" / "run.log"
    ).read_text()
    told = json.loads((tmp_path / "out" / "run.json").read_text())
    assert told["outcome"] == "failed" and told["failed"] == ["beyond"] and told["finished"] == 2
    again = granfabric(*arguments, "--resume")
    assert again.code == 1 and "nothing to do" in again.out and message in again.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--set", "material.coordinaton=3.9,4"), "--set: the key 'material.coordinaton' is unknown"),
        (("--set", "material.coordination=3.9,99"), "--set: material.coordination = 99 is outside its bounds"),
        (("--latin", "material.coordination=3:9", "--samples", 5), "sample "),
        (("--set", "kind=point,dem"), "kind"),
        (("--set", "material.coordination=3.9,4", "--result", "z"), "--result 'z'"),
        (("--set", "material.coordination=3.9,4", "--workers", 0), "--workers 0 is outside"),
        (("--set", "material.coordination=3.9,4", "--scheduler", "tcp://127.0.0.1:9", "--workers", 2), "give one"),
        (("--table", "missing.csv"), "--table missing.csv: cannot be read"),
        (("--set", "effects.sliding=true,false"), "run sliding=true: --set: effects.sliding = true needs material"),
        (("--set", "effects.sliding=true", "--set", "material.coordination=3.9,4"),
         "granfabric: --set: effects.sliding = true needs"),
        (("--set", "effects.pore_fluid=true", "--set", "material.fluid_bulk_stiffness=0,2e9"),
         "run fluid_bulk_stiffness=0: --set: effects.pore_fluid = true needs the bulk modulus"),
    ],
)
def test_what_is_not_legal_is_refused_before_anything_runs(
    granfabric: Callable, tmp_path: Path, arguments: tuple, said: str
) -> None:
    result = granfabric("sweep", SCENE, *arguments, "-o", tmp_path / "out")
    assert result.code == 2 and said in result.err, result.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("scene", "arguments", "said"),
    [
        ("biaxial", ("stage.compression.displacement.0.boundary=top,roof",),
         'run boundary=roof: --set stage.1.displacement.0.boundary: stage 2 "compression": displacement 1: the '
         "boundary 'roof' is unknown"),
        ("biaxial", ("mesh.file=rectangle.msh,other.msh",), "run file=other.msh: --set: mesh.file: mesh "),
        ("grains_biaxial", ("packing.normal_stiffness=1e3,1e9",),
         "run normal_stiffness=1e3: --set: packing.normal_stiffness = 1000 Pa over the initial mean pressure"),
        ("dem_biaxial", ("path.0.stress_ratio=0.1,1.5", "packing.seed=1:9:9"),
         "runs stress_ratio=1.5_seed=1, stress_ratio=1.5_seed=2, stress_ratio=1.5_seed=3, stress_ratio=1.5_seed=4 and "
         "5 more: --set path.0.stress_ratio: path 1: stress_ratio = 1.5 is outside its bounds"),
    ],
)  # fmt: skip
def test_what_a_run_would_refuse_is_refused_before_the_first(
    granfabric: Callable, tmp_path: Path, scene: str, arguments: tuple, said: str
) -> None:
    """Of each kind of scene: what is wrong with one run is found on its mesh, loads, packing or path."""
    words = [word for text in arguments for word in ("--set", text)]
    result = granfabric("sweep", scene, *words, "-o", tmp_path / "out")
    assert result.code == 2 and said in result.err, result.err
    assert not (tmp_path / "out").exists()


def test_columns_of_boundaries_are_those_of_the_scene(granfabric: Callable, tmp_path: Path) -> None:
    arguments = ("sweep", "biaxial", "--set", "material.coordination=3.9,4", "-o", tmp_path / "out", "--result")
    result = granfabric(*arguments, "reaction_roof_y")
    assert result.code == 2 and "reaction_top_y" in result.err and not (tmp_path / "out").exists()


@pytest.mark.parametrize("scene", ["tunnel", "rigid_footing", "layered_oedometer"])
def test_what_may_be_asked_for_is_what_a_run_writes(scene: str) -> None:
    loaded = load(scene, [])
    ready = prepare(loaded)
    problem = ready.problem
    law, space = problem.law.description, problem.space
    history = FieldHistory(space, law, ready.boundaries, ready.supported, problem.program)
    varying = (*FIELD_FAMILIES, LOAD_FACTOR)
    assert set(field_columns(loaded)) == {name for name in history.names if name.startswith(varying)}


def test_a_load_factor_needs_a_control(granfabric: Callable, tmp_path: Path) -> None:
    arguments = ("sweep", "biaxial", "--set", "material.coordination=3.9,4", "-o", tmp_path / "out", "--result")
    result = granfabric(*arguments, "load_factor:max")
    assert result.code == 2 and "no stage of the scene has a control" in result.err and not (tmp_path / "out").exists()


def test_errors_of_a_line_name_it(granfabric: Callable, tmp_path: Path) -> None:
    table = tmp_path / "runs.csv"
    table.write_text("material.coordination,material.friction\n3.9,0.5\n")
    result = granfabric("sweep", SCENE, "--table", table, "-o", tmp_path / "out")
    assert result.code == 2 and f"{table}, line 2: the key 'material.friction' is unknown" in result.err


def test_files_that_are_named_are_found_from_the_working_folder(
    granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also by processes that work elsewhere, and a scene file that is given as it lies there."""
    monkeypatch.chdir(tmp_path)
    for name, z in (("loose", 3.5), ("dense", 4.0)):
        text = f"[material]\ncoordination = {z}\nsolid_fraction = 0.84\nnormal_stiffness = 1e9\n"
        Path(f"{name}.toml").write_text(text)
    assert granfabric("scenes", "--copy", SCENE, "-o", "mine").code == 0
    arguments = ("sweep", "mine", "--set", "material_file=loose.toml,./dense.toml", "--set", "path.0.increments=3")
    done = granfabric(*arguments, "-o", "out", "--workers", 2, "--result", "coordination:first")
    assert done.code == 0, done.err
    table = files.read_csv(tmp_path / "out" / "results.csv")
    assert table["coordination:first"] == [3.5, 4.0]
    assert table["run"] == ["material_file=loose.toml", "material_file=._dense.toml"]


def test_a_field_goes_on_where_it_was_interrupted(granfabric: Callable, tmp_path: Path) -> None:
    """Ctrl-C to the process that began the runs; what was reached is kept, and the rest is as of one go."""
    arguments = ("sweep", "biaxial", "--set", "mesh.element=P1", "--set", "material.coordination=3.9,4.1", "--set",
                 "stage.compression.increments=60", "--set", "effects.stiffness_feedback=true", "--set",
                 "output.every=20", "--result", "reaction_top_y:min")  # fmt: skip
    out = tmp_path / "out"
    begun = subprocess.Popen(
        [sys.executable, "-m", "granfabric.cases", *arguments, "-o", out, "--workers", "2"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    since = time.monotonic()
    while not any(out.glob("*/checkpoint_*.npz")) and time.monotonic() - since < 120.0:
        time.sleep(0.02)
    begun.send_signal(signal.SIGINT)
    said, errors = begun.communicate(timeout=60.0)
    assert begun.returncode == 1 and "--resume goes on from here" in said, (said, errors)
    index = files.read_csv(out / "index.csv")
    assert set(index["outcome"]) <= {"stopped", "not begun", "finished"} and "stopped" in index["outcome"]
    again = granfabric(*arguments, "-o", out, "--resume", "--workers", 1)
    assert again.code == 0, again.err
    assert any("resumed_after_step" in file.read_text() for file in out.glob("*/run.json"))
    assert granfabric(*arguments, "-o", tmp_path / "whole", "--workers", 1).code == 0
    assert (out / "results.csv").read_bytes() == (tmp_path / "whole" / "results.csv").read_bytes()
    assert histories(out) == histories(tmp_path / "whole")


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "killpg"), reason="needs groups of processes")
def test_a_killed_process_costs_its_run_only(granfabric: Callable, tmp_path: Path) -> None:
    """kill -9 of one worker of a sweep of the DEM: the sweep finishes, with the numbers of one that was left alone."""
    arguments = ("sweep", "dem_biaxial", *DEM, "--set", "packing.seed=1:4:4", "--result", "material.coordination")
    out = tmp_path / "out"
    begun = subprocess.Popen(
        [sys.executable, "-m", "granfabric.cases", *arguments, "-o", out, "--workers", "2"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    since, killed = time.monotonic(), False
    while not killed and begun.poll() is None and time.monotonic() - since < 120.0:
        for lock in out.glob("*/.granfabric.lock"):
            try:
                process = json.loads(lock.read_text())["process"]
            except (OSError, ValueError, KeyError):
                continue
            os.kill(process, signal.SIGKILL)
            killed = True
            break
        time.sleep(0.005)
    said, errors = begun.communicate(timeout=120.0)
    assert killed and begun.returncode == 0, (said, errors)
    assert files.read_csv(out / "index.csv")["outcome"] == ["finished"] * 4
    assert granfabric(*arguments, "-o", tmp_path / "whole", "--workers", 1).code == 0
    assert (out / "results.csv").read_bytes() == (tmp_path / "whole" / "results.csv").read_bytes()
    assert histories(out) == histories(tmp_path / "whole")


def test_packings_of_several_seeds(granfabric: Callable, tmp_path: Path) -> None:
    """Mean and scatter of their histories and measured inputs, from the scene's seed on."""
    arguments = ("dem", "dem_biaxial", *DEM, "--set", "packing.seed=5", "--seeds", 2)
    done = granfabric(*arguments, "-o", tmp_path / "out", "--workers", 1)
    assert done.code == 0, done.err
    out = tmp_path / "out"
    assert {entry.name for entry in out.iterdir() if entry.is_dir()} == {"seed=5", "seed=6"}
    texts = [(out / name / "material.toml").read_text() for name in ("seed=5", "seed=6")]
    mean = (out / "material.toml").read_text()
    values = [float(text.partition("coordination = ")[2].split()[0]) for text in (*texts, mean)]
    assert values[2] == pytest.approx((values[0] + values[1]) / 2, rel=1e-9) and "mean of 2 packings" in mean
    scatter = files.read_csv(out / "scatter.csv")
    assert scatter["stress_ratio"][0] == 0.0 and scatter["stress_ratio"][-1] == pytest.approx(0.1, abs=0.01)
    assert scatter["packings"][0] == 2.0
    both = [files.read_csv(out / name / "history.csv") for name in ("seed=5", "seed=6")]
    first = [history["coordination"][0] for history in both]
    assert scatter["coordination"][0] == pytest.approx(np.mean(first), abs=1e-12)
    assert scatter["coordination_scatter"][0] == pytest.approx(np.std(first, ddof=1), abs=1e-12)
    assert granfabric("dem", "dem_biaxial", "--workers", 2).err.startswith("granfabric: --workers goes with --seeds K")
    result = granfabric("dem", "dem_biaxial", "--seeds", 1, "-o", tmp_path / "new")
    assert result.code == 2 and "--seeds 1 is outside [2, " in result.err
    assert granfabric("dem", SCENE, "--seeds", 2, "-o", tmp_path / "new").code == 2
    assert not (tmp_path / "new").exists()


# pictures


def drawn(folder: Path, pictures: dict[str, Any], keys: dict[str, list], results: dict[str, list]) -> Any:
    rows = list(zip(map(str, range(100)), *keys.values(), *results.values()))
    files.write_text(folder / "results.csv", files.csv_text(["run", *keys, *results], rows))
    files.write_json(folder / "run.json", {"program": "granfabric", "keys": list(keys), "results": list(results)})
    pictures.clear()
    sweep_pictures.draw_sweep(folder, "title")
    return pictures.get("results.png")


def test_one_key_gives_lines(tmp_path: Path, pictures: dict[str, Any]) -> None:
    figure = drawn(tmp_path, pictures, {"a": [3.0, 1.0, 2.0]}, {"x": [9.0, 1.0, 4.0], "y": [1.0, 2.0, ""]})
    (first, second) = figure.axes
    np.testing.assert_array_equal(first.lines[0].get_xydata(), [[1, 1], [2, 4], [3, 9]])
    np.testing.assert_array_equal(second.lines[0].get_xydata(), [[1, 2], [3, 1]])
    assert (first.get_xlabel(), first.get_ylabel(), second.get_ylabel()) == ("a", "x", "y")
    figure = drawn(tmp_path, pictures, {"a": ["dense", "loose"]}, {"x": [9.0, 1.0]})
    (axes,) = figure.axes
    assert [label.get_text() for label in axes.get_xticklabels()] == ["dense", "loose"]
    assert axes.lines[0].get_linestyle() == "None"
    (axes,) = drawn(tmp_path, pictures, {"a": [1.0, 10.0, 1000.0]}, {"x": [1.0, 2.0, 3.0]}).axes
    assert axes.get_xscale() == "log"


def test_two_keys_give_lines_or_a_map(tmp_path: Path, pictures: dict[str, Any]) -> None:
    keys = {"a": [1.0, 1.0, 2.0, 2.0, 3.0, 3.0], "b": ["u", "v"] * 3}
    (axes,) = drawn(tmp_path, pictures, keys, {"x": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]}).axes
    np.testing.assert_array_equal(axes.lines[1].get_xydata(), [[1, 2], [2, 4], [3, 6]])
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["u", "v"]
    a, b = np.meshgrid([0.0, 1.0, 2.0, 3.0], [10.0, 20.0, 30.0, 40.0, 50.0])
    keys = {"a": a.ravel().tolist(), "b": b.ravel().tolist()}
    figure = drawn(tmp_path, pictures, keys, {"x": (a + b).ravel().tolist()})
    mesh = figure.axes[0].collections[0]
    np.testing.assert_array_equal(np.asarray(mesh.get_array()).reshape(5, 4), a + b)


def test_many_keys_give_points_and_nothing_gives_nothing(tmp_path: Path, pictures: dict[str, Any]) -> None:
    rng = np.random.default_rng(1)
    keys = {name: rng.random(9).tolist() for name in "abc"}
    figure = drawn(tmp_path, pictures, keys, {"x": rng.random(9).tolist(), "y": rng.random(9).tolist()})
    assert len(figure.axes) == 6
    np.testing.assert_array_equal(figure.axes[4].lines[0].get_xdata(), keys["b"])
    assert drawn(tmp_path, pictures, {"a": [1.0, 2.0]}, {"x": ["", ""]}) is None


def test_plot_makes_the_picture_again(swept: Path, granfabric: Callable, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(swept, out)
    before = (out / "results.png").read_bytes()
    (out / "results.png").unlink()
    result = granfabric("plot", out)
    assert result.code == 0 and (out / "results.png").read_bytes() == before, result.err
