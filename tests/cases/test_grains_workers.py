"""Grains at points that workers hold: the same bits for any number of them, whatever becomes of them."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator

import numpy as np
import pytest
from grains_points import SHEAR, call, law, start
from test_grains_scenes import FIELD, POINT, own_store, quiet, scene  # noqa: F401  (the fixture is for all tests here)

import granfabric as gf
from granfabric.cases.commands.point import run_point
from granfabric.cases.commands.run import run_field
from granfabric.cases.engine.choice import Choice
from granfabric.cases.engine.local_crew import LocalCrew
from granfabric.cases.engine.parts import Part
from granfabric.cases.errors import InputError, RunError
from granfabric.cases.field import grains_run
from granfabric.cases.grains.law import MEASURES, GrainsLaw
from granfabric.cases.grains.spread_law import BLOCK, SpreadGrainsLaw
from granfabric.cases.scene.reader import load
from granfabric.constitutive.arrays import ArrayError
from granfabric.constitutive.contract import Law, Status

POINTS = 5


@pytest.fixture(scope="module")
def crew() -> Iterator[LocalCrew]:
    """Two processes for all tests of this file; what one test leaves in them the next must not notice."""
    with LocalCrew(2, Part(BLOCK, law().recipe, ("dem",))) as made:
        yield made


@pytest.fixture
def both(crew):
    """The law here and by workers, with stress and state of each."""
    here, shared = law(threads=1), SpreadGrainsLaw(law(), crew)
    stress, state = start(here, POINTS)
    return (here, stress, state), (shared, stress, shared.begin(state))


def same(found, expected, shared):
    """Whether a call by workers answered what one here did."""
    for number in (0, 2):
        assert np.array_equal(found[number], expected[number])
    assert np.array_equal(found[1][:, :MEASURES], expected[1][:, :MEASURES])
    assert np.array_equal(shared.expanded(found[1]), expected[1])
    assert np.array_equal(found[3].status, expected[3].status)
    assert found[3].proposed_step_factor == expected[3].proposed_step_factor


def kill(crew: LocalCrew, place: int) -> None:
    os.kill(crew._crew[place].process.pid, signal.SIGKILL)


def test_law_by_workers_is_a_law_that_answers_the_same_bits(both):
    (here, stress, state), (shared, _, tickets) = both
    assert isinstance(shared, Law) and isinstance(shared, GrainsLaw)
    assert shared.description.nstate == MEASURES + 2 and tickets.shape == (POINTS, MEASURES + 2)
    assert np.array_equal(shared.expanded(tickets), state)
    assert shared.lost_pressure(tickets[1]) == here.lost_pressure(state[1])
    assert np.array_equal(shared.packing(tickets[2]).position, here.packing(state[2]).position)
    for kind in ("elastic", "propagated"):
        same(call(shared, SHEAR, stress, tickets, kind=kind), call(here, SHEAR, stress, state, kind=kind), shared)
    assert shared.work.steps == here.work.steps and shared.work.calls == 2
    found, expected = (call(one, np.zeros(3), stress, at) for one, at in ((shared, tickets), (here, state)))
    same(found, expected, shared)
    assert np.array_equal(found[1], tickets)
    without = call(shared, SHEAR, stress, tickets, tangent=False)
    assert without[2] is None and np.array_equal(without[0], call(here, SHEAR, stress, state)[0])


def test_steps_may_be_tried_again_given_up_and_accepted(both):
    (here, stress, state), (shared, _, tickets) = both
    at = stress
    for accepted in (SHEAR, 0.5 * SHEAR, -SHEAR):
        first = call(shared, accepted, at, tickets)
        call(shared, 3.0 * accepted, at, tickets)
        again = call(shared, accepted, at, tickets)
        assert all(np.array_equal(one, other) for one, other in zip(first[:3], again[:3]))
        expected = call(here, accepted, at, state)
        if accepted is not SHEAR:  # once without having seen the packings of the step before
            same(again, expected, shared)
        at, state, tickets = expected[0], expected[1], again[1]


def test_some_of_the_points_alone_answer_the_same(both):
    (here, stress, state), (shared, _, tickets) = both
    part = np.array([1, 4])
    whole = call(here, SHEAR, stress, state)
    some = call(shared, SHEAR, stress[part], tickets[part])
    assert np.array_equal(some[0], whole[0][part]) and np.array_equal(shared.expanded(some[1]), whole[1][part])
    onward = call(shared, SHEAR, some[0], some[1])
    assert np.array_equal(shared.expanded(onward[1]), call(here, SHEAR, whole[0], whole[1])[1][part])
    same(call(shared, SHEAR, stress, tickets), whole, shared)


def test_points_that_fail_keep_what_they_had(both):
    (here, stress, state), (shared, _, tickets) = both
    increment = np.array([SHEAR, [np.nan, 0.0, 0.0], SHEAR, [0.0, -1.0, 0.0], np.zeros(3)])
    stress = stress.copy()
    stress[2, 0] = np.inf
    found, expected = (call(one, increment, stress, at) for one, at in ((shared, tickets), (here, state)))
    same(found, expected, shared)
    kinds = [Status.OK, Status.NOT_FINITE, Status.NOT_FINITE, Status.TOO_MANY_SUBSTEPS, Status.OK]
    assert found[3].status.tolist() == kinds
    assert np.array_equal(found[1][1:], tickets[1:])


WHEN = ("before a call", "within a call", "within the next call", "before packings are asked for")


@pytest.mark.parametrize("when", WHEN)
def test_worker_that_is_killed_costs_nothing_but_time(both, crew, when):
    (here, stress, state), (shared, _, tickets) = both
    ended, asked = [], []

    def once() -> bool:
        asked.append(0)  # before the call, and when all are at work
        if not ended and (len(asked) > 1 or when not in ("within a call", "within the next call")):
            ended.append(crew._crew[1].process.pid)
            kill(crew, 1)
        return False

    expected = call(here, SHEAR, stress, state)
    if when == "before a call":
        call(shared, SHEAR, stress, tickets)
        once()
    elif when == "within a call":
        shared.stop = once  # asked first when all are at work
    found = call(shared, SHEAR, stress, tickets)
    if when == "before packings are asked for":
        once()  # those of the step are with the worker alone: they are strained again
    if when != "within the next call":
        same(found, expected, shared)
    else:
        shared.stop = once
    second = call(shared, SHEAR, found[0], found[1])
    same(second, call(here, SHEAR, expected[0], expected[1]), shared)
    assert ended and crew._crew[1].process.pid != ended[0]


def test_packings_that_were_given_up_long_ago_are_told(both, crew):
    _, (shared, stress, tickets) = both
    found = call(shared, SHEAR, stress, tickets)
    onward = call(shared, SHEAR, found[0], found[1])
    last = call(shared, SHEAR, onward[0], onward[1])
    call(shared, SHEAR, last[0], last[1])
    with pytest.raises(ArrayError, match="packings that were given up"):
        call(shared, SHEAR, found[0], found[1])
    with pytest.raises(ArrayError, match="points without a packing"):
        call(shared, SHEAR, stress, np.zeros_like(tickets))


def test_workers_that_are_lost_again_and_again_end_the_call(both, crew):
    _, (shared, stress, tickets) = both

    class Dying:
        workers, renewed = 2, 0

        def ask(self, questions, advance, stop):
            return {}

        def renew(self, place, stop):
            Dying.renewed += 1

    shared._crew = Dying()
    with pytest.raises(RunError, match="workers are lost again and again, 5 times in one call"):
        call(shared, SHEAR, stress, tickets)
    assert Dying.renewed == 2 * 4


def test_call_is_watched_by_points_and_left(both):
    (_, stress, state), (shared, _, tickets) = both
    told = []
    shared.on_points = lambda done, total: told.append((done, total))
    call(shared, SHEAR, stress, tickets)
    assert told[-1] == (POINTS, POINTS) and told == sorted(told)
    # workers that were told to stop end; a new crew goes on
    with LocalCrew(1, Part(BLOCK, law().recipe)) as alone:
        shared = SpreadGrainsLaw(law(), alone)
        tickets = shared.begin(state)
        shared.stop = lambda: True
        with pytest.raises(KeyboardInterrupt):
            call(shared, 30.0 * SHEAR, stress, tickets)
        processes = [worker.process for worker in alone._crew]
    assert not any(process.is_alive() for process in processes)


def assert_same_files(one, other):
    for name in ("history.csv", "result_0005.vtu", "points_0005.vtu"):
        assert (one / name).read_bytes() == (other / name).read_bytes()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The scene of these tests by one process."""
    folder = tmp_path_factory.mktemp("whole")
    store = tmp_path_factory.getbasetemp() / "packings"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("granfabric.cases.grains.store.default_folder", lambda: store)
        assert run_field(scene(folder, FIELD), folder / "out", quiet()).outcome == "finished"
    return folder / "out"


