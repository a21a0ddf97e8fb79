"""Sliding against closed forms: hardening, dilatancy, unloading, rotation, apex; what is refused."""

import numpy as np
import pytest
from contact_law_cases import PRESSURE, Points, material
from sliding_cases import (
    AT_REST,
    CONSTANT,
    FIRST,
    PEAK,
    REFERENCE,
    SHIFTED,
    SLOPE,
    go_on,
    invariants,
    moduli,
    plastic_strain,
    sliding_law,
    sliding_material,
    strength,
)

from granfabric.constitutive.contract import Status
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import ParameterError
from granfabric.constitutive.path import SLIDING_COLUMNS, Leg, drive

ISOTROPIC = (-PRESSURE, -PRESSURE, 0.0)
TOLERANCE = 1e-9
STRESS = np.ones(3)


def dilatancy_integral(gamma, first):
    """Plastic volumetric strain, dilation positive, of hardening from 0 to gamma: the integral of D (M - M_cv)."""
    logarithm = REFERENCE * np.log1p(gamma / REFERENCE)
    return SLOPE * ((PEAK - CONSTANT) * gamma - (PEAK - first) * logarithm)


def work_integral(gamma, first, p):
    """Plastic work of the same hardening at constant p: the integral of p (M + D (M_cv - M))."""
    logarithm = REFERENCE * np.log1p(gamma / REFERENCE)
    strength_integral = PEAK * gamma - (PEAK - first) * logarithm
    return p * ((1.0 - SLOPE) * strength_integral + SLOPE * CONSTANT * gamma)


@pytest.mark.parametrize("direction", [0.0, 0.4])
@pytest.mark.parametrize("first", [0.0, FIRST])
def test_hardening_at_constant_pressure(first, direction):
    """gamma_p = gamma_r (eta - M_first)/(M_peak - eta) on any principal axes, the elastic strain besides, eta p/G."""
    axis = np.array([-np.cos(2 * direction), np.cos(2 * direction), -np.sin(2 * direction)])
    points = Points(
        sliding_law(AT_REST, material_changes={"first_yield_stress_ratio": first}, tolerance=TOLERANCE), [ISOTROPIC] * 4
    )
    ratio = np.array([0.05, 0.15, 0.3, 0.38])
    _, shear = moduli(points)
    _, state, strain, report = points.mixed(STRESS, ratio[:, None] * PRESSURE * axis)
    assert report.failed == 0
    gamma = np.maximum(plastic_strain(ratio, first), 0.0)
    assert points.get(state, "plastic_shear_strain")[:, 0] == pytest.approx(gamma, rel=1e-12, abs=1e-20)
    # the multiplier is a smooth function of the time; its quadrature over the substeps errs by few tolerances
    allowed = 1e2 * TOLERANCE * (gamma + REFERENCE)
    # axis is a unit deviator: strain . axis = (e_xx - e_yy, gamma_xy) along it
    along = strain @ axis
    assert np.abs(along - (ratio * PRESSURE / shear + gamma)).max() < allowed.max()
    volume = points.get(state, "plastic_volumetric_strain")[:, 0]
    assert np.abs(volume - dilatancy_integral(gamma, first)).max() < allowed.max()
    assert strain[:, 0] + strain[:, 1] == pytest.approx(volume, abs=allowed.max())
    work = points.get(state, "plastic_dissipation")[:, 0]
    assert np.abs(work - work_integral(gamma, first, PRESSURE)).max() < PRESSURE * allowed.max()


