"""Shared by the tests of sliding."""

import numpy as np
from contact_law_cases import Points, law, material

from granfabric.constitutive.effects import Effects
from granfabric.constitutive.parameters import Closure

FIRST, PEAK, REFERENCE, SLOPE, CONSTANT = 0.1, 0.4, 5e-5, 0.9, 0.15
SHIFTED = Closure(force_change="shifted_distribution", shear_stiffness="isostatic")
AT_REST = Effects(contact_loss=False, contact_gain=False, sliding=True)
"""The network stays, so that the moduli do."""


def sliding_material(**changes):
    """The source's packing with a cone that hardens by a hyperbola in gamma_p."""
    values = {
        "peak_stress_ratio": PEAK,
        "first_yield_stress_ratio": FIRST,
        "reference_plastic_strain": REFERENCE,
        "hardening_exponent": 1.0,
        "dilatancy": SLOPE,
        "constant_volume_stress_ratio": CONSTANT,
    }
    return material(**{**values, **changes})


def sliding_law(effects=None, closure=None, material_changes=None, **integration):
    """A contact law with sliding."""
    packing = sliding_material(**(material_changes or {}))
    return law(effects or Effects(sliding=True), closure, [packing], **integration)


def invariants(stress):
    """p, q of tension-positive stresses, shape (..., 3)."""
    p = -0.5 * (stress[..., 0] + stress[..., 1])
    return p, np.hypot(0.5 * (stress[..., 0] - stress[..., 1]), stress[..., 2])


def strength(gamma, first=FIRST, peak=PEAK, reference=REFERENCE):
    """M(gamma_p)."""
    return first + (peak - first) * gamma / (reference + gamma)


def plastic_strain(ratio, first=FIRST, peak=PEAK, reference=REFERENCE):
    """gamma_p of a stress ratio on the cone."""
    return reference * (ratio - first) / (peak - ratio)


def moduli(points):
    """K and G of the state of the first point, from the elastic stiffness, for vanishing fabric."""
    stiffness = points.update(np.zeros((len(points.stress), 3)), "elastic")[2][0]
    return 0.5 * (stiffness[0, 0] + stiffness[0, 1]), stiffness[2, 2]


def go_on(points, stress, state):
    """The same law from an end state."""
    return Points(points.law, stress, state)
