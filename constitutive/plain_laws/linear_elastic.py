"""Isotropic linear elasticity in plane strain, behind the same contract as the contact law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.contract import Array, LawDescription, Status, TangentKind, UpdateReport, Variable
from granfabric.constitutive.parameters import ParameterError

ELASTIC_PARAMETERS = (
    Variable("youngs_modulus", "Young's modulus E", "Pa", lower=1e-300, upper=1e300),
    Variable("poissons_ratio", "Poisson's ratio nu", lower=-0.999, upper=0.4999),
)


def check_parameters(variables: Sequence[Variable], values: Sequence[float]) -> tuple[float, ...]:
    """Parameters as floats, refused outside their bounds.

    Raises
    ------
    ParameterError
    """
    for variable, value in zip(variables, values):
        if isinstance(value, bool) or not isinstance(value, (int, float, np.floating)) or not np.isfinite(value):
            raise ParameterError(f"{variable.name} = {value!r} is not a finite number")
        if not variable.lower <= value <= variable.upper:
            raise ParameterError(
                f"{variable.name} = {value!r} is outside [{variable.lower:g}, {variable.upper:g}] "
                f"({variable.meaning}, unit {variable.unit})"
            )
    return tuple(float(value) for value in values)


@dataclass(frozen=True)
class ElasticMaterial:
    """Young's modulus [Pa] and Poisson's ratio."""

    youngs_modulus: float
    poissons_ratio: float

    def __post_init__(self) -> None:
        check_parameters(ELASTIC_PARAMETERS, (self.youngs_modulus, self.poissons_ratio))


def index_of_points(material_index: NDArray[np.int32] | None, npoints: int) -> NDArray[np.int32]:
    """Row of the parameter table for each point; zeros if none was given."""
    return np.zeros(npoints, dtype=np.int32) if material_index is None else material_index


@compiled(("constitutive",), parallel=True)
def _update(
    table: Array,
    index: NDArray[np.int32],
    strain_increment: Array,
    stress_start: Array,
    stress_end: Array,
    tangent: Array,
    want_tangent: bool,
    status: NDArray[np.int8],
) -> None:
    for point in numba.prange(len(strain_increment)):
        young = table[index[point], 0]
        poisson = table[index[point], 1]
        shear = young / (2.0 * (1.0 + poisson))
        lame = young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
        xx = strain_increment[point, 0]
        yy = strain_increment[point, 1]
        xy = strain_increment[point, 2]
        finite = np.isfinite(xx + yy + xy)
        status[point] = 0 if finite else 6
        for i in range(3):
            stress_end[point, i] = stress_start[point, i]
        if finite:
            volumetric = lame * (xx + yy)
            stress_end[point, 0] += volumetric + 2.0 * shear * xx
            stress_end[point, 1] += volumetric + 2.0 * shear * yy
            stress_end[point, 2] += shear * xy
        if want_tangent:
            for i in range(3):
                for j in range(3):
                    tangent[point, i, j] = 0.0
            tangent[point, 0, 0] = lame + 2.0 * shear
            tangent[point, 1, 1] = lame + 2.0 * shear
            tangent[point, 0, 1] = lame
            tangent[point, 1, 0] = lame
            tangent[point, 2, 2] = shear


class LinearElasticLaw:
    """Hooke's law in plane strain: ``d sigma = lambda tr(d eps) I + 2 G d eps``; no state.

    Parameters
    ----------
    materials : ElasticMaterial or sequence of ElasticMaterial
        Rows of the parameter table.
    """

    def __init__(self, materials: ElasticMaterial | Sequence[ElasticMaterial]) -> None:
        rows = [materials] if isinstance(materials, ElasticMaterial) else list(materials)
        self._table = np.array([[row.youngs_modulus, row.poissons_ratio] for row in rows])

    @property
    def description(self) -> LawDescription:
        """The law as data."""
        return LawDescription("linear elastic", (), ELASTIC_PARAMETERS)

    def initial_state(self, stress: Array, material_index: NDArray[np.int32] | None = None) -> Array:
        """No state: shape (npt, 0)."""
        return np.zeros((len(stress), 0))

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
        """See `constitutive.contract.Law.update`; all kinds of tangent are the same here."""
        npoints = len(strain_increment)
        status = np.empty(npoints, dtype=np.int8)
        wanted = tangent is not None
        matrices = tangent if tangent is not None else np.empty((0, 3, 3))
        index = index_of_points(material_index, npoints)
        _update(self._table, index, strain_increment, stress_start, stress_end, matrices, wanted, status)
        ok = bool((status <= Status.LIMITED).all())
        ones = np.ones(npoints, dtype=np.int32)
        return UpdateReport(status, ones, np.zeros_like(ones), 1.0 if ok else 0.5)
