"""Shared by the tests of the contact law."""

import itertools

import numpy as np

from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Integration, Material

PRESSURE = 1e5
"""[Pa]; kn/p = 1e4 as in the source."""


def material(**changes):
    """The source's packing."""
    values = {"coordination": 4.06, "solid_fraction": 0.846, "normal_stiffness": 1e9, **changes}
    return Material(**values)


def law(effects=None, closure=None, materials=None, **integration):
    """A contact law with defaults that suit tests."""
    return ContactLaw(materials or [material()], closure, effects, Integration(**integration))


CLOSURES = [
    Closure(tangential=tangential, distribution=distribution)
    for tangential, distribution in itertools.product(("neglected", "self_consistent"), ("harmonic", "maximum_entropy"))
]
"""Closures in the form of rates."""

FLUCTUATING = [
    Closure(force_change="fluctuating", tangential="neglected", distribution="maximum_entropy"),
    Closure(force_change="fluctuating", tangential="self_consistent"),
]
"""Rates in which weak contacts feel a scattered change of force."""

SHIFTED = [
    Closure(force_change="shifted_distribution", tangential="frictional"),
    Closure(force_change="shifted_distribution", tangential="self_consistent"),
    Closure(
        force_change="shifted_distribution",
        tangential="frictional",
        shear_stiffness="isostatic",
        elastic_scatter=0.3,
        irreversible_scatter=5.0,
        slip=1.4,
    ),
]
"""Closures in the form of states."""

ALL_CLOSURES = CLOSURES + FLUCTUATING + SHIFTED + [Closure(shear_stiffness="isostatic")]

EFFECT_SETS = [
    Effects(contact_loss=loss, contact_gain=gain, principal_rotation=rotation, stiffness_feedback=feedback)
    for loss, gain, rotation, feedback in itertools.product((True, False), repeat=4)
]


def closure_name(closure):
    """Test id."""
    kind = {"mean_field": "", "fluctuating": "fluctuating-", "shifted_distribution": "shifted-"}[closure.force_change]
    return f"{kind}{closure.tangential}-{closure.distribution}-{closure.shear_stiffness}"


def effects_name(effects):
    """Test id: initials of what is on."""
    on = [name for name in Effects.names() if getattr(effects, name)]
    return "+".join(on) or "none"


class Points:
    """A batch of points with its buffers, and one call that returns fresh end arrays."""

    def __init__(self, contact_law, stress, state=None, **initial):
        self.law = contact_law
        self.stress = np.atleast_2d(np.array(stress, dtype=float))
        self.state = contact_law.initial_state(self.stress, **initial) if state is None else state

    def update(self, strain_increment, tangent_kind="propagated", material_index=None):
        """Strain-driven: end stress, end state, tangent, report."""
        increment = np.atleast_2d(np.array(strain_increment, dtype=float))
        stress, state = np.full_like(self.stress, np.nan), np.full_like(self.state, np.nan)
        tangent = np.full((len(stress), 3, 3), np.nan)
        report = self.law.update(
            increment, self.stress, self.state, stress, state, tangent, tangent_kind, material_index
        )
        return stress, state, tangent, report

    def mixed(self, control, increment):
        """Mixed control: end stress, end state, strain increment, report."""
        increment = np.atleast_2d(np.array(increment, dtype=float))
        control = np.broadcast_to(np.array(control, dtype=np.uint8), increment.shape).copy()
        stress, state = np.full_like(self.stress, np.nan), np.full_like(self.state, np.nan)
        strain = np.full_like(self.stress, np.nan)
        report = self.law.update_mixed(control, increment, self.stress, self.state, stress, state, strain)
        return stress, state, strain, report

    def get(self, state, name):
        """Columns of a state array by name."""
        return state[:, self.law.description.columns(name)]


def anisotropic_stress(rng, number, most=0.4):
    """Stresses with random p, q/p up to `most` and random principal axes."""
    p = PRESSURE * rng.uniform(0.5, 2.0, number)
    q = p * rng.uniform(0, most, number)
    angle = rng.uniform(0, 2 * np.pi, number)
    return np.stack([-p - q * np.cos(angle), -p + q * np.cos(angle), -q * np.sin(angle)], axis=1)