@pytest.mark.parametrize("exponent", [2.0, 3.0])
def test_other_exponents(exponent):
    """gamma_p = gamma_r h^m/(1 - h), h = eta/M_peak; dilatancy and work by quadrature over the stress ratio."""
    changes = {"hardening_exponent": exponent, "first_yield_stress_ratio": 0.0}
    points = Points(sliding_law(AT_REST, material_changes=changes, tolerance=TOLERANCE), [ISOTROPIC] * 4)
    ratio = np.array([0.02, 0.1, 0.3, 0.38])
    axis = np.array([-1.0, 1.0, 0.0])
    _, shear = moduli(points)
    stress, state, strain, report = points.mixed(STRESS, ratio[:, None] * PRESSURE * axis)
    assert report.failed == 0
    h = ratio / PEAK
    gamma = REFERENCE * h**exponent / (1 - h)
    assert points.get(state, "plastic_shear_strain")[:, 0] == pytest.approx(gamma, rel=1e-12)
    allowed = 1e2 * TOLERANCE * (gamma + REFERENCE)
    assert np.abs(strain @ axis - (ratio * PRESSURE / shear + gamma)).max() < allowed.max()
    nodes, weights = np.polynomial.legendre.leggauss(60)
    for i in range(4):
        at = 0.5 * h[i] * (nodes + 1)
        slope = REFERENCE * at ** (exponent - 1) * (exponent - (exponent - 1) * at) / (1 - at) ** 2
        volume = 0.5 * h[i] * (weights @ (slope * SLOPE * (PEAK * at - CONSTANT)))
        work = PRESSURE * 0.5 * h[i] * (weights @ (slope * (PEAK * at - SLOPE * (PEAK * at - CONSTANT))))
        assert points.get(state, "plastic_volumetric_strain")[i, 0] == pytest.approx(volume, abs=allowed[i])
        assert points.get(state, "plastic_dissipation")[i, 0] == pytest.approx(work, abs=PRESSURE * allowed[i])
    # strain control leads back to the same stress, from q = 0 as well
    back = points.update(strain)[0]
    assert back == pytest.approx(stress, abs=PRESSURE * 1e-2)


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_work_on_a_cone_with_cohesion(exponent):
    """q = M (p + c): the deviator works with the cohesion, the pressure against the dilation; by quadrature over M.

    At constant p, to several stress ratios and on several axes.
    """
    cohesion = 2e4
    changes = {"apparent_cohesion": cohesion, "hardening_exponent": exponent, "first_yield_stress_ratio": 0.0}
    points = Points(sliding_law(AT_REST, material_changes=changes, tolerance=TOLERANCE), [ISOTROPIC] * 4)
    strengths, axes = np.array([0.1, 0.2, 0.3, 0.38]), np.array([0.0, 0.4, 1.2, 2.0])
    deviator = (strengths * (PRESSURE + cohesion))[:, None] * np.stack([-np.cos(axes), np.cos(axes), -np.sin(axes)], 1)
    _, state, _, report = points.mixed(STRESS, deviator)
    assert report.failed == 0
    nodes, weights = np.polynomial.legendre.leggauss(60)
    for i, top in enumerate(strengths):
        h = 0.5 * top / PEAK * (nodes + 1)
        slope = REFERENCE * h ** (exponent - 1) * (exponent - (exponent - 1) * h) / (1 - h) ** 2
        m = PEAK * h
        per_strain = m * (PRESSURE + cohesion) + PRESSURE * SLOPE * (CONSTANT - m)
        work = 0.5 * top / PEAK * (weights @ (slope * per_strain))
        volume = 0.5 * top / PEAK * (weights @ (slope * SLOPE * (m - CONSTANT)))
        gamma = REFERENCE * (top / PEAK) ** exponent / (1 - top / PEAK)
        allowed = 1e2 * TOLERANCE * (gamma + REFERENCE)
        assert points.get(state, "plastic_shear_strain")[i, 0] == pytest.approx(gamma, abs=allowed)
        assert points.get(state, "plastic_dissipation")[i, 0] == pytest.approx(work, abs=2 * PRESSURE * allowed)
        assert points.get(state, "plastic_volumetric_strain")[i, 0] == pytest.approx(volume, abs=allowed)
        # the cohesion's part is far above what is allowed
        assert weights @ (slope * m) * 0.5 * top / PEAK * cohesion > 50 * PRESSURE * allowed


