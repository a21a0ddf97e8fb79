"""Pore fluid that cannot leave: undrained response of any law, by the effective stress principle.

With ``u`` the pore pressure (compression positive), ``m = (1, 1, 0)`` and ``n`` the porosity,

    sigma = sigma' - u m,        du = -(K_f/n) d eps_v,        d eps_v = d eps_xx + d eps_yy,

where the skeleton's law sees the effective stress ``sigma'`` alone [Terzaghi 1936]. That is the undrained limit of Biot
with grains that are rigid beside the skeleton (Biot's coefficient is one, his modulus K_f/n). The tangent gains
``(K_f/n) m m^T``. Stress in the arrays of the contract is the *total* one, in equilibrium with loads and weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .arrays import ANY, ArrayError, UpdateArrays, finite, stress_and_index, update_arrays
from .compilation import compiled
from .contract import Array, Law, LawDescription, Status, TangentKind, UpdateReport, Variable
from .effective_stress import PORE_PRESSURE, with_pressure
from .parameters import Material, ParameterError, is_within
from .threads import FEWEST_CHEAP_POINTS, run_in_threads
from .total_control import follow_total

LIMITED, NOT_FINITE = int(Status.LIMITED), int(Status.NOT_FINITE)

STIFFNESS = Variable("fluid_stiffness", "bulk modulus of the fluid over the porosity, K_f/n", "Pa", 1, 0.0, 1e300)


def fluid_stiffness(material: Material) -> float:
    """K_f/n of a material [Pa]; 0 where no fluid is given. The porosity is ``1 - solid_fraction`` if it is not given.

    The solid fraction is that of disks in the plane, whose pores are about half of those of spheres: a porosity
    measured in space is given as `Material.fluid_porosity`.

    Raises
    ------
    ParameterError
        If there is a fluid and no room for it.
    """
    if not material.fluid_bulk_stiffness > 0.0:
        return 0.0
    porosity = material.fluid_porosity if material.fluid_porosity > 0.0 else 1.0 - material.solid_fraction
    if not porosity > 0.0:
        raise ParameterError(
            f"material.fluid_bulk_stiffness = {material.fluid_bulk_stiffness:g} needs pores: material.solid_fraction = "
            f"{material.solid_fraction:g} leaves none, and material.fluid_porosity is not given"
        )
    return float(material.fluid_bulk_stiffness / porosity)


@compiled(nogil=True)
def _effective(first: int, end: int, stress: Array, state: Array, effective: Array) -> None:
    last = state.shape[1] - 1
    for point in range(first, end):
        pressure = state[point, last]
        effective[point, 0] = stress[point, 0] + pressure
        effective[point, 1] = stress[point, 1] + pressure
        effective[point, 2] = stress[point, 2]


@compiled(nogil=True)
def _add_fluid(
    first: int,
    end: int,
    stiffness: Array,
    rows: NDArray[np.int32],
    increment: Array,
    effective: Array,
    stress_start: Array,
    state_start: Array,
    stress_end: Array,
    state_end: Array,
    tangent: Array,
    want_tangent: bool,
    status: NDArray[np.int8],
) -> None:
    last = state_start.shape[1] - 1
    for point in range(first, end):
        fluid = stiffness[rows[point]]
        change = -fluid * (increment[point, 0] + increment[point, 1])
        # changes are added, so that none leaves the total stress as it is to the last bit
        xx = stress_start[point, 0] + ((stress_end[point, 0] - effective[point, 0]) - change)
        yy = stress_start[point, 1] + ((stress_end[point, 1] - effective[point, 1]) - change)
        if status[point] <= LIMITED and not (abs(xx) + abs(yy) < np.inf):
            status[point] = NOT_FINITE
        if status[point] > LIMITED:
            for i in range(3):
                stress_end[point, i] = stress_start[point, i]
            for i in range(last + 1):
                state_end[point, i] = state_start[point, i]
        else:
            stress_end[point, 0], stress_end[point, 1] = xx, yy
            state_end[point, last] = state_start[point, last] + change
        if want_tangent:
            for i in range(2):
                for j in range(2):
                    tangent[point, i, j] += fluid


class PoreFluid:
    """The fluid's part of an update, on arrays whose last state column is the pore pressure.

    Parameters
    ----------
    stiffness : sequence of float
        K_f/n of each row of the skeleton's parameter table [Pa]; zero where nothing fills the pores.
    """

    def __init__(self, stiffness: Sequence[float] | Array) -> None:
        self.stiffness = np.array(stiffness, dtype=np.float64)

    def drained(self) -> PoreFluid:
        """The same state with a fluid that leaves as fast as it is pressed: its pressure stays."""
        return PoreFluid(np.zeros_like(self.stiffness))

    def effective(self, arrays: UpdateArrays) -> Array:
        """Effective stress at the start, shape (npt, 3)."""
        made = np.empty_like(arrays.stress_start)
        run_in_threads(_effective, len(made), (arrays.stress_start, arrays.state_start, made), FEWEST_CHEAP_POINTS)
        return made

    def add(self, arrays: UpdateArrays, effective: Array, status: NDArray[np.int8]) -> None:
        """Turn what the skeleton's law has written into total stress; write the pore pressure, add to the tangent."""
        arguments = (
            self.stiffness,
            arrays.rows,
            arrays.increment,
            effective,
            arrays.stress_start,
            arrays.state_start,
            arrays.stress_end,
            arrays.state_end,
            arrays.tangent,
            len(arrays.tangent) > 0,
            status,
        )
        run_in_threads(_add_fluid, len(effective), arguments, FEWEST_CHEAP_POINTS)


