"""The map of `granfabric verify`: names and keys, paths as the DEM goes them, files, reuse, processes, interruption."""

from __future__ import annotations

import json
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from granfabric.cases.commands.verify_map import MapRequest, run_map
from granfabric.cases.engine.choice import Choice
from granfabric.cases.engine.jobs import Ended, Job
from granfabric.cases.engine.local import Here, Processes
from granfabric.cases.records import files
from granfabric.cases.terminal.screen import Screen
from granfabric.cases.verify.dem_side import DemStore
from granfabric.cases.verify.map import tasks
from granfabric.cases.verify.map.closures import CLOSURES
from granfabric.cases.verify.map.compare import CURVE_COLUMNS, MAP_COLUMNS
from granfabric.cases.verify.map.materials import MATERIALS, chosen_materials
from granfabric.cases.verify.map.paths import DEFAULT_PATHS, MAP_PATHS, chosen_paths
from granfabric.cases.verify.map.sampling import ends
from granfabric.cases.verify.map.tasks import Done, MapStore, Task
from granfabric.cases.verify.paths import QUANTITIES
from granfabric.dem_ref.dynamics.packing import PackingOptions

PARTICLES = 200
PATHS = "constant_pressure,isotropic_falling"
MATERIALS_ASKED = "source,kt_kn_0.2"