def test_unloading_and_reloading_are_elastic():
    """Inside the cone no plastic strain; back at the old stress ratio loading goes on where it was left."""
    points = Points(sliding_law(AT_REST, tolerance=TOLERANCE), ISOTROPIC)
    bulk, shear = moduli(points)
    up, state, _, _ = points.mixed(STRESS, (-3e4, 3e4, 0.0))
    loaded = go_on(points, up, state)
    down, inside, strain, _ = loaded.mixed(STRESS, (6e4 - 1e3, -6e4 + 1e3, 0.0))
    assert inside[0, -3:] == pytest.approx(state[0, -3:], abs=0)
    assert strain[0] == pytest.approx(0.5 * np.array([59e3 / shear, -59e3 / shear, 0]), rel=1e-9)
    again, retraced, strain, _ = go_on(points, down, inside).mixed(STRESS, (-59e3, 59e3, 0.0))
    assert again == pytest.approx(up)
    assert retraced[0, -3:] == pytest.approx(state[0, -3:], rel=1e-12)
    further = go_on(points, again, retraced).mixed(STRESS, (-5e3, 5e3, 0.0))[1]
    at_once = points.mixed(STRESS, (-3.5e4, 3.5e4, 0.0))[1]
    assert further[0, -3:] == pytest.approx(at_once[0, -3:], rel=1e3 * TOLERANCE)
    # isotropic compression from the cone lowers q/p: elastic
    _, compressed, strain, _ = loaded.mixed(STRESS, (-1e4, -1e4, 0.0))
    assert compressed[0, -3:] == pytest.approx(state[0, -3:], abs=0)
    assert strain[0, 0] + strain[0, 1] == pytest.approx(-1e4 / bulk, rel=1e-9)


def test_other_side_of_the_cone():
    """Hardening is isotropic: after loading to 0.3, the opposite direction slides again from 0.3 on."""
    points = Points(sliding_law(AT_REST, tolerance=TOLERANCE), ISOTROPIC)
    up, state, _, _ = points.mixed(STRESS, (-3e4, 3e4, 0.0))
    across, turned, _, report = go_on(points, up, state).mixed(STRESS, (6.5e4, -6.5e4, 0.0))
    assert report.failed == 0 and across[0] == pytest.approx([-6.5e4, -13.5e4, 0.0])
    assert points.get(turned, "plastic_shear_strain")[0, 0] == pytest.approx(plastic_strain(0.35), rel=1e-12)


def test_turning_axes_at_constant_stress_ratio_slide_only_by_the_chords():
    """A turn of the principal axes at constant q/p is neutral: chords of the circle stay inside the cone."""
    history = drive(sliding_law(AT_REST), ISOTROPIC, [Leg(target=(-130e3, -70e3, 0.0), increments=3)])
    turned = drive(
        sliding_law(AT_REST), history.stress[0], [Leg(rotation_degrees=90.0, increments=45)], state=history.state
    )
    assert turned.finished
    assert set(SLIDING_COLUMNS) <= set(turned.columns)
    assert np.ptp(turned.columns["plastic_shear_strain"]) < 1e-9 * plastic_strain(0.3)
    assert turned.stress[0] == pytest.approx([-70e3, -130e3, 0.0], abs=1e-6)


def test_flow_follows_the_stress_when_strain_turns():
    """Strain driven along xy after compression along x: the deviator turns, the state stays on the cone."""
    points = Points(sliding_law(AT_REST, tolerance=TOLERANCE), ISOTROPIC)
    stress, state, _, _ = points.update((-2e-4, 2e-4, 0.0))
    for _ in range(4):
        stress, state, _, report = go_on(points, stress, state).update((0.0, 0.0, 2e-4))
        assert report.failed == 0
        p, q = invariants(stress[0])
        assert q / p == pytest.approx(strength(points.get(state, "plastic_shear_strain")[0, 0]), rel=1e-13)
    # what was along x is forgotten over few elastic strains q/G; the sign of the shear is that of the strain
    assert stress[0, 2] > 0.99 * q


