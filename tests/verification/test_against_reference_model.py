"""The compiled update against a second implementation that shares no code with it (`reference_model`)."""

import numpy as np
import pytest
import reference_model
from contact_law_cases import CLOSURES, FLUCTUATING, PRESSURE, Points, closure_name, law, material

PATHS = [
    ((-1.0, -1.0, 0.0), (-0.2, 0.2, 0.1)),
    ((-1.2, -0.8, 0.1), (-0.3, -0.2, -0.15)),
    ((-1.2, -0.8, 0.1), (0.3, 0.15, 0.05)),
    ((-0.9, -1.1, -0.2), (0.0, 0.0, 0.35)),
]


@pytest.mark.parametrize("closure", CLOSURES + FLUCTUATING, ids=closure_name)
@pytest.mark.parametrize("control", ["stress", "strain"])
@pytest.mark.parametrize("path", PATHS)
def test_end_values(closure, control, path):
    """Both at tight tolerance: 1e-10 in the reference, 1e-9 here, which the global error may exceed a few times."""
    packing = material(
        force_anisotropy_ratio=1.1,
        gap_density_at_zero=40.0,
        bulk_reduction=0.88,
        shear_reduction=0.69,
        stiffness_ratio=0.7,
        initial_fabric_xx=0.1,
        initial_fabric_xy=-0.05,
    )
    stress, change = PRESSURE * np.array(path[0]), np.array(path[1])
    increment = change * (PRESSURE if control == "stress" else 2e-4)
    points = Points(law(closure=closure, materials=[packing], tolerance=1e-9, directions=48), stress)
    code = (1, 1, 1) if control == "stress" else (0, 0, 0)
    end, state, strain, report = points.mixed(code, increment)
    assert report.failed == 0
    sigma, z, a_c, gained, lost, expected_strain = reference_model.integrate(
        packing,
        stress,
        increment,
        control,
        q=(0.1, -0.05),
        tangential=closure.tangential,
        distribution=closure.distribution,
        chi=closure.weak_contact_ratio if closure.force_change == "fluctuating" else 1,
        c_w=closure.fluctuation if closure.force_change == "fluctuating" else 0,
    )
    assert end[0] == pytest.approx(sigma, abs=1e-7 * PRESSURE)
    assert points.get(state, "coordination")[0, 0] == pytest.approx(z, abs=1e-7)
    assert points.get(state, "fabric_anisotropy")[0] == pytest.approx(a_c, abs=1e-7)
    assert points.get(state, "coordination_gained")[0, 0] == pytest.approx(gained[0], abs=1e-7)
    assert points.get(state, "fabric_gained")[0] == pytest.approx(gained[1:], abs=1e-7)
    assert points.get(state, "coordination_lost")[0, 0] == pytest.approx(lost[0], abs=1e-7)
    assert points.get(state, "fabric_lost")[0] == pytest.approx(lost[1:], abs=1e-7)
    assert strain[0] == pytest.approx(expected_strain, abs=1e-11)


def test_stiffness_from_contact_directions():
    """The elastic tangent equals the average over contact directions, exactly (both are finite sums of harmonics)."""
    packing = material(bulk_reduction=0.88, shear_reduction=0.69, stiffness_ratio=0.4, initial_fabric_xx=0.3)
    points = Points(law(materials=[packing]), (-PRESSURE, -PRESSURE, 0.0))
    tangent = points.update((0.0, 0.0, 0.0))[2][0]
    assert tangent == pytest.approx(reference_model.stiffness(packing, 4.06, (0.3, 0.0)), rel=1e-12, abs=1.0)


def test_where_the_stiffness_is_positive_definite():
    """Bounded fabric alone does not make it so: for kt = 0 and |a_c| > sqrt 2 the harmonic estimate is indefinite."""
    closure = CLOSURES[1]
    assert closure.distribution == "maximum_entropy"
    for size, definite in ((1.40, True), (1.43, False)):
        for direction in (0.0, 1.0, 2.5):
            fabric = (size * np.cos(direction), size * np.sin(direction))
            packing = material(stiffness_ratio=0.0, initial_fabric_xx=fabric[0], initial_fabric_xy=fabric[1])
            points = Points(law(closure=closure, materials=[packing]), (-PRESSURE, -PRESSURE, 0.0))
            tangent = points.update((0.0, 0.0, 0.0), "elastic")[2][0]
            expected = reference_model.stiffness(packing, packing.coordination, fabric)
            assert tangent == pytest.approx(expected, rel=1e-12, abs=1.0)
            np.testing.assert_allclose(tangent, tangent.T, rtol=1e-12, atol=1.0)
            smallest = np.linalg.eigvalsh(tangent).min()
            assert (smallest > 0) == definite
            # K G = (z phi kn)^2/(8 pi^2) against (z phi kn a_c/4 pi)^2: they cross at |a_c| = sqrt 2
            assert abs(smallest) > 1e-3 * np.abs(tangent).max()
