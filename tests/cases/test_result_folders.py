"""Whose results a folder holds, one run at a time, nothing removed too early; the log beside the results."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from mutations import one_sentence
from test_files_and_words import FIELD, POINT

from granfabric.cases.commands import convergence, run
from granfabric.cases.errors import InputError
from granfabric.cases.records import files, lock
from granfabric.cases.scene.owner import Owner, is_another
from granfabric.cases.terminal.screen import Screen

OTHER = POINT.replace("a point", "another point")


def write(folder: Path, name: str, text: str) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(text)
    return folder / name


def content(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


# whose results


@pytest.fixture
def finished(granfabric: Callable, tmp_path: Path) -> Path:
    """A result of `first.toml`."""
    file = write(tmp_path, "first.toml", POINT)
    assert granfabric("point", file, "-o", tmp_path / "out").code == 0
    return tmp_path / "out"


def test_results_of_another_scene_are_not_replaced(granfabric: Callable, finished: Path, tmp_path: Path) -> None:
    before = content(finished)
    others = [
        ("point", write(tmp_path, "second.toml", POINT)),
        ("point", write(tmp_path / "copy", "first.toml", POINT)),  # of the same name and title, but both are there
        ("point", "p_constant"),
        ("run", write(tmp_path, "field.toml", FIELD)),
        ("dem", "dem_biaxial"),
        ("convergence", "hole_in_plate"),
    ]
    for command, scene in others:
        result = granfabric(command, scene, "-o", finished)
        assert result.code == 2 and one_sentence(result.err), result.err
        for part in ("holds a finished run of another scene, point 'first'", "first.toml)", "-o", "--overwrite"):
            assert part in result.err
        assert content(finished) == before, command
    result = granfabric("verify", "-o", finished)
    assert result.code == 2 and "--overwrite" in result.err and content(finished) == before
    result = granfabric("cost", "mesh", "--quick", "-o", finished)
    assert result.code == 2 and "--overwrite" in result.err and content(finished) == before
    assert granfabric("point", tmp_path / "second.toml", "-o", finished, "--overwrite").code == 0
    assert json.loads((finished / "run.json").read_text())["name"] == "second"


def test_the_same_scene_with_other_values_is_replaced(granfabric: Callable, finished: Path, tmp_path: Path) -> None:
    file = tmp_path / "first.toml"
    assert granfabric("point", file, "-o", finished, "--set", "material.coordination=3.9").code == 0
    file.write_text(OTHER.replace("4.06", "4.0"))
    assert granfabric("point", file, "-o", finished).code == 0
    # through another path to the same file, and as the scene in the folder itself
    (tmp_path / "link.toml").symlink_to(file)
    assert granfabric("point", tmp_path / "link.toml", "-o", finished).code == 0
    assert granfabric("point", finished / "scene.toml", "-o", finished).code == 0


def test_a_project_that_has_moved_keeps_its_folders(granfabric: Callable, finished: Path, tmp_path: Path) -> None:
    (tmp_path / "new").mkdir()
    shutil.move(tmp_path / "first.toml", tmp_path / "new" / "first.toml")
    shutil.move(finished, tmp_path / "new" / "out")
    assert granfabric("point", tmp_path / "new" / "first.toml", "-o", tmp_path / "new" / "out").code == 0
    (tmp_path / "new" / "first.toml").unlink()
    other = write(tmp_path / "third", "first.toml", OTHER)
    assert granfabric("point", other, "-o", tmp_path / "new" / "out").code == 2


def test_owners(tmp_path: Path) -> None:
    file = write(tmp_path, "a.toml", "")
    owner = Owner("field", "a", "A", file)
    record = {"kind": "field", "name": "a", "scene_file": str(file), "scene": {"title": "A"}}
    out = tmp_path / "out"
    assert not is_another(out, record, owner)
    assert not is_another(out, {**record, "name": "b"}, owner)  # the file counts
    assert is_another(out, {**record, "kind": "point"}, owner)
    assert is_another(out, {**record, "scene_file": str(write(tmp_path, "b.toml", ""))}, owner)
    for gone in ({"scene_file": str(tmp_path / "gone.toml")}, {"scene_file": None}):
        assert not is_another(out, {**record, **gone}, owner)
        assert is_another(out, {**record, **gone, "name": "b"}, owner)
        assert is_another(out, {**record, **gone, "scene": {"title": "B"}}, owner)
    assert is_another(out, {"kind": "field"}, owner) and is_another(out, {}, owner)
    comparison = {"kind": "verify", "name": "verify", "scene": {"title": "T"}}
    assert not is_another(out, comparison, Owner("verify", "verify", "T"))


@pytest.mark.parametrize(
    "change",
    [
        ("--set", "material.coordination=9.0"),
        ("--set", "mesh.rectangle.nx=0"),
        ("--set", "stage.1.displacement.0.boundary=tpo"),
        ("--set", 'stage.1.name="initial"'),
        ("--set", "effects.sliding=true"),
        ("--set", "mesh.file=none.msh"),
    ],
)
def test_old_results_stay_until_the_new_scene_has_been_checked(
    granfabric: Callable, tmp_path: Path, change: tuple[str, ...]
) -> None:
    file, out = write(tmp_path, "field.toml", FIELD), tmp_path / "out"
    assert granfabric("run", file, "-o", out).code == 0
    before = content(out)
    for options in ((), ("--overwrite",)):
        assert granfabric("run", file, "-o", out, *change, *options).code == 2
        assert content(out) == before


@pytest.mark.parametrize(
    ("command", "text", "change"),
    [
        ("point", POINT, "initial.state={coordination=1.0}"),
        ("dem", "[[path]]\nloading = 'isotropic'\npressure_ratio = 2.0\n", "path.0.loading=rotation"),
    ],
)
def test_old_results_stay_in_other_commands(
    granfabric: Callable, tmp_path: Path, command: str, text: str, change: str
) -> None:
    file, out = write(tmp_path, "own.toml", text), tmp_path / "out"
    out.mkdir()
    owner = {"kind": command, "name": "own", "scene_file": str(file), "outcome": "finished", "scene": {"title": "own"}}
    files.write_json(out / "run.json", {"program": "granfabric", **owner})
    files.write_text(out / "history.csv", "step\n")
    before = content(out)
    assert granfabric(command, file, "-o", out, "--set", change).code == 2
    assert content(out) == before


# what is removed when a folder is used again


WRITTEN = re.compile(r"[\w{}.-]*\.(png|svg|pdf|csv|md|txt|log|json|toml|npz|vtu|pvd|part)")
ELSEWHERE = {
    "FILE.png": "a placeholder in the help",
    "FILE.csv": "a placeholder in the help",
    "{}_mesh.png": "where the user asks for it",
    "schema.json": "beside the scenes",
    "notes.json": "kept runs of the DEM",
    "map_{}.png": "figures of the paths of a map, see files.OF_MAP",
    "material_{}.toml": "measured inputs of the materials of a map, see files.OF_MAP",
    "{}.toml": "shipped materials",
    "{}.csv": "tables of studies of cost, histories of kept runs of the DEM",
    "{}.png": "pictures of studies of cost",
    "{}.npz": "kept runs of the DEM",
    "cost.json": "record of the studies of cost",
    "cost.md": "page of the studies of cost",
    "{}.pvd": "a series, see files.SERIES",
    "{}_{}.vtu": "a series, see files.SERIES",
    "probe_{}.csv": "a pattern of its own",
    "{}_disks_seed_{}_{}.npz": "packings in a store of their own",
    "{}_inputs.json": "measured inputs of kept packings",
}
"""Names in the code that are no files of a run in its result folder, and what they are."""


def names_of_files(source: str) -> set[str]:
    """Names of files that code spells, with {} for what is put in; no docstrings, and no suffix alone."""
    tree = ast.parse(source)
    texts, parts = set(), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            parts.add(node.value)
        if isinstance(node, ast.JoinedStr):
            parts.update(node.values)
            texts.add("".join(v.value if isinstance(v, ast.Constant) else "{}" for v in node.values))  # type: ignore
    texts |= {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in parts
    }
    return {text for text in texts if WRITTEN.fullmatch(text) and not text.startswith(".")}


def test_every_name_of_a_file_in_the_code_is_one_of_a_run_or_known_not_to_be() -> None:
    """A command that writes another file has to say so where the files of a run are listed."""
    assert names_of_files('"doc.png"\nopen(f"{a}_{b:05d}.vtu"); x = "a.png"; y = ".csv"') == {"{}_{}.vtu", "a.png"}
    sources = [file for file in Path(files.__file__).parents[1].rglob("*.py") if file != Path(files.__file__)]
    spelled = set().union(*(names_of_files(file.read_text(encoding="utf-8")) for file in sources))
    assert spelled - set(files.OWN_FILES) == set(ELSEWHERE)
    assert len(set(files.OWN_FILES)) == len(files.OWN_FILES)


PLATE = ("mesh.plate_with_hole.n_radial=2", "mesh.plate_with_hole.n_around=4", "stage.1.increments=1")
BREAKING = ("stage.1.displacement.0.value=-0.1", "solver.smallest_factor=0.5", "solver.first_factor=0.5")
COMMANDS = {
    "point": (["point", "{point}"], {"history.csv", "microvariables.png", "fabric_decomposition.png", "scene.toml"}),
    "run": (["run", "hole_in_plate", *PLATE], {"overview.png", "mesh_error.vtu", "closed_form.csv", "closed_form.png"}),
    "run that fails": (
        ["run", "{field}", *BREAKING],
        {"history.csv", "result.pvd", "result_0000.vtu", "points.pvd", "points_0000.vtu", "failed_point.toml"},
    ),
    "convergence": (["convergence", "hole_in_plate", *PLATE], {"convergence.csv", "convergence.png"}),
    "dem": (
        ["dem", "dem_biaxial", "packing.particles=100", "path.0.stress_ratio=0.02", "output.every=2"],
        {"packing.npz", "checkpoint.npz", "material.toml", "packing.png", "distributions.png", "particles.pvd"},
    ),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_nothing_of_a_run_stays_when_its_folder_is_used_again(
    granfabric: Callable, tmp_path: Path, name: str
) -> None:
    """Whatever a command has written: next to the next result it would look like a part of it."""
    (command, scene, *changes), must = COMMANDS[name]
    file, out = tmp_path / "own.toml", tmp_path / "out"
    file.write_text(FIELD if scene == "{field}" else POINT.replace("pictures = false", "pictures = true"))
    options = [part for change in changes for part in ("--set", change)]
    options += ["--refine", "1,2"] if command == "convergence" else []
    granfabric(command, file if "{" in scene else scene, "-o", out, *options)
    assert must | {"run.json", "run.log"} <= set(content(out))
    (out / "notes.txt").write_text("mine")
    files.prepare_output(out, overwrite=True)
    assert set(content(out)) == {"notes.txt"}


# one run at a time


HOLDING = """
import sys, time
from pathlib import Path
from granfabric.cases.records import lock
with lock.held(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def busy(finished: Path) -> Iterator[tuple[Path, subprocess.Popen]]:
    """The folder while another process is at work in it."""
    process = subprocess.Popen([sys.executable, "-c", HOLDING, str(finished)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    yield finished, process
    process.kill()
    process.communicate()


def test_a_folder_at_work_is_refused_and_can_be_drawn(
    granfabric: Callable, busy: tuple, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, process = busy
    before = content(folder)
    for options in ((), ("--overwrite",)):
        result = granfabric("point", tmp_path / "first.toml", "-o", folder, *options)
        assert result.code == 2 and one_sentence(result.err)
        assert f"another run is at work in the output folder {str(folder)!r} (process {process.pid} on" in result.err
        assert content(folder) == before
    for command in (("dem", "dem_biaxial", "--resume"), ("verify",), ("cost", "mesh", "--quick", "--overwrite")):
        assert granfabric(*command, "-o", folder).code == 2 and content(folder) == before
    # nor is anything computed first
    monkeypatch.setattr(convergence, "solve_level", lambda *arguments: pytest.fail("solved for nothing"))
    result = granfabric("convergence", "hole_in_plate", "--overwrite", "-o", folder)
    assert result.code == 2 and "another run is at work" in result.err and content(folder) == before
    assert granfabric("plot", folder).code == 0
    process.kill()
    process.wait()
    assert (folder / lock.NAME).is_file()  # nobody tidied up
    assert granfabric("point", tmp_path / "first.toml", "-o", folder).code == 0
    assert not (folder / lock.NAME).exists()


def test_two_runs_at_once(tmp_path: Path) -> None:
    """Two processes begin together in a new folder: one runs to its end, the other is refused or comes after it."""
    slow = FIELD.replace("increments = 1\ndisplacement", "increments = 60\ndisplacement")
    file, out = write(tmp_path, "own.toml", slow), tmp_path / "out"
    command = [sys.executable, "-m", "cases", "run", str(file), "-o", str(out)]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    said = [process.communicate()[1] for process in both]
    codes = [process.returncode for process in both]
    assert 0 in codes and set(codes) <= {0, 2}, said
    assert all("another run is at work" in text for text, code in zip(said, codes) if code == 2)
    assert json.loads((out / "run.json").read_text())["outcome"] == "finished"
    assert not (out / lock.NAME).exists()


def test_resuming_what_is_at_work_is_refused(granfabric: Callable, tmp_path: Path) -> None:
    file, out = write(tmp_path, "field.toml", FIELD), tmp_path / "out"
    assert granfabric("run", file, "-o", out).code == 0
    refused = []

    def other() -> None:
        # flock tells two openings of a file apart, also in one process
        with pytest.raises(InputError, match="another run is at work") as caught, lock.held(out):
            pass
        refused.append(caught)

    with lock.held(out):
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
    assert refused
    with lock.held(out):
        pass


@pytest.mark.parametrize("with_flock", [True, False])
def test_locks_of_the_dead_are_taken_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, with_flock: bool) -> None:
    if not with_flock:
        monkeypatch.setattr(lock, "fcntl", None)
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    import socket

    note = {"process": dead.pid, "host": socket.gethostname(), "since": "yesterday"}
    for text in (json.dumps(note), "", "{", "[]", json.dumps({**note, "process": "x"})):
        (tmp_path / lock.NAME).write_text(text)
        lock.refuse_held(tmp_path)
        with lock.held(tmp_path):
            assert json.loads((tmp_path / lock.NAME).read_text())["process"] == os.getpid()
            with lock.command(), pytest.raises(InputError, match="another run"), lock.held(tmp_path):
                pass
        assert not (tmp_path / lock.NAME).exists()
    if not with_flock:  # a process on another computer cannot be asked
        (tmp_path / lock.NAME).write_text(json.dumps({**note, "host": "elsewhere"}))
        for attempt in (lock.refuse_held, lambda folder: lock.held(folder).__enter__()):
            with pytest.raises(InputError, match=r"on elsewhere.*; if none is, remove \.granfabric\.lock"):
                attempt(tmp_path)


def test_within_a_command_a_folder_stays_held(tmp_path: Path) -> None:
    with lock.command():
        with lock.held(tmp_path):
            pass
        assert (tmp_path / lock.NAME).is_file()
        lock.refuse_held(tmp_path)  # our own
        with lock.held(tmp_path), lock.held(tmp_path / "."):
            pass
        assert (tmp_path / lock.NAME).is_file()
    assert not (tmp_path / lock.NAME).exists()


# log, voice


def test_the_log_holds_what_the_screen_said(granfabric: Callable, tmp_path: Path) -> None:
    file, out = write(tmp_path, "field.toml", FIELD), tmp_path / "out"
    loud = granfabric("run", file, "-o", out)
    assert loud.code == 0 and not loud.err
    stamp = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}\+00:00) (.*)")
    lines = [stamp.fullmatch(line) for line in (out / "run.log").read_text().splitlines()]
    assert all(lines)
    said = [line[2] for line in lines if line]
    assert said[0] == f"granfabric run {file} -o {out}"
    assert said[1].startswith("python ") and "numba " in said[1]
    for line in loud.out.splitlines():
        assert line.rstrip() in map(str.rstrip, said), line
    quiet = granfabric("run", file, "-o", out, "-q")
    assert (quiet.code, quiet.out, quiet.err) == (0, "", "")
    assert "means and extremes" in (out / "run.log").read_text()
    assert granfabric("-q", "run", file, "-o", out).out == ""
    more = granfabric("run", file, "-o", out, "-v")
    assert "field: 50%, initial: step 1" in more.out and "linear solver" in more.out
    assert granfabric("-v", "run", file, "-o", out).out.count("linear solver: ") == more.out.count("linear solver: ")
    assert "linear solver: " not in granfabric("run", file, "-o", out).out
    assert granfabric("run", file, "-q", "-v").code == 2


def test_quiet_runs_still_warn_and_say_why_they_failed(granfabric: Callable, tmp_path: Path) -> None:
    file, out = write(tmp_path, "field.toml", FIELD), tmp_path / "out"
    pull = ("--set", "stage.0.pressure.0.value=-100e3")
    early = ("--set", "solver.smallest_factor=0.2", "--set", "integration.maximum_substeps=5")
    result = granfabric("run", file, "-o", out, *pull, *early, "-q")
    lines = result.out.splitlines()
    assert result.code == 1 and all(line.startswith(("warning: ", "failed in stage")) for line in lines)
    assert [line.split()[0] for line in lines].count("failed") == 1 and "warning: stage 1" in result.out


def test_an_error_after_the_start_is_in_the_log(
    granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, out = write(tmp_path, "field.toml", FIELD), tmp_path / "out"

    def broken(*arguments: object, **options: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(run, "FieldRecorder", broken)
    result = granfabric("run", file, "-o", out)
    assert result.code == 1 and "No space" in result.err
    assert "No space left on device" in (out / "run.log").read_text()


def test_a_log_that_cannot_be_written_ends_no_run(granfabric: Callable, tmp_path: Path) -> None:
    screen = Screen(quiet=True)
    screen.keep_log(tmp_path / "nowhere" / "run.log", {"python": "3"})
    screen.say("something")
    assert not (tmp_path / "nowhere").exists()


def test_a_resumed_run_goes_on_with_its_log(
    granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, out = write(tmp_path, "field.toml", FIELD), tmp_path / "out"
    from granfabric.cases.terminal.interruption import InterruptRequest

    with monkeypatch.context() as patch:
        rows = out / "history.csv"
        patch.setattr(InterruptRequest, "__call__", lambda self: rows.is_file() and rows.read_text().count("\n") > 2)
        granfabric("run", file, "-o", out)
    first = (out / "run.log").read_text()
    assert granfabric("run", file, "-o", out, "--resume").code == 0
    whole = (out / "run.log").read_text()
    assert whole.startswith(first) and "--resume" in whole and "going on after step 1" in whole


def test_version(granfabric: Callable) -> None:
    result = granfabric("--version")
    assert result.code == 0 and re.fullmatch(r"granfabric \d+\.\d+\S*\n", result.out)


@pytest.mark.parametrize(
    ("typed", "expected", "absent"),
    [
        ("run hole", "hole_in_plate", "p_constant"),
        ("point p_", "p_constant", "biaxial"),
        ("point uni", "unique.toml", "notes.txt"),
        ("dem dem_l", "dem_lateral", "p_constant"),
        ("effects str", "strip_footing", "biaxial"),
        ("sce", "scenes", "point"),
    ],
)
def test_completion_of_the_shell(
    typed: str, expected: str, absent: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, "unique.toml", POINT)
    write(tmp_path, "notes.txt", "")
    words = f"granfabric {typed}"
    environment = {
        **os.environ,
        "_GRANFABRIC_COMPLETE": "complete_bash",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split()) - 1),
    }
    home = str(Path(lock.__file__).parent.parent)
    program = f"import sys; sys.path.insert(0, {home!r}); sys.argv[0] = 'granfabric'\n"
    program += "from granfabric.cases.commands.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False, env=environment, cwd=tmp_path
    )
    found = done.stdout.split()
    assert expected in found and absent not in found, (done.stdout, done.stderr)


# time


class SlowKernels:
    """Kernels that another process compiles while this one waits."""

    running = True

    def wait(self, stop: Callable[[], bool]) -> float:
        """Wait."""
        since = time.perf_counter()
        time.sleep(0.4)
        return time.perf_counter() - since


def test_the_time_in_all_holds_its_parts(tmp_path: Path) -> None:
    """Also of a first run, in which compiling takes most of it."""
    from granfabric.cases.scene.reader import load

    file = write(tmp_path, "field.toml", FIELD)
    record = run.run_field(load(str(file)), tmp_path / "out", Screen(quiet=True), kernels=SlowKernels())  # type: ignore[arg-type]
    timing = json.loads((tmp_path / "out" / "run.json").read_text())["timing"]
    assert timing["compilation"] >= 0.4
    whole = ("compilation", "run", "audit", "mesh_error")
    assert sum(timing[name] for name in whole) <= record.timing["total"]
    phases = ("setup", "law", "assembly", "state", "boundary", "factorise", "solve", "output")
    assert sum(timing[name] for name in phases) <= timing["run"]


def test_phases_leave_compiling_out() -> None:
    """The clock of a run stands still while kernels are compiled, so that they do not count twice."""
    from granfabric.fem.accounting import Accounting

    now = [0.0]
    accounting = Accounting(clock=lambda: now[0])
    with accounting.phase("law"):
        now[0] += 3.0
    assert accounting.seconds["law"] == 3.0 and "clock" not in accounting.counters()
    accounting.continue_from({**accounting.counters(), "steps": 4}, {**accounting.seconds})
    assert accounting.steps == 4 and accounting.seconds["law"] == 6.0


def test_a_foreign_log_is_no_result(granfabric: Callable, tmp_path: Path) -> None:
    """A folder in which only `run.log` lies is somebody else's; one with a lock that nobody holds is free."""
    file = write(tmp_path, "first.toml", POINT)
    log = write(tmp_path / "mine", "run.log", "of another program")
    result = granfabric("point", file, "-o", tmp_path / "mine")
    assert result.code == 2 and "not a result" in result.err and log.read_text() == "of another program"
    write(tmp_path / "free", lock.NAME, "")
    assert granfabric("point", file, "-o", tmp_path / "free").code == 0