def test_scene_by_workers_one_of_which_is_killed_gives_the_same_files(tmp_path, whole, monkeypatch):
    original, calls = SpreadGrainsLaw.update, [0]

    def update(shared, *arguments, **more):
        calls[0] += 1
        if calls[0] == 6:
            kill(shared._crew, 0)
        return original(shared, *arguments, **more)

    monkeypatch.setattr(SpreadGrainsLaw, "update", update)
    record = run_field(scene(tmp_path, FIELD), tmp_path / "out", quiet(), choice=Choice(workers=3))
    assert record.outcome == "finished" and calls[0] > 6
    assert_same_files(tmp_path / "out", whole)


@pytest.mark.parametrize(
    ("before", "afterwards"),
    [(2, 3), pytest.param(2, None, marks=pytest.mark.slow), pytest.param(None, 2, marks=pytest.mark.slow)],
)
def test_run_that_is_interrupted_goes_on_with_other_workers(tmp_path, whole, monkeypatch, before, afterwards):
    def choice(workers):
        return None if workers is None else Choice(workers=workers)

    kind = GrainsLaw if before is None else SpreadGrainsLaw
    original, calls, crews = kind.update, [0], []

    def update(one, *arguments, **more):
        calls[0] += 1
        if calls[0] == 8:
            os.kill(os.getpid(), signal.SIGINT)
            crews.extend([] if before is None else one._crew._crew)
        return original(one, *arguments, **more)

    loaded = scene(tmp_path, FIELD)
    with monkeypatch.context() as patch:
        patch.setattr(kind, "update", update)
        with pytest.raises(RunError, match=r"interrupted within a step .--resume goes on"):
            run_field(loaded, tmp_path / "out", quiet(), choice=choice(before))
    assert calls[0] == 8 and not any(worker.process.is_alive() for worker in crews)
    assert json.loads((tmp_path / "out/run.json").read_text())["outcome"] == "stopped"
    record = run_field(loaded, tmp_path / "out", quiet(), resume=True, choice=choice(afterwards))
    assert record.outcome == "finished" and record.details["resumed_after_step"] >= 1
    assert_same_files(tmp_path / "out", whole)


