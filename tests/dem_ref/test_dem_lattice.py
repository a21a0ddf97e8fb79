"""A regular lattice under homogeneous strain against its closed-form stiffness."""

from __future__ import annotations

import numpy as np
import pytest
from dem_samples import triangular_lattice

from granfabric.dem_ref.dynamics.motion import Control, Motion
from granfabric.dem_ref.inputs.probes import uniform_strain_moduli
from granfabric.dem_ref.measures.contacts import contacts_of, fabric_anisotropy, love_weber_stress


@pytest.mark.parametrize("ratio", [1.0, 0.5])
@pytest.mark.parametrize("strain", [(-1.0, -1.0, 0.0), (-1.0, 1.0, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.5)])
def test_triangular_lattice_has_uniform_strain_moduli(strain, ratio):
    """Every disk is a centre of symmetry: no motion beyond the homogeneous one, K and G of uniform strain are exact."""
    overlap = 1e-5
    sample = triangular_lattice(8, 8, overlap, ratio=ratio)
    before = love_weber_stress(sample)
    motion = Motion(sample, damping=0.0)
    drive = 1e-9 * np.array(strain)
    motion.run(1000, Control(drive=drive))
    motion.run(1)  # the tangential spring of the last displacement is taken up by the next step
    change = motion.stress - before
    bulk, shear = uniform_strain_moduli(sample)
    exx, eyy, exy = 1000 * drive
    expected = np.array(
        [bulk * (exx + eyy) + shear * (exx - eyy), bulk * (exx + eyy) - shear * (exx - eyy), 2 * shear * exy]
    )
    # geometric terms: overlap over diameter, relative
    assert np.allclose(change, expected, rtol=0.0, atol=5 * overlap * np.abs(expected).max())
    assert np.abs(motion.sample.velocity).max() < 2e-3 * 1e-9  # rounding of positions in an undamped lattice


def test_lattice_is_isotropic_in_fabric_and_stress():
    sample = triangular_lattice(6, 6, 1e-4)
    contacts = contacts_of(sample)
    assert contacts.count == 3 * sample.count
    assert np.abs(fabric_anisotropy(contacts)).max() < 1e-12
    stress = love_weber_stress(sample, contacts)
    # p = z phi f/(2 pi r) d/(2 r), here with d the distance of centres
    p = 6 * sample.solid_fraction * 1e-4 * (1 - 1e-4) / (2 * np.pi * 0.5)
    assert stress == pytest.approx([-p, -p, 0.0], rel=1e-9, abs=1e-12 * p)