class PoreFluidLaw:
    """Any law with pore fluid; obeys `contract.Law`. `ContactLaw` has the same by ``effects.pore_fluid``.

    Parameters
    ----------
    skeleton : Law
        Law of the effective stress.
    stiffness : float or sequence of float
        K_f/n of each row of its parameter table [Pa]; zero for a row without fluid.
    """

    def __init__(self, skeleton: Law, stiffness: float | Sequence[float]) -> None:
        rows = np.atleast_1d(np.asarray(stiffness, dtype=object))
        for value in rows.tolist():
            if not is_within(value, STIFFNESS.lower, STIFFNESS.upper):
                raise ParameterError(f"{STIFFNESS.name} = {value!r} is not a number in [0, 1e+300] Pa")
        self.skeleton = skeleton
        self._fluid = PoreFluid(rows.tolist())

    @property
    def description(self) -> LawDescription:
        """The skeleton's law as data, with the pore pressure as last state column."""
        own = self.skeleton.description
        return LawDescription(
            f"{own.name} with pore fluid",
            (*own.state, PORE_PRESSURE),
            (*own.parameters, STIFFNESS),
            own.linear_response,
        )

    def drained(self) -> PoreFluidLaw:
        """The law while water can leave: pore pressures stay as they are."""
        return PoreFluidLaw(self.skeleton, self._fluid.drained().stiffness.tolist())

    def initial_state(
        self,
        stress: Array,
        material_index: NDArray[np.int32] | None = None,
        pore_pressure: Array | None = None,
        **more: Any,
    ) -> Array:
        """State under a total stress, shape (npt, nstate).

        Parameters
        ----------
        stress : ndarray, shape (npt, 3)
            Total stress, tension positive [Pa].
        material_index : ndarray of int32, shape (npt,), optional
        pore_pressure : ndarray, shape (npt,), optional
            [Pa], zero if not given.
        more :
            For the skeleton's law.
        """
        given, _ = stress_and_index(stress, material_index, len(self._fluid.stiffness))
        pressure = initial_pressure(pore_pressure, len(given))
        state = self.skeleton.initial_state(with_pressure(given, pressure), material_index, **more)
        return np.column_stack([state, pressure])

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
        """See `constitutive.contract.Law.update`."""
        inner = self.skeleton.description.nstate
        arrays = update_arrays(
            (inner + 1, len(self._fluid.stiffness)),
            strain_increment,
            stress_start,
            state_start,
            stress_end,
            state_end,
            tangent,
            tangent_kind,
            material_index,
        )
        effective = self._fluid.effective(arrays)
        state = np.empty((len(effective), inner))
        report = self.skeleton.update(
            arrays.increment,
            effective,
            np.ascontiguousarray(arrays.state_start[:, :inner]),
            arrays.stress_end,
            state,
            tangent,
            tangent_kind,
            arrays.rows,
        )
        arrays.state_end[:, :inner] = state
        status = np.array(report.status, dtype=np.int8)
        self._fluid.add(arrays, effective, status)
        return replace(report, status=status)

    def update_mixed(
        self,
        control: NDArray[np.uint8],
        increment: Array,
        stress_start: Array,
        state_start: Array,
        stress_end: Array,
        state_end: Array,
        strain_increment: Array,
        material_index: NDArray[np.int32] | None = None,
    ) -> UpdateReport:
        """Increments of total stress in some components and of strain in the others; see `total_control`."""
        arrays = update_arrays(
            (self.skeleton.description.nstate + 1, len(self._fluid.stiffness)),
            increment,
            stress_start,
            state_start,
            stress_end,
            state_end,
            None,
            "propagated",
            material_index,
            control,
            strain_increment,
            "increment",
        )
        return follow_total(self.update, arrays)


def initial_pressure(given: object, npt: int) -> Array:
    """Pore pressures at the start, shape (npt,) [Pa]; zeros if None."""
    if given is None:
        return np.zeros(npt)
    pressure = finite("pore_pressure", given, (ANY,))
    if len(pressure) != npt:
        raise ArrayError(f"pore_pressure has {len(pressure)} entries, stress {npt} points")
    return pressure
