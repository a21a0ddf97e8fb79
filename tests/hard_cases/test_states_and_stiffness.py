"""Fabric at its limit, few contacts, rotating axes, extreme stiffness, bad starts, NaN, a million points."""

from __future__ import annotations

import resource
import time

import numpy as np
import pytest
from hard_laws import (
    PRESSURE,
    Trail,
    assert_sound,
    closures,
    each_closure,
    each_integration,
    effect_sets,
    follow,
    make_law,
    material,
    name_of,
    steps_to,
    stress_of,
)

from granfabric.constitutive.contract import Status
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Integration

CLOSURES = closures()
EVERY, EACH = each_closure(), each_integration()
P0 = 0.5


def law_or_skip(closure: Closure, integration: Integration | None = None, **options: object) -> ContactLaw:
    law = make_law(closure, integration, **options)  # type: ignore[arg-type]
    if law is None:
        pytest.skip("refused by name")
    return law


@pytest.mark.parametrize("integration", EACH)
@pytest.mark.parametrize("closure", EVERY)
def test_fabric_at_its_limit(closure: Closure, integration: Integration) -> None:
    """Start with a_c at the limit of its distribution and load on, and back: admissible, or refused.

    What was gained and lost accounts for z and a_c to rounding; a packing that is turned together with its loading does
    the same, at an angle at which no formula is simple; and where a_c is beyond what a second harmonic can be (1),
    the point says that its rates were clipped.
    """
    most = 0.999 if closure.distribution == "harmonic" else 1.35
    trails = []
    for angle in (0.0, 1.1):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        fabric = turn @ np.array([0.8, 0.6]) * most
        packing = material(initial_fabric_xx=fabric[0], initial_fabric_xy=fabric[1])
        law = law_or_skip(closure, integration, materials=[packing])
        start = stress_of(PRESSURE, *(turn @ np.array([0.2, 0.15])))
        ways = [sign * 0.6 * np.array(way) for sign in (1, -1) for way in ((1.0, 0.0), (0.8, 0.6))]
        ends = np.array([stress_of(PRESSURE, *(turn @ way)) for way in ways])
        targets = start + np.linspace(0, 1, 11)[1:, None, None] * (ends - start)
        trail = follow(law, start[None], steps_to(targets, start))
        assert_sound(trail)
        assert np.abs(_account(trail, "coordination") - packing.coordination).max() < 1e-12
        assert np.abs(_account(trail, "fabric_anisotropy") - fabric).max() < 1e-12
        trails.append(trail)
    straight, turned = trails
    np.testing.assert_array_equal(straight.status, turned.status)
    followed = straight.status <= Status.LIMITED
    assert followed[:4].all() and followed[:, :2].all()  # loading on is followed to its end
    z = [trail.get("coordination")[followed] for trail in trails]
    size = [np.linalg.norm(_columns(trail, "fabric_anisotropy"), axis=2) for trail in trails]
    allowed = 10 * integration.tolerance
    assert np.abs(z[0] - z[1]).max() < allowed and np.abs((size[0] - size[1])[followed]).max() < allowed
    if closure.force_change != "shifted_distribution" and closure.distribution == "harmonic":
        beyond = followed[1:] & (np.minimum(size[0][:-1], size[0][1:]) > 1.0)
        assert beyond.any() and (straight.status[1:][beyond] == Status.LIMITED).all()


def _columns(trail: Trail, name: str) -> np.ndarray:
    return trail.state[:, :, trail.law.description.columns(name)]


def _account(trail: Trail, name: str) -> np.ndarray:
    """A quantity less what was gained and plus what was lost of it since the start: its first value."""
    short = name.removesuffix("_anisotropy")
    return _columns(trail, name) - _columns(trail, f"{short}_gained") + _columns(trail, f"{short}_lost")


@pytest.mark.parametrize("closure", EVERY)
def test_few_contacts(closure: Closure) -> None:
    """Loss alone is relative: a network of a thousandth of a contact a particle loses the same share as one of four."""
    if closure.shear_stiffness == "isostatic":
        pytest.skip("has no stiffness below the isostatic number, and refuses the material by name")
    effects = Effects(**{name: name != "contact_gain" and bool(getattr(Effects(), name)) for name in Effects.names()})
    ends = []
    for z in (4.06, 1e-3):
        law = law_or_skip(closure, Integration(tolerance=1e-9), effects=effects, materials=[material(coordination=z)])
        start = stress_of(PRESSURE)
        trail = follow(law, start[None], steps_to(stress_of(PRESSURE, np.linspace(0, 0.3, 16)[1:])[:, None], start))
        assert_sound(trail)
        assert trail.status[-1, 0] == Status.OK
        ends.append(trail.get("coordination")[-1, 0] / z)
    # the irreversible spread of the shifted distribution goes with shear strain times kn r/f, in which z drops out
    assert ends[0] == pytest.approx(ends[1], rel=1e-6)


