"""Memory of tangential forces: Masing's rule, first loading untouched, states and tangents (`network.slip_memory`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contact_law_cases import PRESSURE, Points, law, material

from granfabric.constitutive.effects import Effects
from granfabric.constitutive.network import slip_memory
from granfabric.constitutive.network.slip_memory import CLASSES, initially_held, slip_classes, slip_directions
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
    """Averaged over directions, classes of uniform thresholds add up to ``c_t s - k s^2``: midpoint rule, slope two."""
    errors = []
    for number in (8, 16, 32, 64):
        many_classes(monkeypatch, number)
        classes, axes = slip_classes(C_T, K), 2 * np.pi * np.arange(48) / 48
        assert classes[:, 1].sum() == pytest.approx(1.0, rel=1e-12)
        off = []
        for s in (0.05, 0.13, 0.2, 0.29):
            held = [
                2 * np.mean(np.cos(axes) * np.clip(s * np.cos(axes), -threshold, threshold)) * share
                for threshold, share in classes
            ]
            off.append(C_T * np.sum(held) - (C_T * s - K * s * s))
        errors.append(np.abs(off).max())
    assert errors[-1] < 2e-5
    assert np.polyfit(np.log([8, 16, 32, 64]), np.log(errors), 1)[0] < -1.7


def test_directions_carry_what_they_should():
    """The weighted sum of e e is the unit matrix, along the axes without rotation."""
    directions = slip_directions(True)
    assert np.einsum("j,ji,jk->ik", directions[:, 2], directions[:, :2], directions[:, :2]) == pytest.approx(np.eye(2))
    flat = slip_directions(False)
    assert flat[:, 2] @ flat[:, 0] ** 2 == pytest.approx(1.0)
    held = initially_held(np.array([[0.2, 0.0]]), C_T, K, True)
    for name, values in initially_held(np.array([[0.2, 0.0]]), C_T, K, False).items():
        assert values == pytest.approx(held[name])


@pytest.mark.parametrize("angle", [0.0, 37.0])
def test_masing(angle):
    """On unloading ``g(s_1) - 2 g((s_1 - s)/2)``, as well as three classes can; reloading goes through the turn."""
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
    assert a_t[8] < a_t[16] < free[16] - 0.002
    assert a_t[24] < a_t[8] - 0.001


def test_a_turning_stress_is_led_by_what_contacts_hold():
    """Steady response of elements under a turning stress (describing function of a stop): in phase
    ``c_t s - (3 pi/8) k s^2``, ahead ``(4/pi)(1/3)(3 pi/8) k s^2 = k s^2/2``; three directions and classes ripple by
    an eighth of that."""
    m = 0.2
    legs = [at(m, angle) for angle in range(0, 721, 10)]
    a_t = tangential(law(closure=SHIFTED), legs, increments=1)[-36:]
    angles = np.radians(np.arange(720 - 350, 721, 10))
    ahead = np.stack([a_t[:, 0] * np.cos(angles) + a_t[:, 1] * np.sin(angles),
                      a_t[:, 1] * np.cos(angles) - a_t[:, 0] * np.sin(angles)])  # fmt: skip
    assert ahead.mean(axis=1) == pytest.approx([C_T * m - 3 * np.pi / 8 * K * m * m, 0.5 * K * m * m], abs=0.003)


def test_increments_do_not_matter_on_straight_ways():
    """Elements see ends only: one increment or forty, the same to what the substeps err by."""
    targets = [at(0.25), at(-0.1), at(0.12, 40.0)]
    few, many = (tangential(law(closure=SHIFTED, tolerance=1e-9), targets, n)[-1] for n in (1, 40))
    assert few == pytest.approx(many, abs=1e-7)


def test_a_bent_way_converges_with_the_increments():
    """Nearly a turn of the stress at constant q/p in 4 to 64 chords against 256."""
    ends = []
    for number in (4, 8, 16, 32, 64, 256):
        targets = [at(0.2, angle) for angle in np.linspace(0, 170, number + 1)]
        ends.append(tangential(law(closure=SHIFTED, tolerance=1e-9), targets, 1)[-1])
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    # elements see the turn of their own direction only, so that chords do little harm to begin with
    assert errors[0] < 5e-4 and errors[-1] < 1e-5


def test_without_rotation_it_is_the_same_along_the_axes():
    targets = [at(0.25), at(-0.2), at(0.1), at(0.15, p=1.6), at(-0.1, p=0.7)]
    flat = law(Effects(principal_rotation=False), SHIFTED)
    assert sum(name.startswith("held") for name in (v.name for v in flat.description.state)) == 2 * CLASSES
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
    assert sum(v.name.startswith("held") for v in law(closure=SHIFTED).description.state) == 3 * CLASSES


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
    held = history.state[0, contact_law.description.columns("held_stress_ratio_1_0")]
    assert held == pytest.approx(-slip_classes(C_T, K)[0, 0])
