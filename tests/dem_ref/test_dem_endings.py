"""Every leg ends: at its end, or with a sentence on why it could not be followed to it."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from granfabric.dem_ref.dynamics.motion import Motion
from granfabric.dem_ref.dynamics.packing import PackingOptions, make_packing
from granfabric.dem_ref.inputs.probes import ProbeError, at_rest, is_at_rest, stress_probe
from granfabric.dem_ref.inputs.weak_contacts import measure_slip
from granfabric.dem_ref.loading import leg_state
from granfabric.dem_ref.loading.endings import Ending, ending_text
from granfabric.dem_ref.loading.leg_state import LEG_NUMBERS, LegState
from granfabric.dem_ref.loading.legs import mixed_leg, stress_leg
from granfabric.dem_ref.loading.path import Segment
from granfabric.dem_ref.loading.run import HISTORY_COLUMNS, DemRun, RunOptions
from granfabric.dem_ref.loading.servo import SLOWEST_PACE, Loading, RateLimits, mean_pressure
from granfabric.dem_ref.measures.contacts import contacts_of, love_weber_stress, unbalanced_force
from granfabric.dem_ref.sample.disks import Sample, SampleError

P = 1e5
FAST = RateLimits(1e-3, 1e-2)
STRAIN, STRESS = ("strain",) * 3, ("stress",) * 3


@pytest.fixture(scope="module")
def small() -> Sample:
    return make_packing(100, 1)


@pytest.fixture(scope="module")
def apart(small) -> Sample:
    """The disks of a packing with their centres a hundredth further apart: none touches another."""
    loose = small.copy()
    loose.position *= 1.01
    loose.cell *= 1.01
    return loose


def mixed(control, target, **more) -> Segment:
    return Segment("mixed", control=tuple(control), target=tuple(target), **more)


def followed(sample: Sample, *segments: Segment, limits: RateLimits = FAST, **more) -> DemRun:
    run = DemRun(sample, RunOptions(segments, limits=limits, **more))
    run.execute()
    assert run.finished
    return run


WITHOUT_PRESSURE = {
    "expansion": mixed(STRAIN, (5e-4, 5e-4, 0.0)),
    "extension along one axis": mixed(STRAIN, (6e-4, 0.0, 0.0)),
    "no stress": mixed(STRESS, (0.0, 0.0, 0.0)),
    "tension": mixed(STRESS, (1e4, 1e4, 0.0)),
    "tension along one axis": mixed(("stress", "strain", "strain"), (1e4, 0.0, 0.0)),
    "isotropic, next to nothing": Segment("invariants", pressure=1e-9, stress_ratio=0.0),
}


@pytest.mark.parametrize("name", WITHOUT_PRESSURE)
@pytest.mark.parametrize("limits", [FAST, RateLimits(0.1, 1.0)], ids=["fast", "within one chunk"])
def test_a_lost_pressure_ends_the_run_and_keeps_what_was_reached(small, name, limits):
    run = followed(small, WITHOUT_PRESSURE[name], limits=limits)
    assert run.ending == Ending.LOST_PRESSURE and run.message.startswith("segment 1: the sample has lost its pressure")
    h = run.history()
    assert tuple(h) == HISTORY_COLUMNS and np.isfinite(np.array(run.rows)).all()
    # to a thousandth, or to a millionth where the path itself goes down to zero
    # (told half a step after it was seen)
    assert 0.0 <= h["p"][-1] < 1.01e-3 * h["p"][0] and (np.diff(h["dem_steps"]) > 0).all()
    assert run.motion.steps_done < 100_000


def test_expansion_at_the_usual_rate_ends(small):
    """Rates scale with the pressure: without an end of its own this leg slows down for ever."""
    run = followed(small, WITHOUT_PRESSURE["expansion"], limits=RateLimits())
    assert run.ending == Ending.LOST_PRESSURE and run.motion.steps_done < 2_000_000
    assert run.history()["strain_xx"][-1] < 2.5e-4  # it lasts for a third of the way


def test_later_legs_are_not_begun_without_pressure(small):
    back = mixed(STRAIN, (0.0, 0.0, 0.0))
    run = followed(small, WITHOUT_PRESSURE["expansion"], back)
    assert run.segment == 1 and run.message.startswith("segment 1:")
    # measured against the start of the run, not of the leg: two legs of which neither loses a thousandth
    down = [Segment("invariants", pressure=fraction, stress_ratio=0.0) for fraction in (0.02, 0.01)]
    run = followed(small, *down, mixed(STRAIN, (1e-5, 1e-5, 0.0), relative=True), limits=RateLimits(1e-4, 1e-3))
    assert run.message.startswith("segment 3: the sample has lost its pressure: p = ")
    assert 0.5e-3 * P < run.history()["p"][-1] < 1e-3 * P


@pytest.mark.parametrize("fraction", [1e-2, 2e-4])
def test_low_pressures_that_are_asked_for_are_reached(small, fraction):
    run = followed(small, Segment("invariants", pressure=fraction, stress_ratio=0.0), limits=RateLimits(1e-4, 1e-3))
    assert run.message == "" and run.history()["p"][-1] == pytest.approx(fraction * P, rel=1e-3)


def test_disks_that_do_not_touch_are_in_balance_but_not_at_rest(apart):
    assert contacts_of(apart).count == 0 and unbalanced_force(apart) == 0.0
    assert not is_at_rest(apart)
    for call in (
        lambda: at_rest(apart),
        lambda: stress_probe(apart, 0.0, 0.0),
        lambda: measure_slip(apart),
        lambda: Loading(Motion(apart.copy()), stress_leg((-P, -P, 0.0))),
        lambda: DemRun(apart, RunOptions((mixed(STRESS, (-P, -P, 0.0)),))),
    ):
        with pytest.raises(SampleError, match="pressure"):
            call()


def test_probes_that_take_the_pressure_or_too_much_say_so(small):
    with pytest.raises(ProbeError, match=r"dp = -1e\+05 Pa.*has lost its pressure"):
        stress_probe(small, -P, 0.0, limits=FAST)
    with pytest.raises(ProbeError, match="cannot carry"):
        stress_probe(small, 0.0, 0.95 * P, limits=RateLimits(1e-3, 0.1, lag=0.05))


@pytest.mark.parametrize(
    "segment",
    [
        Segment("invariants", stress_ratio=0.9),
        mixed(("stress", "stress", "strain"), (-1e4, -1e5, 0.0)),
        mixed(("stress", "strain", "stress"), (-1e5, 0.0, 2e5)),
    ],
)
def test_a_stress_beyond_the_strength_is_given_up_whatever_the_control(small, segment):
    """Also where some components are strains, which alone used to flow for ever."""
    run = followed(small, segment, limits=RateLimits(1e-3, 1e-1, lag=0.05))
    assert run.ending == Ending.TOO_STRONG and "cannot carry" in run.message
    h = run.history()
    assert max(np.abs(h[f"strain_{name}"][-1]) for name in ("xx", "yy", "xy")) < 0.5


@pytest.fixture
def impatient(monkeypatch):
    """Looked at every 120,000 steps, not every two million."""
    monkeypatch.setattr(leg_state, "WATCH", 3000)


def test_a_loading_that_gets_nowhere_ends(small, impatient):
    run = followed(small, mixed(STRAIN, (-0.02, 0.0, 0.0)), limits=RateLimits(inertial_number=1e-12))
    assert run.ending == Ending.STOOD_STILL and "stands still" in run.message
    assert run.motion.steps_done == 40 * 3000


@pytest.mark.slow
def test_a_loading_that_gets_nowhere_ends_as_shipped(small):
    run = followed(small, mixed(STRAIN, (-0.02, 0.0, 0.0)), limits=RateLimits(inertial_number=1e-12))
    assert run.ending == Ending.STOOD_STILL and run.motion.steps_done <= 2_000_000


def test_what_moves_gets_on_or_calms_down_does_not_stand_still(impatient):
    """Any one of the three is life; and once looked at, the next look is against what was seen then."""
    strain = np.zeros(3)

    def look(state: LegState, unrest: float) -> bool:
        return any(state.stands_still(strain, unrest, 1e-4) for _ in range(3000))

    assert look(LegState(progress=0.5, seen_progress=0.5), 1.0)
    assert not look(LegState(progress=0.5, seen_progress=0.5 - 2e-6), 1.0)
    assert not look(LegState(progress=0.5, seen_progress=0.5, seen_strain=np.array([0.0, 2e-5, 0.0])), 1.0)
    assert look(LegState(progress=0.5, seen_progress=0.5, seen_strain=np.array([0.0, 5e-6, 0.0])), 1.0)
    calming = LegState(progress=1.0, seen_progress=1.0)
    assert not look(calming, 8.0) and not look(calming, 3.0) and look(calming, 2.9)


def test_a_sample_that_never_comes_to_rest_ends(impatient):
    """Without drag and friction vibrations stay; the pace falls without an end, and can grow again."""
    frictionless = make_packing(100, 2, PackingOptions(friction=0.0))
    motion = Motion(frictionless.copy(), damping=0.0)
    loading = Loading(motion, mixed_leg(STRAIN, (-2e-5, -1e-5, 0.0)), RateLimits(1e-2, 1e-7))
    assert not loading.run(3_000_000)
    assert loading.ending == Ending.STOOD_STILL
    assert loading.state.unbalanced_force > 1e-7 and loading.state.pace > 0.1 * SLOWEST_PACE * 1e-12


def test_runs_that_were_given_up_resume_to_the_same_words_and_bits(tmp_path, small, impatient):
    cases = {
        "expansion": (WITHOUT_PRESSURE["expansion"], FAST),
        "within one chunk": (WITHOUT_PRESSURE["expansion"], RateLimits(0.1, 1.0)),
        "still": (mixed(STRAIN, (-0.02, 0.0, 0.0)), RateLimits(inertial_number=1e-12)),
    }
    for name, (segment, limits) in cases.items():
        options = RunOptions((segment,), limits=limits)
        straight = DemRun(small, options)
        straight.execute(checkpoint=tmp_path / "end.npz")
        ended = DemRun.resume(tmp_path / "end.npz", options)
        assert ended.finished and ended.message == straight.message != "", name
        assert not ended.execute()
        half = DemRun(small, options)
        while not half.finished and half.motion.steps_done < straight.motion.steps_done // 2:
            half.advance()
        half.save(tmp_path / "half.npz")
        resumed = DemRun.resume(tmp_path / "half.npz", options)
        assert not resumed.execute()
        assert resumed.message == straight.message and np.array_equal(resumed.rows, straight.rows), name


def test_the_state_of_a_leg_is_stored_whole():
    numbers = np.arange(1.0, LEG_NUMBERS + 1.0)
    state = LegState.from_array(numbers)
    assert np.array_equal(state.to_array(), numbers)
    spread = [np.atleast_1d(getattr(state, entry.name)) for entry in fields(LegState)]
    assert sorted(np.concatenate(spread)) == numbers.tolist()
    with pytest.raises(SampleError, match="23 numbers"):
        LegState.from_array(numbers[:17])


def test_the_words_name_the_pressures():
    text = ending_text(Ending.LOST_PRESSURE, -0.0, 1e5, 0.0)
    assert "p = 0 Pa of 1e+05 Pa" in text
    assert ending_text(Ending.ON_ITS_WAY, 1.0, 1.0, 0.0) == ""


@pytest.mark.parametrize("control", [STRAIN, STRESS, ("stress", "strain", "strain")])
def test_relative_targets_count_from_the_start_of_the_leg(small, control):
    """After a consolidation, and each component from its own: zero keeps it."""
    first = Segment("invariants", pressure=2.0, stress_ratio=0.0)
    target = [-2e-5 if entry == "strain" else -1e4 for entry in control]
    target[2] = 0.0
    absolute = followed(small, first, limits=RateLimits(1e-4, 1e-3))
    run = followed(small, first, mixed(control, target, relative=True), limits=RateLimits(1e-4, 1e-3))
    assert run.message == ""
    before = np.array([*love_weber_stress(absolute.sample), *absolute.sample.strain])
    after = np.array([*love_weber_stress(run.sample), *run.sample.strain])
    for place, entry in enumerate(control):
        if entry == "stress":
            assert after[place] - before[place] == pytest.approx(target[place], abs=1e-3 * 2 * P)
        else:
            assert after[3 + place] - before[3 + place] == pytest.approx(target[place], abs=1e-12)


def test_undrained_shear_after_consolidation_keeps_the_area(tmp_path, small):
    legs = (
        Segment("invariants", pressure=2.0, stress_ratio=0.0),
        mixed(STRAIN, (4e-5, -4e-5, 0.0), relative=True),
    )
    options = RunOptions(legs, limits=RateLimits(1e-4, 1e-3))
    run = DemRun(small, options)
    area, resumed = 0.0, False
    while not run.finished:
        run.advance()
        if run.segment == 1 and area == 0.0:
            area = run.sample.area
        if run.segment == 1 and run.completed_fraction() > 0.6 and not resumed:
            run.save(tmp_path / "c.npz")
            run, resumed = DemRun.resume(tmp_path / "c.npz", options), True
    assert resumed and run.sample.area == pytest.approx(area, rel=1e-8)
    assert mean_pressure(run.motion.stress) > 1.8 * P  # with absolute strains it would fall to 1.0 or so
    straight = DemRun(small, options)
    straight.execute()
    assert np.array_equal(straight.rows, run.rows)
