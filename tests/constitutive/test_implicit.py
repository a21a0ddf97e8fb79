"""The implicit pair: its coefficients, its stage equations, its tangent, every control and closure, its refusals."""

import numpy as np
import pytest
import reference_model
from contact_law_cases import ALL_CLOSURES, PRESSURE, Points, anisotropic_stress, closure_name, law, material
from scipy.optimize import root
from test_tangent import assert_second_order

from granfabric.constitutive.contract import Status
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.integration.runge_kutta import TABLEAUS, ending_at_the_end

NAME = "kennedy_carpenter"
TABLEAU = TABLEAUS[NAME]
STRESS, INCREMENT = (-1.2e5, -0.85e5, 1e4), (-8e-5, 6e-5, 3e-5)


def test_coefficients_make_it_l_stable():
    """Explicit first stage, one diagonal entry, stages of order two; R(inf) = 0, |R| <= 1 on the imaginary axis."""
    a, b = TABLEAU.a, TABLEAU.b
    assert np.array_equal(np.triu(a, 1), np.zeros((4, 4))) and a[0, 0] == 0 and np.ptp(np.diag(a)[1:]) == 0
    assert np.array_equal(b, a[-1])  # the last stage is the end
    c = a.sum(axis=1)
    assert a @ c == pytest.approx(c**2 / 2, abs=1e-15)

    def growth(x):
        return 1 + x * b @ np.linalg.solve(np.eye(4) - x * a, np.ones(4))

    assert abs(growth(-1e9)) < 1e-6
    assert all(abs(growth(1j * x)) <= 1 + 1e-12 for x in np.logspace(-3, 5, 200))


@pytest.mark.parametrize("control", ["strain", "stress"])
def test_a_substep_solves_its_stage_equations(control):
    """Against SciPy's root finder on the model written a second time: the same end after one large substep."""
    increment = INCREMENT if control == "strain" else (-2e4, 1.5e4, 6e3)
    rates = reference_model.derivative_of(material(), STRESS, increment, control)
    scale = np.concatenate([np.full(3, PRESSURE), np.ones(9), np.full(3, 1e-4)])
    start = np.concatenate([STRESS, [4.06], np.zeros(11)]) / scale
    slopes = [rates(start * scale) / scale]
    for i in (1, 2, 3):
        known = start + sum(TABLEAU.a[i, m] * slopes[m] for m in range(i))
        diagonal = TABLEAU.a[i, i]

        def residual(k, known=known, diagonal=diagonal):
            return rates((known + diagonal * k) * scale) / scale - k

        slopes.append(root(residual, slopes[-1], tol=1e-13).x)
    end = (start + TABLEAU.b @ np.array(slopes)) * scale
    points = Points(law(integrator=NAME, substeps=1), STRESS)
    if control == "strain":
        stress, state, _, report = points.update(increment)
    else:
        stress, state, strain, report = points.mixed((1, 1, 1), increment)
        assert strain[0] == pytest.approx(end[12:15], rel=1e-9)
    assert report.failed == 0 and report.substeps[0] == 1
    # both solve to 1e-13; the references' integrals over directions are good to 1e-11
    assert stress[0] == pytest.approx(end[:3], rel=1e-9)
    assert points.get(state, "coordination")[0, 0] == pytest.approx(end[3], rel=1e-9)
    assert points.get(state, "fabric_anisotropy")[0] == pytest.approx(end[4:6], abs=1e-9)
    assert points.get(state, "coordination_lost")[0, 0] == pytest.approx(end[9], abs=1e-9)


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize("closure", ALL_CLOSURES, ids=closure_name)
def test_tangent_is_the_derivative_of_the_substeps(closure, substeps):
    packing = material(gap_density_at_zero=100.0, force_anisotropy_ratio=1.1, initial_fabric_xx=0.2)
    assert_second_order(law(closure=closure, integrator=NAME, substeps=substeps, materials=[packing]))


@pytest.mark.parametrize(
    "effects", [Effects(contact_gain=False), Effects(stiffness_feedback=False), Effects(principal_rotation=False)]
)
def test_tangent_with_effects_off(effects):
    assert_second_order(law(effects=effects, integrator=NAME, substeps=2))