def test_the_last_contacts() -> None:
    """At the floor of z, a millionth, the point is refused; it does not creep on with strains of any size."""
    law = ContactLaw([material(coordination=1e-3, force_density_at_zero=2.0)])
    p = PRESSURE * np.logspace(0, -3, 31)[1:]
    trail = follow(law, stress_of(PRESSURE)[None], steps_to(stress_of(p)[:, None], stress_of(PRESSURE)))
    assert_sound(trail)
    reached = trail.status[1:, 0] <= Status.LIMITED
    # z = 1e-3 (p/p0)^2 is a millionth at p0 10^-1.5, the fifteenth of thirty steps
    assert reached.sum() in (14, 15) and trail.status[-1, 0] == Status.NOT_ADMISSIBLE
    assert trail.get("coordination")[-1, 0] >= 1e-6


@pytest.mark.parametrize("integration", EACH)
@pytest.mark.parametrize("closure", EVERY)
def test_axes_through_360_degrees(closure: Closure, integration: Integration) -> None:
    """Turning the axes of a packing without directions of its own: where the turn begins does not matter. Eight points
    start an eighth of a turn apart; after the whole turn their z are one number, to a tolerance each substep, and their
    fabrics are turned by what they started with. The sum over fixed directions of the shifted distribution is exact to
    rounding for its smooth integrand.
    """
    law = law_or_skip(closure, integration)
    begin = 2 * np.pi * np.arange(8) / 8
    start = stress_of(PRESSURE, 0.15 * np.cos(begin), 0.15 * np.sin(begin))
    turn = np.linspace(0, 4 * np.pi, 73)[1:, None]
    trail = follow(
        law, start, steps_to(stress_of(PRESSURE, 0.15 * np.cos(begin + turn), 0.15 * np.sin(begin + turn)), start)
    )
    assert_sound(trail)
    alive = trail.status[-1] <= Status.LIMITED
    assert alive.all() or not alive.any()
    if not alive.all():
        return
    allowed = 72e-8 if integration.substeps else 20 * integration.tolerance * trail.substeps[-1].max()
    assert np.ptp(trail.get("coordination")[-1]) < allowed * 4.06
    fabric = trail.get("fabric_anisotropy")[-1]
    back = np.stack([np.cos(begin), np.sin(begin)]), np.stack([-np.sin(begin), np.cos(begin)])
    for axis in back:
        assert np.ptp((fabric.T * axis).sum(axis=0)) < allowed


@pytest.mark.parametrize("ratio", [0.0, 1e-12, 1e-3, 0.5, 1.0])
def test_stiffness_ratios(ratio: float) -> None:
    """K = z phi kn/2 pi and G = z phi (kn + kt)/4 pi for kt/kn from 0 to 1, in the tangent of an isotropic packing."""
    for closure in CLOSURES:
        law = law_or_skip(closure, materials=[material(stiffness_ratio=ratio)])
        stress, tangent = stress_of(PRESSURE)[None].copy(), np.zeros((1, 3, 3))
        state = law.initial_state(stress)
        law.update(np.zeros((1, 3)), stress, state, stress.copy(), state.copy(), tangent)
        bulk, shear = 4.06 * 0.846 * 1e9 / (2 * np.pi), 4.06 * 0.846 * 1e9 * (1 + ratio) / (4 * np.pi)
        expected = [[bulk + shear, bulk - shear, 0], [bulk - shear, bulk + shear, 0], [0, 0, shear]]
        assert tangent[0] == pytest.approx(np.array(expected), rel=1e-12, abs=1e-6)


@pytest.mark.parametrize("integration", EACH)
@pytest.mark.parametrize("closure", EVERY)
def test_stiffness_over_pressure(closure: Closure, integration: Integration) -> None:
    """kn/p from 1e2 to 1e7, without gain: the network follows the stress alone, strains go with p/kn.

    The shifted distribution counts shear strain times kn r/f, which does not depend on kn either.
    """
    effects = Effects(**{name: name != "contact_gain" and bool(getattr(Effects(), name)) for name in Effects.names()})
    ends, strains = [], []
    for over in (1e2, 1e4, 1e7):
        law = law_or_skip(closure, integration, effects=effects, materials=[material(normal_stiffness=over * PRESSURE)])
        start = stress_of(PRESSURE)
        trail = follow(
            law, start[None], steps_to(stress_of(PRESSURE, np.linspace(0, 0.2, 5)[1:], 0.05)[:, None], start)
        )
        assert_sound(trail)
        assert trail.status[-1, 0] == Status.OK
        ends.append(trail.get("coordination")[-1, 0])
        strains.append(trail.strain[-1, 0] * over)
    assert ends == pytest.approx([ends[0]] * 3, rel=1e-10)
    for strain in strains[1:]:
        assert strain == pytest.approx(strains[0], rel=1e-10, abs=1e-12)


