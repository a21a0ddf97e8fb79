"""Reference values of the model and its first-order limits (mean field, tangential neglected, harmonic)."""

import numpy as np
import pytest
from contact_law_cases import PRESSURE, Points, law, material

from granfabric.constitutive.path import Leg, drive

P_CONSTANT = {0.1: (-1.1, -0.9), 0.2: (-1.2, -0.8), 0.3: (-1.3, -0.7)}

# P0, path, {q/p: (z, a_c)}; z0 = 4.06, phi = 0.846, kn/p = 1e4, P_xi0 = 3, c_n = 1
TABLE = [
    (0.50, "p", {0.1: (3.9303, 0.0520), 0.2: (3.7995, 0.1081), 0.3: (3.6674, 0.1692)}),
    (0.75, "p", {0.1: (3.8690, 0.0777), 0.2: (3.6836, 0.1608), 0.3: (3.5043, 0.2498)}),
    (0.50, "lateral", {0.1: (4.0150, 0.0202), 0.2: (3.9683, 0.0419), 0.3: (3.9195, 0.0653)}),
]


def end_stress(path, eta):
    p = PRESSURE if path == "p" else PRESSURE / (1 - eta)
    return (-p * (1 + eta), -p * (1 - eta), 0.0)


@pytest.mark.parametrize(("p0", "path", "values"), TABLE)
def test_section_nine_table(p0, path, values):
    """Four printed digits: half a unit of the last one."""
    contact_law = law(materials=[material(force_density_at_zero=p0)], tolerance=1e-8)
    for eta, (z, a_c) in values.items():
        target = end_stress(path, eta)
        history = drive(contact_law, (-PRESSURE, -PRESSURE, 0.0), [Leg(target=target, increments=5)])
        assert history.finished
        assert history.columns["coordination"][-1] == pytest.approx(z, abs=0.5e-4)
        assert history.columns["fabric_anisotropy"][-1] == pytest.approx(a_c, abs=0.5e-4)


@pytest.mark.parametrize("p0", [0.3, 0.5, 0.75])
def test_first_order_from_isotropy(p0):
    """p constant: dz/z = -(2 P0/pi) deta, da_c = P0 deta; lateral stress constant: Delta = 30 degrees.

    Deviations are of second order in the increment, hence the tolerance of ten times its size (no gain: P_xi0 = 0).
    """
    contact_law = law(materials=[material(force_density_at_zero=p0, gap_density_at_zero=0.0)])
    step = 1e-6
    _, state, _, _ = (points := Points(contact_law, (-PRESSURE, -PRESSURE, 0.0))).mixed(
        (1, 1, 1), (-PRESSURE * step, PRESSURE * step, 0.0)
    )
    z, a_c = points.get(state, "coordination")[0, 0], points.get(state, "fabric_anisotropy")[0, 0]
    assert (z / 4.06 - 1) / step == pytest.approx(-2 * p0 / np.pi, rel=10 * step)
    assert a_c / step == pytest.approx(p0, rel=10 * step)
    # only the axial stress grows: dp = d s_1/2
    _, state, _, _ = points.mixed((1, 1, 1), (-2 * PRESSURE * step, 0.0, 0.0))
    z, a_c = points.get(state, "coordination")[0, 0], points.get(state, "fabric_anisotropy")[0, 0]
    assert (1 - z / 4.06) / step == pytest.approx(0.21800 * p0, abs=0.5e-5)
    assert a_c / step == pytest.approx(0.39100 * p0, abs=0.5e-5)


def test_force_closure():
    """a_n = c_n q/p on every path, f from the scale relation, s = (a_c + a_n + a_t)/2 [section 4]."""
    contact_law = law(materials=[material(force_anisotropy_ratio=1.1)])
    history = drive(
        contact_law,
        (-PRESSURE, -PRESSURE, 0.0),
        [Leg(target=(-1.5e5, -0.9e5, 1e4), increments=7), Leg(target=(-1.2e5, -1.0e5, 3e4), increments=5)],
    )
    c = history.columns
    s = np.array([-(c["stress_xx"] - c["stress_yy"]) / 2, -c["stress_xy"]]) / c["p"]
    a_n = np.array([c["normal_force_anisotropy_1"], c["normal_force_anisotropy_2"]])
    a_c = np.array([c["fabric_anisotropy_1"], c["fabric_anisotropy_2"]])
    a_t = np.array([c["tangential_force_anisotropy_1"], c["tangential_force_anisotropy_2"]])
    assert np.allclose(a_n, 1.1 * s, atol=1e-14)
    assert np.allclose(a_c + a_n + a_t, 2 * s, atol=1e-14)
    force = c["p"] / c["p"][0] * c["coordination"][0] / c["coordination"]
    assert np.allclose(c["mean_normal_force"], force, rtol=1e-13)
