"""The contact gain/loss law as a host sees it."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.integration.lane import (
    TANGENT_CONTINUUM,
    TANGENT_ELASTIC,
    TANGENT_NONE,
    TANGENT_PROPAGATED,
    Call,
    Numerics,
)
from granfabric.constitutive.integration.points import smallest_step_factor, update_points
from granfabric.constitutive.integration.runge_kutta import TABLEAUS, ending_at_the_end
from granfabric.constitutive.lanes.eight import LANES_OF_KERNELS
from granfabric.constitutive.network.force_fabric import initial_force_fabric
from granfabric.constitutive.network.point import Options
from granfabric.constitutive.network.rates import MeanField
from granfabric.constitutive.network.slip_memory import initially_held, slip_classes
from granfabric.constitutive.network.weak_force_state import ShiftedDistribution
from granfabric.constitutive.sliding.checks import check_sliding, initial_hardening

from .arrays import ALL_STRESS, finite, stress_and_index, update_arrays
from .contract import Array, LawDescription, TangentKind, UpdateReport
from .effective_stress import with_pressure
from .effects import Effects
from .initial_checks import check_fabric, check_state, given_coordination
from .material_table import PAR_C_N, PAR_FABRIC_XX, PAR_FABRIC_XY, PAR_KN, PAR_PHI, PAR_Z
from .parameters import (
    Closure,
    Integration,
    Material,
    ParameterError,
    instance_of,
    parameter_table,
    rows_of,
)
from .pore_fluid import PoreFluid, fluid_stiffness, initial_pressure
from .state import micro_of_columns, remembers, state_variables
from .threads import run_in_threads
from .total_control import follow_total

_TANGENTS = {
    "propagated": TANGENT_PROPAGATED,
    "continuum": TANGENT_CONTINUUM,
    "elastic": TANGENT_ELASTIC,
}

_NO_CONTROL, _NO_STRAIN = np.zeros((0, 3), dtype=np.uint8), np.zeros((0, 3))

LEAST_FOLLOWING = 0.1
"""Least fraction of weak contacts that follow the mean change of their direction, at a smaller chi too."""
_COMFORTABLE_SUBSTEPS = 20
"""Substeps per increment above which the report proposes no larger step."""


class ContactLaw:
    """Contact gain and loss in a granular assembly [Pouragha & Wan 2017]; obeys `contract.Law`.

    Parameters
    ----------
    materials : Material or sequence of Material
        Rows of the parameter table; `material_index` of the calls selects among them.
    closure : Closure
    effects : Effects
    integration : Integration

    Notes
    -----
    Tension is positive in all arrays, the shear strain is the engineering one. Inside, compression is positive.
    """

    def __init__(
        self,
        materials: Material | Sequence[Material],
        closure: Closure | None = None,
        effects: Effects | None = None,
        integration: Integration | None = None,
    ) -> None:
        self.materials = rows_of("a contact law", materials, Material)
        self.closure = instance_of("closure", closure, Closure)
        self.effects = instance_of("effects", effects, Effects)
        self.integration = instance_of("integration", integration, Integration)
        self._table = parameter_table(self.materials)
        entropy = self.closure.distribution == "maximum_entropy"
        for material in self.materials:
            fabric = material.initial_fabric_xx, material.initial_fabric_xy
            check_fabric("material.initial_fabric", fabric, self.closure.distribution)
            if self.closure.shear_stiffness == "isostatic" and material.isostatic_coordination >= material.coordination:
                raise ParameterError(
                    f"material.isostatic_coordination = {material.isostatic_coordination:g} is not below "
                    f"material.coordination = {material.coordination:g}: the packing would have no shear stiffness"
                )
            if self.closure.tangential == "self_consistent" and material.force_density_at_zero >= 1.0:
                raise ParameterError(
                    f"material.force_density_at_zero = {material.force_density_at_zero:g} is not below 1, where the "
                    'self-consistent equations have no solution; choose tangential = "neglected"'
                )
            if self.effects.sliding:
                check_sliding(material)
        # a network that cannot change needs no closure
        shifted = self.closure.force_change == "shifted_distribution" and self.effects.network_changes
        self._remembers = remembers(self.effects, self.closure)
        self._variables = state_variables(self.effects, shifted, self._remembers)
        self._micro = micro_of_columns(self._variables)
        self._nstate = sum(variable.components for variable in self._variables)
        self._fluid = PoreFluid([fluid_stiffness(row) for row in self.materials]) if self.effects.pore_fluid else None
        follow = self.effects.stiffness_feedback or not self.effects.network_changes
        self._options = Options(
            loss=self.effects.contact_loss,
            gain=self.effects.contact_gain,
            rotation=self.effects.principal_rotation,
            feedback=follow,
            isostatic=self.closure.shear_stiffness == "isostatic",
            limited=not entropy and not shifted,
            sliding=self.effects.sliding,
            mixed=False,
            derivatives=False,
        )
        self._kernel_closure = self._closure_of_kernels(entropy)
        tableau = TABLEAUS[self.integration.integrator]
        # the return to the cone moves the end of a substep, so that nothing is gained by a stage there
        self._tableau = tableau if self.effects.sliding else ending_at_the_end(tableau)
        # equally spaced over the circle, and over half of it: there twelve of the whole circle at least
        around = max(8, self.integration.directions // 2)
        circle = 2.0 * np.pi * np.arange(around) / around
        along = (max(12, around) + 1) // 2
        half = np.pi * (np.arange(along) + 0.5) / along
        nodes, weights = np.polynomial.legendre.leggauss(self.integration.directions)
        slips = slip_classes(*self._slip)
        self._rule = (nodes, weights, np.cos(circle), np.sin(circle), np.cos(half), slips)

    def _closure_of_kernels(self, entropy: bool) -> MeanField | ShiftedDistribution:
        """Numbers of the closure, of the type for which a kernel is compiled."""
        closure = self.closure
        if closure.force_change == "shifted_distribution" and self.effects.network_changes:
            return ShiftedDistribution(
                remembers=self._remembers,
                turns=self.effects.principal_rotation,
                frictional=closure.tangential_rule == "frictional",
                chi=float(closure.weak_contact_ratio),
                following=min(1.0, max(LEAST_FOLLOWING, float(closure.weak_contact_ratio))),
                chi_p=float(closure.weak_contact_ratio_isotropic),
                gradient=float(closure.weak_contact_gradient),
                c_e=float(closure.elastic_scatter),
                c_p=float(closure.elastic_scatter_isotropic),
                c_i=float(closure.irreversible_scatter) if self.effects.irreversible_spread else 0.0,
                c_t=float(closure.tangential_force_ratio),
                kappa=float(closure.tangential_force_loss),
                slip=float(closure.slip),
                delay=float(closure.slip_delay),
            )
        # a network that cannot change needs no more than a closure without loss and gain
        scattered = closure.force_change == "fluctuating" and self.effects.network_changes
        return MeanField(
            loss=self.effects.contact_loss,
            gain=self.effects.contact_gain,
            self_consistent=closure.tangential_rule == "self_consistent" and self.effects.network_changes,
            entropy=entropy,
            closed_form=self.integration.arc_integration == "closed_form",
            scattered=scattered,
            chi=float(closure.weak_contact_ratio) if scattered else 1.0,
            c_w=float(closure.fluctuation) if scattered else 0.0,
        )

    @property
    def _slip(self) -> tuple[float, float]:
        """c_t and k."""
        return float(self.closure.tangential_force_ratio), float(self.closure.slip)

    @cached_property
    def description(self) -> LawDescription:
        """The law as data."""
        return LawDescription("contact_gain_loss", self._variables, Material.variables(), self.effects.linear_response)

    def initial_state(
        self,
        stress: Array,
        material_index: NDArray[np.int32] | None = None,
        coordination: Array | None = None,
        fabric_anisotropy: Array | None = None,
        pore_pressure: Array | None = None,
    ) -> Array:
        """State under the given stress before any loading.

        The normal-force anisotropy is proportional to the stress-ratio vector, ``a_n = c_n s``; the mean force follows
        from the scale relation ``f/(kn r) = 2 pi p/(z phi kn)``; a_t closes the stress-force-fabric relation
        ``s = (a_c + a_n + a_t)/2`` [eq. 7 and section 3.3 of the source]. With the closure "frictional" a_t is known
        and the relations of `force_fabric` give a_n and the mean force.

        A point without pressure (p = -(s_xx + s_yy)/2 not above zero) gets a state without forces, from which no
        update starts: they report it with the status NO_PRESSURE.

        Parameters
        ----------
        stress : ndarray, shape (npt, 3)
            Tension positive [Pa]; finite, and of any number of points, also of none.
        material_index : ndarray of int32, shape (npt,), optional
        coordination : ndarray, shape (npt,), optional
            Instead of the material's value, for instance a random field; within the bounds of that parameter.
        fabric_anisotropy : ndarray, shape (npt, 2), optional
            Instead of the material's value, below the magnitude that the distribution admits.
        pore_pressure : ndarray, shape (npt,), optional
            With the effect `pore_fluid`, where the stress is the total one: u [Pa], zero if not given.

        Returns
        -------
        ndarray, shape (npt, nstate)

        Raises
        ------
        ValueError
            If an array has another shape or kind, or holds a value that is not finite.
        ParameterError
            If a value is out of bounds, or forces that push everywhere cannot carry a stress ratio in this fabric; with
            sliding: if a stress ratio is not below the peak.
        """
        stress, index = stress_and_index(stress, material_index, len(self._table))
        npt = len(stress)
        if pore_pressure is not None and self._fluid is None:
            raise ParameterError("pore_pressure means nothing to a law without effects.pore_fluid")
        pressure = initial_pressure(pore_pressure, npt)
        stress = stress if self._fluid is None else with_pressure(stress, pressure)
        table = self._table[index]
        with np.errstate(all="ignore"):
            p = -0.5 * (stress[:, 0] + stress[:, 1])
            s = np.stack([-0.5 * (stress[:, 0] - stress[:, 1]) / p, -stress[:, 2] / p], axis=1)
        s[~(p > 0.0)] = 0.0
        z = table[:, PAR_Z].copy() if coordination is None else given_coordination(coordination, npt)
        fabric = table[:, [PAR_FABRIC_XX, PAR_FABRIC_XY]]
        if fabric_anisotropy is not None:
            fabric = finite("fabric_anisotropy", fabric_anisotropy, (npt, 2))
            if npt:
                largest = fabric[np.argmax(np.hypot(fabric[:, 0], fabric[:, 1]))]
                check_fabric("fabric_anisotropy", tuple(largest), self.closure.distribution)
        if not self.effects.principal_rotation:
            s = s * [1.0, 0.0]
            fabric = fabric * np.array([1.0, 0.0])
        normal, tangential, mu = self._initial_anisotropies(s, fabric, table[:, [PAR_C_N]])
        values = {
            "coordination": z,
            "fabric_anisotropy": fabric,
            "mean_normal_force": 2.0 * np.pi * np.maximum(p, 0.0) / (z * mu * table[:, PAR_PHI] * table[:, PAR_KN]),
            "normal_force_anisotropy": normal,
            "tangential_force_anisotropy": tangential,
            "reference_coordination": z,
            "reference_fabric": fabric,
            "largest_stress_ratio": np.hypot(s[:, 0], s[:, 1]),
            "pore_pressure": pressure,
        }
        if self._remembers:
            values |= initially_held(s, *self._slip)
        if self.effects.sliding:
            values["hardening_strain"], values["plastic_shear_strain"] = initial_hardening(table, stress)
        state = np.zeros((npt, self.description.nstate))
        for variable in self._variables:
            if variable.name in values:
                value = values[variable.name]
                columns = self.description.columns(variable.name)
                state[:, columns] = value[:, None] if value.ndim == 1 else value[:, : variable.components]
        check_state(state, stress)
        return state

    def _initial_anisotropies(self, s: Array, fabric: Array, c_n: Array) -> tuple[Array, Array, Array]:
        """a_n, a_t (npt, 2), mu (npt,) of `force_fabric` for given s and a_c; mu is 1 if the closure leaves it out."""
        if not (self.closure.tangential_rule == "frictional" and self.effects.network_changes):
            return c_n * s, 2.0 * s - fabric - c_n * s, np.ones(len(s))
        normal, tangential, mu = np.zeros_like(s), np.zeros_like(s), np.ones(len(s))
        initial_force_fabric(
            np.ascontiguousarray(s), np.ascontiguousarray(fabric), *self._slip, normal, tangential, mu
        )
        return normal, tangential, mu

    def drained(self) -> ContactLaw:
        """The law while pore water can leave: pore pressures stay as they are. Without `pore_fluid` the law itself."""
        if self._fluid is None:
            return self
        made = copy(self)
        made._fluid = self._fluid.drained()
        return made

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
        """Advance all points by a strain increment; see `contract.Law.update`."""
        return self._call(
            strain_increment,
            None,
            "",
            stress_start,
            state_start,
            stress_end,
            state_end,
            None,
            tangent,
            tangent_kind,
            material_index,
        )

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
        """Advance all points by an increment of stress in some components and of strain in the others.

        Parameters
        ----------
        control : ndarray of uint8, shape (npt, 3)
            1 where `increment` is one of stress [Pa], 0 where of strain [-] (engineering shear).
        increment : ndarray, shape (npt, 3)
            Tension positive.
        strain_increment : ndarray, shape (npt, 3)
            Written: the whole strain increment.
        stress_start, state_start, stress_end, state_end, material_index :
            As in `update`.
        """
        return self._call(
            increment,
            control,
            "increment",
            stress_start,
            state_start,
            stress_end,
            state_end,
            strain_increment,
            None,
            "propagated",
            material_index,
        )

    def update_stress_driven(
        self,
        stress_increment: Array,
        stress_start: Array,
        state_start: Array,
        stress_end: Array,
        state_end: Array,
        strain_increment: Array,
        material_index: NDArray[np.int32] | None = None,
    ) -> UpdateReport:
        """Advance all points by a stress increment (xx, yy, xy, tension positive) [Pa]; writes `strain_increment`."""
        return self._call(
            stress_increment,
            ALL_STRESS,
            "stress_increment",
            stress_start,
            state_start,
            stress_end,
            state_end,
            strain_increment,
            None,
            "propagated",
            material_index,
        )

    def _call(
        self,
        given: Array,
        control: object,
        mixed: str,
        stress_start: Array,
        state_start: Array,
        stress_end: Array,
        state_end: Array,
        strain_increment: Array | None,
        tangent: Array | None,
        tangent_kind: TangentKind,
        material_index: NDArray[np.int32] | None,
    ) -> UpdateReport:
        arrays = update_arrays(
            (self._nstate, len(self._table)),
            given,
            stress_start,
            state_start,
            stress_end,
            state_end,
            tangent,
            tangent_kind,
            material_index,
            control,
            strain_increment,
            mixed,
        )
        if self._fluid is not None and mixed:
            return follow_total(self.update, arrays)
        npt = len(arrays.increment)
        stress = arrays.stress_start if self._fluid is None else self._fluid.effective(arrays)
        status = np.zeros(npt, dtype=np.int8)
        counts = np.zeros((npt, 3), dtype=np.int32)
        kind = TANGENT_NONE if tangent is None else _TANGENTS[tangent_kind]
        call = Call(
            arrays.increment,
            stress,
            arrays.state_start,
            arrays.stress_end,
            arrays.state_end,
            _NO_CONTROL if arrays.control is None else arrays.control,
            _NO_STRAIN if arrays.strain_increment is None else arrays.strain_increment,
            arrays.tangent,
            arrays.rows,
            self._table,
            self._micro,
            status,
            counts,
        )
        arguments = (
            LANES_OF_KERNELS,
            call,
            self._kernel_closure,
            self._options._replace(mixed=bool(mixed), derivatives=kind == TANGENT_PROPAGATED),
            Numerics(
                float(self.integration.tolerance),
                self.integration.substeps,
                self.integration.maximum_substeps,
                self._tableau.error_order,
                kind,
            ),
            (self._tableau.a, self._tableau.b, self._tableau.error),
            self._rule,
        )
        run_in_threads(update_points, npt, arguments)
        if self._fluid is not None:
            self._fluid.add(arrays, stress, status)
        factor = smallest_step_factor(status, counts, _COMFORTABLE_SUBSTEPS)
        return UpdateReport(status, counts[:, 0], counts[:, 1], float(factor), counts[:, 2])
