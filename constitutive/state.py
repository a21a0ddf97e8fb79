"""State of a point as columns: which quantities are carried depends on the effects that are on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.network.slip_memory import NAMES

from .contract import Variable
from .effective_stress import PORE_PRESSURE
from .effects import Effects
from .material_table import (
    M_A1,
    M_A1_REF,
    M_F,
    M_GAINED,
    M_GAMMA,
    M_HELD,
    M_KAPPA,
    M_LARGEST_S,
    M_LOST,
    M_N1,
    M_SHIFT,
    M_SPREAD,
    M_T1,
    M_Z,
    M_Z_REF,
    MICRO,
)
from .parameters import Closure

_ALONG = "component(s) in the double-angle plane"


def remembers(effects: Effects, closure: Closure) -> bool:
    """Whether a law follows what tangential forces contacts hold."""
    shifted = closure.force_change == "shifted_distribution"
    return effects.tangential_memory and effects.network_changes and shifted and closure.slips


def state_variables(effects: Effects, shifted: bool = False, remembering: bool = False) -> tuple[Variable, ...]:
    """Declaration of the state columns for an effect set.

    Without `principal_rotation` vectors have one component (along the x-y axes); what is gained or lost is counted only
    if that effect is on; a reference state is kept only
    where the network changes but the stiffness does not, or the closure follows the weak forces (`shifted`); what
    contacts hold if they remember (`remembering`).
    """
    components = 2 if effects.principal_rotation else 1
    variables = [
        Variable("coordination", "coordination number z", lower=0.0),
        Variable("fabric_anisotropy", f"a_c, {_ALONG}", components=components, lower=-2.0, upper=2.0),
        Variable("mean_normal_force", "mean normal force over kn r", lower=0.0),
        Variable("normal_force_anisotropy", f"a_n, {_ALONG}", components=components),
        Variable("tangential_force_anisotropy", f"a_t, {_ALONG}", components=components),
    ]
    if effects.contact_gain:
        variables += [
            Variable("coordination_gained", "z gained since the start", lower=0.0, default=0.0),
            Variable("fabric_gained", f"change of a_c by gain, {_ALONG}", components=components, default=0.0),
        ]
    if effects.contact_loss:
        variables += [
            Variable("coordination_lost", "z lost since the start", lower=0.0, default=0.0),
            Variable("fabric_lost", f"change of a_c by loss (subtracts), {_ALONG}", components=components, default=0.0),
        ]
    if effects.network_changes and (shifted or not effects.stiffness_feedback):
        variables += [
            Variable("reference_coordination", "z of the initial packing", lower=0.0),
            Variable("reference_fabric", f"a_c of the initial packing, {_ALONG}", components=components),
        ]
    if effects.network_changes and shifted:
        variables += [
            Variable("force_shift", "X_0, isotropic shift of weak forces over the mean force", default=0.0),
            Variable("force_shift_anisotropy", f"X_1, {_ALONG}", components=components, default=0.0),
        ]
        if effects.irreversible_spread:
            variables += [
                Variable(
                    "force_spread", "S_i, irreversible spread of weak forces over their mean", lower=0.0, default=0.0
                ),
                Variable("largest_stress_ratio", "largest q/p so far", lower=0.0),
            ]
    if effects.sliding:
        variables += [
            Variable("hardening_strain", "kappa, by which the cone has opened", lower=0.0),
            Variable("plastic_shear_strain", "gamma_p, accumulated plastic eps_1 - eps_2", lower=0.0),
            Variable("plastic_volumetric_strain", "plastic eps_xx + eps_yy, dilation positive", default=0.0),
            Variable("plastic_dissipation", "plastic work per volume", "Pa", lower=0.0, default=0.0),
        ]
    if remembering:
        variables += [
            Variable(
                name,
                f"stress ratio that slip class {number} holds, {_ALONG}",
                components=components,
                lower=-2.0,
                upper=2.0,
            )
            for number, name in enumerate(NAMES, 1)
        ]
    if effects.pore_fluid:
        variables.append(PORE_PRESSURE)  # the last one, where `pore_fluid` finds it
    return tuple(variables)


_MICRO_OF = {
    "coordination": (M_Z,),
    "fabric_anisotropy": (M_A1, M_A1 + 1),
    "mean_normal_force": (M_F,),
    "normal_force_anisotropy": (M_N1, M_N1 + 1),
    "tangential_force_anisotropy": (M_T1, M_T1 + 1),
    "coordination_gained": (M_GAINED,),
    "fabric_gained": (M_GAINED + 1, M_GAINED + 2),
    "coordination_lost": (M_LOST,),
    "fabric_lost": (M_LOST + 1, M_LOST + 2),
    "reference_coordination": (M_Z_REF,),
    "reference_fabric": (M_A1_REF, M_A1_REF + 1),
    "force_shift": (M_SHIFT,),
    "force_shift_anisotropy": (M_SHIFT + 1, M_SHIFT + 2),
    "force_spread": (M_SPREAD,),
    "largest_stress_ratio": (M_LARGEST_S,),
    "hardening_strain": (M_KAPPA,),
    "plastic_shear_strain": (M_GAMMA,),
    "plastic_volumetric_strain": (M_GAMMA + 1,),
    "plastic_dissipation": (M_GAMMA + 2,),
    **{name: (M_HELD + 2 * number, M_HELD + 2 * number + 1) for number, name in enumerate(NAMES)},
}


def micro_of_columns(variables: tuple[Variable, ...]) -> NDArray[np.int64]:
    """For each state column but a last one of pore pressure, the entry of the micro-state that it holds (`load_lane`).

    Returns
    -------
    ndarray of int64, shape (nstate,)
    """
    entries: list[int] = []
    for variable in variables:
        if variable is PORE_PRESSURE:
            continue  # no kernel of the skeleton knows of it
        entries += _MICRO_OF[variable.name][: variable.components]
    if len(set(entries)) != len(entries) or max(entries) >= MICRO:
        raise AssertionError("state columns overlap")
    return np.array(entries, dtype=np.int64)