@pytest.mark.parametrize("closure", [None, SHIFTED], ids=["mean_field", "shifted"])
@pytest.mark.parametrize("first", [0.0, FIRST])
def test_strain_control_follows_stress_control(first, closure):
    """The strain of a stress path, given back, leads to the stress and state again. Errors of few tolerances each."""
    contact_law = sliding_law(closure=closure, material_changes={"first_yield_stress_ratio": first}, tolerance=1e-8)
    points = Points(contact_law, (-1.1e5, -0.9e5, 0.5e4))
    increments = [(-1e4, 1e4, 0.0), (5e3, -5e3, 5e3), (2e3, 8e3, -8e3)]
    driven, stress, state = points, points.stress, points.state
    for increment in increments:
        stress, state, strain, report = go_on(points, stress, state).mixed(STRESS, increment)
        assert report.failed == 0
        # a straight path in stress is none in strain: many small pieces
    pieces = 200
    stress, state = points.stress, points.state
    driven_stress, driven_state = stress, state
    for increment in increments:
        for _ in range(pieces):
            stress, state, strain, _ = go_on(points, stress, state).mixed(STRESS, np.array(increment) / pieces)
            driven_stress, driven_state, _, _ = go_on(points, driven_stress, driven_state).update(strain)
    # rates vary by about one over each leg, a chord errs by its square: 1/pieces^2 each, and the sum by 1/pieces
    assert driven_stress[0] == pytest.approx(stress[0], abs=PRESSURE * 2e-4)
    assert driven.get(driven_state, "plastic_shear_strain")[0, 0] == pytest.approx(
        driven.get(state, "plastic_shear_strain")[0, 0], rel=2e-3
    )


def test_mixed_control_passes_where_stress_control_cannot():
    """Compression along y at constant lateral stress approaches the peak and stays on the cone."""
    points = Points(sliding_law(closure=SHIFTED), ISOTROPIC)
    stress, state, strain, report = points.mixed((1, 0, 1), (0.0, -5e-3, 0.0))
    assert report.failed == 0 and stress[0, 0] == -PRESSURE and stress[0, 2] == 0.0
    p, q = invariants(stress[0])
    gamma = points.get(state, "plastic_shear_strain")[0, 0]
    assert q / p == pytest.approx(strength(gamma), rel=1e-13)
    assert PEAK * 0.99 < q / p < PEAK
    # at the end nearly all strain is plastic: dilatancy at the peak
    _, _, strain, _ = go_on(points, stress, state).mixed((1, 0, 1), (0.0, -1e-5, 0.0))
    assert (strain[0, 0] + strain[0, 1]) / (strain[0, 0] - strain[0, 1]) == pytest.approx(
        SLOPE * (PEAK - CONSTANT), rel=0.02
    )


def test_stress_beyond_the_peak_is_refused():
    """With a status and a sentence; what was reached is kept, and strain control goes on from it."""
    points = Points(sliding_law(), ISOTROPIC)
    stress, state, strain, report = points.mixed(STRESS, (-4e4, 4e4, 0.0))
    assert report.status[0] == Status.BEYOND_PEAK and "peak stress ratio" in report.message
    assert np.array_equal(stress, points.stress) and np.array_equal(state, points.state) and not strain.any()
    history = drive(points.law, ISOTROPIC, [Leg(target=(-150e3, -50e3, 0.0), increments=10)])
    assert not history.finished and "peak stress ratio" in history.message
    assert history.columns["q"][-1] / PRESSURE == pytest.approx(0.35)
    assert points.mixed((0, 0, 1), (-1e-2, 1e-2, 0.0))[3].failed == 0


