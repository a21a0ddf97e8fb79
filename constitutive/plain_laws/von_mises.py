"""Von Mises plasticity with linear isotropic hardening in plane strain, behind the same contract as the contact law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.arrays import stress_and_index, update_arrays
from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.contract import Array, LawDescription, TangentKind, UpdateReport, Variable
from granfabric.constitutive.parameters import rows_of
from granfabric.constitutive.threads import FEWEST_CHEAP_POINTS, run_in_threads

from .linear_elastic import ELASTIC_PARAMETERS, NOT_FINITE, OK, check_parameters, report_of

_PARAMETERS = (
    *ELASTIC_PARAMETERS,
    Variable("yield_stress", "initial uniaxial yield stress", "Pa", lower=1e-300, upper=1e300),
    Variable("hardening", "hardening modulus H = d yield stress / d plastic strain", "Pa", lower=0.0, upper=1e300),
)
_STATE = (
    Variable("stress_zz", "normal stress out of the plane", "Pa", default=0.0),
    Variable("plastic_strain", "accumulated equivalent plastic strain", lower=0.0, default=0.0),
)


@dataclass(frozen=True)
class VonMisesMaterial:
    """Young's modulus [Pa], Poisson's ratio, initial yield stress [Pa] and hardening modulus [Pa]."""

    youngs_modulus: float
    poissons_ratio: float
    yield_stress: float
    hardening: float = 0.0

    def __post_init__(self) -> None:
        check_parameters(_PARAMETERS, (self.youngs_modulus, self.poissons_ratio, self.yield_stress, self.hardening))


@compiled()
def _isotropic(bulk: float, shear: float, tangent: Array) -> None:
    """K I x I + 2 G (deviatoric projector) in the plane, engineering shear."""
    for i in range(2):
        for j in range(2):
            tangent[i, j] = bulk - 2.0 * shear / 3.0
        tangent[i, i] += 2.0 * shear
        tangent[i, 2] = 0.0
        tangent[2, i] = 0.0
    tangent[2, 2] = shear


@compiled()
def _refuse(point, bulk, shear, stress_start, state_start, stress_end, state_end, tangent, want_tangent):  # type: ignore[no-untyped-def]
    """End values of a failed point: its start values; Hooke's law for the tangent."""
    for i in range(3):
        stress_end[point, i] = stress_start[point, i]
    for i in range(2):
        state_end[point, i] = state_start[point, i]
    if want_tangent:
        _isotropic(bulk, shear, tangent[point])


@compiled(nogil=True)
def _update(
    first: int,
    end: int,
    table: Array,
    index: NDArray[np.int32],
    strain_increment: Array,
    stress_start: Array,
    state_start: Array,
    stress_end: Array,
    state_end: Array,
    tangent: Array,
    want_tangent: bool,
    elastic_tangent: bool,
    status: NDArray[np.int8],
) -> None:
    for point in range(first, end):
        row = index[point]
        young = table[row, 0]
        poisson = table[row, 1]
        hardening = table[row, 3]
        shear = young / (2.0 * (1.0 + poisson))
        bulk = young / (3.0 * (1.0 - 2.0 * poisson))
        xx = strain_increment[point, 0]
        yy = strain_increment[point, 1]
        xy = strain_increment[point, 2]
        status[point] = OK
        # Elastic trial: deviator of all four components, mean stress apart.
        third = (xx + yy) / 3.0
        szz0 = state_start[point, 0]
        mean0 = (stress_start[point, 0] + stress_start[point, 1] + szz0) / 3.0
        mean = mean0 + 3.0 * bulk * third
        sxx = stress_start[point, 0] - mean0 + 2.0 * shear * (xx - third)
        syy = stress_start[point, 1] - mean0 + 2.0 * shear * (yy - third)
        szz = szz0 - mean0 - 2.0 * shear * third
        sxy = stress_start[point, 2] + shear * xy
        equivalent = np.sqrt(1.5 * (sxx * sxx + syy * syy + szz * szz + 2.0 * sxy * sxy))
        strength = table[row, 2] + hardening * state_start[point, 1]
        overstress = equivalent - strength
        # A point on its yield surface lies beyond it by rounding; without an increment that must not count.
        still = xx == 0.0 and yy == 0.0 and xy == 0.0
        # A norm that overflows is caught here, too: then there is no direction to return along.
        if not (np.isfinite(overstress) and np.isfinite(mean)):
            _refuse(point, bulk, shear, stress_start, state_start, stress_end, state_end, tangent, want_tangent)
            status[point] = NOT_FINITE
            continue
        multiplier = 0.0
        if overstress > 0.0 and not still:
            multiplier = overstress / (3.0 * shear + hardening)
        factor = 1.0
        if multiplier > 0.0:
            factor = 1.0 - 3.0 * shear * multiplier / equivalent
        if still:
            for i in range(3):
                stress_end[point, i] = stress_start[point, i]
            state_end[point, 0] = szz0
        else:
            stress_end[point, 0] = mean + factor * sxx
            stress_end[point, 1] = mean + factor * syy
            stress_end[point, 2] = factor * sxy
            state_end[point, 0] = mean + factor * szz
        state_end[point, 1] = state_start[point, 1] + multiplier
        if not want_tangent:
            continue
        plastic = multiplier > 0.0 and not elastic_tangent
        _isotropic(bulk, shear * (factor if plastic else 1.0), tangent[point])
        if plastic:
            # Radial return, Simo & Hughes 1998, box 3.2: minus 6 G^2 [1/(3G + H) - dgamma/q] N x N, N = dev/|dev|.
            norm2 = equivalent * equivalent / 1.5
            c = 6.0 * shear * shear * (1.0 / (3.0 * shear + hardening) - multiplier / equivalent) / norm2
            tangent[point, 0, 0] -= c * sxx * sxx
            tangent[point, 0, 1] -= c * sxx * syy
            tangent[point, 0, 2] -= c * sxx * sxy
            tangent[point, 1, 0] -= c * syy * sxx
            tangent[point, 1, 1] -= c * syy * syy
            tangent[point, 1, 2] -= c * syy * sxy
            tangent[point, 2, 0] -= c * sxy * sxx
            tangent[point, 2, 1] -= c * sxy * syy
            tangent[point, 2, 2] -= c * sxy * sxy


