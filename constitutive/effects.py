"""Which mechanisms of the contact law are simulated.

Each effect can be off. An effect that is off executes nothing, carries no state column and needs no parameter.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from .parameters import ParameterError


@dataclass(frozen=True)
class Effects:
    """The effect set of a contact law.

    Parameters
    ----------
    contact_loss : bool
        Contacts open where the mean normal force falls [Pouragha & Wan 2017, eqs 9, 10].
    contact_gain : bool
        Gaps close where the mean normal force rises [eqs 9, 13].
    principal_rotation : bool
        Anisotropies are vectors in the double-angle plane. If off, only their component along the x-y axes is
        followed, which is exact where principal axes of stress and fabric stay along x and y.
    stiffness_feedback : bool
        The stiffness follows the coordination number and the fabric. If off, the stiffness of the initial state stays.
    irreversible_spread : bool
        The weak forces keep a spread that grows with the largest q/p so far (closure "shifted_distribution"). If off,
        z and a_c return with the stress.
    tangential_memory : bool
        Contacts that have slipped hold their tangential force when the stress turns back (a_t "frictional"). If off,
        a_t and a_n are functions of the present stress.
    sliding : bool
        Grains slide: plastic strain on a hardening cone in p and the stress ratio (see `sliding`). If off, strain is
        elastic and the stress ratio unbounded.
    pore_fluid : bool
        Fluid fills the pores and cannot leave: pore pressure follows from volumetric strain, and the skeleton carries
        the effective stress (see `pore_fluid`). If off, the response is drained.
    """

    contact_loss: bool = True
    contact_gain: bool = True
    principal_rotation: bool = True
    stiffness_feedback: bool = True
    irreversible_spread: bool = True
    tangential_memory: bool = True
    sliding: bool = False
    pore_fluid: bool = False

    def __post_init__(self) -> None:
        for name in self.names():
            value = getattr(self, name)
            if not isinstance(value, (bool, np.bool_)):
                raise ParameterError(f"effects.{name} = {value!r} is neither True nor False")

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Names of all effects, as used in scenes."""
        return tuple(field.name for field in fields(cls))

    @property
    def network_changes(self) -> bool:
        """Whether coordination number and fabric can change at all."""
        return self.contact_loss or self.contact_gain

    @property
    def linear_response(self) -> bool:
        """Whether stress depends linearly on strain: the stiffness is that of the initial state and stays so."""
        return not (self.network_changes and self.stiffness_feedback) and not self.sliding