@pytest.mark.parametrize("control", [(1, 0, 1), (0, 1, 1), (1, 1, 0), (1, 0, 0), (0, 1, 0)])
def test_some_stresses_given_beyond_the_peak_are_refused_at_once(control):
    """Whatever the components that are free become. Just within the bound there is an answer."""
    points = Points(sliding_law(), ISOTROPIC)
    sine, tangent = PEAK, PEAK / np.sqrt(1 - PEAK**2)
    # end values: shear beside one normal stress; the other normal stress; no pressure at all
    beyond = {
        (1, 0, 1): (0.0, 0.0, tangent * PRESSURE),
        (0, 1, 1): (0.0, 0.0, -tangent * PRESSURE),
        (1, 1, 0): (PRESSURE * 2 * sine / (1 + sine), 0.0, 0.0),
        (1, 0, 0): (PRESSURE, 0.0, 0.0),
        (0, 1, 0): (0.0, PRESSURE, 0.0),
    }[control]
    given = np.where(np.array(control) == 1, beyond, 0.0)
    stress, _, _, report = points.mixed(control, given * (1 + 1e-9))
    assert report.status[0] == Status.BEYOND_PEAK and report.evaluations[0] == 0
    assert np.array_equal(stress, points.stress)
    # strain grows without bound towards it
    if control[2] == 1 or control[:2] == (1, 1):
        assert points.mixed(control, given * 0.9)[3].failed == 0


def test_way_to_no_pressure_leads_over_the_peak_except_through_the_apex():
    """Stress-driven, to a pressure below zero: with a deviator the cone is in the way, else the pressure vanishes."""
    points = Points(sliding_law(), ISOTROPIC)
    for end in ((0.5e5, 0.2e5, 0.0), (0.5e5, 0.5e5, 1.0), (0.0, 1e5, 0.0)):
        report = points.mixed(STRESS, np.array(end) - np.array(ISOTROPIC))[3]
        assert report.status[0] == Status.BEYOND_PEAK and report.evaluations[0] == 0
    report = points.mixed(STRESS, (1.5e5, 1.5e5, 0.0))[3]
    assert report.status[0] == Status.NO_PRESSURE


def test_bound_of_some_stresses_is_that_of_all():
    """Of 200 free values of the third component one is within the cone, exactly if the bound says so."""
    points = Points(sliding_law(material_changes={"apparent_cohesion": 3e3}), ISOTROPIC)
    rng = np.random.default_rng(3)
    refused = 0
    for _ in range(300):
        end = np.array([-(10 ** rng.uniform(3, 5.5)), -(10 ** rng.uniform(3, 5.5)), rng.uniform(-1e5, 1e5)])
        for free in range(3):
            control = [1, 1, 1]
            control[free] = 0
            tried = np.tile(end, (4001, 1))
            tried[:, free] = np.linspace(-2e6, 0.0, 4001) if free < 2 else 0.0
            p, q = invariants(tried)
            margin = (q / (p + 3e3)).min() / PEAK
            if abs(margin - 1) < 0.01:
                continue
            given = np.where(np.array(control) == 1, end - np.array(ISOTROPIC), 0.0)
            at_once = points.mixed(control, given)[3]
            assert (at_once.status[0] == Status.BEYOND_PEAK and at_once.evaluations[0] == 0) == (margin > 1)
            refused += margin > 1
    assert 100 < refused < 800


def test_stress_outside_the_cone_is_refused():
    points = Points(sliding_law(), ISOTROPIC)
    outside = Points(points.law, (-1.3e5, -0.7e5, 0.0), points.state)
    assert outside.update((1e-6, 0.0, 0.0))[3].status[0] == Status.BEYOND_PEAK


def test_initial_stress_lies_on_the_cone():
    """An initial stress ratio beyond the first yield has slid before; one at the peak is refused."""
    contact_law = sliding_law(material_changes={"apparent_cohesion": 5e3})
    state = contact_law.initial_state(np.array([(-1.3e5, -0.7e5, 0.0), (-1e5, -1.05e5, 0.0)]))
    gamma = state[:, contact_law.description.columns("plastic_shear_strain")][:, 0]
    assert gamma == pytest.approx([plastic_strain(3e4 / 1.05e5), 0.0], rel=1e-12)
    with pytest.raises(ParameterError, match=r"q/\(p \+ c\) = 0.4.* at point 1"):
        contact_law.initial_state(np.array([ISOTROPIC, (-1.42e5, -0.58e5, 0.0)]))