FAILING = {
    "loses its pressure or flows": ["stage.1.displacement.0.value=4e-4", "stage.1.increments=2"],
    "does not come to rest": ["law.rest=1e-9", "law.longest_rest=200"],
}


@pytest.mark.parametrize("why", FAILING)
def test_failed_point_replays_alone_from_a_run_by_workers(tmp_path, why):
    given = [*FAILING[why], "solver.smallest_factor=0.5"]
    loaded = scene(tmp_path, FIELD, *given)
    records = [
        run_field(loaded, tmp_path / name, quiet(), choice=choice)
        for name, choice in (("here", None), ("there", Choice(workers=2)))
    ]
    assert records[0].outcome == records[1].outcome == "failed"
    assert records[0].message == records[1].message and "failed_point.toml holds it" in records[1].message
    if why == "does not come to rest":
        assert "its packing does not come to rest within law.longest_rest steps" in records[1].message
    for name in ("failed_point.toml", "failed_point.npz"):
        assert (tmp_path / "here" / name).read_bytes() == (tmp_path / "there" / name).read_bytes()
    replayed = run_point(load(str(tmp_path / "there" / "failed_point.toml")), tmp_path / "replayed", quiet())
    assert replayed.outcome == "failed" and replayed.message.split(": ", 1)[1] in records[1].message


@pytest.mark.slow
def test_workers_lost_for_good_end_the_run_with_what_was_reached(tmp_path, whole, monkeypatch):
    original, calls = SpreadGrainsLaw.update, [0]

    def update(shared, *arguments, **more):
        calls[0] += 1
        if calls[0] == 8:
            monkeypatch.setattr(LocalCrew, "ask", lambda crew, questions, advance, stop: {})
        return original(shared, *arguments, **more)

    loaded = scene(tmp_path, FIELD)
    with monkeypatch.context() as patch:
        patch.setattr(SpreadGrainsLaw, "update", update)
        patch.setattr(LocalCrew, "renew", lambda crew, place, stop: None)
        with pytest.raises(RunError, match=r"workers are lost again and again.*what was computed before is in"):
            run_field(loaded, tmp_path / "out", quiet(), choice=Choice(workers=2))
    monkeypatch.undo()
    monkeypatch.setattr(
        "granfabric.cases.grains.store.default_folder", lambda: tmp_path.parent / "packings_of_this_test"
    )
    assert run_field(loaded, tmp_path / "out", quiet(), resume=True).outcome == "finished"
    assert_same_files(tmp_path / "out", whole)


def test_workers_from_python(tmp_path, whole):
    (tmp_path / "mine.toml").write_text(FIELD)
    results = gf.run_scene(tmp_path / "mine.toml", output=tmp_path / "out", workers=2)
    assert results.outcome == "finished" and len(results.history) == 6
    assert_same_files(tmp_path / "out", whole)
    (tmp_path / "point.toml").write_text(POINT)
    with pytest.raises(gf.InputError, match="shares out the points of a field scene with grains"):
        gf.run_scene(tmp_path / "point.toml", output=tmp_path / "no", workers=2)
    assert not (tmp_path / "no").exists()


def test_workers_are_for_grains_and_checked_before_anything_runs(tmp_path, granfabric):
    for words in (("--workers", 2), ("--scheduler", "tcp://127.0.0.1:9")):
        refused = granfabric("run", "biaxial", *words, "-o", tmp_path / "out")
        assert refused.code == 2 and f"{words[0]} shares out the points of a field scene with grains" in refused.err
    for workers, said in ((0, r"--workers 0 is outside \[1, 1000\]"), (2000, "--workers 2000 is outside")):
        with pytest.raises(InputError, match=said):
            run_field(scene(tmp_path, FIELD), tmp_path / "out", quiet(), choice=Choice(workers=workers))
    assert not (tmp_path / "out").exists()
    grains_run.check(load("biaxial"), None)
