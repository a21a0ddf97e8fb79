"""Independent pieces of work in processes of this machine: what comes of them, loss of a process, stopping, threads."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from granfabric.cases.engine import kernels, machine
from granfabric.cases.engine.choice import Choice
from granfabric.cases.engine.jobs import Ended, Engine, Job, WorkerLost
from granfabric.cases.engine.local import Here, Processes
from granfabric.cases.errors import InputError
from granfabric.cases.terminal.screen import Screen


def job(name: str, *arguments: Any, key: str = "") -> Job:
    return Job(key or name, key or name, f"engine_jobs:{name}", arguments)


def carried_out(
    engine: Engine, jobs: Sequence[Job], more: Callable[[Job, Ended], list[Job]] | None = None, **options: Any
) -> dict[str, Ended]:
    """What came of each job."""
    found: dict[str, Ended] = {}

    def follow(done: Job, ended: Ended) -> list[Job]:
        found[done.key] = ended
        return more(done, ended) if more is not None else []

    advance = options.get("advance", lambda at_work: None)
    engine.carry_out(jobs, follow, advance, options.get("stop", lambda: False))
    return found


@pytest.mark.parametrize("engine", [Here(), Processes(1), Processes(3)], ids=["here", "one", "three"])
def test_what_comes_of_jobs_does_not_depend_on_who_does_them(engine: Engine) -> None:
    jobs = [job("squared", number, key=f"square {number}") for number in range(7)]
    found = carried_out(
        engine,
        [*jobs, job("refused", 3), job("no_disk", 1)],
        lambda done, ended: [job("squared", ended.value, key="next")] if done.key == "square 3" else [],
    )
    assert {key: found[key].value for key in found if key.startswith("square")} == {
        f"square {number}": number * number for number in range(7)
    }
    assert found["next"].value == 81
    assert "3 is odd" in str(found["refused"].error) and isinstance(found["no_disk"].error, OSError)
    assert found["no_disk"].error.errno == 28


def test_jobs_that_follow_come_before_those_that_wait() -> None:
    order: list[str] = []

    def more(done: Job, ended: Ended) -> list[Job]:
        order.append(done.key)
        return [job("squared", 1, key="next")] if done.key == "a" else []

    carried_out(Here(), [job("squared", 1, key="a"), job("squared", 1, key="b")], more)
    assert order == ["a", "next", "b"]


def test_a_process_that_is_killed_costs_its_job_only(tmp_path: Path) -> None:
    """Killed by itself once, always, and by the system from outside while it works."""
    ended: list[int] = []

    def advance(at_work: dict[str, float]) -> None:
        mark = tmp_path / "pid"
        if not ended and mark.is_file() and mark.read_text():
            ended.append(int(mark.read_text()))
            os.kill(ended[0], signal.SIGKILL)

    jobs = [job("patient", str(tmp_path)), job("killed_once", str(tmp_path)), job("killed_always")]
    found = carried_out(Processes(2), [*jobs, *(job("squared", n, key=str(n)) for n in range(4))], advance=advance)
    assert ended and found["patient"].value == "again" and found["killed_once"].value == "done"
    assert isinstance(found["killed_always"].error, WorkerLost)
    assert "killed_always: the process at work on it ended by itself (signal 9" in str(found["killed_always"].error)
    assert [found[str(n)].value for n in range(4)] == [0, 1, 4, 9]


def test_stopping_asks_what_is_at_work_and_begins_nothing(tmp_path: Path) -> None:
    seen: list[dict[str, float]] = []

    def advance(at_work: dict[str, float]) -> None:
        if len(list(tmp_path.iterdir())) == 2:
            seen.append(dict(at_work))

    jobs = [job("waiting", str(tmp_path), str(n), key=str(n)) for n in range(6)]
    found = carried_out(Processes(2), jobs, advance=advance, stop=lambda: len(seen) > 5)
    assert {key: ended.value for key, ended in found.items()} == {"0": "stopped", "1": "stopped"}
    assert any(fraction == 0.5 for at_work in seen for fraction in at_work.values())
    for file in tmp_path.iterdir():  # nobody is left behind
        with pytest.raises(ProcessLookupError):
            os.kill(int(file.read_text()), 0)


def test_a_second_interruption_ends_all_processes_at_once(tmp_path: Path) -> None:
    def advance(at_work: dict[str, float]) -> None:
        if len(list(tmp_path.iterdir())) == 2 and all(file.read_text() for file in tmp_path.iterdir()):
            raise KeyboardInterrupt

    jobs = [job("waiting", str(tmp_path), str(n), key=str(n)) for n in range(2)]
    with pytest.raises(KeyboardInterrupt):
        carried_out(Processes(2), jobs, advance=advance)
    for file in tmp_path.iterdir():
        with pytest.raises(ProcessLookupError):
            os.kill(int(file.read_text()), 0)


def test_each_process_takes_one_thread_or_as_many_as_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    assert carried_out(Processes(1), [job("threads")])["threads"].value == (1, "1")
    assert carried_out(Processes(1, threads=2), [job("threads")])["threads"].value == (2, "1")
    assert os.environ["NUMBA_NUM_THREADS"] == "2"
    assert carried_out(Here(), [job("threads")])["threads"].value[0] == 1


def test_the_script_that_begins_processes_is_not_run_again(tmp_path: Path) -> None:
    """Without the usual guard: what stands in the script is done once."""
    import subprocess

    script = tmp_path / "script.py"
    script.write_text(
        "print('once')\n"
        "from granfabric.cases.engine.local import Processes\n"
        "from granfabric.cases.engine.jobs import Job\n"
        "found = []\n"
        "jobs = [Job(str(n), str(n), 'engine_jobs:squared', (n,)) for n in range(3)]\n"
        "Processes(2).carry_out(jobs, lambda job, ended: found.append(ended.value) or [], lambda work: None, "
        "lambda: False)\n"
        "print(sorted(found))\n"
    )
    settings = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    done = subprocess.run([sys.executable, script], env=settings, capture_output=True, text=True, check=True)
    assert done.stdout.split("\n")[:2] == ["once", "[0, 1, 4]"], done.stdout + done.stderr


def test_kernels_are_compiled_once_a_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two that come at the same time one compiles; the other waits for it, or does what nobody is at."""
    made: list[str] = []
    begun = threading.Barrier(2, timeout=10.0)

    def slow(group: str) -> Callable[[], None]:
        def compile_it() -> None:
            begun.wait()  # both compile at the same time, and not the same
            made.append(group)

        return compile_it

    monkeypatch.setattr(kernels, "GROUPS", {"a": slow("a"), "b": slow("b")})
    monkeypatch.setattr(kernels, "mark", lambda group: tmp_path / f"mark-{group}")
    monkeypatch.setattr(kernels, "_ready", set())
    monkeypatch.setattr(machine.tempfile, "gettempdir", lambda: str(tmp_path))
    assert kernels.missing(["a", "b"]) == ["a", "b"]
    done: list[list[str]] = []
    both = [threading.Thread(target=lambda: done.append(kernels.make_ready(["a", "b"]))) for _ in range(2)]
    for thread in both:
        thread.start()
    for thread in both:
        thread.join(20.0)
    assert sorted(made) == ["a", "b"] and sorted(group for each in done for group in each) == ["a", "b"]
    assert kernels.missing(["a", "b"]) == []


