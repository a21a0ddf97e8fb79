"""Memory of tangential forces: Masing's rule, first loading untouched, states and tangents (`network.slip_memory`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contact_law_cases import PRESSURE, Points, law, material

from granfabric.constitutive.effects import Effects
from granfabric.constitutive.network import slip_memory
from granfabric.constitutive.network.slip_memory import CLASSES, slip_classes, swept
from granfabric.constitutive.parameters import Closure
from granfabric.constitutive.path import Leg, drive

SHIFTED = Closure(force_change="shifted_distribution", tangential="frictional")
START = (-PRESSURE, -PRESSURE, 0.0)
FORGETS = Effects(tangential_memory=False)
C_T, K = SHIFTED.tangential_force_ratio, SHIFTED.slip


def at(ratio: float, angle: float = 0.0, p: float = 1.0) -> tuple[float, float, float]:
    """Stress of a stress ratio in a direction of the double-angle plane [degrees]."""
    c, s = ratio * np.cos(np.radians(angle)), ratio * np.sin(np.radians(angle))
    return (-PRESSURE * p * (1 + c), -PRESSURE * p * (1 - c), -PRESSURE * p * s)


def tangential(contact_law, targets, increments=8):
    """a_t (steps, 2) along straight legs from isotropic stress."""
    columns = drive(contact_law, START, [Leg(target=target, increments=increments) for target in targets]).columns
    return np.stack([columns[f"tangential_force_anisotropy_{i}"] for i in (1, 2)], axis=1)


def many_classes(monkeypatch, number: int) -> None:
    """So many classes, equally wide, up to the largest threshold there is."""
    monkeypatch.setattr(slip_memory, "CLASSES", number)
    monkeypatch.setattr(slip_memory, "LARGEST_THRESHOLD", np.inf)
    monkeypatch.setattr(slip_memory, "SPACING", 1.0)


def test_classes_make_up_the_curve_of_first_loading(monkeypatch):
    """Classes of uniform thresholds add up to ``c_t s - k s^2``: midpoint rule, slope two."""
    errors = []
    for number in (8, 16, 32, 64):
        many_classes(monkeypatch, number)
        thresholds, shares = slip_classes(C_T, K).T
        assert shares.sum() == pytest.approx(1.0, rel=1e-12)
        s = np.linspace(0.0, 0.29, 500)[:, None]
        errors.append(np.abs(C_T * np.minimum(s, thresholds) @ shares - (C_T * s - K * s * s)[:, 0]).max())
    assert np.polyfit(np.log([8, 16, 32, 64]), np.log(errors), 1)[0] == pytest.approx(-2.0, abs=0.1)


def by_small_steps(e, way, limit, steps=4000):
    """The plain return to the disc, of many small steps."""
    for _ in range(steps):
        e = e + way / steps
        e = e * min(1.0, limit / np.hypot(*e))
    return e


WAYS = [
    ((0.02, 0.01), (0.05, 0.02), 0.1),  # stays within
    ((0.02, 0.05), (0.3, -0.1), 0.1),  # reaches the edge, goes along it
    ((0.06, -0.08), (0.05, 0.11), 0.1),  # from the edge through the disc to the edge
    ((0.0, 0.1), (0.07, 0.0), 0.1),  # along the edge from the start
    ((0.06, 0.08), (0.06, 0.08), 0.1),  # straight on at the edge
    ((-0.06, -0.08), (-0.3, 0.02), 0.1),
    ((0.09, -0.08), (-0.2, 0.3), 0.1),  # from outside
]


@pytest.mark.parametrize(("e", "way", "limit"), WAYS)
def test_straight_ways_have_a_closed_form(e, way, limit):
    """Against the return of 4,000 steps, and in two parts; derivatives against central differences."""
    e, way = np.array(e), np.array(way)
    found, by_way, by_limit = swept(*e, *way, limit)
    assert np.hypot(*found) <= limit * (1 + 1e-14)
    assert found == pytest.approx(by_small_steps(e, way, limit), abs=3e-5)
    half = swept(*e, *(0.5 * way), limit)[0]
    assert swept(*half, *(0.5 * way), limit)[0] == pytest.approx(found, abs=1e-14)
    h = 1e-6
    for column in range(2):
        more, less = (np.array(swept(*e, *(way + sign * h * np.eye(2)[column]), limit)[0]) for sign in (1, -1))
        assert np.reshape(by_way, (2, 2))[:, column] == pytest.approx((more - less) / (2 * h), abs=1e-8)
    more, less = (np.array(swept(*e, *way, limit + sign * h)[0]) for sign in (1, -1))
    if np.hypot(*e) != pytest.approx(limit):  # on the edge it matters whether that moves in or out
        assert by_limit == pytest.approx((more - less) / (2 * h), abs=1e-8)


def test_the_shortest_ways():
    """Down to nothing: derivatives stay finite and tend to those along the edge."""
    e = 0.1 * np.array([0.6, 0.8])
    edge = np.eye(2) - np.outer(e, e) / 0.01
    for size in (1e-3, 1e-6, 1e-9, 1e-12):
        _, by_way, by_limit = swept(*e, *(size * np.array([0.8, 0.6])), 0.1)
        assert np.reshape(by_way, (2, 2)) == pytest.approx(edge, abs=20 * size + 1e-4)
        assert np.isfinite(by_limit).all()
    assert swept(*e, 0.0, 0.0, 0.1)[1] == (1.0, 0.0, 0.0, 1.0)
    for held in ((0.0, 0.0), (0.1, 0.0), (0.0, 0.1), (0.0, -0.1)):
        for way in ((0.0, 0.0), (1e-200, 0.0), (0.0, -0.3), (5.0, 0.0), (1e8, 1e8)):
            for part in swept(*held, *way, 0.1):
                assert np.isfinite(part).all()


@pytest.mark.parametrize("angle", [0.0, 37.0])
def test_masing(angle):
    """On unloading ``g(s_1) - 2 g((s_1 - s)/2)``, as well as four classes can; reloading goes through the turn."""
    top, low = 0.24, -0.1
    a_t = tangential(law(closure=SHIFTED), [at(top, angle), at(low, angle), at(top, angle), at(0.3, angle)])
    along = a_t @ [np.cos(np.radians(angle)), np.sin(np.radians(angle))]

    def g(s):
        return C_T * s - K * s * np.abs(s)

    s = np.linspace(top, low, 9)
    assert along[8:17] == pytest.approx(g(top) - 2 * g((top - s) / 2), abs=0.009)
    # without memory the difference is five times that
    assert np.abs(g(s) - (g(top) - 2 * g((top - s) / 2))).max() > 0.027
    assert along[24] == pytest.approx(g(top), abs=1e-7) and along[32] == pytest.approx(g(0.3), abs=1e-7)
    assert np.abs(a_t @ [-np.sin(np.radians(angle)), np.cos(np.radians(angle))]).max() < 0.004


FIRST = {
    "deviator": [(0.3, 0.0, 1.0)],
    "off the axes": [(0.2, 50.0, 1.0)],
    "after a fall": [(0.0, 0.0, 0.5), (0.3, 20.0, 0.5)],
    "before a fall": [(0.25, 20.0, 1.0), (0.25, 20.0, 0.5)],
    "after a rise": [(0.0, 0.0, 2.0), (0.3, 70.0, 2.0)],
}


@pytest.mark.parametrize("path", FIRST.values(), ids=FIRST)
def test_first_loading_is_untouched(path):
    """Whether the pressure falls before or after the deviator has grown, or has risen before: to rounding."""
    legs = [Leg(target=at(*target), increments=7) for target in path]
    with_it = drive(law(closure=SHIFTED, tolerance=1e-9), START, legs)
    without = drive(law(FORGETS, SHIFTED, tolerance=1e-9), START, legs)
    for name, values in without.columns.items():
        if name not in ("evaluations", "substeps", "rejected"):
            assert with_it.columns[name] == pytest.approx(values, rel=1e-9, abs=1e-10), name


def test_pressure_that_grows_after_the_deviator_frees_no_contact():
    """At constant q/p without memory a_t grows by the delay of slip; classes keep most of what has slipped, and when
    the pressure is back hold less than at first."""
    a_t = tangential(law(closure=SHIFTED), [at(0.15), at(0.15, p=2.0), at(0.15)])[:, 0]
    free = tangential(law(FORGETS, SHIFTED), [at(0.15), at(0.15, p=2.0), at(0.15)])[:, 0]
    assert free[8] == pytest.approx(a_t[8], abs=1e-12) and free[24] == pytest.approx(free[8], abs=1e-9)
    assert a_t[8] < a_t[16] < free[16] - 0.0005
    assert a_t[24] < a_t[8] - 0.001


def test_a_turning_stress_is_led_by_what_contacts_hold():
    """Steady turn at |s| = m: an element with r < m goes around at the angle acos(r/m) ahead of s, so that all of them
    hold ``c_t m - (4/3) k m^2`` along s and ``(2/3) k m^2`` ahead of it, as well as four classes can."""
    m = 0.2
    legs = [at(m, angle) for angle in range(0, 721, 10)]
    a_t = tangential(law(closure=SHIFTED), legs, increments=1)[-36:]
    angles = np.radians(np.arange(720 - 350, 721, 10))
    ahead = np.stack([a_t[:, 0] * np.cos(angles) + a_t[:, 1] * np.sin(angles),
                      a_t[:, 1] * np.cos(angles) - a_t[:, 0] * np.sin(angles)])  # fmt: skip
    assert ahead.mean(axis=1) == pytest.approx([C_T * m - 4 / 3 * K * m * m, 2 / 3 * K * m * m], abs=0.007)
    # the axes mean nothing: no ripple
    assert np.ptp(ahead, axis=1) == pytest.approx(0.0, abs=1e-4)


def test_increments_do_not_matter_on_straight_ways():
    """Elements see ends only: one increment or forty, the same to what the substeps err by."""
    targets = [at(0.25), at(-0.1), at(0.12, 40.0)]
    few, many = (tangential(law(closure=SHIFTED, tolerance=1e-9), targets, n)[-1] for n in (1, 40))
    assert few == pytest.approx(many, abs=1e-7)


def test_a_bent_way_converges_with_the_increments():
    """Nearly a turn of the stress at constant q/p in chords against an eightfold number: the error falls as 1/n^2."""
    ends = []
    numbers = (8, 16, 32, 256)
    for number in numbers:
        targets = [at(0.2, angle) for angle in np.linspace(0, 170, number + 1)]
        ends.append(tangential(law(closure=SHIFTED, tolerance=1e-9), targets, 1)[-1])
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    assert errors[0] < 1e-3 and np.polyfit(np.log(numbers[:-1]), np.log(errors), 1)[0] < -1.7


def test_without_rotation_it_is_the_same_along_the_axes():
    targets = [at(0.25), at(-0.2), at(0.1), at(0.15, p=1.6), at(-0.1, p=0.7)]
    flat = law(Effects(principal_rotation=False), SHIFTED)
    assert [v.components for v in flat.description.state if v.name.startswith("held")] == [1] * CLASSES
    names = ("tangential_force_anisotropy_1", "coordination", "fabric_anisotropy_1")
    legs = [Leg(target=target, increments=5) for target in targets]
    histories = [drive(each, START, legs).columns for each in (law(closure=SHIFTED), flat)]
    for name in names:
        assert histories[0][name] == pytest.approx(histories[1][name], abs=1e-9)


def turned_back(contact_law):
    """Points that have been loaded, turned, unloaded partly, at pressures that have risen or fallen."""
    ways = np.array([
        [at(0.25), at(0.05, 30.0), at(0.12, 80.0)],
        [at(0.2, 10.0), at(0.2, 10.0, 1.8), at(0.05, 60.0, 1.5)],
        [at(0.2, 70.0), at(0.25, 70.0, 0.6), at(0.1, 20.0, 0.7)],
        [at(0.1, 130.0), at(0.2, -40.0), at(0.15, 40.0, 1.3)],
    ])  # fmt: skip
    points = Points(contact_law, np.repeat([START], len(ways), axis=0).astype(float))
    for leg in range(ways.shape[1]):
        end, state, _, report = points.mixed((1, 1, 1), ways[:, leg] - points.stress)
        assert report.failed == 0, report.message
        points = Points(contact_law, end, state)
    return points


MOVES = np.array([(2.0, -1.6, 1.0), (-2.0, 0.9, -1.3), (2.2, -1.5, 1.2), (-3.0, -1.0, 2.0)]) * 1e-5
DIRECTION = np.array([(0.3, -0.5, 0.7), (0.4, 0.6, -0.3), (0.9, 0.1, 0.2), (-0.3, 0.5, 0.4)]) * 1e-5


@pytest.mark.parametrize("numerics", [{"substeps": 1}, {"substeps": 5}], ids=str)
@pytest.mark.parametrize("effects", [Effects(), Effects(principal_rotation=False)], ids=["all", "no rotation"])
@pytest.mark.parametrize("slip", [0.6, 1.0, 2.3])
def test_tangent_is_exact(slip, effects, numerics):
    """Taylor remainder of the propagated tangent: second order."""
    contact_law = law(effects, replace(SHIFTED, slip=slip), [material(force_density_slope=-0.3)], **numerics)
    points = turned_back(contact_law)
    stress, _, tangent, report = points.update(MOVES)
    assert report.failed == 0, report.message
    change = np.einsum("pij,pj->pi", tangent, DIRECTION)
    # where an element comes to its limit there is a kink: a tangent that is wrong would be so on both sides of it
    sizes = 0.02 * 0.5 ** np.arange(7)
    both = [
        [np.abs(points.update(MOVES + t * DIRECTION)[0] - stress - t * change).max(axis=1) for t in sizes * side]
        for side in (1.0, -1.0)
    ]
    remainders = np.where(np.array(both)[0, -1] < np.array(both)[1, -1], *np.array(both))
    for column in remainders.T:
        fit = np.flatnonzero(column > 3e-9)[-4:]
        if len(fit) >= 3:
            assert np.polyfit(np.log(sizes[fit]), np.log(column[fit]), 1)[0] > 1.7
    largest = np.abs(sizes[0] * change).max()
    assert remainders[0].max() < 2e-3 * largest


def test_memory_is_in_the_tangent():
    """The test above can fail: the tangents with and without memory differ where the stress turns back."""
    laws = [law(effects, SHIFTED, substeps=1) for effects in (Effects(), FORGETS)]
    tangents = [turned_back(each).update(MOVES)[2] for each in laws]
    assert np.abs(tangents[0] - tangents[1]).max() > 1e-3 * np.abs(tangents[0]).max()


def test_a_zero_increment_changes_nothing():
    points = turned_back(law(closure=SHIFTED))
    stress, state, _, report = points.update(np.zeros((4, 3)))
    assert report.failed == 0
    assert stress.tobytes() == points.stress.tobytes() and state.tobytes() == points.state.tobytes()


def test_stress_on_which_it_starts_counts_as_first_loading():
    """Loaded straight to q/p = 0.2 or put there: what is held is the same, and so is what follows."""
    contact_law = law(closure=SHIFTED)
    put = contact_law.initial_state(np.array([at(0.2, 25.0)]))
    way = drive(contact_law, START, [Leg(target=at(0.2, 25.0), increments=4)])
    for variable in contact_law.description.state:
        if variable.name.startswith(("held", "tangential_force")):
            columns = contact_law.description.columns(variable.name)
            assert put[:, columns] == pytest.approx(way.state[:, columns], abs=1e-9)


def test_columns_only_where_it_acts():
    """Neither without slip or tangential forces, nor with another closure, nor in a network at rest."""
    for contact_law in (
        law(FORGETS, SHIFTED),
        law(closure=replace(SHIFTED, slip=0.0)),
        law(closure=replace(SHIFTED, tangential_force_ratio=0.0)),
        law(closure=replace(SHIFTED, tangential="self_consistent")),
        law(closure=Closure()),
        law(Effects(contact_loss=False, contact_gain=False), SHIFTED),
    ):
        assert not any(variable.name.startswith("held") for variable in contact_law.description.state)
        assert not getattr(contact_law._kernel_closure, "remembers", False)
    held = [v.components for v in law(closure=SHIFTED).description.state if v.name.startswith("held")]
    assert held == [2] * CLASSES


def test_with_sliding():
    """Both together: a loop beyond first yield runs, and what is held belongs to the stress at its end."""
    contact_law = law(Effects(sliding=True), SHIFTED, [material(peak_stress_ratio=0.4)])
    history = drive(contact_law, START, [Leg(target=at(0.3), increments=6), Leg(target=at(0.0), increments=6)])
    assert history.finished
    without = drive(
        law(Effects(sliding=True, tangential_memory=False), SHIFTED, [material(peak_stress_ratio=0.4)]),
        START,
        [Leg(target=at(0.3), increments=6), Leg(target=at(0.0), increments=6)],
    )
    a_t = [each.columns["tangential_force_anisotropy_1"] for each in (history, without)]
    assert a_t[0][6] == pytest.approx(a_t[1][6], abs=1e-9) and a_t[0][-1] < a_t[1][-1] - 0.03
    held = history.state[0, contact_law.description.columns("held_stress_ratio_1")]
    assert held == pytest.approx([-slip_classes(C_T, K)[0, 0], 0.0])
