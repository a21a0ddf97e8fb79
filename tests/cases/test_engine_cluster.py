"""The same pieces of work by workers of Dask: a scheduler of the test's own, which is killed and mistreated."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("distributed", reason="the extra 'scale' is not installed: pip install 'granfabric[scale]'")

from dask_cluster import Cluster, cluster
from test_engine import carried_out, job

from granfabric.cases.engine.choice import Choice
from granfabric.cases.engine.jobs import Engine, WorkerLost
from granfabric.cases.errors import InputError, RunError
from granfabric.cases.terminal.screen import Screen


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with cluster(tmp_path_factory.mktemp("cluster")) as made:
        yield made


@pytest.fixture
def engine(dask: Cluster, tmp_path: Path) -> Iterator[Engine]:
    with Choice(scheduler=dask.address).engine(tmp_path, Screen(), lambda: False) as made:
        yield made


def test_jobs_and_those_that_follow(engine: Engine, tmp_path: Path) -> None:
    jobs = [job("squared", number, key=f"square {number}") for number in range(7)]
    found = carried_out(
        engine,
        [*jobs, job("refused", 3), job("no_disk", 1), job("threads")],
        lambda done, ended: [job("squared", ended.value, key="next")] if done.key == "square 3" else [],
    )
    assert [found[f"square {number}"].value for number in range(7)] == [number * number for number in range(7)]
    assert found["next"].value == 81 and found["threads"].value[0] == 1
    assert "3 is odd" in str(found["refused"].error)
    assert isinstance(found["no_disk"].error, OSError) and found["no_disk"].error.errno == 28
    assert engine.workers == 2 and "2 workers at tcp://" in engine.text


def test_a_worker_that_is_killed_costs_its_job_only(engine: Engine, tmp_path: Path) -> None:
    """From outside while it works, by its job once, and by a job that always does: only that one is given up."""
    ended: list[int] = []

    def advance(at_work: dict[str, float]) -> None:
        mark = tmp_path / "pid"
        if not ended and mark.is_file() and mark.read_text():
            ended.append(int(mark.read_text()))
            os.kill(ended[0], signal.SIGKILL)

    jobs = [job("patient", str(tmp_path)), job("killed_once", str(tmp_path)), job("killed_always")]
    found = carried_out(engine, [*jobs, *(job("squared", n, key=str(n)) for n in range(4))], advance=advance)
    assert ended and found["patient"].value == "again" and found["killed_once"].value == "done"
    assert isinstance(found["killed_always"].error, WorkerLost)
    assert [found[str(n)].value for n in range(4)] == [0, 1, 4, 9]


def test_stopping_asks_what_is_at_work_and_takes_back_the_rest(engine: Engine, tmp_path: Path) -> None:
    seen: list[dict[str, float]] = []

    def advance(at_work: dict[str, float]) -> None:
        if at_work:
            seen.append(dict(at_work))

    jobs = [job("waiting", str(tmp_path), str(n), key=str(n)) for n in range(20)]
    since = time.monotonic()
    found = carried_out(engine, jobs, advance=advance, stop=lambda: len(seen) > 2)
    assert time.monotonic() - since < 25.0  # one of them alone would take 30
    assert {ended.value for ended in found.values()} == {"stopped"} and 1 <= len(found) <= 6
    assert any(0.5 in at_work.values() for at_work in seen)


def test_results_are_those_of_processes_here(dask: Cluster, granfabric: Callable, tmp_path: Path) -> None:
    """A sweep to the last bit."""
    arguments = ("sweep", "p_constant", "--set", "material.coordination=3.9,4.0,4.1", "--result", "q:max")
    assert granfabric(*arguments, "-o", tmp_path / "here", "--workers", 1).code == 0
    done = granfabric(*arguments, "-o", tmp_path / "there", "--scheduler", dask.address)
    assert done.code == 0 and "2 workers at tcp://" in done.out, done.err
    assert (tmp_path / "here" / "results.csv").read_bytes() == (tmp_path / "there" / "results.csv").read_bytes()
    for run in ("3.9", "4.0", "4.1"):
        mine, theirs = (tmp_path / place / f"coordination={run}" / "history.csv" for place in ("here", "there"))
        assert mine.read_bytes() == theirs.read_bytes()
    assert not list((tmp_path / "there").glob(".granfabric-*"))


def test_what_is_wrong_with_workers_is_said_before_anything_runs(
    dask: Cluster, granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"

    def refused(match: str, address: str = dask.address) -> None:
        with (
            pytest.raises(InputError, match=match),
            Choice(scheduler=address).engine(tmp_path, Screen(), lambda: False),
        ):
            pass

    from granfabric.cases.engine import machine

    here = machine.versions()
    with monkeypatch.context() as patch:
        patch.setattr(machine, "versions", lambda: {**here, "numba": "0.1", "python": "2.7"})
        refused(rf"workers tcp://.*: numba {here['numba']} instead of 0.1, python {here['python']} instead of 2.7")
        asked = ("--set", "material.coordination=3.9,4.0", "--scheduler", dask.address, "-o", out)
        for command in (("sweep", "p_constant", *asked), ("verify", *asked[2:]), ("cost", "arcs", *asked[2:])):
            result = granfabric(*command)
            assert result.code == 2 and f"numba {here['numba']} instead of 0.1" in result.err and not out.exists()
    with monkeypatch.context() as patch:  # the folder of somebody else
        patch.setattr(Path, "write_text", lambda self, text: len(text))
        refused("does not see the folder")
    extra = dask.add_workers(1, 2)
    try:
        refused("2 jobs at a time in one process.*--nthreads 1")
    finally:
        dask.kill(extra)
        while any(threads > 1 for threads in dask.threads()):
            time.sleep(0.1)
    with monkeypatch.context() as patch:
        patch.setattr("granfabric.cases.engine.cluster.CONNECT_SECONDS", 1)
        refused("no scheduler of Dask answers there", "tcp://127.0.0.1:9")
        refused("no scheduler of Dask answers there", "nonsense")


@pytest.mark.slow
def test_workers_that_come_later_and_a_scheduler_that_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("granfabric.cases.engine.cluster.LOOK_SECONDS", 0.5)
    with cluster(tmp_path, 0) as late:
        later = threading.Thread(target=late.add_workers, args=(1,))
        later.start()
        with Choice(scheduler=late.address).engine(tmp_path, Screen(), lambda: False) as engine:
            later.join()
            assert carried_out(engine, [job("squared", 3)])["squared"].value == 9

            def advance(at_work: dict[str, float]) -> None:
                if (tmp_path / "w").is_file():
                    late.processes[0].kill()

            with pytest.raises(RunError, match=r"the scheduler at tcp://.* is gone"):
                carried_out(engine, [job("waiting", str(tmp_path), "w")], advance=advance)
