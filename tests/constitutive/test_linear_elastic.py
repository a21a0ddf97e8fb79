"""Hooke's law in plane strain behind the contract."""

from __future__ import annotations

import numpy as np
import pytest

from granfabric.constitutive.contract import Law, Status
from granfabric.constitutive.parameters import ParameterError
from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw

E, NU = 1000.0, 0.3


def call(law, increment, stress=None, index=None, tangent=True):
    n = len(increment)
    start = np.zeros((n, 3)) if stress is None else stress
    end, matrices = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    state = np.zeros((n, 0))
    report = law.update(increment, start, state, end, state.copy(), matrices if tangent else None, material_index=index)
    return end, matrices, report


def test_obeys_the_contract():
    law = LinearElasticLaw(ElasticMaterial(E, NU))
    assert isinstance(law, Law)
    assert law.description.nstate == 0
    assert law.initial_state(np.zeros((4, 3))).shape == (4, 0)


def test_plane_strain_moduli():
    # Uniaxial strain: sigma_xx / eps_xx is the oedometric modulus, sigma_yy / sigma_xx = nu/(1 - nu); pure shear: G.
    law = LinearElasticLaw(ElasticMaterial(E, NU))
    stress, _, report = call(law, np.array([[1e-3, 0.0, 0.0], [0.0, 0.0, 1e-3]]))
    oedometric = E * (1 - NU) / ((1 + NU) * (1 - 2 * NU))
    assert stress[0] == pytest.approx([1e-3 * oedometric, 1e-3 * oedometric * NU / (1 - NU), 0.0], rel=1e-14)
    assert stress[1] == pytest.approx([0.0, 0.0, 1e-3 * E / (2 * (1 + NU))], rel=1e-14)
    assert report.failed == 0 and report.proposed_step_factor >= 1.0


def test_stress_is_start_plus_tangent_times_increment():
    rng = np.random.default_rng(1)
    increment, start = rng.standard_normal((50, 3)), rng.standard_normal((50, 3))
    law = LinearElasticLaw(ElasticMaterial(E, NU))
    stress, tangent, _ = call(law, increment, start)
    expected = start + np.einsum("pij,pj->pi", tangent, increment)
    # Rounding of sums of terms of the size of the modulus.
    np.testing.assert_allclose(stress, expected, rtol=0, atol=1e-15 * 10 * E)


def test_material_index_picks_the_row():
    law = LinearElasticLaw([ElasticMaterial(E, NU), ElasticMaterial(2 * E, NU)])
    increment = np.tile([[1e-3, 2e-3, 3e-3]], (4, 1))
    stress, tangent, _ = call(law, increment, index=np.array([0, 1, 1, 0], dtype=np.int32))
    np.testing.assert_allclose(stress[1], 2 * stress[0], rtol=1e-14)
    np.testing.assert_array_equal(stress[[0, 1]], stress[[3, 2]])
    np.testing.assert_allclose(tangent[2], 2 * tangent[3], rtol=1e-14)


def test_strain_that_is_not_finite_is_a_status_and_leaves_the_start_values():
    law = LinearElasticLaw(ElasticMaterial(E, NU))
    start = np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 3.0]])
    stress, _, report = call(law, np.array([[np.nan, 0.0, 0.0], [1e-3, 0.0, 0.0]]), start)
    np.testing.assert_array_equal(stress[0], start[0])
    assert report.failed == 1 and report.worst_point == 0 and report.status[0] == Status.NOT_FINITE
    assert report.proposed_step_factor < 1.0


@pytest.mark.parametrize(("young", "poisson", "name"), [(-1.0, 0.3, "youngs_modulus"), (1.0, 0.5, "poissons_ratio")])
def test_parameters_outside_their_bounds_are_refused_by_name(young, poisson, name):
    with pytest.raises(ParameterError, match=name):
        ElasticMaterial(young, poisson)