# ---------------------------------------------------------------- bad starts


@pytest.mark.parametrize("effects", [pytest.param(e, id=name_of(e)) for e in effect_sets()])
def test_bad_starts_are_refused_alone(effects: Effects) -> None:
    """Tension, no pressure, numbers that are not finite, states that are none: refused with the reason, the start kept,
    the zero increment included, and the neighbours in the batch as if alone.
    """
    for closure in CLOSURES:
        law = make_law(closure, effects=effects)
        if law is None:
            continue
        description = law.description
        z, fabric = description.columns("coordination"), description.columns("fabric_anisotropy")
        stress = np.tile(stress_of(PRESSURE, 0.1), (12, 1))
        state = law.initial_state(stress)
        increment = np.tile([-1e-6, 5e-7, 2e-7], (12, 1))
        healthy = follow_once(law, increment, stress, state)
        stress[1], stress[2], stress[3] = (1e5, 2e5, 0), (0, 0, 0), (-1e5, np.nan, 0)
        state[4, z], state[5, z], state[6, fabric], state[7, z] = 0.0, -4.0, 2.0, np.inf
        increment[8, 0], increment[9, 2] = np.nan, -np.inf
        end_stress, end_state, tangent, status = follow_once(law, increment, stress, state)
        expected = {1: Status.NO_PRESSURE, 2: Status.NO_PRESSURE, 3: Status.NOT_FINITE, 4: Status.NOT_ADMISSIBLE,
                    5: Status.NOT_ADMISSIBLE, 6: Status.NOT_ADMISSIBLE, 7: Status.NOT_FINITE, 8: Status.NOT_FINITE,
                    9: Status.NOT_FINITE}  # fmt: skip
        assert {k: Status(int(status[k])) for k in expected} == expected
        for k in expected:
            assert np.array_equal(end_stress[k], stress[k], equal_nan=True)
            assert np.array_equal(end_state[k], state[k], equal_nan=True)
        for k in (0, 10, 11):
            assert np.array_equal(end_stress[k], healthy[0][k]) and np.array_equal(tangent[k], healthy[2][k])
        assert np.isfinite(tangent).all()
        still = follow_once(law, np.zeros((12, 3)), stress, state)[3]
        assert all(still[k] == expected[k] for k in range(1, 8))


def follow_once(law: ContactLaw, increment: np.ndarray, stress: np.ndarray, state: np.ndarray) -> tuple:
    """End stress, end state, tangent, status."""
    ends, tangent = (np.full_like(stress, np.nan), np.full_like(state, np.nan)), np.full((len(stress), 3, 3), np.nan)
    report = law.update(increment, stress, state, *ends, tangent)
    return *ends, tangent, report.status


@pytest.mark.slow
def test_a_million_points() -> None:
    """One call: a thousand points a thousand times over give a thousand equal results; the law needs no memory a point
    beyond what it is handed, status and counts: 9 bytes a point, and what threads need, well below 100 MB.
    """
    law = ContactLaw([material()])
    rng = np.random.default_rng(1)
    stress = np.tile(stress_of(PRESSURE * rng.uniform(0.5, 2, 1000), *rng.uniform(-0.2, 0.2, (2, 1000))), (1000, 1))
    state = law.initial_state(stress)
    increment = np.tile(rng.uniform(-1e-5, 1e-5, (1000, 3)), (1000, 1))
    arrays = np.empty_like(stress), np.empty_like(state), np.empty((10**6, 3, 3))
    for array in arrays:
        array.fill(0.0)  # its pages are there
    law.update(increment[:1000], stress[:1000], state[:1000], *(array[:1000] for array in arrays))
    before, since = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter()
    report = law.update(increment, stress, state, *arrays)
    print(f"a million points: {time.perf_counter() - since:.1f} s, {report.substeps.sum()} substeps")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kilobytes
    assert report.failed == 0
    for array in arrays:
        blocks = array.reshape(1000, -1)
        assert (blocks == blocks[0]).all()