def request(**changed: object) -> MapRequest:
    settings: dict = {"paths": PATHS, "materials": MATERIALS_ASKED, "particles": PARTICLES, "seeds": 2}
    settings["choice"] = Choice(workers=2)
    return MapRequest(**(settings | changed))


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a small map, made by two processes."""
    folder = tmp_path_factory.mktemp("map")
    assert run_map(request(), folder, Screen()).outcome == "finished"
    return folder


# names and keys


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--paths", "lateral_faling"), ("--paths: the path", "the nearest is 'lateral_stress_falling'", "loop")),
        (("--paths", "loop,,x"), ("the path 'x' is unknown",)),
        (("--paths", " , "), ("--paths names nothing (legal: constant_pressure",)),
        (("--materials", "frction_0.2"), ("--materials: the material", "the nearest is 'friction_0.2'", "kt_kn_0.5")),
        (("--set", "friction=0.3"), ("'friction' is not one of the keys of a packing", "diameter_ratio")),
        (("--set", "material.coordination2=4"), ("'material.coordination2' is unknown", "stiffness_ratio")),
        (("--set", "material.frction=0.3"), ("the nearest is 'friction'",)),
        (("--set", "material.friction=-1"), ("--set material.friction = -1 is outside its bounds [0, 1000]",)),
        (("--set", "material.friction=high"), ("material.friction = 'high' is not a number",)),
        (("--set", "material.seed=3"), ("--particles and --seeds",)),
        (("--set", "material.friction=1", "--set", "packing.x=1"), ("packing.x",)),
        (("--materials", "source,friction_0.2", "--set", "material.friction=0.2"), ("the same",)),
        (("--quick", "--particles", 10), ("--particles 10 is outside [200, 200000]",)),
        (("--quick", "--seeds", 0), ("--seeds 0 is outside [1, 100]",)),
        (("--quick", "--processes", 0), ("--workers 0 is outside [1, 1000]",)),
        (("--workers", 0), ("--workers 0 is outside [1, 1000]",)),
        (("--quick", "--workers", 2, "--scheduler", "tcp://x:1"), ("give one of them",)),
    ],
)
def test_what_is_not_legal_is_refused_in_a_sentence(
    granfabric: Callable, tmp_path: Path, arguments: tuple, said: tuple
) -> None:
    result = granfabric("verify", "-o", tmp_path / "out", *arguments)
    assert result.code == 2 and all(text in result.err for text in said), result.err
    assert not (tmp_path / "out").exists()


def test_what_is_not_said_is_the_comparison_without_a_map() -> None:
    assert not MapRequest(particles=300, seeds=3).is_map
    assert list(chosen_paths(None)) == list(DEFAULT_PATHS)
    assert [row.options for row in chosen_materials(None)] == [PackingOptions()]
    assert list(chosen_paths("all")) == list(MAP_PATHS) and set(DEFAULT_PATHS) < set(MAP_PATHS)
    assert list(chosen_paths("loop, cyclic,loop")) == ["loop", "cyclic"]
    quick = MapRequest(quick=True).plan()
    assert quick.particles == 400 and quick.seeds == [1, 2] and len(quick.paths) > 4 and len(quick.materials) > 2
    given = MapRequest(quick=True, particles=300, seeds=1, paths="loop", assignments=["material.friction=1"]).plan()
    assert (given.particles, given.seeds, list(given.paths), len(given.materials)) == (300, [1], ["loop"], 1)


def test_rows_differ_from_the_source_in_what_they_are_called() -> None:
    rows = {row.name: row.options for row in chosen_materials("all")}
    assert list(rows) == list(MATERIALS)
    assert (rows["friction_0.2"].friction, rows["friction_1"].friction) == (0.2, 1.0)
    assert (rows["kt_kn_0.5"].stiffness_ratio, rows["kt_kn_0.2"].stiffness_ratio) == (0.5, 0.2)
    assert (rows["kn_p_1e3"].stiffness_to_pressure, rows["kn_p_1e5"].stiffness_to_pressure) == (1e3, 1e5)
    assert (rows["size_ratio_2"].diameter_ratio, rows["size_ratio_4"].diameter_ratio) == (2.0, 4.0)
    own = chosen_materials("kt_kn_0.5,source", ["material.friction=0.3", "packing.distribution=bidisperse"])
    assert [row.name for row in own] == [
        f"{name}, friction=0.3, distribution=bidisperse" for name in ("kt_kn_0.5", "source")
    ]
    assert (own[0].options.friction, own[0].options.distribution) == (0.3, "bidisperse")
    assert (own[0].options.stiffness_ratio, own[1].options.stiffness_ratio) == (0.5, 1.0)


# paths

TURNS = {
    "constant_pressure": [(1.0, 0.302)],
    "constant_lateral_stress": [(1 / 0.698, 0.302)],
    "lateral_stress_falling": [(1 / 1.302, 0.302)],
    "isotropic_falling": [(0.5, 0.0), (0.3, 0.0)],
    "isotropic_to_tenth": [(0.5, 0.0), (0.3, 0.0), (0.1, 0.0)],
    "isotropic_rising": [(2.0, 0.0), (1.0, 0.0), (0.5, 0.0), (0.3, 0.0)],
    "pressure_halved": [(0.5, 0.3)],
    "pressure_doubled": [(1.0, 0.15), (2.0, 0.15), (1.0, 0.15)],
    "constant_volume": [(None, 0.302)],
    "loop": [(1.0, 0.2), (1.0, 0.0), (1.0, 0.2)],
    "cycles": [(1.0, 0.2), (1.0, 0.0), (1.0, 0.2), (1.0, 0.0), (1.0, -0.2)],
    "cyclic": [(1.0, 0.2), *[(1.0, 0.1), (1.0, 0.2)] * 5],
    "rotation": [(1.0, 0.2)] * 5,
    "rotation_small": [(1.0, 0.1)] * 5,
}
"""p over its first value and q/p, signed along y unless the axes turn, at the ends of the segments."""


def at_ends(history: dict, name: str) -> np.ndarray:
    """p over its first value, q/p and the angle of the major compression from y [degrees]; shape (nsegments, 3)."""
    places = ends(history, len(MAP_PATHS[name].segments))
    p, xx, yy, xy = (history[column][places] for column in ("p", "stress_xx", "stress_yy", "stress_xy"))
    signed = (xx - yy) / (2 * p)
    ratio = np.hypot(signed, xy / p) if MAP_PATHS[name].turning else signed
    angle = np.degrees(np.unwrap(np.arctan2(xy, (xx - yy) / 2))) / 2
    return np.column_stack([p / history["p"][0], ratio, angle])


def test_the_dem_goes_every_path_as_it_is_named(mapped: Path, tmp_path: Path) -> None:
    """p and q/p at the turns; axes that turn end where they began, and half way across."""
    store = tmp_path / "dem"
    shutil.copytree(mapped / "dem", store)
    (source,) = chosen_materials("source")
    assert set(TURNS) == set(MAP_PATHS)
    for name, turns in TURNS.items():
        task = Task(store, PARTICLES, source, 1, name)
        done = tasks.carry_out(task, lambda fraction: None, lambda: False)
        assert not done.failure and not done.values["reason"], (name, done)
        found = at_ends(done.values["history"], name)
        for (p, ratio), (at_p, at_ratio, _) in zip(turns, found, strict=True):
            assert p is None or at_p == pytest.approx(p, abs=6e-3), name
            assert at_ratio == pytest.approx(ratio, abs=3e-3), name
        history = done.values["history"]
        if name == "constant_volume":
            np.testing.assert_allclose(history["strain_xx"] + history["strain_yy"], 0.0, atol=1e-12)
            assert history["strain_yy"][-1] < 0.0
        if name == "lateral_stress_falling":
            np.testing.assert_allclose(history["stress_yy"], history["stress_yy"][0], rtol=6e-3)
        if MAP_PATHS[name].turning:
            np.testing.assert_allclose(found[:, 2] - found[0, 2], [0, 45, 90, 135, 180], atol=0.5)


# files


def test_files_of_a_map(mapped: Path, is_drawn: Callable) -> None:
    figures = {"map.png", *(f"map_{name}.png" for name in PATHS.split(","))}
    assert {file.name for file in mapped.iterdir()} == figures | {
        *("map.csv", "map_curves.csv", "map.md", "run.json", "run.log", "dem"),
        *("material_source.toml", "material_kt_kn_0.2.toml"),
    }
    assert all(is_drawn(mapped / name) for name in figures)
    columns = files.read_csv(mapped / "map.csv")
    assert tuple(columns) == MAP_COLUMNS
    keys = list(zip(*(columns[name] for name in ("material", "path", "closure", "quantity"))))
    assert keys == [
        (material, path, closure, quantity)
        for material in MATERIALS_ASKED.split(",")
        for path in PATHS.split(",")
        for closure in CLOSURES
        for quantity in QUANTITIES
    ]
    told = json.loads((mapped / "run.json").read_text())
    assert told["kind"] == "verify" and told["computed_now"] == 2 * 2 * 4 and told["processes"] == 2
    assert told["scene"]["materials"]["kt_kn_0.2"]["stiffness_ratio"] == 0.2
    assert told["scene"]["paths"] == PATHS.split(",") and told["scene"]["seeds"] == [1, 2]
    assert set(told["seconds"]) == {"packing", "inputs", "law", *PATHS.split(",")}
    assert set(told["measured"]) == set(MATERIALS_ASKED.split(","))
    text = (mapped / "map.md").read_text()
    assert all(f"({figure})" in text for figure in figures) and all(f"## {closure}" in text for closure in CLOSURES)


def test_the_map_is_made_of_the_curves(mapped: Path) -> None:
    """Largest error by size of model minus DEM over the places; DEM as the stored histories say."""
    table, curves = files.read_csv(mapped / "map.csv"), files.read_csv(mapped / "map_curves.csv")
    assert tuple(curves) == (*CURVE_COLUMNS, *CLOSURES)
    wanted = ("source", "constant_pressure", "coordination")
    of = [
        place
        for place, key in enumerate(zip(curves["material"], curves["path"], curves["quantity"]))
        if key == wanted
    ]
    dem, ratio = (np.array([curves[name][place] for place in of]) for name in ("dem", "stress_ratio"))
    histories = []
    for file in sorted((mapped / "dem").glob("source_*_constant_pressure.csv")):
        histories.append({name: np.array(values) for name, values in files.read_csv(file).items()})
    assert len(histories) == 2
    for history in histories:
        history["ratio"] = history["q"] / history["p"]
    found = np.mean([np.interp(ratio, history["ratio"], history["coordination"]) for history in histories], axis=0)
    np.testing.assert_allclose(dem, found, atol=2e-3)
    assert ratio[-1] == pytest.approx(0.302, abs=1e-3)
    for closure in CLOSURES:
        (row,) = [
            place
            for place, key in enumerate(zip(table["material"], table["path"], table["quantity"], table["closure"]))
            if key == (*wanted, closure)
        ]
        error = np.array([curves[closure][place] for place in of]) - dem
        largest = int(np.argmax(np.abs(error)))
        assert table["error"][row] == pytest.approx(error[largest], rel=1e-12)
        assert table["stress_ratio"][row] == pytest.approx(ratio[largest])
        assert table["error_percent"][row] == pytest.approx(100.0 * error[largest] / dem[0])
        assert table["scatter"][row] == pytest.approx(curves["scatter"][of[largest]])


def test_what_is_refused_is_told(mapped: Path) -> None:
    """Every closure and path of which the law got not to the end stands in table, page and record."""
    columns = files.read_csv(mapped / "map.csv")
    names = ("material", "path", "closure", "refused_packings", "refused_inputs", "message", "quantity")
    rows = [dict(zip(names, values)) for values in zip(*(columns[name] for name in names))]
    refused = {
        (row["material"], row["path"], row["closure"]): row["message"]
        for row in rows
        if row["refused_packings"] and row["quantity"] == "coordination"
    }
    curves = files.read_csv(mapped / "map_curves.csv")
    for closure in CLOSURES:
        missing = {
            (material, path, closure)
            for material, path, value in zip(curves["material"], curves["path"], curves[closure])
            if not np.isfinite(value)
        }
        assert missing == {key for key in refused if key[2] == closure}
    told = json.loads((mapped / "run.json").read_text())["refused"]
    page = (mapped / "map.md").read_text()
    for key, message in refused.items():
        (line,) = [line for line in told if line.startswith(", ".join(key) + ": ")]
        assert message and message in line and f"- {line}" in page and "refused at " in line


# used again, by whom ever


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the figures."""
    monkeypatch.setattr("granfabric.cases.verify.map.pictures.draw_map", lambda folder, result: [])


