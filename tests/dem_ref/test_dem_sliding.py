"""Parameters of sliding are found again in histories made from known ones; loadings that cannot tell are refused."""

from __future__ import annotations

import numpy as np
import pytest

from granfabric.dem_ref.inputs.sliding import (
    SLIDING_KEYS,
    fit_hardening,
    measure_sliding,
    peak_stress_ratio,
    plastic_part,
)
from granfabric.dem_ref.sample.disks import SampleError

MEASURED = {
    "coordination": 3.9, "solid_fraction": 0.846, "normal_stiffness": 1e9, "stiffness_ratio": 1.0,
    "bulk_reduction": 0.88, "shear_reduction": 0.69, "isostatic_coordination": 2.65,
}  # fmt: skip
PEAK, REFERENCE, SLOPE, CONSTANT = 0.4, 5e-5, 1.1, 0.15


def history(exponent=2.0, first=0.0, angle=np.pi / 2, lateral=False, last=1e-2, z_end=3.05):
    """Columns of a loading along `angle`: exact hardening and dilatancy, elastic strain with falling moduli.

    Finely spaced, so that the trapezoidal rule of the elastic part leaves no error that matters.
    """
    gamma = np.concatenate([np.linspace(0.0, 1.0, 4001) ** 3 * 1e-3, np.linspace(1e-3, last, 2000)[1:]])
    grid = 1.0 - np.logspace(0, -6, 20000)
    ratio = first + (PEAK - first) * np.interp(gamma / REFERENCE, grid**exponent / (1.0 - grid), grid)
    if first > 0.0:
        gamma, ratio = np.r_[np.zeros(500), gamma], np.r_[np.linspace(0.0, first, 501)[:-1], ratio]
    p = 1e5 / (1.0 - ratio) if lateral else np.full_like(ratio, 1e5)
    z = 3.9 - (3.9 - z_end) * gamma / (gamma + 2e-4)
    unit = 0.846 * 1e9 / (4 * np.pi)
    shear_modulus = unit * 2.0 * 3.9 * 0.69 * np.maximum(z / 3.9 * (z - 2.65) / 1.25, 0.2)
    bulk_modulus = 2.0 * unit * z * 0.88

    def integral(values, over):
        return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(over))])

    shear = gamma + integral(1.0 / shear_modulus, ratio * p)
    dilation = SLOPE * (integral(ratio, gamma) - CONSTANT * gamma) - integral(1.0 / bulk_modulus, p)
    c, s = np.cos(2 * angle), np.sin(2 * angle)
    return {
        "strain_xx": 0.5 * (dilation - shear * c), "strain_yy": 0.5 * (dilation + shear * c), "strain_xy": -shear * s,
        "stress_xx": -p * (1 + ratio * c), "stress_yy": -p * (1 - ratio * c), "stress_xy": -p * ratio * s,
        "p": p, "q": ratio * p, "coordination": z, "coordination_without_rattlers": z + 0.15,
        "fabric_anisotropy": 0.5 * ratio,
    }  # fmt: skip


@pytest.mark.parametrize("lateral", [False, True])
@pytest.mark.parametrize("angle", [np.pi / 2, 0.0, 0.3])
def test_known_parameters_are_found_again(angle, lateral):
    """Any axis, constant p or not. The peak is a mean over a tenth of the strain: low by gamma_r over that strain."""
    found, misfit = measure_sliding(history(angle=angle, lateral=lateral), MEASURED)
    assert tuple(found) == SLIDING_KEYS
    assert found["peak_stress_ratio"] == pytest.approx(PEAK, rel=1.5 * REFERENCE / 1e-2)
    assert found["reference_plastic_strain"] == pytest.approx(REFERENCE, rel=0.05)
    assert found["dilatancy"] == pytest.approx(SLOPE, rel=1e-6)
    assert found["constant_volume_stress_ratio"] == pytest.approx(CONSTANT, rel=1e-6)
    assert misfit < 0.01


def test_exponent_and_first_yield_tell_by_their_misfit():
    """A history of a hyperbola with a first yield is fitted by one, and badly by the square."""
    part = plastic_part(history(exponent=1.0, first=0.1), MEASURED)
    peak = peak_stress_ratio(part)
    assert fit_hardening(part, peak, 1.0, 0.1).misfit < 0.005
    assert fit_hardening(part, peak, 2.0, 0.0).misfit > 0.05


def test_what_cannot_tell_is_refused():
    short = {name: column[:3200] for name, column in history().items()}
    with pytest.raises(SampleError, match="may still grow"):
        measure_sliding(short, MEASURED)
    few = {name: column[[0, 4000, 5000, -1]] for name, column in history().items()}
    with pytest.raises(SampleError, match="too few records"):
        measure_sliding(few, MEASURED)