@pytest.mark.parametrize("cohesion", [0.0, 2e3])
def test_apex(cohesion):
    """Extension slides down the cone towards zero pressure: a right answer as long as there is one, then a status."""
    contact_law = sliding_law(closure=SHIFTED, material_changes={"apparent_cohesion": cohesion})
    points = Points(contact_law, (-1.2e5, -0.8e5, 0.0))
    stress, state = points.stress, points.state
    statuses = []
    for _ in range(60):
        stress, state, tangent, report = go_on(points, stress, state).update((4e-6, 6e-6, 0.0))
        assert np.isfinite(stress).all() and np.isfinite(state).all() and np.isfinite(tangent).all()
        statuses.append(int(report.status[0]))
        p, q = invariants(stress[0])
        gamma = points.get(state, "plastic_shear_strain")[0, 0]
        assert p > 0.0 and q <= strength(gamma) * (p + cohesion) * (1 + 1e-9)
        if report.failed:
            break
    # contacts are lost with the pressure, and with them, at z_iso, the shear stiffness
    assert statuses[-1] in (Status.NO_PRESSURE, Status.STIFFNESS_LOST) and len(statuses) > 5


def test_parameters_that_give_back_work_are_refused():
    """(D - 1) M_peak <= D M_cv is the sharp condition: at it the plastic work at the peak vanishes."""
    limit = PEAK / (PEAK - CONSTANT)
    sharp = Points(
        sliding_law(AT_REST, material_changes={"dilatancy": limit * (1 - 1e-12)}), (-1e5 * (1 + 0.39), -1e5 * 0.61, 0.0)
    )
    _, state, _, report = sharp.mixed((0, 0, 1), (-1e-3, 1e-3, 0.0))
    assert report.failed == 0 and sharp.get(state, "plastic_dissipation")[0, 0] >= 0.0
    with pytest.raises(ParameterError, match=r"material.dilatancy = 1.7 .* it may be 1.6 at most"):
        sliding_law(material_changes={"dilatancy": 1.7})
    with pytest.raises(ParameterError, match=r"first_yield_stress_ratio = 0\.4 is not below"):
        sliding_law(material_changes={"first_yield_stress_ratio": 0.4})
    # they do not matter to a law without sliding
    ContactLaw([sliding_material(dilatancy=9.0, first_yield_stress_ratio=0.9)], effects=Effects())


def test_without_sliding_nothing_of_it_is_carried_or_read():
    """No column, and parameters of sliding do not change a bit."""
    increment = np.random.default_rng(1).normal(size=(20, 3)) * 1e-5
    results = []
    for packing in (material(), sliding_material(peak_stress_ratio=1e-3, dilatancy=9.0, apparent_cohesion=1e4)):
        points = Points(ContactLaw([packing], SHIFTED), [(-1.2e5, -0.9e5, 1e3)] * 20)
        assert not any("plastic" in variable.name for variable in points.law.description.state)
        results.append([*points.update(increment)[:3], *points.mixed((1, 0, 1), increment * [1e8, 1, 1e8])[:3]])
    for one, other in zip(*results, strict=True):
        assert np.array_equal(one, other)


def test_points_do_not_depend_on_their_neighbours():
    """A batch of points that stay elastic, cross the cone, slide and fail: each as if alone, to the last bit."""
    rng = np.random.default_rng(4)
    contact_law = sliding_law(closure=SHIFTED)
    number = 40
    q, angle = 1e5 * rng.uniform(0.0, 0.35, number), rng.uniform(0, 2 * np.pi, number)
    stress = np.stack([-1e5 - q * np.cos(angle), -1e5 + q * np.cos(angle), -q * np.sin(angle)], axis=1)
    increment = rng.normal(size=(number, 3)) * 10.0 ** rng.uniform(-6, -3.3, (number, 1))
    points = Points(contact_law, stress)
    batch = points.update(increment)
    assert 0 < batch[3].failed < number and batch[3].rejected.max() > 0
    for i in range(number):
        single = Points(contact_law, stress[i]).update(increment[i])
        assert all(np.array_equal(single[k][0], batch[k][i]) for k in range(3))
