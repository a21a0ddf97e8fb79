"""Grains at points that actors of Dask hold: a scheduler of the test's own, whose workers are killed."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest

pytest.importorskip("distributed", reason="the extra 'scale' is not installed: pip install 'granfabric[scale]'")

from dask_cluster import Cluster, cluster
from distributed import Client
from test_grains_scenes import FIELD, own_store, quiet, scene  # noqa: F401  (the fixture is for all tests here)
from test_grains_workers import assert_same_files, whole  # noqa: F401

from granfabric.cases.commands.run import run_field
from granfabric.cases.engine import machine
from granfabric.cases.engine.choice import Choice
from granfabric.cases.engine.cluster_crew import ClusterCrew
from granfabric.cases.errors import InputError, RunError
from granfabric.cases.grains.spread_law import SpreadGrainsLaw


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with cluster(tmp_path_factory.mktemp("cluster")) as made:
        yield made


def kill(crew: ClusterCrew, place: int) -> None:
    """End the process of a worker at once; its nanny begins another one."""
    worker = crew._parts[place][0]
    with Client(crew._cluster.address, set_as_default=False) as client:
        os.kill(client.run(os.getpid, workers=[worker])[worker], signal.SIGKILL)


@pytest.mark.parametrize("when", ["before a call", "within a call"])
def test_scene_by_actors_one_of_which_is_killed_gives_the_same_files(dask, tmp_path, whole, monkeypatch, when):  # noqa: F811
    original, calls, killed = SpreadGrainsLaw.update, [0], []

    def update(shared, *arguments, **more):
        calls[0] += 1
        if calls[0] == 7:
            asked = iter([when == "within a call", False])

            def once() -> bool:  # asked before the call, and when all are at work
                if not killed and not next(asked):
                    killed.append(kill(shared._crew, 0))
                return False

            shared.stop = once
            if when == "before a call":
                once()
        return original(shared, *arguments, **more)

    monkeypatch.setattr(SpreadGrainsLaw, "update", update)
    record = run_field(scene(tmp_path, FIELD), tmp_path / "out", quiet(), choice=Choice(scheduler=dask.address))
    assert record.outcome == "finished" and killed
    assert_same_files(tmp_path / "out", whole)
    with Client(dask.address, set_as_default=False) as client:
        assert not client.has_what() or not any(client.has_what().values())  # parts are given back


def test_interruption_within_a_call(dask, tmp_path, whole, monkeypatch):  # noqa: F811
    original, calls = SpreadGrainsLaw.update, [0]

    def update(shared, *arguments, **more):
        calls[0] += 1
        if calls[0] == 8:
            os.kill(os.getpid(), signal.SIGINT)
        return original(shared, *arguments, **more)

    loaded, choice = scene(tmp_path, FIELD), Choice(scheduler=dask.address)
    with monkeypatch.context() as patch:
        patch.setattr(SpreadGrainsLaw, "update", update)
        with pytest.raises(RunError, match=r"interrupted within a step .--resume goes on"):
            run_field(loaded, tmp_path / "out", quiet(), choice=choice)
    assert calls[0] == 8
    assert run_field(loaded, tmp_path / "out", quiet(), resume=True, choice=choice).outcome == "finished"
    assert_same_files(tmp_path / "out", whole)


def test_worker_of_another_version_is_refused_before_anything_runs(dask, tmp_path, monkeypatch):
    here = machine.versions()
    monkeypatch.setattr(machine, "versions", lambda: {**here, "numpy": "1.0"})
    with pytest.raises(InputError, match=rf"workers tcp://.*: numpy {here['numpy']} instead of 1.0"):
        run_field(scene(tmp_path, FIELD), tmp_path / "out", quiet(), choice=Choice(scheduler=dask.address))
    assert not (tmp_path / "out").exists()