@pytest.mark.parametrize("control", [(0, 0, 0), (1, 1, 1), (1, 0, 1)], ids=["strain", "stress", "mixed"])
@pytest.mark.parametrize("closure", ALL_CLOSURES, ids=closure_name)
def test_same_answer_as_the_explicit_pair(closure, control):
    """Two unrelated methods under tight tolerances, on random points, by strain, stress and both."""
    stress = anisotropic_stress(np.random.default_rng(3), 20, most=0.3)
    given = np.random.default_rng(4).uniform(-1.0, 1.0, (20, 3)) * np.where(control, 0.1 * PRESSURE, 3e-5)
    ends = []
    for name, tolerance in ((NAME, 1e-9), ("dormand_prince", 1e-10)):
        points = Points(law(closure=closure, integrator=name, tolerance=tolerance), stress)
        end, state, strain, report = points.mixed(control, given)
        assert report.failed == 0
        ends.append((end / PRESSURE, points.get(state, "coordination"), points.get(state, "fabric_anisotropy"), strain))
    for one, other in zip(*ends, strict=True):
        # a kink costs Dormand-Prince up to a few hundred times its tolerance
        assert one == pytest.approx(other, abs=5e-7)


@pytest.mark.parametrize("closure", ALL_CLOSURES, ids=closure_name)
def test_neighbours_do_not_matter(closure):
    """Bit for bit, although lanes need different numbers of passes."""
    contact_law = law(closure=closure, integrator=NAME, tolerance=1e-7)
    rng = np.random.default_rng(0)
    points, increment = Points(contact_law, anisotropic_stress(rng, 37)), rng.uniform(-5e-5, 5e-5, (37, 3))
    stress, state, tangent, report = points.update(increment)
    assert len(set(report.evaluations / (report.substeps + report.rejected))) > 5
    for i in range(0, 37, 4):
        single = Points(contact_law, points.stress[i], points.state[i : i + 1]).update(increment[i])
        assert np.array_equal(single[0][0], stress[i])
        assert np.array_equal(single[1][0], state[i])
        assert np.array_equal(single[2][0], tangent[i])
        assert single[3].evaluations[0] == report.evaluations[i]


@pytest.mark.parametrize("name", TABLEAUS)
def test_evaluations_are_counted(name):
    """One at the start and one for each further stage of an explicit pair, whose last is the next substep's first; of
    the implicit one more, but fewer for what is nearly linear."""
    fixed = {"substeps": 3} if name == "forward_euler" else {"tolerance": 1e-5}
    points = Points(law(integrator=name, **fixed), STRESS)
    _, _, _, report = points.update(INCREMENT)
    stages = (len(ending_at_the_end(TABLEAUS[name]).b) - 1) * (report.substeps[0] + report.rejected[0])
    if name != NAME:
        assert report.evaluations[0] == 1 + stages
        return
    assert stages < report.evaluations[0] < 10 * stages
    small = points.update(1e-3 * np.array(INCREMENT))[3]
    assert small.evaluations[0] / small.substeps[0] < report.evaluations[0] / report.substeps[0]


def test_stages_that_do_not_converge_shorten_the_substep():
    """Down to a millionth of the pressure: refused in one fixed substep, reached under error control."""
    release = ((1 - 1e-6) * PRESSURE, (1 - 1e-6) * PRESSURE, 0.0)
    rigid = Points(law(integrator=NAME, substeps=1), (-PRESSURE, -PRESSURE, 0.0)).mixed((1, 1, 1), release)[3]
    assert rigid.status[0] in (Status.NOT_CONVERGED, Status.NO_PRESSURE, Status.NOT_ADMISSIBLE)
    free = Points(law(integrator=NAME), (-PRESSURE, -PRESSURE, 0.0))
    _, state, _, report = free.mixed((1, 1, 1), release)
    assert report.failed == 0 and report.rejected[0] > 0
    assert free.get(state, "coordination")[0, 0] == pytest.approx(4.06e-3, rel=5e-5)  # z ~ p^P0, P0 = 1/2
