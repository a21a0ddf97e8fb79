"""Pressure to a millionth and through zero, dp = 0, ds = 0, the borders of the arcs, reversals, cycles, huge steps.

Each case has its right outcome: a number with its argument, or a refusal. Where a closure is not known here, what holds
for any is asked: finite, admissible, refused points stay where they are.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hard_laws import (
    PRESSURE,
    Trail,
    assert_sound,
    each_closure,
    each_integration,
    follow,
    make_law,
    material,
    steps_to,
    stress_of,
)

from granfabric.constitutive.contract import Status
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Integration

P0 = 0.5
EVERY, EACH = each_closure(), each_integration()


def law_or_skip(closure: Closure, integration: Integration | None = None, **options: object) -> ContactLaw:
    law = make_law(closure, integration, **options)  # type: ignore[arg-type]
    if law is None:
        pytest.skip("refused by name")
    return law


def is_mean_field(closure: Closure) -> bool:
    return closure.force_change == "mean_field"


def accuracy(integration: Integration) -> float:
    """Error to expect over a path of some tens of substeps: the tolerance each, or first order of fixed ones."""
    return 100 * integration.tolerance if not integration.substeps else 0.05


# ---------------------------------------------------------------- pressure


@pytest.mark.parametrize("integration", EACH)
@pytest.mark.parametrize("closure", EVERY)
def test_pressure_to_a_millionth(closure: Closure, integration: Integration) -> None:
    """Isotropic unloading in sixty equal factors. Everywhere the mean force falls by d = dp/p: l = -P0 d in all
    directions, so dz/z = P0 d and z = z0 (p/p0)^P0, 4.06e-3 at a millionth. The shifted distribution counts forces in
    units of the initial mean: D = chi_p (1 - p/p0), S = c_p D and z = z0 exp(-L - L^2/2) with L = P0 (S phi(D/S)
    + D Phi(D/S)), so that 2.99 is left where next to no pressure is.
    """
    p = PRESSURE * np.logspace(0, -6, 61)[1:]
    trail = follow(
        law_or_skip(closure, integration),
        stress_of(PRESSURE)[None],
        steps_to(stress_of(p)[:, None], stress_of(PRESSURE)),
    )
    assert_sound(trail)
    z = trail.get("coordination")[:, 0]
    reached = trail.status[1:, 0] <= Status.LIMITED
    if is_mean_field(closure):
        expected = 4.06 * (p / PRESSURE) ** P0
        if closure.shear_stiffness == "uniform_strain":
            assert reached.all()
        else:  # refused where z comes to the isostatic number, and there only
            assert reached.sum() == np.count_nonzero(expected > 3.0)
            assert trail.status[-1, 0] == Status.STIFFNESS_LOST
        assert z[1:][reached] == pytest.approx(expected[reached], rel=accuracy(integration))
    elif closure.force_change == "shifted_distribution":
        shift = closure.weak_contact_ratio_isotropic * (1.0 - p / PRESSURE)
        u = 1.0 / closure.elastic_scatter_isotropic
        opened = P0 * shift * (np.exp(-u * u / 2) / (u * np.sqrt(2 * np.pi)) + 0.5 * (1 + math.erf(u / np.sqrt(2))))
        expected = 4.06 * np.exp(-opened - opened**2 / 2)
        if closure.shear_stiffness == "uniform_strain":
            assert reached.all()
        else:  # 2.99 is below the isostatic number
            assert reached.sum() == np.count_nonzero(expected > 3.0)
            assert trail.status[-1, 0] == Status.STIFFNESS_LOST
        assert z[1:][reached] == pytest.approx(expected[reached], rel=accuracy(integration))


@pytest.mark.parametrize("closure", EVERY)
def test_extension_to_zero_pressure(closure: Closure) -> None:
    """Strain-driven. K = K0 z/z0 = K0 sqrt(p/p0) gives sqrt(p/p0) = 1 - K0 e/(2 p0): free of pressure at e = 2 p0/K0.

    To 0.999 of that p is a millionth; to 1.001 of it the point is refused with NO_PRESSURE and stays where it was.
    """
    law = law_or_skip(closure, Integration(tolerance=1e-8, maximum_substeps=2000))
    bulk = 4.06 * 0.846 * 1e9 / (2 * np.pi)
    volume = 2 * PRESSURE / bulk * np.array([0.999, 1.001, 1.5, 100.0])
    increments = np.repeat(np.stack([volume / 2, volume / 2, 0 * volume], axis=1)[None], 50, axis=0) / 50
    trail = follow(law, stress_of(PRESSURE)[None], increments, control=(0, 0, 0))
    assert_sound(trail)
    if is_mean_field(closure) and closure.shear_stiffness == "uniform_strain":
        assert list(trail.status[-1] > Status.LIMITED) == [False, True, True, True], trail.status[-1]
        assert set(trail.status[-1, 1:]) == {Status.NO_PRESSURE}
        assert trail.pressure[-1, 0] == pytest.approx(
            1e-6 * PRESSURE, rel=1e-2
        )  # the end magnifies errors a thousandfold
    elif closure.force_change == "shifted_distribution" and closure.shear_stiffness == "uniform_strain":
        # z stays above 2.99, so that 4.06/2.99 p0/K0 of volume is the most before no pressure is left
        assert set(trail.status[-1]) == {Status.NO_PRESSURE}
    else:  # where contacts open faster than pressure falls, the network is gone before the pressure
        assert (trail.pressure[-1, 3] < 0.1 * PRESSURE) or (trail.status[-1, 3] > Status.LIMITED)


@pytest.mark.parametrize("integration", EACH)
@pytest.mark.parametrize("closure", EVERY)
def test_stress_driven_through_zero(closure: Closure, integration: Integration) -> None:
    """In one increment to tension, and to exactly zero: refused; nothing has changed."""
    law = law_or_skip(closure, integration)
    start = np.array([stress_of(PRESSURE), stress_of(PRESSURE, 0.2, 0.1)] * 3)
    increments = np.array([-start[0], -start[1], -2 * start[2], -2 * start[3], -10 * start[4], [3e5, -1e4, 2e4]])
    trail = follow(law, start, increments[None])
    assert_sound(trail)
    assert (trail.status[-1] > Status.LIMITED).all()
    if not integration.substeps:
        legal = {Status.NO_PRESSURE, Status.STIFFNESS_LOST, Status.NOT_CONVERGED, Status.NOT_ADMISSIBLE}
        assert set(trail.status[-1]) <= legal | {Status.TOO_MANY_SUBSTEPS}


# ---------------------------------------------------------------- dp = 0, ds = 0, borders of the arcs


@pytest.mark.parametrize("integration", EACH)
@pytest.mark.parametrize("closure", EVERY)
def test_dp_zero_exactly_and_nearly(closure: Closure, integration: Integration) -> None:
    """dp/p = 0, and 1e-300 to 1e-6 of it either way: end states differ by no more than ten times dp/p, and rounding."""
    law = law_or_skip(closure, integration)
    sizes = np.array([0.0, *(sign * 10.0**-k for k in (300, 100, 20, 16, 12, 9, 6) for sign in (1, -1))])
    for ratio in (0.0, 0.2):
        start = stress_of(PRESSURE, ratio)
        end = stress_of(PRESSURE * (1 + sizes), ratio + 0.05, 0.02)
        trail = follow(law, start[None], steps_to(end[None], start))
        assert_sound(trail)
        assert (trail.status[-1] == Status.OK).all()
        differ = np.abs(trail.state[-1] - trail.state[-1, :1]).max(axis=1)
        assert (differ <= 10 * np.abs(sizes) + 20 * accuracy(integration) * (np.abs(sizes) > 0) * 1e-6 + 1e-12).all()


@pytest.mark.parametrize("closure", EVERY)
def test_d_within_rounding_of_the_borders(closure: Closure) -> None:
    """From isotropy w = 2 ds and d = dp/p: dp = +-2 dq (1 + k eps), where the arcs of loss or gain vanish.

    Near the border what is lost goes with the arc's width cubed, (k eps)^1.5: the ends of neighbours agree to rounding.
    """
    law = law_or_skip(closure, Integration(tolerance=1e-10))
    k = np.array([0, *(sign * n for n in (1, 2, 4, 100, 10_000, 10**8) for sign in (1, -1))]) * 2.2e-16
    for sign in (1.0, -1.0):
        for size in (1e-12, 1e-6, 1e-2):
            dq = size * PRESSURE
            dp = sign * 2 * dq * (1 + k)
            increments = np.stack([-dp - dq, -dp + dq, 0 * dp], axis=1)[None]
            trail = follow(law, stress_of(PRESSURE)[None], increments)
            assert_sound(trail)
            assert (trail.status[-1] == Status.OK).all()
            differ = np.abs(trail.state[-1] - trail.state[-1, :1]).max(axis=1)
            # 4 eps for rounding of numbers of order one, once a substep, of which there are less than a hundred
            assert (differ <= 10 * size * np.abs(k) + 400 * 2.2e-16).all()


@pytest.mark.parametrize("integration", EACH)
@pytest.mark.parametrize("closure", EVERY)
def test_proportional_loading(closure: Closure, integration: Integration) -> None:
    """ds = 0, from q/p = 0.3: with b = 0 the mean force changes by d (1 + a_n.e), up in every direction: nothing is
    lost while p doubles, and going back nothing is gained; on the way back z falls as p^P0.
    """
    law = law_or_skip(closure, integration)
    start = stress_of(PRESSURE, 0.24, 0.18)
    up = stress_of(PRESSURE * np.linspace(1, 2, 21)[1:], 0.24, 0.18)
    trail = follow(law, start[None], steps_to(np.concatenate([up, up[::-1][1:], start[None]])[:, None], start))
    assert_sound(trail)
    if is_mean_field(closure) and closure.shear_stiffness == "isostatic":
        # at half the pressure z would be 4.07 / sqrt 2, below the isostatic number
        assert trail.status[-1, 0] == Status.STIFFNESS_LOST
        return
    assert (trail.status[-1] <= Status.LIMITED).all()
    if is_mean_field(closure) and closure.tangential == "neglected":
        lost, gained, z = (trail.get(f"coordination{part}")[:, 0] for part in ("_lost", "_gained", ""))
        assert lost[20] <= 1e-12 and gained[40] - gained[20] <= 1e-12
        assert z[40] == pytest.approx(z[20] * 0.5**P0, rel=accuracy(integration))


# ---------------------------------------------------------------- reversals, cycles, huge steps


@pytest.mark.parametrize("integration", EACH)
@pytest.mark.parametrize("closure", EVERY)
def test_reversals_of_every_size(closure: Closure, integration: Integration) -> None:
    """One loop of q/p at constant p, 0 -> s -> 0, s from 1e-15 to 0.1. In the mean field both ways lose 2 P0/pi s:
    dz/z = -4 P0/pi s to first order, 4/pi (P0 + P0 C) with gain, which is 5e-4 of it at kn/p = 1e4. Any closure changes
    by less than 3 s.
    """
    law = law_or_skip(closure, integration)
    sizes = 10.0 ** -np.arange(1, 16)
    there = stress_of(PRESSURE, sizes)[None]
    back = np.broadcast_to(stress_of(PRESSURE), there.shape)
    trail = follow(law, stress_of(PRESSURE)[None], steps_to(np.concatenate([there, back]), stress_of(PRESSURE)))
    assert_sound(trail)
    assert (trail.status[-1] == Status.OK).all()
    change = trail.get("coordination")[-1] / 4.06 - 1
    assert (np.abs(change) <= 3 * sizes + 1e-14).all()
    if is_mean_field(closure) and closure.tangential == "neglected":
        some = (sizes < 2e-3) & (sizes > 1e-10)
        assert change[some] == pytest.approx(-4 * P0 / np.pi * sizes[some], rel=2e-2)


@pytest.mark.parametrize("cycles", [30, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("closure", EVERY)
def test_a_thousand_cycles(closure: Closure, cycles: int) -> None:
    """q/p from 0 to 0.05 and back, a thousand times. The mean field ratchets; whatever it comes to is admissible or
    refused. The shifted distribution is a function of the state on what was loaded before: the last loop ends where the
    second did, to a tolerance for each substep of all ways.
    """
    law = law_or_skip(closure, Integration(tolerance=1e-5))
    away, home = stress_of(PRESSURE, 0.05), stress_of(PRESSURE)
    way = steps_to(np.array([away, home])[:, None], home)
    trail = follow(law, home[None], np.tile(way, (cycles, 1, 1)), every=2)
    assert_sound(trail)
    z = trail.get("coordination")[:, 0]
    if closure.force_change == "shifted_distribution":
        assert trail.status[-1, 0] == Status.OK
        assert np.ptp(z[2:]) < trail.substeps[-1, 0] * 1e-5 * 4.06
    elif is_mean_field(closure):
        running = trail.status[:, 0] <= Status.LIMITED
        # z falls in every loop, at last by less than the tolerance of a substep
        assert (np.diff(z[running]) < 1e-5).all() and running[:5].all()
        assert (np.diff(z[running])[:20] < 0).all()
        assert running.all() or trail.status[-1, 0] in (Status.STIFFNESS_LOST, Status.NOT_ADMISSIBLE)


@pytest.mark.parametrize("integration", EACH)
@pytest.mark.parametrize("closure", EVERY)
def test_ten_times_the_whole_test_in_one_increment(closure: Closure, integration: Integration) -> None:
    """q/p = 3 at constant p in one increment and in a hundred: the same end to the tolerances of the substeps, or a
    refusal in both. A step that is refused has changed nothing.
    """
    law = law_or_skip(closure, integration)
    start = stress_of(PRESSURE)
    one = follow(law, start[None], steps_to(stress_of(PRESSURE, 3.0)[None, None], start))
    many = follow(law, start[None], steps_to(stress_of(PRESSURE, np.linspace(0, 3, 101)[1:])[:, None], start))
    assert_sound(one)
    assert_sound(many)
    if Status.TOO_MANY_SUBSTEPS in (one.status[-1, 0], many.status[-1, 0]):
        return  # an integrator of low order may say that it cannot
    if integration.substeps:  # 64 substeps of 0.047 in q/p: first order, or refused where control would cut
        return
    assert (one.status[-1, 0] > Status.LIMITED) == (many.status[-1, 0] > Status.LIMITED)
    if one.status[-1, 0] <= Status.LIMITED:
        allowed = 50 * integration.tolerance * (one.substeps[-1, 0] + many.substeps[-1, 0])
        z = one.get("coordination")[-1, 0], many.get("coordination")[-1, 0]
        assert abs(np.log(z[0] / z[1])) < allowed


@pytest.mark.parametrize("integration", EACH)
@pytest.mark.parametrize("closure", EVERY)
def test_stress_ratios_beyond_one(closure: Closure, integration: Integration) -> None:
    """To q/p = 1.5, along x and turned: beyond |a_n| = 0.98 rates are clipped, and every such point says so. Shifted
    weak forces are not clipped: their density is positive whatever a_n. The three directions lose the same share and,
    where the law refuses to go on, end at the same ratio, whatever axis the principal direction lies on.
    """
    law = law_or_skip(closure, integration, materials=[material(force_anisotropy_ratio=1.1)])
    ends = stress_of(PRESSURE, 1.5 * np.cos([0.0, 1.0, 2.0]), 1.5 * np.sin([0.0, 1.0, 2.0]))
    targets = stress_of(PRESSURE) + np.linspace(0, 1, 31)[1:, None, None] * (ends - stress_of(PRESSURE))
    trail = follow(law, stress_of(PRESSURE)[None], steps_to(targets, stress_of(PRESSURE)))
    assert_sound(trail)
    alive = trail.status[-1] <= Status.LIMITED
    if is_mean_field(closure):
        beyond = trail.ratio[-1] * 1.1 > 0.98
        assert (trail.status[-1][alive & beyond] == Status.LIMITED).all()
    np.testing.assert_array_equal(trail.status, trail.status[:, :1].repeat(3, axis=1))
    followed = (trail.status <= Status.LIMITED).all(axis=1)
    # 31 steps to the end at most; everybody is refused beyond q/p = 0.6 at the earliest
    assert followed.sum() > 12
    z = trail.get("coordination")[followed]
    assert z[-1].max() < 0.9 * 4.06
    assert np.ptp(z, axis=1).max() < 1e-6 * 4.06 + accuracy(integration)


def trails_of(law: ContactLaw) -> Trail:
    """Used by the pictures: isotropic unloading to a millionth."""
    p = PRESSURE * np.logspace(0, -6, 61)[1:]
    return follow(law, stress_of(PRESSURE)[None], steps_to(stress_of(p)[:, None], stress_of(PRESSURE)))
