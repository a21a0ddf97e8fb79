"""The closure by shifted weak forces where the pressure falls and rises: tangent, extremes, choices at their ends."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from contact_law_cases import PRESSURE, Points, law, material

from granfabric.constitutive.contract import Status
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.parameters import Closure, ParameterError
from granfabric.constitutive.path import Leg, drive

SHIFTED = Closure(force_change="shifted_distribution")
START = (-PRESSURE, -PRESSURE, 0.0)

CLOSURES = {
    "frictional": SHIFTED,
    "self_consistent": replace(SHIFTED, tangential="self_consistent"),
    "isostatic": replace(SHIFTED, shear_stiffness="isostatic"),
    "chi_zero": replace(SHIFTED, weak_contact_ratio=0.0),
    "chi_beyond_one": replace(SHIFTED, weak_contact_ratio=1.3),
    "chi_one": replace(SHIFTED, weak_contact_ratio=1.0),
    "no_scatter": replace(SHIFTED, elastic_scatter=0.0, elastic_scatter_isotropic=0.0, irreversible_scatter=0.0),
    "stretched_as_a_whole": replace(SHIFTED, weak_contact_gradient=1.0),
    "not_stretched": replace(SHIFTED, weak_contact_gradient=0.0),
    "no_tangential_forces": replace(SHIFTED, tangential_force_ratio=0.0),
    "no_slip": replace(SHIFTED, slip=0.0),
    "all_tangential_forces_lost": replace(SHIFTED, tangential_force_loss=20.0),
}
MATERIALS = {
    "line": material(force_density_slope=-0.4),
    "rising_line": material(force_density_slope=0.5, gap_density_at_zero=60.0),
    "end_of_the_line": material(force_density_at_zero=0.3, force_density_slope=-1.5, initial_fabric_xx=0.1),
    "no_weak_forces": material(force_density_at_zero=0.0, force_density_slope=0.0),
    "rising_from_nothing": material(force_density_at_zero=0.0, force_density_slope=1.0),
}
EFFECTS = {
    "all": Effects(),
    "no_loss": Effects(contact_loss=False),
    "no_gain": Effects(contact_gain=False),
    "no_spread": Effects(irreversible_spread=False),
}


def far_points(contact_law):
    """Points that stand far from their initial pressure: at 0.3 to 0.5 of it, at 1.6 and 3, on straight and bent ways.

    Only the last increment remains to be done, falling or rising.
    """
    ends = np.array([(-0.35, -0.25, 0.03), (-0.6, -0.4, -0.05), (-1.7, -1.5, 0.1), (-3.3, -2.7, 0.2)]) * PRESSURE
    stress, state = np.repeat([START], 4, axis=0).astype(float), None
    steps = 6
    points = Points(contact_law, stress, state)
    for _ in range(steps):
        stress, state, _, report = points.mixed((1, 1, 1), (ends - np.array(START)) / steps)
        assert report.failed == 0, report.message
        points = Points(contact_law, stress, state)
    return points


MOVES = np.array([(2.0, 1.6, 1.0), (-2.0, 0.5, -1.0), (2.5, 1.5, 1.0), (-3.0, -1.0, 2.0)]) * 1e-5
MOVES[:2] *= 0.3
DIRECTION = np.array([(0.3, -0.5, 0.7), (0.4, 0.6, -0.3), (0.9, 0.1, 0.2), (-0.3, 0.5, 0.4)]) * 1e-5
DIRECTION[:2] *= 0.3


def assert_second_order(contact_law) -> None:
    """Taylor remainder of the tangent of one substep: it falls with the square of the size."""
    points = far_points(contact_law)
    stress, _, tangent, report = points.update(MOVES)
    assert report.failed == 0, report.message
    sizes = 0.3 * 0.5 ** np.arange(9)
    change = np.einsum("pij,pj->pi", tangent, DIRECTION)
    remainders = np.array(
        [np.abs(points.update(MOVES + t * DIRECTION)[0] - stress - t * change).max(axis=1) for t in sizes]
    )
    for column in remainders.T:
        fit = np.flatnonzero(column > 1e-8)[-4:]
        if len(fit) < 3:
            continue  # linear to rounding, which is 1e-16 of 3e5 Pa
        assert np.polyfit(np.log(sizes[fit]), np.log(column[fit]), 1)[0] > 1.9


@pytest.mark.parametrize("name", [name for name in CLOSURES if name != "no_scatter"])
def test_tangent_of_every_closure(name):
    """Without any scatter a direction starts to lose at once, which is a kink."""
    closure = CLOSURES[name]
    assert_second_order(law(closure=closure, substeps=1, materials=[MATERIALS["line"]]))


@pytest.mark.parametrize("packing", MATERIALS.values(), ids=MATERIALS)
@pytest.mark.parametrize("effects", EFFECTS.values(), ids=EFFECTS)
def test_tangent_of_every_material(packing, effects):
    assert_second_order(law(effects=effects, closure=SHIFTED, substeps=1, materials=[packing]))


@pytest.mark.parametrize("kind", ["stress", "strain"])
@pytest.mark.parametrize("closure", CLOSURES.values(), ids=CLOSURES)
def test_isotropic_unloading_to_a_tenth(closure, kind):
    """It runs, and is reversible: what comes back is what was there.

    Strain-driven by the strain that the stress-driven way has taken; the same coordination number at its end.
    """
    contact_law = law(closure=closure, tolerance=1e-7, materials=[material(isostatic_coordination=2.65)])
    legs = [Leg(target=(-PRESSURE * p, -PRESSURE * p, 0.0), increments=8) for p in (0.1, 1.0)]
    columns = drive(contact_law, START, legs).columns
    z = columns["coordination"]
    assert 2.5 < z[8] < 3.9 and z[16] == pytest.approx(z[0], abs=1e-5)
    assert columns["fabric_anisotropy"] == pytest.approx(0.0, abs=1e-12)
    if kind == "strain":
        strain = [columns[f"strain_{axis}"] for axis in ("xx", "yy", "xy")]
        points = Points(contact_law, START)
        for step in range(8):
            move = [column[step + 1] - column[step] for column in strain]
            stress, state, _, report = points.update(move)
            assert report.failed == 0, report.message
            points = Points(contact_law, stress, state)
        assert -0.5 * stress[0, :2].sum() == pytest.approx(0.1 * PRESSURE, rel=1e-4)
        assert points.get(state, "coordination")[0, 0] == pytest.approx(z[8], abs=1e-5)


@pytest.mark.parametrize("packing", MATERIALS.values(), ids=MATERIALS)
@pytest.mark.parametrize("closure", CLOSURES.values(), ids=CLOSURES)
def test_pressures_far_from_the_first(closure, packing):
    """To a thousandth and to a thousand times, with and without a stress ratio: an end with numbers, or a refusal.

    No more than the six neighbours, however high the pressure.
    """
    contact_law = law(closure=closure, materials=[packing], maximum_substeps=2000)
    for p in (1e-3, 1e3):
        for ratio in (0.0, 0.2):
            points = Points(contact_law, START)
            target = -PRESSURE * p * np.array([1 + ratio, 1 - ratio, 0.0])
            way = np.diff(START + (target - START) * np.linspace(0, 1, 9)[:, None], axis=0)
            status = Status.OK
            for step in way:
                stress, state, _, report = points.mixed((1, 1, 1), step)
                status = Status(report.status[0])
                assert np.isfinite(stress).all() and np.isfinite(state).all()
                if status != Status.OK:
                    assert status in (Status.STIFFNESS_LOST, Status.NOT_CONVERGED, Status.NOT_ADMISSIBLE), status
                    break
                points = Points(contact_law, stress, state)
            # down to a thousandth the isotropic way is a matter of the shift of weak forces alone
            if ratio == 0.0 and p < 1.0 and closure is not CLOSURES["isostatic"]:
                assert status == Status.OK, (p, ratio, status)
            if status == Status.OK:
                z = points.get(points.state, "coordination")[0, 0]
                assert 0.0 < z <= 6.0
                assert -0.5 * points.stress[0, :2].sum() == pytest.approx(p * PRESSURE, rel=1e-9)


@pytest.mark.parametrize("p0", [0.3, 0.65])
@pytest.mark.parametrize("slope", [-3.0, -0.4, 0.0, 0.7])
def test_what_is_lost_where_the_pressure_falls(slope, p0):
    """Closed form without scatter: D = chi_p (1 - p/p0), Lambda the area of the line below it, to its end if it falls.

    At constant pressure nothing of it counts; a higher one loses nothing.
    """
    closure = CLOSURES["no_scatter"]
    packing = material(force_density_at_zero=p0, force_density_slope=slope, gap_density_at_zero=0.0)
    p = np.array([0.9, 0.6, 0.3, 0.1, 0.02, 2.0])
    legs = [Leg(target=(-PRESSURE * ratio, -PRESSURE * ratio, 0.0), increments=2) for ratio in p]
    z = drive(law(closure=closure, materials=[packing]), START, legs).columns["coordination"][2::2] / 4.06
    shift = np.maximum(closure.weak_contact_ratio_isotropic * (1.0 - p), 0.0)
    if slope < 0.0:
        shift = np.minimum(shift, -p0 / slope)
    lost = p0 * shift + slope * shift**2 / 2
    assert z == pytest.approx(np.exp(-lost - lost**2 / 2), rel=1e-9)


@pytest.mark.parametrize("control", [0, 1], ids=["strain", "stress"])
def test_no_more_contacts_than_neighbours(control):
    """Open pairs decay: z = 6 - (6 - z0) exp(-g chi_p (P - 1)) with g = P_xi0 f0/(2 kn r), to as high a P as one likes.

    Strain-driven by what K, in proportion to z, takes for steps of the pressure.
    """
    closure, packing = CLOSURES["no_scatter"], material(gap_density_at_zero=400.0)
    f0 = 2 * np.pi * PRESSURE / (4.06 * packing.solid_fraction * packing.normal_stiffness)
    g = 200.0 * f0 * closure.weak_contact_ratio_isotropic
    points = Points(law(closure=closure, materials=[packing]), START)
    bulk = packing.solid_fraction * packing.normal_stiffness / (2 * np.pi)
    reached = 1.0
    for _ in range(40):
        z = points.get(points.state, "coordination")[0, 0]
        assert z == pytest.approx(6.0 - 1.94 * np.exp(-g * (reached - 1)), rel=1e-5)
        step = -np.array([1.0, 1.0, 0.0]) * PRESSURE * (5.0 if control else 2.5 / (bulk * z))
        stress, state, _, report = points.mixed(3 * (control,), step)
        assert report.failed == 0, report.message
        points = Points(points.law, stress, state)
        reached = -0.5 * stress[0, :2].sum() / PRESSURE
    assert reached > 150.0 and 5.5 < z < 6.0


def test_no_gain_where_no_neighbour_is_left():
    """A packing that has as many contacts as neighbours, or more."""
    packing = material(coordination=6.0, gap_density_at_zero=400.0)
    legs = [Leg(target=(-30 * PRESSURE, -30 * PRESSURE, 0.0), increments=5)]
    z = drive(law(closure=CLOSURES["no_scatter"], materials=[packing]), START, legs).columns["coordination"]
    assert (z == 6.0).all()


@pytest.mark.parametrize("gradient", [0.0, 0.5, 0.85, 1.0])
def test_what_a_rising_pressure_loses_and_how_it_is_stretched(gradient):
    """z = z0 exp(-L), L = P0 c_p D (phi(u) - u Phi(-u)), u = 1/c_p, D = chi_p (P - 1)/P^a.

    Disks lose next to nothing, and stop losing at 2 p0.
    """
    closure = replace(CLOSURES["no_scatter"], elastic_scatter_isotropic=0.35, weak_contact_gradient=gradient)
    ratio = np.array([1.5, 4.0, 20.0, 300.0])
    legs = [Leg(target=(-PRESSURE * p, -PRESSURE * p, 0.0), increments=2) for p in ratio]
    packing = material(gap_density_at_zero=0.0)
    z = drive(law(closure=closure, materials=[packing]), START, legs).columns["coordination"][2::2]
    u = 1.0 / 0.35
    excess = np.exp(-u * u / 2) / np.sqrt(2 * np.pi) - u * 0.5 * math.erfc(u / np.sqrt(2))
    shift = closure.weak_contact_ratio_isotropic * (ratio - 1.0) / ratio**gradient
    lost = packing.force_density_at_zero * 0.35 * shift * excess
    assert z == pytest.approx(4.06 * np.exp(-lost - lost**2 / 2), rel=1e-8)


def test_half_as_much_force_is_half_as_far_from_zero():
    """A slope of the line in units of the initial mean force: the same whatever unit the stress has."""
    packing, other = MATERIALS["line"], replace(MATERIALS["line"], normal_stiffness=1e12)
    ends = []
    for made, unit in ((packing, 1.0), (other, 1e3)):
        legs = [Leg(target=(-4e4 * unit, -3e4 * unit, 1e3 * unit), increments=4)]
        history = drive(law(closure=SHIFTED, materials=[made]), np.array(START) * unit, legs).columns
        ends.append([history[name][-1] for name in ("coordination", "fabric_anisotropy", "normal_force_anisotropy")])
    assert ends[0] == pytest.approx(ends[1], rel=1e-9)


def test_without_any_response_of_weak_contacts_the_direction_does_not_matter():
    """chi = 0: z follows the pressure alone, whatever q/p, and no fabric grows."""
    closure = replace(CLOSURES["no_scatter"], weak_contact_ratio=0.0)
    legs = [Leg(target=(-0.72 * PRESSURE, -0.48 * PRESSURE, 0.0), increments=6)]
    history = drive(law(closure=closure), START, legs).columns
    lost = 0.5 * closure.weak_contact_ratio_isotropic * 0.4
    assert history["coordination"][-1] / 4.06 == pytest.approx(np.exp(-lost - lost**2 / 2), rel=1e-3)
    assert abs(history["fabric_anisotropy"][-1]) < 1e-3


def test_bounds_are_refused_by_name():
    for name, value in (
        ("weak_contact_ratio_isotropic", 0.0), ("weak_contact_gradient", -0.1), ("tangential_force_loss", -1.0),
        ("weak_contact_gradient", 2.1), ("tangential_force_loss", 21.0),
    ):  # fmt: skip
        with pytest.raises(ParameterError, match=f"closure.{name} = {value} is not a number in"):
            replace(SHIFTED, **{name: value})
    for value in (-10.1, 10.1):
        with pytest.raises(ParameterError, match=r"material\.force_density_slope"):
            material(force_density_slope=value)