@pytest.mark.usefixtures("undrawn")
def test_a_map_again_by_one_process_computes_nothing_of_the_dem(mapped: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    shutil.copytree(mapped, again)
    stamps = {file: file.stat().st_mtime_ns for file in (again / "dem").iterdir()}
    record = run_map(request(choice=Choice(workers=1)), again, Screen())
    assert record.outcome == "finished" and record.details["computed_now"] == 0
    for name in ("map.csv", "map_curves.csv", "map.md"):
        assert (again / name).read_bytes() == (mapped / name).read_bytes()
    assert {file: file.stat().st_mtime_ns for file in (again / "dem").iterdir()} == stamps
    assert not list(again.glob("*.png"))  # those of the map before are not its own


def test_files_of_the_comparison_without_a_map_are_used(mapped: Path, tmp_path: Path) -> None:
    """On the source's material; and none of another one."""
    source, other = chosen_materials("source,kt_kn_0.2")
    store, plain = MapStore(mapped / "dem", PARTICLES, source, 1), DemStore(tmp_path, PARTICLES)
    shutil.copy(store.path("packing.npz"), plain.path(1, "packing.npz"))
    shutil.copy(store.path("constant_pressure.npz"), plain.path(1, "constant_pressure.npz"))
    here = MapStore(tmp_path, PARTICLES, source, 1)
    assert not here.packing(lambda fraction: None, lambda: False).computed
    assert not here.run("constant_pressure", lambda fraction: None, lambda: False).computed
    assert MapStore(tmp_path, PARTICLES, other, 1).kept_packing() is None
    assert MapStore(tmp_path, PARTICLES + 1, source, 1).kept_packing() is None


@pytest.mark.usefixtures("undrawn")
def test_an_interrupted_map_goes_on_to_the_same_numbers(
    mapped: Path, granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C within a path: the run of the DEM is kept half way, and finished by the same command."""
    again = tmp_path / "again"
    shutil.copytree(mapped / "dem", again / "dem")
    shutil.copy(mapped / "run.json", again)
    for file in (again / "dem").glob("source_*_seed_1_*_constant_pressure.*"):
        file.unlink()
    arguments = ("verify", "-o", again, "--particles", PARTICLES, "--seeds", 2, "--paths", PATHS)
    arguments = (*arguments, "--materials", MATERIALS_ASKED, "--processes", 1)
    run = MapStore.run

    def interrupted(store: MapStore, name: str, report: Callable, stop: Callable) -> Done:
        asked = [0]

        def stop_soon() -> bool:
            asked[0] += 1
            if asked[0] == 20:
                signal.raise_signal(signal.SIGINT)
            return stop()

        return run(store, name, report, stop_soon)

    with monkeypatch.context() as patch:
        patch.setattr(MapStore, "run", interrupted)
        result = granfabric(*arguments)
    assert result.code == 1 and "goes on from here" in result.out
    assert json.loads((again / "run.json").read_text())["outcome"] == "stopped"
    assert not (again / "map.csv").exists()
    (begun,) = (again / "dem").glob("source_*_seed_1_*_constant_pressure.npz")
    assert begun.is_file()
    assert granfabric(*arguments).code == 0
    assert json.loads((again / "run.json").read_text())["computed_now"] == 1
    assert (again / "map.csv").read_bytes() == (mapped / "map.csv").read_bytes()


@pytest.mark.usefixtures("undrawn")
def test_a_packing_that_fails_leaves_the_others(
    mapped: Path, granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(mapped, tmp_path / "out")
    packing = MapStore.packing

    def failing(store: MapStore, report: Callable, stop: Callable) -> Done:
        if store.material.name != "source":
            raise tasks.PackingError("it is not at rest")
        return packing(store, report, stop)

    monkeypatch.setattr(MapStore, "packing", failing)
    arguments = ("--paths", "isotropic_falling", "--materials", MATERIALS_ASKED, "--processes", 1)
    result = granfabric("verify", "-o", tmp_path / "out", "--particles", PARTICLES, "--seeds", 1, *arguments)
    assert result.code == 1 and "failed: kt_kn_0.2, seed 1: it is not at rest" in result.out
    columns = files.read_csv(tmp_path / "out" / "map.csv")
    by_material = dict(zip(columns["material"], zip(columns["packings"], columns["message"])))
    assert by_material["source"][0] == 1 and by_material["kt_kn_0.2"] == (0, "kt_kn_0.2, seed 1: it is not at rest")
    assert "no DEM" in (tmp_path / "out" / "map.md").read_text()


# processes


def test_tasks_are_stopped_between_and_within(mapped: Path) -> None:
    (source,) = chosen_materials("source")
    todo = [Task(mapped / "dem", PARTICLES, source, seed, tasks.PACKING).job for seed in (1, 2)]
    found: list[Task] = []

    def follow(job: Job, ended: Ended) -> list[Job]:
        found.append(job.arguments[0])
        return [Task(mapped / "dem", PARTICLES, source, 1, tasks.INPUTS).job] if len(found) == 1 else []

    Here().carry_out(todo, follow, lambda at_work: None, lambda: False)
    assert [(task.seed, task.what) for task in found] == [(1, "packing"), (1, "inputs"), (2, "packing")]
    found.clear()
    Here().carry_out(todo, follow, lambda at_work: None, lambda: bool(found))
    assert len(found) == 1


def test_two_processes_stop_a_path_half_way(tmp_path: Path) -> None:
    """Asked from here; what was reached is kept there, and the rest is not begun."""
    (source,) = chosen_materials("source", ["material.friction=0.1"])
    done: dict[str, Done] = {}
    todo = [Task(tmp_path, PARTICLES, source, 1, tasks.PACKING).job]
    names = ["cyclic", *DEFAULT_PATHS * 20]
    asked: list[bool] = []

    count = [0]

    def follow(job: Job, ended: Ended) -> list[Job]:
        count[0] += 1
        (task,) = job.arguments
        done[task.what] = ended.value
        if task.what != tasks.PACKING:
            return []
        return [Task(tmp_path, PARTICLES, source, 1, name).job for name in names]

    def advance(at_work: dict[str, float]) -> None:
        if any(fraction > 0.0 for text, fraction in at_work.items() if "cyclic" in text):
            asked.append(True)

    Processes(2).carry_out(todo, follow, advance, lambda: bool(asked))
    assert done["cyclic"].stopped and not done["cyclic"].failure
    assert MapStore(tmp_path, PARTICLES, source, 1).path("cyclic.npz").is_file()
    assert count[0] < 40
