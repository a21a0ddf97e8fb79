"""Isotropic linear elasticity in plane strain, behind the same contract as the contact law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.arrays import stress_and_index, update_arrays
from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.contract import Array, LawDescription, Status, TangentKind, UpdateReport, Variable
from granfabric.constitutive.parameters import ParameterError, is_number, is_within, rows_of
from granfabric.constitutive.threads import FEWEST_CHEAP_POINTS, run_in_threads

OK, NOT_FINITE = int(Status.OK), int(Status.NOT_FINITE)

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
        if not is_number(value):
            raise ParameterError(f"{variable.name} = {value!r} is not a finite number")
        if not is_within(value, variable.lower, variable.upper):
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


def report_of(status: NDArray[np.int8]) -> UpdateReport:
    """Report of a law that takes one substep a point."""
    ok = bool((status <= Status.LIMITED).all())
    ones = np.ones(len(status), dtype=np.int32)
    return UpdateReport(status, ones, np.zeros_like(ones), 1.0 if ok else 0.5)


@compiled(nogil=True)
def _update(
    first: int,
    end: int,
    table: Array,
    index: NDArray[np.int32],
    strain_increment: Array,
    stress_start: Array,
    stress_end: Array,
    tangent: Array,
    want_tangent: bool,
    status: NDArray[np.int8],
) -> None:
    for point in range(first, end):
        young = table[index[point], 0]
        poisson = table[index[point], 1]
        shear = young / (2.0 * (1.0 + poisson))
        lame = young * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
        xx = strain_increment[point, 0]
        yy = strain_increment[point, 1]
        xy = strain_increment[point, 2]
        volumetric = lame * (xx + yy)
        end_xx = stress_start[point, 0] + (volumetric + 2.0 * shear * xx)
        end_yy = stress_start[point, 1] + (volumetric + 2.0 * shear * yy)
        end_xy = stress_start[point, 2] + shear * xy
        finite = np.isfinite(end_xx) and np.isfinite(end_yy) and np.isfinite(end_xy)
        status[point] = OK if finite else NOT_FINITE
        for i in range(3):
            stress_end[point, i] = stress_start[point, i]
        if finite:
            stress_end[point, 0], stress_end[point, 1], stress_end[point, 2] = end_xx, end_yy, end_xy
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
        rows = rows_of("a linear elastic law", materials, ElasticMaterial)
        self._table = np.array([[row.youngs_modulus, row.poissons_ratio] for row in rows], dtype=np.float64)

    @property
    def description(self) -> LawDescription:
        """The law as data."""
        return LawDescription("linear elastic", (), ELASTIC_PARAMETERS)

    def initial_state(self, stress: Array, material_index: NDArray[np.int32] | None = None) -> Array:
        """No state: shape (npt, 0)."""
        return np.zeros((len(stress_and_index(stress, material_index, len(self._table))[0]), 0))

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
        arrays = update_arrays(
            (0, len(self._table)),
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
            arrays.stress_end,
            arrays.tangent,
            tangent is not None,
            status,
        )
        run_in_threads(_update, npoints, arguments, FEWEST_CHEAP_POINTS)
        return report_of(status)