def test_every_group_of_kernels_is_one_that_can_be_called() -> None:
    for group in ("mean_field", "shifted_distribution", "host", "dem"):
        assert kernels.make_ready([group]) in ([], [group])
        assert kernels.mark(group).is_file()


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        (Choice(workers=0), "--workers 0 is outside"),
        (Choice(workers=1001), r"--workers 1001 is outside \[1, 1000\]"),
        (Choice(threads=0), r"--threads 0 is outside \[1, "),
        (Choice(threads=machine.cores() + 1), "this process may use"),
        (Choice(workers=2, scheduler="tcp://x:1"), "give one of them"),
    ],
)
def test_what_is_not_legal_is_refused(choice: Choice, said: str) -> None:
    with pytest.raises(InputError, match=said):
        choice.check()


def test_the_engine_is_the_smallest_that_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("granfabric.cases.engine.choice.cores", lambda: 8)

    def engine_of(choice: Choice, jobs: int | None = None) -> Engine:
        with choice.engine(tmp_path, Screen(), lambda: False, jobs) as engine:
            return engine

    assert engine_of(Choice()).workers == 8 and engine_of(Choice(threads=4)).workers == 2
    assert engine_of(Choice(), jobs=3).workers == 3
    assert isinstance(engine_of(Choice(), jobs=1), Here) and isinstance(engine_of(Choice(workers=1)), Here)


def test_versions_that_differ_are_named() -> None:
    here = machine.versions()
    assert set(here) == {"granfabric", "numba", "numpy", "python", "processor"}
    assert machine.differences(here, dict(here)) == []
    assert machine.differences(here, {**here, "numpy": "1.0", "processor": "other"}) == [
        f"numpy 1.0 instead of {here['numpy']}"
    ]
    assert machine.differences(here, {k: v for k, v in here.items() if k != "numba"})[0].startswith("numba unknown")


def test_threads_of_a_command(granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same bits for one and two; more than the machine has, and words, are refused."""
    import numba

    for name in machine.THREADS:  # put back afterwards
        monkeypatch.setenv(name, os.environ.get(name, "1"))
    before = numba.get_num_threads()
    histories = []
    try:
        for number in (1, min(2, machine.cores())):
            out = tmp_path / str(number)
            assert granfabric("point", "p_constant", "--threads", number, "-o", out, "-q").code == 0
            histories.append((out / "history.csv").read_bytes())
    finally:
        numba.set_num_threads(before)
    assert histories[0] == histories[1]
    one = (("point", "p_constant"), ("run", "biaxial"), ("dem", "dem_biaxial"))
    for command in (*one, ("verify",), ("cost",), ("sweep", "p_constant")):
        for value in ("0", str(machine.cores() + 1), "many"):
            refused = granfabric(*command, "--threads", value, "-o", tmp_path / "new")
            assert refused.code == 2 and "--threads" in refused.err, (command, value, refused.err)
    assert not (tmp_path / "new").exists()
