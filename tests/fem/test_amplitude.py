"""How loads go through a stage: closed forms, corners that are met, what the next stage inherits."""

from __future__ import annotations

import numpy as np
import pytest
from fem_meshes import ELASTIC, PLASTIC, distorted, nodal, run

from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Material
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.control import StepControl
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.loads.amplitude import NAMES, Amplitude, amplitude, merged_corners, positions
from granfabric.fem.loads.kinds import Displacement, Fixed, LoadError, Pressure, Stage, Traction
from granfabric.fem.loads.problem import Problem

OEDOMETRIC = 1000.0 * 0.7 / (1.3 * 0.4)
ROLLERS = [Fixed("bottom", ("y",)), Fixed("left", ("x",)), Fixed("right", ("x",))]
TIGHT = StepControl(tolerance=1e-12)
TABLE = [[0, 0], [0.25, 1], [1, 0.5]]


@pytest.mark.parametrize("cycles", [0.25, 1.0, 2.5, 3.0])
def test_periodic_ones_have_their_closed_forms_and_corners_at_extremes(cycles):
    t = np.linspace(0.0, 1.0, 401)
    wanted = {
        "sine": np.sin(2 * np.pi * cycles * t),
        "triangle": 2 / np.pi * np.arcsin(np.sin(2 * np.pi * cycles * t)),
        "haversine": 0.5 * (1 - np.cos(2 * np.pi * cycles * t)),
    }
    for kind, values in wanted.items():
        one = Amplitude(kind, cycles)
        np.testing.assert_allclose([one.factor(place, 10) for place in t], values, atol=1e-12)
        corners = one.corners(10)
        # extremes of a sine are where its size is 1; of the haversine 0 or 1
        at = np.array([one.factor(place, 10) for place in corners])
        np.testing.assert_allclose(
            np.abs(at - (0.5 if kind == "haversine" else 0.0)), 0.5 if kind == "haversine" else 1.0
        )
        assert len(corners) == (
            np.ceil(2 * cycles - 1e-9) - 1 if kind == "haversine" else np.floor(2 * cycles + 0.5 - 1e-9)
        )


def test_ramp_step_and_table():
    assert [Amplitude("step").factor(t, 4) for t in (0.0, 0.125, 0.25, 1.0)] == [0.0, 0.5, 1.0, 1.0]
    assert Amplitude("ramp").factor(0.3, 4) == 0.3
    one = amplitude(TABLE)
    assert [one.factor(t, 4) for t in (0.0, 0.125, 0.25, 0.625, 1.0)] == pytest.approx([0.0, 0.5, 1.0, 0.75, 0.5])
    assert amplitude([[0, 0], [0.5, 2]]).factor(0.9, 4) == 2.0  # the last is held
    assert merged_corners([one, Amplitude("step"), Amplitude("ramp")], 4) == [0.25, 1.0]


def test_positions_meet_corners_and_are_no_longer_than_an_increment():
    assert positions([1.0], 3) == [1 / 3, 2 / 3, 1.0]
    corners = merged_corners([Amplitude("sine", 3.0)], 10)
    found = positions(corners, 10)
    assert set(corners) <= set(found) and found == sorted(found)
    assert np.diff([0.0, *found]).max() <= 0.1 + 1e-12


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ("rmp", "is not one of ramp, step, sine"),
        ([[0, 1], [1, 1]], "begins with [0, 1], not with [0, 0]"),
        ([[0, 0], [0.5, 1], [0.5, 2]], "from 0.5 to 0.5 in rows 2 and 3"),
        ([[0, 0], [1.5, 1]], "ends at 1.5"),
        ([[0, 0]], "has 1 rows"),
        ([[0, 0], [1, np.nan]], "no pair of finite numbers"),
        ([[0, 0, 0], [1, 1, 1]], "neither one of"),
        (7, "neither one of"),
    ],
)
def test_other_amplitudes_are_refused(given, sentence):
    with pytest.raises(LoadError) as error:
        amplitude(given)
    assert sentence in str(error.value)
    with pytest.raises(LoadError, match="stage 'a'"):
        Stage("a", [], 1, True, amplitude=given)


@pytest.mark.parametrize("cycles", [0.0, -1.0, np.nan, 1e9, True])
def test_other_numbers_of_cycles_are_refused(cycles):
    with pytest.raises(LoadError, match="cycles"):
        Amplitude("sine", cycles)