class VonMisesLaw:
    """Radial return for ``sqrt(3/2) |dev sigma| <= yield_stress + H alpha``.

    State: the stress out of the plane (plane strain) and the accumulated plastic strain alpha. Source of update and
    consistent tangent: Simo & Hughes, Computational Inelasticity (1998), section 3.3.

    Parameters
    ----------
    materials : VonMisesMaterial or sequence of VonMisesMaterial
        Rows of the parameter table.
    """

    def __init__(self, materials: VonMisesMaterial | Sequence[VonMisesMaterial]) -> None:
        rows = rows_of("a von Mises law", materials, VonMisesMaterial)
        values = [[row.youngs_modulus, row.poissons_ratio, row.yield_stress, row.hardening] for row in rows]
        self._table = np.array(values, dtype=np.float64)

    @property
    def description(self) -> LawDescription:
        """The law as data."""
        return LawDescription("von Mises", _STATE, _PARAMETERS)

    def initial_state(self, stress: Array, material_index: NDArray[np.int32] | None = None) -> Array:
        """Out-of-plane stress ``nu (sigma_xx + sigma_yy)`` as if the stress were elastic; no plastic strain."""
        stress, index = stress_and_index(stress, material_index, len(self._table))
        state = np.zeros((len(stress), 2))
        state[:, 0] = self._table[index, 1] * (stress[:, 0] + stress[:, 1])
        return state

    def update(
        self,
        strain_increment: Array,
        stress_start: Array,
        state_start: Array,
        stress_end: Array,
        state_end: Array,
        tangent: Array | None = None,
        tangent_kind: TangentKind = "propagated",
        material_index: NDArray[np.int32] | None = None,
    ) -> UpdateReport:
        """See `constitutive.contract.Law.update`.

        "propagated" is the consistent tangent of the return; "continuum" is taken to be the same (their difference
        vanishes with the increment); "elastic" is Hooke's law.
        """
        arrays = update_arrays(
            (len(_STATE), len(self._table)),
            strain_increment,
            stress_start,
            state_start,
            stress_end,
            state_end,
            tangent,
            tangent_kind,
            material_index,
        )
        npoints = len(arrays.increment)
        status = np.empty(npoints, dtype=np.int8)
        arguments = (
            self._table,
            arrays.rows,
            arrays.increment,
            arrays.stress_start,
            arrays.state_start,
            arrays.stress_end,
            arrays.state_end,
            arrays.tangent,
            tangent is not None,
            tangent_kind == "elastic",
            status,
        )
        run_in_threads(_update, npoints, arguments, FEWEST_CHEAP_POINTS)
        return report_of(status)