@pytest.mark.parametrize("law", [ELASTIC, PLASTIC], ids=["uncoupled", "coupled"])
def test_cycles_within_a_stage_and_what_the_next_one_inherits(law):
    """Stress of a column under a pressure of 0.05 (elastic): the factor times it, in the corners exactly."""
    space = Space(distorted("P2"), "P2")
    cycle = Stage("cycle", [*ROLLERS, Pressure("top", 0.05, Amplitude("sine", 2.25))], increments=10)
    table = Stage("table", [Pressure("top", 0.01, TABLE), Traction("right", (0.0, 0.0))], increments=4)
    rest = Stage("rest", [Pressure("top", 0.0)], increments=1)
    steps, summary = run(space, law, [cycle, table, rest], TIGHT)
    assert summary.finished
    first = [step for step in steps if step.stage == "cycle"]
    np.testing.assert_allclose(
        [step.stress[:, 1].mean() for step in first],
        [-0.05 * np.sin(4.5 * np.pi * step.fraction) for step in first],
        atol=1e-10,
    )
    extremes = [(2 * k + 1) / 9 for k in range(4)]
    assert all(min(abs(step.fraction - place) for step in first) < 1e-15 for place in extremes)
    # from 0.05 at the end of the sine to 0.01, by the table: half of the way is what stays
    second = {step.fraction: step.stress[:, 1].mean() for step in steps if step.stage == "table"}
    assert second[0.25] == pytest.approx(-0.01, rel=1e-8) and second[1.0] == pytest.approx(-0.03, rel=1e-8)
    assert steps[-1].stress[:, 1].mean() == pytest.approx(0.0, abs=1e-11)
    assert [step.step for step in steps] == list(range(1, len(steps) + 1))


@pytest.mark.parametrize("law", [ELASTIC, PLASTIC], ids=["uncoupled", "coupled"])
def test_displacements_with_amplitudes_of_their_own(law):
    space = Space(distorted("P2"), "P2")
    loads = [*ROLLERS[:2], Displacement("top", "y", -1e-4, "triangle"), Displacement("right", "x", 2e-4, "haversine")]
    steps, _ = run(space, law, [Stage("both", loads, 4), Stage("hold", [Pressure("top", 0.0)])], TIGHT)
    top, right = space.boundary_nodes("top"), space.boundary_nodes("right")
    for step in steps[:-1]:
        way = [Amplitude(kind).factor(step.fraction, 4) for kind in ("triangle", "haversine")]
        np.testing.assert_allclose(nodal(step)[top, 1], -1e-4 * way[0], atol=1e-18)
        np.testing.assert_allclose(nodal(step)[right, 0], 2e-4 * way[1], atol=1e-18)
    assert {0.25, 0.5, 0.75} <= {step.fraction for step in steps}
    np.testing.assert_allclose(steps[-1].displacement, steps[-2].displacement, atol=1e-15)


def test_a_cycle_of_a_plastic_column_dissipates_what_two_ramps_do():
    """A table up and down within one stage ends where two stages end."""
    space = Space(distorted("P2"), "P2")
    start = [Fixed("bottom")]
    one, summary = run(
        space, PLASTIC, [Stage("a", [*start, Displacement("top", "y", -0.01, [[0, 0], [0.5, 1], [1, 0.2]])], 8)], TIGHT
    )
    two, _ = run(
        space,
        PLASTIC,
        [Stage("a", [*start, Displacement("top", "y", -0.01)], 4), Stage("b", [Displacement("top", "y", -0.002)], 4)],
        TIGHT,
    )
    assert summary.finished and len(one) == len(two) == 8
    np.testing.assert_allclose(one[-1].stress, two[-1].stress, atol=1e-8)


def test_states_follow_cycles_in_uncoupled_runs_that_report_seldom():
    """Reported or not, the law goes through each increment: the same state either way."""
    law = ContactLaw([Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)])
    space = Space(distorted("P2"), "P2")
    hold = [Fixed("bottom"), Pressure("left", 1e5), Pressure("right", 1e5), Pressure("top", 1e5)]
    stages = [
        Stage("initial", hold, 1),
        Stage("cycle", [Displacement("top", "x", 2e-5, Amplitude("sine", 1.25))], 6),
    ]
    problem = Problem(space, law, stages, initial_stress=(-1e5, -1e5, 0.0))
    ends = []
    for every in (1, 100):
        steps: list = []
        assert solve(problem, StepControl(report_every=every), on_step=steps.append).finished
        ends.append(steps[-1])
    np.testing.assert_allclose(ends[0].state, ends[1].state, rtol=1e-12, atol=1e-12)


def test_an_initial_stage_has_no_amplitude_and_nodes_only_one():
    with pytest.raises(LoadError, match="act from the outset"):
        Stage("initial", [Pressure("top", 1.0, "sine")])
    space = Space(distorted("P2"), "P2")
    loads = [Displacement("top", "y", 0.1), Displacement("right", "y", 0.1, "sine")]
    with pytest.raises(LoadError, match="is told two amplitudes of component y"):
        Problem(space, ELASTIC, [Stage("a", loads)])
    assert set(NAMES) == {"ramp", "step", "sine", "triangle", "haversine"}
